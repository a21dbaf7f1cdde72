"""docs/z_calibration.md says of each option what its row in settings.py says."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.docs.documents import OPTIONS, part, rows, spans, text_of
from tests.docs.option_rows import problems_of_lines, range_of, same_value
from z_touch.core import options
from z_touch.z_calibration import settings

TEXT = text_of("z_calibration")
OLD = "Old names"
# As the page has what an owner writes
WORDS = {
    settings.SHIFT: "X, Y in mm",
    options.PAIR: "X, Y in mm",
    options.MARGINS: "low, high in mm",
    options.SAMPLES: "count, ≥ 1",
    options.RESULT: "`median` or `average`",
    options.FLAG: "`true` or `false`",
    settings.SAFE_Z: "mm, > 0",
}


def range_in_table(row: Any) -> str:
    """Unit and range of an option."""
    if row.kind.word == options.PAIR.word:
        return "X, Y in mm"
    if row.name == "save_button":
        return ", ".join(f"`{word}`" for word in settings.SAVE_BUTTON)
    return WORDS.get(row.kind) or range_of(row)


def problems_of_table(text: str) -> Iterator[str]:
    """Where the tables of options differ from the rows of the source."""
    body = part(text, OPTIONS).replace(part(text, OLD), "")
    table = {spans(row[0])[0]: row[1:3] for row in rows(body)}
    by_name = {row.name: row for row in settings.OPTIONS}
    for name in sorted(set(table) ^ set(by_name)):
        yield f"{name}: only in the table or only in the source"
    for name in sorted(set(table) & set(by_name)):
        (default, words), row = table[name], by_name[name]
        if words != range_in_table(row):
            yield f"{name}: {words!r}, it is {range_in_table(row)!r}"
        # Words say where a default comes from that is none of the row
        literal = re.fullmatch("`([^`]+)`", default)
        if not same_value(literal[1] if literal else "", row):
            yield f"{name}: default {default!r}, it is {row.default!r}"


def problems_of_old_names(text: str) -> Iterator[str]:
    """Where the table of old names differs from the rows of the source."""
    table = {
        (spans(row[0])[0], spans(row[1])[0]) for row in rows(part(text, OLD))
    }
    known = {
        (old, row.name)
        for row in settings.OPTIONS
        for entry in row.old
        for old in ((entry,) if isinstance(entry, str) else entry)
    }
    for old, name in sorted(table ^ known):
        yield f"{old} of {name}: only in the table or only in the source"


def problems(text: str) -> Iterator[str]:
    """Where the page differs from the rows."""
    yield from problems_of_lines(text, settings.OPTIONS)
    yield from problems_of_table(text)
    yield from problems_of_old_names(text)


MISTAKES = {
    "left out": (r"(?m)^\| `lift_speed` .*\n", ""),
    "default": (r"(\| `travel_margin` \| )`1.0`", r"\1`1.5`"),
    "default of another": (r"(\| `position_min` \| )[^|]*", r"\1`-1` "),
    "range": (r"(\| `switch_offset` .*)≥ 0", r"\1> 0"),
    "line": (r"(?m)^(#lift_speed:\n#   )All", r"\1Some"),
    "value": (r"(?m)^#history_runs: 1000", "#history_runs: 100"),
    "no option": (r"(?m)^#speed: ", "#no_speed: "),
    "old name": (r"\| `clearance` ", "| `clear` "),
}


def test_page_says_of_each_option_what_its_row_says():
    assert list(problems(TEXT)) == []


@pytest.mark.parametrize("what", MISTAKES)
def test_mistakes_are_found(what):
    changed, count = re.subn(*MISTAKES[what], TEXT)
    assert count
    assert list(problems(changed))
