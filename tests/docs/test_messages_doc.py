"""docs/messages.md has every message of the modules, and no other."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator

import pytest

from tests.docs.documents import link_problems
from tests.docs.messages import (
    DOCUMENT,
    NAMES,
    NO_MESSAGES,
    cells,
    generated,
    is_row,
)
from tests.docs.sources import files, messages_of

TEXT = DOCUMENT.read_text(encoding="utf-8")
# Nobody reads more than that
MOST_WORDS = 7000


def problems(text: str) -> Iterator[str]:
    """What `python -m tests.docs.messages` would change, and wrong links."""
    for line in filter(is_row, text.splitlines()):
        if len(cells(line)) != 3:
            yield f"no message, place and note: {line}"
            return
    wanted = generated(text).splitlines()
    for line in difflib.unified_diff(text.splitlines(), wanted, n=0):
        if re.match(r"[-+]\|", line):
            yield line
    yield from link_problems(text, DOCUMENT)


MISTAKES = {
    "left out": (r"(?m)^\|`trying again`.*\n", ""),
    "too many": (r"\|`trying again`", "|`trying again`<br>`no more`"),
    "twice": (r"\|`trying again`", "|`is not ready`<br>`trying again`"),
    "renamed": ("is not ready", "is not there"),
    "of another file": (
        r"(`the report is <file>`)\|`[^`]*`",
        r"\1|`core/host`",
    ),
    "a cell less": (r"(?m)^(\|`touched at .*\|)\|", r"\1"),
    "link": (r"\]\(#", "](#no-"),
}


def test_every_message_is_there():
    assert list(problems(TEXT)) == []


def test_short_enough_to_read():
    assert len(TEXT.split()) <= MOST_WORDS


def test_what_is_no_message_is_in_the_sources():
    everything = {
        text
        for name in NAMES
        for tree in files(name).values()
        for text in messages_of(tree)
    }
    assert everything >= NO_MESSAGES


@pytest.mark.slow
def test_mistakes_are_found():
    for what, (old, new) in MISTAKES.items():
        changed, count = re.subn(old, new, TEXT)
        assert count, what
        assert list(problems(changed)), what


def test_contents_are_the_headings():
    titles = re.findall(r"(?m)^## (.*)", TEXT)
    assert re.findall(r"(?m)^- \[(.*)\]\(#", TEXT) == titles
