"""The pure part of extra_probe.py: how low a touch may go."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.loading import load

ep = load("z_touch.extra_probe.module")

heights = st.floats(-5.0, 5.0)
thicknesses = st.floats(0.01, 2.0)


def settings(**own):
    """Settings with a membrane of 0.25 mm, and nothing else."""
    plain = dict.fromkeys(ep.Settings._fields)
    return ep.Settings(**{**plain, "thickness": 0.25, **own})


def homing(z):
    return ep.Homing("stepper_z", "position_endstop", z)


@pytest.mark.parametrize(
    ("own", "now", "expected"),
    [
        ({}, 1.0, -1.0),
        ({"saved_z": 1.0}, 1.0, 0.125),
        ({"saved_z": 1.0}, 1.124, 0.125),
        ({"saved_z": 1.0}, 0.876, 0.125),
        ({"saved_z": 1.0}, 1.126, -1.0),
        ({"saved_z": 1.0}, 0.874, -1.0),
        ({"saved_z": 1.0, "thickness": 1.0}, 1.4, 0.5),
        ({"saved_z": 1.0, "position_min": -0.2}, 1.0, -0.2),
        # Nothing to lie on the bed
        ({"saved_z": 1.0, "thickness": 0.0}, 1.0, -1.0),
    ],
)
def test_floor(own, now, expected):
    assert ep.floor(settings(**own), homing(now), -5.0) == expected


def test_floor_where_nobody_knows_the_zero():
    assert ep.floor(settings(saved_z=1.0), None, -5.0) == -1.0


@given(heights, heights, heights)
def test_floor_of_the_command_comes_first(own, position_min, axis_min):
    given_settings = settings(position_min=position_min, saved_z=1.0)
    found = ep.floor(given_settings, homing(1.0), axis_min, own)
    assert found == max(own, axis_min)


@given(thicknesses, heights, heights, heights)
def test_floor_is_above_the_bed_or_the_user_was_told(
    thickness, saved_z, now, axis_min
):
    # What a saved calibration has put at Z=0 moves with what Z is homed at
    own = settings(thickness=thickness, saved_z=saved_z)
    found = ep.floor(own, homing(now), axis_min)
    bed_z = now - saved_z
    if ep.is_calibrated(own, homing(now)):
        assert found >= bed_z or math.isclose(found, bed_z)
        # And a membrane that lies there is met
        assert bed_z + thickness > thickness / 2.0 - 1e-9
    else:
        assert found == max(ep.UNSAVED_FLOOR, axis_min)
