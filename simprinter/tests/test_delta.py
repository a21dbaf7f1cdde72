"""A delta: its towers, their switches, and what real klippy finds with a probe."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter import plugin_printer, printer_cfg, world_file
from simprinter.printer_cfg import PrinterCfgError
from simprinter.running import SAMPLE
from simprinter.world import Pose, SpecError, TowerSpec, make_kinematics
from simprinter.world_file import WorldFileError

CFG = """
[mcu]
[printer]
kinematics: delta
max_velocity: 300
max_accel: 3000
max_z_velocity: 150
delta_radius: 140
print_radius: 110
minimum_z_position: -5
[stepper_a]
step_pin: PA0
dir_pin: PA1
microsteps: 16
rotation_distance: 40
endstop_pin: ^PC0
homing_retract_dist: 0
homing_speed: 50
position_endstop: 250
arm_length: 300
[stepper_b]
step_pin: PA3
dir_pin: !PA4
microsteps: 16
rotation_distance: 40
endstop_pin: ^PC1
homing_retract_dist: 0
[stepper_c]
step_pin: PB0
dir_pin: PB1
microsteps: 16
rotation_distance: 40
endstop_pin: ^PC2
homing_retract_dist: 0
[probe]
pin: ^PC3
x_offset: 0
y_offset: 0
z_offset: 1.5
speed: 5
lift_speed: 20
samples: 1
[delta_calibrate]
radius: 80
speed: 100
horizontal_move_z: 10
"""
# Half a microstep of the carriages moves the head so far (mm) at the most
STEP = 0.0125


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The world file that the printer.cfg above makes."""
    file = tmp_path_factory.mktemp("delta") / "printer.cfg"
    file.write_text(CFG)
    return world_file.made_from(printer_cfg.read(file))


@pytest.fixture
def machine(made):
    """The machine as both files tell."""
    return plugin_printer.read_scene(CFG, made)


INSIDE = st.floats(-75, 75)


@given(x=INSIDE, y=INSIDE, z=st.floats(-5, 200), off=st.floats(-2, 2))
def test_carriages_lead_back_to_the_tip(x, y, z, off):
    # Unlike each other, as they are
    towers = (
        TowerSpec("a", -121.0, -70.0, 300.0),
        TowerSpec("b", 122.0, -70.0, 301.0),
        TowerSpec("c", off, 140.0, 299.5),
    )
    kinematics = make_kinematics("delta", (), towers)
    motors = kinematics.motors((x, y, z), {})
    assert kinematics.pose(motors) == pytest.approx((x, y, z), abs=1e-8)
    lifted = {name: place + off for name, place in motors.items()}
    assert kinematics.pose(lifted) == pytest.approx((x, y, z + off), abs=1e-8)
    skewed = kinematics.motors((x, y, z - 1.0), dict.fromkeys("abc", 1.0))
    assert skewed == pytest.approx(motors, abs=1e-8)


def test_world_is_made_of_what_printer_cfg_says(machine):
    assert machine.kinematics == "delta"
    assert list(machine.wiring.motors) == ["a", "b", "c"]
    assert machine.start == Pose(0, 0, 240)
    a, b, c = machine.world.towers
    assert (a.x, a.y) == pytest.approx((-121.2436, -70), abs=1e-4)
    assert (b.x, c.y, c.arm) == pytest.approx((121.2436, 140, 300), abs=1e-4)
    ends = [(s.signal, s.axis, s.position) for s in machine.world.switches]
    assert ends == [(f"{name}_endstop", name, 250) for name in "abc"]
    assert machine.world.bed.x_min == -110


TOWERS = """
[[towers]]
name = "a"
x_world_mm = -120
y_world_mm = -70
arm_mm = 299
[[towers]]
name = "b"
x_world_mm = 120
y_world_mm = -70
arm_mm = 300
[[towers]]
name = "c"
x_world_mm = 0
y_world_mm = 140
arm_mm = 300
"""


