"""EXTRA_PROBE_CALIBRATE as a web interface sees it: dialogs and their buttons.

An interface reads the lines of the console as they come, or, after it was
loaded again, from Moonraker's store.
"""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from simprinter.hosts.moonraker import MoonrakerError
from tests.moonraker.updates import restarted
from tools.kit.dialogs import dialogs_of
from tools.kit.extra_probe import (
    CALIBRATE,
    CONTINUE,
    MICROSTEP,
    NAME,
    POINT,
)
from tools.kit.lab import Lab

pytestmark = pytest.mark.slow

# Real seconds that a finger stays
HAND = 0.3


@pytest.fixture(scope="module")
def lab(request, moonraker_python, tmp_path_factory):
    """A printer with a membrane switch, and Moonraker in front of it."""
    directory = tmp_path_factory.mktemp("lab")
    with Lab(request.param, moonraker_python, directory, "membrane") as lab:
        lab.install()
        lab.obey()
        lab.moonraker.run("G28")
        yield lab


def said(lab):
    """All lines of the console that Moonraker has stored."""
    store = lab.moonraker.get("/server/gcode_store")["gcode_store"]
    return [e["message"] for e in store if e["type"] == "response"]


def open_dialog(lab):
    """What an interface shows that is loaded now."""
    shown = [dialog for dialog in dialogs_of(said(lab)) if dialog.is_open]
    assert len(shown) <= 1
    return shown[0] if shown else None


def press(lab, label):
    """Press a button of the dialog that is open."""
    buttons = {b[0]: b[1] for b in open_dialog(lab).footer_buttons}
    return lab.moonraker.run(buttons[label])


def lay_membrane(lab, is_laid):
    with lab.standing() as printer:
        printer.machine.lay_membrane(is_laid)
    if not is_laid:
        return
    # A finger, too, while the command waits for it
    with ThreadPoolExecutor(1) as pool:
        answer = pool.submit(press, lab, "Continue")
        for level in (True, None):
            time.sleep(HAND)
            with lab.standing() as printer:
                printer.machine.hold("membrane", level)
        assert answer.result() == "ok"


def test_calibration_by_buttons_only(lab):
    lab.moonraker.run(CALIBRATE)
    assert open_dialog(lab).headline == "Step 1 of 3: Lay the switch on the bed"
    lay_membrane(lab, True)
    assert open_dialog(lab).headline == "Step 2 of 3: Take your hand away"
    assert press(lab, "Continue") == "ok"
    assert open_dialog(lab).headline == "Step 3 of 3: Take the switch away"
    lay_membrane(lab, False)
    assert press(lab, "Continue") == "ok"
    assert open_dialog(lab) is None
    offset = lab.moonraker.status(NAME)
    move = lab.moonraker.status("gcode_move")
    assert move["homing_origin"][2] == pytest.approx(offset["last_offset"])
    with lab.standing() as printer:
        gap = printer.gap(POINT)
    assert gap == pytest.approx(0.0, abs=2 * MICROSTEP)


def test_abort_by_button(lab):
    lab.moonraker.run(CALIBRATE)
    assert press(lab, "Abort") == "ok"
    assert open_dialog(lab) is None
    with pytest.raises(MoonrakerError) as caught:
        lab.moonraker.run(CONTINUE)
    assert "nothing was asked" in caught.value.text


def test_error_closes_the_dialog_and_is_shown(lab):
    lab.moonraker.run(f"{CALIBRATE} FLOOR=2")
    # Nobody has laid the membrane
    with pytest.raises(MoonrakerError) as caught:
        press(lab, "Continue")
    assert "the switch did not answer" in caught.value.text
    assert open_dialog(lab) is None
    assert f"!! {caught.value.text}" in said(lab)


def test_dialog_comes_over_the_socket(lab):
    with lab.moonraker.listen() as listener:
        lab.moonraker.run(CALIBRATE)
        lines = listener.collect(
            "notify_gcode_response",
            lambda params: params[0] == "// action:prompt_show",
        )
        (shown,) = dialogs_of(line for (line,) in lines)
        assert shown.headline == "Step 1 of 3: Lay the switch on the bed"
    press(lab, "Abort")


def test_dialog_of_mainsail_that_is_closed_by_its_cross(lab):
    # Without [respond] this is an unknown command; the question stays
    lab.moonraker.run(CALIBRATE)
    cross = 'RESPOND type="command" msg="action:prompt_end"'
    lab.moonraker.run(cross)
    status = lab.moonraker.status(NAME)
    assert status["waits_for"] == "switch"
    lab.moonraker.run("EXTRA_PROBE_ABORT PROBE=membrane")


def test_dialog_of_before_a_restart_is_closed_by_its_button(lab):
    lab.moonraker.run(f"G28\n{CALIBRATE}")
    restarted(lab, "RESTART")
    with pytest.raises(MoonrakerError) as caught:
        press(lab, "Continue")
    assert "nothing was asked" in caught.value.text
    assert open_dialog(lab) is None
