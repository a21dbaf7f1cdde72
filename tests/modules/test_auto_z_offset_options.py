"""Every option of [auto_z_offset]: that it does something, and what."""

from __future__ import annotations

import pytest

from simprinter import Fault
from tools.kit.auto_z_offset import (
    AIR_GAP,
    DEPTH,
    MICROSTEP,
    POINT,
    PROBE_PLACE,
    SENSOR,
    formulas,
    seconds,
    section,
    sites,
    state,
    told,
    touches,
    true_gap,
    with_extras,
)
from tools.kit.carrying import with_all
from tools.kit.cases import slow
from tools.kit.docks import DOCK_SCENES
from tools.kit.printer import module_files
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import refusal

STEPS = 2 * MICROSTEP
# Takes no time and moves nothing
JUST_ON = "SET_PIN PIN=bed_sensor VALUE=1"


def measured(printer, command="AUTO_Z_MEASURE_OFFSET"):
    """The numbers of one measurement."""
    return formulas(printer.run(command))[-1]


def ends(printer):
    """Where moves of the module have ended: x, y, z in mm."""
    return printer.status("moves")["ends"]


def moving(start, faults=(), probe=None, **options):
    """A printer that notes moves, homed, with nothing in prepare_gcode."""
    changes = {"moves": {}, **section(prepare_gcode=JUST_ON, **options)}
    changes["probe"] = probe or {}
    printer = start(
        "qidi", changes=changes, modules=with_extras("moves"), faults=faults
    )
    return printer.homed()


# Heights


@pytest.mark.parametrize("z_offset", [slow("0"), "0.05", "-0.1"])
def test_air_gap(start, z_offset):
    changes = section(z_offset=z_offset)
    printer = start("qidi", changes=changes).homed()
    # A nozzle inside the bed is what the user asked for
    printer.machine.tolerate("nozzle_bed", 0.2)
    lines = printer.run("AUTO_Z_CALIBRATE")
    gap = float(z_offset) - DEPTH
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    at_start = told(printer.session.console, "mm inside the bed")
    inside = told(lines, "at Z=0 the nozzle is 0.100 mm inside the bed")
    if float(z_offset) < 0:
        # At the start and with the result
        assert (len(inside), len(at_start)) == (1, 2)
        assert "z_offset -0.100" in inside[0]
        assert "write it without the minus sign" in inside[0]
        lines = printer.run("AUTO_Z_MEASURE_OFFSET")
        assert len(told(lines, "mm inside the bed")) == 1
    else:
        assert at_start == []


@pytest.mark.parametrize(
    ("hop", "z_offset"), [("4.0", 0.0), ("12.5", 0.0), ("9.0", 2.2)]
)
def test_probe_hop(start, hop, z_offset):
    printer = moving(start, probe={"z_offset": f"{z_offset}"}, probe_hop=hop)
    before = len(ends(printer))
    z = measured(printer).sensor
    moves = ends(printer)[before:]
    # Travel before anything is known, then above the trigger, twice
    wanted = max(10.0, z_offset + float(hop))
    assert moves[0][2] == pytest.approx(wanted, abs=1e-3)
    over_bed = [m[:2] == list(POINT) for m in moves].index(True)
    to_probe = [m for m in moves[over_bed:] if m[:2] == list(PROBE_PLACE)]
    assert to_probe[0][2] == pytest.approx(z + float(hop), abs=0.01)
    assert moves[-1][2] == pytest.approx(z + float(hop), abs=0.01)


@pytest.mark.parametrize(
    ("changes", "place"),
    [
        (section(bed_xy_position="60, 180"), (60.0, 180.0)),
        # X ends at -5.5 and there
        ({"stepper_x": {"position_max": "205"}}, (99.75, POINT[1])),
    ],
)
def test_point_of_the_measurement(start, changes, place):
    home = {"safe_z_home": {"home_xy_position": "100, 122"}}
    printer = start("qidi", changes={**changes, **home}).homed()
    first = len(printer.machine.truth.touches)
    printer.run("AUTO_Z_MEASURE_OFFSET")
    unused, nozzle, probe = touches(printer, first)
    assert (nozzle.x, nozzle.y) == pytest.approx(place, abs=0.02)
    there = (place[0] - 17.6, place[1] - 4.4)
    assert (probe.x, probe.y) == pytest.approx(there, abs=0.02)


