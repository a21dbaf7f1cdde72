# Points of a textured plate that are touched in its stead: pure functions.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# One point of powder-coated PEI is not the surface.  With bed_spread each touch is at
# another point of a spiral around the one that was chosen:
#
#          o
#      o       o        o   touches 0, 1, 2 ... from the middle outwards, so that
#        o  o           any number of them is spread evenly
#      o   o  o
#        o    o

import math

# From here on (mm) it is measured how the bed is bent, not its texture
LARGEST_SPREAD = 20.0

# Points from the middle to the edge; the golden angle keeps any number of them
# apart (Vogel, Mathematical Biosciences 44, 1979).
SPREAD_POINTS = 10
GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))

# By how much (mm) points of a textured plate may differ, besides what touches of one
# point may: RatOS's page on Beacon's true zero has up to 0.1 mm.
TEXTURE = 0.1

# The standard deviation (mm) of such points: six of them are nearly all
ROUGH = TEXTURE / 6.0


# The Site of the touch of that number, from 0, within a radius (mm) around a site;
# 0: that site.  After the last point it begins in the middle again, between the
# points before.
def spread_site(site, radius, number):
    if not radius:
        return site
    part = (number % SPREAD_POINTS + 0.5) / SPREAD_POINTS
    distance, angle = radius * math.sqrt(part), number * GOLDEN_ANGLE
    x, y = distance * math.cos(angle), distance * math.sin(angle)
    return site._replace(x=site.x + x, y=site.y + y)


# How far (mm) touches at one point may be apart, if they are at several
def spread_tolerance(tolerance, radius):
    return tolerance + TEXTURE if radius else tolerance
