"""G-code's own state around CALIBRATE_Z: offsets, saved states, tools."""

from __future__ import annotations

import pytest

from tools.kit.klipper_sections import TOOL
from tools.kit.scenes import SCENES, heated
from tools.kit.z_calibration import (
    SAVE,
    assert_unharmed,
    calibration,
    marker,
    pending,
    section,
    validity,
)

OFFSET = 0.16
# The result does not depend on what was there before


RESTORE = "RESTORE_GCODE_STATE NAME=old"


@pytest.mark.parametrize("end_gcode", ["SET_GCODE_OFFSET Z=0", RESTORE])
def test_offset_of_before_does_not_count(start, end_gcode):
    """Nor one that end_gcode leaves at 0, or brings back with a state."""
    macro = {"gcode": f"\n  {end_gcode}"}
    changes = {"gcode_macro END": macro, **section(end_gcode="END")}
    printer = start(changes=changes).homed()
    # At a height where a restored offset meets nothing
    printer.run("G1 X150 Y150 Z20 F6000\nSET_GCODE_OFFSET Z=0.25")
    for _ in range(3):
        printer.run("SAVE_GCODE_STATE NAME=old\nCALIBRATE_Z")
        assert printer.offset() == pytest.approx(OFFSET, abs=0.001)
    status = printer.status("z_calibration")
    assert status["last_z_offset"] == pytest.approx(OFFSET, abs=0.001)
    assert validity(printer) == (True, True, "")
    # The state of before is as it was
    printer.run(f"SET_GCODE_OFFSET Z=0\n{RESTORE}")
    assert printer.offset() == pytest.approx(OFFSET, abs=0.001)


@pytest.mark.parametrize(
    "end_gcode",
    [
        "SET_GCODE_OFFSET Z=0.05",
        "SET_GCODE_OFFSET Z_ADJUST=-0.05",
        # As the original had it, where end_gcode came after the offset
        "SET_GCODE_OFFSET Z={printer.z_calibration.last_z_offset + 0.05}",
        # Of another state than that of the run
        RESTORE,
    ],
)
def test_end_gcode_that_leaves_an_offset_of_its_own_is_refused(
    start, end_gcode
):
    printer = start(changes=section(end_gcode=end_gcode)).homed()
    printer.run("SET_GCODE_OFFSET Z=0.25\nSAVE_GCODE_STATE NAME=old")
    printer.run("SET_GCODE_OFFSET Z=0.3")
    text = printer.fail("CALIBRATE_Z")
    assert "end_gcode has left a G-code Z offset of" in text
    assert text.endswith("by Z_ADJUST, or in offset_gcode")
    assert_unharmed(printer, 0.3)
    assert validity(printer)[:2] == (False, False)


@pytest.mark.parametrize("template", ["start_gcode", "before_switch_gcode"])
def test_offset_that_another_template_leaves_does_not_count(start, template):
    """Such as that of a tool, which T0 sets when start_gcode takes it."""
    attach = "\n  ATTACH_PROBE" if template == "before_switch_gcode" else ""
    code = f"{attach}\n  SET_GCODE_OFFSET Z=0.3"
    changes = {"gcode_macro ATTACH_PROBE": {"gcode": "M400"}}
    changes.update(section(**{template: code}))
    printer = start(changes=changes).homed()
    for _ in range(2):
        calibration(printer)
        assert printer.offset() == pytest.approx(OFFSET, abs=0.001)
        assert validity(printer) == (True, True, "")


@pytest.mark.parametrize("is_own", [False, True])
def test_g92_is_refused(start, is_own):
    """It is no part of the offset, and stays until G28."""
    moved = "G1 Z20 F900\nG92 Z19.7"
    own = {"start_gcode": "\n  G90\n  G1 Z20 F900\n  G92 Z19.7"}
    printer = start(changes={"z_calibration": own} if is_own else None).homed()
    if not is_own:
        printer.run(moved)
    before = len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert "G92 has moved Z=0 by 0.300 mm" in text
    assert "; run G28 before CALIBRATE_Z, or RESTART where that homes" in text
    # Nothing was touched
    assert len(printer.machine.truth.touches) == before
    if not is_own:
        printer.run("G28\nCALIBRATE_Z")
        assert printer.gap() == pytest.approx(0.06, abs=0.005)


