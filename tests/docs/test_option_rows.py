"""The pages of auto_z_offset and extra_probe say of each option what its row says."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from typing import Any

import pytest

from tests.docs.documents import OPTIONS, part, rows, spans, text_of
from tests.docs.option_rows import problems_of_lines, range_of, value_of
from z_touch.core import options

SETTINGS = {
    name: importlib.import_module(f"z_touch.{name}.settings")
    for name in ("auto_z_offset", "extra_probe")
}
# The sources are plain ASCII
UNITS = {"mm/s^2": "mm/s²", "C": "°C"}
# As the pages have what an owner writes
WORDS = {
    options.RESULT: "`median` or `average`",
    SETTINGS["auto_z_offset"].RESULT: "`average` or `median`",
}


def range_in_table(row: Any) -> str:
    """Unit and range of an option."""
    row = row._replace(unit=UNITS.get(row.unit, row.unit))
    if row.kind.word == options.PAIR.word:
        return f"X, Y in {row.unit}"
    if "maxval" in row.limits:
        limits = "{minval:g} to {maxval:g}".format(**row.limits)
        return f"{row.unit}, {limits}" if row.unit else limits
    return WORDS.get(row.kind) or range_of(row)


def problems_of_table(text: str, table: tuple[Any, ...]) -> Iterator[str]:
    """Where the tables of options differ from the rows of the source."""
    cells = {
        spans(row[0])[0]: row[1:3]
        for row in rows(part(text, OPTIONS))
        if len(row) == 4
    }
    by_name = {row.name: row for row in table}
    for name in sorted(set(cells) ^ set(by_name)):
        yield f"{name}: only in the table or only in the source"
    for name in sorted(set(cells) & set(by_name)):
        (default, words), row = cells[name], by_name[name]
        if words != range_in_table(row):
            yield f"{name}: {words!r}, it is {range_in_table(row)!r}"
        # Other words say where a default comes from that is none of the row
        literal = re.fullmatch("`([^`]+)`", default)
        written = literal[1] if literal and literal[1] not in by_name else ""
        if written != value_of(row):
            yield f"{name}: default {default!r}, it is {row.default!r}"


def problems(name: str, text: str) -> Iterator[str]:
    """Where a page differs from the rows."""
    table = SETTINGS[name].OPTIONS
    yield from problems_of_lines(text, table)
    yield from problems_of_table(text, table)


MISTAKES = {
    "left out": (r"(?m)^\| `lift_speed` .*\n", ""),
    "default": (r"(\| `samples_tolerance` \| )`0.1`", r"\1`0.2`"),
    "default of another": (
        r"(\| `(?:probe_z|position)_min` \| )[^|]*",
        r"\1`-1` ",
    ),
    "limit": (r"(\| `samples` .*)≥ 1", r"\1≥ 2"),
    "kind of limit": (r"(\| `speed` .*)> 0", r"\1≥ 0"),
    "line": (r"(?m)^(#lift_speed:.*\n#   )", r"\1So: "),
    "value": (r"(?m)^#samples: 1", "#samples: 2"),
    "no comment": (r"(?m)^(#lift_speed:.*\n)(#   .*\n)+", r"\1"),
    "no option": (r"(?m)^#speed: ", "#no_speed: "),
}


@pytest.mark.parametrize("name", SETTINGS)
def test_page_says_of_each_option_what_its_row_says(name):
    text = text_of(name)
    assert list(problems(name, text)) == []
    for what, (old, new) in MISTAKES.items():
        changed, count = re.subn(old, new, text)
        assert count, what
        assert list(problems(name, changed)), what
