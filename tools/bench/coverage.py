"""How many offsets are inside the uncertainty that is told of them.

    python -m tools.bench.coverage [--runs N] [--first] [--csv FILE]

Printers at random, without klippy: three sites whose touches vary by the same
noise and end on whole steps of Z, so of 2.5 um. Each has a history of ten good
runs, and of the refused ones between them; with --first it has that of the refused
runs before its first good one only. One line for each noise and shape of it, one
column for each samples_tolerance and samples_tolerance_retries, or for samples: auto
with a target_uncertainty. Nothing is said ("-") where fewer than one run in ten is
good. Then the first runs after the noise has grown.
"""

from __future__ import annotations

import argparse
import csv
import math
import random
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import NamedTuple, Optional, Union

from simprinter.running import show
from tools.kit.product import (
    AUTO,
    SamplesDiffer,
    Sampling,
    run_log,
    runs,
    statistics,
)

STEP = 0.0025
HISTORY = 10
# Records that may play a part
KEPT = 40
# Runs of one printer
OF_ONE = 60
# Fewer good ones among all that were begun are nobody's printer
LEAST_GOOD = 0.1


def normal(draw: random.Random) -> float:
    return draw.gauss(0.0, 1.0)


def student(draw: random.Random) -> float:
    """Student's t of 5 degrees of freedom, at a standard deviation of 1."""
    square = sum(draw.gauss(0.0, 1.0) ** 2 for _ in range(5))
    return draw.gauss(0.0, 1.0) / math.sqrt(square / 3.0)


class Noise(NamedTuple):
    """Of one touch: mm, shape, and the chance of an outlier of 30 um."""

    name: str
    sigma: float
    shape: Callable[[random.Random], float] = normal
    outliers: float = 0.0


class Setting(NamedTuple):
    """What an owner sets: mm, count, count or auto, how, mm."""

    tolerance: float = 0.01
    retries: int = 0
    samples: Union[int, str] = 3
    method: str = "median"
    target: float = 0.008

    def __str__(self) -> str:
        if self.samples == AUTO:
            return f"auto {1000 * self.target:.0f}"
        return f"{1000 * self.tolerance:.0f}/{self.retries}"


class Run(NamedTuple):
    """Its record, error and uncertainty (mm), None of a refused one."""

    record: runs.Run
    error: Optional[float] = None
    worth: Optional[float] = None


class DrawnPrinter:
    """One that homes anew before each run."""

    def __init__(self, draw: random.Random, noise: Noise) -> None:
        self.draw, self.noise = draw, noise
        self.runs: list[runs.Run] = []
        self.heights: dict[str, float] = {}

    def touch(self, site: str) -> float:
        z = self.heights[site] + self.noise.sigma * self.noise.shape(self.draw)
        if self.draw.random() < self.noise.outliers:
            z += self.draw.choice((-0.03, 0.03))
        return math.floor(z / STEP) * STEP

    def touched(self) -> int:
        """How many touches its last run had."""
        return sum(map(len, self.statistics.touches.values()))

    def run(self, setting: Setting) -> Run:
        """One CALIBRATE_Z, which knows those before it."""
        self.heights = {
            site: self.draw.uniform(0.0, 10.0) for site in runs.SITES
        }
        earlier_runs = {
            site: runs.spreads(self.runs, site) for site in runs.SITES
        }
        target = setting.target if setting.samples == AUTO else None
        self.statistics = statistics.RunStatistics(STEP, earlier_runs, target)
        found = self.measured(self.statistics, setting)
        self.runs = [*self.runs, found.record][-KEPT:]
        return found

    def measured(self, run: statistics.RunStatistics, setting: Setting) -> Run:
        sampling = Sampling(
            setting.samples,
            setting.tolerance,
            setting.retries,
            setting.method,
            *(2.0, 4.0, 6.0),
        )
        for site in runs.SITES:
            series = run.begin(site, sampling)
            try:
                while not series.is_complete():
                    series.add(self.touch(site))
            except SamplesDiffer:
                record = runs.Run(False, 0.0, run_log.site_runs(run))
                return Run(record)
        errors = {s: run.estimates[s].z - self.heights[s] for s in runs.SITES}
        error = errors["bed"] - (errors["switch"] - errors["nozzle"])
        record = runs.Run(True, 0.0, run_log.site_runs(run))
        return Run(record, error, run.uncertainty())


