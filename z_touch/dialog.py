"""Questions to a person: dialogs of the web interfaces and of KlipperScreen.

What the interfaces have in common, read from the lines of the console:

    // action:prompt_begin HEADLINE
    // action:prompt_text TEXT
    // action:prompt_button_group_start
    // action:prompt_button LABEL|G-CODE|COLOUR
    // action:prompt_button_group_end
    // action:prompt_footer_button LABEL|G-CODE|COLOUR
    // action:prompt_show
    // action:prompt_end

The G-code of a button waits until the command that is running has ended: so a
command asks and ends, and another one goes on.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Iterator, Sequence

from .host.printer import Host

PREFIX = "// action:prompt_"
END = PREFIX + "end"

# What a person has to do before anything of ours asks
PAUSED = (
    "a print is paused (PAUSE), and goes on from here; end it (CANCEL_PRINT),"
    " or CLEAR_PAUSE where there is none"
)


@dataclass(frozen=True)
class Button:
    """A button of a dialog: what it says, what it sends, and its colour."""

    label: str
    gcode: str
    colour: str = "secondary"

    def parts(self) -> str:
        """Return it as a line has it."""
        return "|".join((self.label, self.gcode, self.colour))


def plain(text: str) -> str:
    """Return a text without what would end its line, or its part of a button."""
    return " ".join(text.split()).replace("|", "/")


def lines(
    headline: str,
    sentences: Sequence[str],
    footer: Sequence[Button],
    rows: Sequence[Sequence[Button]] = (),
) -> Iterator[str]:
    """Yield the lines of a dialog.

    Each sentence is a text of its own. KlipperScreen shows only the last one, which
    has to say what the first button of the footer does. Empty ones are left out.
    """
    yield PREFIX + "begin " + plain(headline)
    for sentence in filter(None, map(plain, sentences)):
        yield PREFIX + "text " + sentence
    for row in rows:
        yield PREFIX + "button_group_start"
        for button in row:
            yield PREFIX + "button " + button.parts()
        yield PREFIX + "button_group_end"
    for button in footer:
        yield PREFIX + "footer_button " + button.parts()
    yield PREFIX + "show"


def is_paused(host: Host) -> bool:
    """Say whether PAUSE has left a print paused."""
    pauser = host.printer.lookup_object("pause_resume", None)
    status = pauser.get_status(host.eventtime()) if pauser else {}
    return bool(status.get("is_paused"))
