"""docs/reliability.md shows the figures beside it, and they are complete."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tools.campaign import fault_cases, jobs, tables
from tools.campaign.__main__ import parse
from tools.campaign.drawn_printers import MODULES, MOST_REFUSED

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Of each module, in the figures and in a run of one's own
LEAST_PRINTERS = 300
LEAST_PAIRS, HOSTS = 2000, 5
USUAL_PRINTERS = 300


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


def test_random_printers_are_enough(figures):
    assert set(figures["printers"]) == set(MODULES)
    for found in figures["printers"].values():
        assert found["runs"] >= LEAST_PRINTERS
        assert len(found["hosts"]) > 1
        assert found["failures"] == []
        assert found["healthy_refused"] <= MOST_REFUSED * found["healthy"]


def test_own_run_tries_as_many_as_it_says(document):
    assert parse([]).printers == USUAL_PRINTERS
    assert f"{USUAL_PRINTERS} random printers for each module" in document


def test_document_says_what_is_judged(document):
    text = " ".join(document.split())
    for words in (
        f"{jobs.FLOOR_MARGIN:g} mm below where a trigger is expected",
        f"within {fault_cases.GAP_ERROR:.3f} mm of that of a run without",
        f"strikes {fault_cases.INTO_A_MOVE * 1e3:g} ms into it",
        "at most half may be refused",
        f"pressed up to {fault_cases.BLIND_BODY:g} mm deeper",
    ):
        assert words in text, words
