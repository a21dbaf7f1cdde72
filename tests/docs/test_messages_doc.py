"""docs/all_messages.csv has every message of the modules, and no other."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterator
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
from tests.docs.sources import files, messages_of

TEXT = DOCUMENT.read_text(encoding="utf-8")
# How an advice begins
ADVICE = (
    "(?:add|attach|begin|check|choose|clean|correct|do|end|exchange|fetch|give|go"
    "|home|keep|lay|leave|let|look|lower|make|mend|move|narrow|press|put|raise"
    "|remove|repair|run|save|seat|set|take|tighten|try|update|use|wait|watch|wire"
    "|write)\\b"
)


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
    "of another file": (
        r"(`the report is <file>`),`[^`]*`",
        r"\1,`core/host`",
    ),
    "link": (r"\.md#", ".md#no-"),
    "section": (
        r"(?m)^The touches do not agree(,`trying again`)",
        r"Results\1",
    ),
}


def test_every_message_is_there():
    assert list(problems(TEXT)) == []


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


def out_of_order(message: str) -> bool:
    """Whether an advice does not come last, or two are joined by a comma."""
    text = re.sub(r"\([^()]*\)", "", message)
    if re.search(rf"[:.] {ADVICE}", text, re.IGNORECASE):
        return True
    facts, _, advice = text.rpartition("; ")
    if re.search(rf"(?:^|; ){ADVICE}", facts):
        return True
    # After a condition, or one of several that may be chosen from
    is_choice = re.match("(?i)(?:if|where|for) ", advice) or ", or " in advice
    checked = facts if is_choice else text
    return bool(re.search(rf", {ADVICE}", checked))


def test_advice_comes_last():
    everything = [
        text
        for name in NAMES
        for tree in files(name).values()
        for text in messages_of(tree)
    ]
    assert len(everything) > 300
    assert [text for text in everything if out_of_order(text)] == []


@pytest.mark.parametrize(
    "message",
    [
        "it is dead: check the wire",
        "it is dead. Write another pin",
        "it is dead, check the wire",
        "it is dead; check the wire; it may be broken",
        "it is dead; check the wire, home again",
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
