"""Two carriages on one rail, each with a nozzle of its own, on real klippy."""

from __future__ import annotations

import pytest

from simprinter import plugin_printer, printer_cfg, world_file
from simprinter.printer_cfg import PrinterCfgError
from simprinter.world import CrashError
from simprinter.world_file import WorldFileError

# The rail of each carriage, and the pins of its motor
RAILS = {
    "x": """
endstop_pin: ^PC0
position_endstop: -40
position_min: -40
position_max: 220
homing_speed: 50
homing_retract_dist: 0
""",
    "y": """
endstop_pin: ^PC1
position_endstop: 0
position_max: 220
homing_speed: 50
homing_retract_dist: 0
""",
    "z": """
endstop_pin: probe:z_virtual_endstop
position_min: -3
position_max: 250
""",
    "u": """
endstop_pin: ^PC4
position_endstop: 260
position_min: 0
position_max: 260
homing_speed: 50
homing_retract_dist: 0
safe_distance: 30
""",
}
PINS = {
    "x": ("PA0", "PA1", 40),
    "y": ("PA3", "PA4", 40),
    "z": ("PB0", "PB1", 8),
    "u": ("PA6", "!PA7", 40),
}
MOTORS = {
    name: f"step_pin: {step}\ndir_pin: {direction}\n"
    f"rotation_distance: {turn}\nmicrosteps: 16\n"
    for name, (step, direction, turn) in PINS.items()
}
# Both nozzles press the bed's sensor, which is the probe
REST = """
[mcu]
[probe]
pin: ^PC3
z_offset: 0
speed: 5
lift_speed: 10
samples: 1
[safe_z_home]
home_xy_position: 110, 110
z_hop: 10
[printer]
max_velocity: 300
max_accel: 3000
max_z_velocity: 15
"""
CFG = f"{REST}kinematics: cartesian\n" + "".join(
    f"[{section}]\n{MOTORS[name]}{RAILS[name]}"
    for name, section in (
        ("x", "stepper_x"),
        ("y", "stepper_y"),
        ("z", "stepper_z"),
        ("u", "dual_carriage]\naxis: x\n[dual_carriage"),
    )
)
GENERIC = f"{REST}kinematics: generic_cartesian\n" + "".join(
    f"[{section}]\n{RAILS[name]}[stepper {name}]\ncarriages: {name}\n"
    f"{MOTORS[name]}"
    for name, section in (
        ("x", "carriage x"),
        ("y", "carriage y"),
        ("z", "carriage z"),
        ("u", "dual_carriage u]\nprimary_carriage: x\n[dual_carriage u"),
    )
)
MACHINES = {
    "cartesian": CFG,
    "hybrid_corexy": CFG.replace("cartesian", "hybrid_corexy"),
    "generic_cartesian": GENERIC,
}
# The second nozzle is behind the first, and lower, mm
DY, DZ = 0.5, -0.25
PRESS = 0.05
# The bed, above what printer.cfg has as zero at first
BED = 0.1
X_STEP, Z_STEP = 0.0125, 0.0025


def world_of(cfg, folder):
    """The world file that a printer.cfg makes, with what had to be guessed."""
    file = folder / "printer.cfg"
    file.write_text(cfg)
    made = world_file.made_from(printer_cfg.read(file))
    for guess, measured in (
        ("y_from_first_nozzle_mm = 0", f"y_from_first_nozzle_mm = {DY}"),
        ("z_from_first_nozzle_mm = 0", f"z_from_first_nozzle_mm = {DZ}"),
        ("nearest_to_first_nozzle_mm = 0", "nearest_to_first_nozzle_mm = 30"),
        ("z_world_mm = 0\n", f"z_world_mm = {BED}\n"),
    ):
        assert guess in made
        made = made.replace(guess, measured)
    return made


@pytest.fixture
def machine(tmp_path):
    """The cartesian one."""
    return plugin_printer.read_scene(CFG, world_of(CFG, tmp_path))


def has_kinematics(host, name):
    """Whether the host has a file for it."""
    return (host.directory / "base/klippy/kinematics" / f"{name}.py").exists()


@pytest.mark.every_host("each has its own code for two carriages")
@pytest.mark.parametrize("kind", MACHINES)
def test_each_nozzle_meets_the_bed_where_it_hangs(start, host, kind, tmp_path):
    if not has_kinematics(host, kind):
        pytest.skip(f"the host has no {kind}")
    cfg = MACHINES[kind]
    scene = plugin_printer.read_scene(cfg, world_of(cfg, tmp_path))
    printer = start(scene)
    printer.session.require_ready()
    second = "u" if kind == "generic_cartesian" else "1"
    printer.run("G28")
    machine = printer.machine
    # Both have found their switches, and the first one is active again
    homed = {touch.site for touch in machine.truth.touches}
    assert homed == {"x_endstop", "second_endstop", "y_endstop", "nozzle_bed"}
    assert machine.tip(1).x == pytest.approx(260, abs=2 * X_STEP)
    printer.run("G1 X60 Y80 Z5 F6000\nPROBE")
    first, first_z = machine.truth.touches[-1], z_of(printer)
    printer.run(
        f"G1 Z5\nG1 X-40 F6000\nSET_DUAL_CARRIAGE CARRIAGE={second}\n"
        "G1 X60 F6000\nPROBE"
    )
    other, other_z = machine.truth.touches[-1], z_of(printer)
    assert (first.site, other.site) == ("nozzle_bed", "second_nozzle_bed")
    wanted = {"nozzle_bed": (60, 80), "second_nozzle_bed": (60, 80 + DY)}
    for touch in (first, other):
        assert (touch.x, touch.y) == pytest.approx(
            wanted[touch.site], abs=2 * X_STEP
        )
        assert touch.trigger_z == pytest.approx(BED - PRESS, abs=1e-6)
    assert other_z - first_z == pytest.approx(-DZ, abs=2 * Z_STEP)
    # The first has stayed where it was left
    assert machine.tip(0).x == pytest.approx(-40, abs=2 * X_STEP)
    printer.run("G1 Z1\nM400")
    gap = machine.gap_at_zero(1.0, carriage=1)
    assert gap == pytest.approx(machine.gap_at_zero(1.0) + DZ, abs=1e-6)


