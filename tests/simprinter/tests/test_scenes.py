"""Every scene is a whole machine on which real klippy homes and measures."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.hostkit.printer import Printer, has_kinematics
from tests.simprinter import SCENES, Fault, heated
from tests.simprinter.world import Bed

CALIBRATING = [n for n in SCENES if "z_calibration" in SCENES[n].sections]
PIEZO = [n for n in SCENES if "auto_z_offset" in SCENES[n].sections]
# The driver's section of each Z motor
DRIVERS = {
    "qidi_two_boards": ("stepper_z", "stepper_z1"),
    "piezo_generic": ("stepper left_z", "stepper right_z"),
}
MICROSTEP = 0.0025
# Klippy retries a register's write so often
ATTEMPTS = 5


def ready(start, host, scene, **options):
    """A printer, or a skipped test where the host cannot have it."""
    if not has_kinematics(host, scene):
        kinematics = scene.sections["printer"]["kinematics"]
        pytest.skip(f"{host.name} has no {kinematics}")
    return start(scene, **options)


def microstep(printer):
    """What one microstep of a Z motor moves, mm."""
    return printer.scene.wiring.motors["z"].step_dist


def require_z_level(printer):
    """All Z motors were stopped at once, and no command was late."""
    printer.session.wait(0.5)
    travel = printer.machine.rig.travel(printer.machine.simulation.clock.now())
    heights = [travel[motor] for motor, _, _ in printer.scene.z_motors]
    assert max(heights) - min(heights) == pytest.approx(0.0, abs=1e-9)
    for board in printer.machine.boards.values():
        assert board.journal.late == []


@pytest.mark.parametrize("name", SCENES)
def test_wiring_and_configuration_name_the_same_pins(name):
    scene = heated(SCENES[name])
    assert scene.name == name
    written = [
        value
        for options in scene.sections.values()
        for key, value in (options or {}).items()
        if key.endswith("pin")
    ]
    wired = [
        *scene.wiring.inputs.values(),
        *scene.wiring.outputs.values(),
        *(heater.pin for heater in scene.wiring.heaters.values()),
        *(pin for m in scene.wiring.motors.values() for pin in m.pins()),
    ]
    assert set(wired) <= set(written)
    assert len(set(written)) == len(written)


@pytest.mark.spread
@pytest.mark.parametrize("name", CALIBRATING)
def test_calibration_ends_at_the_gap_of_the_formula(start, host, name):
    printer = ready(start, host, SCENES[name]).homed()
    require_z_level(printer)
    wanted = printer.scene.formula_gap()
    # It would be no wonder otherwise
    assert abs(printer.gap() - wanted) > 10 * microstep(printer)
    printer.run("CALIBRATE_Z\nG1 X150 Y150 Z20 F3000\nM400")
    printer.session.wait(0.5)
    # Half a belt that ran on would carry the head aside as well as down
    assert printer.machine.tip().x == pytest.approx(150.0, abs=0.02)
    assert printer.gap() == pytest.approx(wanted, abs=2 * microstep(printer))
    samples = int(printer.scene.number("probe", "samples"))
    for site in ("nozzle_pin", "body_pin", "probe_bed"):
        assert printer.machine.truth.touch_count(site) >= samples


# z_calibration is left out where it cannot know the machine yet
def test_separate_pin_has_an_input_of_its_own(start):
    """Another section takes z_calibration's place."""
    scene = SCENES["separate_pin"]
    reader = {
        "step_pin": "PD0",
        "dir_pin": "PD1",
        "rotation_distance": "40",
        "microsteps": "16",
        "endstop_pin": scene.sections["z_calibration"]["endstop_pin"],
    }
    changes = {"z_calibration": None, "manual_stepper reader": reader}
    printer = start(scene, changes, modules={}).homed()
    # Z is homed with the probe, about whose length its owner is wrong
    probe = scene.world.mag_probe
    wanted = probe.body_drop + probe.switch_offset
    wanted -= scene.number("probe", "z_offset")
    gap = printer.gap((150.0, 150.0))
    assert gap == pytest.approx(wanted, abs=MICROSTEP)
    assert printer.machine.truth.touch_count("nozzle_pin") == 0
    pin = scene.world.pin
    trigger = pin.z - scene.world.bed.z0 - gap
    seen = []
    for height in (trigger + 0.02, trigger - 0.02, trigger + 0.02):
        printer.run(f"G1 X{pin.x} Y{pin.y} F6000\nG1 Z{height} F300\nM400")
        seen.append("reader:TRIGGERED" in printer.run("QUERY_ENDSTOPS")[-1])
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


# With a piezo bed: klippy without [auto_z_offset]


WITHOUT = {"changes": {"auto_z_offset": None}, "modules": {}}


def probed_z(printer, script="PROBE"):
    """Height a PROBE has found, klippy's frame, mm."""
    printer.run(script)
    probe = printer.status("probe")
    if "last_probe_position" in probe:
        offset = printer.scene.number("probe", "z_offset")
        return probe["last_probe_position"][2] + offset
    return probe["last_z_result"]


