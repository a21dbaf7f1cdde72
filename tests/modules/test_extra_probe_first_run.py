"""The first calibration, before anybody knows where the bed is.

Who forgets the membrane must not find it out by a nozzle in the bed.
"""

from __future__ import annotations

import pytest

from simprinter.hosts.session import GcodeError
from tools.kit.dialogs import dialogs_of
from tools.kit.extra_probe import (
    ABORT,
    BED,
    CALIBRATE,
    CONTINUE,
    MICROSTEP,
    NAME,
    calibrate,
    lay,
    press,
    section,
    true_gap,
)

MISSING = (
    "extra_probe membrane: the switch was not pressed after 20 seconds; Continue,"
    " then press it once with a finger and let go, or look with QUERY_EXTRA_PROBE"
    " PROBE=membrane if that changes nothing"
)
HELD = MISSING.replace("was not pressed after", "is pressed still after")
WAITS = "Continue waits until you press the switch once with a finger."


def asked(start, scene="membrane", **options):
    """A printer that waits for the membrane, and its dialog."""
    printer = start(scene, **options).homed()
    (shown,) = dialogs_of(printer.run(CALIBRATE))
    return printer, shown


def deepest(printer):
    return printer.machine.truth.deepest_in_bed()


@pytest.mark.parametrize("scene", ["membrane", "membrane_two_boards"])
def test_forgotten_membrane(start, scene):
    printer, shown = asked(start, scene)
    assert shown.last == WAITS
    clock = printer.machine.simulation.clock
    # Twice: the question stays, and so does its dialog
    for _ in range(2):
        began = clock.now()
        assert printer.fail(shown.gcode("Continue")) == MISSING
        assert 19.5e9 < clock.now() - began < 21.5e9
        assert printer.status(NAME)["waits_for"] == "switch"
    while_waiting, again = dialogs_of(printer.session.console)[-2:]
    assert while_waiting.headline == "Step 1 of 3: press it now"
    assert [label for label, *_ in while_waiting.footer_buttons] == ["Abort"]
    assert again.is_open and again.last == WAITS
    assert (deepest(printer), printer.machine.truth.min_gap > 9.0) == (
        0.0,
        True,
    )
    lay(printer)
    # The hand is still there: nothing has come down
    assert printer.machine.truth.min_gap > 9.0
    hand = dialogs_of(printer.session.console)[-1]
    assert hand.texts[0] == "The switch was pressed, and works."
    printer.run(hand.gcode("Continue"))
    printer.machine.lay_membrane(False)
    printer.run(CONTINUE)
    assert true_gap(printer) == pytest.approx(0.0, abs=2 * MICROSTEP)
    assert deepest(printer) == 0.0


def test_finger_that_stays_is_none_yet(start):
    printer, _ = asked(start)
    printer.machine.lay_membrane()
    with pytest.raises(GcodeError) as caught:
        press(printer, after=True)
    assert str(caught.value) == HELD
    printer.machine.hold("membrane", None)
    press(printer)
    printer.run(f"{CONTINUE}\n{ABORT}")


# Before Continue, or with the question before, is nothing
@pytest.mark.parametrize("end", [ABORT, CALIBRATE, "RESTART"])
def test_finger_counts_for_one_question(start, end):
    printer, _ = asked(start)
    press(printer)
    if end == "RESTART":
        printer.session.restart(end)
        end = "G28"
    printer.run(end)
    for pressed in (True, None):
        printer.machine.hold("membrane", pressed)
        printer.session.wait(0.3)
    if end != CALIBRATE:
        printer.run(CALIBRATE)
    assert printer.fail(CONTINUE) == MISSING


# A bed that is known, or a floor that somebody has given
@pytest.mark.parametrize("known", ["saved", " FLOOR=-0.5", "position_min"])
def test_no_finger_where_the_lowest_point_is_known(start, known):
    own = {"position_min": "-0.5"} if known == "position_min" else {}
    printer = start("membrane", changes=section(**own)).homed()
    params = known if known.startswith(" ") else ""
    if known == "saved":
        calibrate(printer, f"{CALIBRATE} SAVE=1")
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28")
    if params:
        # A question of before that was waiting for one
        printer.run(CALIBRATE)
    (shown,) = dialogs_of(printer.run(CALIBRATE + params))
    assert "finger" not in shown.text
    printer.machine.lay_membrane()
    printer.run(CONTINUE)
    assert printer.status(NAME)["waits_for"] == "removal"


# Nobody has to press what cannot go on
@pytest.mark.parametrize(
    ("script", "words"),
    [
        ("M84", "not homed: X, Y, Z; home all axes (G28) first"),
        ("G28\nG1 Z10\nG1 X30 Y20", "since the calibration began; begin again"),
        ("MANUAL_PROBE", "a manual probe is under way; end it with ACCEPT or"),
    ],
)
def test_finger_is_not_asked_for_in_vain(start, script, words):
    printer, _ = asked(start)
    printer.run(script)
    text = printer.fail(CONTINUE)
    assert words in text
    assert "press it" not in text
    assert printer.status(NAME)["waits_for"] == ""
    assert not any(d.is_open for d in dialogs_of(printer.session.console))


# Commands that cannot ask go no lower than homing does, give or take 0.1 mm
@pytest.mark.parametrize("command", ["EXTRA_PROBE", "EXTRA_PROBE_ACCURACY"])
def test_touch_without_a_question(start, command):
    printer = start("membrane").homed()
    homed = printer.machine.truth.min_gap
    printer.machine.tolerate("nozzle_bed", 2.0)
    printer.run("G90\nG1 Z5 F900\nG1 X30 Y20 F6000")
    text = printer.fail(f"{command} PROBE=membrane")
    assert "(stopped at z=-0.100); press it by hand and look with" in text
    assert text.endswith(
        ", or where the bed may be lower find it with EXTRA_PROBE_CALIBRATE, or"
        " set position_min"
    )
    assert deepest(printer) == pytest.approx(0.1 + BED, abs=0.01)
    assert printer.machine.truth.min_gap <= homed


def test_printer_that_ends_while_the_switch_is_watched(start):
    printer, shown = asked(start)
    command = printer.session.begin(shown.gcode("Continue"))
    printer.session.wait(1.0)
    printer.session.call("emergency_stop", {})
    with pytest.raises(GcodeError) as caught:
        printer.session.finish(command)
    assert "Internal error" not in str(caught.value)
    assert printer.session.state()[0] == "shutdown"
    assert printer.status(NAME)["waits_for"] == ""
    printer.session.restart("FIRMWARE_RESTART")
    printer.run(f"G28\n{CALIBRATE}")
    lay(printer)
    printer.run(CONTINUE)
