"""Baby steps, the Save button, Z_ADJUST: what users change after CALIBRATE_Z."""

from __future__ import annotations

import pytest

from tools.kit.z_calibration import (
    MICROSTEP,
    SAVE,
    calibration,
    kept_runs,
    pending,
    section,
)

ENDSTOP, PROBE = "Z_OFFSET_APPLY_ENDSTOP", "Z_OFFSET_APPLY_PROBE"
# What an offset_gcode has to say that makes another offset of it
OWN = "Z_CALIBRATION_KEEP_OFFSET"
RAISE = "SET_GCODE_OFFSET Z_ADJUST=0.02 MOVE=1"
# 0.06 mm are between nozzle and bed at Z=0
USUAL_GAP = 0.06


def test_baby_steps_are_there_again_in_the_next_run(start):
    printer = start().homed()
    calibration(printer)
    printer.run(RAISE)
    lines = printer.run(SAVE)
    assert lines[0] == (
        "// z_calibration: switch_offset=0.440 - (G-code offset=0.180 - 0.160"
        " of CALIBRATE_Z) --> new switch_offset=0.420"
    )
    assert lines[1] == "// z_calibration: switch_offset: 0.420"
    assert pending(printer) == {"z_calibration": {"switch_offset": "0.420"}}
    # Nothing has moved, and nothing counts twice
    assert printer.offset() == pytest.approx(0.18)
    # What macros read of it is what is in force
    status = printer.status("z_calibration")
    assert (status["valid"], status["measured"]) == (True, True)
    assert status["last_z_offset"] == pytest.approx(0.18)
    result = status["last_result"]
    numbers = result["switch_offset"], result["offset"]
    assert numbers == pytest.approx((0.42, 0.18))
    text = "// z_calibration: nothing was changed with baby steps since"
    assert printer.run(SAVE)[0].startswith(text)
    result, _ = calibration(printer)
    assert result[3:] == pytest.approx((0.42, 0.18), abs=0.001)
    gap = USUAL_GAP + 0.02
    assert printer.gap() == pytest.approx(gap, abs=2 * MICROSTEP)
    # Later ones count from the run of now
    printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.05")
    assert printer.run(f"{SAVE} SAVE=0")[0].endswith("new switch_offset=0.470")
    assert pending(printer)["z_calibration"] == {"switch_offset": "0.420"}
    assert calibration(printer)[0][3] == 0.47
    # What was not handed over yet is, also without another one
    printer.run(SAVE)
    assert pending(printer)["z_calibration"] == {"switch_offset": "0.470"}


# The second time it sets just what was in force
@pytest.mark.slow
def test_offset_gcode_that_sets_the_same_again(start):
    adding = "SET_GCODE_OFFSET Z={(params.Z|float + 0.1)|round(4)}"
    printer = start(changes=section(offset_gcode=f"\n  {adding}\n  {OWN}"))
    printer.homed()
    for _ in range(2):
        printer.run("G28\nCALIBRATE_Z")
        assert printer.status("z_calibration")["valid"]
    lines = printer.run("Z_CALIBRATION_SAVE_GCODE_OFFSET SAVE=0")
    assert any("nothing was changed with baby steps" in n for n in lines)


@pytest.mark.slow
def test_what_offset_gcode_adds_is_no_correction(start):
    adding = "SET_GCODE_OFFSET Z={params.Z|float + 0.1}"
    printer = start(changes=section(offset_gcode=f"\n  {adding}\n  {OWN}"))
    printer.homed()
    calibration(printer)
    printer.run(f"{RAISE}\n{SAVE}")
    status = printer.status("z_calibration")
    assert status["last_z_offset"] == pytest.approx(0.18)
    assert printer.offset() == pytest.approx(0.28)
    assert status["valid"]
    printer.run(f"SET_GCODE_OFFSET Z={status['last_z_offset']}")
    assert printer.status("z_calibration")["valid"]


def test_offset_set_again_with_three_digits_is_the_same(start):
    printer = start(changes=section(switch_offset="0.4404")).homed()
    calibration(printer)
    offset = printer.offset()
    printer.run(f"SET_GCODE_OFFSET Z={offset:.3f}")
    assert 0.0 < abs(printer.offset() - offset) < 0.0005
    assert printer.status("z_calibration")["valid"]
    printer.run(f"{RAISE}\n{SAVE}")
    assert pending(printer)["z_calibration"] == {"switch_offset": "0.420"}
    printer.run(f"SET_GCODE_OFFSET Z={offset + 0.001}")
    assert not printer.status("z_calibration")["valid"]


