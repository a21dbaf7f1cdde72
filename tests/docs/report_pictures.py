"""Draw the reports that docs/z_calibration.md shows, of printers at random.

python -m tests.docs.report_pictures
"""

from __future__ import annotations

import random
from pathlib import Path

from tests.unit.runs import make_run, make_runs
from tests.unit.test_uncertainty_cycles import RandomPrinter
from z_touch.history import report
from z_touch.uncertainty import cycles

DOCS = Path(__file__).resolve().parents[2] / "docs"
# Noon, so that it is the same day nearly everywhere
START, DAY = 1699963200.0, 86400.0


def draw_runs() -> str:
    """Three months, in which the nozzle is exchanged and two runs fail."""
    runs = make_runs(45, 11)
    other = {"switch": 0.12, "bed": 0.12}
    runs += make_runs(45, 12, moved=other)
    draw = random.Random(13)
    for number, run in enumerate(runs):
        z = {site: record["z"] for site, record in run["sites"].items()}
        run["time"] = START + DAY * number
        run["offset"] = z["bed"] - (z["switch"] - z["nozzle"] + 0.44)
        run["uncertainty"] = draw.uniform(0.005, 0.009)
        run["temperatures"]["heater_bed"] = draw.choice((60.0, 60.0, 100.0))
    for number, reason in (
        (20, "bed: No trigger on probe after full movement"),
        (63, "nozzle: samples differ by 0.0275 mm"),
    ):
        runs[number] = {
            **runs[number],
            "ok": False,
            "offset": None,
            "reason": reason,
        }
    return report.svg(runs)


def draw_accuracy() -> str:
    """A probe that hangs elsewhere each time it is attached."""
    draw = random.Random(14)
    printer = RandomPrinter(draw, "seat")
    found = [printer.cycle() for _ in range(10)]
    record = {
        **make_run(draw, time=START),
        "verdict": cycles.judge(found).text,
        "cycles": [
            {site: getattr(cycle, site) for site in cycles.SITES}
            for cycle in found
        ],
    }
    return report.svg([record])


PICTURES = {
    DOCS / "report_runs.svg": draw_runs,
    DOCS / "report_accuracy.svg": draw_accuracy,
}

if __name__ == "__main__":
    for path, draw_one in PICTURES.items():
        path.write_text(draw_one(), encoding="utf-8")
