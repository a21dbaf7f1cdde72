"""What [z_calibration] does with the user's macros, places and settings."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.hostkit.printer import Printer
from tests.hostkit.z_calibration import (
    BODY,
    MICROSTEP,
    PIN,
    assert_unharmed,
    calibration,
    result_of,
    section,
    with_moves,
)
from tests.simprinter import SCENES, Fault
from tests.simprinter.world import DriftSpec

pytestmark = pytest.mark.spread

# A z_calibration without an offset of its own would say 0.16 here
OFFSET = 0.16

LOOK = (
    "\n  RESPOND MSG='seen {printer.z_calibration.last_z_offset}"
    " {printer.z_calibration.last_result.nozzle}"
    " {printer.z_calibration.last_query}'"
)


def macro(name, gcode):
    """A macro besides those of the scene."""
    return {"respond": {}, f"gcode_macro {name}": {"gcode": f"\n  {gcode}"}}


# Parameters that a macro passes on


def test_blank_parameters_count_as_not_given(start):
    printer = start().homed()
    blank = "NOZZLE_POSITION= SWITCH_POSITION= BED_POSITION= SWITCH_OFFSET="
    usual, _ = calibration(printer)
    again, _ = calibration(printer, f"CALIBRATE_Z {blank}")
    assert again == pytest.approx(usual, abs=MICROSTEP)
    printer.run("PROBE_Z_ACCURACY SAMPLES= PROBE_SPEED= NOZZLE_POSITION=")


# end_gcode


def test_end_gcode_reads_the_result_of_its_own_run(start):
    changes = macro("LOOK", LOOK)
    changes.update(section(end_gcode="LOOK"))
    printer = start(changes=changes).homed()
    lines = printer.run("CALIBRATE_Z")
    result = result_of(lines)
    seen = [line for line in lines if "seen" in line]
    _, _, offset, nozzle, query = seen[0].split()
    assert float(offset) == pytest.approx(result[-1], abs=1e-5)
    assert float(nozzle) == pytest.approx(result[2], abs=1e-3)
    # Not before all of it has succeeded
    assert query == "False"
    assert printer.status("z_calibration")["last_query"] is True


def test_what_end_gcode_adds_to_the_offset_stays(start):
    adjust = section(end_gcode="SET_GCODE_OFFSET Z_ADJUST=0.02")
    printer = start(changes=adjust).homed()
    printer.run("SET_GCODE_OFFSET Z=0.5")
    lines = printer.run("CALIBRATE_Z")
    offset = result_of(lines)[-1]
    assert printer.offset() == pytest.approx(offset + 0.02, abs=1e-6)
    told = "end_gcode changed the G-code Z offset by 0.020000"
    assert told in "\n".join(lines)


def test_an_offset_that_end_gcode_restores_is_not_added(start):
    changes = section(
        start_gcode="\n  SAVE_GCODE_STATE NAME=mine\n  SET_GCODE_OFFSET Z=0",
        end_gcode="RESTORE_GCODE_STATE NAME=mine",
    )
    printer = start(changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.5")
    result, _ = calibration(printer)
    assert printer.offset() == pytest.approx(result[-1], abs=1e-6)


def test_last_query_is_false_from_the_start_of_a_run(start):
    printer = start().homed()
    calibration(printer)
    printer.machine.faults.add(Fault("stuck_open", signal="z_endstop"))
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.fail("CALIBRATE_Z")
    status = printer.status("z_calibration")
    assert status["last_query"] is False
    # The rest is of the last good run
    assert status["valid"] is True
    assert status["last_z_offset"] == pytest.approx(OFFSET, abs=0.02)


# Errors of templates


@pytest.mark.parametrize("template", ["start_gcode", "end_gcode"])
def test_error_in_a_template_names_it(start, template):
    changes = macro("BROKEN", "{ action_raise_error('Probe attach failed!') }")
    changes.update(section(**{template: "BROKEN"}))
    printer = start(changes=changes).homed()
    text = printer.fail("CALIBRATE_Z")
    assert text.startswith(f"z_calibration: {template}: ")
    assert "Probe attach failed!" in text
    assert_unharmed(printer)


def test_error_in_offset_gcode_names_it(start):
    changes = macro("BROKEN", "{ action_raise_error('no offset') }")
    changes.update(section(offset_gcode="BROKEN"))
    text = start(changes=changes).homed().fail("CALIBRATE_Z")
    assert text.startswith("z_calibration: offset_gcode: ")


# Homing


def test_homing_is_checked_before_start_gcode(start):
    changes = macro("ATTACH", "RESPOND MSG=attaching")
    printer = start(changes={**changes, **section(start_gcode="ATTACH")})
    printer.session.require_ready()
    printer.run("G28 X Y")
    assert "not homed: Z" in printer.fail("CALIBRATE_Z")
    assert "attaching" not in "\n".join(printer.session.console)


@pytest.mark.parametrize("by_macro", [False, True])
def test_start_gcode_may_home(start, by_macro):
    changes = macro("home_it", "G28 Z")
    line = "Home_It" if by_macro else "G28 Z"
    changes.update(section(start_gcode=line))
    printer = start(changes=changes)
    printer.session.require_ready()
    printer.run("G28 X Y")
    calibration(printer)


# Where before_switch_gcode attaches the probe


@pytest.mark.parametrize(
    ("before_switch", "start_gcode", "attaches"),
    [
        ("Look_At_It", "", True),
        ("look_at_it", "LOOK_AT_IT", False),
        ("G0 Z20\n  M117 switch", "", False),
        ("RESPOND MSG=hello", "", False),
        ("{% if True %}LOOK_AT_IT{% endif %}", "", True),
        ("SET_PIN PIN=servo VALUE=1", "", True),
    ],
)
def test_before_switch_gcode_that_attaches_a_probe(
    start, before_switch, start_gcode, attaches
):
    changes = macro("LOOK_AT_IT", "M117 looking")
    changes["output_pin servo"] = {"pin": "PD0"}
    changes.update(
        section(
            start_gcode=start_gcode or None,
            before_switch_gcode=f"\n  {before_switch}",
        )
    )
    printer = start(changes=changes).homed()
    if attaches:
        # There is a probe on the head already
        assert "attached already" in printer.fail("CALIBRATE_Z")
    else:
        calibration(printer)


# Places


def test_the_first_way_goes_along_x_then_along_y(host):
    with Printer(host, changes={"moves": {}}, modules=with_moves()) as printer:
        printer.homed()
        printer.run("G1 X50 Y60 Z20 F6000\nM400")
        before = len(printer.status("moves")["ends"])
        printer.run("CALIBRATE_Z")
        ends = printer.status("moves")["ends"][before:]
        places = [(x, y) for x, y, _ in ends]
        first = places.index((206.0, 306.0))
        assert places[first - 1] == (206.0, 60.0)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"nozzle_xy_position": None},
            "no place for the nozzle: set nozzle_xy_position, or add",
        ),
        (
            {"switch_xy_position": None},
            "no place for the switch: set switch_xy_position or"
            " switch_xy_offsets, or add",
        ),
        (
            {"bed_xy_position": None},
            "no place for the bed: set bed_xy_position, or"
            " zero_reference_position in section 'bed_mesh', or add",
        ),
    ],
)
def test_missing_place_is_told_when_klippy_starts(start, changes, words):
    printer = start(changes={**section(**changes), "safe_z_home": None})
    printer.session.require_ready()
    assert words in "\n".join(printer.session.console)


def test_nothing_is_told_of_places_that_are_there(start):
    printer = start()
    printer.session.require_ready()
    assert "no place for" not in "\n".join(printer.session.console)


def test_pressed_plunger_is_told(start):
    probe = replace(SCENES["voron"].world.mag_probe, plunger_on_pin=True)
    printer = start(SCENES["voron"].with_world(mag_probe=probe)).homed()
    lines = printer.run("CALIBRATE_Z")
    told = [line for line in lines if "presses the plunger" in line]
    assert len(told) == 1
    assert "correct switch_xy_position" in told[0]
    assert any(
        "presses the plunger" in warning
        for warning in printer.status("z_calibration")["warnings"]
    )


# An exchanged nozzle


def test_exchanged_nozzle_without_homing_is_calibrated_and_told(start):
    # It grows by 0.7 mm between the runs
    drift = DriftSpec(nozzle=0.1, start=100.0, stop=107.0)
    printer = start(SCENES["voron"].with_world(drift=drift)).homed()
    calibration(printer)
    printer.session.wait(120.0)
    before = len(printer.session.console)
    result, _ = calibration(printer)
    console = "\n".join(printer.session.console[before:])
    assert "switch - nozzle is 5.715 mm and was 6.415 mm" in console
    assert result[1] - result[2] == pytest.approx(BODY - 0.7, abs=MICROSTEP)
    assert len(printer.status("z_calibration")["warnings"]) >= 1
    assert printer.gap() == pytest.approx(0.06, abs=2 * MICROSTEP)


# Margins


def test_one_negative_margin_means_both_directions(start):
    printer = start(changes=section(offset_margins="-1.0")).homed()
    calibration(printer)


def test_margins_that_leave_out_zero(start):
    changes = section(offset_margins="0.1, 0.3")
    calibration(start(changes=changes).homed())
    changes = section(offset_margins="-2.75, -2.35")
    printer = start(changes=changes).homed()
    text = printer.fail("CALIBRATE_Z")
    assert "is outside offset_margins -2.750 to -2.350" in text


# Samples of the bed


def test_the_bed_is_sampled_as_the_section_says(start):
    printer = start(changes=section(samples="2")).homed()
    _, sites = calibration(printer)
    assert sites.count("probe_bed") == 2


def test_the_bed_is_sampled_as_the_probe_says_otherwise(start):
    printer = start(changes={"probe": {"samples": "4"}}).homed()
    _, sites = calibration(printer)
    assert sites.count("probe_bed") == 4
    assert sites.count("nozzle_pin") == 4


# What macros read


def test_settings_are_numbers_and_have_the_defaults(start):
    settings = start().homed().status("configfile")["settings"]
    own = settings["z_calibration"]
    assert own["travel_margin"] == 1.0
    assert own["speed"] == 50.0
    assert own["switch_offset"] == 0.44
    assert list(own["nozzle_xy_position"]) == [206.0, 306.0]
    assert own["probing_first_fast"] is False
    assert settings["stepper_z"]["position_endstop"] == PIN
