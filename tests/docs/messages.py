"""The rows of docs/messages.md: what they say, and where, is of the sources.

    build/venv/bin/python -m tests.docs.messages

writes them anew: a message that is gone goes, a new one comes below the others of its
file.  Words between < and >, the order, and the last column are kept as they are: they
are written by hand.
"""

from __future__ import annotations

import re
from functools import lru_cache
from pathlib import Path

from tests.docs.documents import normal, spans
from tests.docs.sources import ROOT, VALUE, files, messages_of

DOCUMENT = ROOT / "docs" / "messages.md"
NAMES = ("z_calibration", "auto_z_offset", "extra_probe", "dockable_probe")
# Names, beginnings of lines, and what is looked for in messages
NO_MESSAGES = {
    "get_mcu add_stepper get_steppers home_start query_endstop",
    "// action:prompt_",
    "named z_touch.core",
    "No trigger",
    "Communication timeout during",
    "Unable to obtain",
}
HEAD = ("|message|raised in|besides|", "|---|---|---|")


def key(span: str) -> str:
    """What a message is known by: values and names of modules are anything."""
    text = normal(re.sub(r"<[^<>]+>", VALUE, span))
    return re.sub("|".join(NAMES), VALUE, text)


def place(path: Path) -> str:
    """A file, as a reader finds it in z_touch; the four modules are doors."""
    if path.parent == ROOT:
        return "door"
    return str(path.relative_to(ROOT / "z_touch").with_suffix(""))


@lru_cache
def raised() -> dict[str, dict[str, str]]:
    """Where each message is raised, and how it reads there: by its key."""
    found: dict[str, dict[str, str]] = {}
    for name in NAMES:
        for path, tree in files(name).items():
            for text in messages_of(tree) - NO_MESSAGES:
                found.setdefault(key(text), {})[place(path)] = text
    return {k: v for k, v in found.items() if k not in NO_MESSAGES}


def cells(line: str) -> list[str]:
    """Of a row of a table."""
    return re.split(r"(?<!\\)\|", line)[1:-1]


def is_row(line: str) -> bool:
    """Whether a line is of a table, below its head."""
    return line.startswith("|") and line not in HEAD


def row(told: list[str], note: str) -> str:
    """Of messages that belong together."""
    places = sorted({p for span in told for p in raised()[key(span)]})
    cell, where = ("<br>".join(f"`{t}`" for t in c) for c in (told, places))
    return f"|{cell}|{where}|{note}|"


def generated(text: str) -> str:
    """The document with the messages of the sources, and no others."""
    lines: list[str] = []
    told: set[str] = set()
    for line in text.splitlines():
        if not is_row(line):
            lines.append(line)
            continue
        columns = cells(line)
        own = [s for s in spans(columns[0]) if key(s) in raised()]
        own = [s for s in own if key(s) not in told]
        told |= {key(span) for span in own}
        if own:
            lines.append(row(own, columns[-1]))
    for new in sorted(raised().keys() - told):
        insert(lines, new)
    return "\n".join(lines) + "\n"


def insert(lines: list[str], new: str) -> None:
    """A message that nobody has placed yet: below the others of its file."""
    (where, text), *_ = sorted(raised()[new].items())
    ends = [
        i
        for i, line in enumerate(lines)
        if is_row(line) and f"`{where}`" in cells(line)[1]
    ]
    rows = [i for i, line in enumerate(lines) if is_row(line)]
    lines.insert((ends or rows)[-1] + 1, row([text], ""))


if __name__ == "__main__":
    before = DOCUMENT.read_text(encoding="utf-8")
    DOCUMENT.write_text(generated(before), encoding="utf-8")
