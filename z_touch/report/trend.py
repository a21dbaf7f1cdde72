"""What many runs say of a printer: drifts, changes, and spreads that grow.

A drift is found by the test of Mann and Kendall, which asks for each two runs which one
was higher: it wants no certain distribution, and single runs that are far off do not
decide. What hangs together from run to run, such as plates in turn, counts as fewer
runs. What one step between two runs explains better than a line is a change, and a new
stretch begins.

Only runs that are like the last good one are looked at: as hot, with the same
bed_spread.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from collections import Counter
from statistics import median
from typing import Callable, Dict, List, NamedTuple, Optional, Sequence, Tuple

from ..z_calibration.runs import SITES, Run, is_as_hot
from .noise import f_limit, pool_usual
from .steps import (
    LINE_ODDS,
    SHIFT,
    SIZE_RUNS,
    WINDOW,
    best_split,
    find_steps,
    odds_of_step,
    off_line,
    size_of_step,
    square_of,
    together,
    without_single_ones,
)

# Runs for a drift, at least
DRIFT_RUNS = 20

# A drift is one from so many standard deviations of its statistic on: a chance of 7e-6
# at each look
TREND_SIGMA = 4.5

# Runs at both ends whose spreads are compared; they have grown from so much on, in mm
# and in times
GROWTH_RUNS = 20
GROWTH = 0.001
GROWTH_TIMES = 1.5

# Part of a change by which one may miss where it was before, and is back there
BACK = 0.2


# The heights of a run (mm) that are looked at, by name
HEIGHTS: Dict[str, Callable[[Run], float]] = {
    "nozzle height": lambda run: run.z("nozzle"),
    "switch - nozzle": lambda run: run.body(),
    "probe - switch": lambda run: run.z("bed") - run.z("switch"),
}


class Change(NamedTuple):
    """A height that has changed at once.

    height: of HEIGHTS. by: mm. number: of the first run after it, among all runs.
    """

    height: str
    by: float
    number: int


class Drift(NamedTuple):
    """A height of HEIGHTS that drifts: by so much (mm) in so many runs, the latest."""

    height: str
    by: float
    runs: int


class Growth(NamedTuple):
    """A site whose touches vary more than before (mm), in so many runs."""

    site: str
    before: float
    after: float
    runs: int


def like_last(runs: Sequence[Run]) -> List[Tuple[int, Run]]:
    """Return the good runs that are like the last good one, with their numbers."""
    good = [(number, run) for number, run in enumerate(runs) if run.ok]
    if not good:
        return []
    last = good[-1][1]
    return [
        (number, run)
        for number, run in good
        if run.bed_spread == last.bed_spread
        and is_as_hot(run.temperatures, last.temperatures)
    ]


######################################################################
# Changes
######################################################################


def changes(runs: Sequence[Run]) -> List[Change]:
    """Return what has changed at once and has stayed so, in the order of the runs.

    A height that comes and goes is none: two plates in turn.
    """
    alike, found = like_last(runs), []
    for height, value in HEIGHTS.items():
        values = [value(run) for _, run in alike]
        parts = stretches(values)
        for i, (before, after) in enumerate(zip(parts, parts[1:])):
            by = size_of_step(before, after)
            apart = max(SHIFT, BACK * abs(by))
            was, now = median(before[-SIZE_RUNS:]), median(after[:SIZE_RUNS])
            is_back = is_among(now, parts[:i], apart)
            if is_back or is_among(was, parts[i + 2 :], apart):
                continue
            first = sum(map(len, parts[: i + 1]))
            found.append(Change(height, by, alike[first][0]))
    return sorted(found, key=lambda change: change.number)


def stretches(values: Sequence[float]) -> List[Sequence[float]]:
    """Return the values in parts, between the steps."""
    ends = [0, *find_steps(values), len(values)]
    return [values[begin:end] for begin, end in zip(ends, ends[1:])]


def is_among(
    level: float, parts: Sequence[Sequence[float]], apart: float
) -> bool:
    """Tell whether one of the parts is as high as 'level', within 'apart' (mm)."""
    return any(abs(level - median(part)) <= apart for part in parts)


######################################################################
# Wear
######################################################################


def kendall(values: Sequence[float]) -> float:
    """Return the statistic of Mann and Kendall in its standard deviations.

    Ties included. Kendall, Rank Correlation Methods (1970).
    """
    n, total = len(values), 0
    for i, value in enumerate(values):
        row = values[:i]
        total += sum(v < value for v in row) - sum(v > value for v in row)
    ties = Counter(values).values()
    variance = n * (n - 1) * (2 * n + 5)
    variance -= sum(t * (t - 1) * (2 * t + 5) for t in ties)
    return total / math.sqrt(variance / 18.0) if variance > 0 else 0.0


def drifted(values: Sequence[float]) -> float:
    """Return by how much (mm) values of one stretch drift; 0: by no more than chance."""
    if len(values) < DRIFT_RUNS:
        return 0.0
    third = len(values) // 3
    # A line shifts by half as much again as its thirds do
    shift = 1.5 * (median(values[-third:]) - median(values[:third]))
    if abs(shift) < SHIFT:
        return 0.0
    straight = without_single_ones(values)
    rest = off_line(straight)
    if abs(kendall(values)) / math.sqrt(together(rest)) < TREND_SIGMA:
        return 0.0
    split = best_split(straight)
    odds = odds_of_step(straight, split, square_of(rest))
    return 0.0 if odds > LINE_ODDS * math.log(len(values)) else shift


def drifts(runs: Sequence[Run]) -> List[Drift]:
    """Return the heights that drift, since they have changed last."""
    alike, found = like_last(runs), []
    for height, value in HEIGHTS.items():
        values = [value(run) for _, run in alike]
        if not values:
            continue
        latest = stretches(values)[-1][-WINDOW:]
        by = drifted(latest)
        if by:
            found.append(Drift(height, by, len(latest)))
    return found


def growth(site: str, runs: Sequence[Run]) -> Optional[Growth]:
    """Return how much more the touches of a site vary; None: not beyond chance.

    runs: good ones that are alike.
    """
    if len(runs) < 2 * GROWTH_RUNS:
        return None
    first, last = (
        pool_usual([run.sites[site].spread() for run in part], GROWTH)
        for part in (runs[:GROWTH_RUNS], runs[-GROWTH_RUNS:])
    )
    if not (first.dof and last.dof):
        return None
    before, after = math.sqrt(first.variance), math.sqrt(last.variance)
    if after < max(before + GROWTH, before * GROWTH_TIMES):
        return None
    limit = f_limit(last.dof, first.dof, TREND_SIGMA)
    if last.variance < limit * max(first.variance, GROWTH**2):
        return None
    return Growth(site, before, after, len(runs))


def growths(runs: Sequence[Run]) -> List[Growth]:
    """Return the sites whose touches vary more than they did in the first runs."""
    alike = [run for _, run in like_last(runs)]
    found = (growth(site, alike) for site in SITES)
    return [one for one in found if one is not None]
