"""What ends a result, or is no end of it: told once, in the status at once.

Whoever moves on: a macro, a tool changer, the other carriage, G28, a mesh.
"""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from simprinter.hosts.session import GcodeError
from tools.kit import scenes
from tools.kit.docks import DOCK_SCENES
from tools.kit.klipper_sections import TOOL, bed_mesh, profile
from tools.kit.printer import module_files
from tools.kit.scenes import SCENES, heated
from tools.kit.z_calibration import (
    MICROSTEP,
    SAVE,
    SWITCH_OFFSET,
    calibration,
    pending,
    section,
    touched_sites,
    validity,
)

EXTRAS = Path(__file__).resolve().parents[2] / "tools" / "kit" / "extras"
OFFSET = 0.16
GAP = 0.06
WAS = "; the offset of CALIBRATE_Z was 0.160"
NOTHING = "nothing was changed with baby steps"
ADJUST = "SET_GCODE_OFFSET Z_ADJUST="
ONE, TWO = [
    f"ACTIVATE_EXTRUDER EXTRUDER={n}" for n in ("extruder", "extruder1")
]


def with_two_extruders(start, tmp_path, **more):
    path = tmp_path / "temp"
    path.write_text("25000")
    changes = {"extruder1": {**TOOL, "sensor_path": str(path)}, **more}
    return start(heated(SCENES["voron"]), changes=changes).homed()


def told(printer, script, seconds=5.0):
    """Run it; the lines of z_calibration until it has looked twice."""
    before = len(printer.session.console)
    printer.run(script)
    printer.session.wait(seconds)
    lines = printer.session.console[before:]
    return [n for n in lines if n.startswith("// z_calibration: ")]


######################################################################
# Told once, with the number
######################################################################

MESH = bed_mesh("50, 50", "250, 250")
CHANGES = {
    "bed_mesh": MESH,
    "bed_mesh default": profile([0.2] * 3, MESH),
}


@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("G28 Z", f"Z was homed again{WAS}"),
        (
            "BED_MESH_PROFILE LOAD=default",
            "bed_mesh is 0.200 mm at 150.0, 150.0 and was 0.000 mm there after"
            " CALIBRATE_Z",
        ),
        ("SET_GCODE_OFFSET Z=0", "the G-code Z offset is 0.000, that of"),
        ("SET_GCODE_OFFSET Z_ADJUST=0.6", "the G-code Z offset is 0.760, that"),
        ("G92 Z5", "G92 has moved Z=0 by"),
        ("SET_KINEMATIC_POSITION Z=20", f"Z was homed again or set{WAS}"),
    ],
)
def test_what_ends_a_result_is_told_once(start, script, words):
    changes = {"force_move": {"enable_force_move": "True"}, **CHANGES}
    printer = start(changes=changes).homed()
    assert told(printer, "CALIBRATE_Z")[-1].startswith(
        "// z_calibration: bed at"
    )
    lines = told(printer, script)
    assert validity(printer)[1] is False
    assert len(lines) == 1 and words in lines[0]
    assert told(printer, "G4 P100") == []
    # The next result has its own
    printer.run("G92 Z20\nG28")
    lines = told(printer, "CALIBRATE_Z\nG28 Z")
    assert sum("Z was homed again" in line for line in lines) == 1


@pytest.mark.parametrize(
    "script", ["M84", "SET_GCODE_OFFSET Z_ADJUST=0.05", "G1 X100 F6000"]
)
def test_what_everybody_does_is_not_told(start, script):
    """The motors are off after each print; baby steps are the user's."""
    printer = start().homed()
    printer.run("CALIBRATE_Z")
    assert told(printer, script) == []


