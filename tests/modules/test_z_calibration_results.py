"""[z_calibration] on real klippy in front of the simulated machine."""

from __future__ import annotations

import functools
import math
import re
from dataclasses import replace

import pytest

from tests.hostkit.printer import (
    Printer,
    firmware_of,
    has_kinematics,
    module_files,
)
from tests.hostkit.session import run_batch
from tests.hostkit.z_calibration import (
    BED,
    BODY,
    MICROSTEP,
    PIN,
    RESULT,
    SWITCH_OFFSET,
    TRIGGER,
    assert_unharmed,
    calibration,
    lowest_tip,
    marked,
    refusal,
    result_of,
    section,
    touched_sites,
)
from tests.simprinter import SCENES, Fault, Machine
from tests.simprinter.world import Pose

pytestmark = pytest.mark.spread

# The measurement


@pytest.mark.quick
@pytest.mark.each_host
@pytest.mark.parametrize("scene", ["voron", "cartesian"])
def test_gap_is_what_the_formula_predicts(start, scene):
    printer = start(scene).homed()
    printer.run("CALIBRATE_Z")
    predicted = printer.scene.formula_gap()
    assert printer.gap() == pytest.approx(predicted, abs=2 * MICROSTEP)


@pytest.mark.each_host
def test_result_line_and_status_hold_the_heights(start):
    printer = start()
    printer.session.require_ready()
    status = printer.status("z_calibration")
    assert status == {
        "last_query": False,
        "last_z_offset": 0.0,
        "last_result": {},
        "valid": False,
        "reason": "not calibrated yet",
        "phase": "idle",
        "progress": 0.0,
    }
    printer.run("G28")
    (probe, switch, nozzle, switch_offset, offset), _ = calibration(printer)
    assert nozzle == pytest.approx(PIN, abs=MICROSTEP)
    assert switch == pytest.approx(PIN + BODY, abs=MICROSTEP)
    assert probe == pytest.approx(BED + TRIGGER, abs=MICROSTEP)
    assert switch_offset == SWITCH_OFFSET
    assert offset == pytest.approx(
        probe - (switch - nozzle + switch_offset), abs=0.002
    )
    status = printer.status("z_calibration")
    assert status["last_query"] is True
    assert (status["valid"], status["reason"]) == (True, "")
    assert (status["phase"], status["progress"]) == ("idle", 0.0)
    assert status["last_z_offset"] == pytest.approx(offset, abs=1e-6)
    parts = status["last_result"]
    assert parts["switch_offset"] == SWITCH_OFFSET
    assert parts["offset"] == status["last_z_offset"]
    assert [round(parts[k], 3) for k in ("probe", "switch", "nozzle")] == [
        probe,
        switch,
        nozzle,
    ]
    assert printer.offset() == pytest.approx(offset, abs=1e-6)


def test_each_site_is_touched_where_it_is_configured(start):
    changes = section(
        nozzle_xy_position="205.5, 306.5",
        switch_xy_position="208.5, 281",
        bed_xy_position="110, 90",
    )
    printer = start(changes=changes).homed()
    homing = len(printer.machine.truth.touches)
    printer.run("CALIBRATE_Z")
    expected = {
        "nozzle_pin": (205.5, 306.5),
        "body_pin": (208.5, 281.0),
        # The probe's point is asked for, not the nozzle's
        "probe_bed": (112.0, 65.25),
    }
    touches = printer.machine.truth.touches[homing:]
    assert {touch.site for touch in touches} == set(expected)
    for touch in touches:
        # X and Y are homed to a full microstep
        at = pytest.approx(expected[touch.site], abs=0.02)
        assert (touch.x, touch.y) == at


@pytest.mark.each_host
def test_batch_run_gives_the_same_result(host):
    with Printer(host) as printer:
        live, _ = calibration(printer.homed())
    scene = SCENES["voron"]
    with Machine(scene, app=firmware_of(host)) as machine:
        batch = run_batch(
            host.install(module_files()),
            machine,
            scene.config(machine.link.path),
            "G28\nCALIBRATE_Z\nG1 X150 Y150 Z10 F6000\nM400\n",
        )
        assert batch.status == 0, batch.tail()
        assert result_of(batch.log.splitlines()) == live
        gap = machine.gap_at_zero(10.0)
    assert gap == pytest.approx(scene.formula_gap(), abs=2 * MICROSTEP)


def test_switch_offset_moves_the_nozzle_closer(start):
    printer = start(changes=section(switch_offset="0.54")).homed()
    printer.run("CALIBRATE_Z")
    assert printer.gap() == pytest.approx(-0.04, abs=2 * MICROSTEP)


def test_offset_replaces_an_earlier_one_and_a_second_run_agrees(start):
    printer = start().homed()
    first, _ = calibration(printer)
    printer.run("SET_GCODE_OFFSET Z=0.7 MOVE=1")
    second, _ = calibration(printer)
    assert second == pytest.approx(first, abs=MICROSTEP)
    assert printer.offset() == pytest.approx(second[-1], abs=1e-6)


@pytest.mark.each_host
def test_samples_come_from_the_probe(start):
    printer = start(changes={"probe": {"samples": "4"}}).homed()
    _, sites = calibration(printer)
    expected = ["nozzle_pin"] * 4 + ["body_pin"] * 4 + ["probe_bed"] * 4
    assert sites == expected


