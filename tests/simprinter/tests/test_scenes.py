"""Every scene is a whole machine on which real klippy homes and calibrates.

Those with a piezo bed are in test_piezo_scenes.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.hostkit.printer import has_kinematics
from tests.simprinter import SCENES, heated

CALIBRATING = [n for n in SCENES if "z_calibration" in SCENES[n].sections]


def ready(start, host, name, **options):
    """A printer, or a skipped test where the host cannot have it."""
    scene = SCENES[name]
    if not has_kinematics(host, scene):
        kinematics = scene.sections["printer"]["kinematics"]
        pytest.skip(f"{host.name} has no {kinematics}")
    return start(scene, **options)


def microstep(printer):
    """What one microstep of a Z motor moves, mm."""
    return printer.scene.wiring.motors["z"].step_dist


@pytest.mark.spread
@pytest.mark.parametrize("name", CALIBRATING)
def test_calibration_ends_at_the_gap_of_the_formula(start, host, name):
    printer = ready(start, host, name).homed()
    wanted = printer.scene.formula_gap()
    # It would be no wonder otherwise
    assert abs(printer.gap() - wanted) > 10 * microstep(printer)
    printer.run("CALIBRATE_Z")
    assert printer.gap() == pytest.approx(wanted, abs=2 * microstep(printer))
    samples = int(printer.scene.sections["probe"]["samples"])
    for site in ("nozzle_pin", "body_pin", "probe_bed"):
        assert printer.machine.truth.touch_count(site) >= samples


@pytest.mark.parametrize("name", SCENES)
def test_wiring_and_configuration_name_the_same_pins(name):
    scene = heated(SCENES[name])
    written = [
        value
        for options in scene.sections.values()
        for key, value in (options or {}).items()
        if key.endswith("pin") or key == "pin"
    ]
    wired = [
        *scene.wiring.inputs.values(),
        *scene.wiring.outputs.values(),
        *(heater.pin for heater in scene.wiring.heaters.values()),
        *(pin for m in scene.wiring.motors.values() for pin in m.pins()),
    ]
    assert set(wired) <= set(written)
    assert len(set(written)) == len(written)


@pytest.mark.parametrize("name", ["voron", "hybrid", "generic"])
def test_homing_stops_all_z_motors_at_once(start, host, name):
    printer = ready(start, host, name).homed()
    assert len(printer.scene.z_motors) in (2, 4)
    printer.session.wait(0.5)
    travel = printer.machine.rig.travel(printer.machine.simulation.clock.now())
    heights = [travel[motor] for motor, _, _ in printer.scene.z_motors]
    assert max(heights) - min(heights) == pytest.approx(0.0, abs=1e-9)
    assert max(heights) < printer.scene.start.z


def test_corexz_stops_both_belts(start):
    printer = start("corexz").homed()
    printer.session.wait(0.5)
    belief, tip = printer.session.position(), printer.machine.tip()
    # Half a belt that ran on would carry the head aside as well as down
    assert tip.x == pytest.approx(belief[0], abs=0.02)
    printer.run("CALIBRATE_Z\nG1 X150 Y150 Z20 F3000\nM400")
    printer.session.wait(0.5)
    assert printer.machine.tip().x == pytest.approx(150.0, abs=0.02)


# z_calibration is left out where it cannot know the machine yet
WITHOUT_CALIBRATION = {"modules": {}, "changes": {"z_calibration": None}}


def test_separate_pin_homes_with_its_probe(start):
    printer = start("separate_pin", **WITHOUT_CALIBRATION).homed()
    probe = printer.scene.world.mag_probe
    z_offset = float(printer.scene.sections["probe"]["z_offset"])
    # What its owner is wrong about
    wanted = probe.body_drop + probe.switch_offset - z_offset
    assert printer.gap() == pytest.approx(wanted, abs=microstep(printer))
    assert printer.machine.truth.touch_count("probe_bed") >= 2
    assert printer.machine.truth.touch_count("nozzle_pin") == 0


def test_separate_pin_reads_its_own_input(start):
    """Another section takes z_calibration's place."""
    section = SCENES["separate_pin"].sections["z_calibration"]
    anything = {
        "step_pin": "PD0",
        "dir_pin": "PD1",
        "rotation_distance": "40",
        "microsteps": "16",
        "endstop_pin": section["endstop_pin"],
    }
    changes = {"z_calibration": None, "manual_stepper reader": anything}
    printer = start("separate_pin", modules={}, changes=changes).homed()
    pin = printer.scene.world.pin
    trigger = pin.z - printer.scene.world.bed.z0 - printer.gap()
    seen = []
    for height in (trigger + 0.02, trigger - 0.02, trigger + 0.02):
        printer.run(f"G1 X{pin.x} Y{pin.y} F6000\nG1 Z{height} F300\nM400")
        line = printer.run("QUERY_ENDSTOPS")[-1]
        seen.append("reader:TRIGGERED" in line)
    assert seen == [False, True, False]


def test_kinematics_that_a_host_does_not_have(start, host):
    assert has_kinematics(host, SCENES["voron"])
    assert has_kinematics(host, SCENES["corexz"])
    sections = {**SCENES["voron"].sections, "printer": {"kinematics": "spiral"}}
    unknown = replace(SCENES["voron"], sections=sections)
    assert not has_kinematics(host, unknown)
    state, _ = start("generic").session.start()
    expected = has_kinematics(host, SCENES["generic"])
    assert state == ("ready" if expected else "error")
