# The detour around the dock: pure geometry.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Seen from above; (x, y) in mm are places of the toolhead, angles are radians
# from +X towards +Y:
#
#                 __o__           D  the dock, the middle of a circle that the
#               o' . - . 'o          head stays out of
#              / '       ' \      o  corners of the detour, all of them outside
#             / |    D    | \        of the circle
#            /   '   |   '   \    lane: the way into the dock, or out of it;
#           /      ' | '      \      the head leaves the circle along it when
#        start       |        end    it starts in one
#                   lane
#
# A way that ends in the circle ends where a straight way out of it would: from
# there the head may go straight in, and on that line it never comes nearer to
# the dock than it is in the end.

import collections
import math

# A position nearer (mm) to the dock than this is the dock itself.
SMALLEST_DISTANCE = 1.0

# A head that leaves a dock is this close (mm) to the lane it came along.
LANE = 3.0

# The detour turns by at most so many degrees at each corner.
TURN = 15.0

# What rounding makes of lengths (mm).
ROUNDING = 1e-3

# An exit of the circle is looked for in so many steps to either side.
EXITS = 32

# Where the toolhead is or has to go (mm); z None: it stays as high as it is.
Position = collections.namedtuple("Position", "x y z")

# The circle (mm) that the head enters only to fetch the probe and to dock it,
# and the unit vectors of the lanes that lead out of the dock; (0, 0) is one that
# leads straight up.
Zone = collections.namedtuple("Zone", "x y radius lanes")


# Nothing leads around the dock within the reach of the axes.
class NoDetour(Exception):
    pass


######################################################################
# Directions
######################################################################


def distance(a, b):
    return math.hypot(a[0] - b[0], a[1] - b[1])


# The unit vector from a to b in the plane; (0, 0) where they are the same place
def direction(a, b):
    length = distance(a, b)
    if length < SMALLEST_DISTANCE:
        return 0.0, 0.0
    return (b[0] - a[0]) / length, (b[1] - a[1]) / length


# The unit vector (x, y, z) of how the head leaves the dock at first, on its way
# to a position.  'z' is the height of the dock; Z moves before X and Y do.
def first_leg(dock, z, position):
    if None not in (z, position.z) and z != position.z:
        return 0.0, 0.0, math.copysign(1.0, position.z - z)
    return direction(dock, position) + (0.0,)


# Degrees between two unit vectors
def angle_between(a, b):
    dot = sum(p * q for p, q in zip(a, b))
    return math.degrees(math.acos(max(-1.0, min(1.0, dot))))


# Degrees by which the way to 'detach' differs from the one to 'extract', which
# takes the probe along: either the first moves differ, or those in the plane.
# 'z' is the height of the dock, or of the head on its way in.
def strip_angle(dock, z, extract, detach):
    in_plane = [direction(dock, position) for position in (extract, detach)]
    at_first = [first_leg(dock, z, position) for position in (extract, detach)]
    return max(angle_between(*in_plane), angle_between(*at_first))


######################################################################
# The circle around the dock
######################################################################


def is_inside(point, zone):
    return distance(point, zone) < zone.radius - ROUNDING


# Whether that is the dock itself
def is_in_dock(point, zone):
    return distance(point, zone) < SMALLEST_DISTANCE


# Whether a point is in the reach of the axes, (low, high) of each
def is_within(point, limits):
    return all(
        low - ROUNDING <= xy <= high + ROUNDING
        for xy, (low, high) in zip(point, limits)
    )


# The least distance from the dock to the line from a to b
def least_distance(a, b, zone):
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    if not length:
        return distance(a, zone)
    part = ((zone.x - a[0]) * dx + (zone.y - a[1]) * dy) / length
    part = max(0.0, min(1.0, part))
    return distance((a[0] + part * dx, a[1] + part * dy), zone)


def on_circle(center, angle, radius):
    return (
        center.x + radius * math.cos(angle),
        center.y + radius * math.sin(angle),
    )


def angle_of(point, zone):
    return math.atan2(point[1] - zone.y, point[0] - zone.x)


# Points of the circle that a straight line leads to from inside, the best one
# first: along a lane where the head is in one, otherwise away from the dock.
# 'other' is the other end of the way: that side is nearest from straight above
# a dock that is left upwards.
def exits(point, zone, other):
    dx, dy = point[0] - zone.x, point[1] - zone.y
    is_above = (0.0, 0.0) in zone.lanes and is_in_dock(point, zone)
    for ux, uy in zone.lanes:
        along, aside = dx * ux + dy * uy, dx * uy - dy * ux
        is_in_lane = along >= -LANE and abs(aside) <= LANE
        if is_in_lane and not is_above and (ux, uy) != (0.0, 0.0):
            rest = math.sqrt(max(0.0, zone.radius**2 - aside**2)) - along
            yield point[0] + rest * ux, point[1] + rest * uy
    away = angle_of(other if is_above else point, zone)
    # Further off the line would come nearer to the dock at first.
    widest = math.acos(min(1.0, distance(point, zone) / zone.radius))
    for part in range(EXITS + 1):
        for side in (1, -1):
            angle = away + side * widest * part / EXITS
            yield on_circle(zone, angle, zone.radius)