@pytest.mark.parametrize(
    ("axis", "own", "z", "why"),
    [
        ("-4", "-1.1", -1.1, "probe_z_min"),
        ("-4", "-7", -4.0, "position_min of section 'stepper_z'"),
    ],
)
def test_floor(start, axis, own, z, why):
    changes = {"stepper_z": {"position_min": axis}, **section(probe_z_min=own)}
    command = "AUTO_Z_MEASURE_OFFSET"
    fault = Fault("stuck_open", site="nozzle_bed", command=command)
    printer = start("qidi", changes=changes, faults=[fault])
    printer.machine.tolerate("nozzle_bed", max(0.0, SENSOR - z) + 0.02)
    text = printer.homed().fail(command)
    assert "bed sensor: the switch did not answer" in text
    assert (
        f"(stopped at z={z:.3f}), the lowest point of this touch: {why}; "
        in text
    )
    assert printer.machine.truth.min_gap == pytest.approx(1.2695 + z, abs=STEPS)
    ignored = told(printer.session.console, f"'probe_z_min: {own}' is ignored")
    assert len(ignored) == (1 if own and float(own) < z else 0)


# Speeds


@pytest.mark.parametrize("saved", [None, "-1.12"])
def test_every_touch_has_the_same_speed(start, saved):
    # 0.9 mm to stop: further than the floor would be below the bed
    printer = moving(
        start,
        speed="10",
        probe_accel="50",
        samples="3",
        samples_tolerance="0.003",
        samples_tolerance_retries="0",
        probe_z_correction=saved,
    )
    printer.run("AUTO_Z_CALIBRATE")
    z = printer.status("auto_z_offset")["last_z"]
    # 9.49 mm/s
    assert z == pytest.approx(SENSOR - 0.002 * 4.5, abs=STEPS)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("speed", "accel", "below"),
    [
        # 0.64 mm from 8 mm/s, and a reserve
        ("8", {"probe_accel": "50"}, 0.740),
        # No more room than that below the bed
        ("30", {"probe_accel": "50"}, 1.000),
        # Slower than what the axes together are allowed
        ("5", {"max_z_accel": "25"}, 0.600),
    ],
)
def test_floor_leaves_room_to_brake(start, speed, accel, below):
    changes = section(speed=speed, probe_accel=accel.get("probe_accel"))
    changes["printer"] = {"max_z_accel": accel.get("max_z_accel", "500")}
    about = {"site": "nozzle_bed", "touch": 2, "command": "AUTO_Z_CALIBRATE"}
    fault = Fault("trigger_never", **about)
    printer = start("qidi", changes=changes, faults=[fault]).homed()
    printer.machine.tolerate("nozzle_bed", 1.2)
    text = printer.fail("AUTO_Z_CALIBRATE")
    assert f"{below:.3f} mm below the expected trigger at z=-1.3" in text
    notes = told(printer.session.console, "is limited to")
    assert len(notes) == (1 if below == 1.000 else 0)
    for note in notes:
        assert f"speed {speed} is limited to 9.49 mm/s on the bed" in note
        assert "with 50 mm/s^2 the toolhead could not stop" in note


def test_lift_speed(start):
    # Five mm of hop each, counted from the bed; quickly down from the hop to 2 mm above
    # where the probe triggers, which is at 0
    took = {}
    for speed in (2.0, 20.0):
        printer = moving(
            start, lift_speed=str(speed), samples="1", probe_accel="0"
        )
        printer.run("AUTO_Z_PROBE")
        took[speed] = seconds(printer, "AUTO_Z_MEASURE_OFFSET")
    lifted = 5.0 + 5.0 + (SENSOR + 5.0 - 2.0)
    assert took[2.0] - took[20.0] == pytest.approx(
        lifted * (1 / 2.0 - 1 / 20.0), abs=0.35
    )


# Samples