def test_towers_may_stand_otherwise_than_printer_cfg_says(made):
    scene = plugin_printer.read_scene(CFG, made + TOWERS)
    assert scene.world.towers[0] == TowerSpec("a", -120, -70, 299)
    turned = CFG.replace("[stepper_b]", "[stepper_b]\nangle: 0")
    (_, tower, _) = plugin_printer.read_scene(turned, made).world.towers
    assert (tower.x, tower.y) == pytest.approx((140, 0))
    short = CFG.replace("arm_length: 300", "arm_length: 140")
    with pytest.raises(PrinterCfgError, match="arm_length is '140'"):
        plugin_printer.read_scene(short, made)
    with pytest.raises(WorldFileError, match="arm_mm = 138: must be longer"):
        plugin_printer.read_scene(CFG, made + TOWERS.replace("= 299", "= 138"))
    with pytest.raises(WorldFileError, match="must be none, or"):
        plugin_printer.read_scene(CFG, made + TOWERS[: TOWERS.rindex("[[")])
    with pytest.raises(WorldFileError, match="the axes a, b, c"):
        plugin_printer.read_scene(CFG, made.replace('"b"\n', '"y"\n'))
    line = [replace(t, y=0.0) for t in scene.world.towers]
    with pytest.raises(SpecError, match="triangle"):
        replace(scene.world, towers=tuple(line))


def test_towers_are_of_a_delta_only():
    cfg, world = SAMPLE / "printer.cfg", (SAMPLE / "world.toml").read_text()
    with pytest.raises(WorldFileError, match="kinematics is cartesian"):
        plugin_printer.read_scene(cfg, world + TOWERS)
    with pytest.raises(WorldFileError, match="the axes x, y, z"):
        plugin_printer.read_scene(cfg, world.replace('"y"\n', '"b"\n'))


def test_all_carriages_are_homed_and_the_head_goes_where_it_is_sent(
    start, machine
):
    # As they hang when it is switched on
    skewed = replace(machine, z_skew={"a": 1.0, "c": -2.0})
    printer = start(skewed)
    printer.session.require_ready()
    printer.run("G28\nM400")
    truth = printer.machine.truth
    assert {t.site for t in truth.touches} == {f"{n}_endstop" for n in "abc"}
    assert printer.machine.tip() == pytest.approx((0, 0, 250), abs=2 * STEP)
    for x, y, z in ((60, 40, 100), (-80, 10, 20), (0, -100, 5)):
        printer.run(f"G1 X{x} Y{y} Z{z} F9000\nM400")
        printer.session.wait(1.0)
        assert printer.machine.tip() == pytest.approx((x, y, z), abs=2 * STEP)


def probed(printer, x, y):
    """Klippy's Z (mm) at which the probe triggers there."""
    printer.run(f"G90\nG1 Z15 F3000\nG1 X{x} Y{y} F9000\nPROBE")
    return printer.status("toolhead")["position"][2]


PLACES = ((0, 0), (-70, -40), (70, -40), (0, 80))


def test_probe_meets_the_bed_of_a_machine_that_is_as_klippy_believes(
    start, machine
):
    bed = replace(machine.world.bed, z0=-0.3, slope_x=0.002)
    printer = start(machine.with_world(bed=bed)).homed()
    seen = [probed(printer, x, y) for x, y in PLACES]
    wanted = [1.5 - 0.3 + 0.002 * x for x, _ in PLACES]
    assert seen == pytest.approx(wanted, abs=2 * STEP)


def test_delta_calibrate_finds_a_switch_that_is_elsewhere(start, machine):
    """One switch is 0.6 mm higher and another 0.4 mm lower than is believed."""
    a, b, c = machine.world.switches
    switches = (
        replace(a, position=250.6),
        b,
        replace(c, position=249.6),
    )
    printer = start(machine.with_world(switches=switches)).homed()
    before = [probed(printer, x, y) for x, y in PLACES]
    assert max(before) - min(before) > 0.5
    printer.run("DELTA_CALIBRATE METHOD=automatic")
    printer.session.restart("SAVE_CONFIG")
    printer.session.require_ready()
    printer.run("G28")
    after = [probed(printer, x, y) for x, y in PLACES]
    assert after == pytest.approx([1.5] * len(PLACES), abs=2 * STEP)
