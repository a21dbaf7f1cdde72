"""z_touch/auto_z_offset/heights.py: the formula, floors, and which cycles count."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from z_touch.auto_z_offset import heights as az
from z_touch.errors import CalibrationError

STEP = 1 / 64
FLOOR = az.Floor(-4.0, "position_min", "")


def exact(low, high):
    """Multiples of 1/64: their sums are exact."""
    return st.integers(int(low / STEP), int(high / STEP)).map(
        lambda steps: steps * STEP
    )


heights = exact(-10, 10)


# The formula


@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ((-1.32, 0.0, 0.0, 0.2), -1.12),
        # A probe with the right z_offset: what is left is the air gap
        ((-0.05, 1.27, 1.27, 0.2), 0.15),
        ((-0.32, 1.0, 1.0, -0.1), -0.42),
    ],
)
def test_correction(parts, expected):
    assert az.correction(*parts) == pytest.approx(expected)


# Expected heights


def test_probe_alone_tells_how_high_the_bed_can_be():
    expected = az.expect_below_probe(1.5)
    assert expected == (None, -math.inf, 2.0)
    assert az.sensor_floor(FLOOR, expected, 9.0, 1.0) == FLOOR


@pytest.mark.parametrize(
    ("z", "before", "tolerance", "low"),
    [
        (-1.0, None, 0.1, -1.4),
        # The lowest counts
        (-1.0, -1.2, 0.1, -1.6),
        (-1.3, -1.2, 0.0, -1.6),
    ],
)
def test_touch_before_at_the_same_place(z, before, tolerance, low):
    sampling = SimpleNamespace(tolerance=tolerance)
    found = az.expect_again(z, before, sampling)
    assert found.low == pytest.approx(low)
    assert found.z == (z if before is None else min(z, before))
    assert found.high - found.z == pytest.approx(found.z - found.low)


@pytest.mark.parametrize(
    ("braking", "z"),
    [(0.0, -1.3), (0.19, -1.3), (0.25, -1.35), (1.0, -2.1), (3.0, -4.0)],
)
def test_floor_leaves_room_to_brake(braking, z):
    expected = az.expect_near(-1.0, 0.3)
    # v * v = 2 a s
    found = az.sensor_floor(FLOOR, expected, math.sqrt(100 * braking), 50.0)
    assert found.z == pytest.approx(z)
    if z > -4.0:
        assert f"{-1.0 - z:.3f} mm below the expected" in found.why
    else:
        assert found == FLOOR


@given(heights, exact(0, 3), exact(0, 4), exact(-10, 0))
def test_floor_is_never_below_the_configured_one(z, margin, braking, lowest):
    floor = az.Floor(lowest, "", "")
    speed = math.sqrt(100 * braking)
    found = az.sensor_floor(floor, az.expect_near(z, margin), speed, 50.0)
    assert found.z >= lowest
    assert found.z == lowest or found.z <= z - margin


@given(st.floats(0.1, 100.0), st.floats(1.0, 1e5))
def test_touch_can_stop_within_a_millimetre(speed, accel):
    found = az.fastest_touch(speed, accel)
    assert 0.0 < found <= speed
    room = found * found / (2.0 * accel) + az.BRAKING_RESERVE
    assert room <= az.EXPECTED_MARGIN + 1e-9
    assert found == speed or room == pytest.approx(az.EXPECTED_MARGIN)


def test_trigger_above_the_expected_one():
    expected = az.expect_near(-1.0, 0.3)
    az.check_expected(-0.7, expected)
    with pytest.raises(CalibrationError, match="0.310 mm above the exp"):
        az.check_expected(-0.69, expected)
    az.check_expected(1e6, az.NOTHING_EXPECTED)


@pytest.mark.parametrize(
    ("position_min", "probe_z_min", "floor"),
    [
        (-4.0, None, (-4.0, "position_min of section 'stepper_z'", "")),
        (-4.0, -1.1, (-1.1, "probe_z_min", "")),
        # It can only raise what the axis allows
        (-4.0, -7.0, (-4.0, "position_min of section 'stepper_z'", "")),
        (-10.0, None, (-10.0, "position_min of section 'stepper_z'", "")),
        (-10.1, None, (-10.0, "the limit of auto_z_offset", "")),
        (-60.0, -50.0, (-10.0, "the limit of auto_z_offset", "")),
        (-60.0, -9.0, (-9.0, "probe_z_min", "")),
    ],
)
def test_floor_of_the_section(position_min, probe_z_min, floor):
    axis = z_axis(position_min, None)
    assert az.section_floor(axis, probe_z_min) == floor


def z_axis(position_min, position_endstop, pin="^PC2"):
    return SimpleNamespace(
        section="stepper_z",
        position_min=position_min,
        position_endstop=position_endstop,
        endstop_pin=pin,
    )


@pytest.mark.parametrize(
    ("position_min", "endstop", "probe_z_min", "z"),
    [
        (-5.0, 1.6, None, -2.0),
        (-5.0, -0.5, None, -2.5),
        # Whoever knows better, and an axis that ends higher
        (-5.0, 1.6, -4.0, -4.0),
        (-1.0, 1.6, None, -1.0),
        # At the other end of the axis, or of a probe
        (-5.0, 250.0, None, -5.0),
        (-5.0, None, None, -5.0),
    ],
)
def test_floor_below_a_switch(position_min, endstop, probe_z_min, z):
    axis = z_axis(position_min, endstop)
    assert az.section_floor(axis, probe_z_min).z == z


def test_switch_of_a_probe_says_nothing_of_the_bed():
    axis = z_axis(-5.0, 1.6, "probe:z_virtual_endstop")
    assert az.section_floor(axis, None).z == -5.0


@pytest.mark.parametrize(
    ("z_offset", "z"), [(-0.5, 0.1), (2.0, 0.1), (5.0, 0.1), (6.9, 2.0)]
)
def test_floor_of_the_probe(z_offset, z):
    assert az.probe_floor(0.1, z_offset).z == pytest.approx(z)


@pytest.mark.parametrize(
    ("pin_z", "z"), [(None, -4.0), (0.6, 0.6), (-4.0, -4.0), (-6.0, -4.0)]
)
def test_floor_over_the_pin(pin_z, z):
    floor = az.above_pin(FLOOR, pin_z)
    assert floor.z == z
    assert (floor.remedy == "choose a point of the bed") is (z == 0.6)


# Cycles


@pytest.mark.parametrize(
    ("corrections", "counted"),
    [
        ([1.0], [1.0]),
        ([1.0, 1.1, 0.9], [1.0, 1.1, 0.9]),
        # The edge counts, what is beyond it does not
        ([1.0, 1.0, 1.125], [1.0, 1.0, 1.125]),
        ([1.0, 1.0, 1.126], [1.0, 1.0]),
        ([0.7, 1.0, 1.0, 1.3], [1.0, 1.0]),
        # Nobody knows which of two is wrong
        ([1.0, 1.3], [1.0, 1.3]),
        ([1.0, 1.0, 1.3, 1.3], [1.0, 1.0, 1.3, 1.3]),
    ],
)
def test_outliers_do_not_count(corrections, counted):
    assert az.without_outliers(corrections, 0.125) == counted


@given(st.lists(heights, min_size=1, max_size=9), exact(0, 2))
def test_something_always_counts(corrections, tolerance):
    counted = az.without_outliers(corrections, tolerance)
    assert counted
    assert set(counted) <= set(corrections)
    if max(corrections) - min(corrections) <= tolerance:
        assert counted == corrections


# Limits


@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_largest_correction(sign):
    az.check_correction(sign * 10.0)
    with pytest.raises(CalibrationError, match="10 mm is the limit"):
        az.check_correction(sign * 10.001)


@pytest.mark.parametrize(
    ("probe_z", "height"), [(0.0, 5.0), (2.25, 7.25), (-1.27, 5.0)]
)
def test_travel_height(probe_z, height):
    assert az.travel_height(probe_z, 5.0) == height


def test_nozzle_inside_the_bed_is_told():
    for z_offset in (0.0, 0.2):
        assert az.inside_bed(z_offset) == ""
        assert az.inside_bed_after_homing(-z_offset) == ""
    assert "0.070 mm inside the bed" in az.inside_bed(-0.07)
    assert "0.200 mm inside the bed" in az.inside_bed_after_homing(0.2)
