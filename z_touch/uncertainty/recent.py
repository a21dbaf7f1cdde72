# What the touches of earlier runs say about those of now: pure functions.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# A series that keeps samples_tolerance is not how a printer touches: the noisier
# it is, the more of it is hidden by what was rejected.  So a Spread is that of all
# touches of a site in a run, rejected ones and those of refused runs included.
#
# 'earlier_runs': of each site the Spreads of the last runs, the oldest first, of the same
# runs for all sites, UNKNOWN where one was not touched; 'now': the Spread by site of
# the run that ends.

import collections
import math

from .estimate import pool
from .tails import middle_part

# Standard deviations of a normal distribution: from the first on the last runs are
# noisier than those before; below the second sites vary alike, as far as one can
# tell; from the third on a single run is an accident.
NOISIER = 1.645
AS_NOISY = 1.28
ACCIDENT = 3.1

# So many runs are needed to tell that one of them is an accident
ACCIDENT_RUNS = 6

# The part of the degrees of freedom that it leaves to choose the runs: those whose noise
# has grown are few, and the series among them that keep samples_tolerance are the quiet
# ones
CUT = 0.4

# Behind what is compared with (degrees of freedom)
LEAST_BEFORE = 6


# The value of F that is exceeded by chance as rarely as 'sigmas' of a normal
# distribution: Paulson, Annals of Mathematical Statistics 13 (1942)
def f_limit(dof, below, sigmas):
    a, b = 2.0 / (9.0 * dof), 2.0 / (9.0 * below)
    square = (1.0 - b) ** 2 - sigmas**2 * b
    if square <= 0.0:
        return float("inf")
    middle, rest = (1.0 - a) * (1.0 - b), (1.0 - a) ** 2 - sigmas**2 * a
    root = math.sqrt(max(middle**2 - square * rest, 0.0))
    return ((middle + root) / square) ** 3


# What is known of the touches of now: the Spread of one by site, whether that is one
# for all sites, and middle_part() of all of them
Current = collections.namedtuple("Current", "spreads is_shared middle")


# Without single ones that are far noisier than all others: an accident
def usual(spreads, step):
    spreads = [s for s in spreads if s.dof > 0]
    while len(spreads) >= ACCIDENT_RUNS:
        worst = max(spreads, key=lambda s: s.variance)
        others = list(spreads)
        others.remove(worst)
        rest = pool(others)
        limit = f_limit(worst.dof, rest.dof, ACCIDENT)
        if worst.variance <= limit * max(rest.variance, step**2 / 4.0):
            break
        spreads = others
    return spreads


# Of several runs together
def pool_usual(spreads, step):
    return pool(usual(spreads, step))


# From which of the earlier runs on they touch as now.  A printer whose noise has
# grown shows it at all sites, in the last runs together, long before a single site
# does in a single run.  Where that was, the likelihood of both parts says: what is
# most significant is often a few runs too early, and these hide how much it is.
def first_like_current(earlier_runs, current, step):
    count, best, most = max(map(len, earlier_runs.values())), 0, 0.0
    for begin in range(count, 0, -1):
        parts = [
            (
                pool(earlier_runs[site][:begin]),
                pool(earlier_runs[site][begin:] + [current[site]]),
            )
            for site in current
        ]
        parts = [(old, new) for old, new in parts if old.dof and new.dof]
        if not is_noisier(parts, step):
            continue
        likely = likelihood(parts, step)
        if not best or likely > most:
            best, most = begin, likely
    return best


# Of pairs of Spreads before and after, by site
def is_noisier(parts, step):
    dof, below = sum(new.dof for _, new in parts), sum(o.dof for o, _ in parts)
    if not dof or below < LEAST_BEFORE:
        return False
    ratio = math.fsum(
        new.dof * new.variance / max(old.variance, step**2 / 4.0)
        for old, new in parts
    )
    return ratio / dof > f_limit(dof, below, NOISIER)


# Its logarithm, but for what all divisions of the same runs have
def likelihood(parts, step):
    return -math.fsum(
        s.dof * math.log(max(s.variance, step**2 / 4.0))
        for pair in parts
        for s in pair
    )


# Whether Spreads may well be the same
def are_alike(spreads, step):
    floor = step**2 / 12.0
    most = max(spreads, key=lambda s: s.variance)
    least = min(spreads, key=lambda s: s.variance)
    ratio = max(most.variance, floor) / max(least.variance, floor)
    return ratio < f_limit(most.dof, least.dof, AS_NOISY)


# The Current of a run.  'chosen': the part of the degrees of freedom that it leaves a
# site without a history to choose by what its touches say
def current_spreads(earlier_runs, current, step, chosen=1.0):
    begin = first_like_current(earlier_runs, current, step)
    like = dict((site, earlier_runs[site][begin:]) for site in current)
    parts = dict(
        (site, CUT if begin else 1.0 if pool(like[site]).dof else chosen)
        for site in current
    )
    like = dict(
        (site, usual(like[site] + [current[site]], step)) for site in current
    )
    pooled = dict((site, pool(like[site])) for site in current)
    middle = middle_part(like.values(), step)
    if not all(spread.dof for spread in pooled.values()):
        return Current(pooled, False, middle)
    is_shared = are_alike(list(pooled.values()), step)
    left = dict((site, parts[site] * pooled[site].dof) for site in current)
    if is_shared:
        pooled = dict.fromkeys(pooled, pool(pooled.values()))
        left = dict.fromkeys(pooled, sum(left.values()))
    pooled = dict((site, with_dof(pooled[site], left[site])) for site in pooled)
    return Current(pooled, is_shared, middle)


def with_dof(spread, dof):
    return spread._replace(dof=max(dof, 1.0))
