"""The chart of docs/performance.md shows the figures beside it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def figures():
    return json.loads((DOCS / "performance.json").read_text(encoding="utf-8"))


def test_chart_is_that_of_the_figures(figures):
    svg = (DOCS / "performance.svg").read_text(encoding="utf-8")
    for timing in figures["timings"]:
        assert f">{timing['runs'][0]['seconds']:.3f}<" in svg