@pytest.mark.spread
@pytest.mark.parametrize("name", PIEZO)
def test_inductive_probe_reads_what_is_below_it(start, host, name):
    printer = ready(start, host, SCENES[name], **WITHOUT).homed()
    require_z_level(printer)
    scene, height = printer.scene, Bed(printer.scene.world.bed).height
    probe = scene.world.inductive
    truth = printer.machine.truth
    assert truth.touch_count("inductive_bed") == 2
    assert truth.touch_count("nozzle_bed") == 0
    # Homed over the middle of the axes
    gap = printer.gap((119.75, 126.75))
    wanted = probe.sense_distance - scene.number("probe", "z_offset")
    assert gap == pytest.approx(wanted, abs=MICROSTEP)
    zero = gap + height(119.75, 126.75)
    for x, y in [(10.0, 240.0), (220.0, 5.0)]:
        printer.run(f"G1 Z10 F900\nG1 X{x} Y{y} F9000\nM400")
        wanted = height(x + probe.x_offset, y + probe.y_offset) - zero
        wanted += probe.sense_distance
        assert probed_z(printer) == pytest.approx(wanted, abs=MICROSTEP)


@pytest.mark.spread
@pytest.mark.parametrize("name", PIEZO)
def test_piezo_bed_reads_where_the_scene_says(start, host, name):
    """As [probe]: deeper the faster; its motors are on the same board."""
    scene = SCENES[name]
    assert scene.piezo_depth() == pytest.approx(0.05)
    assert scene.piezo_gap() == pytest.approx(0.15)
    probe = {
        **scene.sections["probe"],
        "pin": scene.wiring.inputs["bed_sensor"],
        **dict.fromkeys(("x_offset", "y_offset", "z_offset"), "0"),
        "speed": "5",
        "samples": "1",
    }
    scene = replace(scene, sections={**scene.sections, "probe": probe})
    printer = ready(start, host, scene, **WITHOUT)
    printer.session.require_ready()
    if scene.wiring.outputs:
        printer.run("SET_PIN PIN=bed_sensor VALUE=1")
    printer.homed()
    place = (102.15, 122.35)
    homing = scene.piezo_depth(5.0)
    assert printer.gap(place) == pytest.approx(-homing, abs=MICROSTEP)
    for speed in (5.0, 10.0):
        printer.run("G1 X%g Y%g Z5 F900" % place)
        found = probed_z(printer, f"PROBE PROBE_SPEED={speed}")
        wanted = homing - scene.piezo_depth(speed)
        assert found == pytest.approx(wanted, abs=MICROSTEP)
    # Homing at 8 mm/s, the touch at 10, and no lateness of another board
    depth = printer.machine.truth.depth("nozzle_bed")
    assert depth == pytest.approx(0.002 * 10.0, abs=MICROSTEP)


def set_current(printer, section, motor, amperes):
    """Ask for a current; what the driver does once it has it, A RMS."""
    stepper = section.split()[-1]
    printer.run(f"SET_TMC_CURRENT STEPPER={stepper} CURRENT={amperes!r}")
    printer.session.wait(0.2)
    return printer.machine.drivers[motor].current()[1:]


@pytest.mark.spread
@pytest.mark.parametrize("name", DRIVERS)
def test_motor_currents_are_those_asked_for(start, host, name):
    printer = ready(start, host, SCENES[name], **WITHOUT)
    printer.session.require_ready()
    for section, motor, amperes in zip(DRIVERS[name], ("z", "z1"), (0.8, 1.07)):
        # Klippy takes the full scale for 0.32 V, the datasheet for 0.325
        current = printer.machine.drivers[motor].current().run
        assert current == pytest.approx(amperes, abs=0.04)
        current = set_current(printer, section, motor, 0.4)[0]
        assert current == pytest.approx(0.4, abs=0.02)
        status = printer.status(f"tmc2209 {section}")
        assert status["run_current"] == pytest.approx(current, abs=0.02)


@pytest.mark.spread
@pytest.mark.parametrize("tries", [ATTEMPTS - 1, ATTEMPTS, "change"])
def test_writes_to_a_driver_that_are_lost(host, tries):
    """One less than klippy's attempts is not even noticed."""
    with Printer(host, "qidi", **WITHOUT) as printer:
        printer.session.require_ready()
        # A change is lost however often klippy tries it again
        if tries == "change":
            faults = [Fault("tmc_change_lost", driver="z")]
        else:
            faults = [
                Fault("tmc_write_error", driver="z", n=n)
                for n in range(1, tries + 1)
            ]
        for fault in faults:
            printer.machine.faults.add(fault)
        driver = printer.machine.drivers["z"]
        before = driver.current()[1:]
        if tries == ATTEMPTS - 1:
            assert set_current(printer, "stepper_z", "z", 0.4) != before
        else:
            text = printer.fail("SET_TMC_CURRENT STEPPER=stepper_z CURRENT=0.4")
            assert "Unable to write tmc uart 'stepper_z'" in text
            assert driver.current()[1:] == before
        # Nothing is left to fail. Another value: Kalico takes the first one
        # for set
        before = driver.current()[1:]
        assert set_current(printer, "stepper_z", "z", 0.5) != before
        assert printer.machine.faults.unfired() == []