@pytest.mark.parametrize(
    ("method", "share"), [("median", 0), ("average", 0.25)]
)
def test_samples_are_summarized_as_the_probe_says(start, method, share):
    # One of four samples triggers 0.1 mm early, within the tolerance
    changes = {
        "probe": {
            "samples": "4",
            "samples_result": method,
            "samples_tolerance": "0.2",
        }
    }
    faults = [Fault("trigger_early", signal="z_endstop", mm=0.1, n=5)]
    printer = start(changes=changes, faults=faults).homed()
    (_, _, nozzle, _, _), _ = calibration(printer)
    assert printer.machine.faults.unfired() == []
    assert nozzle == pytest.approx(PIN + share * 0.1, abs=2 * MICROSTEP)


def test_a_sample_that_disagrees_starts_the_site_again(start):
    faults = [Fault("trigger_early", signal="z_endstop", mm=0.05, n=5)]
    printer = start(faults=faults).homed()
    lines = printer.run("CALIBRATE_Z")
    assert result_of(lines)[2] == pytest.approx(PIN, abs=MICROSTEP)
    retries = [line for line in lines if "samples_tolerance" in line]
    assert len(retries) == 1
    assert "nozzle" in retries[0]
    assert "0.0500 mm" in retries[0]


@pytest.mark.each_host
def test_retries_end(start):
    changes = {"probe": {"samples_tolerance_retries": "1"}}
    faults = [
        Fault("trigger_early", signal="z_endstop", mm=0.05, n=n) for n in (5, 7)
    ]
    printer = start(changes=changes, faults=faults).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "nozzle: samples differ by 0.05" in text
    assert printer.machine.faults.unfired() == []
    assert_unharmed(printer)


@pytest.mark.each_host
def test_bed_is_sampled_with_the_probes_own_settings(start):
    changes = {"probe": {"samples_tolerance_retries": "0"}}
    # Homing and the two other sites arm the endstop, not the probe: its first
    # arming is for the way down, the third is the second sample
    faults = [Fault("trigger_early", signal="probe", mm=0.05, n=3)]
    printer = start(changes=changes, faults=faults).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "bed: samples differ by 0.0" in text
    assert "samples_tolerance is 0.0100 mm" in text
    assert printer.machine.faults.unfired() == []
    assert_unharmed(printer)


@pytest.mark.each_host
@pytest.mark.parametrize("deactivate", ["activate", "deactivate"])
def test_probe_that_cannot_be_made_ready_ends_the_run(start, deactivate):
    # With its own pin to be told apart: fails once, when told to
    changes = {
        "gcode_macro READY": {
            "variable_broken": "0",
            "gcode": "\n  {% if printer['gcode_macro READY'].broken %}"
            "\n    { action_raise_error('not ready') }\n  {% endif %}",
        },
        "probe": {f"{deactivate}_gcode": "READY"},
    }
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_VARIABLE MACRO=READY VARIABLE=broken VALUE=1")
    assert "not ready" in printer.fail("CALIBRATE_Z")
    assert printer.status("z_calibration")["last_query"] is False
    assert_unharmed(printer)
    printer.run("SET_GCODE_VARIABLE MACRO=READY VARIABLE=broken VALUE=0")
    calibration(printer)


def test_noise_is_averaged_out(start):
    scene = SCENES["voron"]
    pin = scene.world.pin
    noisy = scene.with_world(
        pin=replace(pin, noise=replace(pin.noise, sigma=0.003))
    )
    changes = {"probe": {"samples": "5", "samples_tolerance": "0.05"}}
    printer = start(noisy, changes, seed=7).homed()
    printer.run("CALIBRATE_Z")
    assert printer.gap() == pytest.approx(noisy.formula_gap(), abs=0.008)


def test_probe_passes_over_a_pin_that_stands_high(start):
    # Twice the z_offset would drag the body across the pin
    scene = SCENES["voron"]
    high = scene.with_world(pin=replace(scene.world.pin, z=8.9012))
    changes = {"stepper_z": {"position_endstop": "8.6"}}
    printer = start(high, changes=changes).homed()
    printer.run("CALIBRATE_Z")
    assert printer.gap() == pytest.approx(high.formula_gap(), abs=2 * MICROSTEP)


def test_retract_is_never_zero(start):
    changes = {"stepper_z": {"homing_retract_dist": "0"}}
    printer = start(changes=changes).homed()
    _, sites = calibration(printer)
    assert sites.count("nozzle_pin") == 3


def test_head_travels_at_the_safe_height(start):
    printer = start().homed()
    printer.run("G1 Z3 F600\nM400")
    machine = printer.machine
    before = len(machine.truth.touches)
    printer.run("CALIBRATE_Z")
    printer.session.wait(2.0)
    # Twice the probe's z_offset of 6.9
    assert printer.session.position()[2] == pytest.approx(13.8, abs=0.01)
    assert len(machine.truth.touches) > before
    assert sum(machine.truth.drag(s) for s in ("body_pin", "probe_bed")) == 0


def seconds_between_samples(host, changes):
    """From the first touch of a site to the second one, by site."""
    with Printer(host, changes=changes) as printer:
        printer.homed()
        homing = len(printer.machine.truth.touches)
        printer.run("CALIBRATE_Z")
        times = {
            site: [
                t.t
                for t in printer.machine.truth.touches[homing:]
                if t.site == site
            ]
            for site in ("nozzle_pin", "body_pin")
        }
    return {site: t[1] - t[0] for site, t in times.items()}


@functools.cache
def usual_seconds_between_samples(host):
    """The same without any change."""
    return seconds_between_samples(host, None)