def z_of(printer):
    """Klippy's Z, mm."""
    return printer.status("toolhead")["position"][2]


@pytest.mark.every_host("each has its own code for two carriages")
def test_both_move_at_once(start, machine):
    printer = start(machine).homed()
    printer.run(
        "G1 X20 Z5 F6000\nSET_DUAL_CARRIAGE CARRIAGE=1\nG1 X200 F6000\n"
        "SET_DUAL_CARRIAGE CARRIAGE=0\n"
        "SET_DUAL_CARRIAGE CARRIAGE=1 MODE=MIRROR\nG1 X50 F6000\nM400"
    )
    tips = [printer.machine.tip(carriage).x for carriage in (0, 1)]
    assert tips == pytest.approx([50, 170], abs=2 * X_STEP)


@pytest.mark.every_host("Klipper lost the second carriage before 2024-02-07")
def test_what_klippy_does_wrong_is_seen(start, host, machine):
    """It takes the second carriage to be where the first is, after a touch."""
    idex = host.directory / "base/klippy/kinematics/idex_modes.py"
    is_lost = "def get_primary_rail" not in idex.read_text()
    printer = start(machine).homed()
    printer.run(
        "G1 X-40 Z5 F6000\nSET_DUAL_CARRIAGE CARRIAGE=1\nG1 X60\nPROBE\n"
        "G1 Z5\nG1 X70\nM400"
    )
    wanted = 60 + 70 + 40 if is_lost else 70
    assert printer.machine.tip(1).x == pytest.approx(wanted, abs=2 * X_STEP)


def test_second_nozzle_in_the_bed_is_named(start, machine):
    printer = start(machine).homed()
    printer.run("G1 X-40 Z5 F6000\nSET_DUAL_CARRIAGE CARRIAGE=1")
    printer.run("G1 X110\nG1 Z0 F300\nM400")
    truth = printer.machine.truth
    with pytest.raises(CrashError) as caught:
        truth.require_no_crash()
    (crash,) = truth.crashes()
    assert str(caught.value).endswith(f"hurt:\n  {crash}")
    assert crash.site == "second_nozzle_bed"
    # The first has found the bed by pressing it
    deep = truth.deepest_in_bed()
    assert deep == pytest.approx(-DZ + PRESS, abs=2 * Z_STEP)
    assert crash.depth == pytest.approx(deep - PRESS, abs=1e-6)
    truth.forget()


def test_carriages_that_meet_are_named(start, machine):
    """Klippy is told that there is more room between them than there is."""
    printer = start(machine, {"dual_carriage": {"safe_distance": "10"}}).homed()
    printer.run("G1 X20 Z5 F6000\nSET_DUAL_CARRIAGE CARRIAGE=1\nG1 X85\nM400")
    printer.machine.truth.require_no_crash()
    printer.run("SET_DUAL_CARRIAGE CARRIAGE=0\nG1 X65 F6000\nM400")
    (crash,) = printer.machine.truth.crashes()
    assert (crash.site, crash.kind) == ("carriages", "depth")
    assert crash.depth == pytest.approx(10, abs=2 * X_STEP)
    printer.machine.truth.forget()


def test_both_files_say_that_there_are_two(tmp_path):
    world = world_of(CFG, tmp_path)
    one = CFG[: CFG.index("[dual_c")]
    with pytest.raises(WorldFileError, match=r"no \[dual_carriage\]"):
        plugin_printer.read_scene(one, world)
    begin = world.index("[second_carriage]")
    end = world.index("[[switches]]", begin)
    alone = world[:begin] + world[end:]
    with pytest.raises(WorldFileError, match="of carriages that are there"):
        plugin_printer.read_scene(CFG, alone)
    begin = alone.index('[[switches]]\nsignal = "second')
    end = alone.index("# Where", begin)
    alone = alone[:begin] + alone[end:]
    alone = alone.replace('second_endstop = "^PC4"\n', "")
    with pytest.raises(WorldFileError, match=r"\[second_carriage\] x_world_mm"):
        plugin_printer.read_scene(CFG, alone)
    # Without its section klippy has one carriage only
    left = f'leave_out_sections = ["dual_carriage"]\n{alone}'
    made = plugin_printer.read_scene(CFG, left)
    assert list(made.wiring.motors) == ["x", "y", "z"]
    across = CFG.replace("axis: x", "axis: y")
    with pytest.raises(PrinterCfgError, match="axis is 'y'"):
        plugin_printer.read_scene(across, world)
    belts = CFG.replace("cartesian", "corexy")
    with pytest.raises(PrinterCfgError, match="second carriage"):
        plugin_printer.read_scene(belts, world)
