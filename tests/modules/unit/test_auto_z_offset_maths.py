"""The pure part of auto_z_offset.py that it does not share: edges and rules."""

from __future__ import annotations

import importlib.util
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

ROOT = Path(__file__).resolve().parents[3]
_SPEC = importlib.util.spec_from_file_location(
    "auto_z_offset", ROOT / "auto_z_offset.py"
)
az = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(az)

STEP = 1 / 64


def exact(low, high):
    """Multiples of 1/64: their sums are exact."""
    return st.integers(int(low / STEP), int(high / STEP)).map(
        lambda steps: steps * STEP
    )


heights = exact(-10, 10)
gaps = exact(-2, 2)


def sampling(**changes):
    """A Sampling with some values changed."""
    usual = az.Sampling(1, 0.1, 0, "average", 5.0, 3.0, 20.0)
    return usual._replace(**changes)


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


@given(heights, heights, heights, gaps, heights)
def test_correction_does_not_depend_on_the_frame(
    sensor, probe, z_offset, gap, shift
):
    here = az.correction(sensor, probe, z_offset, gap)
    there = az.correction(sensor + shift, probe + shift, z_offset, gap)
    assert there == here


@given(heights, heights, heights, gaps, exact(0, 2))
def test_larger_gap_and_higher_bed_lift_the_nozzle(
    sensor, probe, z_offset, gap, more
):
    here = az.correction(sensor, probe, z_offset, gap)
    assert az.correction(sensor, probe, z_offset, gap + more) == here + more
    assert az.correction(sensor + more, probe, z_offset, gap) == here + more
    # A probe that says the bed is higher is corrected downward
    assert az.correction(sensor, probe + more, z_offset, gap) == here - more


# Expected heights


@given(heights, heights, heights, gaps)
def test_correction_expects_the_touch_it_came_from(
    sensor, probe, z_offset, gap
):
    found = az.correction(sensor, probe, z_offset, gap)
    bed_z = probe - z_offset
    expected = az.expect_corrected(found, gap, bed_z)
    assert expected.z == sensor
    assert (expected.low, expected.high) == (sensor - 1.0, sensor + 1.0)


def test_probe_alone_tells_how_high_the_bed_can_be():
    expected = az.expect_below_probe(1.5)
    assert expected.z is None
    assert expected.high == 2.0
    assert math.isinf(expected.low)
    floor = az.sensor_floor(az.Floor(-4.0, "why"), expected, 9.0, 1.0)
    assert floor.z == -4.0


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
    found = az.expect_again(z, before, sampling(tolerance=tolerance))
    assert found.low == pytest.approx(low)
    assert found.z == (z if before is None else min(z, before))
    assert found.high - found.z == pytest.approx(found.z - found.low)


FLOOR = az.Floor(-4.0, "position_min")


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
    floor = az.Floor(lowest, "")
    speed = math.sqrt(100 * braking)
    found = az.sensor_floor(floor, az.expect_near(z, margin), speed, 50.0)
    assert found.z >= lowest
    assert found.z == lowest or found.z <= z - margin
    free = az.sensor_floor(floor, az.NOTHING_EXPECTED, speed, 50.0)
    assert free == floor


@given(st.floats(0.1, 100.0), st.floats(1.0, 1e5))
def test_touch_can_stop_within_a_millimetre(speed, accel):
    found = az.fastest_touch(speed, accel)
    assert 0.0 < found <= speed
    room = found * found / (2.0 * accel) + az.BRAKING_RESERVE
    assert room <= az.KNOWN_MARGIN + 1e-9
    assert found == speed or room == pytest.approx(az.KNOWN_MARGIN)


@pytest.mark.parametrize(("z", "good"), [(-0.7, True), (-0.69, False)])
def test_trigger_above_the_expected_one(z, good):
    expected = az.expect_near(-1.0, 0.3)
    if good:
        az.check_expected(z, expected)
        return
    with pytest.raises(az.CalibrationError, match="0.310 mm above the exp"):
        az.check_expected(z, expected)


def test_nothing_expected_allows_everything():
    for z in (-1e6, 0.0, 1e6):
        az.check_expected(z, az.NOTHING_EXPECTED)


# Limits


@pytest.mark.parametrize("z", [-10.0, 0.0, 10.0])
def test_largest_correction(z):
    az.check_correction(z)


@pytest.mark.parametrize("z", [-10.001, 10.001])
def test_correction_beyond_it(z):
    with pytest.raises(az.CalibrationError, match="10 mm is the limit"):
        az.check_correction(z)


@pytest.mark.parametrize(
    ("probe_z", "height"), [(0.0, 5.0), (2.25, 7.25), (-1.27, 5.0)]
)
def test_travel_height(probe_z, height):
    assert az.travel_height(probe_z, 5.0) == height


@pytest.mark.parametrize(
    ("text", "value"), [("0.1", 0.1), ("1", 1.0), (" 0.33", 0.33)]
)
def test_number_between(text, value):
    assert az.parse_between(text, 0.1, 1.0) == value


@pytest.mark.parametrize("text", ["0.09", "1.01", "", "x", "nan", "-inf"])
def test_number_that_is_not_between(text):
    with pytest.raises(az.CalibrationError):
        az.parse_between(text, 0.1, 1.0)


@pytest.mark.parametrize(("text", "good"), [("4", True), ("3.999", False)])
def test_hop(text, good):
    if good:
        assert az.parse_hop(text) == 4.0
        return
    with pytest.raises(az.CalibrationError, match="less than 4"):
        az.parse_hop(text)


@pytest.mark.parametrize(
    ("pin", "chip"),
    [
        ("PC1", "mcu"),
        ("^!PC1", "mcu"),
        ("U_1:PC1", "U_1"),
        ("!U_1:PA14", "U_1"),
        ("^ probe:z_virtual_endstop", "probe"),
    ],
)
def test_chip_of_a_pin(pin, chip):
    assert az.chip_of(pin) == chip


# What the user is told


@pytest.mark.parametrize("z_offset", [0.0, 0.2])
def test_nozzle_outside_the_bed_is_no_news(z_offset):
    assert az.inside_bed(z_offset) == ""
    assert az.inside_bed_after_homing(-z_offset) == ""


def test_nozzle_inside_the_bed_is_told():
    assert "0.070 mm inside the bed" in az.inside_bed(-0.07)
    assert "0.200 mm inside the bed" in az.inside_bed_after_homing(0.2)