@pytest.mark.parametrize(
    ("changes", "more"),
    [
        # Up by the retract of 3 mm at the probe's 10 mm/s, down at 3 mm/s
        ({"stepper_z": {"second_homing_speed": "1"}}, 3 / 1 - 3 / 3),
        # Half the homing speed of 8 where there is no second one
        ({"stepper_z": {"second_homing_speed": None}}, 3 / 4 - 3 / 3),
        ({"stepper_z": {"homing_retract_dist": "6"}}, 3 / 10 + 3 / 3),
        # Klipper's own default of 5
        ({"stepper_z": {"homing_retract_dist": None}}, 2 / 10 + 2 / 3),
        ({"probe": {"lift_speed": "1"}}, 3 / 1 - 3 / 10),
    ],
)
def test_samples_are_taken_at_the_configured_speeds(host, changes, more):
    usual = usual_seconds_between_samples(host)
    changed = seconds_between_samples(host, changes)
    for site in ("nozzle_pin", "body_pin"):
        assert changed[site] - usual[site] == pytest.approx(more, abs=0.2)


def test_way_to_the_bed_is_taken_at_the_configured_speeds(start):
    printer = start().homed()
    printer.run("CALIBRATE_Z")
    touches = printer.machine.truth.touches
    body = max(t.t for t in touches if t.site == "body_pin")
    bed = min(t.t for t in touches if t.site == "probe_bed")
    # Lift to 13.8, 50 mm/s in XY, down at the homing speed of 8 mm/s, and the
    # probe's own 2 mm with its own 5 mm/s
    travel = math.hypot(208 - 152, 281.25 - 125.25)
    down = (13.8 - 8.855) / 8 + 2 / 5
    seconds = (13.8 - 8.0) / 10 + travel / 50 + down
    # The rest is what starting and stopping takes
    assert 0.6 < bed - body - seconds < 2.2


def test_lift_at_the_end_is_taken_at_the_configured_speed(start):
    printer = start(changes=section(end_gcode="M400")).homed()
    printer.run("M400")
    clock, touches = printer.machine.simulation.clock, printer.machine.truth
    homing, began = len(touches.touches), clock.now()
    printer.run("CALIBRATE_Z")
    measuring = touches.touches[-1].t - touches.touches[homing].t
    # Up to 13.8 at 10 mm/s, down at 8 mm/s and the last 3 mm at 3 mm/s, and
    # after the last touch up again: what is left is starting and stopping
    down = (13.8 - 4.6) / 8 + 3 / 3
    seconds = (13.8 - 10) / 10 + down + (13.8 - 7.0) / 10
    rest = (clock.now() - began) / 1e9 - measuring - seconds
    assert 0.0 < rest < 3.0


def test_nothing_is_searched_above_the_safe_height(start):
    printer = start().homed()
    homed = printer.machine.truth.touches[-1]
    printer.run("G1 Z100 F900\nM400\nCALIBRATE_Z")
    touches = printer.machine.truth.touches
    first = touches[touches.index(homed) + 1]
    assert first.site == "nozzle_pin"
    # Up at 15 mm/s, down at 8 and the last 3 mm at 3 mm/s; down at 3 mm/s all
    # the way would take 20 s more
    seconds = 100 / 15 + (100 - 4.6) / 8 + 3 / 3
    assert first.t - homed.t < seconds + 6.0


def test_head_that_is_higher_does_not_come_down_on_the_way(start):
    # It ends over the nozzle's site, which lies behind the bed
    fault = Fault("stuck_closed", signal="z_endstop", t=60.0)
    high = replace(SCENES["voron"], start=Pose(285.0, 295.0, 40.0))
    printer = start(high, faults=[fault]).homed()
    printer.run("G1 Z60 F900\nG1 X20 Y20 F6000\nM400")
    printer.session.wait(60.0)
    above_bed = lowest_tip(printer)
    assert above_bed > 20.0
    assert "endstop reads triggered" in printer.fail("CALIBRATE_Z")
    assert lowest_tip(printer) == above_bed


AXIS_OPTIONS = (
    "endstop_pin",
    "position_endstop",
    "position_min",
    "position_max",
    "homing_speed",
    "homing_retract_dist",
)


@pytest.mark.each_host
@pytest.mark.parametrize("name", ["z", "lift"])
def test_axis_of_generic_cartesian(host, name):
    if not has_kinematics(host, SCENES["generic"]):
        pytest.skip(f"{host.name} has no generic_cartesian")
    changes = {
        "printer": {"kinematics": "generic_cartesian"},
        "tmc2209 stepper_z": None,
    }
    for axis, carriage in (("x", "x"), ("y", "y"), ("z", name)):
        stepper = dict(SCENES["cartesian"].sections[f"stepper_{axis}"])
        own = {k: stepper.pop(k) for k in AXIS_OPTIONS if k in stepper}
        changes[f"stepper_{axis}"] = None
        changes[f"carriage {carriage}"] = {**own, "axis": axis}
        changes[f"stepper my_{axis}"] = {**stepper, "carriages": carriage}
    with Printer(host, "cartesian", changes=changes) as printer:
        printer.homed().run("CALIBRATE_Z")
        predicted = printer.scene.formula_gap()
        assert printer.gap() == pytest.approx(predicted, abs=2 * MICROSTEP)


@pytest.mark.each_host
def test_twist_compensation_counts_as_the_probe_counts_it(host):
    twist = {
        "calibrate_start_x": "20",
        "calibrate_end_x": "280",
        "calibrate_y": "150",
        "z_compensations": "0.1, 0.1, 0.1",
    }
    # Needed by newer hosts, refused by older ones
    limits = {"compensation_start_x": "20", "compensation_end_x": "280"}
    for options in ({**twist, **limits}, twist):
        changes = {"axis_twist_compensation": options}
        with Printer(host, changes=changes) as printer:
            if printer.session.start()[0] != "ready":
                continue
            printer.homed()
            (probe, *_), _ = calibration(printer)
            printer.run("G1 X152 Y125.25 Z15 F6000\nPROBE")
            seen = printer.status("probe")["last_z_result"]
        assert abs(probe - (BED + TRIGGER)) == pytest.approx(0.1, abs=0.005)
        assert probe == pytest.approx(seen, abs=0.005)
        return
    raise AssertionError("no host takes this section")


