# Heights of a Z calibration: the formula, what is expected, floors, travel
# heights.  Pure functions.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Every height is a toolhead Z in mm, see z_touch/core/touching.py: the position
# of the head in the frame of the last homing, up is positive.  With the probe on
# the head, three things lie below the nozzle:
#
#        \_/        ___ nozzle_z      where the nozzle presses the pin
#         :
#       [ s ]       ___ body          switch - nozzle: the body of the switch
#         I         ___ trigger       + switch_offset: where its plunger triggers
#         I         ___ free plunger  + FREE_PLUNGER: where the free plunger ends
#
# 'settings' is the record of settings.py, completed; 'last' the Result of the
# last good run, None where there is none.

import collections

from ..core import z_pin
from ..core.errors import CalibrationError

# The switch body hangs at least this far (mm) below the nozzle tip: a probe
# with less could not reach the bed before the nozzle does.
BODY_BELOW_NOZZLE = 1.0

# A smaller z_offset (mm) of the probe cannot have been measured on a switch.
SMALLEST_Z_OFFSET = 2.0

# What a probe that was never measured may hang below the nozzle (mm), where
# its z_offset is no better.  Common ones hang 5 to 9 mm; long ones need a
# z_offset or a safe_z_height that is right.
UNMEASURED_PROBE = 10.0

# The free plunger hangs this much (mm) lower than the point at which it
# triggers; no micro switch has a longer pretravel.
FREE_PLUNGER = 1.0

# Plates of one printer differ in thickness by less than this (mm), so its bed is found
# so near to where the last good run has found it, seen from the pin.
BED_VARIES = 2.0

# A nozzle that meets its pin this much (mm) higher than where Z was homed on that pin
# does not meet it itself: something hangs below it.  Tools differ by less in length.
HANGS_BELOW = 3.0

# So far (mm) below position_endstop a touch has to be able to go at least: homing
# again moves the trigger by some microsteps.
LEAST_ROOM = 0.05

# What to do about a frame that may be outdated
HOME_AGAIN = "home Z again (G28 Z) after any levelling"

# Heights (mm) that differ by less are the same.
ROUNDING = 0.0000001

# Travel height (mm) where twice the probe's z_offset is no real height.
SMALLEST_SAFE_Z = 3.0
FALLBACK_SAFE_Z = 20.0

######################################################################
# The result
######################################################################

# The parts and the outcome of one calibration (mm): toolhead Z of the three
# triggers, the switch_offset that was reckoned with, and the G-code Z offset.
Result = collections.namedtuple(
    "Result", "probe switch nozzle switch_offset offset"
)


# The G-code Z offset (mm): toolhead Z where the nozzle meets the bed.  The part
# in brackets is how far the probe triggers below the nozzle, see the door.
def offset(probe, switch, nozzle, switch_offset):
    return probe - (switch - nozzle + switch_offset)


# So far (mm) a probe may hang below the nozzle, with 'more' for what it is not sure of
def may_hang(z_offset, more):
    is_measured = z_offset >= SMALLEST_Z_OFFSET
    return (z_offset if is_measured else UNMEASURED_PROBE) + more


# Raises CalibrationError for an offset outside of margins (low, high).  'zero' is
# where Z gets its zero (axes.ZZero), None: nobody knows.
def check_offset(result, margins, zero):
    low, high = margins
    if low <= result.offset <= high:
        return
    text = (
        "offset %.3f is outside offset_margins %.3f to %.3f"
        " (probe=%.3f switch=%.3f nozzle=%.3f); "
        + HOME_AGAIN
        + ", then check the three positions and %s"
    )
    right = corrected_zero(zero, result.offset)
    values = (result.offset, low, high) + result[:3] + (right,)
    raise CalibrationError(text % values)


# What would make the offset (mm) 0, in words.  A bed that is lower than expected gets
# no number: that would bring the nozzle closer to it, and without plate or probe the
# bed only seems to be so low.
def corrected_zero(zero, z_offset):
    if zero is None:
        return "position_endstop"
    if z_offset < 0.0:
        return "%s of section '%s'" % (zero.option, zero.section)
    text = "%s of section '%s' (%.3f - %.3f: try %.3f)"
    values = zero.option, zero.section, zero.z, z_offset, zero.z - z_offset
    return text % values


