"""The lower bounds of the benchmark, calculated by hand."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.bench.commands import (
    ACCURACY_SAMPLES,
    AUTO_Z_CALIBRATE,
    CALIBRATE_Z,
    PROBE_Z_ACCURACY,
    STANDARD,
    calibrate_plan,
)
from tests.bench.lower_bounds import (
    Limits,
    Plan,
    Stop,
    lower_bound,
    move_seconds,
)
from tests.bench.text import bound_table

ROUNDING = 1e-9

distances = st.floats(0.0, 500.0)
speeds = st.floats(0.1, 500.0)
accels = st.floats(1.0, 20000.0)
factors = st.floats(1.0, 100.0)

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


# A move


@pytest.mark.parametrize(
    "distance, speed, accel, stops, seconds",
    [
        # Trapezoids: distance / speed, and half a ramp's time for each ramp
        (50.0, 50.0, 1000.0, True, 1.05),
        (10.0, 10.0, 100.0, True, 1.1),
        (2.0, 2.0, 100.0, False, 1.01),
        # Triangles: half way up, half way down; all the way up
        (1.0, 10.0, 4.0, True, 1.0),
        (2.0, 10.0, 4.0, False, 1.0),
        # Where both are the same
        (2.0, 2.0, 2.0, True, 2.0),
        (1.0, 2.0, 2.0, False, 1.0),
        (0.0, 10.0, 100.0, True, 0.0),
        (0.0, 10.0, 100.0, False, 0.0),
    ],
)
def test_move_is_calculated_right(distance, speed, accel, stops, seconds):
    found = move_seconds(distance, speed, accel, stops)
    assert found == pytest.approx(seconds)


@given(distances, speeds, accels, st.booleans(), factors)
def test_move_is_never_longer_when_something_is_faster(
    distance, speed, accel, stops, factor
):
    seconds = move_seconds(distance, speed, accel, stops) + ROUNDING
    assert move_seconds(distance, speed * factor, accel, stops) <= seconds
    assert move_seconds(distance, speed, accel * factor, stops) <= seconds
    assert move_seconds(distance / factor, speed, accel, stops) <= seconds
    assert move_seconds(distance, speed, accel, False) <= seconds


@given(distances, distances, speeds, accels)
def test_move_is_never_longer_than_in_two_parts(first, second, speed, accel):
    parts = move_seconds(first, speed, accel) + move_seconds(
        second, speed, accel
    )
    assert move_seconds(first + second, speed, accel) <= parts + ROUNDING


@given(distances, speeds, accels, st.booleans())
def test_move_is_never_faster_than_speed_and_acceleration(
    distance, speed, accel, stops
):
    seconds = move_seconds(distance, speed, accel, stops)
    assert seconds >= distance / speed - ROUNDING
    assert seconds >= math.sqrt(2.0 * distance / accel) - ROUNDING


# The lower bound


def by_part(parts):
    return {(part.site, part.what): part.seconds for part in parts}


def seconds_of(parts):
    return math.fsum(part.seconds for part in parts)


def test_bound_of_one_site():
    parts = by_part(lower_bound(SIMPLE, (0.0, 0.0, 10.0)))
    assert parts == pytest.approx(
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


def test_bound_where_the_head_is_there_already():
    parts = by_part(lower_bound(SIMPLE, (30.0, 40.0, 15.0)))
    assert parts["pin", "lift"] == parts["pin", "travel"] == 0.0
    assert parts["pin", "approach"] == pytest.approx(1.05)  # 5 mm


def test_bound_from_above_has_no_lift():
    parts = by_part(lower_bound(SIMPLE, (0.0, 0.0, 60.0)))
    assert parts["pin", "lift"] == 0.0
    assert parts["pin", "approach"] == pytest.approx(2.05)


def test_next_site_begins_at_the_touch_of_the_last():
    other = PIN._replace(name="bed", x=0.0, trigger_z=18.5)
    plan = SIMPLE._replace(stops=(*SIMPLE.stops, other))
    parts = by_part(lower_bound(plan, (0.0, 0.0, 10.0)))
    assert parts["bed", "lift"] == pytest.approx(1.3)  # 8 to 20
    assert parts["bed", "travel"] == pytest.approx(0.65)  # 30 mm
    assert parts["bed", "approach"] == 0.0  # begins above the travel height
    assert parts["end", "lift"] == pytest.approx(0.25)  # 1.5 mm at 10 mm/s


def test_gcode_of_the_user_counts_once():
    plan = SIMPLE._replace(stops=(PIN, PIN._replace(x=0.0)), prepare=3.5)
    parts = lower_bound(plan, (0.0, 0.0, 10.0))
    assert [p.seconds for p in parts if p.what == "prepare"] == [3.5, 0.0]


def test_slow_acceleration_counts_on_the_way_down_only():
    fast = by_part(lower_bound(SIMPLE, (0.0, 0.0, 10.0)))
    plan = SIMPLE._replace(stops=(PIN._replace(accel=1.0),))
    slow = by_part(lower_bound(plan, (0.0, 0.0, 10.0)))
    assert slow["pin", "samples"] == pytest.approx(4.0)  # twice 2 s, 2 mm
    assert slow["pin", "approach"] > fast["pin", "approach"]
    for what in ("lift", "travel", "retracts"):
        assert slow["pin", what] == fast["pin", what]


def plan_of(command):
    return command.plan(command.scene, command.changes)


def test_plan_of_calibrate_z():
    plan = plan_of(CALIBRATE_Z)
    assert plan.limits == Limits(300.0, 3000.0, 15.0, 350.0)
    assert (plan.end_z, plan.travel_speed, plan.prepare) == (15.0, 50.0, 0.0)
    assert {stop.travel_z for stop in plan.stops} == {15.0}
    assert {stop.approach_speed for stop in plan.stops} == {8.0}
    assert {stop.accel for stop in plan.stops} == {350.0}
    pin, bed = (3, 2.0, 2.0, 10.0), (3, 5.0, 2.0, 10.0)
    assert [stop.name for stop in plan.stops] == ["nozzle", "switch", "bed"]
    assert [stop[1:3] for stop in plan.stops] == [
        (206.0, 306.0),
        (208.0, 281.25),
        (152.0, 125.25),
    ]
    assert [stop[6:10] for stop in plan.stops] == [pin, pin, bed]
    heights = [stop.trigger_z for stop in plan.stops]
    assert heights == pytest.approx([1.6, 8.015, 7.0138])


def test_plan_of_probe_z_accuracy():
    nozzle = plan_of(CALIBRATE_Z).stops[0]
    plan = plan_of(PROBE_Z_ACCURACY)
    assert plan.stops == (nozzle._replace(samples=ACCURACY_SAMPLES),)
    assert plan._replace(stops=()) == plan_of(CALIBRATE_Z)._replace(stops=())


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
    # No option for the speed of travel: the fastest there is
    assert plan.travel_speed == 300.0


def test_bound_of_auto_z_calibrate():
    parts = lower_bound(plan_of(AUTO_Z_CALIBRATE), (102.15, 122.35, 10.0))
    down = [p.seconds for p in parts if p.what == "samples"]
    # Distance / 5 mm/s, and half a ramp at 50 and at 500 mm/s^2
    sensor, later, probe = 1.26426 + 0.05, 1.05, 0.73574 + 0.005
    wanted = [sensor, probe, later, probe, later, probe]
    assert down == pytest.approx(wanted)
    travels = [p.seconds for p in parts if p.what == "travel"]
    # Never at full speed: up and down the ramps
    across = 2.0 * math.sqrt(math.hypot(17.6, 4.4) / 3000.0)
    assert travels == pytest.approx([across] * 6)
    assert not any(p.seconds for p in parts if p.what == "approach")


@given(
    st.sampled_from(
        [
            ("z_calibration", "speed"),
            ("z_calibration", "lift_speed"),
            ("z_calibration", "probing_speed"),
            ("z_calibration", "probing_second_speed"),
            ("probe", "speed"),
            ("probe", "lift_speed"),
            ("printer", "max_velocity"),
            ("printer", "max_accel"),
            ("printer", "max_z_velocity"),
            ("printer", "max_z_accel"),
        ]
    ),
    st.floats(0.5, 400.0),
    factors,
    st.tuples(
        st.floats(0.0, 300.0), st.floats(0.0, 300.0), st.floats(0.0, 100.0)
    ),
)
def test_bound_is_never_longer_when_something_is_faster(
    option, value, factor, start
):
    def bound(number):
        section, name = option
        changed = {**STANDARD.get(section, {}), name: f"{number:.6f}"}
        changes = {**STANDARD, section: changed}
        plan = calibrate_plan(CALIBRATE_Z.scene, changes)
        return seconds_of(lower_bound(plan, start))

    assert bound(value * factor) <= bound(value) + ROUNDING


def test_table_adds_up():
    parts = lower_bound(plan_of(CALIBRATE_Z), (206.0, 306.0, 10.0))
    lines = bound_table(CALIBRATE_Z, parts, (206.0, 306.0, 10.0))
    assert "X206.0 Y306.0 Z10.0" in lines[0]
    rows = {line.split()[0]: line.split()[1:] for line in lines[2:]}
    assert list(rows) == ["nozzle", "switch", "bed", "end", "all"]
    assert rows["all"][-1] == f"{seconds_of(parts):.2f}"
    assert rows["nozzle"][:2] == ["0.00", "0.00"]
    assert sum(float(rows[name][-1]) for name in list(rows)[:-1]) == (
        pytest.approx(seconds_of(parts), abs=0.02)
    )


def test_table_sums_places_that_come_again():
    plan = plan_of(AUTO_Z_CALIBRATE)._replace(prepare=2.0)
    parts = lower_bound(plan, (102.15, 122.35, 10.0))
    lines = bound_table(AUTO_Z_CALIBRATE, parts, (102.15, 122.35, 10.0))
    rows = {line.split()[0]: line.split()[1:] for line in lines[2:]}
    assert list(rows) == ["sensor", "probe", "end", "all"]
    assert "prepare" in lines[1]
    assert rows["all"][-1] == f"{seconds_of(parts):.2f}"
