"""One step between two values, or a line: pure maths on the heights of runs (mm).

A step is a change at once between two runs: another plate, nozzle or probe, something
that has come loose. A line is wear.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from statistics import fmean, median
from typing import List, Sequence

from ..z_calibration.statistics import MAD_FACTOR, t_factor

# A value is off from so many standard deviations on
SINGLE_SIGMA = 5.0

# From so large a shift (mm) on it matters
SHIFT = 0.006

# Values on both sides of a step that its size is of
SIZE_RUNS = 20

# Values before and after a step, at least; standard errors from which on it is one;
# and the odds against a line from which on it is one, and up to which a drift is no
# step (as logarithms, in logarithms of the number of values): that where a step fits
# best was chosen speaks for it by chance
STEP_RUNS = 5
STEP_SIGMA = 6.0
STEP_ODDS = 3.0
LINE_ODDS = 0.5

# So many values, the latest, are looked at together
WINDOW = 100


def without_single_ones(values: Sequence[float]) -> List[float]:
    """Return the values with those in between that single ones should have been.

    A single one is off, and agrees with neither neighbour while these do with each
    other.
    """
    apart = [abs(b - a) for a, b in zip(values, values[1:])]
    far = SINGLE_SIGMA * MAD_FACTOR * median(apart) / math.sqrt(2.0)
    smooth = list(values)
    for i in range(1, len(values) - 1):
        before, value, after = values[i - 1 : i + 2]
        off = min(abs(value - before), abs(value - after))
        if off > far and abs(after - before) <= far:
            smooth[i] = (before + after) / 2.0
    return smooth


def off_line(values: Sequence[float]) -> List[float]:
    """Return what a straight line leaves of the values."""
    n = len(values)
    middle, mean = (n - 1) / 2.0, fmean(values)
    square = math.fsum((i - middle) ** 2 for i in range(n))
    slope = math.fsum((i - middle) * v for i, v in enumerate(values)) / square
    return [v - mean - slope * (i - middle) for i, v in enumerate(values)]


def best_split(values: Sequence[float]) -> int:
    """Return how many values come before the one step that explains them best."""
    n, total, before = len(values), math.fsum(values), 0.0
    best, most = 1, -1.0
    for i in range(1, n):
        before += values[i - 1]
        apart = before / i - (total - before) / (n - i)
        explains = apart**2 * i * (n - i)
        if explains > most:
            best, most = i, explains
    return best


def off_step(values: Sequence[float], split: int) -> List[float]:
    """Return what a step leaves of the values."""
    rest = []
    for part in (values[:split], values[split:]):
        mean = fmean(part)
        rest += [v - mean for v in part]
    return rest


def square_of(values: Sequence[float]) -> float:
    """Return the sum of squares."""
    return math.fsum(v**2 for v in values)


def square_off_bend(values: Sequence[float]) -> float:
    """Return the sum of squares that the best bent line leaves of the values.

    It is level at first, then straight up or down, as a drift that has just begun.
    """
    n, mean = len(values), fmean(values)
    left = [v - mean for v in values]
    whole = square_of(left)
    best, after, product = whole, 0.0, 0.0
    # Of x, the runs since the bend: 0 up to it, then 1, 2 ...
    for x in range(1, n):
        after += left[n - x]
        product += after
        total = x * (x + 1) / 2.0
        square = x * (x + 1) * (2 * x + 1) / 6.0 - total**2 / n
        best = min(best, whole - product**2 / square)
    return best


def together(rest: Sequence[float]) -> float:
    """Return how many values that hang together count as one.

    rest: what a line or a step leaves of them; by the correlation of neighbours.
    """
    square = square_of(rest)
    if not square:
        return 1.0
    part = math.fsum(a * b for a, b in zip(rest, rest[1:])) / square
    part = min(max(part, 0.0), 0.9)
    return (1.0 + part) / (1.0 - part)


def odds_of_step(values: Sequence[float], split: int, line: float) -> float:
    """Return how much likelier a step is than a line, as a logarithm.

    line: the sum of squares that it leaves. Below 0 the line is likelier.
    """
    # Of heights that are all the same, too
    least = len(values) * 1e-14
    step = max(square_of(off_step(values, split)), least)
    return len(values) * math.log(max(line, least) / step)


def find_step(values: Sequence[float]) -> int:
    """Return how many values come before the step among them; 0: there is none."""
    n = len(values)
    if n < 2 * STEP_RUNS or max(values) - min(values) < SHIFT:
        return 0
    values = without_single_ones(values)
    split = best_split(values)
    if min(split, n - split) < STEP_RUNS:
        # Too early to tell
        return 0
    if abs(size_of_step(values[:split], values[split:])) < SHIFT:
        return 0
    rest = off_step(values, split)
    apart = abs(fmean(values[:split]) - fmean(values[split:]))
    noise = max(square_of(rest) / (n - 2), 1e-14) * together(rest)
    error = math.sqrt(noise * (1.0 / split + 1.0 / (n - split)))
    # Of few runs it is not known well how they vary
    sure = STEP_SIGMA * (t_factor(n - 2) / t_factor(math.inf)) ** 3
    if apart < sure * error:
        return 0
    line = min(square_of(off_line(values)), square_off_bend(values))
    odds = odds_of_step(values, split, line)
    return split if odds > STEP_ODDS * math.log(n) else 0


def find_steps(values: Sequence[float]) -> List[int]:
    """Return the numbers of the values that come first after each step.

    As if they were looked at one after the other: after a step those before it have
    no say.
    """
    begin, found = 0, []
    for end in range(2 * STEP_RUNS, len(values) + 1):
        first = max(begin, end - WINDOW)
        split = find_step(values[first:end])
        if split:
            begin = first + split
            found.append(begin)
    return found


def size_of_step(before: Sequence[float], after: Sequence[float]) -> float:
    """Return the size of a step: from the last values before it to the first after."""
    return median(after[:SIZE_RUNS]) - median(before[-SIZE_RUNS:])