def test_levelling_is_told(start):
    """Before that one motor was some steps off."""
    levels = DOCK_SCENES["dock_gantry_switch"].sections["quad_gantry_level"]
    changes = {
        "quad_gantry_level": levels,
        "force_move": {"enable_force_move": "True"},
    }
    printer = start(changes=changes).homed()
    printer.run("FORCE_MOVE STEPPER=stepper_z DISTANCE=0.5 VELOCITY=5")
    printer.run("CALIBRATE_Z")
    words = "the Z motors were levelled"
    (line,) = told(printer, "QUAD_GANTRY_LEVEL")
    assert line.startswith(f"// z_calibration: {words}; the offset of")
    assert validity(printer) == (False, False, words)


def test_macro_that_is_still_at_work_is_not_interrupted(start):
    """Tool changers set 0 for a moment, a mesh is cleared before it is probed."""
    back = "\n  SET_GCODE_OFFSET Z={printer.z_calibration.applied}"
    busy = "\n  CALIBRATE_Z\n  SET_GCODE_OFFSET Z=0\n  G4 P9000\n  BACK"
    changes = {
        "gcode_macro BEGIN": {"gcode": busy},
        "gcode_macro BACK": {"gcode": back},
    }
    printer = start(changes=changes).homed()
    lines = told(printer, "BEGIN")
    assert not any("G-code Z offset" in line for line in lines)
    assert validity(printer) == (True, True, "")


######################################################################
# What the G-code adds that has called CALIBRATE_Z, and the user's baby steps after it
######################################################################


def begin(*lines):
    """A macro that calibrates, and goes on with these lines."""
    code = "".join(f"\n  {line}" for line in ("CALIBRATE_Z", *lines))
    return {"gcode_macro BEGIN": {"gcode": code}}


def macro(name, *lines):
    return {f"gcode_macro {name}": {"gcode": "\n  " + "\n  ".join(lines)}}


def answer(printer, script):
    """What is said to it, were it an error."""
    try:
        return "\n".join(printer.run(script))
    except GcodeError as error:
        return str(error)


def assert_saved(printer, more):
    """switch_offset is by so much (mm) larger with SAVE_CONFIG, and macros read the same."""
    waiting = float(pending(printer)["z_calibration"]["switch_offset"])
    assert waiting - SWITCH_OFFSET == pytest.approx(more, abs=0.002)
    # Of that nozzle and plate, without what a macro adds
    applied = printer.status("z_calibration")["applied"]
    assert applied == pytest.approx(OFFSET - more, abs=0.003)


