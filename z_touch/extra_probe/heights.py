"""The bed below a switch, and how low a touch may go: pure functions of numbers.

Every height is a toolhead Z, in mm and in the frame that the last homing defined; up is
positive.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Optional, Tuple

from ..errors import CalibrationError
from ..host.toolhead import ENDSTOP_OPTION

if TYPE_CHECKING:
    from ..host.toolhead import ZZero
    from .settings import Settings

# Before a calibration was saved it is not known where the bed is: a touch ends this far
# (mm) below Z=0, where a person has proved that the switch is there.
UNSAVED_FLOOR = -1.0

# Otherwise, with Z homed on a switch, this far (mm) below where that triggers, and
# below Z=0: no more than that beyond what homing itself does.
PAST_ENDSTOP = 0.1

# A switch that stays where it is says that the bed is so near to where Z is homed (mm), and
# is pressed no further than that below where it should trigger.
NEAR_ZERO = 1.0

# A bed this far (mm) from Z=0 was not touched: a hand has pressed the switch.
LARGEST_OFFSET = 5.0


def bed_height(trigger_z: float, z_offset: float) -> float:
    """Return the toolhead Z at which the nozzle meets the bed.

    The switch that lies between them is z_offset (mm) thick when it triggers.  Raises
    CalibrationError for a bed that is nowhere near Z=0.
    """
    bed_z = trigger_z - z_offset
    if abs(bed_z) > LARGEST_OFFSET:
        raise CalibrationError(
            f"triggered at z={trigger_z:.3f}, so the bed would be over"
            f" {LARGEST_OFFSET:g} mm from Z=0; begin again if a hand has pressed it, or"
            " home Z nearer to the bed first"
        )
    return bed_z


def bed_below_fixed(trigger_z: float, switch_height: float) -> float:
    """Return the toolhead Z at which the nozzle meets the bed.

    A switch that stays where it is triggers switch_height (mm) above the bed.  Raises
    CalibrationError for a bed that is not near Z=0.
    """
    bed_z = trigger_z - switch_height
    if abs(bed_z) > NEAR_ZERO:
        raise CalibrationError(
            f"the switch triggered at z={trigger_z:.3f}, switch_height is"
            f" {switch_height:.3f}, so"
            f" the bed would be at z={bed_z:.3f}, over {NEAR_ZERO:g} mm from Z=0; check"
            " switch_height, that nothing lies on the switch, and that G28 homes Z on the bed"
        )
    return bed_z


def is_low(bed_z: float) -> bool:
    """Return whether a bed is lower than a first touch goes.

    The zero of a new printer may be that wrong, but so it looks, too, where z_offset has its
    decimal point in the wrong place.
    """
    return bed_z < UNSAVED_FLOOR


def is_calibrated(
    settings: Settings, z_zero: Optional[ZZero], moved_by: float = 0.0
) -> bool:
    """Return whether a saved calibration still says where the bed is.

    It has put the bed at Z=0, give or take half the thickness of the switch, unless what Z
    is homed at was changed since.  z_zero is where Z gets its zero, None: not known;
    moved_by (mm) how far Z=0 is from there by now.
    """
    if settings.saved_homing_z is None or z_zero is None:
        return False
    change = abs(settings.saved_homing_z - z_zero.z) + moved_by
    return change < settings.z_offset / 2.0


def floor(
    settings: Settings,
    z_zero: Optional[ZZero],
    axis_min: float,
    floor_param: Optional[float] = None,
    is_proved: bool = False,
    moved_by: float = 0.0,
) -> float:
    """Return the lowest toolhead Z of a touch, never below the axis (axis_min).

    It is that of the command (floor_param), or of the section, or what is known of the bed.
    Half the thickness above a bed at Z=0 a switch that lies there has triggered, and the
    nozzle does not reach a bed that is bare.  A bed that is not known is looked for no lower
    than homing goes, unless the switch 'is_proved' to be there.  A fixed switch is pressed no
    further than NEAR_ZERO below where it triggers with the bed at Z=0.  z_zero and moved_by as in
    is_calibrated().
    """
    if floor_param is not None:
        return max(floor_param, axis_min)
    if settings.position_min is not None:
        return max(settings.position_min, axis_min)
    if settings.switch_height is not None:
        return max(settings.switch_height - NEAR_ZERO, axis_min)
    if is_calibrated(settings, z_zero, moved_by):
        return max(settings.z_offset / 2.0, axis_min)
    if is_proved or z_zero is None or z_zero.option != ENDSTOP_OPTION:
        return max(UNSAVED_FLOOR, axis_min)
    return max(min(z_zero.z, 0.0) - PAST_ENDSTOP, axis_min)


def above_pin(floor_z: float, pin_z: Optional[float]) -> float:
    """Return the lowest toolhead Z of a touch over the pin of the Z endstop.

    It ends at pin_z at the latest, None: the toolhead is elsewhere.
    """
    return floor_z if pin_z is None else max(floor_z, pin_z)


def corrected_zero(
    z_zero: ZZero, bed_z: float, axis_limits: Tuple[float, float]
) -> ZZero:
    """Return where Z gets its zero once the bed, now at bed_z, is to be at Z=0.

    Raises CalibrationError for a value outside the axis (low, high), with which klippy would
    not start.
    """
    corrected = z_zero._replace(z=round(z_zero.z - bed_z, 3))
    low, high = axis_limits
    if not low <= corrected.z <= high:
        raise CalibrationError(
            f"{corrected.section}: {corrected.option} would be {corrected.z:.3f},"
            f" outside the {low:.3f} to {high:.3f} of Z; widen position_min or"
            " position_max, or do without SAVE=1"
        )
    return corrected
