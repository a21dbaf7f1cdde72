"""What the module chooses with samples: auto: pure."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.unit.calibrated import make_sampling, make_settings
from z_touch.uncertainty.adaptive import Automatic
from z_touch.z_calibration import pace

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


def made(counting, retract=2.0, said=(), axis_speed=15.0):
    pin = make_sampling(retract_dist=retract, lift_speed=7.0, speed=3.0)
    settings = make_settings(
        counting=counting, pin=pin, probe=pin, said=frozenset(said), speed=50.0
    )
    return settings, pace.of_run(settings, axis_speed, 350.0)


def test_count_is_as_configured():
    settings, run = made(make_settings().counting)
    assert run == settings


@pytest.mark.parametrize(("retract", "lift"), [(2.0, 0.5), (0.3, 0.3)])
def test_lift_is_never_longer_than_of_the_section(retract, lift):
    _, run = made(Automatic(0.008), retract)
    assert run.pin.retract_dist == run.probe.retract_dist == lift


def test_what_the_owner_has_said_is_kept():
    names = ("probing_retract_dist", "lift_speed", "probing_speed", "speed")
    settings, run = made(Automatic(0.008), said=names)
    assert run == settings
    _, free = made(Automatic(0.008))
    assert (free.pin.lift_speed, free.speed) == (15.0, pace.FREE_TRAVEL_SPEED)
    assert free.probing_speed == 15.0
    # Of the touches it is always the owner's
    assert free.pin.speed == 3.0


def test_z_is_no_quicker_than_its_owner_has_it():
    """Without max_z_velocity hosts would drive a screw as fast as X and Y."""
    settings, run = made(Automatic(0.008), axis_speed=None)
    assert run.pin.lift_speed == run.probe.lift_speed == 7.0
    assert run.probing_speed == settings.probing_speed
    # Nor where half of the margin would be too short for it
    short = settings._replace(travel_margin=0.1)
    assert pace.of_run(short, None, 350.0).probing_speed == pytest.approx(2.0)
