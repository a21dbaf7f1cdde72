"""The figures as tables of a document, between two markers."""

from __future__ import annotations

import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from tools.bench.text import summary_text
from tools.bench.timing import OURS

BEGIN = "<!-- figures: written by make bench, not by hand -->"
END = "<!-- end of the figures -->"

Figures = Mapping[str, Any]


def table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table; the first two columns are names, numbers follow."""
    rule = ["---", "---", *("--:" for _ in heads[2:])]
    return ["| " + " | ".join(cells) + " |" for cells in (heads, rule, *rows)]


def time_table(figures: Figures) -> list[str]:
    """Printer seconds of the first run and of the one after it, touches.

    And CPU seconds, the median of all runs.
    """
    heads = ["command", "host", "printer s", "lower bound s", "ratio"]
    heads += ["again s", "ratio", "touches", "CPU s", "at rest"]
    rows = []
    for timing in figures["timings"]:
        if timing["module"] != OURS or timing["failure"]:
            continue
        first, again = timing["runs"][:2]
        cells = [timing["command"], timing["host"]]
        for run in (first, again):
            cells += [f"{run['seconds']:.1f}"]
            cells += [f"{run['bound']:.1f}"] if run is first else []
            cells += [f"{run['ratio']:.2f}"]
        touches = sorted(first["touches"].items())
        cells.append(", ".join(f"{site} {n}" for site, n in touches))
        for name in ("cpu", "idle_cpu"):
            cpu = statistics.median(run[name] for run in timing["runs"])
            cells.append(f"{cpu:.2f}")
        rows.append(cells)
    return table(heads, rows)


def error_table(figures: Figures) -> list[str]:
    """Mean, sigma and worst in um under each condition."""
    errors = [e for e in figures["errors"] if e["module"] == OURS]
    noises = list(dict.fromkeys(error["noise"] for error in errors))
    cells: dict[tuple[str, str], dict[str, str]] = {}
    for error in errors:
        group = cells.setdefault((error["command"], error["host"]), {})
        group[error["noise"]] = summary_text(error)
    rows = [
        [*key, *(group.get(noise, "") for noise in noises)]
        for key, group in sorted(cells.items())
    ]
    return table(["command", "host", *noises], rows)


def cost_table(figures: Figures) -> list[str]:
    """Time of loading and memory."""
    rows = [
        [
            cost["module"],
            cost["host"],
            f"{cost['import_ms']:.1f}",
            f"{cost['memory_kib']:.0f}",
        ]
        for cost in sorted(figures["costs"], key=lambda cost: cost["module"])
        if not cost["other"]
    ]
    return table(["module", "host", "import ms", "memory KiB"], rows)


def about_text(figures: Figures) -> str:
    """What was measured, and on what."""
    about = figures["about"]
    return (
        f"The modules of revision {about['revision']}, with Python"
        f" {about['python']} on {about['processor']}."
    )


def render(figures: Figures) -> str:
    """All that stands between the markers."""
    parts = [
        [about_text(figures)],
        ["### Time", "", *time_table(figures)],
        ["### Error, in um", "", *error_table(figures)],
        ["### Loading", "", *cost_table(figures)],
    ]
    return "\n\n".join("\n".join(part) for part in parts)


def put(file: Path, begin: str, end: str, middle: str) -> None:
    """Replace what stands between two markers of a document.

    Raises ValueError if they are missing.
    """
    text = file.read_text(encoding="utf-8")
    before, found, rest = text.partition(begin)
    after = rest.partition(end)
    if not found or not after[1]:
        raise ValueError(f"{file}: the markers {begin} and {end} are missing")
    whole = f"{before}{begin}\n\n{middle}\n\n{end}{after[2]}"
    file.write_text(whole, encoding="utf-8")


def update(file: Path, figures: Figures) -> None:
    """Replace the figures of a document.

    Raises ValueError if the markers are missing.
    """
    put(file, BEGIN, END, render(figures))
