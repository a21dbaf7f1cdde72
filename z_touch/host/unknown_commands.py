"""Commands that the host does not know, in G-code of the user.

Klipper answers an unknown command with a line on the console, not with an error, so a name
that is misspelt does nothing, and what comes after it goes on.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import re
from typing import TYPE_CHECKING, Iterator, List, NamedTuple

if TYPE_CHECKING:
    from .klippy import GCode, Printer

# Among the printer's objects; a RESTART makes new ones.
NAME = "z_touch_unknown_commands"

# cmd_default() of gcode.py, on all hosts
ANSWER = re.compile(r'^// Unknown command:"(.*)"$')

# What the host ignores without a word where the printer has no such part
SILENT = ("M21", "M104", "M105", "M106", "M107", "M140")

# Of a template: statements and values; a '#' begins a comment of printer.cfg
STATEMENT = re.compile(r"\{%.*?%\}", re.DOTALL)
VALUE = re.compile(r"\{.*?\}", re.DOTALL)
# They stand for a statement and a value
TAG, UNSEEN = "\0", "\1"
# The command of a line, after statements, as the host cuts it: letters, then a number
COMMAND = re.compile(rf"^[{TAG}\s]*([A-Z_]+[\d.]*)(?![A-Z_\d.{TAG}{UNSEEN}])")


def is_letter_and_number(word: str) -> bool:
    """Return whether a command is one such as M300 or 'M117 DONE'.

    Slicers and macros send them to any printer, with or without the part that they are for.
    """
    return bool(re.match(r"[A-Z]\d", word))


def commands_of(script: str) -> List[str]:
    """Return what can be seen of the commands of a template without running it."""
    text = VALUE.sub(UNSEEN, STATEMENT.sub(TAG, script))
    found: List[str] = []
    for line in text.split("\n"):
        command = COMMAND.match(line.split(";")[0].upper())
        if command:
            found.append(command.group(1))
    return found


class Script(NamedTuple):
    """G-code of the user: its section, its option, and what stands there."""

    section: str
    option: str
    text: str


def of(printer: Printer) -> UnknownCommands:
    """Return the one UnknownCommands of a printer."""
    unknown: UnknownCommands = printer.lookup_object(NAME, None)
    if unknown is None:
        unknown = UnknownCommands(printer.lookup_object("gcode"))
        printer.add_object(NAME, unknown)
    return unknown


class UnknownCommands:
    """One for a printer: it hears which commands the host does not know."""

    def __init__(self, gcode: GCode):
        self.gcode = gcode
        self.scripts: List[Script] = []
        # What was heard by each template that is under way, the innermost last
        self.heard: List[List[str]] = []
        # A handler of output cannot be taken away again, and an error in it would
        # reach the command that writes: it only records
        gcode.register_output_handler(self._hear)

    def _hear(self, text: str) -> None:
        answer = ANSWER.match(text)
        if answer and self.heard:
            self.heard[-1].append(answer.group(1))

    @contextlib.contextmanager
    def listening(self) -> Iterator[List[str]]:
        """Yield the list that unknown commands are added to while this lasts."""
        heard: List[str] = []
        self.heard.append(heard)
        try:
            yield heard
        finally:
            self.heard.pop()

    def add(self, section: str, option: str, text: str) -> None:
        """Add G-code of the user while the configuration is read."""
        self.scripts.append(Script(section, option, text))

    def notes(self, section: str) -> List[str]:
        """Return what the G-code of a section names that is no command, when klippy is ready."""
        known = self.gcode.ready_gcode_handlers
        return [
            f"{script.option}: {command} is no command or macro of this printer;"
            " check how it is spelt"
            for script in self.scripts
            if script.section == section
            for command in dict.fromkeys(commands_of(script.text))
            if command not in known and command not in SILENT
        ]