def test_g92_of_end_gcode_is_refused(start):
    changes = section(end_gcode="G92 Z19.7")
    printer = start(changes=changes).homed()
    assert "G92 has moved Z=0 by" in printer.fail("CALIBRATE_Z")
    assert_unharmed(printer)


# Whether the offset is still in force


def test_zero_that_g92_has_moved_is_noticed(start):
    printer = start().homed()
    printer.run("CALIBRATE_Z\nG1 Z20 F900\nG92 Z19.7")
    measured, valid, reason = validity(printer)
    assert (measured, valid) == (False, False)
    assert "G92 has moved Z=0 by 0.300 mm" in reason
    # What only makes good for it is no baby step
    printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.3")
    assert "G92 has moved Z=0" in printer.fail(SAVE)
    assert pending(printer) == {}
    printer.run("G28\nCALIBRATE_Z")
    assert validity(printer) == (True, True, "")


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ("PAUSE", "RESUME"),
        ("", "SET_GCODE_OFFSET Z=0.1"),
    ],
)
def test_offset_that_is_gone_is_noticed(start, before, after):
    printer = start(changes={"pause_resume": {}}).homed()
    printer.run(f"SET_GCODE_OFFSET Z=0.1\n{before}\nCALIBRATE_Z")
    assert validity(printer) == (True, True, "")
    printer.run(after)
    is_measured, is_valid, reason = validity(printer)
    assert (is_measured, is_valid) == (True, False)
    assert reason == (
        "the G-code Z offset is 0.100, that of CALIBRATE_Z is 0.160: changed by"
        " baby steps, SET_GCODE_OFFSET, RESUME or RESTORE_GCODE_STATE"
    )
    # By itself, once
    assert told_later(printer) == [f"// z_calibration: {reason}"]
    assert told_later(printer) == []
    why = "is none of baby steps since CALIBRATE_Z"
    if not before:
        why = "was set by SET_GCODE_OFFSET Z=... in place of that"
    assert f"the G-code offset 0.100 {why}" in printer.fail(SAVE)
    assert pending(printer) == {}
    printer.run(f"{SAVE} FORCE=1")
    assert pending(printer)["z_calibration"] == {"switch_offset": "0.500"}
    # Counted once
    assert "nothing was changed" in "".join(printer.run(SAVE))
    printer.run("CALIBRATE_Z")
    # Set again it is valid again
    z_offset = printer.status("z_calibration")["last_z_offset"]
    printer.run(f"SET_GCODE_OFFSET Z={z_offset}")
    assert validity(printer) == (True, True, "")


def shown(printer, words):
    """The lines of the console with these words."""
    return [line for line in printer.session.console if words in line]


def told_later(printer):
    """What the console shows within some seconds while nothing runs."""
    before = len(printer.session.console)
    printer.session.wait(6.0)
    return printer.session.console[before:]


# What a baby step of then is taken back to is no offset that is gone; and what was
# there when it was saved are baby steps
def test_state_of_since_is_as_it_was(start):
    printer = start(changes={"pause_resume": {}}).homed()
    printer.run("CALIBRATE_Z\nSAVE_GCODE_STATE NAME=old")
    printer.run("SET_GCODE_OFFSET Z_ADJUST=0.3")
    assert printer.run(RESTORE) == []
    assert validity(printer) == (True, True, "")
    # An offset that is nobody's baby step was not that of CALIBRATE_Z
    printer.run("SET_GCODE_OFFSET Z=0.3\nSAVE_GCODE_STATE NAME=own")
    printer.run("SET_GCODE_OFFSET Z=1")
    assert printer.run("RESTORE_GCODE_STATE NAME=own") == []
    printer.run(RESTORE)
    printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.05\nPAUSE")
    printer.run("SET_GCODE_OFFSET Z_ADJUST=0.02\nRESUME")
    printer.run(SAVE)
    assert pending(printer)["z_calibration"] == {"switch_offset": "0.490"}


