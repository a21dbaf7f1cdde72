"""z_touch/dockable_probe/path.py: around the dock, never through it."""

from __future__ import annotations

import math

import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from z_touch.dockable_probe import path as detour

LIMITS = ((0.0, 300.0), (-5.0, 310.0))
# The body that the toolhead must not meet, as a part of the circle
BODY = 0.5
LANE = detour.LANE

coordinate = st.floats(0.0, 300.0)
point = st.tuples(coordinate, coordinate)
angle = st.floats(0.0, 2 * math.pi)


@st.composite
def zones(draw):
    """A dock anywhere in reach, entered at any angle, left at another."""
    way_in = draw(angle)
    way_off = way_in + draw(st.floats(0.8, 2 * math.pi - 0.8))
    lanes = [(math.cos(a), math.sin(a)) for a in (way_in, way_off)]
    (x, y), radius = draw(point), draw(st.floats(15.0, 60.0))
    for ux, uy in lanes:
        # Where approach_position and detach_position are: within reach
        end = (x + ux * radius, y + uy * radius)
        for aside in (-LANE, LANE):
            shifted = (end[0] + uy * aside, end[1] - ux * aside)
            assume(detour.is_within(shifted, LIMITS))
    return detour.Zone(x, y, radius, lanes)


def depth_in_body(xy, zone):
    """How deep (mm) a toolhead there is in a dock that is open along its lanes."""
    dx, dy = xy[0] - zone.x, xy[1] - zone.y
    depth = BODY * zone.radius - math.hypot(dx, dy)
    for ux, uy in zone.lanes:
        along, aside = dx * ux + dy * uy, abs(dx * uy - dy * ux)
        if along >= -LANE and aside <= LANE:
            return 0.0
    return max(0.0, depth)


def along(points, step=1.5):
    """Points of a polyline, close together."""
    for (ax, ay), (bx, by) in zip(points, points[1:]):
        count = max(1, int(math.hypot(bx - ax, by - ay) / step))
        for i in range(count + 1):
            yield ax + (bx - ax) * i / count, ay + (by - ay) * i / count


def path(start, end, zone, limits=LIMITS, via=None):
    return [start, *detour.around(start, end, zone, limits, via)]


def apart(xy, zone):
    return math.hypot(xy[0] - zone.x, xy[1] - zone.y)


@settings(max_examples=250)
@given(zone=zones(), start=point, end=point)
def test_never_a_hit_from_anywhere_to_anywhere(zone, start, end):
    assume(depth_in_body(start, zone) == 0.0)
    try:
        points = path(start, end, zone)
    except detour.NoWay:
        # Only where the circle reaches from one end of the axes to another
        room = min(min(zone.x, 300 - zone.x), min(zone.y + 5, 310 - zone.y))
        assert room < zone.radius * 1.05
        return
    for xy in along(points):
        assert depth_in_body(xy, zone) < 1e-6, xy
        assert detour.is_within(xy, LIMITS)


@settings(max_examples=250)
@given(zone=zones(), start=point, end=point)
def test_never_nearer_to_the_dock_than_at_the_start(zone, start, end):
    try:
        points = path(start, end, zone)
    except detour.NoWay:
        return
    nearest = min(apart(start, zone), zone.radius)
    lane_slack = LANE if apart(start, zone) < 2 * LANE else 0.0
    for xy in along(points):
        assert apart(xy, zone) >= nearest - lane_slack - 0.01
    # and outside of the circle from the first corner on
    if apart(start, zone) >= zone.radius:
        assert all(
            apart(xy, zone) >= zone.radius - 0.01 for xy in along(points)
        )


@given(zone=zones(), start=point, end=point)
def test_ends_where_it_should_or_beside_the_dock(zone, start, end):
    try:
        points = path(start, end, zone)
    except detour.NoWay:
        return
    if apart(end, zone) >= zone.radius:
        assert points[-1] == end
    else:
        assert apart(points[-1], zone) == pytest.approx(zone.radius, abs=0.01)


@given(zone=zones(), start=point, end=point)
def test_straight_where_the_dock_is_not_in_the_way(zone, start, end):
    clear = detour.least_distance(start, end, zone) >= zone.radius
    assume(clear)
    assert path(start, end, zone) == [start, end]


DOCK = detour.Zone(150.0, 150.0, 40.0, [(0.0, -1.0), (1.0, 0.0)])


