"""Heights of [auto_z_offset]: formula, expected triggers, floors and speeds.

Pure functions.  Every height is a toolhead Z in mm, see z_touch/touch.py: the position of
the toolhead in the frame of the last homing; up is positive.  Between which heights a
trigger of the bed sensor is believed, and where a touch ends:

    high  ___   above it the sensor was shaken, or something lies on the bed
           :
    z     ___   expected: from a saved correction, or from an earlier touch
           :
    low   ___   a sensor that is later than this is dead: the floor,
                unless the toolhead needs more room to brake

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple, Optional, Sequence

from .. import pin as z_pin
from ..errors import CalibrationError, TouchedWrong
from ..in_force import LARGEST_STEP, NO_STEP
from ..sampling import Sampling, summarize

if TYPE_CHECKING:
    from ..host.toolhead import ZAxis

# No touch goes lower (mm), whatever is configured.
LOWEST_FLOOR = -10.0

# Where Z is homed on a switch near the bed, the first touch looks so far (mm) below
# where that triggers, and below Z=0, unless probe_z_min says otherwise: a pin is
# rarely higher above the bed than 2 mm, and no print succeeds on a Z=0 that is 1 mm off.
BELOW_SWITCH = 2.0

# How far (mm) below the expected height a touch may still look, and how far
# above it a trigger is believed.  Expected from a saved correction, or from a
# touch anywhere since Z was homed; and, beyond samples_tolerance, from the
# touch before at the same site: a sensor that is later than this is dead.
EXPECTED_MARGIN = 1.0
TOUCH_MARGIN = 0.3

# A sensor is later the faster it is touched; so none is touched braking, also
# when it triggers this much (mm) lower than expected.
BRAKING_RESERVE = 0.1

# So far (mm) above a trigger whose height is known a touch begins, after a quick
# way down: more than noise, heat and the slope of a bed, and no more than hosts
# lift a probe between two samples.
APPROACH = 2.0

# A trigger of the bed sensor this far (mm) above the probe's is not the bed.
ABOVE_PROBE = 0.5

# A probe that is longer than the nozzle is pressed so far (mm) beyond where it should
# trigger, at most: then it is dead.
DEAD_PROBE = 5.0

# The toolhead travels so far (mm) above where the probe triggers, at least: more than the
# hysteresis of an inductive one.
ABOVE_TRIGGER = 1.0

# An air gap or a correction beyond this (mm) is none.
LARGEST_OFFSET = 10.0

# What an error that rests on an expected height ends with
IF_CHANGED = "ACCEPT_CHANGE=1 if nozzle, probe or bed was changed"


######################################################################
# The result
######################################################################


class Result(NamedTuple):
    """The parts and the outcome of one measurement (mm); see the door."""

    sensor: float
    probe: float
    probe_z_offset: float
    z_offset: float
    correction: float


def correction(
    sensor: float, probe: float, probe_z_offset: float, z_offset: float
) -> float:
    """Return the correction: toolhead Z of G-code Z=0 where the probe sees the bed at 0 (mm).

    The sensor says where the bed is, the part in brackets where the probe sees it.
    """
    return sensor - (probe - probe_z_offset) + z_offset


def result_of(
    sensor: float, probe: float, probe_z_offset: float, z_offset: float
) -> Result:
    """Return the result of the heights of sensor and probe, and of both z_offsets (mm)."""
    z = correction(sensor, probe, probe_z_offset, z_offset)
    return Result(sensor, probe, probe_z_offset, z_offset, z)


def check_correction(z: float) -> None:
    """Raise CalibrationError for a correction (mm) that no printer has."""
    if abs(z) > LARGEST_OFFSET:
        raise CalibrationError(
            f"a correction of {z:.3f} mm is none, {LARGEST_OFFSET:g} mm is the limit;"
            " check z_offset, and home Z again (G28)"
        )


def without_outliers(
    corrections: Sequence[float], tolerance: float
) -> Sequence[float]:
    """Return the corrections of all cycles (mm) that no outlier is among.

    None is farther from their median than 'tolerance'.  An outlier is not averaged;
    without one these are all.  Where none is so near, such as with two that differ, there
    is nothing to tell the outlier by, and all count.
    """
    median = summarize(corrections, "median")
    agreeing = [z for z in corrections if abs(z - median) <= tolerance]
    return agreeing or corrections


######################################################################
# Expected heights
######################################################################


class Expected(NamedTuple):
    """Where the sensor should trigger (toolhead Z, mm), and where that is believed.

    z None: it is not known.
    """

    z: Optional[float]
    low: float
    high: float


NOTHING_EXPECTED = Expected(None, float("-inf"), float("inf"))


def expect_near(z: float, margin: float) -> Expected:
    """Return that a trigger is expected at z, within a margin (mm)."""
    return Expected(z, z - margin, z + margin)


def expect_below_probe(probe_z: float) -> Expected:
    """Return all that is certain where nothing was saved or touched.

    The probe triggers above the bed, at probe_z (mm).
    """
    return NOTHING_EXPECTED._replace(high=probe_z + ABOVE_PROBE)


def expect_again(
    z: float, lowest_z: Optional[float], sampling: Sampling
) -> Expected:
    """Return what is expected of the next touch at the same site, after one at z (mm).

    'lowest_z' is the lowest trigger there before, None: there is none.  The lowest counts:
    what triggers higher up was shaken.
    """
    if lowest_z is not None:
        z = min(z, lowest_z)
    return expect_near(z, TOUCH_MARGIN + sampling.tolerance)


def check_expected(z: float, expected: Expected) -> None:
    """Raise TouchedWrong for a trigger (mm) that is too high to be the bed."""
    if z <= expected.high:
        return
    where = f"which is above z={expected.high:.3f}, the highest that the probe leaves for it"
    if expected.z is not None:
        where = f"{z - expected.z:.3f} mm above the expected z={expected.z:.3f}"
    raise TouchedWrong(
        f"triggered at z={z:.3f}, {where}; clean the nozzle and the bed, look"
        f" at prepare_gcode and probe_accel, or add {IF_CHANGED}"
    )


######################################################################
# Floors and speeds
######################################################################


class Floor(NamedTuple):
    """The lowest toolhead Z (mm) of a touch, who says so, and what to do if it is wrong."""

    z: float
    why: str
    remedy: str


def section_floor(z_axis: ZAxis, probe_z_min: Optional[float]) -> Floor:
    """Return the floor of the section.

    probe_z_min (mm, None: not given) can only raise what the axis allows.
    """
    floor = Floor(
        z_axis.position_min, f"position_min of section '{z_axis.section}'", ""
    )
    if floor.z < LOWEST_FLOOR:
        floor = Floor(LOWEST_FLOOR, "the limit of auto_z_offset", "")
    if probe_z_min is None:
        return above_switch(floor, z_axis)
    if probe_z_min >= floor.z:
        return Floor(probe_z_min, "probe_z_min", "")
    return floor


def above_switch(floor: Floor, z_axis: ZAxis) -> Floor:
    """Return a floor, higher where the switch that homes Z tells about how high the bed is."""
    switch_z = z_pin.low_switch(z_axis)
    if switch_z is None:
        return floor
    z = min(switch_z, 0.0) - BELOW_SWITCH
    if z <= floor.z:
        return floor
    return Floor(
        z,
        f"{BELOW_SWITCH:g} mm below where Z is homed, and below Z=0",
        "set probe_z_min if the bed may be lower",
    )


def above_pin(floor: Floor, pin_z: Optional[float]) -> Floor:
    """Return a floor, higher where the toolhead is over the pin of the Z endstop.

    A touch ends at pin_z (mm) at the latest; None: the toolhead is elsewhere.
    """
    if pin_z is None or pin_z <= floor.z:
        return floor
    return Floor(
        pin_z,
        "as far as the pin of the Z endstop may be pressed, as the toolhead is over it",
        "choose a point of the bed",
    )


def fastest_touch(speed: float, accel: float) -> float:
    """Return the speed (mm/s) from which the toolhead can stop within EXPECTED_MARGIN.

    A touch must not need more room below the bed than that: v^2 = 2 a s.
    """
    room = EXPECTED_MARGIN - BRAKING_RESERVE
    return min(speed, math.sqrt(2.0 * accel * room))


def approach(speed: float, accel: float) -> float:
    """Return how far (mm) above its trigger a touch begins.

    The toolhead has its speed (mm/s) after half of that at the latest, as a sensor is later
    the faster it is touched.
    """
    return max(APPROACH, speed * speed / accel)


def sensor_floor(
    floor: Floor, expected: Expected, speed: float, accel: float
) -> Floor:
    """Return the floor of a touch of the bed sensor (mm/s, mm/s^2).

    The toolhead needs room to stop at it: where the trigger is expected it has its full
    speed still, as in every other touch.
    """
    if expected.z is None:
        return floor
    braking = speed * speed / (2.0 * accel)
    low = min(expected.low, expected.z - braking - BRAKING_RESERVE)
    if low <= floor.z:
        return floor
    return Floor(
        low,
        f"{expected.z - low:.3f} mm below the expected trigger at z={expected.z:.3f}",
        f"add {IF_CHANGED}",
    )


def probe_floor(sensor_z: float, probe_z_offset: float) -> Floor:
    """Return the floor of a touch with the probe, where the nozzle meets the bed at sensor_z.

    That is there or, with a probe that is longer than DEAD_PROBE, above it.
    """
    why = "where the bed sensor triggered"
    if probe_z_offset <= DEAD_PROBE:
        return Floor(sensor_z, why, "")
    why = f"{DEAD_PROBE:g} mm below where the probe should trigger"
    return Floor(sensor_z + probe_z_offset - DEAD_PROBE, why, "")


def hop(probe_hop: float, probe_z_offset: float) -> float:
    """Return how far (mm) above the bed the toolhead travels.

    As far as probe_hop says, or so far that the probe does not trigger.
    """
    return max(probe_hop, probe_z_offset + ABOVE_TRIGGER)


def travel_height(probe_z: float, probe_hop: float) -> float:
    """Return the travel height (mm) before the bed was touched.

    There the probe, which triggers at probe_z, does not trigger, wherever it says that the
    bed is.
    """
    return max(probe_z, 0.0) + probe_hop


######################################################################
# A nozzle inside the bed
######################################################################


def inside_bed(z_offset: float) -> str:
    """Return what a z_offset (mm) below zero means, in plain words; empty: it is not."""
    if z_offset >= 0.0:
        return ""
    return (
        f"z_offset {z_offset:.3f}: at Z=0 the nozzle is {-z_offset:.3f} mm inside the"
        " bed, below where the bed sensor triggers; for an air gap write it without the"
        " minus sign"
    )


def inside_bed_after_homing(z_offset: float) -> str:
    """Return what a z_offset (mm) above zero means after AUTO_Z_HOME_Z; empty: it is not.

    There the trigger itself has become z_offset.
    """
    if z_offset <= 0.0:
        return ""
    return (
        f"Z is {z_offset:.3f} where the bed sensor triggers: at Z=0 the nozzle is"
        f" {z_offset:.3f} mm inside the bed; home with G28 and use AUTO_Z_LOAD_OFFSET to"
        " print"
    )


######################################################################
# Baby steps
######################################################################


def check_first(correction: float) -> None:
    """Raise CalibrationError where that (mm) cannot be the first correction.

    Once it is saved, touches are expected there.
    """
    if abs(correction) <= NO_STEP:
        raise CalibrationError(
            "the G-code Z offset holds no correction, and none was saved before:"
            " nothing was measured yet; run AUTO_Z_CALIBRATE, or add FORCE=1 if 0"
            " is right"
        )


def check_steps(offset: float, base: float) -> None:
    """Raise CalibrationError unless an offset (mm) is that of the correction and baby steps.

    'base' is what has applied the correction has left there.
    """
    change = offset - base
    if not offset and abs(change) > NO_STEP:
        raise CalibrationError(
            f"the G-code Z offset is 0, not the {base:.3f} of the correction: it was"
            " reset, or not loaded; run AUTO_Z_LOAD_OFFSET and set the steps again, or"
            " add FORCE=1 if 0 is right"
        )
    if abs(change) > LARGEST_STEP:
        raise CalibrationError(
            f"the G-code Z offset is {offset:.3f}, with the correction it was"
            f" {base:.3f}: a change of more than {LARGEST_STEP:g} mm is none of baby"
            " steps; run AUTO_Z_LOAD_OFFSET and set the steps again, or add FORCE=1"
        )
