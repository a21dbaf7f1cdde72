"""The simulated column of docs/first_real_printer.md is what the printers show."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.docs.documents import rows
from tools.bench import first

DOCUMENT = (
    Path(__file__).resolve().parents[3] / "docs" / "first_real_printer.md"
)
ORDER = (
    "probe",
    "pin",
    "seconds",
    "+-",
    "apart",
    "sigma",
    "range",
    "drift",
    "one run",
    "gap",
)


def table() -> dict[str, tuple[float, float]]:
    """The smallest and the largest of each figure, by its name here."""
    cells = [row[3] for row in rows(DOCUMENT.read_text(encoding="utf-8"))]
    found = [re.search(r"\((-?[\d.]+) to (-?[\d.]+)\)", cell) for cell in cells]
    ranges = [(float(m[1]), float(m[2])) for m in found if m]
    assert len(ranges) == len(ORDER)
    return dict(zip(ORDER, ranges))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_printer_is_within_what_the_page_says(host):
    # Hosts may round in another way
    for name, value in first.figures(host, 3).items():
        low, high = table()[name]
        assert low - 0.0015 <= value <= high + 0.0015 or name == "seconds", name
        if name == "seconds":
            assert low - 2.0 <= value <= high + 2.0
