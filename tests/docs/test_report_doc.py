"""docs/report.md: what a report tells, and its pictures."""

from __future__ import annotations

import ast
import csv
import re
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.documents import link_problems, normal, rows, spans
from tests.docs.pictures import DOCS
from tests.docs.sources import VALUE, texts
from tools.kit.product import picture, runs, verdict

DOCUMENT = DOCS / "report.md"
# What has happened on the printers of the pictures
STORIES = (
    "good",
    "dirt",
    "wear",
    "pin",
    "loose",
    "plate",
    "refused",
    "accuracy",
)
with (DOCS / "report_texts.csv").open(encoding="utf-8", newline="") as lines:
    TABLE = ["| " + " | ".join(row[1:]) + " |" for row in csv.reader(lines)]
TEXT = "\n".join(
    [
        DOCUMENT.read_text(encoding="utf-8"),
        TABLE[0],
        "|---|---|---|",
        *TABLE[1:],
        "",
    ]
)
SOURCE = Path(verdict.__file__).read_text(encoding="utf-8")
# For what is missing in a record, and what is looked for in it
NO_TEXTS = {
    "no reason is kept",
    *verdict.WORDS,
    *(text for words in verdict.WORDS.values() for text in words),
    *(text for texts in verdict.WORN.values() for text in texts),
    *verdict.STEADIER.values(),
    verdict.CLEAN,
    *verdict.TOUCHING.values(),
    "last run",
}
# What sentences are made of: values of a row
PARTS = {
    "in <...>",
    "<...> runs ago",
    "<...> times",
    "<...> <...> mm <...>",
    r"\b<...> is (\S+) mm and was (\S+) mm",
    r"the probe hangs \1 mm below the nozzle and hung \2 mm",
}
# In whose words a reader finds the numbers of the sources
NUMBERS = {
    "GOOD_WORTH": "*Watch* from {:g} mm on",
    "ROUGH_WORTH": "`bed_spread` from {:g} mm on",
    "POOR_WORTH": "*Act* from {:g} mm on",
    "OFTEN": "{:g} of the last",
    "LATEST": "of the last {:g} runs",
    "CHANGE_STAYS": "for the next {:g} good runs",
}


def told() -> set[str]:
    """Every text of more than one word that the report may show, in pieces."""
    found = {
        normal(re.sub(r"%(?:\.\d+)?[sdf]", VALUE, text)).replace("%%", "%")
        for text in texts(ast.parse(SOURCE))
    }
    return {text for text in found if " " in text} - NO_TEXTS - PARTS


def problems(text: str) -> Iterator[str]:
    """What is missing or wrong."""
    written = {
        normal(re.sub(r"<[^<>]+>", VALUE, span))
        for row in rows(text)
        for span in spans(row[0])
    }
    yield from (f"it says: {words}" for words in told() - written)
    # Those of other rooms have a value only, or two
    more = {words for words in written - told() if " " in words}
    yield from (f"it does not say: {words}" for words in more)
    for name, words in NUMBERS.items():
        phrase = words.format(getattr(verdict, name))
        if phrase not in text:
            yield f"{name}: it does not say {phrase}"
    for name in STORIES:
        if f"(report_{name}.svg)" not in text:
            yield f"the picture {name} is not shown"
    yield from link_problems(text, DOCUMENT)


def test_all_that_it_tells_is_there():
    assert not "\n".join(problems(TEXT))


@pytest.fixture
def greenwich(monkeypatch):
    """Days and hours as the pictures have them."""
    monkeypatch.setenv("TZ", "UTC")
    time.tzset()
    yield
    monkeypatch.undo()
    time.tzset()


def records(name):
    lines = (DOCS / f"report_{name}.jsonl").read_bytes().splitlines()
    found = runs.parse_all(lines)
    assert (found.damaged, found.other) == (0, 0)
    return found.runs


@pytest.mark.parametrize("name", STORIES)
def test_pictures_are_drawn_from_what_was_measured(name, greenwich):
    path = DOCS / f"report_{name}.jsonl"
    drawn = path.with_suffix(".svg").read_text(encoding="ascii")
    assert picture.svg(records(name), name=f"docs/{path.name}") == drawn


@pytest.mark.parametrize(
    ("name", "level", "words"),
    [
        ("good", "good", "Nothing to do."),
        ("dirt", "act", "the nozzle is dirty"),
        (
            "wear",
            "watch",
            "Replace the probe's switch soon: its touches spread twice as far as"
            " in January 2026",
        ),
        ("pin", "watch", "Replace the switch of the pin soon: "),
        ("loose", "watch", "Tighten the nozzle, and what holds the probe: "),
        ("plate", "watch", "since then the probe finds the bed 0.1"),
        ("refused", "watch", "3 of the last 10 runs were refused"),
    ],
)
def test_stories_end_as_they_are_told(name, level, words):
    found = verdict.judge(records(name))
    assert found.level == level
    assert words in " ".join(found.texts)
