"""docs/performance.md and its chart show the figures beside them."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.bench.commands import ATTACH_AND_DETACH, COMMANDS, HOME_AND_MESH
from tools.bench.errors import OUTLIER, OUTLIER_CHANCE, UM

DOCS = Path(__file__).resolve().parents[2] / "docs"


@pytest.fixture(scope="module")
def figures():
    return json.loads((DOCS / "performance.json").read_text(encoding="utf-8"))


def test_chart_is_that_of_the_figures(figures):
    svg = (DOCS / "performance.svg").read_text(encoding="utf-8")
    for timing in figures["timings"]:
        assert f">{timing['runs'][0]['seconds']:.3f}<" in svg


def test_figures_are_complete(figures):
    """All commands on all hosts, without a failure, and over fifty seeds."""
    hosts = figures["about"]["hosts"]
    timed = {(t["command"], t["host"]) for t in figures["timings"]}
    assert timed == {(c.name, host) for c in COMMANDS for host in hosts}
    assert not any(timing["failure"] for timing in figures["timings"])
    assert {error["seeds"] for error in figures["errors"]} == {50}
    assert {error["command"] for error in figures["errors"]} >= {
        command.name
        for command in COMMANDS
        # They measure no height of their own
        if command not in (ATTACH_AND_DETACH, HOME_AND_MESH)
    }
    assert figures["about"]["outlier_um"] == OUTLIER * UM
    assert figures["about"]["outlier_chance"] == OUTLIER_CHANCE