PAUSED = {"pause_resume": {}}
OLD_STATE = "SET_GCODE_OFFSET Z=0.1\nSAVE_GCODE_STATE NAME=old"
RESTORE = "RESTORE_GCODE_STATE NAME=old"
# Used later by SET_GCODE_OFFSET
KEEP = macro(
    "KEEP",
    "SET_GCODE_VARIABLE MACRO=KEEP VARIABLE=z VALUE={params.Z}",
    "Z_CALIBRATION_KEEP_OFFSET",
)
KEEP["gcode_macro KEEP"]["variable_z"] = "0.0"
KEPT = {
    **KEEP,
    **macro("USE_IT", 'SET_GCODE_OFFSET Z={printer["gcode_macro KEEP"].z}'),
    **section(offset_gcode="KEEP Z={params.Z}"),
}
# As CALIBRATE_Z_IF_NEEDED of the documents: a print that keeps the result sets it again
PRINTS = {
    **macro("FIRST", "CALIBRATE_Z", ADJUST + "{params.PLATE}"),
    **macro(
        "SECOND",
        "SET_GCODE_OFFSET Z={printer.z_calibration.applied}",
        ADJUST + "{params.PLATE}",
    ),
}
PRINT = macro(
    "PRINT",
    *("SAVE_GCODE_STATE NAME=start", "G28", "CALIBRATE_Z", f"{ADJUST}-0.06"),
)
# As some tool changes do, with the steps in it
AGAIN = macro(
    "AGAIN",
    "{% set z = printer.gcode_move.homing_origin.z %}",
    *("SET_GCODE_OFFSET Z=0", "SET_GCODE_OFFSET Z={z}"),
)
NO_STEP = "is none of baby steps"
TOLD = "the G-code Z offset is 0.100, that of CALIBRATE_Z is"
# Sections, and scripts: with words of the answer, or with how much larger (mm)
# switch_offset is by then; "" is to wait, with words that are told meanwhile, if any
STEPS = {
    # It has not ended then
    "of the macro itself": (begin(f"{ADJUST}-0.06", SAVE), [("BEGIN", 0.06)]),
    # A user may press the button right then
    "at once when it has ended": (
        begin(f"{ADJUST}0.1"),
        ["BEGIN", f"{ADJUST}0.02", (SAVE, -0.02)],
    ),
    "there and back, with a pause": (
        {**begin(f"{ADJUST}-0.06"), **PAUSED},
        [
            *("BEGIN", "", (f"{ADJUST}0.02\n{SAVE}\n{SAVE}", -0.02)),
            *((SAVE, NOTHING), "PAUSE\nRESUME", ""),
            *(f"{ADJUST}-0.02", (SAVE, 0.0), "PAUSE\nRESUME", ""),
        ],
    ),
    "on a large one": (
        begin(f"{ADJUST}0.4"),
        ["BEGIN", "", f"{ADJUST}0.2", "", (SAVE, -0.2)],
    ),
    # Counted from what was measured, 0.160
    "after an old state": (
        begin(RESTORE),
        [OLD_STATE, "BEGIN", ("", TOLD), f"{ADJUST}0.08", (SAVE, -0.02)],
    ),
    # One for a plate that replaces what was just measured
    "after another one": (
        begin("SET_GCODE_OFFSET Z=0.1"),
        [
            *("BEGIN", ("", TOLD), f"{ADJUST}0.01"),
            (SAVE, "0.110 was set by SET_GCODE_OFFSET Z="),
        ],
    ),
    "after the same one": (
        {**begin(f"{ADJUST}-0.06"), **AGAIN},
        ["BEGIN", "", f"{ADJUST}0.02", "AGAIN", "", (SAVE, -0.02)],
    ),
    "kept for later and never used": (
        KEPT,
        ["CALIBRATE_Z", f"{ADJUST}0.02", (SAVE, NO_STEP)],
    ),
    **{
        f"plates {first} and {second} with one result": (
            PRINTS,
            [
                *(f"FIRST PLATE={first}", "", f"SECOND PLATE={second}", ""),
                *((SAVE, NOTHING), f"{ADJUST}0.02", (SAVE, -0.02)),
            ],
        )
        for first, second in ((0.0, -0.06), (-0.06, 0.0), (-0.06, -0.06))
    },
    # Both measure the same, so the offset is one of before
    "two prints with a state": (
        {**PRINT, **PAUSED},
        [
            *("PRINT", "", "PAUSE\nRESUME", "", (SAVE, NOTHING)) * 2,
            *(f"{ADJUST}0.02", "PAUSE\nRESUME", "", (SAVE, -0.02)),
        ],
    ),
    **{
        f"none by {script}": (
            {},
            [
                OLD_STATE,
                "SET_GCODE_OFFSET Z=0\nCALIBRATE_Z",
                *(f"{RESTORE}\n{script}", (SAVE, f"0.100 {NO_STEP}")),
            ],
        )
        for script in ("SET_GCODE_OFFSET X=0 Y=0", f"{ADJUST}0")
    },
}


@pytest.mark.parametrize(("changes", "steps"), STEPS.values(), ids=STEPS)
def test_what_baby_steps_count_from(start, changes, steps):
    printer = start(changes=changes).homed()
    console = printer.session.console
    seen = len(console)
    for step in steps:
        script, wanted = step if isinstance(step, tuple) else (step, None)
        if not script:
            printer.session.wait(5.0)
            lines = [n for n in console[seen:] if ": the G-code Z offset" in n]
            seen = len(console)
            assert len(lines) == bool(wanted)
            assert (wanted or "") in "".join(lines)
        elif isinstance(wanted, str):
            assert wanted in answer(printer, script)
        else:
            printer.run(script)
            if wanted is not None:
                assert_saved(printer, wanted)


