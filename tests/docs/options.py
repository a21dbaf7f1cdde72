"""docs/options.csv and the whole sections of the pages: what the rows of options say.

    build/venv/bin/python -m tests.docs.options

writes them anew: an option that is gone goes, a new one comes below the one before it
in its table.  Kept as they are, being written by hand: the order; in the data file the
words of a default that comes from elsewhere, and the last column; in a whole section
the values without `#`.
"""

from __future__ import annotations

import csv
import io
import re
import textwrap
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

from tests.docs.documents import DOCS
from tools.kit import product
from tools.kit.product import options

DATA = DOCS / "options.csv"
NAMES = ("z_calibration", "auto_z_offset", "dockable_probe", "extra_probe")
TABLES = {name: product.OPTIONS[name] for name in NAMES}
COLUMNS = 84
# Up to the first option, the options, and what follows
WHOLE = re.compile(
    r"(\n## The whole section\n.*?\n```ini\n\[[^\n]*\]\n)(.*?)(```\n.*)", re.S
)
LINE = re.compile(r"(#?)([a-z_]+):(.*)\n((?:#   .*\n)*)")
# The sources are plain ASCII
UNITS = {"mm/s^2": "mm/s²", "C": "°C"}
SIGNS = (("above", ">"), ("minval", "≥"), ("maxval", "≤"), ("below", "<"))


class Cells(NamedTuple):
    """A row of the data file."""

    section: str
    option: str
    default: str
    range: str
    more: str


HEAD = Cells("section", "option", "default", "unit, range", "more")


def value_of(row: Any) -> str:
    """The default as an owner writes it; empty: it comes from elsewhere."""
    default = row.default
    if isinstance(default, options.Given):
        default = default.else_
    if default is options.REQUIRED or isinstance(default, options.Same):
        return ""
    if isinstance(default, tuple):
        return ", ".join(f"{value:g}" for value in default)
    if isinstance(default, float):
        return f"{default:g}"
    return "" if default is None else str(default)


def default_of(row: Any, before: str) -> str:
    """In the data file; 'before' may have words for what comes from elsewhere."""
    if row.default is options.REQUIRED:
        return "required"
    if isinstance(row.default, options.Same):
        return f"`{row.default.name}`"
    if value_of(row):
        return f"`{value_of(row)}`"
    is_literal = re.fullmatch("`[^`]*`|required|", before)
    return "-" if is_literal else before


def range_of(row: Any) -> str:
    """Unit and range in the data file."""
    kind, unit = row.kind, UNITS.get(row.unit, row.unit)
    words = " or ".join(f"`{word}`" for word in kind.words)
    if kind.word in ("number", "whole number", options.SAMPLES.word):
        is_count = kind.word != "number"
        text = ", ".join(
            filter(None, ["count" if is_count else unit, *limits(row)])
        )
        return f"{text} or {words}" if words else text
    if words:
        return words
    return f"{kind.word} in {unit}" if unit else kind.word


def limits(row: Any) -> Iterable[str]:
    """Of a number."""
    given = row.limits
    if {"minval", "maxval"} <= set(given):
        return ["{minval:g} to {maxval:g}".format(**given)]
    return [f"{sign} {given[name]:g}" for name, sign in SIGNS if name in given]


def ordered(names: Iterable[str], table: tuple[Any, ...]) -> list[str]:
    """The options of a table in the order of 'names', new ones behind a neighbour."""
    known = [row.name for row in table]
    found = [name for name in dict.fromkeys(names) if name in known]
    for number, name in enumerate(known):
        if name not in found:
            before = known[number - 1] if number else ""
            place = found.index(before) + 1 if before else 0
            found.insert(place, name)
    return found


def data(text: str) -> str:
    """The data file."""
    _, *before = (Cells(*row) for row in csv.reader(io.StringIO(text)))
    out = [HEAD]
    for section, table in TABLES.items():
        old = {
            cells.option: cells for cells in before if cells.section == section
        }
        rows = {row.name: row for row in table}
        for name in ordered(old, table):
            row, cells = (
                rows[name],
                old.get(name, Cells(section, name, "", "", "")),
            )
            default = default_of(row, cells.default)
            out.append(Cells(section, name, default, range_of(row), cells.more))
    written = io.StringIO()
    csv.writer(written, lineterminator="\n").writerows(out)
    return written.getvalue()


def page(text: str, table: tuple[Any, ...]) -> str:
    """A page, with its whole section."""
    begin, block, end = WHOLE.search(text).groups()
    assert LINE.sub("", block) == "", "neither option nor comment"
    lines = LINE.findall(block)
    given = {name: value.strip() for mark, name, value, _ in lines if not mark}
    rows, written = {row.name: row for row in table}, ""
    for name in ordered((name for _, name, _, _ in lines), table):
        row = rows[name]
        is_given = name in given or row.default is options.REQUIRED
        value = given.get(name, value_of(row))
        written += f"{'' if is_given else '#'}{name}: {value}".rstrip() + "\n"
        written += textwrap.fill(
            row.text,
            COLUMNS,
            initial_indent="#   ",
            subsequent_indent="#   ",
            break_on_hyphens=False,
        )
        written += "\n"
    start = text.index(begin)
    return text[:start] + begin + written + end


def generated() -> dict[Path, str]:
    """Each file that has options, and what it has to have."""
    found = {DATA: data(DATA.read_text(encoding="utf-8"))}
    for name, table in TABLES.items():
        path = DOCS / f"{name}.md"
        found[path] = page(path.read_text(encoding="utf-8"), table)
    return found


if __name__ == "__main__":
    for path, text in generated().items():
        path.write_text(text, encoding="utf-8")
