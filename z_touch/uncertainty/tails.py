# How much narrower the middle of the touches is than their spread says: pure functions.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Where some touches are far off the others are the closer together for that, and a
# median is of these.  Mean absolute and standard deviation tell it: Geary, Biometrika 27
# (1935).  Their ratio, squared, in that of normal touches:
#
#   g = (pi / 2) * (mean absolute deviation / standard deviation)^2
#
# is 1 of normal touches, 0.85 of Student's t with 5 degrees of freedom.  The middle of
# these that series which keep a tolerance come from has a variance of 0.6 of the whole:
# of Student's t with 4 to 20 degrees of freedom it is g^3 within a tenth.

import math

from .estimate import pool

# The power of g
MIDDLE = 3

# Standard deviation of g, by one touch, and how many of these g may be too small by chance
CHANCE = 2.0 * math.sqrt(math.pi / 2.0) * math.sqrt(1.0 - 3.0 / math.pi)
CHANCES = 0.5

# Less than that is no noise of a switch
NARROWEST = 0.7


# What is left of heavy tails in deviations from an average of n, which has them, too:
# of their fourth moments, as these add up
def left_of_tails(n):
    return (n**2 - 3.0 * n + 3.0) / (n * (n - 1.0))


# The variance of the middle, in variances of a touch.  'earlier_runs': of each site the
# Spreads of its runs.  Touches that vary by less than a step say nothing.
def middle_part(earlier_runs, step):
    dof, ratios, lefts = 0, 0.0, 0.0
    for spreads in earlier_runs:
        spreads = [s for s in spreads if s.dof and s.absolute is not None]
        pooled = pool(spreads)
        if not pooled.dof or pooled.variance < step**2:
            continue
        absolute = math.fsum(s.dof * s.absolute for s in spreads) / pooled.dof
        left = math.fsum(s.dof * left_of_tails(s.dof + 1) for s in spreads)
        lack = 1.0 - absolute**2 / pooled.variance
        dof += pooled.dof
        ratios += pooled.dof * (1.0 - lack * pooled.dof / left)
        lefts += left
    if not dof:
        return 1.0
    chance = CHANCES * CHANCE * math.sqrt(dof) / lefts
    return min(max(ratios / dof + chance, NARROWEST), 1.0) ** MIDDLE
