"""z_touch/wizard.py: what a hand has done, and how far a button moves."""

from __future__ import annotations

import pytest

from z_touch import wizard
from z_touch.errors import CalibrationError
from z_touch.wizard import jogged

# The reading of the pin asked for, and of the other one
NO, YES = False, True


@pytest.mark.parametrize(
    ("readings", "verdict"),
    [
        ([(NO, YES)], "nothing"),
        ([(NO, YES), (NO, YES)], "nothing"),
        ([(NO, YES), (YES, YES)], "held"),
        ([(NO, YES), (YES, YES), (NO, YES)], "good"),
        ([(YES, NO), (NO, NO)], "early"),
        ([(NO, NO), (NO, YES), (NO, NO)], "other"),
        ([(NO, NO), (YES, YES), (NO, NO)], "both"),
        # Not at the same moment
        ([(NO, NO), (YES, NO), (NO, YES)], "both"),
    ],
)
def test_what_a_hand_has_done(readings, verdict):
    assert wizard.judge(readings) == verdict


@pytest.mark.parametrize(
    ("start", "distance", "end"),
    [(5.0, 5.0, 10.0), (5.0, -5.0, 0.0), (-1.0, 1.0, 0.0), (12.0, -1.0, 11.0)],
)
def test_jog_within_the_limits_or_towards_them(start, distance, end):
    assert jogged("X", start, distance, (0.0, 10.0)) == end


@pytest.mark.parametrize(
    ("start", "distance", "end"),
    [(5.0, -10.0, 2.0), (5.0, -3.0, 2.0), (5.0, -1.0, 4.0), (2.0, 1.0, 3.0)],
)
def test_jog_that_stops_by_itself(start, distance, end):
    assert jogged("Z", start, distance, (2.0, 9.0), stops=True) == end


@pytest.mark.parametrize(
    ("start", "distance", "words"),
    [
        # Nowhere to go
        (2.0, -0.1, "would lead to 1.900, outside 2.000"),
        (1.0, -0.1, "would lead to 0.900, outside 1.000"),
        (9.0, -10.1, "by 10 mm at most"),
        (8.5, 1.0, "outside 2.000 to 9.000"),
    ],
)
def test_jog_that_does_not_even_stop(start, distance, words):
    with pytest.raises(CalibrationError, match=words):
        jogged("Z", start, distance, (2.0, 9.0), stops=True)


@pytest.mark.parametrize(
    ("start", "distance", "words"),
    [
        (5.0, 5.1, "X=5.1 would lead to 10.100, outside 0.000 to 10.000"),
        (5.0, -5.1, "outside"),
        (-1.0, -0.1, "would lead to -1.100"),
        (5.0, 10.1, "by 10 mm at most"),
        (5.0, -10.1, "by 10 mm at most"),
    ],
)
def test_jog_too_far(start, distance, words):
    with pytest.raises(CalibrationError, match=words):
        jogged("X", start, distance, (0.0, 10.0))
