"""The tour of docs/playground.md, for the page and for its test."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

_DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "playground.md"
_TITLE = re.compile(r"\*\*(.*?)\.\*\* ")


class Step(NamedTuple):
    """text: in Markdown, on one line, without the title."""

    title: str
    text: str


def steps() -> list[Step]:
    """The steps in their order."""
    text = _DOCUMENT.read_text(encoding="utf-8")
    tour = text.partition("\n## A tour\n")[2].partition("\n## ")[0]
    found = []
    for part in re.split(r"^\d+\. ", tour, flags=re.M)[1:]:
        words = " ".join(part.split())
        title = _TITLE.match(words)
        assert title, words
        found.append(Step(title[1], words[title.end() :]))
    return found