def test_macro_named_like_the_offset_command_is_left_alone(start):
    changes = marked("SET_GCODE_OFFSET")
    changes["gcode_macro SET_GCODE_OFFSET"]["rename_existing"] = "PLAIN_OFFSET"
    printer = start(changes=changes).homed()
    lines = printer.run("CALIBRATE_Z")
    assert not any("SET_GCODE_OFFSET" in line for line in lines)
    assert printer.offset() == pytest.approx(result_of(lines)[-1], abs=1e-6)


def test_head_does_not_move_with_the_new_offset(start):
    printer = start().homed()
    printer.run("SET_GCODE_OFFSET Z=0.9\nCALIBRATE_Z\nM400")
    assert printer.session.position()[2] == pytest.approx(13.8, abs=1e-6)


def test_offset_is_given_to_the_micrometre(start):
    printer = start(changes=section(switch_offset="0.441234")).homed()
    lines = printer.run("CALIBRATE_Z")
    offset = next(m for m in map(RESULT.search, lines) if m).group(5)
    assert re.fullmatch(r"0\.\d{6}", offset)
    assert not offset.endswith("000")
    assert printer.offset() == pytest.approx(float(offset), abs=1e-7)


@pytest.mark.each_host
def test_klippy_knows_version_help_and_settings(start):
    printer = start()
    printer.session.require_ready()
    assert re.search(r"z_calibration \d+\.\d+\.\d+", printer.session.log())
    helped = [line for line in printer.run("HELP") if "CALIBRATE_Z" in line]
    assert "set the Z offset" in " ".join(helped)
    settings = printer.status("configfile")["settings"]["z_calibration"]
    assert settings["switch_offset"] == SWITCH_OFFSET


# Templates


@pytest.mark.each_host
def test_templates_run_in_order_and_once(start):
    changes = marked("FIRST", "SECOND", "LAST")
    changes.update(
        section(
            start_gcode="FIRST",
            before_switch_gcode="ATTACH_PROBE\n  SECOND",
            end_gcode="DOCK_PROBE\n  LAST",
        )
    )
    printer = start("cartesian", changes=changes).homed()
    lines = printer.run("CALIBRATE_Z")
    order = [
        word
        for line in lines
        for word in (
            "FIRST",
            "nozzle: touched",
            "SECOND",
            "switch: touched",
            "bed: touched",
            "LAST",
            "Z-CALIBRATION:",
        )
        if word in line
    ]
    once = [word for i, word in enumerate(order) if word not in order[:i]]
    assert once == [
        "FIRST",
        "nozzle: touched",
        "SECOND",
        "switch: touched",
        "bed: touched",
        "LAST",
        "Z-CALIBRATION:",
    ]
    assert [order.count(w) for w in ("FIRST", "SECOND", "LAST")] == [1, 1, 1]
    assert printer.machine.world.probe_state(0.0) == "docked"


