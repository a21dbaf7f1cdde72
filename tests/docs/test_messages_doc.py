"""docs/all_messages.csv has every message of the modules, and no other."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
from functools import lru_cache
from itertools import groupby

import pytest

from tests.docs.documents import link_problems
from tests.docs.messages import (
    DOCUMENT,
    NAMES,
    NO_MESSAGES,
    generated,
    rows_of,
)
from tests.docs.order import out_of_order
from tests.docs.sources import files, messages_of

TEXT = DOCUMENT.read_text(encoding="utf-8")


def problems(text: str) -> Iterator[str]:
    """What `python -m tests.docs.messages` would change, and wrong links."""
    wanted = generated(text).splitlines()
    yield from difflib.unified_diff(text.splitlines(), wanted, n=0)
    # Each is a table of the site
    sections = [name for name, _ in groupby(rows_of(text), lambda r: r.section)]
    yield from (s for s in set(sections) if sections.count(s) > 1)
    yield from link_problems(text, DOCUMENT)


MISTAKES = {
    "left out": (r"(?m)^.*`trying again`.*\n", ""),
    "too many": ("`trying again`", "`trying again` `no more`"),
    "twice": ("`trying again`", "`is not ready` `trying again`"),
    "renamed": ("is not ready", "is not there"),
    "of another module": (
        r"(`the report is <file>`),`[^`]*`",
        r"\1,`extra_probe`",
    ),
    "of each module": (r"(`the report is <file>`),`[^`]*`", r"\1,each"),
    "of no module": (r"(`the report is <file>`),`[^`]*`", r"\1,"),
    "link": (r"\.md#", ".md#no-"),
    "section": (
        r"(?m)^The touches do not agree(,`trying again`)",
        r"Results\1",
    ),
}


def test_every_message_is_there():
    assert list(problems(TEXT)) == []


def test_what_is_no_message_is_in_the_sources():
    told = {
        text
        for name in NAMES
        for tree in files(name).values()
        for text in messages_of(tree)
    }
    assert told >= NO_MESSAGES


@pytest.mark.slow
def test_mistakes_are_found():
    for what, (old, new) in MISTAKES.items():
        changed, count = re.subn(old, new, TEXT)
        assert count, what
        assert list(problems(changed)), what


@lru_cache(maxsize=None)
def everything() -> frozenset[str]:
    """All messages of the modules, values left out."""
    return frozenset(
        text
        for name in NAMES
        for tree in files(name).values()
        for text in messages_of(tree) - NO_MESSAGES
    )


def test_any_three_words_find_the_message():
    shown = " ".join(TEXT.replace('""', '"').split())
    searched = 0
    for text in everything():
        pieces = re.split(
            r"<\.\.\.>|z_calibration|\w+_probe|auto_z_offset", f" {text} "
        )
        for piece in pieces:
            # A word that a value joins is no whole one
            words = re.findall(r"(?<=\s)\S+(?=\s)", piece)
            for three in zip(words, words[1:], words[2:]):
                searched += 1
                assert " ".join(three) in shown, text
    assert searched > 3000


def test_advice_comes_last():
    assert len(everything()) > 300
    assert [text for text in everything() if out_of_order(text)] == []


@pytest.mark.parametrize(
    "message",
    [
        "it is dead: check the wire",
        "it is dead. Write another pin",
        "it is dead, check the wire",
        "it is dead; check the wire; it may be broken",
        "it is dead; check the wire, home again",
        "it is dead; check the wire, where a trigger was expected",
        "it is dead; check the height, which is 2 mm below",
    ],
)
def test_other_orders_are_found(message):
    assert out_of_order(message)


@pytest.mark.parametrize(
    "message",
    [
        "it is dead; check the wire, then home again",
        "it is dead: it has no wire; if it has one, check that",
        "it is dead; check the wire, set pin, or leave it out",
    ],
)
def test_this_order_is_right(message):
    assert not out_of_order(message)
