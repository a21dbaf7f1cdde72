"""z_touch/z_calibration/switch_offset.py: baby steps into switch_offset."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from z_touch.errors import CalibrationError
from z_touch.z_calibration.switch_offset import (
    check_steps,
    corrected_switch_offset,
)

# What CALIBRATE_Z has set, and the switch_offset that it was calculated with
BASE = 0.16, 0.44


@given(st.floats(-1, 1), st.floats(0.3, 2), st.floats(-0.25, 0.25))
def test_next_calibration_gives_the_offset_of_the_baby_steps(
    z_offset, switch_offset, change
):
    new, _ = check_steps(z_offset, switch_offset, z_offset + change, True)
    # offset = something measured - switch_offset
    measured = z_offset + switch_offset
    assert measured - new == pytest.approx(z_offset + change)


@given(st.floats(-1, 1), st.floats(0, 2), st.floats(-1, 1))
def test_next_calibration_gives_the_height_that_was_moved_to(
    z_offset, switch_offset, z
):
    new = corrected_switch_offset(switch_offset, z, z_offset)
    measured = z_offset + switch_offset
    assert measured - new == pytest.approx(z)


@pytest.mark.parametrize(
    ("z_offset", "force", "words"),
    [
        (0.61, True, "new switch_offset=-0.010, which cannot be negative"),
        (-0.35, False, "a change of more than 0.5 mm"),
        (0.0, False, "the G-code offset is 0"),
    ],
)
def test_what_cannot_be_is_refused(z_offset, force, words):
    with pytest.raises(CalibrationError, match=words):
        check_steps(*BASE, z_offset, force)


@pytest.mark.parametrize(
    ("z_offset", "force"),
    [
        # Only unlikely
        (-0.35, True),
        (0.0, True),
        # Half a millimetre, and 0 as new switch_offset
        (-0.33, False),
        (0.59, False),
        (0.6, True),
    ],
)
def test_what_may_be_is_taken(z_offset, force):
    assert check_steps(*BASE, z_offset, force)[0] >= 0.0
