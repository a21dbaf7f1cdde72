"""A plugin of pytest: says to klippy which test runs, and keeps how each ended."""

from __future__ import annotations

import hashlib
import os
from collections import Counter
from pathlib import Path

import pytest

_OF_A_TABLE = 3
_folder = Path(os.environ["PLANTED_HITS"])
_worker = os.environ.get("PYTEST_XDIST_WORKER", "main")
_now = _folder / f"now-{_worker}"
_now.write_text(16 * "0", encoding="ascii")


def number_of(test: str) -> str:
    """What the name of a test is in the page, and its file of blocks."""
    return hashlib.sha256(test.encode("utf-8")).hexdigest()[:16]


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Of a table its first cases: they stand for the others."""
    before: Counter[str] = Counter()
    kept = []
    for item in items:
        function = item.nodeid.partition("[")[0]
        before[function] += 1
        if before[function] <= _OF_A_TABLE:
            kept.append(item)
    items[:] = kept


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """From now on it is this one, also for the klippys that run already."""
    slow = "slow" if item.get_closest_marker("slow") else "test"
    item.user_properties.append(("cases", slow))
    # In its place: klippy has the file mapped
    with _now.open("r+b") as file:
        file.write(number_of(item.nodeid).encode("ascii"))


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """A line for each that was run: how it ended, its cases, its name."""
    # What runs the tests itself, or hears of all its workers' tests
    if _worker == "main" and report.when == "call":
        cases = dict(report.user_properties)["cases"]
        with (_folder / "ended").open("a", encoding="utf-8") as file:
            line = f"{report.outcome}\t{report.duration:.3f}\t{cases}"
            file.write(f"{line}\t{report.nodeid}\n")
