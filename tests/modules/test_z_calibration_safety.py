"""What [z_calibration] does when something is wrong: nothing gets hurt."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault
from simprinter.world import DriftSpec
from tools.kit.cases import slow
from tools.kit.printer import Printer, has_kinematics
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    BODY,
    MICROSTEP,
    PIN,
    SWITCH_OFFSET,
    assert_unharmed,
    calibration,
    result_of,
    section,
    touched_sites,
    validity,
)


def voron(**mag_probe):
    """The voron scene with another probe on it."""
    world = SCENES["voron"].world
    return SCENES["voron"].with_world(
        mag_probe=replace(world.mag_probe, **mag_probe)
    )


# A z_offset that is wrong

LOOKING = "looking at the bed how long the probe is"


@pytest.mark.parametrize(
    ("body", "z_offset"),
    [
        # Never measured: nothing, less than nothing, the template's
        (6.415, "0"),
        slow(6.415, "-1.1"),
        slow(5.2, "0.096"),
        # Twice that is a height to travel at, or no more
        slow(6.415, "1.5"),
        slow(4.9, "6.9"),
        # Much too long: the switch is looked for too high up at first
        slow(5.2, "9.04"),
        (5.2, "20"),
        (8.9, "6.42"),
        slow(6.415, "2.0"),
    ],
)
def test_wrong_z_offset_does_not_matter(start, body, z_offset):
    changes = {"probe": {"z_offset": z_offset}}
    printer = start(voron(body_drop=body), changes=changes).homed()
    lines = printer.run("CALIBRATE_Z")
    result = result_of(lines)
    assert result[1] == pytest.approx(PIN + body, abs=2 * MICROSTEP)
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)
    truth = printer.machine.truth
    assert truth.drag("body_pin") == truth.drag("probe_bed") == 0.0
    if float(z_offset) > body + 1.0 + SWITCH_OFFSET:
        # Why, and before that what may be wrong
        (look,) = [n for n, line in enumerate(lines) if LOOKING in line]
        assert "z_offset in section 'probe'" in lines[look - 1]
    # The second run knows
    before = len(printer.session.console)
    calibration(printer)
    assert LOOKING not in "\n".join(printer.session.console[before:])


@pytest.mark.parametrize(("touch", "looks"), [(1, True), (3, False)])
def test_dead_switch_with_a_z_offset_that_is_right(start, touch, looks):
    # It is not the z_offset: the bed agrees with it, or the body was there
    fault = Fault(
        "stuck_open", site="body_pin", touch=touch, command="CALIBRATE_Z"
    )
    printer = start(faults=[fault])
    printer.machine.tolerate("body_pin", 1.0)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "switch: the switch did not answer" in text
    assert f"(stopped at z={PIN + 6.9 - SWITCH_OFFSET - 1.0:.3f})" in text
    console = "\n".join(printer.session.console)
    assert (LOOKING in console) == looks
    assert touched_sites(printer).count("probe_bed") == looks
    assert printer.machine.truth.min_gap > 5.0
    assert_unharmed(printer)


@pytest.mark.parametrize(
    ("margins", "words"),
    [("-7,7", "bed: No trigger"), ("-5,22", "below z=23.000")],
)
def test_bed_that_says_nothing_about_the_probe(start, margins, words):
    # With these margins the nozzle might be on the bed before the probe
    changes = {
        "probe": {"z_offset": "0"},
        **section(offset_margins=margins),
    }
    lines = start(changes=changes).homed().run("CALIBRATE_Z")
    told = [line for line in lines if "searching for the switch down" in line]
    assert len(told) == 1
    # The line before it
    assert words in lines[lines.index(told[0]) - 1]
    assert result_of(lines)[1] == pytest.approx(PIN + BODY, abs=0.005)


@pytest.mark.parametrize("z_offset", ["0", "6.9"])
def test_switch_position_over_the_bed(start, z_offset):
    changes = {
        "probe": {"z_offset": z_offset},
        **section(switch_xy_position="150, 200"),
    }
    printer = start(changes=changes)
    printer.machine.tolerate("body_bed", 1.0)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "switch: " in text
    assert "check switch_xy_position" in text
    assert printer.machine.truth.min_gap > 5.0
    assert_unharmed(printer)


def test_plunger_pressed_at_the_switch_is_told(start):
    # The bed lies higher than the floor there
    changes = {
        "probe": {"z_offset": "5.5"},
        **section(switch_xy_position="150, 200"),
    }
    printer = start(changes=changes)
    printer.machine.tolerate("body_bed", 1.5)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "switch: the plunger of the probe was pressed" in text
    assert "check switch_xy_position" in text
    assert printer.session.state()[0] == "ready"


# Geometry that changes between two runs


def warnings(printer):
    """What the last run that was applied was warned of."""
    found = printer.status("z_calibration")["warnings"]
    console = "\n".join(printer.session.console)
    assert all(f"// z_calibration: {text}" in console for text in found)
    return found


@pytest.mark.parametrize(
    ("between", "start_gcode"),
    [("", ""), ("", "G28 Z")],
)
def test_jump_of_the_geometry_is_told(start, between, start_gcode):
    # Lifted by more than it triggers too early
    options = {"start_gcode": start_gcode, "probing_retract_dist": "3"}
    printer = start(changes=section(**options)).homed()
    calibration(printer)
    # The pin is reached 0.7 mm early by another body
    body_triggers_early(printer, 0.7)
    printer.run(between)
    (_, switch, *_, offset), _ = calibration(printer)
    assert switch == pytest.approx(PIN + BODY + 0.7, abs=0.01)
    assert printer.offset() == pytest.approx(offset, abs=1e-6)
    (told,) = warnings(printer)
    assert "switch - nozzle is 7.115 mm and was 6.415 mm in the last" in told
    assert "check how the probe is seated" in told
    if not start_gcode and not between:
        # Back again, and as it was
        calibration(printer)
        assert len(warnings(printer)) == 1
        calibration(printer)
        assert warnings(printer) == []
        # A small change is none
        body_triggers_early(printer, 0.4)
        calibration(printer)
        assert warnings(printer) == []


def body_triggers_early(printer, mm):
    """At each touch of the switch in the next calibration."""
    for touch in (1, 2, 3):
        printer.machine.break_down(
            Fault(
                "trigger_early",
                site="body_pin",
                touch=touch,
                command="CALIBRATE_Z",
                mm=mm,
            )
        )


@pytest.mark.slow
@pytest.mark.parametrize("longer", [0.7, 1.5])
def test_longer_nozzle_without_homing(start, longer):
    # The body is that much lower, below what the last run lets expect
    drift = DriftSpec(nozzle=0.1, start=100.0, stop=100.0 + 10 * longer)
    changes = section(offset_margins="-2,2")
    scene = SCENES["voron"].with_world(drift=drift)
    printer = start(scene, changes=changes)
    printer.machine.tolerate("body_pin", 1.0)
    calibration(printer.homed())
    printer.session.wait(120.0)
    calibration(printer)
    nozzle, body = warnings(printer)
    assert f"nozzle: z={PIN + longer:.3f} is far from position_end" in nozzle
    assert f"switch - nozzle is {BODY - longer:.3f} mm and was 6.4" in body
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)


# Z that has moved since it was homed


def shifted(height):
    """klippy believes that Z is so much higher (mm) than it was homed."""
    return (
        "{% set z = printer.toolhead.position.z %}"
        "SET_KINEMATIC_POSITION Z={z + " + str(height) + "}"
    )


def stale(start, height, **options):
    changes = {
        "force_move": {"enable_force_move": "true"},
        "gcode_macro SHIFT": {"gcode": "\n  " + shifted(height)},
        **section(**options),
    }
    return start(changes=changes).homed()


@pytest.mark.parametrize("height", [0.6, -0.6, 0.4])
def test_nozzle_far_from_where_z_was_homed_is_told(start, height):
    printer = stale(start, height, offset_margins="-2,2")
    lines = printer.run("SHIFT\nCALIBRATE_Z")
    told = [line for line in lines if "is far from position_endstop" in line]
    if height == 0.4:
        assert told == warnings(printer) == []
        return
    assert f"nozzle: z={PIN + height:.3f} is far from" in told[0]
    assert "home Z again (G28 Z) after any levelling" in told[0]
    assert warnings(printer) == [told[0].partition("z_calibration: ")[2]]


# Macros bring this probe, for the switch, and here somebody has brought it before; what
# its switch reads then is no proof, as one that is normally open reads so, too
def test_probe_that_is_left_on_meets_the_bed_without_harm(start):
    printer = start("cartesian").homed()
    text = printer.fail("ATTACH_PROBE\nCALIBRATE_Z")
    assert (
        "the probe is on the toolhead, and has touched the bed at z=2.0" in text
    )
    printer.machine.truth.require_no_crash()
    # Once it is off all goes on
    printer.run("DOCK_PROBE\nG28\nCALIBRATE_Z")


# Validity


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ("G28 X Y", ""),
        slow("G1 X150 Y120 Z20 F6000\nPROBE_ACCURACY SAMPLES=20\nG1 Z20", ""),
        ("M84", "the motors were turned off"),
        slow("M84\nG28", "Z was homed again"),
        (
            "SET_STEPPER_ENABLE STEPPER=stepper_z2 ENABLE=0",
            "the motors were turned off",
        ),
        ("SHIFT", "Z was homed again or set"),
    ],
)
def test_result_is_valid_until_z_moves(start, script, reason):
    printer = stale(start, 0.05)
    assert validity(printer) == (False, False, "not calibrated yet")
    calibration(printer)
    assert validity(printer) == (True, True, "")
    printer.run(script)
    assert validity(printer) == (not reason, not reason, reason)
    # The result itself stays, and a new one holds again
    assert printer.status("z_calibration")["last_query"] is True
    if "M84" not in script or "G28" in script:
        calibration(printer, "G28\nCALIBRATE_Z" if reason else "CALIBRATE_Z")
        assert validity(printer) == (True, True, "")


@pytest.mark.slow
@pytest.mark.every_host("hosts before 2024-12 know nothing of the parameter")
@pytest.mark.parametrize("word", ["CLEAR", "CLEAR_HOMED"])
def test_result_is_not_valid_where_nobody_knows_z(start, word):
    printer = stale(start, 0.05)
    calibration(printer)
    printer.run(f"SET_KINEMATIC_POSITION {word}=Z")
    if "z" in printer.status("toolhead")["homed_axes"]:
        pytest.skip(f"the host has no {word}")
    assert validity(printer) == (False, False, "Z is not homed")


LEVEL = {
    "quad_gantry_level": {
        "gantry_corners": "\n  -60,-10\n  360,370",
        "points": "\n  50,25\n  50,225\n  250,225\n  250,25",
        "speed": "100",
        "horizontal_move_z": "15",
        "retries": "5",
        "retry_tolerance": "0.02",
        "max_adjust": "10",
    }
}


@pytest.mark.parametrize("option", ["start_gcode", "end_gcode"])
def test_motors_off_in_gcode_is_said_of_it(start, option):
    """The owner has homed, so that G28 is no advice."""
    code = SCENES["voron"].sections["z_calibration"].get(option, "")
    printer = start(changes=section(**{option: f"{code}\n  M84"})).homed()
    printer.run("SET_GCODE_OFFSET Z=0.2")
    text = printer.fail("CALIBRATE_Z")
    assert f"not homed any more after {option}: X, Y, Z; take M84" in text
    assert "G28" not in text
    assert printer.status("z_calibration")["last_query"] is False
    assert printer.offset() == pytest.approx(0.2)


def test_levelling_in_end_gcode_is_an_error(start):
    bed = replace(SCENES["voron"].world.bed, slope_x=0.001, slope_y=-0.0008)
    changes = {**LEVEL, **section(end_gcode="QUAD_GANTRY_LEVEL")}
    tilted = SCENES["voron"].with_world(bed=bed)
    printer = start(tilted, changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.3")
    text = printer.fail("CALIBRATE_Z")
    assert "the Z motors were levelled in end_gcode" in text
    assert "do it before CALIBRATE_Z" in text
    assert printer.offset() == pytest.approx(0.3)


def test_homing_with_the_probe_ends_validity(start):
    # Not every host sends an event for it
    noisy = replace(
        SCENES["separate_pin"].world.mag_probe,
        noise=replace(
            SCENES["separate_pin"].world.mag_probe.noise,
            outlier_chance=0.0,
            sigma=0.0,
        ),
    )
    scene = SCENES["separate_pin"].with_world(mag_probe=noisy)
    # It comes back to exactly where it was
    printer = start(scene).homed()
    calibration(printer)
    assert validity(printer) == (True, True, "")
    printer.run("G28 Z")
    assert validity(printer)[:2] == (False, False)
    assert "Z was homed again" in validity(printer)[2]


# Status while it runs


def test_phases_in_order_and_progress(start):
    where = "{printer.z_calibration.phase}:{printer.z_calibration.progress}"
    changes = {
        "respond": {},
        **{
            f"gcode_macro {name}": {"gcode": f"\n  RESPOND MSG='at {where}'"}
            for name in ("FIRST", "SECOND", "LAST")
        },
        **section(
            start_gcode="FIRST",
            before_switch_gcode="SECOND\n  ATTACH_PROBE",
            end_gcode="LAST\n  DOCK_PROBE",
        ),
    }
    printer = start("cartesian", changes=changes).homed()
    lines = printer.run("CALIBRATE_Z")
    words = [
        "echo: at start_gcode:0.0",
        "nozzle at z=",
        # Two samples each
        f"echo: at before_switch_gcode:{2 / 6}",
        "switch at z=",
        "bed at z=",
        "echo: at end_gcode:1.0",
        "Z-CALIBRATION: probe=",
    ]
    found = [word for line in lines for word in words if word in line]
    assert found == words
    assert sum("echo: at" in line for line in lines) == 3
    status = printer.status("z_calibration")
    assert (status["phase"], status["progress"]) == ("idle", 0.0)


def test_pin_of_its_own_has_no_place_to_fall_back_to(start):
    # [safe_z_home] is where the probe homes, over the bed
    printer = start("separate_pin", changes=section(nozzle_xy_position=None))
    printer.homed()
    before = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert "no place for the nozzle; run Z_CALIBRATION_SETUP" in text
    assert len(printer.machine.truth.touches) == before
    calibration(printer, "CALIBRATE_Z NOZZLE_POSITION=206,306")


# Every kind of machine


@pytest.mark.slow
@pytest.mark.parametrize(
    "scene",
    [
        "voron_two_boards",
        slow("hybrid"),
        "corexz",
        pytest.param(
            "generic", marks=pytest.mark.every_host("few hosts have it")
        ),
    ],
)
def test_gap_on_other_machines(host, scene):
    if not has_kinematics(host, SCENES[scene]):
        pytest.skip(f"{host.name} has no kinematics of {scene}")
    with Printer(host, scene) as printer:
        printer.homed()
        for _ in range(2):
            calibration(printer)
            gap = printer.gap()
            # The microsteps of corexz are 0.0031 mm
            assert gap == pytest.approx(0.06, abs=2 * MICROSTEP)
        assert validity(printer) == (True, True, "")


RUNS = 15


def finer(scene):
    """The machine with half the microstep in Z: 1.25 um.

    A trigger is seen at the step after it, so each height is half a step low.
    """
    motors = {
        name: replace(motor, step_dist=motor.step_dist / 2)
        if name.startswith("z")
        else motor
        for name, motor in scene.wiring.motors.items()
    }
    sections = {
        name: {**options, "microsteps": "32"}
        if name.startswith("stepper_z")
        else options
        for name, options in scene.sections.items()
    }
    wiring = replace(scene.wiring, motors=motors)
    return replace(scene, wiring=wiring, sections=sections)


@pytest.mark.slow
def test_noise_leaves_a_small_mean_error(host):
    """Sigma 3 um on pin and probe, median of 3, 15 runs: the true gap."""
    scene = SCENES["voron"]
    pin, probe = scene.world.pin, scene.world.mag_probe
    noisy = scene.with_world(
        pin=replace(pin, noise=replace(pin.noise, sigma=0.003)),
        mag_probe=replace(probe, noise=replace(probe.noise, sigma=0.003)),
    )
    changes = {"probe": {"samples_tolerance": "0.03"}}
    with Printer(host, finer(noisy), changes, seed=1) as printer:
        printer.homed()
        offsets = [calibration(printer)[0][-1] for _ in range(RUNS)]
        # One look from outside: the frame is the same for all of them
        gap = printer.gap()
    errors = [gap + z - offsets[-1] - noisy.formula_gap() for z in offsets]
    assert abs(sum(errors) / RUNS) < 0.0015
    assert 0.001 < max(map(abs, errors)) < 0.015
