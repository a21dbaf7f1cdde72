# The heights of [extra_probe]: the bed below a switch, and how low a touch may
# go.  Pure functions of numbers; every height is a toolhead Z, in mm.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from ..errors import CalibrationError
from ..host.toolhead import ENDSTOP_OPTION

# Before a calibration was saved nobody knows where the bed is: a touch ends
# this far (mm) below Z=0, where somebody has proved that the switch is there.
UNSAVED_FLOOR = -1.0

# Otherwise, with Z homed on a switch, this far (mm) below where that triggers, and
# below Z=0: no more than that beyond what homing itself does.
PAST_ENDSTOP = 0.1

# A bed this far (mm) from Z=0 was not touched: somebody pressed the switch.
LARGEST_OFFSET = 5.0


# The toolhead Z at which the nozzle meets the bed: the switch that lies between
# them is z_offset thick when it triggers.  Raises CalibrationError for a bed
# that is nowhere near Z=0.
def bed_height(trigger_z, z_offset):
    bed_z = trigger_z - z_offset
    if abs(bed_z) > LARGEST_OFFSET:
        raise CalibrationError(
            "triggered at z=%.3f, so the bed would be over %g mm from Z=0;"
            " begin again if a hand has pressed it, or home Z nearer to the bed"
            " first" % (trigger_z, LARGEST_OFFSET)
        )
    return bed_z


# Whether a bed is lower than a first touch goes: the zero of a new printer may be
# that wrong, but so it looks, too, where z_offset has a decimal point too many.
def is_low(bed_z):
    return bed_z < UNSAVED_FLOOR


# A saved calibration has put the bed at Z=0, give or take half the thickness of
# the switch, unless what Z is homed at was changed since.  'z_zero' is where Z
# gets its zero (axes.ZZero), None if nobody knows; 'moved_by' (mm) is how far Z=0
# is from there by now.
def is_calibrated(settings, z_zero, moved_by=0.0):
    if settings.saved_homing_z is None or z_zero is None:
        return False
    change = abs(settings.saved_homing_z - z_zero.z) + moved_by
    return change < settings.z_offset / 2.0


# The lowest toolhead Z of a touch, but never below the axis: that of the
# command, or of the section, or what is known of the bed.  Half the thickness
# above a bed at Z=0 a switch that lies there has triggered, and the nozzle does
# not reach a bed that is bare.  A bed that nobody knows is looked for no lower than
# homing goes, unless the switch 'is_proved' to be there.
def floor(
    settings,
    z_zero,
    axis_min,
    floor_param=None,
    is_proved=False,
    moved_by=0.0,
):
    if floor_param is not None:
        return max(floor_param, axis_min)
    if settings.position_min is not None:
        return max(settings.position_min, axis_min)
    if is_calibrated(settings, z_zero, moved_by):
        return max(settings.z_offset / 2.0, axis_min)
    is_homed_on_switch = z_zero is not None and z_zero.option == ENDSTOP_OPTION
    if is_homed_on_switch and not is_proved:
        return max(min(z_zero.z, 0.0) - PAST_ENDSTOP, axis_min)
    return max(UNSAVED_FLOOR, axis_min)


# Over the pin of the Z endstop, where a touch ends at 'pin_z' (mm) at the latest;
# None: the head is elsewhere.
def above_pin(floor_z, pin_z):
    return floor_z if pin_z is None else max(floor_z, pin_z)


# Where Z gets its zero once the bed, now at bed_z, is to be at Z=0.  Raises
# CalibrationError for a value outside the axis (low, high), with which klippy
# would not start.
def corrected_zero(z_zero, bed_z, axis_limits):
    corrected = z_zero._replace(z=round(z_zero.z - bed_z, 3))
    low, high = axis_limits
    if not low <= corrected.z <= high:
        raise CalibrationError(
            "%s: %s would be %.3f, outside the %.3f to %.3f of Z; widen"
            " position_min or position_max, or do without SAVE=1"
            % (corrected + (low, high))
        )
    return corrected
