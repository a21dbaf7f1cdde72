"""The lower bounds of the benchmark, calculated by hand."""

from __future__ import annotations

import pytest

from tools.bench.commands import (
    ACCURACY_SAMPLES,
    AUTO_Z_CALIBRATE,
    CALIBRATE_Z,
    PROBE_Z_ACCURACY,
)
from tools.bench.lower_bounds import (
    Limits,
    Plan,
    Stop,
    lower_bound,
    move_seconds,
)

# Numbers to calculate with by hand
PIN = Stop(
    "pin",
    x=30.0,
    y=40.0,
    trigger_z=8.0,
    travel_z=20.0,
    approach_speed=5.0,
    samples=2,
    speed=2.0,
    retract=2.0,
    lift_speed=20.0,
    accel=100.0,
)
SIMPLE = Plan(
    stops=(PIN,),
    end_z=20.0,
    travel_speed=50.0,
    limits=Limits(100.0, 1000.0, 10.0, 100.0),
)


@pytest.mark.parametrize(
    "distance, speed, accel, stops, seconds",
    [
        # Trapezoids: distance / speed, and half a ramp's time for each ramp
        (50.0, 50.0, 1000.0, True, 1.05),
        (2.0, 2.0, 100.0, False, 1.01),
        # Triangles: half way up, half way down; all the way up
        (1.0, 10.0, 4.0, True, 1.0),
        (2.0, 10.0, 4.0, False, 1.0),
        # Where both are the same
        (2.0, 2.0, 2.0, True, 2.0),
        (0.0, 10.0, 100.0, False, 0.0),
    ],
)
def test_move_is_calculated_right(distance, speed, accel, stops, seconds):
    found = move_seconds(distance, speed, accel, stops)
    assert found == pytest.approx(seconds)


def bound(plan, *start):
    parts = lower_bound(plan, start)
    return {(part.site, part.what): part.seconds for part in parts}


def test_bound_of_one_site():
    assert bound(SIMPLE, 0.0, 0.0, 10.0) == pytest.approx(
        {
            ("pin", "lift"): 1.1,  # 10 mm at 10 mm/s, all that Z can
            ("pin", "travel"): 1.05,  # 50 mm at 50 mm/s
            ("pin", "prepare"): 0.0,
            ("pin", "approach"): 2.05,  # 10 mm at 5 mm/s
            ("pin", "samples"): 2.02,  # twice 2 mm at 2 mm/s
            ("pin", "retracts"): 0.3,  # 2 mm at 10 mm/s, between them
            ("end", "lift"): 1.3,  # 12 mm at 10 mm/s
        }
    )


def test_way_to_where_the_head_has_to_stand():
    back = bound(SIMPLE._replace(end=(80.0, 40.0)), 0.0, 0.0, 10.0)
    assert back.pop(("end", "travel")) == pytest.approx(
        1.05
    )  # 50 mm at 50 mm/s
    assert back == bound(SIMPLE, 0.0, 0.0, 10.0)


def test_way_that_is_not_needed_takes_no_time():
    there = bound(SIMPLE, 30.0, 40.0, 15.0)
    assert there["pin", "lift"] == there["pin", "travel"] == 0.0
    assert there["pin", "approach"] == pytest.approx(1.05)  # 5 mm
    above = bound(SIMPLE, 0.0, 0.0, 60.0)
    assert above["pin", "lift"] == 0.0
    assert above["pin", "approach"] == pytest.approx(2.05)


def test_next_site_begins_at_the_touch_of_the_last():
    other = PIN._replace(name="bed", x=0.0, trigger_z=18.5)
    plan = SIMPLE._replace(stops=(PIN, other), prepare=3.5)
    parts = bound(plan, 0.0, 0.0, 10.0)
    assert parts["bed", "lift"] == pytest.approx(1.3)  # 8 to 20
    assert parts["bed", "travel"] == pytest.approx(0.65)  # 30 mm
    assert parts["bed", "approach"] == 0.0  # begins above the travel height
    assert parts["end", "lift"] == pytest.approx(0.25)  # 1.5 mm at 10 mm/s
    # The user's G-code runs once
    assert (parts["pin", "prepare"], parts["bed", "prepare"]) == (3.5, 0.0)


def test_slow_acceleration_counts_on_the_way_down_only():
    fast = bound(SIMPLE, 0.0, 0.0, 10.0)
    plan = SIMPLE._replace(stops=(PIN._replace(accel=1.0),))
    slow = bound(plan, 0.0, 0.0, 10.0)
    assert slow["pin", "samples"] == pytest.approx(4.0)  # twice 2 s, 2 mm
    assert slow["pin", "approach"] > fast["pin", "approach"]
    for what in ("lift", "travel", "retracts"):
        assert slow["pin", what] == fast["pin", what]


# Of the machines


def plan_of(command):
    return command.plan(command.scene, command.changes)


def test_plan_of_calibrate_z():
    way, limits = (15.0, 8.0), Limits(300.0, 3000.0, 15.0, 350.0)
    pin, bed = (3, 2.0, 2.0, 10.0, 350.0), (3, 5.0, 2.0, 10.0, 350.0)
    wanted = (
        Stop("nozzle", 206.0, 306.0, 1.6, *way, *pin),
        Stop("switch", 208.0, 281.25, 8.015, *way, *pin),
        Stop("bed", 152.0, 125.25, 7.0138, *way, *bed),
    )
    plan = plan_of(CALIBRATE_Z)
    for stop, other in zip(plan.stops, wanted):
        assert stop.name == other.name
        assert stop[1:] == pytest.approx(other[1:])
    assert plan._replace(stops=()) == Plan((), 15.0, 50.0, limits)
    # The same pin, more often
    stops = (plan.stops[0]._replace(samples=ACCURACY_SAMPLES),)
    assert plan_of(PROBE_Z_ACCURACY) == plan._replace(stops=stops)


def test_plan_of_auto_z_calibrate():
    plan = plan_of(AUTO_Z_CALIBRATE)
    # Sensor 0.05 mm below the bed, the probe 1.2713 mm above it and at 0
    sensor = Stop(
        "sensor", 119.75, 126.75, -1.3213, 5.0, 5.0, 1, 5.0, 6.3213, 20.0, 50.0
    )
    later = sensor._replace(travel_z=3.6787, retract=5.0)
    probe = Stop(
        "probe", 102.15, 122.35, 0.0, 3.6787, 5.0, 1, 5.0, 3.6787, 20.0, 500.0
    )
    wanted = [sensor, probe, later, probe, later, probe]
    assert [stop.name for stop in plan.stops] == [w.name for w in wanted]
    for stop, other in zip(plan.stops, wanted):
        assert stop[1:] == pytest.approx(other[1:])
    assert plan.end_z == pytest.approx(3.6787)
    # There the nozzle stands over the point that was measured
    assert plan.end == sensor[1:3]
    # No option for the speed of travel: the fastest there is
    assert plan.travel_speed == 300.0
