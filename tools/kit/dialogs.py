"""Reads action:prompt_... lines as the interfaces do; see their documents.

Mainsail (docs: macro prompts), Fluidd and KlipperScreen agree on these types,
but KlipperScreen keeps only the last text, refuses buttons of more than three
parts, and until 2024-01-03 (5ad03b5d) showed nothing new while a dialog was
open. None of them knows a way to write a bar in a part.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass, field

LINE = re.compile(r"// action:prompt_(\S+) *(.*)")
COLOURS = ("primary", "secondary", "info", "warning", "error")
# Words that fit, see MacroPrompt of Mainsail: 400 pixels wide
LONGEST_HEADLINE = 40
# A row of a group: so many buttons, or fewer of more letters
BUTTONS_OF_A_GROUP, LONGEST_OF_A_GROUP = 4, 6
# All that a small screen has room for below the sentences
BUTTONS_OF_A_DIALOG = 8


@dataclass
class Shown:
    """A dialog that was shown: its parts, and whether it still is."""

    headline: str
    texts: list[str] = field(default_factory=list)
    footer_buttons: list[tuple[str, str, str]] = field(default_factory=list)
    groups: list[list[tuple[str, str, str]]] = field(default_factory=list)
    is_open: bool = False

    @property
    def text(self) -> str:
        """All that Mainsail and Fluidd show, a sentence a line."""
        return "\n".join(self.texts)

    @property
    def last(self) -> str:
        """All that KlipperScreen shows."""
        return self.texts[-1]

    def assert_stands_alone(self) -> None:
        """Who sees the last sentence only knows what the first button does."""
        first = self.footer_buttons[0][0]
        assert first == "Abort" or first in self.last

    def gcode(self, label: str) -> str:
        """What the button of that name sends."""
        buttons = [*self.footer_buttons, *sum(self.groups, [])]
        (found,) = [gcode for name, gcode, _ in buttons if name == label]
        return found


def dialogs_of(lines: Iterable[str]) -> list[Shown]:
    """What interfaces show, in order. AssertionError: not the grammar."""
    shown: list[Shown] = []
    building, in_group = None, False
    for kind, text in (m.groups() for m in map(LINE.fullmatch, lines) if m):
        if kind == "begin":
            # An older KlipperScreen would ignore it
            assert not any(dialog.is_open for dialog in shown)
            assert building is None, "begun twice"
            assert 0 < len(text) <= LONGEST_HEADLINE
            building = Shown(text)
        elif kind == "text":
            assert building is not None and text
            building.texts.append(text)
        elif kind == "footer_button":
            assert building is not None
            label, gcode, colour = text.split("|")
            assert 0 < len(label) <= 10 and gcode and colour in COLOURS
            building.footer_buttons.append((label, gcode, colour))
        elif kind == "button_group_start":
            assert building is not None and not in_group and not text
            building.groups.append([])
            in_group = True
        elif kind == "button":
            # Fluidd ignores groups, and shows what is in them
            assert in_group
            label, gcode, colour = text.split("|")
            assert label
            assert gcode and colour in COLOURS
            building.groups[-1].append((label, gcode, colour))
        elif kind == "button_group_end":
            assert in_group and not text
            row = building.groups[-1]
            assert 0 < len(row) <= BUTTONS_OF_A_GROUP
            room = BUTTONS_OF_A_GROUP * LONGEST_OF_A_GROUP // len(row)
            assert all(len(button[0]) <= room for button in row)
            in_group = False
        elif kind == "show":
            assert building is not None and building.footer_buttons
            assert not in_group
            assert not text
            buttons = [*building.footer_buttons, *sum(building.groups, [])]
            assert len(buttons) <= BUTTONS_OF_A_DIALOG
            building.is_open = True
            shown.append(building)
            building = None
        else:
            assert (kind, text) == ("end", ""), kind
            for dialog in shown:
                dialog.is_open = False
            building = None
    assert building is None, "not shown"
    return shown