@pytest.mark.parametrize("broken", ["FIRST", "SECOND", "LAST"])
def test_template_that_fails_ends_the_run(start, broken):
    bodies = {broken: "{ action_raise_error('no luck') }"}
    changes = marked("FIRST", "SECOND", "LAST", **bodies)
    changes.update(
        section(
            start_gcode="FIRST",
            before_switch_gcode="ATTACH_PROBE\n  SECOND",
            end_gcode="LAST\n  DOCK_PROBE",
        )
    )
    printer = start("cartesian", changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.2")
    before = len(printer.session.console)
    assert "no luck" in printer.fail("CALIBRATE_Z")
    lines = printer.session.console[before:]
    # A macro that raises has no time to leave its mark
    assert lines.count("echo: LAST") == (0 if broken == "LAST" else 1)
    assert printer.status("z_calibration")["last_query"] is False
    assert printer.session.state()[0] == "ready"
    assert printer.offset() == pytest.approx(0.2)


@pytest.mark.each_host
def test_template_that_turns_the_motors_off_ends_the_run(start):
    changes = section(before_switch_gcode="ATTACH_PROBE\n  M84")
    printer = start("cartesian", changes=changes).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "the motors were turned off in before_switch_gcode" in text
    assert set(touched_sites(printer)) == {"nozzle_pin"}
    assert printer.session.state()[0] == "ready"


def test_template_that_homes_between_nozzle_and_switch(start):
    changes = section(before_switch_gcode="G28 Z\n  ATTACH_PROBE")
    printer = start("cartesian", changes=changes).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "Z was homed again in before_switch_gcode" in text
    assert "do it before CALIBRATE_Z" in text
    assert "body_pin" not in touched_sites(printer)


def test_end_gcode_that_homes_leaves_a_result_that_does_not_hold(start):
    printer = start(changes=section(end_gcode="G28 Z")).homed()
    lines = printer.run("CALIBRATE_Z")
    assert result_of(lines)
    told = [line for line in lines if "the offset holds no more" in line]
    assert len(told) == 1
    assert "Z was homed again after measuring, in end_gcode" in told[0]
    status = printer.status("z_calibration")
    assert (status["valid"], status["reason"]) == (False, "Z was homed again")


def test_start_gcode_may_home(start):
    printer = start(changes=section(start_gcode="G28"))
    printer.session.require_ready()
    calibration(printer)


def test_failing_end_gcode_does_not_hide_the_first_error(start):
    changes = marked("LAST", LAST="{ action_raise_error('second error') }")
    changes.update(section(end_gcode="LAST"))
    faults = [Fault("trigger_never", signal="z_endstop", n=4)]
    printer = start(changes=changes, faults=faults)
    printer.machine.tolerate("nozzle_pin", 1.01)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "nozzle" in text
    assert "second error" not in text
    assert "second error" in printer.session.log()
    assert_unharmed(printer)


@pytest.mark.parametrize("faults", [0, 1])
def test_head_is_safe_when_user_gcode_runs(start, faults):
    where = "{printer.toolhead.position.z|round(2)}"
    changes = {
        "respond": {},
        "gcode_macro SECOND": {"gcode": f"\n  RESPOND MSG=second:{where}"},
        "gcode_macro LAST": {"gcode": f"\n  RESPOND MSG=last:{where}"},
        # Lower than the safe height after each touch
        "stepper_z": {"homing_retract_dist": "1"},
    }
    changes.update(
        section(
            before_switch_gcode="SECOND\n  ATTACH_PROBE",
            end_gcode="LAST\n  DOCK_PROBE",
        )
    )
    printer = start(
        "cartesian",
        changes=changes,
        faults=[Fault("probe_falls", n=1)] * faults,
    ).homed()
    printer.run("G1 Z2 F600")
    before = len(printer.session.console)
    if faults:
        printer.fail("CALIBRATE_Z")
    else:
        printer.run("CALIBRATE_Z")
    lines = "\n".join(printer.session.console[before:])
    # Twice the probe's z_offset of 2.0
    assert float(re.search(r"second:(\S+)", lines)[1]) >= 4.0
    assert float(re.search(r"last:(\S+)", lines)[1]) >= 4.0


def test_empty_template_is_no_template(start):
    # This probe is attached all the time
    changes = section(start_gcode="", before_switch_gcode="", end_gcode="")
    calibration(start(changes=changes).homed())


def test_end_gcode_that_turns_the_motors_off_voids_the_result(start):
    printer = start(changes=section(end_gcode="M84")).homed()
    printer.run("SET_GCODE_OFFSET Z=0.2")
    text = printer.fail("CALIBRATE_Z")
    assert "z_calibration: not homed: X, Y, Z" in text
    assert printer.status("z_calibration")["last_query"] is False
    assert printer.offset() == pytest.approx(0.2)


@pytest.mark.each_host
def test_template_that_stops_the_printer_is_the_last_thing_run(start):
    changes = marked("LAST")
    stop = "\n  { action_emergency_stop('enough') }"
    changes.update(section(before_switch_gcode=stop, end_gcode="LAST"))
    printer = start("cartesian", changes=changes).homed()
    before = len(printer.session.console)
    assert "enough" in printer.fail("CALIBRATE_Z")
    printer.session.wait(2.0)
    assert "echo: LAST" not in printer.session.console[before:]
    assert "failed, too" not in printer.session.log()
    assert printer.session.state()[0] == "shutdown"


# What may go wrong on the way


@pytest.mark.each_host
@pytest.mark.parametrize("homed", ["", "G28 X Y", "G28\nM84"])
def test_unhomed_printer_does_not_move(start, homed):
    printer = start(changes={"safe_z_home": None} if homed else None)
    printer.session.require_ready()
    if "M84" in homed:
        homed = "G28 X Y\nM84"
    printer.run(homed)
    printer.session.wait(3.0)
    before = printer.machine.tip()
    text = printer.fail("CALIBRATE_Z")
    assert re.search(r"not homed: .*Z; home all axes \(G28\) first", text)
    printer.session.wait(3.0)
    assert printer.machine.tip() == before
    assert printer.session.state()[0] == "ready"


@pytest.mark.quick
@pytest.mark.each_host
def test_probe_that_is_not_attached_never_goes_down(start):
    changes = section(before_switch_gcode=None)
    printer = start("cartesian", changes=changes).homed()
    printer.session.wait(3.0)
    before, at = len(printer.machine.truth.touches), printer.machine.tip()
    text = printer.fail("CALIBRATE_Z")
    assert "not attached" in text
    assert "start_gcode or before_switch_gcode" in text
    assert "QUERY_PROBE" in text
    # Nothing was touched, and the only move was the lift
    assert touched_sites(printer, before) == []
    printer.session.wait(3.0)
    tip = printer.machine.tip()
    assert (tip.x, tip.y) == (at.x, at.y)
    assert tip.z >= at.z
    assert printer.session.state()[0] == "ready"


def test_probe_may_stand_on_the_bed_before(start):
    printer = start().homed()
    printer.run("G1 X150 Y120 Z15 F6000\nPROBE")
    calibration(printer)


def test_probe_that_fails_to_attach_never_goes_down(start):
    # Two armings for homing, one down to the nozzle's samples and two of them:
    # the sixth would be the way down to the switch
    down = Fault("trigger_early", signal="z_endstop", mm=0.1, n=6)
    faults = [Fault("attach_fails"), down]
    printer = start("cartesian", faults=faults).homed()
    before = len(printer.machine.truth.touches)
    assert "not attached" in printer.fail("CALIBRATE_Z")
    assert touched_sites(printer, before) == ["nozzle_pin"] * 2
    assert printer.machine.faults.unfired() == [down]


def test_probe_attached_too_early_is_refused(start):
    changes = section(
        start_gcode="ATTACH_PROBE", before_switch_gcode="ATTACH_PROBE\n  M400"
    )
    printer = start("cartesian", changes=changes).homed()
    before = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert "before_switch_gcode" in text
    assert touched_sites(printer, before) == []


@pytest.mark.parametrize("k", range(1, 7))
def test_probe_that_falls_off_at_touch_k_ends_the_run(start, k):
    # 3 body touches, then 3 samples on the bed
    printer = start(faults=[Fault("probe_falls", n=k)]).homed()
    text = printer.fail("CALIBRATE_Z")
    # After the last body touch the next look is the one at the bed
    assert ("switch: " if k <= 2 else "bed: ") in text
    assert "it is not attached" in text
    assert "probe" in text.lower()
    assert printer.machine.faults.unfired() == []
    # The nozzle stays above the bed by the probe's own length
    assert lowest_tip(printer) > 1.0
    assert printer.status("z_calibration")["last_query"] is False
    assert_unharmed(printer)


@pytest.mark.parametrize(
    ("signal", "n", "site", "floor"),
    [
        # Two armings belong to G28, one to the way down to each site
        ("z_endstop", 4, "nozzle", PIN - 1.0),
        ("z_endstop", 6, "nozzle", PIN - 1.0),
        # A z_offset of 6.9 is about right
        ("z_endstop", 8, "switch", PIN + 6.9 - SWITCH_OFFSET - 1.0),
        ("z_endstop", 10, "switch", PIN + 6.9 - SWITCH_OFFSET - 1.0),
        ("probe", 2, "bed", BODY + SWITCH_OFFSET - 1.0),
        ("probe", 4, "bed", BODY + SWITCH_OFFSET - 1.0),
    ],
)
def test_trigger_that_never_comes_ends_at_the_floor(
    start, signal, n, site, floor
):
    printer = start(faults=[Fault("trigger_never", signal=signal, n=n)])
    # A dead switch is pressed: how far, the floor limits
    expected = {"nozzle": PIN, "switch": PIN + BODY, "bed": BED + BODY}[site]
    crashed = {"nozzle": "nozzle_pin", "switch": "body_pin", "bed": "body_bed"}
    printer.machine.tolerate(crashed[site], expected - floor + MICROSTEP)
    text = printer.homed().fail("CALIBRATE_Z")
    assert printer.machine.faults.unfired() == []
    assert f"{site}: " in text
    assert f"z={floor:.3f}" in text
    assert f"{site}_xy_position" in text
    lowest = printer.machine.truth.min_gap
    if site != "nozzle":
        assert lowest > 1.0
    assert_unharmed(printer)


def test_endstop_that_is_pressed_already_is_not_touched(start):
    printer = start(faults=[Fault("stuck_closed", signal="z_endstop", t=60.0)])
    printer.homed()
    printer.session.wait(60.0)
    before = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert "nozzle: " in text
    assert "endstop reads triggered" in text
    assert "QUERY_ENDSTOPS" in text
    assert touched_sites(printer, before) == []
    assert printer.session.state()[0] == "ready"


@pytest.mark.parametrize(
    ("n", "site"), [(3, "nozzle"), (4, "nozzle"), (7, "switch"), (8, "switch")]
)
def test_endstop_that_closes_while_a_touch_begins(start, n, site):
    fault = Fault("stuck_closed", signal="z_endstop", n=n)
    printer = start(faults=[fault]).homed()
    text = printer.fail("CALIBRATE_Z")
    assert f"{site}: the Z endstop reads triggered" in text
    assert "QUERY_ENDSTOPS" in text
    assert_unharmed(printer)


@pytest.mark.each_host
@pytest.mark.parametrize(
    ("site", "noticed"), [("nozzle", "switch"), ("switch", "bed")]
)
def test_endstop_that_stays_pressed_after_the_last_touch(host, site, noticed):
    where = {"nozzle": "nozzle_pin", "switch": "body_pin"}[site]
    with Printer(host) as printer:
        printer.homed().run("CALIBRATE_Z")
        last = max(
            touch.t
            for touch in printer.machine.truth.touches
            if touch.site == where
        )
    # The same run again: it sticks the moment it was pressed last
    fault = Fault("stuck_closed", signal="z_endstop", t=last + 0.01)
    with Printer(host, faults=[fault]) as printer:
        text = printer.homed().fail("CALIBRATE_Z")
        # At its own site when the second run is a little late
        assert text.startswith(
            tuple(
                f"z_calibration: {where}: the Z endstop reads triggered"
                for where in (site, noticed)
            )
        )
        assert_unharmed(printer)


def test_result_outside_the_margins_is_not_applied(start):
    # The owner moved the endstop by 1.5 mm
    changes = {"stepper_z": {"position_endstop": "3.2"}}
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.1")
    text = printer.fail("CALIBRATE_Z")
    assert "offset 1.7" in text
    assert "-1.000 to 1.000" in text
    assert "home Z again" in text
    assert_unharmed(printer, 0.1)


def test_failure_keeps_the_last_result_and_offset(start):
    # 2 for homing, 8 for a good run, 1 for the way down, then the second
    # run's second sample
    fault = Fault("trigger_never", signal="z_endstop", n=13)
    printer = start(faults=[fault])
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.homed()
    good, _ = calibration(printer)
    status = printer.status("z_calibration")
    printer.fail("CALIBRATE_Z")
    assert printer.machine.faults.unfired() == []
    assert printer.status("z_calibration") == status
    assert_unharmed(printer, good[-1])


@pytest.mark.each_host
def test_probe_is_usable_after_a_failure(start):
    # The session must have been closed
    fault = Fault("trigger_never", signal="probe", n=3)
    printer = start(faults=[fault])
    printer.machine.tolerate("body_bed", 1.0)
    printer.homed().fail("CALIBRATE_Z")
    assert printer.machine.faults.unfired() == []
    printer.run("G1 X150 Y120 Z15 F6000\nPROBE")


@pytest.mark.each_host
def test_failure_says_who_and_where(start):
    fault = Fault("trigger_never", signal="z_endstop", n=4)
    printer = start(faults=[fault])
    printer.machine.tolerate("nozzle_pin", 1.01)
    text = printer.homed().fail("CALIBRATE_Z")
    assert text.startswith("z_calibration: nozzle: No trigger")
    assert "(stopped at z=0.600), expected a trigger at z=1.600" in text
    assert "home Z again (G28 Z) after any levelling" in text


def test_floor_without_position_min_is_zero(start):
    changes = {"stepper_z": {"position_min": None}}
    fault = Fault("trigger_never", signal="z_endstop", n=4)
    printer = start("cartesian", changes=changes, faults=[fault])
    printer.machine.tolerate("nozzle_pin", 0.5 + MICROSTEP)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "(stopped at z=0.000), expected a trigger at z=0.500" in text


def test_axes_that_are_not_homed_are_named(start):
    # It stands over the pin already
    scene = replace(SCENES["cartesian"], start=Pose(226.0, 20.0, 25.0))
    printer = start(scene, changes={"safe_z_home": None})
    printer.session.require_ready()
    printer.run("G28 Z")
    homing = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert "z_calibration: not homed: X, Y; home all axes (G28)" in text
    assert touched_sites(printer, homing) == []
    assert printer.session.state()[0] == "ready"


def test_unhomed_printer_is_not_lifted(start):
    printer = start()
    printer.session.require_ready()
    printer.fail("CALIBRATE_Z")
    assert "failed, too" not in printer.session.log()


def test_switch_offset_beyond_the_travel_height(start):
    printer = start(changes=section(switch_offset="300")).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "bed: the head is at z=280.000, this touch ends at z=305.4" in text
    assert "correct switch_offset, which is larger than any switch has" in text
    assert "probe_bed" not in touched_sites(printer)
    assert_unharmed(printer)


# Set-ups that are refused when klippy connects


@pytest.mark.parametrize(
    ("option", "parameter", "words"),
    [
        ("nozzle_xy_position", "NOZZLE_POSITION=206,306", "for the nozzle"),
        ("switch_xy_position", "SWITCH_POSITION=208,281.25", "for the switch"),
        ("bed_xy_position", "BED_POSITION=150,150", "for the bed"),
        ("switch_offset", "SWITCH_OFFSET=0.44", "no switch_offset"),
    ],
)
def test_option_that_is_missing_may_come_with_the_command(
    start, option, parameter, words
):
    changes = section(**{option: None})
    if option == "nozzle_xy_position":
        changes["safe_z_home"] = None
        changes["homing_override"] = {
            "axes": "xyz",
            "set_position_z": "0",
            "gcode": "\n  G91\n  G1 Z10 F600\n  G90\n  G28 X Y"
            "\n  G1 X206 Y306 F6000\n  G28 Z",
        }
    printer = start(changes=changes).homed()
    homing = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert words in text
    assert option in text
    assert parameter.split("=")[0] in text
    assert touched_sites(printer, homing) == []
    calibration(printer, f"CALIBRATE_Z {parameter}")
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("nozzle_xy_position", ""),
        ("nozzle_xy_position", "206"),
        ("switch_xy_position", "206, 306, 5"),
        ("switch_xy_position", "here, there"),
        ("bed_xy_position", "nan, 100"),
        ("bed_xy_position", "100, inf"),
        ("switch_offset", "much"),
        ("switch_offset", "-0.1"),
        ("switch_offset", "nan"),
        ("switch_offset", "inf"),
    ],
)
def test_option_that_makes_no_sense(host, option, value):
    message = refusal(host, section(**{option: value}))
    assert f"'{option}'" in message
    assert "section 'z_calibration'" in message