# RESUME takes back what was kept while the print was paused, and nobody wants that
def test_resume_takes_no_baby_step_back(start):
    printer = start(changes={"pause_resume": {}}).homed()
    printer.run("CALIBRATE_Z\nPAUSE")
    printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.02")
    printer.run(f"{SAVE}\nRESUME")
    printer.session.wait(3.0)
    (told,) = shown(printer, "the G-code Z offset is 0.160")
    assert "that of CALIBRATE_Z is 0.140" in told
    assert "0.160 is none of baby steps since CALIBRATE_Z" in printer.fail(SAVE)
    assert pending(printer)["z_calibration"] == {"switch_offset": "0.460"}
    # What is set again counts again
    printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.03")
    printer.run(SAVE)
    assert pending(printer)["z_calibration"] == {"switch_offset": "0.470"}


@pytest.mark.parametrize(
    ("offset_gcode", "offset"),
    [
        # Of a tool, on top
        ("\n  SET_GCODE_OFFSET Z={params.Z|float + 0.1}", OFFSET + 0.1),
        # Kept for later
        ("\n  RESPOND MSG='keep {params.Z}, {rawparams}'", 0.0),
    ],
)
def test_offset_gcode_may_make_another_one_of_it(start, offset_gcode, offset):
    code = f"{offset_gcode}\n  Z_CALIBRATION_KEEP_OFFSET"
    changes = {"respond": {}, **section(offset_gcode=code)}
    printer = start(changes=changes).homed()
    lines = printer.run("CALIBRATE_Z")
    said = "echo: keep 0.160000, Z=0.160000"
    assert (said in lines) == (not offset)
    assert printer.offset() == pytest.approx(offset, abs=0.001)
    assert validity(printer)[:2] == (True, bool(offset))
    printer.run(f"SET_GCODE_OFFSET Z={OFFSET}")
    assert validity(printer) == (True, True, "")


# Another tool


@pytest.mark.parametrize("keeps", [True, False])
def test_offset_of_another_tool_is_no_baby_step(start, tmp_path, keeps):
    path = tmp_path / "temp"
    path.write_text("25000")
    change = "ACTIVATE_EXTRUDER EXTRUDER=%s\n  SET_GCODE_OFFSET Z_ADJUST=%s"
    changes = {
        "extruder1": {**TOOL, "sensor_path": str(path)},
        "respond": {},
        "gcode_macro T0": marker("T0", change % ("extruder", -0.3)),
        "gcode_macro T1": marker("T1", change % ("extruder1", 0.3)),
    }
    if keeps:
        changes.update(section(save_button="switch_offset"))
    printer = start(heated(SCENES["voron"]), changes=changes).homed()
    calibration(printer)
    printer.run("T1")
    told = "extruder1 is active, and CALIBRATE_Z was run with extruder"
    assert validity(printer) == (False, False, told)
    for command in (SAVE, "CALCULATE_SWITCH_OFFSET"):
        assert told in printer.fail(command)
    if keeps:
        assert told in printer.fail("Z_OFFSET_APPLY_ENDSTOP")
        assert pending(printer) == {}
    else:
        # As ever, and without a word of a baby step of 0.3
        lines = printer.run("Z_OFFSET_APPLY_ENDSTOP")
        assert "stepper_z" in pending(printer)
        assert "CALIBRATE_Z measures anew" not in "\n".join(lines)
    printer.run("T0")
    assert validity(printer) == (True, True, "")
    printer.run(f"SET_GCODE_OFFSET Z_ADJUST=0.02\n{SAVE}")
    saved = pending(printer)["z_calibration"]
    assert saved == {"switch_offset": "0.420"}
