"""docs/messages.md has every message of the modules, and no other."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.documents import link_problems, normal, rows, spans
from tests.docs.sources import VALUE, messages, nameless

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "messages.md"
TEXT = DOCUMENT.read_text(encoding="utf-8")
NAMES = ("z_calibration", "auto_z_offset", "extra_probe", "dockable_probe")
# Of z_touch: for options and phases that only others have, and what is looked
# for in messages
LOOKED_FOR = {
    "named z_touch.core",
    "No trigger",
    "Communication timeout during",
    "Unable to obtain",
}
OTHERS = {
    "Z was homed again",
    "Z was homed again or set",
    "the Z motors were levelled",
    "the motors were turned off",
    "<...> does not stop these Z motors: <...>; remove the endstop_pin of"
    " their own",
    "must be 'low, high' in mm, such as -1.0, 1.0, or one value for both"
    " directions",
    "leaves no room between <...> and <...>; write the lower one first",
    "option '<...>' is ignored, '<...>' is given",
    "option '<...>' is now called '<...>'",
    "options '<...>' and '<...>' are ignored, '<...>' is given",
    "options '<...>' and '<...>' are now '<...>: <...>,<...>'",
    "Option '<...>' in section '<...>': only one of '<...>' and '<...>' is"
    " given; write both, better as '<...>: X,Y'",
    "option '<...>' <...>",
    "Error on '<...>': <...> has to be <...>",
    "a finite number",
    "X and Y in mm, such as 100,100",
    "median or average",
    "trying again",
    "cannot be used: <...>; give the pin that the switch is wired to, such as"
    " ^PA1",
    "The SAVE_CONFIG command will update the printer config file with the"
    " above and restart the printer.",
    "<...> needs the head at <...>=<...><...>, outside its <...> to <...>;"
    " <...>",
    "Option '<...>: <...>,<...>' in section '<...>'",
    "then <...>, or <...>",
    "<...>: nothing was asked; begin with <...>",
    "<...>: QUESTION=<...> is not what is asked now, which is <...>",
}
# Names, and beginnings of lines
NO_MESSAGES = {
    "get_mcu add_stepper get_steppers home_start query_endstop",
    "pre_attach attach post_attach pre_detach detach post_detach activate"
    " deactivate",
    "// action:prompt_",
    "footer_button <...>|<...>|<...>",
    "EXTRA_PROBE_<...> PROBE=",
}


def written(name: str, cells: list[str]) -> set[str]:
    """What is written as code, as the sources of a module would have it."""
    found = [span for cell in cells for span in spans(cell)]
    values = [normal(re.sub(r"<[^<>]+>", VALUE, span)) for span in found]
    return {nameless(value, name) for value in values}


def modules_of(cell: str) -> list[str]:
    """Whose message it is, by the second column."""
    return list(NAMES) if cell == "all" else cell.split(", ")


def problems(text: str) -> Iterator[str]:
    """Messages that are missing, too many, or at the wrong module."""
    for line in re.findall(r"(?m)^\|.*", text):
        if line.count("|") != 5:
            yield f"no message, module, meaning and remedy: {line}"
    table = list(rows(text))
    for row in table:
        if not set(modules_of(row[1])) <= set(NAMES):
            yield f"no module: {row}"
            return
    for name in NAMES:
        known = messages(name)
        own = [row for row in table if name in modules_of(row[1])]
        told = {words for row in own for words in written(name, row)}
        for words in known - told - LOOKED_FOR - OTHERS - NO_MESSAGES:
            yield f"{name} says: {words}"
        for row in own:
            for words in written(name, row[:1]) - known:
                yield f"{name} does not say: {words}"
    everything = {w for row in table for n in NAMES for w in written(n, row)}
    yield from (f"nobody is told of: {w}" for w in OTHERS - everything)
    yield from link_problems(text, DOCUMENT)


MISTAKES = {
    "left out": (r"(?m)^\| `trying again`.*\n", ""),
    "too many": (r"\| `trying again` ", "| `trying`<br>`no more` "),
    "renamed": ("is not ready", "is not there"),
    "of another module": (
        r"(`the report is <file>` \| )z_calibration",
        r"\1auto_z_offset",
    ),
    "a cell less": (r"(?m)^(\| `touched at .*\|) one touch \|", r"\1"),
    "link": (r"\]\(#", "](#no-"),
}


def test_every_message_is_there():
    assert list(problems(TEXT)) == []


@pytest.mark.slow
def test_mistakes_are_found():
    for what, (old, new) in MISTAKES.items():
        changed, count = re.subn(old, new, TEXT)
        assert count, what
        assert list(problems(changed)), what


def test_contents_are_the_headings():
    titles = re.findall(r"(?m)^## (.*)", TEXT)
    assert re.findall(r"(?m)^- \[(.*)\]\(#", TEXT) == titles