######################################################################
# Expected heights
######################################################################

# Where a touch should trigger: toolhead Z (mm), or None where nobody knows.


# The nozzle meets the Z endstop where Z was homed, or, more exactly, where it
# did in the last run, as long as the frame is still the one of that run
# ('holds').  A pin of its own is only known from the last run.
def expect_nozzle(settings, last, holds):
    if last is None or not (holds or settings.position_endstop is None):
        return settings.position_endstop
    return last.nozzle


# The body hangs below the nozzle as in the last run; before the first one as
# far as z_offset of the probe says, if that was ever measured.
def expect_switch(settings, nozzle_z, last):
    if last is not None:
        return nozzle_z + last.switch - last.nozzle
    if settings.z_offset < SMALLEST_Z_OFFSET:
        return None
    return nozzle_z + settings.z_offset - settings.switch_offset


# The bed is where the last run had it; before the first one at an offset of 0.
def expect_bed(settings, nozzle_z, switch_z, last):
    gap = switch_z - nozzle_z + settings.switch_offset
    return gap + (last.offset if last is not None else 0.0)


######################################################################
# Floors
######################################################################

# The lowest toolhead Z (mm) of each touch.  None goes lower than a usable result can
# lie, nor below position_min: a lost probe or a dead switch then ends with the
# nozzle in the air.


# The nozzle meets the Z endstop where Z was homed: what the *result* may be has no say
# in it.  Nobody knows how high a pin of its own is until it was touched.
def nozzle_floor(settings, expected_z):
    homed_z = settings.position_endstop
    if homed_z is None:
        homed_z = expected_z
    if homed_z is None:
        return settings.position_min
    return max(settings.position_min, homed_z - settings.travel_margin)


# What the offset can be (low, high; mm): as offset_margins say, and, once a run was
# good ('kept', None: none was), so near to the bed of that run as plates differ.
def possible_offsets(settings, nozzle_z, kept):
    low, high = settings.offset_margins
    if kept is None:
        return low, high
    before = nozzle_z + kept.bed
    return max(low, before - BED_VARIES), min(high, before + BED_VARIES)


# The heights of a good run as they hold for later ones (mm): switch - nozzle of its
# probe, and how high the bed is above where the nozzle meets the pin.
Kept = collections.namedtuple("Kept", "body bed")


# From toolhead Z of the three sites and the switch_offset (mm) of that run
def kept_of(nozzle, switch, bed, switch_offset):
    z_offset = offset(bed, switch, nozzle, switch_offset)
    return Kept(switch - nozzle, z_offset - nozzle)


# Over what the bed mesh covers no pin is lower than the bed, which meets the nozzle
# where the offset is.  'point': X and Y (mm) of what touches, None: nobody knows;
# 'below': how far (mm) it hangs below the nozzle.
def floor_over(settings, floor, point, below=0.0):
    area = settings.mesh_area
    if None in (area, point) or not z_pin.is_over(point, area):
        return floor
    return max(floor, settings.offset_margins[0] + below)


# How far (mm) the body hangs below the nozzle, at least
def least_body(settings):
    if settings.z_offset < SMALLEST_Z_OFFSET:
        return BODY_BELOW_NOZZLE
    return settings.z_offset - settings.switch_offset


# The body hangs below the nozzle, in any case; where a trigger is expected,
# the touch ends travel_margin below it.  The probe's z_offset would be tighter, but
# many configurations hold a value there that was never measured.
# 'kept' as in possible_offsets()
def switch_floor(settings, nozzle_z, expected_z, kept=None):
    floor = max(settings.position_min, nozzle_z + BODY_BELOW_NOZZLE)
    if kept is not None:
        floor = max(floor, nozzle_z + kept.body - BED_VARIES)
    if expected_z is None:
        return floor
    return max(floor, expected_z - settings.travel_margin)


# A bed that is lower than this would give an offset that cannot be.
def bed_floor(settings, nozzle_z, switch_z, kept=None):
    gap = switch_z - nozzle_z + settings.switch_offset
    low, _ = possible_offsets(settings, nozzle_z, kept)
    return max(settings.position_min, gap + low)


