"""World files: what they may hold, what they become, what is refused."""

from __future__ import annotations

import dataclasses
import re

import jsonschema
import pytest

from simprinter import plugin_printer, printer_cfg, world, world_file
from simprinter.hosts.hosts import named_checkouts
from simprinter.machine import Machine
from simprinter.running import SAMPLE
from simprinter.wiring import BoardSpec, Heater
from simprinter.world_file import SCHEMA, WorldFileError

CFG = (SAMPLE / "printer.cfg").read_text(encoding="utf-8")
WORLD = (SAMPLE / "world.toml").read_text(encoding="utf-8")
# What a key of a number ends in: a unit, or that it has none
UNITS = (
    "_mm",
    "_s",
    "_deg",
    "_share",
    "_mm_per_mm",
    "_mm_per_mm2",
    "_mm_per_s",
    "_c",
)
NO_UNIT = {"seed", "direction"}


def nodes():
    """Each table of the schema, by its name there."""
    for name, node in SCHEMA["$defs"].items():
        yield name, node
    for name, node in SCHEMA["properties"].items():
        if name not in SCHEMA["$defs"]:
            yield name, node.get("items", node)


def test_schema_is_one():
    jsonschema.Draft202012Validator.check_schema(SCHEMA)


@pytest.mark.parametrize(
    "name", [name for name, node in nodes() if "record" in node]
)
def test_every_field_of_a_record_has_a_key(name):
    node = dict(nodes())[name]
    record = getattr(world, node["record"])
    fields = {field.name for field in dataclasses.fields(record)}
    named = [key["field"] for key in node["properties"].values()]
    if record is world.WorldSpec:
        named += [
            part["field"]
            for part in SCHEMA["properties"].values()
            if "field" in part
        ]
    assert sorted(named) == sorted(fields)
    wanted = {
        field.name
        for field in dataclasses.fields(record)
        if field.default is dataclasses.MISSING
        and field.default_factory is dataclasses.MISSING
    }
    required = {
        node["properties"][key]["field"] for key in node.get("required", ())
    }
    # Some have a default that nobody should rely on
    assert wanted <= required <= {*wanted, "direction"}


def keys_of_numbers():
    for table, node in nodes():
        inner = node.get("additionalProperties")
        tables = [node, inner] if isinstance(inner, dict) else [node]
        for part in tables:
            for key, about in part.get("properties", {}).items():
                if about.get("type") in ("number", "integer"):
                    yield table, key


def test_keys_of_numbers_name_their_units():
    pairs = list(keys_of_numbers())
    assert len(pairs) > 60
    bare = {
        key
        for _, key in pairs
        if key not in NO_UNIT and not key.endswith(UNITS)
    }
    assert bare == set()
    # Places name their frame
    places = {
        k for _, k in pairs if re.match(r"(brush_|trigger_)?[xyz]_(?!play)", k)
    }
    framed = ("_world_mm", "_from_nozzle_mm", "_from_first_nozzle_mm")
    assert {key for key in places if not key.endswith(framed)} == set()


def test_sample_is_what_its_printer_cfg_makes():
    cfg = printer_cfg.read(SAMPLE / "printer.cfg")
    made = world_file.made_from(
        printer_cfg.PrinterCfg("printer.cfg", cfg.sections)
    )
    assert made == WORLD


EVERYTHING = """
leave_out_sections = ["safe_z_home"]
[start]
x_world_mm = 1
y_world_mm = 2
z_world_mm = 3.5
[machine]
z_play_mm = 0.01
allowed_overtravel_mm = 0.2
senses_probe = true
[bed]
z_world_mm = 0.4
slope_x_mm_per_mm = 0.001
texture.sigma_mm = 0.02
[hotend]
longer_mm_per_100_c = 0.05
lag_s = 20
[bed.mesh]
x_min_world_mm = 0
x_max_world_mm = 10
y_min_world_mm = 0
y_max_world_mm = 20
heights_mm = [[0.0, 0.1], [0.2, 0.3]]
[z_pin]
x_world_mm = 5
y_world_mm = 6
trigger_z_world_mm = 1.5
signal = "pin"
[[switches]]
signal = "x_endstop"
axis = "x"
trigger_world_mm = 0
direction = -1
noise.latency_s = 0.001
[switch_probe]
x_from_nozzle_mm = -2
y_from_nozzle_mm = 24
body_below_nozzle_mm = 6
trigger_below_body_mm = 0.5
mode = "dock"
noise.sigma_mm = 0.001
[dock]
x_world_mm = 1
y_world_mm = 2
z_world_mm = 3
lane_directions = [[0, 1, 0]]
[signals]
x_endstop = "^PC0"
pin = "PC1"
probe = "PC2"
probe_sense = "PC4"
[motors.stepper_z]
microstep_mm = 0.005
x_world_mm = 7
higher_at_start_mm = 0.25
"""