# The best exit that the axes can reach; raises NoDetour.
def find_exit(point, zone, limits, other):
    for end in exits(point, zone, other):
        if is_within(end, limits):
            return end
    raise NoDetour()


# Where a straight line from a to b crosses the circle, in that order
def crossings(a, b, zone):
    length = distance(a, b)
    if not length:
        return
    ux, uy = (b[0] - a[0]) / length, (b[1] - a[1]) / length
    along = (zone.x - a[0]) * ux + (zone.y - a[1]) * uy
    aside = (zone.x - a[0]) * uy - (zone.y - a[1]) * ux
    if abs(aside) >= zone.radius:
        return
    half = math.sqrt(zone.radius**2 - aside**2)
    for way in (along - half, along + half):
        if 0.0 <= way <= length:
            yield a[0] + way * ux, a[1] + way * uy


######################################################################
# The detour
######################################################################


# The corners of a polygon around the circle, from the tangent of 'start' to
# that of 'end'; 'turn' is 1 against the clock, -1 with it.
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
    # The sides touch the circle, so the corners are outside of it.
    radius = zone.radius / math.cos(step / 2.0)
    return [
        on_circle(zone, angles[0] + turn * step * (i + 0.5), radius)
        for i in range(count)
    ]


def length_of(points):
    return sum(distance(a, b) for a, b in zip(points, points[1:]))


# The points that lead from start to end and never nearer to the dock than they
# have to; without the start.  The last one is 'end' or, where that is in the
# circle, the exit beside it.  Of the two sides it takes the shorter one or,
# with 'via', the one that comes nearer to that point.  Raises NoDetour.
def around(start, end, zone, limits, via=None):
    start, end, points = tuple(start[:2]), tuple(end[:2]), []
    if is_inside(start, zone):
        start = find_exit(start, zone, limits, other=end)
        points.append(start)
    if is_inside(end, zone):
        end = find_exit(end, zone, limits, other=start)
    if least_distance(start, end, zone) >= zone.radius - ROUNDING:
        return points + [end]
    sides = [corners_around(start, end, zone, turn) for turn in (1, -1)]
    sides = [side for side in sides if all(is_within(c, limits) for c in side)]
    if not sides:
        raise NoDetour()

    def cost(corners):
        if via is not None:
            return min(distance(corner, via) for corner in corners)
        return length_of([start] + corners + [end])

    return points + min(sides, key=cost) + [end]


# The points of a detour for a head that stands where homing X and Y has left it.
# Where nothing else leads out, such as from a corner behind the dock, it goes back
# the way it came, no further than it has to.  'trace' are the moves of that homing,
# each an axis (0: X) and how far (mm) the head went along it.
def out_of_corner(start, end, zone, limits, trace, via=None):
    came, corner = [], tuple(start[:2])
    for axis, moved in reversed(trace):
        back = list(corner)
        back[axis] -= moved
        for stop in list(crossings(corner, back, zone)) + [tuple(back)]:
            try:
                return came + [stop] + around(stop, end, zone, limits, via)
            except NoDetour:
                continue
        corner = tuple(back)
        came.append(corner)
    raise NoDetour()


######################################################################
# Homing beside the dock
######################################################################


# The lines (from, to) that homing goes from a place: along each axis to its end, in
# either order, which macros choose.  'ends' are mm by the axis (0: X).
def homing_lines(place, ends):
    for order in (sorted(ends), sorted(ends, reverse=True)):
        here = tuple(place[:2])
        for axis in order:
            there = list(here)
            there[axis] = ends[axis]
            yield here, tuple(there)
            here = tuple(there)


# Whether homing from a place stays out of the circle around the dock
def is_clear_for_homing(place, ends, zone):
    return all(
        least_distance(start, end, zone) >= zone.radius - ROUNDING
        for start, end in homing_lines(place, ends)
    )


# Places from where homing stays out of it: beside the circle, or where an axis ends;
# the nearest one first
def places_for_homing(start, ends, zone, limits):
    choices = []
    for axis, middle in enumerate((zone.x, zone.y)):
        beside = [middle - zone.radius, middle + zone.radius]
        choices.append([start[axis], ends.get(axis, start[axis])] + beside)
    places = [(x, y) for x in choices[0] for y in choices[1]]
    return [
        place
        for place in sorted(places, key=lambda place: distance(start, place))
        if is_within(place, limits) and is_clear_for_homing(place, ends, zone)
    ]
