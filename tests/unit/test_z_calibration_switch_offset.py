"""Baby steps into switch_offset: pure."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.calibrated import (
    distances,
    exact,
    machines,
    results,
    shifts,
    travels,
)
from z_touch.errors import CalibrationError
from z_touch.z_calibration.heights import offset
from z_touch.z_calibration.switch_offset import (
    check_steps,
    corrected_switch_offset,
)

BASE = 0.16, 0.44


@given(st.floats(-1, 1), st.floats(0.3, 2), st.floats(-0.25, 0.25))
def test_next_calibration_gives_the_offset_of_the_baby_steps(
    z_offset, switch_offset, change
):
    new, _ = check_steps(z_offset, switch_offset, z_offset + change, True)
    # offset = something measured - switch_offset
    measured = z_offset + switch_offset
    assert measured - new == pytest.approx(z_offset + change)


def test_answer_has_old_change_and_new():
    new, text = check_steps(*BASE, 0.18, False)
    assert new == pytest.approx(0.42)
    assert text == (
        "switch_offset=0.440 - (G-code offset=0.180 - 0.160 of CALIBRATE_Z)"
        " --> new switch_offset=0.420"
    )


@pytest.mark.parametrize(
    ("z_offset", "force", "words"),
    [
        (0.61, True, "new switch_offset=-0.010, which cannot be negative"),
        (0.61, False, "cannot be negative"),
        (-0.35, False, "a change of more than 0.5 mm"),
        (0.0, False, "the G-code offset is 0"),
    ],
)
def test_what_cannot_be_is_refused(z_offset, force, words):
    with pytest.raises(CalibrationError, match=words):
        check_steps(*BASE, z_offset, force)


@pytest.mark.parametrize("z_offset", [-0.35, 0.0])
def test_force_helps_against_what_is_only_unlikely(z_offset):
    assert check_steps(*BASE, z_offset, True)[0] > 0.0


@pytest.mark.parametrize("z_offset", [-0.33, 0.59])
def test_half_a_millimetre_is_allowed(z_offset):
    assert check_steps(*BASE, z_offset, False)[0] >= 0.0


class TestCorrectedSwitchOffset:
    @pytest.mark.parametrize(
        ("switch_offset", "z", "z_offset", "expected"),
        [
            (0.5, 0.25, 0.25, 0.5),  # it was right
            (0.5, -0.25, 0.0, 0.75),  # the nozzle had to go lower
            (0.5, 0.25, 0.0, 0.25),
            (0.5, -1.25, -1.0, 0.75),
            (0.0, 0.5, 0.0, -0.5),  # refused later on
        ],
    )
    def test_table(self, switch_offset, z, z_offset, expected):
        new = corrected_switch_offset(switch_offset, z, z_offset)
        assert new == expected

    @given(results, shifts)
    def test_gives_the_offset_that_was_moved_to(self, result, z):
        p, s, n, so = result[:4]
        new = corrected_switch_offset(so, z, offset(p, s, n, so))
        assert offset(p, s, n, new) == z

    @given(machines, exact(0, 3))
    def test_finds_the_travel_of_a_modelled_machine(self, machine, wrong):
        p, s, n = machine.result()[:3]
        found = offset(p, s, n, wrong)
        new = corrected_switch_offset(wrong, machine.bed, found)
        assert new == machine.travel

    @given(travels, shifts, shifts, distances)
    def test_signs(self, so, z, z_offset, more):
        plain = corrected_switch_offset(so, z, z_offset)
        assert corrected_switch_offset(so, z - more, z_offset) > plain
        assert corrected_switch_offset(so, z, z_offset - more) < plain
        assert corrected_switch_offset(so + more, z, z_offset) > plain
