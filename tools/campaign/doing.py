"""Steps that are more than one command: dialogs, prints, SAVE_CONFIG, a finger."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from simprinter.hosts.session import LiveSession, SessionError
from simprinter.machine import Machine
from tools.campaign.drawn import card
from tools.kit.dialogs import Shown, dialogs_of

# Of a print, printer seconds: it heats, levels, meshes and prints a line
LIMIT = 1800.0
# Takes G-code, and keeps why it was refused
Run = Callable[[str], None]


def press(dialog: Shown, number: int, run: Run) -> None:
    """A button of a dialog."""
    buttons = [*dialog.footer_buttons, *sum(dialog.groups, [])]
    label, gcode, _ = buttons[number % len(buttons)]
    # A person looks before the toolhead goes down
    if not label.startswith(("-", "Lower")):
        run(gcode)


def answer(session: LiveSession, run: Run, number: int) -> None:
    """A button of the dialog that is open; where none is, nothing."""
    for dialog in _open(session):
        press(dialog, number, run)


def twice(session: LiveSession, run: Run, number: int) -> None:
    """The same button again, as the page still shows it."""
    for dialog in _open(session):
        press(dialog, number, run)
        press(dialog, number, run)


def late(session: LiveSession, run: Run, number: int) -> None:
    """A button of the dialog before the last one, on a page that is behind."""
    shown = dialogs_of(session.console)
    if len(shown) > 1:
        press(shown[-2], number, run)


def _open(session: LiveSession) -> list[Shown]:
    return [d for d in dialogs_of(session.console) if d.is_open][-1:]


def save(session: LiveSession, command: str) -> None:
    """SAVE_CONFIG, where an interface shows that there is something to save."""
    if session.status("configfile").get("save_config_pending"):
        session.restart(command)


def print_card(session: LiveSession, run: Run, what: Sequence) -> None:
    """A print from the card.

    what: so many seconds later another client sends the first command; where the
    print is paused at its end, the second.
    """
    seconds, meanwhile, then = what
    run(f"SDCARD_PRINT_FILE FILENAME={card.FILE}")
    session.wait(float(seconds))
    if meanwhile:
        run(meanwhile)
    _wait_for_end(session)
    if session.status("pause_resume").get("is_paused"):
        run(then)
        _wait_for_end(session)


def _wait_for_end(session: LiveSession) -> None:
    left = LIMIT
    while session.status("virtual_sdcard").get("is_active"):
        session.wait(5.0)
        left -= 5.0
        if left < 0.0:
            raise SessionError(f"a print takes over {LIMIT:.0f} s")


def finger_asked_for(session: LiveSession) -> str:
    """What begins to wait for a finger; empty: no dialog asks for one."""
    for dialog in _open(session):
        if "with a finger" in dialog.last:
            return dialog.gcode("Continue")
    return ""


def finger(session: LiveSession, machine: Machine, signal: str) -> None:
    """Somebody presses a switch, and lets it go."""
    for level in True, None:
        machine.hold(signal, level)
        session.wait(0.5)
