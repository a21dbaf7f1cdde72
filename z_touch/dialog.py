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
from typing import (
    Generic,
    Iterator,
    List,
    Optional,
    Protocol,
    Sequence,
    TypeVar,
)

from . import attached
from .host.klippy import GCodeCommand
from .host.printer import Host

PREFIX = "// action:prompt_"
END = PREFIX + "end"

# What a person has to do before anything of ours asks
PAUSED = (
    "a print is paused (PAUSE), and goes on from here; end it (CANCEL_PRINT),"
    " or CLEAR_PAUSE where there is none"
)


class Asked(Protocol):
    """A question that waits for an answer; `asks` names it in one word."""

    @property
    def asks(self) -> str:
        """Return the word that QUESTION= has."""


Question = TypeVar("Question", bound=Asked)


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


# One question with two answers, of a command that another one goes on with
class Dialog(Generic[Question]):
    """Asks a person to go on or to end, by a dialog and on the console."""

    def __init__(self, host: Host, command: str) -> None:
        """Remember who asks.

        command: the G-code of the beginning and of both answers; it has %s for
        CALIBRATE, CONTINUE or ABORT.
        """
        self.host = host
        self.begin = command % ("CALIBRATE",)
        self.go_on = command % ("CONTINUE",)
        self.abort = command % ("ABORT",)
        # What the asking command wants to know again; None: nothing is asked
        self.question: Optional[Question] = None

    def waits_for(self) -> str:
        """Return what is asked for, in its word; empty: nothing."""
        return "" if self.question is None else self.question.asks

    def ask(
        self, question: Question, headline: str, sentences: List[str]
    ) -> None:
        """Show a question; the one before was closed."""
        self.host.say(" ".join([f"{headline}.", *sentences]))
        self.host.say(f"then {self.go_on}, or {self.abort}")
        go_on = f"{self.go_on} QUESTION={question.asks}"
        footer = (
            Button("Continue", go_on, "primary"),
            Button("Abort", self.abort, "error"),
        )
        for line in lines(headline, sentences, footer):
            self.host.gcode.respond_raw(line)
        self.question = question
        answers = self.go_on, self.abort
        attached.of(self.host.printer).asking(self.host.section, answers)

    def close(self) -> None:
        """Ask nothing any more."""
        self.question = None
        attached.of(self.host.printer).answered(self.host.section)
        self.host.gcode.respond_raw(END)

    def answered(self, gcmd: GCodeCommand) -> Question:
        """Return what was asked, which is over; the command's error: nothing was."""
        question = self.question
        self.close()
        if question is None:
            raise gcmd.error(
                f"{self.host.section}: nothing was asked; begin with {self.begin}"
            )
        return question

    def continued(self, gcmd: GCodeCommand) -> Question:
        """Return what was asked, as answered() does, if CONTINUE answers that."""
        self.check_asked(gcmd)
        return self.answered(gcmd)

    def check_asked(self, gcmd: GCodeCommand) -> None:
        """Raise the command's error where QUESTION= is not what is asked.

        A button that is pressed twice must not answer the question that comes next.
        """
        asked, waits_for = gcmd.get("QUESTION", "").strip(), self.waits_for()
        if waits_for and asked not in ("", waits_for):
            raise gcmd.error(
                f"{self.host.section}: QUESTION={asked} is not what is asked"
                f" now, which is {waits_for}"
            )