def scene(text, cfg=CFG):
    return plugin_printer.read_scene(cfg, text)


def test_file_becomes_a_machine():
    made = scene(EVERYTHING)
    spec = made.world
    assert spec.bed.mesh.heights == ((0.0, 0.1), (0.2, 0.3))
    assert spec.bed.texture == world.TextureSpec(sigma=0.02)
    assert spec.hotend == world.HotendSpec(0.05, 20)
    assert spec.pin == world.PinSpec(5, 6, 1.5, signal="pin")
    assert spec.switches[0].noise.latency == 0.001
    assert spec.mag_probe.switch_offset == 0.5
    assert spec.dock.lanes == ((0, 1, 0),)
    assert (spec.z_play, spec.overtravel) == (0.01, 0.2)
    assert spec.probe_sense and not spec.dock_sense
    assert made.start == (1, 2, 3.5)
    assert made.wiring.inputs["probe"] == "PC2"
    assert made.wiring.motors["z"].step_dist == 0.005
    assert made.z_motors == [("z", 7, 0.0)]
    assert made.z_skew == {"z": 0.25}
    assert "safe_z_home" not in made.sections
    assert "probe" in made.sections


HOT = """
[extruder]
heater_pin: PH0
sensor_pin: PI0
[heater_bed]
heater_pin: PH1
sensor_pin: PI1
[temperature_sensor room]
sensor_pin: PI2
[mcu tool]
[z_tilt]
z_positions: 0, 10
[stepper_z1]
step_pin: PB3
dir_pin: PB4
microsteps: 16
rotation_distance: 8
"""


def test_heaters_boards_and_tilt_are_those_of_printer_cfg():
    text = f"{WORLD}\n[heaters.extruder]\nambient_c = 30.0\n"
    text += "[boards.tool]\nlatency_s = 0.002\n"
    cfg = f"{CFG}{HOT}".replace("0, 10", "0, 10\n  200, 20")
    made = scene(text, cfg)
    assert made.wiring.heaters == {
        "extruder": Heater("PH0", "PI0", ambient=30.0),
        "heater_bed": Heater("PH1", "PI1", power=1.0, loss=0.005),
        "temperature_sensor room": Heater("", "PI2"),
    }
    assert made.wiring.boards == {"tool": BoardSpec(latency=0.002)}
    assert made.z_motors == [("z", 0.0, 10.0), ("z1", 200.0, 20.0)]


def test_heater_may_be_wired_that_printer_cfg_does_not_have():
    pins = '[heaters.heater_bed]\nheater_pin = "PH1"\nsensor_pin = "PI1"\n'
    bed = Heater("PH1", "PI1", power=1.0, loss=0.005)
    assert scene(f"{WORLD}\n{pins}").wiring.heaters == {"heater_bed": bed}
    sensor = '[heaters."temperature_sensor room"]\nsensor_pin = "PI2"\n'
    room = {"temperature_sensor room": Heater("", "PI2")}
    assert scene(f"{WORLD}\n{sensor}").wiring.heaters == room
    # What printer.cfg has may be wired otherwise than it says
    made = scene(
        f"{WORLD}\n{pins}",
        f"{CFG}[heater_bed]\nheater_pin: PH7\nsensor_pin: PI7\n",
    )
    assert made.wiring.heaters == {"heater_bed": bed}