def test_median_of_the_cycles(start):
    about = {"site": "nozzle_bed", "touch": 2, "command": "AUTO_Z_CALIBRATE"}
    fault = Fault("trigger_early", mm=0.06, **about)
    options = {"samples_result": "median", "samples_tolerance": "0.1"}
    printer = moving(start, [fault], offset_samples="5", **options)
    lines = printer.run("AUTO_Z_CALIBRATE")
    assert len(formulas(lines)) == 5
    assert told(lines, "AUTO_Z_CALIBRATE: median of 5, range 0.06")
    assert printer.offset() == pytest.approx(SENSOR + AIR_GAP, abs=STEPS)
    spread = printer.status("auto_z_offset")["spread"]
    assert spread == pytest.approx(0.06, abs=STEPS)


# What was saved


def test_change_is_accepted(start):
    # Saved with another probe
    changes = section(probe_z_correction="0.5")
    printer = start("qidi", changes=changes).homed()
    for value, words in (
        ("", "bed sensor: the switch did not answer"),
        ("0", "bed sensor: the switch did not answer"),
        ("2", "ACCEPT_CHANGE"),
        ("yes", "ACCEPT_CHANGE"),
    ):
        text = printer.fail(f"AUTO_Z_PROBE ACCEPT_CHANGE={value}")
        assert words in text
    assert printer.machine.truth.touch_count("nozzle_bed") == 0
    printer.run("AUTO_Z_PROBE ACCEPT_CHANGE=1")
    assert printer.machine.truth.touch_count("nozzle_bed") == 1


def test_correction_follows_the_probe(start):
    # As Z_OFFSET_APPLY_PROBE leaves it: z_offset took over what was measured
    printer = start(
        "qidi",
        changes={
            "probe": {"z_offset": "1.12"},
            **section(
                probe_z_correction="-1.12", corrected_probe_z_offset="0.0"
            ),
        },
    ).homed()
    (line,) = told(printer.session.console, "the probe's z_offset is 1.120")
    assert "and was 0.000 when the correction was saved" in line
    assert "probe_z_correction -1.120000 is taken as 0.000000" in line
    assert line.endswith(
        "if the probe was moved meanwhile, run AUTO_Z_CALIBRATE"
    )
    lines = printer.run("AUTO_Z_LOAD_OFFSET")
    assert not told(lines, "there is no probe_z_correction yet")
    assert told(lines, ": 1.120 mm of it follow the probe's new z_offset")
    gap = printer.scene.piezo_gap()
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    printer.run("AUTO_Z_CALIBRATE")
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    assert not told(printer.run("AUTO_Z_LOAD_OFFSET"), "mm of it follow")


def test_correction_of_the_same_probe_stays(start):
    changes = section(
        probe_z_correction="-1.12", corrected_probe_z_offset="0.0000004"
    )
    printer = start("qidi", changes=changes)
    printer.session.require_ready()
    assert told(printer.session.console, "is taken as") == []
    status = printer.status("auto_z_offset")
    assert status["probe_z_correction"] == -1.12


# Its next run sets Z anew, and the step is part of nothing
@pytest.mark.parametrize(("step", "is_told"), [(0.08, True), (0.0, False)])
def test_button_of_the_host_after_homing_with_the_sensor(start, step, is_told):
    changes = section(z_offset="-0.05")
    printer = start("qidi", changes=changes).homed()
    printer.run(f"AUTO_Z_HOME_Z\nSET_GCODE_OFFSET Z_ADJUST={step}")
    assert "nozzle_bed" in sites(printer)
    gap = true_gap(printer)
    lines = printer.run("Z_OFFSET_APPLY_PROBE")
    hint = "write z_offset: -0.130 into section 'auto_z_offset' for it"
    assert any(hint in line for line in lines) is is_told
    if is_told:
        changes = section(z_offset="-0.130")
        printer = start("qidi", changes=changes).homed()
        printer.run("AUTO_Z_HOME_Z")
        assert true_gap(printer) == pytest.approx(gap, abs=STEPS)


OVER_BED = (150.0, 155.0)


