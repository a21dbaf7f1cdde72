"""z_touch/z_calibration/pace.py: how fast and how far where the section leaves it open."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from z_touch.z_calibration import pace

positive = st.floats(0.01, 1000.0)


@given(positive, positive, positive)
def test_way_down_stops_within_half_of_the_margin(margin, fastest, accel):
    """By v * v = 2 a s, and if another board hears of it 25 ms later."""

    def may_be(speed):
        ways = speed**2 / (2.0 * accel), speed * 0.025
        return speed <= fastest and max(ways) <= 0.5 * margin

    speed = pace.armed_speed(margin, fastest, accel)
    assert may_be(speed * (1.0 - 1e-9))
    # And no slower than that
    assert not may_be(speed * (1.0 + 1e-9))


@given(positive, positive)
def test_touch_has_its_speed_after_half_of_its_way(speed, accel):
    lift = pace.least_lift(speed, accel)
    assert lift >= pace.SHORTEST_LIFT
    assert speed**2 / (2.0 * accel) <= lift / 2.0 * (1.0 + 1e-9)
