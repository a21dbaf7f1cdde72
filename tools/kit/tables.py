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


def summary_of(file: str) -> str:
    """Of the cells 'touches: difference' of a file, a line for each column."""
    figures = json.loads(Path(file).read_text(encoding="utf-8"))
    rows = []
    for number, head in enumerate(figures["heads"][1:], 1):
        cells = [row[number].split(": ") for row in figures["rows"]]
        known = [cell for cell in cells if len(cell) == 2]
        touches = sum(int(cell[0]) for cell in known)
        worst = max(float(cell[1]) for cell in known)
        rows.append([head, str(len(known)), str(touches), f"{worst:g}"])
    heads = ["host, its program", "runs", "touches", "largest difference, um"]
    return f"\n{markdown(heads, rows)}\n"


def plain(heads: Sequence[str], rows: Rows) -> str:
    """For the console."""
    return tabulate(rows, heads, "simple", disable_numparse=True)
