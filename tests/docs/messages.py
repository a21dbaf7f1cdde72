"""The rows of docs/all_messages.csv: what they say, and who says it, is of the sources.

    build/venv/bin/python -m tests.docs.messages

writes them anew: a message that is gone goes, a new one comes below those beside which
it stands in the sources.  Words between < and >, the order, and the last column are
kept as they are: they are written by hand.  So are the modules, as long as the message
is one of each: which file of theirs it stands in is nothing to a reader.
"""

from __future__ import annotations

import csv
import io
import re
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from tests.docs.documents import normal, spans
from tests.docs.sources import ROOT, VALUE, files, messages_of

DOCUMENT = ROOT / "docs" / "all_messages.csv"
NAMES = ("z_calibration", "auto_z_offset", "extra_probe", "dockable_probe")
# Names, beginnings of lines, what is looked for in messages, and sentences of dialogs,
# which explain themselves
NO_MESSAGES = {
    "// action:prompt_",
    '^// Unknown command:"(.*)"$',
    "No trigger",
    "Keep a hand on the emergency stop.",
    "The buttons move the toolhead; you may move it as you like, too.",
    "'Move' shows buttons that move the toolhead; you may move it as you like, too.",
    "'Done' shows the answers; nothing moves.",
    "'Save' has SAVE_CONFIG write these into printer.cfg; Klipper restarts.",
    "nozzle height",
    "the nozzle",
    "another feature",
    "Unknown pin chip",
    "multiple times",
    "not supported",
    "switch - nozzle",
    "probe - switch",
    "Communication timeout during",
    "Unable to obtain",
}


class Row(NamedTuple):
    """Messages that belong together, as code, and what a person adds to them."""

    section: str
    message: str
    module: str
    besides: str


HEAD = Row("section", "message", "module", "besides")
EACH = "each"


def key(span: str) -> str:
    """What a message is known by: values and names of modules are anything."""
    text = normal(re.sub(r"<[^<>]+>", VALUE, span))
    return re.sub("|".join(NAMES), VALUE, text)


class Raised(NamedTuple):
    """A message as it reads in the sources; its modules, and their files."""

    text: str
    modules: set[str]
    files: set[Path]


@lru_cache
def raised() -> dict[str, Raised]:
    """Each message by its key."""
    found: dict[str, Raised] = {}
    for name in NAMES:
        for path, tree in files(name).items():
            for text in messages_of(tree) - NO_MESSAGES:
                one = found.setdefault(key(text), Raised(text, set(), set()))
                one.modules.add(name)
                one.files.add(path)
    return {k: v for k, v in found.items() if k not in NO_MESSAGES}


def modules_of(cell: str) -> set[str]:
    """Of the third column."""
    return set(NAMES if cell == EACH else spans(cell))


def rows_of(text: str) -> list[Row]:
    """The rows of the data file, without its head."""
    head, *rows = csv.reader(io.StringIO(text))
    assert tuple(head) == HEAD
    return [Row(*row) for row in rows]


def row(section: str, told: list[str], named: str, besides: str) -> Row:
    """Of messages that belong together; named: their modules so far."""
    own = set().union(*(raised()[key(span)].modules for span in told))
    modules = modules_of(named)
    if not modules or not modules <= own:
        modules = own
    cell = " ".join(f"`{name}`" for name in NAMES if name in modules)
    cell = EACH if modules == {*NAMES} else cell
    return Row(section, " ".join(f"`{t}`" for t in told), cell, besides)


def generated(text: str) -> str:
    """The data file with the messages of the sources, and no others."""
    rows: list[Row] = []
    told: set[str] = set()
    for old in rows_of(text):
        own = [s for s in spans(old.message) if key(s) in raised()]
        own = [s for s in own if key(s) not in told]
        told |= {key(span) for span in own}
        if own:
            rows.append(row(old.section, own, old.module, old.besides))
    for new in sorted(raised().keys() - told):
        insert(rows, new)
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([HEAD, *rows])
    return out.getvalue()


def insert(rows: list[Row], new: str) -> None:
    """A message that nobody has placed yet: below the others of its file."""
    text, _modules, its_files = raised()[new]

    def is_beside(old: Row) -> bool:
        return any(
            its_files & raised()[key(span)].files for span in spans(old.message)
        )

    ends = [i for i, old in enumerate(rows) if is_beside(old)]
    last = (ends or [len(rows) - 1])[-1]
    rows.insert(last + 1, row(rows[last].section, [text], "", ""))


if __name__ == "__main__":
    before = DOCUMENT.read_text(encoding="utf-8")
    DOCUMENT.write_text(generated(before), encoding="utf-8")
