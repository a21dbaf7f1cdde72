r"""The way around the dock: pure geometry.

Seen from above; (x, y) in mm are places of the toolhead, angles are radians from +X
towards +Y:

                __o__           D  the dock, the middle of a circle that the
              o' . - . 'o          toolhead stays out of
             / '       ' \      o  corners of the way around, all of them outside
            / |    D    | \        of the circle
           /   '   |   '   \    lane: the way into the dock, or out of it;
          /      ' | '      \      the toolhead leaves the circle along it when
       start       |        end    it starts in one
                  lane

A way that ends in the circle ends where a straight way out of it would: from there the
toolhead may go straight in, and on that line it never comes nearer to the dock than it is
in the end.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import (
    Any,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

# A position nearer (mm) to the dock than this is the dock itself.
SMALLEST_DISTANCE = 1.0

# A toolhead that leaves a dock is this close (mm) to the lane it came along.
LANE = 3.0

# The way around turns by at most so many degrees at each corner.
TURN = 15.0

# What rounding makes of lengths (mm).
ROUNDING = 1e-3

# An exit of the circle is looked for in so many steps to either side.
EXITS = 32

Point = Tuple[float, float]
# X and Y (mm), and what may follow
Place = Sequence[Any]
# (low, high) of X and Y (mm), and perhaps of Z
Limits = Sequence[Tuple[float, float]]


class Position(NamedTuple):
    """Where the toolhead is or has to go (mm); z None: it stays as high as it is."""

    x: float
    y: float
    z: Optional[float]


class Zone(NamedTuple):
    """The circle (mm) that the toolhead enters only to fetch the probe and to dock it.

    lanes are the unit vectors of those that lead out of the dock; (0, 0) is one that leads
    straight up.
    """

    x: float
    y: float
    radius: float
    lanes: Sequence[Point]


class NoWay(Exception):
    """Nothing leads around the dock within the reach of the axes."""


######################################################################
# Directions
######################################################################


def distance(a: Place, b: Place) -> float:
    """Return how far (mm) two places are apart in the plane."""
    return math.hypot(a[0] - b[0], a[1] - b[1])


def direction(a: Place, b: Place) -> Point:
    """Return the unit vector from a to b in the plane; (0, 0): they are the same place."""
    length = distance(a, b)
    if length < SMALLEST_DISTANCE:
        return 0.0, 0.0
    return (b[0] - a[0]) / length, (b[1] - a[1]) / length


def first_leg(
    dock: Position, z: Optional[float], position: Position
) -> Tuple[float, float, float]:
    """Return the unit vector of how the toolhead leaves the dock at first.

    It is on its way to a position.  'z' (mm) is the height of the dock, None: any; Z moves
    before X and Y do.
    """
    if z is not None and position.z is not None and z != position.z:
        return 0.0, 0.0, math.copysign(1.0, position.z - z)
    x, y = direction(dock, position)
    return x, y, 0.0


def angle_between(a: Sequence[float], b: Sequence[float]) -> float:
    """Return the degrees between two unit vectors."""
    dot = sum(p * q for p, q in zip(a, b))
    return math.degrees(math.acos(max(-1.0, min(1.0, dot))))


def strip_angle(
    dock: Position, z: Optional[float], extract: Position, detach: Position
) -> float:
    """Return by how many degrees the way to 'detach' differs from the one to 'extract'.

    The latter takes the probe along.  Either the first moves differ, or those in the plane.
    'z' (mm) is the height of the dock, or of the toolhead on its way in, None: any.
    """
    in_plane = [direction(dock, position) for position in (extract, detach)]
    at_first = [first_leg(dock, z, position) for position in (extract, detach)]
    return max(angle_between(*in_plane), angle_between(*at_first))


######################################################################
# The circle around the dock
######################################################################


def is_inside(point: Place, zone: Zone) -> bool:
    """Return whether a point is in the circle."""
    return distance(point, zone) < zone.radius - ROUNDING


def is_in_dock(point: Place, zone: Zone) -> bool:
    """Return whether that is the dock itself."""
    return distance(point, zone) < SMALLEST_DISTANCE


def is_within(point: Sequence[float], limits: Limits) -> bool:
    """Return whether a point is in the reach of the axes."""
    return all(
        low - ROUNDING <= xy <= high + ROUNDING
        for xy, (low, high) in zip(point, limits)
    )


def least_distance(a: Place, b: Place, zone: Zone) -> float:
    """Return the least distance (mm) from the dock to the line from a to b."""
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    if not length:
        return distance(a, zone)
    part = ((zone.x - a[0]) * dx + (zone.y - a[1]) * dy) / length
    part = max(0.0, min(1.0, part))
    return distance((a[0] + part * dx, a[1] + part * dy), zone)


def on_circle(center: Place, angle: float, radius: float) -> Point:
    """Return the point of a circle at an angle."""
    return (
        center[0] + radius * math.cos(angle),
        center[1] + radius * math.sin(angle),
    )


def _angle_of(point: Point, zone: Zone) -> float:
    return math.atan2(point[1] - zone.y, point[0] - zone.x)


def _exits(point: Point, zone: Zone, other: Point) -> Iterator[Point]:
    """Yield points of the circle that a straight line leads to from inside, best first.

    Along a lane where the toolhead is in one, otherwise away from the dock.  'other' is the
    other end of the way: that side is nearest from straight above a dock that is left
    upwards.
    """
    dx, dy = point[0] - zone.x, point[1] - zone.y
    is_above = (0.0, 0.0) in zone.lanes and is_in_dock(point, zone)
    for ux, uy in zone.lanes:
        along, aside = dx * ux + dy * uy, dx * uy - dy * ux
        is_in_lane = along >= -LANE and abs(aside) <= LANE
        if is_in_lane and not is_above and (ux, uy) != (0.0, 0.0):
            rest = math.sqrt(max(0.0, zone.radius**2 - aside**2)) - along
            yield point[0] + rest * ux, point[1] + rest * uy
    away = _angle_of(other if is_above else point, zone)
    # Further off the line would come nearer to the dock at first
    widest = math.acos(min(1.0, distance(point, zone) / zone.radius))
    for part in range(EXITS + 1):
        for side in (1, -1):
            angle = away + side * widest * part / EXITS
            yield on_circle(zone, angle, zone.radius)


def find_exit(point: Point, zone: Zone, limits: Limits, other: Point) -> Point:
    """Return the best exit that the axes can reach; see _exits().  Raises NoWay."""
    for end in _exits(point, zone, other):
        if is_within(end, limits):
            return end
    raise NoWay()


######################################################################
# Around it
######################################################################


def _corners(start: Point, end: Point, zone: Zone, turn: int) -> List[Point]:
    """Return the corners of a polygon around the circle.

    From the tangent of 'start' to that of 'end'; 'turn' is 1 against the clock, -1 with it.
    """
    angles = []
    for point, side in ((start, turn), (end, -turn)):
        tangent = math.acos(min(1.0, zone.radius / distance(point, zone)))
        angles.append(_angle_of(point, zone) + side * tangent)
    sweep = (turn * (angles[1] - angles[0])) % (2.0 * math.pi)
    if sweep > 2.0 * math.pi - ROUNDING:
        sweep = 0.0
    count = int(math.ceil(sweep / math.radians(TURN)))
    if not count:
        return []
    step = sweep / count
    # The sides touch the circle, so the corners are outside of it
    radius = zone.radius / math.cos(step / 2.0)
    return [
        on_circle(zone, angles[0] + turn * step * (i + 0.5), radius)
        for i in range(count)
    ]


def length_of(points: Sequence[Point]) -> float:
    """Return the length (mm) of a polyline."""
    return sum(distance(a, b) for a, b in zip(points, points[1:]))


def around(
    start: Sequence[float],
    end: Sequence[float],
    zone: Zone,
    limits: Limits,
    via: Optional[Position] = None,
) -> List[Point]:
    """Return the points that lead from start to end, without the start.

    They come never nearer to the dock than they have to.  The last one is 'end' or, where
    that is in the circle, the exit beside it.  Of the two sides it takes the shorter one or,
    with 'via', the one that comes nearer to that point.  Raises NoWay.
    """
    first, last = (start[0], start[1]), (end[0], end[1])
    points: List[Point] = []
    if is_inside(first, zone):
        first = find_exit(first, zone, limits, other=last)
        points.append(first)
    if is_inside(last, zone):
        last = find_exit(last, zone, limits, other=first)
    if least_distance(first, last, zone) >= zone.radius - ROUNDING:
        return [*points, last]
    sides = [_corners(first, last, zone, turn) for turn in (1, -1)]
    sides = [side for side in sides if all(is_within(c, limits) for c in side)]
    if not sides:
        raise NoWay()

    def cost(corners: List[Point]) -> float:
        """Return what a side is chosen by; the smaller one is taken."""
        if via is not None:
            return min(distance(corner, via) for corner in corners)
        return length_of([first, *corners, last])

    return [*points, *min(sides, key=cost), last]


######################################################################
# Homing beside the dock
######################################################################


def homing_lines(
    place: Place, ends: Mapping[int, float]
) -> Iterator[Tuple[Point, Point]]:
    """Yield the lines (from, to) that homing goes from a place.

    Along each axis to its end, in either order, which macros choose.  'ends' are mm by the
    axis (0: X).
    """
    for order in (sorted(ends), sorted(ends, reverse=True)):
        here = (place[0], place[1])
        for axis in order:
            end = ends[axis]
            there = (end, here[1]) if axis == 0 else (here[0], end)
            yield here, there
            here = there


def is_clear_for_homing(
    place: Place, ends: Mapping[int, float], zone: Zone
) -> bool:
    """Return whether homing from a place stays out of the circle around the dock."""
    return all(
        least_distance(start, end, zone) >= zone.radius - ROUNDING
        for start, end in homing_lines(place, ends)
    )


def places_for_homing(
    start: Place, ends: Mapping[int, float], zone: Zone, limits: Limits
) -> List[Point]:
    """Return places from where homing stays out of it, the nearest one first.

    They are beside the circle, or where an axis ends.
    """
    choices = []
    for axis, middle in enumerate((zone.x, zone.y)):
        beside = [middle - zone.radius, middle + zone.radius]
        choices.append([start[axis], ends.get(axis, start[axis]), *beside])
    places = [(x, y) for x in choices[0] for y in choices[1]]
    return [
        place
        for place in sorted(places, key=lambda place: distance(start, place))
        if is_within(place, limits) and is_clear_for_homing(place, ends, zone)
    ]
