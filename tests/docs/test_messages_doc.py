"""docs/all_messages.csv has every message of the modules, and no other."""

from __future__ import annotations

import difflib
from collections.abc import Iterator
from functools import lru_cache
from itertools import groupby

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


@lru_cache(maxsize=None)
def everything() -> frozenset[str]:
    """All messages of the modules, values left out."""
    return frozenset(
        text
        for name in NAMES
        for tree in files(name).values()
        for text in messages_of(tree) - NO_MESSAGES
    )


def test_advice_comes_last():
    assert len(everything()) > 300
    assert [text for text in everything() if out_of_order(text)] == []