def homed_on_pin(start):
    """Z homed on a switch, the probe 0.7 mm wrong, and its mesh in force."""
    scene = with_all(DOCK_SCENES["dock_gantry_switch"])
    probe = {"dockable_probe": {"samples": "1", "z_offset": "6.2"}}
    printer = start(scene, probe).homed()
    printer.run("BED_MESH_CALIBRATE\nAUTO_Z_CALIBRATE")
    return printer


@pytest.mark.parametrize("step", [0.0, -0.05])
def test_button_that_puts_the_correction_into_the_endstop(start, step):
    printer = homed_on_pin(start)
    gap = printer.gap(OVER_BED)
    printer.run(f"SET_GCODE_OFFSET Z_ADJUST={step}")
    lines = printer.run("Z_OFFSET_APPLY_ENDSTOP")
    hint = f"by it, and {step:.3f} mm of baby steps are gone; RESTART instead"
    assert any(hint in line for line in lines)
    # As it says
    printer.session.restart("SAVE_CONFIG")
    printer.homed().run("BED_MESH_PROFILE LOAD=default\nAUTO_Z_LOAD_OFFSET")
    assert printer.gap(OVER_BED) < -0.3
    printer.run("BED_MESH_CALIBRATE\nAUTO_Z_LOAD_OFFSET")
    assert printer.gap(OVER_BED) == pytest.approx(gap, abs=2 * STEPS)


# z_offset takes the correction over, and nothing else
@pytest.mark.parametrize("step", [0.0, 0.05])
def test_baby_steps_and_the_button_of_the_host(start, step):
    printer = start("qidi").homed()
    printer.run(f"AUTO_Z_CALIBRATE\nSET_GCODE_OFFSET Z_ADJUST={step} MOVE=0")
    lines = printer.run("Z_OFFSET_APPLY_PROBE")
    hint = f"{step:.3f} mm of baby steps are gone after SAVE_CONFIG"
    assert any(hint in line for line in lines) == bool(step)
    if step:
        printer.run("AUTO_Z_SAVE_GCODE_OFFSET")
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28\nAUTO_Z_LOAD_OFFSET")
    gap = printer.scene.piezo_gap() + step
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)


LOAD = "AUTO_Z_LOAD_OFFSET\nSET_GCODE_OFFSET Z=0"


# Nobody knows of baby steps there
@pytest.mark.parametrize(
    "script",
    [
        "G28",
        f"G28\n{LOAD}",
        # Of the bed sensor's frame
        f"{LOAD}\nAUTO_Z_HOME_Z\nSET_GCODE_OFFSET Z=0.05",
    ],
)
def test_button_of_the_host_without_a_correction_in_force(start, script):
    changes = section(probe_z_correction="-1.12")
    printer = start("qidi", changes=changes).homed()
    lines = printer.run(script)
    is_loaded = any("the G-code Z offset is -1.12" in line for line in lines)
    assert is_loaded == ("LOAD" in script)
    lines = printer.run("Z_OFFSET_APPLY_PROBE")
    assert not any("baby steps" in line for line in lines)


def test_documented_default_of_the_correction_means_none(start):
    printer = start("qidi", changes=section(probe_z_correction="0")).homed()
    printer.run("AUTO_Z_CALIBRATE")
    assert printer.offset() == pytest.approx(SENSOR + AIR_GAP, abs=STEPS)


def test_saved_correction_says_nothing_where_a_switch_homes_z(start):
    # The frame is the switch's
    scene = SCENES["piezo_cartesian"]
    changes = section(probe_z_correction="3.0")
    changes["stepper_z"] = {
        "endstop_pin": "^PC8",
        "position_endstop": "0",
        "position_min": "-4",
    }
    changes["safe_z_home"] = None
    changes["force_move"] = {"enable_force_move": "true"}
    printer = start(scene, changes=changes)
    printer.session.require_ready()
    x, y, z = scene.start
    printer.run(f"SET_KINEMATIC_POSITION X={x} Y={y} Z={z + 0.3}\nG90")
    at_start = told(printer.session.console, "Z is not homed with the probe")
    assert len(at_start) == 1
    lines = printer.run("AUTO_Z_MEASURE_OFFSET")
    assert told(lines, "the correction holds with a bed mesh of this probe")
    bed_z = formulas(lines)[0].probe - 1.0
    assert bed_z == pytest.approx(0.3130 + 1.2713 + 0.3 - 1.0, abs=STEPS)