GENERIC = (
    CFG.replace("kinematics: cartesian", "kinematics: generic_cartesian")
    .replace("[stepper_x]", "[stepper my_x]\ncarriages: x")
    .replace("[stepper_y]", "[stepper my_y]\ncarriages: y")
    .replace("[stepper_z]", "[stepper left]\ncarriages: up")
    .replace("endstop_pin: ^PC0\nposition_endstop: 0\nposition_max: 220", "")
    .replace("endstop_pin: ^PC1\nposition_endstop: 0\nposition_max: 220", "")
    .replace(
        "endstop_pin: probe:z_virtual_endstop\nposition_min: -3\nposition_max: 250",
        "",
    )
    + """
[carriage x]
endstop_pin: tmc2209_my_x:virtual_endstop
position_endstop: 0
position_max: 220
[carriage y]
endstop_pin: ^PC1
position_endstop: 220
position_max: 220
[carriage up]
axis: z
endstop_pin: probe:z_virtual_endstop
position_min: -3
position_max: 250
[stepper right]
carriages: up
step_pin: PB3
dir_pin: !PB4
microsteps: 16
rotation_distance: 8
[tmc2209 stepper my_x]
uart_pin: PE0
diag_pin: ^PC0
run_current: 1
"""
)


def test_generic_cartesian_is_what_its_motors_move():
    text = f"""{WORLD}
[motors."stepper right"]
x_world_mm = 200
higher_at_start_mm = 0.5
"""
    made = scene(text, GENERIC)
    assert made.kinematics == "cartesian"
    motors = made.wiring.motors
    assert {name: m.step_pin for name, m in motors.items()} == {
        "x": "PA0",
        "y": "PA3",
        "z": "PB0",
        "z1": "PB3",
    }
    assert motors["x"].uart == "PE0"
    assert made.z_motors == [("z", 0.0, 0.0), ("z1", 200, 0.0)]
    assert made.z_skew == {"z1": 0.5}
    with pytest.raises(WorldFileError, match="'stepper left'"):
        scene(f"{WORLD}\n[motors.stepper_z]\nx_world_mm = 1\n", GENERIC)


@pytest.mark.parametrize(
    ("x", "y", "wanted"),
    [
        ("x + y", "x-y", "corexy"),
        ("x-y", "y", "hybrid_corexy"),
        ("x+y", "y", None),
    ],
)
def test_generic_cartesian_with_crossed_belts(x, y, wanted):
    cfg = GENERIC.replace("carriages: x", f"carriages: {x}")
    cfg = cfg.replace("carriages: y", f"carriages: {y}")
    if wanted:
        assert scene(WORLD, cfg).kinematics == wanted
        return
    with pytest.raises(
        printer_cfg.PrinterCfgError, match=r"\[stepper my_x\] car"
    ):
        scene(WORLD, cfg)


def test_generic_cartesian_without_a_carriage_is_refused():
    cfg = GENERIC.replace("[carriage up]\naxis: z", "[carriage up]\naxis: x")
    with pytest.raises(
        printer_cfg.PrinterCfgError, match=r"\[carriage z\] axis"
    ):
        scene(WORLD, cfg)


def test_world_of_a_generic_cartesian_has_its_switches(tmp_path):
    file = tmp_path / "printer.cfg"
    file.write_text(GENERIC)
    made = world_file.made_from(printer_cfg.read(file))
    x, y = scene(made, GENERIC).world.switches
    assert (x.position, x.direction, y.position, y.direction) == (0, -1, 220, 1)
    # The driver's virtual endstop is on its diag pin
    assert 'x_endstop = "^PC0"' in made
    assert "# [carriage up] has no switch of its own" in made


def test_thermometer_may_be_on_another_board_or_left_out():
    cfg = f"{CFG}{HOT}".replace("sensor_pin: PI2", "sensor_pin: tool:PI2")
    cfg = cfg.replace("0, 10", "0, 10\n  200, 20")
    wiring = scene(WORLD, cfg).wiring
    assert set(wiring.on_board("tool").heaters) == {"temperature_sensor room"}
    # A pin that is nowhere does no harm there
    cfg = cfg.replace("tool:PI2", "ZZ1")
    left_out = 'leave_out_sections = ["temperature_sensor room"]\n'
    assert len(scene(left_out + WORLD, cfg).wiring.heaters) == 2