@pytest.mark.parametrize(
    ("lines", "more"),
    [
        # Such as to prime both; the other one's comes to what was applied, by chance
        ((f"{ADJUST}-0.06", TWO, f"{ADJUST}0.06"), f"{ADJUST}-0.06"),
        ((TWO, f"{ADJUST}0.3"), f"{ADJUST}-0.3"),
    ],
)
def test_other_tool_at_the_end_of_the_macro(start, tmp_path, lines, more):
    printer = with_two_extruders(start, tmp_path, **begin(*lines))
    told(printer, "BEGIN")
    printer.run(f"{ONE}\n{more}")
    assert NOTHING in "".join(printer.run(SAVE))
    printer.run(f"{ADJUST}0.02\n{SAVE}")
    assert_saved(printer, -0.02)


def test_offset_that_is_kept_for_later(start):
    """It leaves that of before, and counts when it is used."""
    printer = start(changes=KEPT).homed()
    printer.run("SET_GCODE_OFFSET Z=0.5\nSAVE_GCODE_STATE NAME=old")
    lines = told(printer, "CALIBRATE_Z")
    assert printer.offset() == pytest.approx(0.5)
    assert validity(printer)[:2] == (True, False)
    # It is the user who sets it, when it is wanted
    assert not any("the G-code Z offset" in line for line in lines)
    printer.run("USE_IT")
    assert validity(printer) == (True, True, "")
    assert NOTHING in "".join(printer.run(SAVE))
    printer.run(f"{ADJUST}0.02\n{SAVE}")
    assert_saved(printer, -0.02)


def test_offset_that_is_set_is_no_baby_step(start):
    """The web interfaces send Z_ADJUST; a macro that sets one has lost ours."""
    printer = start(changes=PAUSED).homed()
    printer.run("CALIBRATE_Z\nSET_GCODE_OFFSET Z=0.1")
    text = printer.fail(SAVE)
    assert "the G-code offset 0.100 was set by SET_GCODE_OFFSET Z=" in text
    assert "in place of that of CALIBRATE_Z, which is no baby step" in text
    # Nor with a step on top of it, whatever comes between
    for script in (
        *("M400", "PROBE_Z_ACCURACY", "PAUSE\nRESUME"),
        "CALIBRATE_Z_ACCURACY CYCLES=2",
    ):
        printer.run(f"{script}\n{ADJUST}0.01")
        assert "no baby step" in printer.fail(SAVE)
    printer.run(f"{SAVE} FORCE=1")
    assert_saved(printer, OFFSET - 0.14)
    # From here on they count again
    printer.run(f"{ADJUST}0.01\n{SAVE}")
    assert_saved(printer, OFFSET - 0.15)
    # What was reset is none, either
    printer.run("SET_GCODE_OFFSET Z=0")
    assert "the G-code offset is 0, not that of CALIBRATE_Z" in printer.fail(
        SAVE
    )


def printing(printer, tmp_path, *lines):
    """Print a file with these lines, which extrudes nothing."""
    (tmp_path / "print.gcode").write_text("\n".join([*lines, "G4 P9000", ""]))
    printer.run("SDCARD_PRINT_FILE FILENAME=print.gcode")


# What is run before, and the lines of the file
FILES = {
    "its own lines": ("", ("CALIBRATE_Z", "G4 P4000")),
    # What is extruded there is no first layer that a user has judged
    "a macro with a purge line": ("", ("BEGIN",)),
    "a print that keeps the result": ("CALIBRATE_Z", ()),
}


