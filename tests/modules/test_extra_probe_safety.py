"""What EXTRA_PROBE_CALIBRATE does when something is wrong.

Nothing gets hurt, and everything is as before.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter import Fault
from tools.kit.carrying import OVER, SWITCH, with_all
from tools.kit.cases import slow
from tools.kit.dialogs import dialogs_of
from tools.kit.dockable_probe import QUICK
from tools.kit.docks import DOCK_SCENES, HANG
from tools.kit.extra_probe import (
    ABORT,
    BED,
    CALIBRATE,
    CONTINUE,
    MICROSTEP,
    NAME,
    calibrate,
    heights,
    lay,
    membrane,
    press,
    section,
    state,
    true_gap,
)
from tools.kit.prints import of_card
from tools.kit.scenes import SCENES, on_gantry

DEEP = 3.0


def asked(start, scene="membrane", before="SET_GCODE_OFFSET Z=0.3", **options):
    """A printer with something to lose, that waits for the membrane."""
    printer = start(scene, **options).homed()
    printer.run(f"{before}\n{CALIBRATE} SAVE=1")
    lay(printer)
    for site in ("nozzle_membrane", "nozzle_bed"):
        printer.machine.tolerate(site, DEEP)
    return printer


def fails(printer, words, script=CONTINUE):
    """It fails so, and everything is as before the calibration."""
    before = state(printer)
    text = printer.fail(script)
    assert text.startswith("extra_probe membrane: ")
    assert words in text
    assert_as_before(printer, before)
    return text


def assert_as_before(printer, before):
    """Offset, status and saved values; the toolhead is up, the dialog closed."""
    after = state(printer)
    assert before["status"].pop("waits_for") != ""
    assert after["status"].pop("waits_for") == ""
    assert after == before
    assert after["pending"] == {}
    assert printer.offset() == pytest.approx(0.3)
    assert printer.session.state()[0] == "ready"
    printer.session.wait(2.0)
    assert printer.session.position()[2] >= 10.0 - MICROSTEP
    assert not any(d.is_open for d in dialogs_of(printer.session.console))
    # Another one is no problem
    assert "nothing was asked" in printer.fail(CONTINUE)


# The membrane


def test_membrane_that_is_not_there_once_the_bed_is_known(start):
    printer = start("membrane").homed()
    calibrate(printer, f"{CALIBRATE} SAVE=1")
    printer.session.restart("SAVE_CONFIG")
    printer.run(f"G28\n{CALIBRATE}")
    text = printer.fail(CONTINUE)
    assert "(stopped at z=0.125)" in text
    # In the air
    assert printer.machine.truth.deepest_in_bed() == 0.0
    assert printer.machine.truth.min_gap == pytest.approx(0.125, abs=0.01)


def test_membrane_that_always_reads_triggered(start):
    printer = start("membrane", changes=section(pin="^PF5")).homed()
    printer.run(f"{CALIBRATE} SAVE=1")
    words = (
        "the switch reads triggered before it is touched; check it with"
        " QUERY_EXTRA_PROBE PROBE=membrane, and whether pin needs a '!'"
    )
    assert words in printer.fail(CONTINUE)
    # The question stays
    assert printer.status(NAME)["waits_for"] == "switch"
    assert printer.machine.truth.min_gap > 9.0


def test_finger_on_the_membrane(start):
    about = {"site": "nozzle_membrane", "command": "EXTRA_PROBE_CONTINUE"}
    faults = [
        Fault("trigger_early", touch=n, mm=5.5, **about) for n in (1, 2, 3)
    ]
    printer = asked(start, faults=faults)
    text = fails(printer, "the bed would be over 5 mm from Z=0")
    assert (
        "begin again if a hand has pressed it, or home Z nearer to the" in text
    )


# The user's G-code


@pytest.mark.parametrize("option", ["activate_gcode", "deactivate_gcode"])
@pytest.mark.parametrize("each", ["true", slow("false")])
@pytest.mark.parametrize(
    ("code", "words"),
    [
        ("\n  G91\n  G1 Z-0.5\n  G90", "the toolhead moved in "),
        ("\n  M84", "not homed any more after |the motors were turned off"),
    ],
)
def test_template_that_moves_or_turns_the_motors_off(
    start, option, each, code, words
):
    own = {option: code, "deactivate_on_each_sample": each}
    printer = asked(start, changes=section(**own))
    before = state(printer)
    text = printer.fail(CONTINUE)
    assert any(word in text for word in words.split("|")), text
    if "M84" in code:
        assert printer.session.state()[0] == "ready"
        assert printer.offset() == pytest.approx(0.3)
        assert printer.status(NAME)["waits_for"] == ""
        return
    assert_as_before(printer, before)


def test_template_that_moves_the_frame(start):
    # The toolhead is where it was, by its own account
    code = "\n  {% set z = printer.toolhead.position.z %}"
    code += "\n  SET_KINEMATIC_POSITION Z={z - 0.5}\n  G90\n  G1 Z{z}"
    own = {"deactivate_gcode": code, "deactivate_on_each_sample": "false"}
    changes = {**SHIFT, **section(**own)}
    printer = asked(start, before="", changes=changes)
    text = printer.fail(CONTINUE)
    assert "Z was homed again or set since the calibration began" in text
    assert printer.status(NAME)["waits_for"] == ""


# Whoever is asked


@pytest.mark.parametrize("after_touch", [False, True])
def test_abort(start, after_touch):
    printer = asked(start)
    if after_touch:
        printer.run(CONTINUE)
    before = state(printer)
    lines = printer.run(ABORT)
    told = f"// {NAME}: the calibration ends, nothing was changed"
    assert lines == ["// action:prompt_end", told]
    assert_as_before(printer, before)
    assert "nothing was asked" in printer.fail(ABORT)


def test_beginning_again_while_something_is_asked(start):
    printer = asked(start)
    printer.run(CONTINUE)
    # The second one does not save
    lines = printer.run(CALIBRATE)
    (dialog,) = dialogs_of(lines)
    assert dialog.headline == "Step 1 of 3: Lay the switch on the bed"
    press(printer)
    printer.run(CONTINUE)
    printer.machine.lay_membrane(False)
    printer.run(CONTINUE)
    assert state(printer)["pending"] == {}
    assert true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)


def test_beginning_again_in_vain_closes_the_dialog(start):
    printer = asked(start)
    before = state(printer)
    printer.fail(f"{CALIBRATE} SAVE=2")
    assert_as_before(printer, before)


SHIFT = {
    "force_move": {"enable_force_move": "true"},
    "gcode_macro SHIFT": {
        "gcode": "\n  {% set z = printer.toolhead.position.z %}"
        "\n  SET_KINEMATIC_POSITION Z={z + 0.5}"
    },
}


@pytest.mark.parametrize("after_touch", [slow(False), True])
@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("G1 Z10\nG1 X-13 Y-7 F6000\nG28 Z\nG1 Z10\nG1 X30 Y20", "homed again"),
        ("SHIFT", "Z was homed again or set since the calibration began"),
        ("M84", "not homed: X, Y, Z"),
        ("M84\nG28\nG1 Z10\nG1 X30 Y20", "since the calibration began"),
    ],
)
def test_frame_that_moved_meanwhile(start, after_touch, script, words):
    printer = asked(start, changes=SHIFT)
    if after_touch:
        printer.run(CONTINUE)
        printer.machine.lay_membrane(False)
    printer.run(script)
    fails_so(printer, words)


def fails_so(printer, words):
    """The same without a look at the height, which is not known here."""
    text = printer.fail(CONTINUE)
    assert words in text
    assert printer.offset() == pytest.approx(0.3)
    assert state(printer)["pending"] == {}
    assert printer.status(NAME)["last_offset"] is None
    assert printer.session.state()[0] == "ready"


@pytest.mark.parametrize("move", ["X31", "Y19"])
def test_head_that_was_moved_meanwhile(start, move):
    printer = asked(start)
    printer.run(f"G1 {move} F6000")
    fails(printer, "the toolhead was moved since the calibration began")
    assert heights(printer) == []


def test_head_that_was_lowered_meanwhile(start):
    # It is lifted again
    printer = asked(start)
    printer.run("G1 Z2")
    printer.run(CONTINUE)
    assert printer.session.position()[2] == pytest.approx(10.0)


# What cannot begin


@pytest.mark.parametrize(
    ("own", "params", "words"),
    [
        ({"z_offset": None}, "", "z_offset is 0; set it to the thickness"),
        ({}, "SAVE=2", "SAVE"),
        ({}, "FLOOR=deep", "FLOOR"),
    ],
)
def test_calibration_that_cannot_begin(start, own, params, words):
    printer = start("membrane", changes=section(**own)).homed()
    at = printer.session.position()
    assert words in printer.fail(f"{CALIBRATE} {params}")
    assert printer.session.position() == at
    assert printer.status(NAME)["waits_for"] == ""
    assert dialogs_of(printer.session.console) == []


def test_floor_above_the_head(start):
    printer = asked(start)
    printer.run(ABORT)
    printer.run(f"{CALIBRATE} FLOOR=12")
    fails(printer, "the toolhead is at z=10.000, this touch ends at z=12.000")


# Z=0 is not where G28 has put it

TILTED = (0.0008, 0.0005)
GANTRY = with_all(DOCK_SCENES["dock_gantry"])
SCREWS = {"z": (-50.0, 18.0), "z1": (150.0, 348.0), "z2": (350.0, 18.0)}
Z_TILT = {
    "quad_gantry_level": None,
    "z_tilt": {
        "z_positions": "-50, 18\n  150, 348\n  350, 18",
        "points": "40, 20\n  150, 230\n  250, 20",
        "horizontal_move_z": "10",
        "speed": "200",
    },
}
# A probe whose z_offset is 0.6 mm wrong
WRONG_PROBE = {"dockable_probe": {"z_offset": f"{HANG - 0.6}", **QUICK}}
SET = "Z was homed again or set since G28"
LEVELLED = "the Z motors were levelled since G28"
OFF = "SET_STEPPER_ENABLE STEPPER=stepper_z ENABLE=0"
SINCE_G28 = {
    OFF: (SWITCH, {}, "the motors were turned off since G28"),
    "QUAD_GANTRY_LEVEL": (SWITCH, {}, LEVELLED),
    "Z_TILT_ADJUST": (
        on_gantry(SWITCH, "three_screws", SWITCH.kinematics, **SCREWS),
        {**Z_TILT, **WRONG_PROBE},
        SET,
    ),
    "AUTO_Z_HOME_Z": (
        GANTRY,
        {"auto_z_offset": {"z_offset": "0.8"}, "z_calibration": None},
        SET,
    ),
}


def tilted(scene, slope=TILTED):
    bed = replace(scene.world.bed, slope_x=slope[0], slope_y=slope[1])
    return scene.with_world(bed=bed)


def moved(start, script, saved=None):
    """A printer whose Z=0 is elsewhere since G28, and the words for that."""
    scene, changes, words = SINCE_G28[script]
    scene = tilted(scene) if script == "QUAD_GANTRY_LEVEL" else scene
    if saved:
        changes = {**changes, **section(saved_homing_z=saved)}
    printer = start(scene, changes=changes).homed()
    printer.run(f"{script}\n{OVER}")
    return printer, words


@pytest.mark.parametrize("script", SINCE_G28)
def test_nothing_is_saved_where_g28_has_not_put_z(start, script):
    printer, words = moved(start, script)
    at = printer.session.position()
    text = printer.fail(f"{CALIBRATE} SAVE=1")
    assert f"SAVE=1: {words}, and what is saved counts from G28 on" in text
    assert "; run G28 first" in text
    assert printer.session.position() == at
    # As it is for now it can be right
    lines = calibrate(printer)
    told = f"{words[0].upper()}{words[1:]}: the offset will be right until"
    assert any(told in line for line in printer.session.console)
    assert any("--> new offset=" in line for line in lines)
    assert printer.gap((60.0, 60.0)) == pytest.approx(0.0, abs=2 * MICROSTEP)
    # After it all is as ever
    printer.run(f"SET_GCODE_OFFSET Z=0\nG28 Z\n{OVER}")
    count = len(printer.session.console)
    calibrate(printer, f"{CALIBRATE} SAVE=1")
    printer.session.restart("SAVE_CONFIG")
    printer.run(f"G28\n{OVER}")
    assert printer.gap((60.0, 60.0)) == pytest.approx(0.0, abs=2 * MICROSTEP)
    assert not any(told in line for line in printer.session.console[count:])


# Z=0.125, where touches end otherwise, is inside the bed
def test_saved_calibration_does_not_hold_where_z_was_set(start):
    printer, words = moved(start, "AUTO_Z_HOME_Z", saved=f"{HANG}")
    text = "\n".join(printer.run(CALIBRATE))
    assert "Continue waits until you press the switch once with a finger" in (
        text
    )
    assert "the switch was not pressed after 20" in printer.fail(CONTINUE)
    printer.run(ABORT)
    for command in ("EXTRA_PROBE", "EXTRA_PROBE_ACCURACY"):
        at = printer.session.position()
        text = printer.fail(f"{command} PROBE=membrane")
        assert f"{words}, and the saved calibration does not tell any" in text
        assert text.endswith("; run G28 first, or set position_min")
        assert printer.session.position() == at
    assert printer.machine.truth.depth("nozzle_bed") < 0.05
    printer.run(f"G28 Z\n{OVER}")
    printer.machine.lay_membrane()
    printer.run("EXTRA_PROBE PROBE=membrane")


# A lowest Z that its owner has set needs no calibration
def test_position_min_holds_where_z_was_set(start):
    scene, changes, _words = SINCE_G28["AUTO_Z_HOME_Z"]
    options = section(saved_homing_z=f"{HANG}", position_min="-1.0")
    printer = start(scene, changes={**changes, **options}).homed()
    printer.run(f"AUTO_Z_HOME_Z\n{OVER}")
    printer.machine.lay_membrane()
    printer.run("EXTRA_PROBE PROBE=membrane")
    assert printer.machine.truth.touches[-1].site == "nozzle_membrane"


# Homing X is none of Z
def test_homing_of_another_axis_after_levelling(start):
    printer, words = moved(start, "QUAD_GANTRY_LEVEL")
    printer.run(f"G28 X\n{OVER}")
    assert f"SAVE=1: {words}" in printer.fail(f"{CALIBRATE} SAVE=1")


# By 0.06 mm; half a membrane is left over the bed
def test_saved_calibration_holds_after_a_little_levelling(start):
    scene = tilted(SWITCH, (0.0003, 0.0))
    zero = SWITCH.number("stepper_z", "position_endstop")
    changes = section(saved_homing_z=f"{zero}")
    printer = start(scene, changes=changes).homed()
    printer.run(f"QUAD_GANTRY_LEVEL\n{OVER}")
    assert "(stopped at z=0.12" in printer.fail("EXTRA_PROBE PROBE=membrane")
    assert LEVELLED in printer.fail(f"{CALIBRATE} SAVE=1")
    printer.session.wait(5.0)
    printer.machine.lay_membrane()
    printer.run("EXTRA_PROBE PROBE=membrane")


# It changes nothing
def test_levelling_of_what_is_level(start):
    printer = start(SWITCH).homed()
    printer.run(f"QUAD_GANTRY_LEVEL\n{OVER}")
    calibrate(printer, f"{CALIBRATE} SAVE=1")


# What comes after it in there is no homing
@pytest.mark.parametrize("wrapped", ["homing_override", slow("macro")])
@pytest.mark.parametrize("homes", [False, True])
def test_levelling_in_g28(start, homes, wrapped):
    gcode = ["", "G28.1 X Y", "G90", "G1 X206 Y306 F9000", "G28.1 Z"]
    gcode += ["G1 Z20 F900", "QUAD_GANTRY_LEVEL"]
    if homes:
        gcode += ["G1 X206 Y306 Z20 F9000", "G28.1 Z"]
    code = "\n  ".join([*gcode, "G1 Z20 F900"])
    changes = {"safe_z_home": None}
    if wrapped == "macro":
        macro = {"rename_existing": "G28.1", "gcode": code}
        changes["gcode_macro G28"] = macro
    else:
        code = code.replace("G28.1", "G28")
        changes["homing_override"] = {"axes": "z", "gcode": code}
    printer = start(tilted(SWITCH), changes=changes).homed()
    if homes:
        calibrate(printer, f"{CALIBRATE} SAVE=1")
    else:
        assert LEVELLED in printer.fail(f"{CALIBRATE} SAVE=1")


def test_z_that_nobody_has_homed(start):
    changes = {"force_move": {"enable_force_move": "true"}}
    printer = start("membrane", changes=changes)
    printer.session.require_ready()
    printer.run("SET_KINEMATIC_POSITION X=100 Y=100 Z=10")
    text = printer.fail(f"{CALIBRATE} SAVE=1")
    assert "SAVE=1: Z was not homed with G28, and what is saved" in text
    text = "\n".join(printer.run(CALIBRATE))
    assert "Z was not homed with G28: the offset will be right until" in text


# Its Z motor moves X, too, and tells nothing
def test_saving_where_the_motors_do_not_tell(start):
    scene = with_all(SCENES["corexz"])
    changes = {"auto_z_offset": None, "z_calibration": None}
    printer = start(scene, changes=changes).homed()
    printer.run(f"{CALIBRATE} SAVE=1")
    assert printer.status("extra_probe membrane")["waits_for"]
    printer.run(ABORT)
    assert not printer.status("extra_probe membrane")["waits_for"]


@pytest.mark.parametrize("after_touch", [False, True])
def test_print_that_begins_meanwhile(start, tmp_path, after_touch):
    changes = of_card(tmp_path, ["G4 P20000"] * 3)
    printer = asked(start, changes=changes)
    if after_touch:
        printer.run(CONTINUE)
    printer.run("SDCARD_PRINT_FILE FILENAME=print.gcode")
    printer.session.wait(2.0)
    fails_so(printer, "a print is under way (printing); end it first")


def test_endstop_that_would_end_up_outside_its_axis(start):
    # With it klippy would not start again
    printer = asked(start, changes={"stepper_z": {"position_min": "0"}})
    text = fails(printer, "stepper_z: position_endstop would be -0.45")
    assert "outside the 0.000 to 250.000 of Z; widen position_min or" in text
    assert "position_max, or do without SAVE=1" in text
    # Without, nothing is wrong with it
    calibrate(printer)
    assert true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)


def test_something_high_on_the_bed(start):
    # The nozzle comes down on it before it should meet anything
    printer = start(membrane(thickness=14.0)).homed()
    printer.run(f"G1 Z30 F900\n{CALIBRATE}")
    lay(printer)
    assert "the bed would be over 5 mm from Z=0" in printer.fail(CONTINUE)
    printer.session.wait(2.0)
    # In the air again
    top = 14.0 + BED
    assert printer.session.position()[2] > top + 1.0
    assert printer.machine.truth.depth("nozzle_membrane") < 0.1
