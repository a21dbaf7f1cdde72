"""A bed that is where offset_margins do not look for it: what is said of it."""

from __future__ import annotations

import re

import pytest

from simprinter import Fault
from tools.kit.z_calibration import calibration, section

BELOW = "the bed is below the low end of offset_margins (%s), or the probe"
TRY = re.compile(r"(\w+) of section '(\w+)' \((\S+) - (\S+): try (\S+)\)")


# How much too low (mm) what Z is homed at is
@pytest.mark.parametrize(
    ("scene", "section_name", "option", "right", "low"),
    [
        ("voron", "stepper_z", "position_endstop", 1.6, 1.2),
        ("separate_pin", "probe", "z_offset", 6.9, 1.3),
    ],
)
def test_bed_that_is_lower_is_told_without_a_number(
    start, scene, section_name, option, right, low
):
    changes = {section_name: {option: str(right - low)}}
    printer = start(scene, changes=changes).homed()
    printer.run("SET_GCODE_OFFSET Z=0.1")
    text = printer.fail("CALIBRATE_Z")
    assert text.startswith("z_calibration: bed: No trigger on probe after full")
    assert BELOW % "-1.000" in text
    checks = (
        "is dead; check that the plate is on, the probe (QUERY_PROBE) and"
        " bed_xy_position, and that Z was homed (G28 Z) after any levelling;"
    )
    assert checks in text
    assert text.endswith(
        f"only then correct {option} of section '{section_name}'"
    )
    assert printer.offset() == pytest.approx(0.1)


def test_value_that_is_named_is_a_good_one(start):
    """The bed is found, above the margins."""
    changes = {"stepper_z": {"position_endstop": "3"}}
    text = start(changes=changes).homed().fail("CALIBRATE_Z")
    (found,) = TRY.findall(text.replace("\n", " "))
    assert found[:3] == ("position_endstop", "stepper_z", "3.000")
    assert float(found[4]) == pytest.approx(3.0 - 1.56, abs=0.01)
    changes = {"stepper_z": {"position_endstop": found[4]}}
    printer = start(changes=changes).homed()
    calibration(printer)
    assert printer.gap() == pytest.approx(printer.scene.formula_gap(), abs=0.01)


# Margins that are above 0; a touch that has met the bed before
@pytest.mark.slow
@pytest.mark.parametrize(
    ("changes", "touch"),
    [
        (section(offset_margins="0.1, 0.3"), 1),
        ({}, 2),
    ],
)
def test_bed_that_is_not_below(start, changes, touch):
    about = {"site": "probe_bed", "touch": touch, "command": "CALIBRATE_Z"}
    faults = [Fault("trigger_never", **about)]
    printer = start(changes=changes, faults=faults)
    printer.machine.tolerate("body_bed", 1.0)
    text = printer.homed().fail("CALIBRATE_Z")
    assert "bed: No trigger on probe" in text
    assert "check bed_xy_position, switch_offset and the probe" in text
    assert "the bed is below" not in text
