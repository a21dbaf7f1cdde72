# Heights of [auto_z_offset]: the formula, where a trigger is expected, how low
# and how fast a touch may go.  Pure functions.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Every height is a toolhead Z in mm, see z_touch/core/touching.py: the position
# of the head in the frame of the last homing; up is positive.  Between which
# heights a trigger of the bed sensor is believed, and where a touch ends:
#
#     high  ___   above it the sensor was shaken, or something lies on the bed
#            :
#     z     ___   expected: from a saved correction, or from an earlier touch
#            :
#     low   ___   a sensor that is later than this is dead: the floor,
#                 unless the head needs more room to brake

import collections
import math

from .. import pin as z_pin
from ..errors import CalibrationError
from ..in_force import LARGEST_STEP, NO_STEP
from ..sampling import summarize

# No touch goes lower (mm), whatever is configured.
LOWEST_FLOOR = -10.0

# Where Z is homed on a switch near the bed, the first touch looks so far (mm) below
# where that triggers, and below Z=0, unless probe_z_min says otherwise: a pin is
# rarely higher above the bed than 2 mm, and nobody prints on a Z=0 that is 1 mm off.
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

# A probe that hangs below the nozzle is pressed so far (mm) beyond where it should
# trigger, at most: then it is dead.
DEAD_PROBE = 5.0

# An air gap or a correction beyond this (mm) is none.
LARGEST_OFFSET = 10.0

# What an error that rests on an expected height ends with
IF_CHANGED = "ACCEPT_CHANGE=1 if nozzle, probe or bed was changed"


######################################################################
# The result
######################################################################

# The parts and the outcome of one measurement (mm); see the door.
Result = collections.namedtuple(
    "Result", "sensor probe probe_z_offset z_offset correction"
)


# Toolhead Z (mm) of G-code Z=0 where the probe says that the bed is at 0: the
# sensor says where the bed is, the part in brackets where the probe sees it.
def correction(sensor, probe, probe_z_offset, z_offset):
    return sensor - (probe - probe_z_offset) + z_offset


# Raises CalibrationError for one that no printer has.
def check_correction(z):
    if abs(z) > LARGEST_OFFSET:
        raise CalibrationError(
            "a correction of %.3f mm is none, %g mm is the limit; check"
            " z_offset, and home Z again (G28)" % (z, LARGEST_OFFSET)
        )


# Of the corrections of all cycles those that no outlier is among: none farther
# (mm) from their median than 'tolerance'.  An outlier is not averaged; without
# one these are all.  Where none is so near, such as with two that differ, there
# is nothing to tell the outlier by, and all count.
def without_outliers(corrections, tolerance):
    median = summarize(corrections, "median")
    agreeing = [z for z in corrections if abs(z - median) <= tolerance]
    return agreeing or corrections


######################################################################
# Expected heights
######################################################################

# Where the sensor should trigger: toolhead Z (mm, None: no idea), and between
# which heights a trigger is believed.
Expected = collections.namedtuple("Expected", "z low high")

NOTHING_EXPECTED = Expected(None, float("-inf"), float("inf"))


def expect_near(z, margin):
    return Expected(z, z - margin, z + margin)


# All that is certain where nothing was saved or touched: the probe triggers
# above the bed.
def expect_below_probe(probe_z):
    return NOTHING_EXPECTED._replace(high=probe_z + ABOVE_PROBE)


# For the next touch at the same site, after one at z; 'lowest_z' is the lowest
# trigger there before, None if there is none.  The lowest counts: what triggers
# higher up was shaken.
def expect_again(z, lowest_z, sampling):
    if lowest_z is not None:
        z = min(z, lowest_z)
    return expect_near(z, TOUCH_MARGIN + sampling.tolerance)


# Raises CalibrationError for a trigger that is too high to be the bed.
def check_expected(z, expected):
    if z <= expected.high:
        return
    where = "which is above z=%.3f, the highest that the probe leaves for it"
    where %= (expected.high,)
    if expected.z is not None:
        where = "%.3f mm above the expected z=%.3f"
        where %= (z - expected.z, expected.z)
    raise CalibrationError(
        "triggered at z=%.3f, %s; clean the nozzle and the bed, look"
        " at prepare_gcode and probe_accel, or add %s" % (z, where, IF_CHANGED)
    )


######################################################################
# Floors and speeds
######################################################################

# Lowest toolhead Z (mm) of a touch, who says so, and what to do where it is wrong.
Floor = collections.namedtuple("Floor", "z why remedy")


# The floor of the section.  probe_z_min (None: not given) can only raise what
# the axis allows.
def section_floor(z_axis, probe_z_min):
    floor = Floor(
        z_axis.position_min,
        "position_min of section '%s'" % (z_axis.section,),
        "",
    )
    if floor.z < LOWEST_FLOOR:
        floor = Floor(LOWEST_FLOOR, "the limit of auto_z_offset", "")
    if probe_z_min is None:
        return above_switch(floor, z_axis)
    return (
        Floor(probe_z_min, "probe_z_min", "")
        if probe_z_min >= floor.z
        else floor
    )