def test_the_shorter_way_around():
    points = path((50.0, 160.0), (250.0, 160.0), DOCK)
    assert min(y for _, y in points[1:-1]) > 150.0
    length = detour.length_of(points)
    straight = 2 * math.sqrt(100**2 + 10**2 - 40**2)
    # Tangent, arc, tangent: hardly longer than the best there is
    tangent = math.acos(40 / math.hypot(100, 10))
    turn = math.pi - 2 * math.atan2(10, 100) - 2 * tangent
    best = straight + 40 * turn
    assert length == pytest.approx(best, rel=0.005)


def test_the_way_by_the_point_that_is_wanted():
    points = path((50.0, 160.0), (250.0, 160.0), DOCK, via=(150.0, 100.0))
    assert max(y for _, y in points[1:-1]) < 150.0


def test_the_longer_way_where_the_shorter_one_is_out_of_reach():
    dock = DOCK._replace(y=280.0)
    points = path((50.0, 285.0), (250.0, 285.0), dock)
    assert all(y <= 285.0 for _, y in points)
    assert len(points) > 3


def test_no_way_at_all():
    narrow = ((0.0, 300.0), (120.0, 180.0))
    with pytest.raises(detour.NoWay):
        path((50.0, 150.0), (250.0, 150.0), DOCK, narrow)


@pytest.mark.parametrize(
    ("start", "out"),
    [
        # Along the lane, not straight away from the middle
        ((151.0, 145.0), (151.0, 150.0 - math.sqrt(40**2 - 1))),
        ((160.0, 148.5), (150.0 + math.sqrt(40**2 - 1.5**2), 148.5)),
        ((150.0, 150.0), (150.0, 110.0)),
        # Beside the dock
        ((150.0, 180.0), (150.0, 190.0)),
    ],
)
def test_out_of_the_circle_first(start, out):
    points = path(start, (150.0, 20.0), DOCK)
    assert points[1] == pytest.approx(out, abs=1e-6)


def test_out_beside_the_dock_where_straight_out_is_out_of_reach():
    dock = DOCK._replace(x=10.0)
    points = path((5.0, 170.0), (100.0, 300.0), dock)
    assert detour.is_within(points[1], LIMITS)
    assert apart(points[1], dock) == pytest.approx(40.0)


def position(x, y, z=None):
    return detour.Position(x, y, z)


@pytest.mark.parametrize(
    ("extract", "detach", "degrees"),
    [
        (position(0, -40), position(40, 0), 90.0),
        (position(0, -40), position(0, -20), 0.0),
        (position(0, -40), position(0, 40), 180.0),
        # Up or down first
        (position(0, -40), position(0, -40, 30), 90.0),
        (position(0, -40, 5), position(0, -40, 1), 90.0),
        (position(0, -40, 5), position(0, -40, 5), 0.0),
        # Up first, both
        (position(0, -40, 8), position(0, -40, 9), 0.0),
        (position(0, -40, 8), position(40, 0, 9), 90.0),
    ],
)
def test_angle_between_two_ways_out(extract, detach, degrees):
    dock = position(0, 0, 5)
    angle = detour.strip_angle(dock, 5, extract, detach)
    assert angle == pytest.approx(degrees, abs=0.01)


# Homing


END = st.sampled_from([0.0, 300.0])


@given(
    zone=zones(),
    start=point,
    ends=st.dictionaries(st.sampled_from([0, 1]), END, min_size=1),
)
def test_homing_from_a_place_stays_out_of_the_circle(zone, start, ends):
    places = detour.places_for_homing(start, ends, zone, LIMITS)
    far = [math.dist(start, place) for place in places]
    assert far == sorted(far)
    for place in places:
        assert detour.is_within(place, LIMITS)
        for axes in {tuple(sorted(ends)), tuple(sorted(ends))[::-1]}:
            here = list(place)
            for axis in axes:
                length = ends[axis] - here[axis]
                for part in range(51):
                    at = list(here)
                    at[axis] += length * part / 50.0
                    assert detour.distance(at, zone) > zone.radius - 0.01
                here[axis] = ends[axis]


@pytest.mark.parametrize(
    ("ends", "wanted"),
    [
        # Straight before the dock: to either side, and to the right with X
        ({1: 310.0}, (12.0, 270.0)),
        ({0: 300.0, 1: 310.0}, (88.0, 270.0)),
        # Away from it
        ({1: 0.0}, (50.0, 270.0)),
        # In the corner of the dock
        ({0: 40.0, 1: 310.0}, None),
    ],
)
def test_nearest_place_to_home_from(ends, wanted):
    zone = detour.Zone(50.0, 308.0, 38.0, [(0.0, -1.0), (1.0, 0.0)])
    places = detour.places_for_homing((50.0, 270.0), ends, zone, LIMITS)
    assert (places[0] if places else None) == wanted
