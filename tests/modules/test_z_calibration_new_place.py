"""CALIBRATE_Z where neither Z was homed nor the nozzle has met the pin before."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault, heated
from simprinter.world import AxisSwitchSpec, NoiseSpec
from tools.kit.carrying import without_our_dock
from tools.kit.cases import slow
from tools.kit.dockable_probe import SENSED, SWITCH, trips, where
from tools.kit.docks import calibrating
from tools.kit.klipper_sections import TOOL, bed_mesh
from tools.kit.scenes import SCENES, servo
from tools.kit.z_calibration import (
    MICROSTEP,
    assert_unharmed,
    calibration,
    section,
)

DOCK = calibrating(SWITCH)
OVER_BED = "CALIBRATE_Z NOZZLE_POSITION=150,150"
# Still on the pin, which is at 206, 306
BESIDE = "CALIBRATE_Z NOZZLE_POSITION=207.5,306"
BY_HOOKS = {
    "z_calibration": {
        "start_gcode": "ATTACH_PROBE",
        "end_gcode": "DETACH_PROBE",
    }
}
MET = "the probe is on the toolhead, and has touched the bed at z="
ON_PIN = "check that the pin is at"


# Over the bed


@pytest.mark.parametrize(
    "command",
    ["CALIBRATE_Z", slow("PROBE_Z_ACCURACY"), slow("Z_CALIBRATION_WAIT")],
)
def test_probe_that_is_on_the_head(start, command):
    printer = start().homed()
    text = printer.fail(f"{command} NOZZLE_POSITION=150,150")
    assert f"nozzle: {MET}" in text
    assert f"{ON_PIN} NOZZLE_POSITION" in text
    assert_unharmed(printer)


@pytest.mark.parametrize("is_put_on", [True, slow(False)])
def test_probe_of_a_dock(start, is_put_on):
    printer = start(DOCK, BY_HOOKS if is_put_on else {}).homed()
    text = printer.fail(OVER_BED)
    told = MET if is_put_on else "nozzle: the switch did not answer"
    assert told in text
    printer.machine.truth.require_no_crash()
    assert where(printer) == "docked"


# Nobody knows how high it is, and position_min is 5 mm below the bed
@pytest.mark.slow
@pytest.mark.parametrize("is_on_head", [True, False])
def test_pin_of_its_own(start, is_on_head):
    changes = {"bed_mesh": bed_mesh("30, 30", "270, 240")}
    if not is_on_head:
        changes.update(section(before_switch_gcode="G4 P1"))
    printer = start("separate_pin", changes).homed()
    if not is_on_head:
        printer.run("G1 Z30 F600\nM400")
        machine = printer.machine
        now = machine.rig.seconds(machine.simulation.clock.now())
        machine.world.take_probe_off(now)
        machine.tolerate("nozzle_bed", 1.01)
    # Where Z was homed, with the probe
    text = printer.fail("CALIBRATE_Z NOZZLE_POSITION=152,125.25")
    if is_on_head:
        assert f"{ON_PIN} NOZZLE_POSITION" in text
    else:
        assert "did not answer (stopped at z=-1.000)" in text
    assert_unharmed(printer)


@pytest.mark.slow
def test_pin_of_its_own_where_z_is_homed_on_another_switch(start):
    scene = SCENES["separate_pin"]
    inputs = {**scene.wiring.inputs, "z_endstop": "^PC6"}
    scene = replace(scene, wiring=replace(scene.wiring, inputs=inputs))
    top = AxisSwitchSpec("z_endstop", "z", 120.4, 1)
    scene = scene.with_world(switches=(*scene.world.switches, top))
    changes = {
        "stepper_z": {
            "endstop_pin": "^PC6",
            "position_endstop": "120",
            "position_max": "120",
        },
        "safe_z_home": {"home_xy_position": "152, 125.25"},
        **section(nozzle_xy_position="152, 125.25"),
    }
    printer = start(scene, changes).homed()
    text = printer.fail("CALIBRATE_Z")
    assert f"{ON_PIN} nozzle_xy_position" in text
    assert_unharmed(printer)


# Where the body is over the pin, and not the nozzle
@pytest.mark.parametrize(
    "place", ["208, 281.25", slow("211.5, 281.25"), slow("206, 281")]
)
@pytest.mark.parametrize("is_docked", [True, slow(False)])
def test_places_that_are_exchanged(start, place, is_docked):
    changes = BY_HOOKS if is_docked else {}
    printer = start(DOCK if is_docked else "voron", changes).homed()
    printer.machine.tolerate("body_pin", 0.1)
    printer.fail(f"CALIBRATE_Z NOZZLE_POSITION={place}".replace(", ", ","))
    printer.machine.truth.require_no_crash()


# The pin is there, but so is a bed below the probe: Z was homed without it
@pytest.mark.parametrize("command", ["CALIBRATE_Z", slow("PROBE_Z_ACCURACY")])
def test_start_gcode_where_before_switch_gcode_is_needed(start, command):
    scene = SCENES["cartesian"]
    probe = replace(scene.world.mag_probe, body_drop=6.0)
    changes = {
        "probe": {"z_offset": "6.7"},
        **section(before_switch_gcode=None, start_gcode="ATTACH_PROBE"),
    }
    printer = start(scene.with_world(mag_probe=probe), changes).homed()
    if command == "PROBE_Z_ACCURACY":
        # Without it the nozzle meets the pin, which proves nothing
        printer.run(f"{command}\nATTACH_PROBE")
    text = printer.fail(command)
    assert MET in text
    assert text.endswith("or attach the probe later, in before_switch_gcode")
    printer.machine.truth.require_no_crash()
    # As it says
    changes.update(section(start_gcode=None))
    printer = start(scene.with_world(mag_probe=probe), changes).homed()
    calibration(printer)


# With a pin that is lower than the bed
@pytest.mark.slow
def test_body_over_the_bed(start):
    scene = SCENES["voron"]
    low = replace(scene.world.pin, z=-2.6988)
    changes = {
        "stepper_z": {"position_endstop": "-3", "position_min": "-6"},
        "bed_mesh": bed_mesh("30, 30", "270, 240"),
        **section(switch_xy_position="150, 200"),
    }
    printer = start(scene.with_world(pin=low), changes).homed()
    printer.machine.tolerate("body_bed", 1.1)
    assert "switch: " in printer.fail("CALIBRATE_Z")


# Over the pin: nothing is refused


@pytest.mark.slow
@pytest.mark.every_host("only Kalico has a dockable_probe")
@pytest.mark.parametrize("auto", ["True", slow("False")])
def test_dock_that_the_host_has(start, host, auto):
    if host.name != "kalico":
        pytest.skip("only Kalico has one")
    changes = {**BY_HOOKS, "dockable_probe": {"auto_attach_detach": auto}}
    printer = start(DOCK, changes, modules=without_our_dock()).homed()
    calibration(printer, BESIDE)
    assert trips(printer) == ["attach", "dock"]


# In the dock it reads as it does on the toolhead
@pytest.mark.slow
def test_switch_in_a_dock_that_is_normally_open(start):
    probe = replace(SENSED.world.mag_probe, normally_open=True)
    sensed = SENSED.with_world(mag_probe=probe)
    inputs = {**sensed.wiring.inputs, "z_endstop": "^PC2"}
    on_pin = replace(sensed, wiring=replace(sensed.wiring, inputs=inputs))
    scene = calibrating(on_pin.with_world(pin=SWITCH.world.pin))
    changes = {
        "stepper_z": dict(SWITCH.sections["stepper_z"]),
        "safe_z_home": SWITCH.sections["safe_z_home"],
        "dockable_probe": {"check_open_attach": None},
    }
    calibration(start(scene, changes).homed(), BESIDE)


# One on a servo, which reads attached all the time
@pytest.mark.slow
@pytest.mark.every_host(
    "hosts differ in when a session ends, and with it deactivate_gcode"
)
def test_probe_that_is_put_away_after_each_session(start):
    scene = servo(normally_open=True)
    turn = "\n  SET_PIN PIN=probe_magnet VALUE=%d\n  G4 P300"
    pin = {"pin": "PD0", "value": "0", "shutdown_value": "0"}
    changes = {
        "output_pin probe_magnet": pin,
        "gcode_macro ON": {"gcode": turn % 1},
        "gcode_macro OFF": {"gcode": turn % 0},
        "probe": {"activate_gcode": "ON", "deactivate_gcode": "OFF"},
        **section(start_gcode="ON", end_gcode="OFF"),
    }
    calibration(start(scene, changes).homed(), BESIDE)


@pytest.mark.slow
def test_switch_that_opens_late(start):
    scene = SCENES["separate_pin"]
    pin = replace(scene.world.pin, noise=NoiseSpec(hysteresis=0.7))
    printer = start(scene.with_world(pin=pin), section(samples="auto")).homed()
    calibration(printer)


def test_longer_nozzle_below_a_probe_that_is_always_attached(start):
    """It is on the pin already where the way down that the probe ends is over."""
    changes = section(before_switch_gcode="M400")
    printer = start("separate_pin", changes).homed()
    calibration(printer)
    printer.run("G1 Z50 F600\nM400")
    printer.machine.world.exchange_nozzle(0.7)
    printer.machine.tolerate("nozzle_pin", 0.21)
    calibration(printer)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)


# A tool whose nozzle is 2 mm longer, and which stands elsewhere
@pytest.mark.slow
@pytest.mark.parametrize("scene", ["voron", slow("separate_pin")])
def test_longer_tool(start, tmp_path, scene):
    heat = tmp_path / "temp"
    heat.write_text("20000")
    tool = {"extruder1": {**TOOL, "sensor_path": str(heat)}}
    changes = {**section(offset_margins="-4, 4"), **tool}
    printer = start(heated(SCENES[scene]), changes).homed()
    calibration(printer)
    printer.run("G1 Z50 F600\nM400\nACTIVATE_EXTRUDER EXTRUDER=extruder1")
    printer.machine.world.exchange_nozzle(2.0)
    calibration(printer, BESIDE)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)
    # Neither tool is another one from now on
    for name, longer in (("extruder", 0.0), ("extruder1", 2.0)):
        printer.run(f"G1 Z50 F600\nM400\nACTIVATE_EXTRUDER EXTRUDER={name}")
        printer.machine.world.exchange_nozzle(longer)
        calibration(printer, BESIDE)
        warnings = "".join(printer.status("z_calibration")["warnings"])
        assert "switch - nozzle" not in warnings


# Once the pin was met its height is known, and what is dead ends there
@pytest.mark.slow
def test_pin_that_is_dead_once_it_was_met(start):
    scene = SCENES["separate_pin"]
    deep = replace(scene.world.pin, pin_travel=8.0)
    about = {"site": "nozzle_pin", "touch": 2, "command": "CALIBRATE_Z"}
    fault = Fault("trigger_never", **about)
    printer = start(scene.with_world(pin=deep), faults=[fault]).homed()
    printer.machine.tolerate("nozzle_pin", 1.01)
    text = printer.fail("CALIBRATE_Z")
    assert "did not answer (stopped at z=0.4" in text
    assert_unharmed(printer)
