"""How fast and how far CALIBRATE_Z moves where its section leaves it open: pure."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.calibrated import make_sampling, make_settings
from z_touch.z_calibration import pace
from z_touch.z_calibration.settings import may_lengthen, with_pace

positive = st.floats(0.01, 1000.0)


@given(positive, positive, positive)
def test_way_down_stops_within_half_of_the_margin(margin, fastest, accel):
    speed = pace.armed_speed(margin, fastest, accel)
    assert 0.0 < speed <= fastest
    least = 0.5 * margin * (1.0 + 1e-9)
    assert speed**2 / (2.0 * accel) <= least
    assert speed * pace.BOARDS_APART <= least


@given(positive, positive)
def test_touch_has_its_speed_after_half_of_its_way(speed, accel):
    lift = pace.least_lift(speed, accel)
    assert lift >= pace.SHORTEST_LIFT
    assert speed**2 / (2.0 * accel) <= lift / 2.0 * (1.0 + 1e-9)


def made(retract=2.0, said=(), z_speed=15.0):
    pin = make_sampling(retract_dist=retract, lift_speed=7.0, speed=3.0)
    settings = make_settings(on_pin=pin, on_bed=pin, given=frozenset(said))
    return settings, with_pace(settings, z_speed, 350.0)


@pytest.mark.parametrize(("retract", "lift"), [(2.0, 0.5), (0.3, 0.3)])
def test_lift_is_never_longer_than_of_the_section(retract, lift):
    _, run = made(retract)
    assert run.on_pin.retract_dist == run.on_bed.retract_dist == lift


def test_what_the_section_gives_is_kept():
    settings, run = made(
        said=("probing_retract_dist", "lift_speed", "probing_speed", "speed")
    )
    assert run == settings.replace(z_speed=7.0)
    assert not may_lengthen(run)


def test_what_the_section_leaves_open_is_as_quick_as_z_elsewhere():
    settings, run = made()
    assert run.on_pin.lift_speed == run.on_bed.lift_speed == 15.0
    assert run.probing_speed == run.z_speed == 15.0
    assert run.speed == pace.TRAVEL_SPEED
    # Of the touches it is always the user's
    assert run.on_pin.speed == 3.0
    assert may_lengthen(run)
    # Other commands take what the section and [probe] have
    assert not may_lengthen(settings)


def test_lift_speed_of_the_section_is_that_of_the_way_down_too():
    _, run = made(said=("lift_speed",))
    assert run.probing_speed == run.on_pin.lift_speed == 7.0


def test_armed_way_stops_within_half_of_the_margin():
    settings, _ = made()
    short = settings.replace(travel_margin=0.1)
    assert with_pace(short, 15.0, 350.0).probing_speed == pytest.approx(2.0)
