"""The chart of the benchmark: each command on each host beside its bound."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from tools.kit import charts


def draw(figures: Mapping[str, Any], file: Path) -> None:
    """Write it: printer seconds right after G28, and the lower bound."""
    done = [
        (f"{t['command']}, {t['host']}", t["runs"][0])
        for t in figures["timings"]
    ]
    series = {
        "printer seconds": [run["seconds"] for _, run in done],
        "lower bound": [run["bound"] for _, run in done],
    }
    labels = [label for label, _ in done]
    charts.draw_bars(
        "Printer seconds right after G28, and the lower bound",
        labels,
        series,
        file,
    )
