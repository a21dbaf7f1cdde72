"""What [z_calibration] does with the user's macros, places and settings."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tools.kit.printer import Printer
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    PIN,
    calibration,
    result_of,
    section,
    with_moves,
)

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
    # As upstream has it, where the offset is set by then
    assert query == "True"
    assert printer.status("z_calibration")["last_query"] is True


# Errors of templates


# Homing


@pytest.mark.slow
@pytest.mark.parametrize("by_macro", [False, True])
def test_start_gcode_may_home(start, by_macro):
    changes = macro("home_it", "G28 Z")
    line = "Home_It" if by_macro else "G28 Z"
    changes.update(section(start_gcode=line))
    printer = start(changes=changes)
    printer.session.require_ready()
    printer.run("G28 X Y")
    calibration(printer)


# before_switch_gcode of a probe that is on the toolhead: its words say nothing


@pytest.mark.slow
@pytest.mark.parametrize(
    ("before_switch", "start_gcode"),
    [
        ("Look_At_It", ""),
        ("look_at_it", "LOOK_AT_IT"),
        ("G0 Z20\n  M117 switch", ""),
        ("{% if True %}LOOK_AT_IT{% endif %}", ""),
        ("SET_PIN PIN=servo VALUE=1", ""),
    ],
)
def test_before_switch_gcode_that_attaches_nothing(
    start, before_switch, start_gcode
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
    for _ in range(2):
        calibration(printer)


@pytest.mark.slow
def test_before_switch_gcode_that_hides_what_attaches(start):
    code = '\n  {% set name = "ATTACH_PROBE" %}\n  {name}'
    printer = start("cartesian", section(before_switch_gcode=code)).homed()
    for _ in range(2):
        calibration(printer)


# Places


@pytest.mark.slow
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
            "no place for the nozzle; run Z_CALIBRATION_SETUP, set"
            " nozzle_xy_position, or add",
        ),
        (
            {"switch_xy_position": None},
            "no place for the switch; run Z_CALIBRATION_SETUP, set"
            " switch_xy_position or switch_xy_offsets, or add",
        ),
        (
            {"bed_xy_position": None},
            "no place for the bed; run Z_CALIBRATION_SETUP, set bed_xy_position,"
            " or zero_reference_position in section 'bed_mesh', or add",
        ),
    ],
)
def test_missing_place_is_told_when_klippy_starts(start, changes, words):
    printer = start(changes={**section(**changes), "safe_z_home": None})
    printer.session.require_ready()
    assert words in "\n".join(printer.session.console)
    printer.run("G28 X Y\nG90\nG1 X206 Y306 F6000\nG28 Z")
    assert words in printer.fail("CALIBRATE_Z")


@pytest.mark.slow
def test_nothing_is_told_of_places_that_are_there(start):
    printer = start()
    printer.session.require_ready()
    assert "no place for" not in "\n".join(printer.session.console)


@pytest.mark.slow
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


# Samples of the bed


@pytest.mark.slow
def test_the_bed_is_sampled_as_the_section_says(start):
    printer = start(changes=section(samples="2")).homed()
    _, sites = calibration(printer)
    assert sites.count("probe_bed") == 2


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
