# Ways of the head around something that it must not hit: pure functions.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import math

# A position nearer (mm) to the dock is none of its own.
SMALLEST_DISTANCE = 1.0

# A head that leaves a dock is this close (mm) to the line it came along.
LANE = 3.0

# The way around a dock turns by so many degrees at each corner.
TURN = 15.0

# Of lengths (mm): what rounding makes of them.
ROUNDING = 1e-3

# z None: as it is
Place = collections.namedtuple("Place", "x y z")

# Where the head goes only to fetch the probe and to put it back: a circle, and
# the unit vectors of the lanes out of it.
Zone = collections.namedtuple("Zone", "x y radius lanes")


# Nothing leads around the dock in the reach of the axes
class NoWay(Exception):
    pass


def distance(a, b):
    return math.hypot(a[0] - b[0], a[1] - b[1])


# From a to b in the plane; (0, 0) where they are the same
def direction(a, b):
    length = distance(a, b)
    if length < SMALLEST_DISTANCE:
        return 0.0, 0.0
    return (b[0] - a[0]) / length, (b[1] - a[1]) / length


# How a head leaves the dock at first: Z moves before X and Y do.
def first_leg(dock, z, place):
    if None not in (z, place.z) and z != place.z:
        return 0.0, 0.0, math.copysign(1.0, place.z - z)
    return direction(dock, place) + (0.0,)


# Degrees between two ways out of the dock
def angle_between(a, b):
    dot = sum(p * q for p, q in zip(a, b))
    return math.degrees(math.acos(max(-1.0, min(1.0, dot))))


# Degrees by which the way off differs from the one that takes the probe along;
# 'z': where the dock is, or the head on its way in.
def strip_angle(dock, z, extract, detach):
    flat = [direction(dock, place) for place in (extract, detach)]
    legs = [first_leg(dock, z, place) for place in (extract, detach)]
    return max(angle_between(*flat), angle_between(*legs))


def is_inside(point, zone):
    return distance(point, zone) < zone.radius - ROUNDING


# Least distance of the centre of the zone to the line from a to b
def least_distance(a, b, zone):
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    if not length:
        return distance(a, zone)
    part = ((zone.x - a[0]) * dx + (zone.y - a[1]) * dy) / length
    part = max(0.0, min(1.0, part))
    return distance((a[0] + part * dx, a[1] + part * dy), zone)


def is_within(point, limits):
    return all(
        low - ROUNDING <= xy <= high + ROUNDING
        for xy, (low, high) in zip(point, limits)
    )


def on_circle(zone, angle, radius):
    x, y = zone.x + radius * math.cos(angle), zone.y + radius * math.sin(angle)
    return x, y


def angle_of(point, zone):
    return math.atan2(point[1] - zone.y, point[0] - zone.x)


# The ends of the ways straight out of the circle, the best one first: along
# a lane where the head is in one, otherwise away from the dock.
def ways_out(point, zone):
    dx, dy = point[0] - zone.x, point[1] - zone.y
    for ux, uy in zone.lanes:
        along, aside = dx * ux + dy * uy, dx * uy - dy * ux
        if along >= -LANE and abs(aside) <= LANE:
            rest = math.sqrt(max(0.0, zone.radius**2 - aside**2)) - along
            yield point[0] + rest * ux, point[1] + rest * uy
    middle = angle_of(point, zone)
    # Further off the head would come nearer to the dock at first
    widest = math.acos(min(1.0, distance(point, zone) / zone.radius))
    for part in range(33):
        for side in (1, -1):
            angle = middle + side * widest * part / 32.0
            yield on_circle(zone, angle, zone.radius)


def way_out(point, zone, limits):
    for end in ways_out(point, zone):
        if is_within(end, limits):
            return end
    raise NoWay()


# The corners of a way around the circle, all of it outside; 'turn' is 1 with
# the angles, -1 against them.
def corners_around(start, end, zone, turn):
    angles = []
    for point, side in ((start, turn), (end, -turn)):
        tangent = math.acos(min(1.0, zone.radius / distance(point, zone)))
        angles.append(angle_of(point, zone) + side * tangent)
    sweep = (turn * (angles[1] - angles[0])) % (2.0 * math.pi)
    if sweep > 2.0 * math.pi - ROUNDING:
        sweep = 0.0
    count = int(math.ceil(sweep / math.radians(TURN)))
    if not count:
        return []
    step = sweep / count
    radius = zone.radius / math.cos(step / 2.0)
    return [
        on_circle(zone, angles[0] + turn * step * (i + 0.5), radius)
        for i in range(count)
    ]


def length_of(points):
    return sum(distance(a, b) for a, b in zip(points, points[1:]))


# The corners of the way from start to end that never gets nearer to the dock
# than it has to; the last one is where it ends: at 'end' or, where that is
# too near to the dock, outside beside it.  'via': None, or the point that the
# way has to pass by.  Raises NoWay.
def way_around(start, end, zone, limits, via=None):
    start, end, way = tuple(start[:2]), tuple(end[:2]), []
    if is_inside(start, zone):
        start = way_out(start, zone, limits)
        way.append(start)
    if is_inside(end, zone):
        end = way_out(end, zone, limits)
    if least_distance(start, end, zone) >= zone.radius - ROUNDING:
        return way + [end]
    ways = [corners_around(start, end, zone, turn) for turn in (1, -1)]
    ways = [w for w in ways if all(is_within(p, limits) for p in w)]
    if not ways:
        raise NoWay()

    def cost(corners):
        if via is not None:
            return min(distance(corner, via) for corner in corners)
        return length_of([start] + corners + [end])

    return way + min(ways, key=cost) + [end]