def test_two_corrections_of_one_run_add_up(start):
    printer = start().homed()
    # Of the run itself, not of the section
    calibration(printer, "CALIBRATE_Z SWITCH_OFFSET=0.5")
    printer.run(f"{RAISE}\n{SAVE}\n{RAISE}\n{SAVE}")
    assert pending(printer)["z_calibration"] == {"switch_offset": "0.460"}


@pytest.mark.parametrize("button", [ENDSTOP, PROBE])
def test_button_that_saves_baby_steps(start, button):
    printer = start(changes=section(save_button="switch_offset")).homed()
    # As the host has it, until there is a result
    printer.run(f"{RAISE}\n{button}\nSET_GCODE_OFFSET Z=0")
    own = pending(printer)
    assert list(own) == ["probe" if button == PROBE else "stepper_z"]
    calibration(printer)
    # After a print
    printer.run(f"{RAISE}\nM84")
    lines = printer.run(button)
    assert "// z_calibration: switch_offset: 0.420" in lines
    saved = {**own, "z_calibration": {"switch_offset": "0.420"}}
    assert pending(printer) == saved
    # What is unlikely is not for a button
    printer.run("SET_GCODE_OFFSET Z_ADJUST=1")
    assert "or the G-code offset is none of CALIBRATE_Z" in printer.fail(button)
    printer.run("SET_GCODE_OFFSET Z=0.3")
    text = printer.fail(button)
    assert "which is no baby step" in text
    # It takes no parameter
    assert f"or run {SAVE} FORCE=1 if what is set is right" in text
    # Homed again: the host's
    lines = printer.run(f"G28\nM84\nSET_GCODE_OFFSET Z=0.3\n{button}")
    assert pending(printer) != saved
    text = f"{button} saves as ever, and nothing goes into switch_offset"
    assert text in "\n".join(lines)


@pytest.mark.slow
@pytest.mark.parametrize("button", [ENDSTOP, PROBE])
def test_button_that_saves_in_vain_is_told_of_once(start, button):
    printer = start().homed()
    hint = f"CALIBRATE_Z measures anew what {button} saves: the baby step of"
    assert hint not in "\n".join(printer.run(button))
    calibration(printer)
    assert hint not in "\n".join(printer.run(button))
    printer.run(RAISE)
    text = "\n".join(printer.run(button))
    assert f"{hint} 0.020 is gone then" in text
    assert "'save_button: switch_offset' in section 'z_calibration'" in text
    assert "z_calibration" not in pending(printer)
    assert pending(printer)
    assert hint not in "\n".join(printer.run(button))


def test_adjustment_of_a_plate(start):
    changes = section(offset_margins="-0.2, 0.2")
    printer = start(changes=changes).homed()
    lines = printer.run("CALIBRATE_Z Z_ADJUST=0.1")
    # 0.16 is within the margins, 0.26 is not
    told = [line for line in lines if "Z-CALIBRATION: offset" in line]
    assert told[0].startswith("// Z-CALIBRATION: offset 0.260 +-")
    assert told[0].endswith(" mm, with Z_ADJUST=0.100")
    status = printer.status("z_calibration")
    assert status["z_adjust"] == 0.1
    assert status["last_z_offset"] == pytest.approx(0.26, abs=0.001)
    assert status["last_result"]["offset"] == pytest.approx(0.16, abs=0.001)
    gap = USUAL_GAP + 0.1
    assert printer.gap() == pytest.approx(gap, abs=2 * MICROSTEP)
    # It is no baby step, and nothing is learned from it
    text = "// z_calibration: nothing was changed with baby steps since"
    assert printer.run(SAVE)[0].startswith(text)
    beside = "G1 X20 Y305 F6000\nG1 Z0.1 F900\nM400"
    (answer,) = printer.run(f"{beside}\nCALCULATE_SWITCH_OFFSET")
    assert "(current_z=0.360 - z_offset=0.260)" in answer
    printer.run("G1 Z20 F900")
    result, _ = calibration(printer)
    assert result[-1] == pytest.approx(0.16, abs=0.001)
    assert printer.status("z_calibration")["z_adjust"] == 0.0
    assert [run["z_adjust"] for run in kept_runs(printer)] == [0.1, 0.0]


def test_what_counted_before_the_paper_is_not_saved_after_it(start):
    printer = start().homed()
    calibration(printer)
    printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.05")
    printer.run(f"{SAVE} SAVE=0")
    beside = "G1 X20 Y305 F6000\nG1 Z-0.02 F900\nM400"
    told = printer.run(f"{beside}\nCALCULATE_SWITCH_OFFSET SAVE=1")
    assert "switch_offset: 0.510" in "\n".join(told)
    saved = {"z_calibration": {"switch_offset": "0.510"}}
    assert pending(printer) == saved
    assert "0.490" not in "\n".join(printer.run(SAVE))
    assert pending(printer) == saved