def coverage(
    noise: Noise, setting: Setting, count: int, *, first: bool = False
) -> Optional[float]:
    """The part of the good runs that is inside."""
    draw = random.Random(f"{noise.name}/{setting}/{first}")
    good, begun, inside = 0, 0, 0
    while good < count:
        printer, of_one, fine = DrawnPrinter(draw, noise), 0, 0
        while of_one < OF_ONE and good < count:
            begun += 1
            if begun > 100 and good + fine < LEAST_GOOD * begun:
                return None
            run = printer.run(setting)
            if run.error is None:
                continue
            fine += 1
            if first:
                printer.runs = []
            elif fine <= HISTORY:
                continue
            good, of_one = good + 1, of_one + 1
            inside += abs(run.error) <= run.worth
    return inside / good


def grown(
    before: float, after: float, setting: Setting, printers: int, runs: int = 4
) -> list[float]:
    """The part that is inside in each of the runs after the noise has grown."""
    draw, inside = random.Random(f"{before}/{after}/{setting}"), [0] * runs
    for _ in range(printers):
        printer = DrawnPrinter(draw, Noise("", before))
        for _ in range(HISTORY + 5):
            printer.run(setting)
        printer.noise = Noise("", after)
        for number in range(runs):
            found = printer.run(setting)
            while found.error is None:
                found = printer.run(setting)
            inside[number] += abs(found.error) <= found.worth
    return [count / printers for count in inside]


SIGMAS = (0.001, 0.003, 0.005, 0.008, 0.010)
SETTINGS = [
    Setting(tolerance, retries)
    for tolerance in (0.005, 0.008, 0.020)
    for retries in (0, 3, 10)
] + [Setting(samples=AUTO, target=target) for target in (0.005, 0.008)]
KINDS = (
    ("normal", normal, 0.0),
    ("Student's t", student, 0.0),
    ("2 % of 30 um", normal, 0.02),
)
GROWTH = ((0.003, 0.006), (0.003, 0.010), (0.005, 0.010))
HEADS = ("runs", "noise", "sigma, um", "setting, um/retries", "inside, %")


def percent(part: Optional[float]) -> str:
    return "-" if part is None else f"{100.0 * part:.1f}"


def tables(
    pool: ProcessPoolExecutor, given: argparse.Namespace
) -> Iterator[tuple]:
    """The cells, as HEADS names them; tells a line of them at a time."""
    runs = (
        "first run of a printer"
        if given.first
        else "with a history of ten runs"
    )
    show(" " * 22 + "".join(f"{setting!s:>7}" for setting in SETTINGS))
    for kind, shape, outliers in KINDS:
        for sigma in SIGMAS:
            um = f"{1000 * sigma:.0f}"
            noise = Noise(f"{kind}, {um} um", sigma, shape, outliers)
            inside = partial(
                coverage, noise, count=given.runs, first=given.first
            )
            parts = [percent(part) for part in pool.map(inside, SETTINGS)]
            show(f"{noise.name:22}" + "".join(f"{part:>7}" for part in parts))
            for setting, part in zip(SETTINGS, parts):
                yield runs, kind, um, setting, part


def main(words: Sequence[str]) -> int:
    """Print the tables."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.coverage")
    parser.add_argument("--runs", type=int, default=600)
    parser.add_argument("--first", action="store_true")
    parser.add_argument("--csv", type=Path, help="write the cells there, too")
    given = parser.parse_args(words)
    with ProcessPoolExecutor(2) as pool:
        rows = list(tables(pool, given))
    if given.csv is not None:
        with given.csv.open("w", newline="") as file:
            csv.writer(file, lineterminator="\n").writerows([HEADS, *rows])
    for before, after in () if given.first else GROWTH:
        parts = grown(before, after, Setting(0.020, 3), given.runs)
        name = f"{1000 * before:.0f} um, then {1000 * after:.0f}"
        show(f"{name:22}" + "".join(f"{percent(p):>7}" for p in parts))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