def test_option_that_does_not_exist(host):
    message = refusal(host, section(swich_offset="0.4"))
    assert "Option 'swich_offset' in section 'z_calibration'" in message
    assert "is 'switch_offset' meant?" in message
    message = refusal(host, section(second_homing_speed="2"))
    assert "is 'probing_second_speed' meant?" in message
    message = refusal(host, section(frobnicate="0.4"))
    assert "'frobnicate' in section 'z_calibration' is not known" in message
    assert "remove it" in message


@pytest.mark.parametrize(
    ("option", "value", "reason"),
    [
        ("nozzle_xy_position", "301, 100", "X=301.000"),
        ("switch_xy_position", "100, -1", "Y=-1.000"),
        # The probe hangs 24.75 mm behind the nozzle
        ("bed_xy_position", "150, 20", "Y=-4.750"),
        ("bed_xy_position", "299, 150", "X=301.000"),
    ],
)
def test_point_that_the_head_cannot_reach(host, option, value, reason):
    message = refusal(host, section(**{option: value}))
    assert f"Option '{option}: " in message
    assert "in section 'z_calibration' needs the head at" in message
    assert reason in message


@pytest.mark.each_host
def test_printer_without_a_probe(host):
    message = refusal(host, {"probe": None})
    assert "Section 'probe' is missing" in message