@pytest.mark.parametrize(("told", "direction"), [("True", 1), ("False", -1)])
def test_direction_of_homing_is_the_one_that_is_told(tmp_path, told, direction):
    file = tmp_path / "printer.cfg"
    file.write_text(f"{CFG}[stepper_x]\nhoming_positive_dir: {told}\n")
    made = world_file.made_from(printer_cfg.read(file))
    (switch, _) = scene(made, file.read_text()).world.switches
    assert switch.direction == direction


def test_gantry_of_four_motors_stands_on_its_corners():
    steppers = "".join(
        f"[stepper_z{n}]\nstep_pin: PB{3 * n}\ndir_pin: PB{3 * n + 1}\n"
        "microsteps: 16\nrotation_distance: 8\n"
        for n in (1, 2, 3)
    )
    corners = "[quad_gantry_level]\ngantry_corners: -60,-10\n  410, 420\n"
    made = scene(WORLD, CFG + steppers + corners)
    assert made.z_motors == [
        ("z", -60.0, -10.0),
        ("z1", -60.0, 420.0),
        ("z2", 410.0, 420.0),
        ("z3", 410.0, -10.0),
    ]


SEVERAL = """
[switch_probe]
x_from_nozzle_mm = 0
y_from_nozzle_mm = 20
body_below_nozzle_mm = 6
trigger_below_body_mm = 0.5
[[more_pins]]
x_world_mm = 5
y_world_mm = 6
trigger_z_world_mm = 1.5
signal = "other_pin"
[membrane]
x_world_mm = 30
y_world_mm = 20
thickness_mm = 0.3
radius_mm = 9
[[more_membranes]]
x_world_mm = 60
y_world_mm = 20
thickness_mm = 0.4
radius_mm = 9
signal = "thick"
noise.sigma_mm = 0.001
[signals]
membrane = "PC5"
thick = "PC6"
other_pin = "PC7"
coil = "PC8"
"""


def several(coil='signal = "coil"\n'):
    old = "[inductive_probe]\n"
    text = WORLD.replace(old, old + coil)
    return text.replace("[signals]\n", f"{SEVERAL}")


def test_several_probes_pins_and_membranes_have_signals_of_their_own():
    made = scene(several())
    assert set(made.wiring.inputs) == {
        "x_endstop",
        "y_endstop",
        "probe",
        "coil",
        "other_pin",
        "membrane",
        "thick",
    }
    spec = made.world
    assert spec.inductive.signal == "coil"
    assert [part.thickness for part in spec.membranes()] == [0.3, 0.4]
    assert spec.more_membranes[0].noise.sigma == 0.001
    assert [pin.x for pin in spec.pins()] == [5.0]
    with pytest.raises(WorldFileError, match=r"\['probe'\] is that of more"):
        scene(several(coil=""))


def changed(old, new):
    assert old in WORLD
    return WORLD.replace(old, new, 1)


NONSENSE = [
    ("[bed]", "[beds]", ["[beds]: is unknown", "do you mean bed?"]),
    ("x_max_world_mm = 220", 'x_max_world_mm = "220"', ['"220"', "a number"]),
    ("x_max_world_mm = 220", "x_max_mm = 220", ["x_max_mm", "x_max_world_mm"]),
    ("x_max_world_mm = 220", "x_max_world_mm = -1", ["= -1:", "must be >"]),
    ("x_max_world_mm = 220", "x_max_world_mm = nan", ["nan", "finite"]),
    ("x_max_world_mm = 220", "x_max_world_mm = ", ["not TOML", "line"]),
    ("x_world_mm = 20", "", ["[start] x_world_mm: is missing; add it"]),
    ("[start]", "[bed.texture]\nsigma_mm = 0\n[start]", ["above 0", "spread"]),
    ("direction = -1", "direction = 0", ["(number 1)", "one of [1, -1]"]),
    ('axis = "x"', 'axis = "w"', ['"w"', "one of"]),
    ('probe = "^PC3"', "", ["[signals] probe", "is missing"]),
    ('probe = "^PC3"', 'probe = "^PC0"', ["the pin of x_endstop", "its own"]),
    ('probe = "^PC3"', 'probe = "C3"', ['"C3"', "a pin"]),
    ('probe = "^PC3"', 'probe = "^PC3"\nno = "PA9"', ["nothing drives it"]),
    ("[signals]", "[dock]\nx_world_mm=1\ny_world_mm=1\nz_world_mm=1\n[signals]",
     ["[dock]", "must be"]),
    ("[signals]", "[motors.z]\nmicrostep_mm = 1\n[signals]", ["stepper_z"]),
    ("[signals]", "[heaters.h]\nambient_c = 1\n[signals]", ["[heaters.h]"]),
    ("[signals]", "[boards.b]\nlatency_s = 1\n[signals]", ["[boards.b]"]),
]  # fmt: skip