@pytest.mark.parametrize(("before", "lines"), FILES.values(), ids=FILES)
def test_lines_of_a_file_are_no_steps_of_a_user(start, tmp_path, before, lines):
    """Slicers have the plate's or the filament's G-code on lines of their own."""
    card = {"virtual_sdcard": {"path": str(tmp_path)}}
    purges = begin("G1 E5 F300", "G4 P4000")
    cold = {"extruder": {"min_extrude_temp": "0"}}
    changes = {**card, **purges, **cold}
    printer = start(heated(SCENES["voron"]), changes=changes).homed()
    told(printer, before)
    printing(printer, tmp_path, *lines, f"{ADJUST}-0.06")
    printer.session.wait(60.0)
    printer.run("SDCARD_RESET_FILE")
    printer.session.wait(3.0)
    assert printer.offset() == pytest.approx(OFFSET - 0.06, abs=0.003)
    assert NOTHING in "".join(printer.run(SAVE))
    printer.run(f"{ADJUST}0.02\n{SAVE}")
    assert_saved(printer, -0.02)


def test_mesh_after_it_in_the_same_file_is_told_at_once(start, tmp_path):
    sections = {"virtual_sdcard": {"path": str(tmp_path)}, **CHANGES}
    printer = start(changes=sections).homed()
    load = "BED_MESH_PROFILE LOAD=default"
    waits = ["G4 P500"] * 200
    printing(printer, tmp_path, "CALIBRATE_Z", load, *waits)
    # Not when it has ended, or extrudes
    printer.session.wait(60.0)
    assert printer.status("print_stats")["state"] == "printing"
    lines = [n for n in printer.session.console if "bed_mesh is 0.200 mm" in n]
    assert len(lines) == 1


def test_lines_before_it_in_a_file_are_not_told(start, tmp_path):
    """They end the result of the print before, and CALIBRATE_Z comes some lines later."""
    sections = {"virtual_sdcard": {"path": str(tmp_path)}}
    printer = start(changes=sections).homed()
    told(printer, "CALIBRATE_Z")
    lines = ("SET_GCODE_OFFSET Z=0", "G4 P5000", "G28", "G4 P9000")
    printing(printer, tmp_path, *lines, "CALIBRATE_Z")
    printer.session.wait(120.0)
    assert not any(WAS in line for line in printer.session.console)
    assert not any("Z offset is 0.000" in n for n in printer.session.console)
    printing(printer, tmp_path, "G28 Z")
    printer.session.wait(60.0)
    printer.run("SDCARD_RESET_FILE")
    printer.session.wait(5.0)
    assert sum(WAS in line for line in printer.session.console) == 1


######################################################################
# Another nozzle
######################################################################


def test_another_extruder_is_told_once(start, tmp_path):
    printer = with_two_extruders(start, tmp_path)
    printer.run("CALIBRATE_Z")
    reason = "extruder1 is active, and CALIBRATE_Z was run with extruder"
    printer.run(TWO)
    assert validity(printer) == (False, False, reason)
    assert told(printer, "G4 P1") == [f"// z_calibration: {reason}{WAS}"]
    assert told(printer, f"{ONE}\nG4 P3000\n{TWO}") == []


def test_each_extruder_has_a_result_of_its_own(start, tmp_path):
    """As tools.cfg keeps them: the offset of the active one is in force."""
    printer = with_two_extruders(start, tmp_path)
    printer.run(f"CALIBRATE_Z\n{TWO}\nCALIBRATE_Z Z_ADJUST=0.1")
    assert validity(printer) == (True, True, "")
    offset = printer.offset() - 0.1
    assert told(printer, f"{ONE}\nSET_GCODE_OFFSET Z={offset:.6f}") == []
    assert validity(printer) == (True, True, "")
    printer.run(f"SET_GCODE_OFFSET Z={offset + 0.1:.6f}")
    assert "that of CALIBRATE_Z is 0.160" in validity(printer)[2]


######################################################################
# klipper-toolchanger shifts Z below the G-code offset
######################################################################


def changer(start, second, first="0", **options):
    changes = {
        "tool T0": {"gcode_z_offset": first, "active": "True"},
        "tool T1": {"gcode_z_offset": second},
        **section(**options),
    }
    modules = {**module_files(), "tool": EXTRAS / "tool.py"}
    return start(changes=changes, modules=modules).homed()


