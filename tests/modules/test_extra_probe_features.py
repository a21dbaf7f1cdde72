"""EXTRA_PROBE_CALIBRATE where Klipper's own features shift Z: the gap, the line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools.kit.cases import slow
from tools.kit.extra_probe import (
    BED,
    CALIBRATE,
    MICROSTEP,
    NAME,
    PROBE_BED,
    calibrate,
    true_gap,
)
from tools.kit.klipper_sections import bed_mesh, profile
from tools.kit.printer import module_files
from tools.kit.z_calibration import refusal

EXTRAS = Path(__file__).resolve().parents[2] / "tools" / "kit" / "extras"
LOAD = "BED_MESH_PROFILE LOAD=default"
TAKEN_OFF = "where the switch lay, taken off: the offset is"
BEDS = {"membrane": BED, "membrane_and_probe": PROBE_BED}


def mesh(height):
    """[bed_mesh] with a profile that is as high everywhere (mm)."""
    own = bed_mesh("20, 15", "180, 180")
    return {"bed_mesh": own, "bed_mesh default": profile([height] * 3, own)}


def told(lines):
    """What was told of shifts."""
    return [n for n in lines if "taken off" in n or "another feature" in n]


def assert_right(printer):
    assert true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)


@pytest.mark.parametrize("height", [0.2, -0.05])
@pytest.mark.parametrize("scene", ["membrane", "membrane_and_probe"])
def test_mesh_is_taken_off(start, scene, height):
    printer = start(scene, changes=mesh(height)).homed()
    printer.run(LOAD)
    lines = calibrate(printer)
    offset = BEDS[scene] - height
    (line,) = told(lines)
    words = f"// {NAME}: bed_mesh {height:.3f} mm at 30.0, 20.0, {TAKEN_OFF} "
    assert line.startswith(words)
    assert line.endswith(", and right there while that is in force")
    assert printer.offset() == pytest.approx(offset, abs=2 * MICROSTEP)
    last = printer.status(NAME)["last_offset"]
    assert last == pytest.approx(printer.offset(), abs=1e-5)
    assert_right(printer)
    # The result is what was measured
    (result,) = [n for n in lines if "--> new offset=" in n]
    measured = float(result.split("=")[-1])
    assert measured == pytest.approx(BEDS[scene], abs=2 * MICROSTEP)


# As an adaptive one does: the host goes on with its rim
@pytest.mark.slow
@pytest.mark.parametrize("zero", [None, "30, 20", "100, 100"])
def test_mesh_that_ends_before_the_switch(start, zero):
    own = bed_mesh("60, 60", "180, 180", zero_reference_position=zero)
    changes = {"bed_mesh": own, "bed_mesh default": profile([0.2] * 3, own)}
    printer = start("membrane", changes=changes).homed()
    printer.run(LOAD)
    lines = told(calibrate(printer))
    is_zero = zero == "30, 20"
    taken_off = 0.0 if is_zero else 0.2
    wanted = pytest.approx(BED - taken_off, abs=2 * MICROSTEP)
    assert printer.offset() == wanted
    ends = "bed_mesh ends before 30.0, 20.0, where the switch lay"
    assert any(ends in line for line in lines) != is_zero


@pytest.mark.parametrize("height", [0.2, 0.05])
@pytest.mark.parametrize("scene", ["membrane", "membrane_and_probe"])
def test_mesh_is_taken_off_what_is_saved(start, scene, height):
    printer = start(scene, changes=mesh(height)).homed()
    printer.run(LOAD)
    lines = calibrate(printer, f"{CALIBRATE} SAVE=1")
    assert [TAKEN_OFF in line for line in told(lines)] == [True]
    printer.session.restart("SAVE_CONFIG")
    printer.run(f"G28\n{LOAD}")
    assert printer.offset() == 0.0
    assert_right(printer)
    # The bed is no more at Z=0 without the mesh: floors count from where it is
    text = "\n".join(printer.run(CALIBRATE))
    assert ("with a finger" in text) is (height > 0.125)


# One that comes later, such as of PRINT_START
@pytest.mark.parametrize(
    ("scene", "zero", "script", "is_told"),
    [
        ("membrane", None, "", True),
        ("membrane", "30, 20", "", False),
        ("membrane", "100, 100", " SAVE=1", True),
        slow("membrane_and_probe", None, " SAVE=1", True),
        slow("membrane_and_probe", "30, 20", " SAVE=1", False),
    ],
)
@pytest.mark.parametrize("is_in_force", [False, True])
def test_later_mesh_is_told(start, scene, zero, is_told, script, is_in_force):
    own = bed_mesh("20, 15", "180, 180", zero_reference_position=zero)
    changes = {"bed_mesh": own, "bed_mesh default": profile([0.05] * 3, own)}
    printer = start(scene, changes=changes).homed()
    if is_in_force:
        printer.run(LOAD)
    lines = "\n".join(calibrate(printer, CALIBRATE + script))
    assert (TAKEN_OFF in lines) is is_in_force
    # What was taken off is right as long as it is in force.
    is_told = is_told and not is_in_force
    assert ("bed_mesh has no zero at 30.0, 20.0, where" in lines) is is_told


@pytest.mark.parametrize("script", ["", slow(" SAVE=1")])
@pytest.mark.parametrize("scene", ["membrane", slow("membrane_and_probe")])
def test_g92_is_undone(start, scene, script):
    printer = start(scene).homed()
    printer.run("G90\nG1 Z20 F900\nG92 Z10")
    lines = calibrate(printer, CALIBRATE + script)
    words = "G92 had moved Z=0 by 10.000 mm: undone, as G28 does"
    assert [words in line for line in lines].count(True) == 1
    if script:
        assert printer.status("gcode_move")["gcode_position"][2] >= 10.0
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28")
    assert_right(printer)


@pytest.mark.parametrize("is_saved", [False, True])
def test_heat_is_nothing_to_save(start, tmp_path, is_saved):
    path = tmp_path / "temp"
    path.write_text("25000")
    heat = {
        "temp_coeff": "0.002",
        "sensor_type": "temperature_host",
        "sensor_path": str(path),
        "min_temp": "0",
        "max_temp": "100",
        "smooth_time": "1",
    }
    printer = start("membrane", changes={"z_thermal_adjust": heat})
    printer.session.require_ready()
    printer.session.wait(30.0)
    printer.homed()
    path.write_text("75000")
    printer.session.wait(30.0)
    lines = calibrate(printer, f"{CALIBRATE} SAVE={is_saved:d}")
    words = [line.split(": ", 1)[1] for line in told(lines)]
    if is_saved:
        assert words == []
        printer.session.restart("SAVE_CONFIG")
        printer.session.wait(30.0)
        printer.run("G28")
    else:
        (text,) = words
        assert text.startswith("z_thermal_adjust -0.100 mm at 30.0, 20.0, ")
    assert_right(printer)


@pytest.mark.parametrize("is_saved", [True, slow(False)])
def test_offset_of_the_active_tool_is_taken_off(start, is_saved):
    """klipper-toolchanger adds it for good, below the G-code offset."""
    changes = {"tool T0": {"gcode_z_offset": "-0.3", "active": "True"}}
    modules = {**module_files(), "tool": EXTRAS / "tool.py"}
    printer = start("membrane", changes=changes, modules=modules).homed()
    lines = calibrate(printer, f"{CALIBRATE} SAVE={is_saved:d}")
    assert "tool T0 -0.300 mm at 30.0, 20.0" in "\n".join(lines)
    if is_saved:
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28")
    assert_right(printer)
    calibrate(printer)
    assert_right(printer)


def test_what_nobody_knows_is_told_and_stays(start):
    modules = {**module_files(), "lift": EXTRAS / "lift.py"}
    # The mesh is the transform that it is around
    changes = {**mesh(0.0), "lift": {"height": "0.12"}}
    printer = start("membrane", changes=changes, modules=modules).homed()
    (line,) = told(calibrate(printer))
    assert "another feature shifts Z by 0.120 mm there: not taken off" in line
    assert true_gap(printer) == pytest.approx(0.12, abs=2 * MICROSTEP)


# More of what is told: test_auto_z_offset_results.py
@pytest.mark.parametrize(
    ("save", "script", "words"),
    [
        ("", "SET_GCODE_OFFSET Z=0", f"is 0.000, and {CALIBRATE} has set"),
        # It is 0 then, as it should be
        ("SAVE=1", "SET_GCODE_OFFSET Z=0.6", ""),
        # At once, and within a baby step
        ("", "RESTORE_GCODE_STATE", "has brought back the G-code Z offset 0.1"),
    ],
)
def test_offset_that_has_gone_is_told_once(start, save, script, words):
    """A macro of a tool, or at the end of a print, sets 0 without a word."""
    printer = start("membrane").homed()
    printer.run("SET_GCODE_OFFSET Z=0.1\nSAVE_GCODE_STATE")
    calibrate(printer, f"{CALIBRATE} {save}")
    before = len(printer.session.console)
    for _ in range(2):
        printer.run(script)
        printer.session.wait(5.0)
    lines = printer.session.console[before:]
    found = [line for line in lines if "the G-code Z offset" in line]
    assert len(found) == bool(words)
    assert not words or words in found[0]


@pytest.mark.parametrize(
    ("is_moved", "script", "words"),
    [
        (False, "SET_KINEMATIC_POSITION Z=10.5", "Z was homed again or set"),
        (False, "G28", ""),
        # It was not right after G28 when it was set, and is not now
        (True, "G28", "Z was homed again"),
    ],
)
def test_what_moves_z_from_the_offset_is_told_once(
    start, is_moved, script, words
):
    changes = {"force_move": {"enable_force_move": "True"}}
    printer = start("membrane", changes=changes).homed()
    if is_moved:
        z = printer.session.position()[2] - 0.1
        printer.run(f"SET_KINEMATIC_POSITION Z={z:.3f}")
    calibrate(printer)
    seen = len(printer.session.console)
    for _ in range(2):
        printer.run(script)
        printer.session.wait(5.0)
    told_of = f"; the offset of {CALIBRATE} was "
    lines = [n for n in printer.session.console[seen:] if told_of in n]
    assert len(lines) == bool(words)
    assert not words or words in lines[0]


# A textured plate


def test_bed_spread_is_refused_with_the_reason(host):
    text = refusal(host, {NAME: {"bed_spread": "3"}}, "membrane")
    assert "Option 'bed_spread' in section 'extra_probe" in text
    assert "covers texture; remove it" in text
