"""How touches vary over many runs: pure functions.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import Iterable, List

from ..z_calibration.statistics import Spread, pool

# Standard deviations of a normal distribution from which on a single run is an
# accident, and the runs that it takes to tell
NO_CHANCE = 3.1
ACCIDENT_RUNS = 6


def f_limit(dof: float, below: float, sigmas: float) -> float:
    """Return the value of F that is exceeded as rarely as 'sigmas' of a normal one.

    dof, below: degrees of freedom of the two variances. Paulson, Annals of
    Mathematical Statistics 13 (1942).
    """
    a, b = 2.0 / (9.0 * dof), 2.0 / (9.0 * below)
    square = (1.0 - b) ** 2 - sigmas**2 * b
    if square <= 0.0:
        return math.inf
    middle, rest = (1.0 - a) * (1.0 - b), (1.0 - a) ** 2 - sigmas**2 * a
    root = math.sqrt(max(middle**2 - square * rest, 0.0))
    return ((middle + root) / square) ** 3


def pool_usual(spreads: Iterable[Spread], least: float) -> Spread:
    """Return the spread of several runs together, without accidents.

    An accident is a run that is far noisier than all others. least: a standard
    deviation (mm) that is never too much.
    """
    kept: List[Spread] = [spread for spread in spreads if spread.dof > 0]
    while len(kept) >= ACCIDENT_RUNS:
        worst = max(kept, key=lambda spread: spread.variance)
        others = list(kept)
        others.remove(worst)
        rest = pool(others)
        limit = f_limit(worst.dof, rest.dof, NO_CHANCE)
        if worst.variance <= limit * max(rest.variance, least**2):
            break
        kept = others
    return pool(kept)
