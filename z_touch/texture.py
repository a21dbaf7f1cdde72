"""Points of a textured plate that are touched in place of one: pure functions.

One point of powder-coated PEI is not the surface.  With bed_spread each touch is at another
point of a spiral around the one that was chosen:

          o
      o       o        o   touches 0, 1, 2 ... from the middle outwards, so that
        o  o           any number of them is spread evenly
      o   o  o
        o    o

Each run turns the spiral further, so that no dent or old plastic is touched each time.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .touch import Site

# From here on (mm) it is measured how the bed is bent, not its texture
LARGEST_SPREAD = 20.0

# Points from the middle to the edge; the golden angle keeps any number of them
# apart (Vogel, Mathematical Biosciences 44, 1979).
SPREAD_POINTS = 10
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

# By how much (radians) the spiral of a run is turned against that of the run before: no
# fraction of a circle, nor of the angle above, so that it does not come back soon.
TURN = 1.0

# By how much (mm) points of a textured plate may differ, besides what touches of one
# point may: RatOS's page on Beacon's true zero has up to 0.1 mm.
TEXTURE = 0.1

# The standard deviation (mm) of such points: six of them are nearly all
ROUGH = TEXTURE / 6.0


def spread_site(site: Site, radius: float, number: int, turn: int = 0) -> Site:
    """Return the site of the touch of that number, from 0, within a radius (mm) around one.

    'turn' counts the runs: counted, not random, so that a run can be repeated.  After the last point it begins in the middle again, between the points before.  A radius
    of 0 is the site itself.
    """
    if not radius:
        return site
    part = (number % SPREAD_POINTS + 0.5) / SPREAD_POINTS
    distance, angle = radius * math.sqrt(part), number * GOLDEN_ANGLE
    angle += turn * TURN
    x, y = distance * math.cos(angle), distance * math.sin(angle)
    return site._replace(x=site.x + x, y=site.y + y)


def spread_tolerance(tolerance: float, radius: float) -> float:
    """Return how far touches may be apart (mm) that may be so far at one point."""
    return tolerance + TEXTURE if radius else tolerance