# Wrong set-ups


NO_Z_AXIS = {
    "printer": {
        "kinematics": "none",
        "max_velocity": "1",
        "max_accel": "1",
        "max_z_velocity": None,
        "max_z_accel": None,
    },
    **{f"stepper_{name}": None for name in ("x", "y", "z", "z1")},
    **{f"tmc2209 stepper_{name}": None for name in ("z", "z1")},
    **{name: None for name in ("probe", "safe_z_home")},
}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (section(pin=""), ["Option 'pin: '", "is no pin", "U_1:PC1"]),
        (
            section(pin="much:PC1"),
            [
                "Option 'pin: much:PC1' in section 'auto_z_offset' names a board",
                "no section [mcu ...] of; the boards are mcu, and a pin",
            ],
        ),
        (
            {
                "probe": None,
                "safe_z_home": None,
                "stepper_z": {"endstop_pin": "^PC8", "position_endstop": "0"},
            },
            ["Section 'probe' is missing: auto_z_offset corrects"],
        ),
        (NO_Z_AXIS, ["'kinematics: none'", "remove section 'auto_z_offset'"]),
        (section(probe_hop="300"), ["probe_hop", "position_max (248.000)"]),
        (section(probe_z_min="0.5"), ["probe_z_min", "below 0"]),
        (
            section(bed_xy_position="246, 100"),
            ["bed_xy_position: 246,100", "X=246.000, outside its -5.500"],
        ),
        (
            section(bed_xy_position="10, 100"),
            ["with the probe above it, needs the toolhead at X=-7.600"],
        ),
        (
            section(bed_xy_position="100, -1"),
            ["with the probe above it, needs the toolhead at Y=-5.400"],
        ),
        (
            section(bed_spread="3", bed_xy_position="243, 120"),
            ["Option 'bed_spread: 3' in section 'auto_z_offset' needs the"],
        ),
    ],
)
def test_wrong_set_up_is_refused(host, changes, words):
    message = refusal(host, changes, "qidi")
    for word in words:
        assert word in message


# Options of the original module


OLD = {
    "calibrated_z_offset": ("-1.24", "AUTO_Z_CALIBRATE again"),
    "x_offset": ("17.6", "is ignored"),
    "y_offset": ("4.4", "is ignored"),
    "activate_gcode": ("", ""),
    "deactivate_gcode": ("M118 off", "that runs after AUTO_Z_CALIBRATE"),
    "deactivate_on_each_sample": ("False", "is ignored"),
    "stow_on_each_sample": ("False", "is ignored"),
    "recovery_time": ("0.4", "G4"),
}


def test_old_options_are_told_and_not_used(start):
    changes = section(**{name: value for name, (value, _) in OLD.items()})
    printer = start("qidi", changes=changes).homed()
    for option, (value, words) in OLD.items():
        lines = told(printer.session.console, f"option '{option}' ")
        assert len(lines) == (1 if value else 0)
        assert all(words in line for line in lines)
    printer.run("AUTO_Z_LOAD_OFFSET")
    assert printer.offset() == 0.0
    printer.run("AUTO_Z_CALIBRATE")
    gap = printer.scene.piezo_gap()
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)


@pytest.mark.parametrize("command", ["CALIBRATE", "LOAD_OFFSET"])
def test_section_of_the_original_module_as_it_was(start, command):
    changes = section(calibrated_z_offset="-1.00", z_offset="-0.2")
    printer = start("qidi", changes=changes).homed()
    before, first = state(printer), len(printer.machine.truth.touches)
    text = printer.fail(f"AUTO_Z_{command}")
    assert "it has calibrated_z_offset, and 'z_offset: -0.2' as the Z" in text
    assert "with the opposite sign; write 'z_offset: 0.2' and remove" in text
    assert (state(printer), sites(printer, first)) == (before, [])