# A Floor, higher where the switch that homes Z has told about how high the bed is
def above_switch(floor, z_axis):
    switch_z = z_pin.low_switch(z_axis)
    if switch_z is None:
        return floor
    z = min(switch_z, 0.0) - BELOW_SWITCH
    if z <= floor.z:
        return floor
    return Floor(
        z,
        "%g mm below where Z is homed, and below Z=0" % (BELOW_SWITCH,),
        "set probe_z_min if the bed may be lower",
    )


# A Floor, higher where the head is over the pin of the Z endstop: a touch ends at
# 'pin_z' (mm) at the latest.  None: the head is elsewhere.
def above_pin(floor, pin_z):
    if pin_z is None or pin_z <= floor.z:
        return floor
    return Floor(
        pin_z,
        "as far as the pin of the Z endstop may be pressed, as the head is over it",
        "choose a point of the bed",
    )


# The speed (mm/s) from which the head can stop within EXPECTED_MARGIN: a touch
# must not need more room below the bed than that.  v^2 = 2 a s.
def fastest_touch(speed, accel):
    room = EXPECTED_MARGIN - BRAKING_RESERVE
    return min(speed, math.sqrt(2.0 * accel * room))


# How far (mm) above its trigger a touch begins: the head has its speed (mm/s)
# after half of that at the latest, as a sensor is later the faster it is touched.
def approach(speed, accel):
    return max(APPROACH, speed * speed / accel)


# The head needs room (mm) to stop at the floor: where the trigger is expected
# it has its full speed still, as in every other touch.
def sensor_floor(floor, expected, speed, accel):
    if expected.z is None:
        return floor
    braking = speed * speed / (2.0 * accel)
    low = min(expected.low, expected.z - braking - BRAKING_RESERVE)
    if low <= floor.z:
        return floor
    why = "%.3f mm below the expected trigger at z=%.3f"
    return Floor(low, why % (expected.z - low, expected.z), "add " + IF_CHANGED)


# The lowest toolhead Z (mm) of a touch with the probe, where the nozzle meets the bed
# at 'sensor_z': there or, with a probe that hangs lower, above it.
def probe_floor(sensor_z, probe_z_offset):
    why = "where the bed sensor triggered"
    if probe_z_offset <= DEAD_PROBE:
        return Floor(sensor_z, why, "")
    why = "%g mm below where the probe should trigger" % (DEAD_PROBE,)
    return Floor(sensor_z + probe_z_offset - DEAD_PROBE, why, "")


# Travel height (mm) before the bed was touched: where the probe does not
# trigger, wherever it says that the bed is.
def travel_height(probe_z, probe_hop):
    return max(probe_z, 0.0) + probe_hop


######################################################################
# A nozzle inside the bed
######################################################################


# What a z_offset below zero means, in plain words; empty: it is not.
def inside_bed(z_offset):
    if z_offset >= 0.0:
        return ""
    return (
        "z_offset %.3f: at Z=0 the nozzle is %.3f mm inside the bed, below"
        " where the bed sensor triggers; for an air gap write it without the"
        " minus sign" % (z_offset, -z_offset)
    )


# What a z_offset above zero means where the trigger itself became z_offset
# (AUTO_Z_HOME_Z); empty: it is not.
def inside_bed_after_homing(z_offset):
    if z_offset <= 0.0:
        return ""
    return (
        "Z is %.3f where the bed sensor triggers: at Z=0 the nozzle is %.3f mm"
        " inside the bed; home with G28 and use AUTO_Z_LOAD_OFFSET to print"
        % (z_offset, z_offset)
    )


# Whether that (mm) may be the first correction.  Once it is saved, touches are
# expected there.  Raises CalibrationError.
def check_first(correction):
    if abs(correction) <= NO_STEP:
        raise CalibrationError(
            "the G-code Z offset holds no correction, and none was saved before:"
            " nothing was measured yet; run AUTO_Z_CALIBRATE, or add FORCE=1 if 0"
            " is right"
        )


# Whether a G-code offset (mm) is that of the correction and baby steps; 'base': what
# has applied the correction has left there.  Raises CalibrationError.
def check_steps(offset, base):
    change = offset - base
    if not offset and abs(change) > NO_STEP:
        raise CalibrationError(
            "the G-code Z offset is 0, not the %.3f of the correction: it was reset,"
            " or not loaded; run AUTO_Z_LOAD_OFFSET and set the steps again, or"
            " add FORCE=1 if 0 is right" % (base,)
        )
    if abs(change) > LARGEST_STEP:
        raise CalibrationError(
            "the G-code Z offset is %.3f, with the correction it was %.3f: a change"
            " of more than %g mm is none of baby steps; run AUTO_Z_LOAD_OFFSET and"
            " set the steps again, or add FORCE=1"
            % (offset, base, LARGEST_STEP)
        )
