"""docs/reliability.md shows the figures beside it, and they are complete."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.campaign import fault_cases, jobs, tables
from tools.campaign.walks import gaps
from tools.campaign.walks.machines import BASES

DOCS = Path(__file__).resolve().parents[2] / "docs"
LEAST_PAIRS, HOSTS = 2000, 5


@pytest.fixture(scope="module")
def figures():
    return json.loads((DOCS / "reliability.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def document():
    return (DOCS / "reliability.md").read_text(encoding="utf-8")


def test_every_command_was_tried_with_every_fault(figures):
    assert [found["job"] for found in figures["faults"]] == list(jobs.JOBS)
    kinds = set()
    for found in figures["faults"]:
        assert len(found["hosts"]) > 1
        assert found["runs"] == found["survived"] > 0
        kinds |= set(found["faults"])
    assert kinds == set(tables.KINDS)


def test_every_command_was_tried_on_every_dock(figures):
    found = {one["job"]: one for one in figures["docks"]["faults"]}
    assert list(found) == list(jobs.DOCK_JOBS)
    for one in found.values():
        assert one["runs"] == one["survived"] > 0
    hosts = {host for one in found.values() for host in one["hosts"]}
    assert len(hosts) == HOSTS


def test_pairs_are_enough(figures):
    pairs = figures["pairs"]
    assert [found["job"] for found in pairs["faults"]] == list(jobs.JOBS)
    assert sum(found["runs"] for found in pairs["faults"]) >= LEAST_PAIRS
    hosts = {host for found in pairs["faults"] for host in found["hosts"]}
    assert len(hosts) == HOSTS
    for found in pairs["faults"]:
        assert found["runs"] == found["survived"]
        assert all(one["reason"] or one["ended"] for one in found["blind"])


def test_document_says_what_is_judged(document):
    text = " ".join(document.split())
    for words in (
        f"{jobs.FLOOR_MARGIN:g} mm below where a trigger is expected",
        f"within {fault_cases.GAP_ERROR:.3f} mm of that of a run without",
        f"strikes {fault_cases.INTO_A_MOVE * 1e3:g} ms into it",
        f"within {gaps.GAP_ERROR:g} mm, what is told and what has grown",
        f"{len(BASES)} machines",
        f"pressed up to {fault_cases.BLIND_BODY:g} mm deeper",
    ):
        assert words in text, words
