"""What both set-ups by dialogs have in common: back, aborted, during a print."""

from __future__ import annotations

import pytest

from simprinter import heated
from tools.kit import dock_owner, setup_user
from tools.kit.cases import all_slow_but
from tools.kit.dock_owner import Owner
from tools.kit.dockable_probe import SWITCH, where
from tools.kit.product import ORDER
from tools.kit.scenes import SCENES
from tools.kit.setup_user import EMPTY, User
from tools.kit.z_calibration import section

Z, DOCK = setup_user.SETUP, dock_owner.SETUP
SECTION = {Z: "z_calibration", DOCK: "dockable_probe"}
# A step with jog buttons, the probe on the toolhead
JOG = {Z: "SWITCH", DOCK: "DOCK"}
SETUPS = pytest.mark.parametrize("setup", [Z, DOCK])


def user_of(start, setup, scenes=lambda scene: scene, **more):
    """Somebody before the first step, who knows no place yet."""
    if setup == DOCK:
        return dock_owner.dock_owner(start, scenes(SWITCH), more=more)
    changes = {**section(**EMPTY), **more}
    printer = start(scenes(SCENES["cartesian"]), changes=changes)
    printer.session.require_ready()
    return User(printer)


def come_to(user, step):
    """From the beginning, as far as that."""
    if not isinstance(user, Owner):
        user.begin()
    user.go_to(step)


# Where a print stands, and how it is ended; OctoPrint's has nothing but PAUSE
PRINTS = {
    "printing": ("SDCARD_PRINT_FILE FILENAME=a.gcode", "during a print"),
    "paused": ("PAUSE", "a print is paused (PAUSE), and goes on from here"),
}


@SETUPS
@pytest.mark.parametrize("state", PRINTS)
def test_print_that_begins_meanwhile(start, tmp_path, setup, state):
    (tmp_path / "a.gcode").write_text("G4 P500\n" * 99)
    card = {"virtual_sdcard": {"path": str(tmp_path)}, "pause_resume": {}}
    user = user_of(start, setup, **card)
    come_to(user, JOG[setup])
    printer = user.printer
    at, probe = user.position(), where(printer)
    script, words = PRINTS[state]
    printer.run(script)
    step = f"{setup} STEP={JOG[setup]}"
    for refused in (setup, step, f"{step} X=1"):
        text = printer.fail(refused)
        assert text.startswith(f"{SECTION[setup]}: ") and words in text
    # What moves nothing may be done; the print goes on at this height
    printer.run(f"{step} WIDTH=1")
    assert user.has("X-1 mm")
    told = "\n".join(user.press("Abort"))
    if setup == Z:
        # It lifts the toolhead otherwise
        assert "nothing was moved, as a print may be on" in told
    assert user.position() == at
    assert (user.dialog(), where(printer)) == (None, probe)


# OctoPrint says nothing of its prints, and a nozzle that is hot is no print
@SETUPS
def test_heated_printer_is_set_up_without_a_question(start, setup):
    user = user_of(start, setup, heated)
    user.printer.run("M140 S60\nM104 S150")
    come_to(user, JOG[setup])
    at = user.position()
    user.press("X+1 mm")
    assert user.position()[0] == at[0] + 1.0
    console = "\n".join(user.printer.session.console)
    assert "print paused" not in console


STEPS = {
    Z: [name.upper() for name in ORDER],
    DOCK: ["ON", "DOCK", "APPROACH", "INSERT", "FETCH", "STORE", "SAVE"],
}
USUAL = [
    *((Z, step) for step in ("OFF", "ATTACH", "TOUCH_SWITCH", "SAVE")),
    *((DOCK, step) for step in ("DOCK", "INSERT", "FETCH", "STORE", "SAVE")),
]


def assert_ended(user, setup, step):
    """Nothing is left of it."""
    printer = user.printer
    text = printer.fail(f"{setup} STEP={step}")
    assert "no set-up is under way" in text
    assert user.dialog() is None
    assert printer.status("configfile")["save_config_pending_items"] == {}


@pytest.mark.parametrize(
    ("setup", "step"),
    all_slow_but(USUAL, [(s, step) for s in STEPS for step in STEPS[s]]),
)
def test_aborted_or_restarted_at_a_step(start, setup, step):
    user = user_of(start, setup)
    printer = user.printer
    come_to(user, step)
    assert user.step() == step
    printer.run("SET_GCODE_OFFSET Z=0.1")
    told = "\n".join(user.press("Abort"))
    assert "the set-up has ended, nothing was saved" in told
    assert_ended(user, setup, step)
    assert printer.offset() == pytest.approx(0.1)
    printer.session.wait(1.0)
    if printer.status("toolhead")["homed_axes"] == "xyz":
        # As high as the probe needs it
        assert user.position()[2] > 11.4
    if setup == Z:
        assert where(printer) == "docked"
    else:
        # It may be nowhere near its dock
        user.go("Y262", "X150 Y150 Z20")
        user.put_on()
    come_to(user, step)
    printer.session.restart("RESTART")
    assert_ended(user, setup, step)
    assert "as a restart ends it, too" in printer.fail(f"{setup} STEP={step}")


@SETUPS
def test_emergency_stop_in_the_middle(start, setup):
    user = user_of(start, setup)
    come_to(user, JOG[setup])
    user.printer.session.stop()
    user.printer.session.wait(1.0)
    assert "Internal error" not in "\n".join(user.printer.session.console)
    user.printer.session.restart("FIRMWARE_RESTART")
    assert_ended(user, setup, JOG[setup])
    user.begin()
    assert user.step() == STEPS[setup][0]
