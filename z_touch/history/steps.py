# One step between two values, or a line: pure maths on the heights of many runs (mm).
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import math

from ..core.sampling import summarize
from ..uncertainty.estimate import MAD_FACTOR, t_factor

# A value is off from so many standard deviations on.
FAR_SIGMA = 5.0

# From so large a shift (mm) on it is told.
SHIFT = 0.006

# Runs at both ends of a stretch that are compared
GROWTH_RUNS = 20

# Runs before and after a change, at least; standard errors from which on it is one;
# and the odds against a line from which on it is one, and up to which a trend is no
# change (as logarithms, in logarithms of the number of runs): that where a step
# fits best was chosen speaks for it by chance
STEP_RUNS = 5
STEP_SIGMA = 6.0
STEP_ODDS = 3.0
LINE_ODDS = 0.5

# So long a step has to hold that may be two plates in turn; and the part of it from
# which on the plate of before is back
PLATE_RUNS = 40
PLATE_NEAR = 2.0 / 3.0


def no_pause():
    pass


# Of single runs that are off, and agree with neither neighbour while these do with
# each other: a value between them
def without_single_ones(values):
    steps = [abs(b - a) for a, b in zip(values, values[1:])]
    far = FAR_SIGMA * MAD_FACTOR * summarize(steps, "median") / math.sqrt(2.0)
    smooth = list(values)
    for i in range(1, len(values) - 1):
        before, v, after = values[i - 1 : i + 2]
        off = min(abs(v - before), abs(v - after))
        if off > far and abs(after - before) <= far:
            smooth[i] = (before + after) / 2.0
    return smooth


######################################################################
# Line or step
######################################################################


# What a straight line leaves of the values
def off_line(values):
    n = len(values)
    middle, mean = (n - 1) / 2.0, math.fsum(values) / n
    square = math.fsum((i - middle) ** 2 for i in range(n))
    slope = math.fsum((i - middle) * v for i, v in enumerate(values)) / square
    return [v - mean - slope * (i - middle) for i, v in enumerate(values)]


# Where one step explains the values best: how many come before it
def best_split(values):
    n, total, before = len(values), math.fsum(values), 0.0
    best, most = 1, -1.0
    for i in range(1, n):
        before += values[i - 1]
        apart = before / i - (total - before) / (n - i)
        explains = apart**2 * i * (n - i)
        if explains > most:
            best, most = i, explains
    return best


# What a step leaves of the values
def off_step(values, split):
    rest = []
    for part in (values[:split], values[split:]):
        mean = math.fsum(part) / len(part)
        rest += [v - mean for v in part]
    return rest


def square_of(values):
    return math.fsum(v**2 for v in values)


# The sum of squares that the best bent line leaves of the values: level at first,
# then straight up or down, as a drift that has just begun
def square_off_bend(values):
    n, mean = len(values), math.fsum(values) / len(values)
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


# How many values that hang together count as one: by the correlation of neighbours
# in what is left of them
def together(rest):
    square = square_of(rest)
    if not square:
        return 1.0
    part = math.fsum(a * b for a, b in zip(rest, rest[1:])) / square
    part = min(max(part, 0.0), 0.9)
    return (1.0 + part) / (1.0 - part)


# How much likelier a step is than a line that leaves so much of the values, as a
# logarithm; below 0 a line is
def odds_of_step(values, split, line):
    # Of heights that are all the same, too
    least = len(values) * 1e-14
    step = max(square_of(off_step(values, split)), least)
    return len(values) * math.log(max(line, least) / step)


# Whether a step has held for long, and on neither side the middle of any few runs in a
# row was as good as on the other one, as it is where a plate comes back.  'values':
# all of the stretch
def has_held(values, split, pause=no_pause):
    before, after = values[:split], values[split:]
    if len(after) < PLATE_RUNS:
        return False
    was = summarize(before[-PLATE_RUNS:], "median")
    now = summarize(after, "median")
    return not (
        was == now
        or is_near(before, was, now, pause)
        or is_near(after, now, was, pause)
    )


# Whether values that are about 'here' were near 'there', a few in a row
def is_near(values, here, there, pause):
    for i in range(len(values) - STEP_RUNS + 1):
        if i % 20 == 0:
            pause()
        middle = summarize(values[i : i + STEP_RUNS], "median")
        if (middle - here) / (there - here) >= PLATE_NEAR:
            return True
    return False


# The number of the values before a change, 0: there is none
def find_step(values):
    n = len(values)
    if n < 2 * STEP_RUNS:
        return 0
    values = without_single_ones(values)
    split = best_split(values)
    if min(split, n - split) < STEP_RUNS:
        # Too early to tell
        return 0
    if abs(size_of_step(values, split)) < SHIFT:
        return 0
    rest = off_step(values, split)
    means = [math.fsum(p) / len(p) for p in (values[:split], values[split:])]
    noise = max(square_of(rest) / (n - 2), 1e-14) * together(rest)
    error = math.sqrt(noise * (1.0 / split + 1.0 / (n - split)))
    # Of few runs nobody knows well how they vary
    sure = STEP_SIGMA * (t_factor(n - 2) / t_factor(float("inf"))) ** 3
    if abs(means[1] - means[0]) < sure * error:
        return 0
    line = min(square_of(off_line(values)), square_off_bend(values))
    odds = odds_of_step(values, split, line)
    return split if odds > STEP_ODDS * math.log(n) else 0


# From the last runs before it to the first ones after it (mm)
def size_of_step(values, split):
    before = values[max(0, split - GROWTH_RUNS) : split]
    after = values[split : split + GROWTH_RUNS]
    return summarize(after, "median") - summarize(before, "median")
