"""The least time that a measurement can take; mm, s, toolhead Z.

It consists of the moves that no module can do without at the configured
speeds: at each place the way up to the travel height and across (not where the
head is there already), down to where the samples begin, the samples with the
lifts between them, a last lift, and the way to where the toolhead has to stand at
the end. It knows the true heights and accelerations, but nothing of what a host needs to stop, ask or plan.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple, Optional, Union


class Limits(NamedTuple):
    """What the axes can do, mm/s and mm/s^2."""

    velocity: float
    accel: float
    z_velocity: float
    z_accel: float


class Stop(NamedTuple):
    """A place: where the toolhead stands (mm), where it triggers, how often.

    travel_z: height at which the toolhead gets there; from it down to the samples
    at approach_speed, which begin retract above the trigger. accel: in Z in
    the samples (mm/s^2).
    """

    name: str
    x: float
    y: float
    trigger_z: float
    travel_z: float
    approach_speed: float
    samples: int
    speed: float
    retract: float
    lift_speed: float
    accel: float


class Plan(NamedTuple):
    """What a command has to do, in the frame of the configuration.

    end_z: height at the end. prepare: seconds that the user's own G-code takes
    above the first place, before the toolhead goes down. end: where the toolhead has
    to stand at the end (mm), None: over the last place.
    """

    stops: Sequence[Stop]
    end_z: float
    travel_speed: float
    limits: Limits
    prepare: float = 0.0
    end: Optional[tuple[float, float]] = None


class Route(NamedTuple):
    """What a command has to do, wherever it begins: known seconds."""

    seconds: float


def move_seconds(
    distance: float, speed: float, accel: float, stops: bool = True
) -> float:
    """Shortest time of a move from rest, mm and s.

    stops: at rest again at its end; a touch ends at full speed.
    """
    ramps = 2 if stops else 1
    if distance < ramps * speed * speed / (2.0 * accel):
        # Never at full speed
        return ramps * math.sqrt(2.0 * distance / (ramps * accel))
    return distance / speed + ramps * speed / (2.0 * accel)


def lower_bound(
    plan: Union[Plan, Route], start: tuple[float, float, float]
) -> float:
    """Seconds of the moves that no measurement from `start` (mm) can do without."""
    if isinstance(plan, Route):
        return plan.seconds
    seconds = plan.prepare
    for stop in plan.stops:
        seconds += _stop_seconds(plan, stop, start)
        start = (stop.x, stop.y, stop.trigger_z)
    up = max(0.0, plan.end_z - start[2])
    limits, last = plan.limits, plan.stops[-1]
    seconds += z_seconds(limits, up, last.lift_speed, limits.z_accel)
    if plan.end is not None:
        away = math.dist(plan.end, (last.x, last.y))
        speed = min(plan.travel_speed, limits.velocity)
        seconds += move_seconds(away, speed, limits.accel)
    return seconds


def _stop_seconds(
    plan: Plan, stop: Stop, start: tuple[float, float, float]
) -> float:
    limits, (x, y, z) = plan.limits, start
    away = math.hypot(stop.x - x, stop.y - y)
    up = max(0.0, stop.travel_z - z) if away else 0.0
    top = stop.travel_z if away else min(z, stop.travel_z)
    down = max(0.0, top - stop.trigger_z - stop.retract)
    travel_speed = min(plan.travel_speed, limits.velocity)
    touch = z_seconds(limits, stop.retract, stop.speed, stop.accel, False)
    retract = z_seconds(limits, stop.retract, stop.lift_speed, limits.z_accel)
    return (
        z_seconds(limits, up, stop.lift_speed, limits.z_accel)
        + move_seconds(away, travel_speed, limits.accel)
        + z_seconds(limits, down, stop.approach_speed, limits.z_accel)
        + stop.samples * touch
        + (stop.samples - 1) * retract
    )


def z_seconds(
    limits: Limits,
    distance: float,
    speed: float,
    accel: float,
    stops: bool = True,
) -> float:
    """The same in Z, as fast as its limits allow."""
    speed = min(speed, limits.z_velocity)
    return move_seconds(distance, speed, min(accel, limits.z_accel), stops)