@pytest.mark.parametrize(("old", "new", "told"), NONSENSE)
def test_nonsense_is_refused_with_key_value_and_remedy(old, new, told):
    with pytest.raises(WorldFileError) as error:
        scene(changed(old, new))
    text = str(error.value)
    assert "world.toml: " in text
    assert all(part in text for part in told), text


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (
            "kinematics: cartesian",
            "kinematics: polar",
            "only cartesian.*generic_cartesian",
        ),
        ("kinematics: cartesian", "kinematics: corexz", None),
        ("kinematics: cartesian", "kinematics: limited_corexy", None),
    ],
)
def test_machines_that_are_simulated(old, new, told):
    if told is None:
        assert scene(WORLD, CFG.replace(old, new)).kinematics in new
        return
    with pytest.raises(printer_cfg.PrinterCfgError, match=told):
        scene(WORLD, CFG.replace(old, new))


SWITCHED = [
    # What Z homes on, what the probe is
    ("endstop_pin: ^PC2\nposition_endstop: 0", "", ["z_world_mm = -0.5"]),
    ("endstop_pin: ^PC2\nposition_endstop: 250", "", ["direction = 1"]),
    (None, "z_offset: -0.1", ["[bed_sensor]", 'bed_sensor = "^PC3"']),
    (None, "z_offset: 2.5", ["trigger_nozzle_above_bed_mm = 2.5"]),
]


@pytest.mark.parametrize(("endstop", "probe", "wanted"), SWITCHED)
def test_world_is_made_of_what_printer_cfg_says(
    tmp_path, endstop, probe, wanted
):
    text = CFG
    if endstop:
        text = text.replace("endstop_pin: probe:z_virtual_endstop", endstop)
    if probe:
        text = text.replace("z_offset: 1.5", probe)
    file = tmp_path / "printer.cfg"
    file.write_text(
        f"{text}\n[adxl345]\n[fan]\npin: PD1\n"
        "[stepper_x1]\nstep_pin: PD2\ndir_pin: PD3\nendstop_pin: PD4\n"
        "microsteps: 16\nrotation_distance: 40\n"
        "[temperature_sensor cpu]\nsensor_type: temperature_mcu\n"
    )
    made = world_file.made_from(printer_cfg.read(file))
    assert all(part in made for part in wanted), made
    assert '"adxl345"' in made and '"temperature_sensor cpu"' in made
    assert '"fan"' not in made
    assert 'x1_endstop = "PD4"' in made
    machine = scene(made, file.read_text())
    assert "adxl345" not in machine.sections and "fan" in machine.sections
    # A second motor of X moves nothing by itself
    with Machine(machine):
        assert set(machine.wiring.motors) == {"x", "y", "z"}


@pytest.mark.slow
def test_examples_of_klipper_become_machines_or_are_refused(tmp_path):
    """Four of five; what is no whole printer, or no such machine, is told."""
    checkouts = named_checkouts()
    files = [f for c in checkouts[:1] for f in c.glob("config/*.cfg")]
    if not files:
        pytest.skip("no checkout of Klipper is named")
    refused = []
    for file in files:
        try:
            machine = plugin_printer.read_scene(file)
        except printer_cfg.PrinterCfgError as error:
            refused.append(str(error))
            continue
        with Machine(machine):
            pass
    reasons = (
        "kinematics is",
        "step_pin is",
        "dir_pin is",
        "rotation_distance",
        "carriages is",
        "axis is",
    )
    assert [t for t in refused if not any(r in t for r in reasons)] == []
    assert len(refused) < 0.25 * len(files)
