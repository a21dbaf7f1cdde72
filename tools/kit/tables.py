"""Tables for documents and for people."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from tabulate import tabulate

Rows = Sequence[Sequence[str]]


def markdown(heads: Sequence[str], rows: Rows) -> str:
    """For a document: the first two columns are names, numbers follow."""
    align = ["left", "left", *("right" for _ in heads[2:])]
    return tabulate(rows, heads, "pipe", disable_numparse=True, colalign=align)


def table_of(file: str) -> str:
    """The heads and rows of a file, for a document."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    return f"\n{markdown(figures['heads'], figures['rows'])}\n"


def plain(heads: Sequence[str], rows: Rows) -> str:
    """For the console."""
    return tabulate(rows, heads, "simple", disable_numparse=True)