@pytest.mark.parametrize("shift", [-0.3, 0.0])
def test_offset_of_the_active_tool_is_taken_off(start, shift):
    """It counted twice: 0.24 mm into the bed, or as much too high."""
    printer = changer(start, str(shift))
    printer.run("FETCH_TOOL TOOL=T1")
    lines = printer.run("CALIBRATE_Z")
    words = f"tool T1 shifts Z by {shift:.3f} mm there now: taken off"
    assert any(words in line for line in lines) == bool(shift)
    assert not any("another feature" in line for line in lines)
    assert printer.offset() == pytest.approx(OFFSET - shift, abs=0.003)
    assert printer.gap() == pytest.approx(GAP, abs=2 * MICROSTEP)
    assert validity(printer) == (True, True, "")


def test_one_result_is_for_all_tools_of_a_changer(start):
    """Their own offsets are the user's; both may be calibrated, too."""
    printer = changer(start, "-0.3")
    printer.run("CALIBRATE_Z")
    assert told(printer, "FETCH_TOOL TOOL=T1") == []
    assert validity(printer) == (True, True, "")
    printer.run("FETCH_TOOL TOOL=T1\nCALIBRATE_Z")
    assert printer.gap() == pytest.approx(GAP, abs=2 * MICROSTEP)
    second = printer.offset()
    assert told(printer, "FETCH_TOOL TOOL=T0") == []
    assert validity(printer) == (True, True, "")
    # Each may keep its own, as tools.cfg does
    assert told(printer, f"SET_GCODE_OFFSET Z={OFFSET:.6f}") == []
    assert validity(printer) == (True, True, "")
    printer.run(f"FETCH_TOOL TOOL=T1\nSET_GCODE_OFFSET Z={second:.6f}")
    assert validity(printer) == (True, True, "")
    assert printer.gap() == pytest.approx(GAP, abs=2 * MICROSTEP)


def test_steps_count_from_the_result_of_the_tool_that_is_active(start):
    printer = changer(start, "-0.3")
    printer.run("CALIBRATE_Z\nSAVE_GCODE_STATE NAME=t0")
    printer.run("FETCH_TOOL TOOL=T1\nCALIBRATE_Z Z_ADJUST=0.1")
    printer.run("FETCH_TOOL TOOL=T0\nRESTORE_GCODE_STATE NAME=t0")
    assert validity(printer) == (True, True, "")
    printer.run(f"{ADJUST}0.02\n{SAVE}")
    saved = pending(printer)["z_calibration"]["switch_offset"]
    assert float(saved) == pytest.approx(SWITCH_OFFSET - 0.02)


def test_step_does_not_bring_an_old_result_back(start):
    """Of T0 from before Z was homed; the last one is for both."""
    printer = changer(start, "-0.3")
    printer.run("CALIBRATE_Z\nG28\nFETCH_TOOL TOOL=T1\nCALIBRATE_Z")
    printer.run("FETCH_TOOL TOOL=T0")
    assert validity(printer) == (True, True, "")
    lines = told(printer, "SET_GCODE_OFFSET Z_ADJUST=0.02")
    assert lines == []
    printer.run(SAVE)
    saved = pending(printer)["z_calibration"]["switch_offset"]
    assert float(saved) == pytest.approx(SWITCH_OFFSET - 0.02)


def test_tools_without_offsets_of_their_own_are_calibrated_each(start):
    """With 0 everywhere the changer does not know what they differ by."""
    printer = changer(start, "0")
    printer.run("CALIBRATE_Z")
    lines = told(printer, "FETCH_TOOL TOOL=T1")
    assert (
        len(lines) == 1
        and "tool T1 is active, and CALIBRATE_Z was" in (lines[0])
    )
    assert validity(printer)[:2] == (False, False)


def test_offset_of_the_tool_that_is_changed_afterwards_is_told(start):
    printer = changer(start, "0", first="0.1")
    printer.run("CALIBRATE_Z")
    lines = told(printer, "SHIFT_TOOL TOOL=T0 Z=0.25")
    assert (
        "gcode_z_offset of section 'tool T0' is 0.250 and was 0.100"
        in (lines[0])
    )