@pytest.mark.each_host
def test_probe_without_a_switch_body(host):
    changes = {
        "probe": None,
        "bltouch": {
            "sensor_pin": "^PC3",
            "control_pin": "PD1",
            "z_offset": "2",
        },
    }
    message = refusal(host, changes)
    assert "Section 'bltouch'" in message


@pytest.mark.each_host
def test_virtual_endstop(host):
    changes = {
        "stepper_z": {
            "endstop_pin": "probe:z_virtual_endstop",
            "position_endstop": None,
        }
    }
    message = refusal(host, changes)
    assert "'endstop_pin: probe:z_virtual_endstop'" in message
    assert "is the probe: z_calibration needs a Z endstop" in message
    assert "section 'stepper_z'" in message


@pytest.mark.each_host
def test_endstop_that_does_not_stop_every_z_motor(host):
    changes = {"stepper_z1": {"endstop_pin": "^PC5"}}
    message = refusal(host, changes)
    assert "stepper_z1" in message
    assert "does not stop these Z motors: stepper_z1;" in message


@pytest.mark.each_host
def test_delta(host):
    tower = {
        "microsteps": "16",
        "rotation_distance": "40",
        "position_endstop": "300",
        "arm_length": "330",
    }
    changes = {
        "printer": {
            "kinematics": "delta",
            "max_z_velocity": "100",
            "max_z_accel": None,
        },
        "safe_z_home": None,
        **{f"stepper_{a}": None for a in ("x", "y", "z", "z1", "z2", "z3")},
    }
    for name, pins in (("a", 0), ("b", 3), ("c", 6)):
        changes[f"stepper_{name}"] = {
            "step_pin": f"PB{pins}",
            "dir_pin": f"PB{pins + 1}",
            "enable_pin": f"!PB{pins + 2}",
            "endstop_pin": f"^PC{pins}",
            **tower,
        }
    changes["probe"] = {"pin": "^PD3"}
    message = refusal(host, changes)
    assert "kinematics: delta" in message


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        # Twice the z_offset is no height to travel at
        ({"probe": {"z_offset": "150"}}, "z_offset"),
        ({"stepper_z": {"position_endstop": "275"}}, "position_endstop"),
    ],
)
def test_travel_height_that_makes_no_sense(host, changes, words):
    message = refusal(host, changes)
    assert words in message
    assert "travel height" in message