# What to do where nothing triggered down to that floor, 'lowest': the offset (mm) there;
# 'zero' as in check_offset(), 'site' the touched one.  Empty: with such margins the bed
# is not known to be low.
def below_margins(settings, lowest, zero, site):
    low = settings.offset_margins[0]
    check = (
        "check that the plate is on, the probe (QUERY_PROBE) and %s, and that Z was"
        " homed (G28 Z) after any levelling" % (site.place(),)
    )
    if lowest > low:
        return (
            "the last good run has found the bed %g mm higher; %s; if pin or bed is"
            " elsewhere now, run CALIBRATE_Z ACCEPT_CHANGE=1"
            % (BED_VARIES, check)
        )
    if low >= 0.0:
        return ""
    # Whoever is led through the set-up has not chosen it
    end = "the low end of offset_margins (%.3f)" if site.option else "z=%.3f"
    text = "the bed is below %s, or the probe is dead; %s; only then correct %s"
    return text % (end % (low,), check, corrected_zero(zero, low))


# Why a touch without a trigger has ended where it did, if that was position_min of
# 'section'; 'expected_z': where it was expected (toolhead Z, mm; None: nobody knew).
# Empty: it could go as far down as it may.
def ended_by_position_min(settings, section, floor, expected_z):
    position_min = settings.position_min
    if floor > position_min + ROUNDING:
        return ""
    is_low = (
        expected_z is None
        or expected_z - settings.travel_margin <= position_min - ROUNDING
    )
    if not is_low:
        return ""
    return "position_min (%.3f) of section '%s'" % (position_min, section)


# Where the bed may be looked for with a probe of unknown length: the nozzle
# meets it below the upper margin.  Where levelling has lifted the bed, it has
# lifted the pin of the Z endstop with it.
def unmeasured_bed_floor(settings, nozzle_z):
    floor = settings.offset_margins[1] + BODY_BELOW_NOZZLE
    if settings.position_endstop is not None:
        floor += max(0.0, nozzle_z - settings.position_endstop)
    return max(settings.position_min, floor)


# The lowest height of the body on the pin if the probe triggered on the bed
# at bed_z: the offset can be no larger than that.
def lowest_switch(settings, nozzle_z, bed_z, kept=None):
    gap = bed_z - possible_offsets(settings, nozzle_z, kept)[1]
    return nozzle_z + gap - settings.switch_offset


######################################################################
# Travel heights
######################################################################

# Toolhead Z (mm) at which the head moves in X and Y.  A minimum where the user
# or z_offset has it; never above the end of the axis.


# safe_z_height where it is left out: twice the probe's z_offset, if that is a
# real height.
def default_safe_z(probe_z_offset):
    safe_z = 2.0 * probe_z_offset
    return safe_z if safe_z >= SMALLEST_SAFE_Z else FALLBACK_SAFE_Z


# Above a pin at pin_z (None: nobody knows) and above the bed, which lies at
# about 0, with a probe whose body hangs 'body' (mm, None: nobody knows) below
# the nozzle.
def travel_height(settings, pin_z, body):
    if pin_z is None:
        pin_z = settings.unmeasured_pin
    hangs = max(settings.z_offset, UNMEASURED_PROBE)
    if body is not None:
        hangs = body + settings.switch_offset + FREE_PLUNGER
    clear = max(pin_z, 0.0) + hangs + settings.travel_margin
    return at_least(settings, clear, pin_z)


# Above the pin and above the bed, which may lie as high as the upper margin
# lets it, with a probe that was measured.
def travel_height_to_bed(settings, nozzle_z, switch_z):
    gap = switch_z - nozzle_z + settings.switch_offset
    highest = max(nozzle_z, settings.offset_margins[1])
    clear = highest + gap + FREE_PLUNGER + settings.travel_margin
    return at_least(settings, clear, switch_z)


# 'clear', or as high as the owner wants it after a touch at trigger_z
def at_least(settings, clear, trigger_z):
    wanted = max(settings.safe_z_height, trigger_z + settings.clearance)
    return min(max(clear, wanted), settings.position_max)