def test_gcode_that_would_be_missed_is_asked_for(start):
    # The sensor may be powered by it
    changes = section(activate_gcode="SET_PIN PIN=bed_sensor VALUE=1")
    printer = start("qidi", changes=changes).homed()
    first = len(printer.machine.truth.touches)
    text = printer.fail("AUTO_Z_CALIBRATE")
    assert "activate_gcode is not run" in text
    assert "move it into prepare_gcode" in text
    assert sites(printer, first) == []
    printer.run("AUTO_Z_LOAD_OFFSET\nAUTO_Z_SAVE_GCODE_OFFSET FORCE=1")


# How far the first touch of all may go


@pytest.mark.parametrize(
    ("changes", "depth"),
    [
        ({}, "4"),
        ({"stepper_z": {"position_min": "-2.5"}}, "2.5"),
        # The user has said how far
        (section(probe_z_min="-2.5"), None),
        (section(probe_z_correction="0.1"), None),
        ({"stepper_z": {"position_min": "-1.5"}}, None),
    ],
)
def test_deep_first_touch_is_told_until_there_is_a_correction(
    start, changes, depth
):
    """As a dead bed sensor lets the nozzle into the bed as far as that."""
    printer = start("qidi", changes=changes)
    printer.session.require_ready()
    notes = printer.status("auto_z_offset")["notes"]
    told = [n for n in notes if "until AUTO_Z_CALIBRATE has run once" in n]
    assert len(told) == bool(depth)
    for note in told:
        assert f"be pressed {depth} mm into the bed" in note
        assert "set probe_z_min" in note


# Slow touches


@pytest.mark.parametrize(("speed", "is_told"), [("3.9", 1), ("4", 0)])
def test_slow_speed_is_told(start, speed, is_told):
    printer = start("qidi", changes=section(speed=speed))
    printer.session.require_ready()
    notes = printer.status("auto_z_offset")["notes"]
    words = (
        f"'speed: {speed}' is slow for a piezo sensor, which may not trigger"
    )
    assert sum(words in note for note in notes) == is_told


@pytest.mark.parametrize(
    ("options", "names"),
    [
        # Faster by itself, and by what the floor allows
        ({"speed": "12", "probe_accel": "500"}, False),
        slow({"speed": "12", "probe_accel": "50"}, True),
    ],
)
def test_touch_without_a_trigger_names_speed_first(start, options, names):
    printer = start("qidi", changes=section(**options)).homed()
    printer.machine.break_down(Fault("stuck_open", site="nozzle_bed"))
    printer.machine.tolerate("nozzle_bed", 5.0)
    text = printer.fail("AUTO_Z_PROBE")
    assert ("; raise speed (piezo sensors may miss a touch at" in text) == names
    assert "check that prepare_gcode turns the sensor on" in text


# Pins that other sections name, and may


CLAIMS = """
def load_config(config):
    pins = config.get_printer().lookup_object("pins")
    pins.allow_multi_use_pin(config.get("sensor_pin"))
    return config
"""


def test_pin_that_may_be_shared(start):
    button = {"pin": "PC1", "press_gcode": "\n  G4 P1"}
    changes = {
        "duplicate_pin_override": {"pins": "\n  PA15,\n  PC1"},
        "gcode_button bed": button,
    }
    start("qidi", changes=changes).session.require_ready()


def test_pin_of_a_diagnosis_that_nothing_uses(start):
    """Boards share it with an endstop by a jumper."""
    changes = {"tmc2209 stepper_z": {"diag_pin": "^PC1"}}
    start("qidi", changes=changes).session.require_ready()


def test_pin_that_a_module_allows_several_times(start, tmp_path):
    """As tools_calibrate of klipper-toolchanger does."""
    source = tmp_path / "tools_calibrate.py"
    source.write_text(CLAIMS)
    modules = {**module_files(), "tools_calibrate": source}
    changes = {"tools_calibrate": {"sensor_pin": "PC1"}}
    printer = start("qidi", changes=changes, modules=modules)
    printer.session.require_ready()