@pytest.mark.parametrize("edge", ["300, 100", "100, 310", "0, 0"])
def test_point_on_the_edge_of_the_axes(start, edge):
    changes = section(nozzle_xy_position=edge, switch_xy_position=edge)
    start(changes=changes).session.require_ready()


@pytest.mark.parametrize(
    "option", ["start_gcode", "before_switch_gcode", "end_gcode"]
)
def test_template_with_a_syntax_error(host, option):
    message = refusal(host, section(**{option: "{% if %}"}))
    assert f"z_calibration:{option}" in message


@pytest.mark.each_host
def test_smart_effector(host):
    changes = {
        "probe": None,
        "smart_effector": {
            "pin": "^PC3",
            "control_pin": "PD1",
            "z_offset": "2",
        },
    }
    assert "Section 'smart_effector'" in refusal(host, changes)


STRANGE = '''
class Strange:
    """Changes a part of the printer, as extras of others do: QIDI's, for one,
    exchange what belongs to mcu_probe."""

    def __init__(self, config):
        self.printer = config.get_printer()
        self.part = config.get("part")
        if self.part == "samples_result":
            # On QIDI's hosts
            probe = self.printer.load_object(config, "probe")
            for name in ("param_helper", "probe_session"):
                helper = getattr(probe, name, probe)
                if hasattr(helper, "samples_result"):
                    helper.samples_result = "submaxmin"
        self.printer.register_event_handler("klippy:mcu_identify", self.change)

    def trigger_above_halt(self):
        # As with endstop and motors on boards of their own, only more so
        homing = self.printer.lookup_object("homing")
        probing_move = homing.probing_move

        def changed(*args, **options):
            position = list(probing_move(*args, **options))
            position[2] += 0.25
            return position

        homing.probing_move = changed

    def change(self):
        if self.part == "halt":
            return self.trigger_above_halt()
        probe = self.printer.lookup_object("probe")
        if self.part == "endstop":
            query = self.printer.lookup_object("query_endstops")
            query.endstops = [e for e in query.endstops if "z" not in e[1]]
        elif self.part == "probe":
            probe.mcu_probe = None
        elif self.part == "steppers":
            raw = getattr(probe.mcu_probe, "mcu_endstop", None)
            for endstop in (raw, probe.mcu_probe):
                if endstop is not None:
                    endstop.get_steppers = lambda: []


def load_config(config):
    return Strange(config)
'''


@pytest.mark.each_host
@pytest.mark.parametrize(
    ("part", "words"),
    [
        ("endstop", "knows no endstop of the name stepper_z or z"),
        ("probe", "Section 'probe' (PrinterProbe) is not a switch"),
        ("steppers", "Section 'probe' (PrinterProbe) is not a switch"),
        ("samples_result", "set it to median or average"),
    ],
)
def test_host_that_is_not_as_expected(host, tmp_path, part, words):
    source = tmp_path / "strange.py"
    source.write_text(STRANGE)
    modules = {**module_files(), "strange": source}
    changes = {"strange": {"part": part}}
    with Printer(host, changes=changes, modules=modules) as printer:
        state, message = printer.session.start()
        assert state == "error"
        assert words in message
        assert "Internal error" not in message


@pytest.mark.each_host
def test_heights_are_those_of_the_trigger_not_of_the_halt(start, tmp_path):
    source = tmp_path / "strange.py"
    source.write_text(STRANGE)
    modules = {**module_files(), "strange": source}
    changes = {"strange": {"part": "halt"}}
    printer = start(changes=changes, modules=modules).homed()
    (probe, switch, nozzle, _, _), _ = calibration(printer)
    assert nozzle == pytest.approx(PIN + 0.25, abs=MICROSTEP)
    assert switch == pytest.approx(PIN + BODY + 0.25, abs=MICROSTEP)
    assert probe == pytest.approx(BED + TRIGGER + 0.25, abs=MICROSTEP)


def test_bed_point_out_of_reach_speaks_of_the_probes_offset(host):
    bed = refusal(host, section(bed_xy_position="150, 20"))
    assert "Y=-4.750, the probe's offset included, outside" in bed
    nozzle = refusal(host, section(nozzle_xy_position="301, 100"))
    assert "X=301.000, outside" in nozzle
