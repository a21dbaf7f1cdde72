"""z_touch/extra_probe/heights.py: the bed, and how low a touch may go."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from z_touch.errors import CalibrationError
from z_touch.extra_probe import heights
from z_touch.host.toolhead import ZZero

z_values = st.floats(-5.0, 5.0)
thicknesses = st.floats(0.01, 2.0)


def settings(**changes):
    """Those of a membrane of 0.25 mm, as far as heights depend on them."""
    values = {
        "z_offset": 0.25,
        "saved_homing_z": None,
        "position_min": None,
        "switch_height": None,
    }
    return SimpleNamespace(**{**values, **changes})


def z_zero(z):
    return ZZero("stepper_z", "position_endstop", z)


# The bed


@given(st.integers(-320, 320), st.integers(0, 128))
def test_bed_is_a_thickness_below_the_trigger(bed, thickness):
    # Multiples of 1/64: their sums are exact
    bed_z, z_offset = bed / 64, thickness / 64
    assert heights.bed_height(bed_z + z_offset, z_offset) == bed_z


@pytest.mark.parametrize("trigger_z", [5.251, -4.751])
def test_bed_that_is_nowhere_near(trigger_z):
    with pytest.raises(
        CalibrationError, match="over 5 mm from Z=0; begin again"
    ):
        heights.bed_height(trigger_z, 0.25)


@pytest.mark.parametrize(
    ("bed_z", "z"), [(0.45, -0.45), (-1.2344, 1.234), (2.0, -2.0), (-3.0, 3.0)]
)
def test_zero_moves_against_the_bed(bed_z, z):
    corrected = heights.corrected_zero(z_zero(0.0), bed_z, (-2.0, 3.0))
    assert corrected == ZZero("stepper_z", "position_endstop", z)


@pytest.mark.parametrize("bed_z", [2.001, -3.001])
def test_zero_stays_within_the_axis(bed_z):
    words = r"stepper_z: position_endstop would be -?\d\.001, outside the"
    with pytest.raises(CalibrationError, match=f"{words} -2.000 to 3.000 of"):
        heights.corrected_zero(z_zero(0.0), bed_z, (-2.0, 3.0))


# How low


@pytest.mark.parametrize(
    ("options", "z", "expected"),
    [
        # As low as homing goes, and a little: a bed that is believed to be at 0
        ({}, 1.0, -0.1),
        ({}, 0.0, -0.1),
        ({}, -0.5, -0.6),
        ({"saved_homing_z": 1.0}, 1.0, 0.125),
        ({"saved_homing_z": 1.0}, 1.124, 0.125),
        ({"saved_homing_z": 1.0}, 0.876, 0.125),
        ({"saved_homing_z": 1.0}, 1.126, -0.1),
        ({"saved_homing_z": 1.0}, 0.874, -0.1),
        ({"saved_homing_z": 1.0, "z_offset": 1.0}, 1.4, 0.5),
        ({"saved_homing_z": 1.0, "position_min": -0.2}, 1.0, -0.2),
        # Nothing to lie on the bed
        ({"saved_homing_z": 1.0, "z_offset": 0.0}, 1.0, -0.1),
    ],
)
def test_floor(options, z, expected):
    assert heights.floor(settings(**options), z_zero(z), -5.0) == expected


def test_floor_where_nobody_knows_the_zero():
    assert heights.floor(settings(saved_homing_z=1.0), None, -5.0) == -1.0


@pytest.mark.parametrize(("pin_z", "floor"), [(None, -0.1), (0.6, 0.6)])
def test_floor_over_the_pin(pin_z, floor):
    assert heights.above_pin(-0.1, pin_z) == floor


@given(z_values, z_values, z_values)
def test_floor_of_the_command_comes_first(param, position_min, axis_min):
    record = settings(position_min=position_min, saved_homing_z=1.0)
    floor = heights.floor(record, z_zero(1.0), axis_min, param)
    assert floor == max(param, axis_min)


@given(thicknesses, z_values, z_values, z_values)
def test_floor_is_above_the_bed_or_the_user_was_told(
    thickness, saved_homing_z, homing_z, axis_min
):
    # What a saved calibration has put at Z=0 moves with what Z is homed at
    record = settings(z_offset=thickness, saved_homing_z=saved_homing_z)
    zero = z_zero(homing_z)
    floor = heights.floor(record, zero, axis_min, is_proved=True)
    bed_z = homing_z - saved_homing_z
    if heights.is_calibrated(record, z_zero(homing_z)):
        assert floor >= bed_z or math.isclose(floor, bed_z)
        # And a membrane that lies there is met
        assert bed_z + thickness > thickness / 2.0 - 1e-9
    else:
        assert floor == max(heights.UNSAVED_FLOOR, axis_min)