def test_older_changer_has_it_in_the_gcode_offset(start):
    """There it is no transform, and nothing is taken off for it."""
    tool = {"gcode_z_offset": "-0.3", "active": "True", "is_older": "True"}
    changes = {"tool T0": tool}
    modules = {**module_files(), "tool": EXTRAS / "tool.py"}
    printer = start(changes=changes, modules=modules).homed()
    lines = told(printer, "CALIBRATE_Z")
    assert not any("shifts Z" in line for line in lines)
    assert printer.gap() == pytest.approx(GAP, abs=2 * MICROSTEP)


def test_tool_that_start_gcode_fetches(start):
    printer = changer(start, "0.2", start_gcode="FETCH_TOOL TOOL=T1")
    printer.run("CALIBRATE_Z")
    assert printer.gap() == pytest.approx(GAP, abs=2 * MICROSTEP)


def test_tool_of_another_plugin_is_none_of_a_changer(start):
    changes = {"tool T1": {"gcode_z_offset": "0.2", "is_other": "1"}}
    modules = {**module_files(), "tool": EXTRAS / "tool.py"}
    calibration(start(changes=changes, modules=modules).homed())


######################################################################
# The other carriage of an IDEX
######################################################################


def idex(start, park=None, scene="cartesian", **more):
    """A printer with two carriages, both homed, whose first is at X=park, or parked."""
    machine = scenes.idex(SCENES[scene])
    park = park or machine.number("stepper_x", "position_endstop")
    printer = start(machine, changes=more)
    printer.session.require_ready()
    printer.run(f"G28\nG90\nG1 Z10\nG1 X{park} F6000")
    return printer


OTHER = "SET_DUAL_CARRIAGE CARRIAGE=1"


@pytest.mark.parametrize(
    ("mesh", "park", "is_refused"),
    [
        (None, "100", True),
        (None, "2", False),
        (("50, 50", "180, 180"), "100", True),
        (("50, 50", "180, 180"), "40", False),
    ],
)
def test_first_carriage_over_the_bed_is_refused(start, mesh, park, is_refused):
    more = {"bed_mesh": bed_mesh(*mesh)} if mesh else {}
    printer = idex(start, park, **more)
    printer.run(OTHER)
    for command in (
        "CALIBRATE_Z",
        "PROBE_Z_ACCURACY",
        "Z_CALIBRATION_WAIT MAX=2",
        "CALIBRATE_Z_ACCURACY",
    ):
        before = len(printer.machine.truth.touches)
        # Out of reach is refused, too, and moves nothing
        nowhere = "" if is_refused else " NOZZLE_POSITION=9999,1"
        text = printer.fail(command + nowhere)
        words = (
            "carriage_0, with which Z was homed, is not active and stands at"
        )
        assert (words in text) == is_refused
        if is_refused:
            assert f"X={float(park):.1f} over the bed" in text
        assert touched_sites(printer, before) == []


def test_carriage_that_moves_along_is_refused(start):
    printer = idex(start, "2")
    printer.run(f"{OTHER} MODE=COPY")
    text = printer.fail("CALIBRATE_Z")
    assert "carriage_1 moves along (COPY): two nozzles would go down" in text


def test_copying_after_it_is_the_same_nozzle(start):
    printer = idex(start)
    printer.run("G28 Z\nCALIBRATE_Z")
    assert told(printer, f"{OTHER} MODE=COPY") == []
    assert validity(printer) == (True, True, "")


def test_start_gcode_may_take_the_first_carriage(start):
    code = "SET_DUAL_CARRIAGE CARRIAGE=0"
    printer = idex(start, "100", **section(start_gcode=code))
    printer.run(f"G28 Z\nG1 X100 F6000\n{OTHER}")
    calibration(printer)


def test_second_carriage_is_another_nozzle(start):
    """Also without ACTIVATE_EXTRUDER."""
    printer = idex(start)
    printer.run("G28 Z\nCALIBRATE_Z")
    assert validity(printer) == (True, True, "")
    printer.run(OTHER)
    _, is_valid, reason = validity(printer)
    assert not is_valid
    assert "carriage_1 is active, and CALIBRATE_Z was run with" in reason
    lines = told(printer, "G4 P1")
    assert len(lines) == 1 and reason in lines[0]
    printer.run("SET_DUAL_CARRIAGE CARRIAGE=0")
    assert validity(printer) == (True, True, "")


def test_first_nozzle_is_measured_after_the_second_was_used(start):
    printer = idex(start)
    before = len(printer.machine.truth.touches)
    printer.run(f"{OTHER}\nG1 X120 Y80 Z3 F6000\nG1 X290")
    printer.run("SET_DUAL_CARRIAGE CARRIAGE=0")
    calibration(printer)
    sites = touched_sites(printer, before)
    assert set(sites) == {"nozzle_pin", "body_pin", "probe_bed"}
    assert printer.gap() == pytest.approx(
        printer.scene.formula_gap(), abs=2 * MICROSTEP
    )


def loses_second(host):
    """Whether it takes the second carriage to be elsewhere after a probing move."""
    file = host.directory / "base/klippy/kinematics/idex_modes.py"
    return "def get_primary_rail" not in file.read_text()


@pytest.mark.every_host("Klipper before 2024-02-07 loses the second carriage")
@pytest.mark.parametrize(
    ("scene", "commands"),
    [
        ("cartesian", ("CALIBRATE_Z", "PROBE_Z_ACCURACY")),
        ("piezo_cartesian", ("AUTO_Z_CALIBRATE",)),
        (
            "membrane",
            (
                "EXTRA_PROBE PROBE=membrane",
                "EXTRA_PROBE_CALIBRATE PROBE=membrane",
            ),
        ),
    ],
)
def test_second_nozzle_is_not_touched_with_where_it_is_lost(
    start, host, scene, commands
):
    """The next move would drive it 60 mm into its end."""
    if not loses_second(host):
        pytest.skip("the host does not lose it")
    printer = idex(start, scene=scene)
    printer.run(f"{OTHER}\nM400")
    words = "carriage_1 is active, and this Klipper loses its place at each"
    before = printer.machine.tip(1)
    for command in commands:
        assert words in printer.fail(command)
    assert printer.machine.tip(1) == before


def average(printer):
    """What PROBE_Z_ACCURACY has found with the active nozzle, mm."""
    lines = " ".join(printer.run("PROBE_Z_ACCURACY"))
    return float(re.search(r"average (-?[\d.]+)", lines)[1])


def test_second_nozzle_without_a_probe(start, host):
    """The probe is on the first carriage: nothing of the second meets the switch."""
    if loses_second(host):
        pytest.skip("the host loses the second carriage at each touch")
    printer = idex(start)
    printer.run(OTHER)
    truth, before = printer.machine.truth, len(printer.machine.truth.touches)
    text = printer.fail("CALIBRATE_Z")
    assert "the switch did not answer" in text
    assert set(touched_sites(printer, before)) == {"second_nozzle_pin"}
    assert truth.min_gap > 1.0
    # How far the nozzles are apart can be measured
    second = average(printer)
    printer.run("G1 X290 F6000\nSET_DUAL_CARRIAGE CARRIAGE=0")
    assert average(printer) - second == pytest.approx(
        scenes.SECOND_NOZZLE, abs=2 * MICROSTEP
    )
    # ... and be put into its macro
    printer.run(
        f"CALIBRATE_Z\nG1 X-8 F6000\n{OTHER}\nG1 X110 Y110\n"
        f"SET_GCODE_OFFSET Z_ADJUST={-scenes.SECOND_NOZZLE}\nG1 Z5\nM400"
    )
    assert printer.machine.gap_at_zero(5.0, carriage=1) == pytest.approx(
        printer.scene.formula_gap(), abs=3 * MICROSTEP
    )
