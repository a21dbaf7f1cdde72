r"""Heights of a Z calibration: the formula, what is expected, floors, travel heights.

Pure functions.  Every height is a toolhead Z in mm, see z_touch/touch.py: the position of the
toolhead in the frame of the last homing, up is positive.  With the probe attached, three
things lie below the nozzle:

       \_/        ___ nozzle_z      where the nozzle presses the pin
        :
      [ s ]       ___ body          switch - nozzle: the body of the switch
        I         ___ trigger       + switch_offset: where its plunger triggers
        I         ___ free plunger  + FREE_PLUNGER: where the free plunger ends

'settings' are completed; 'last' is the Result of the last good run, None without one.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Optional, Tuple

from .. import pin
from ..errors import TouchedWrong

if TYPE_CHECKING:
    from ..host.toolhead import ZZero
    from ..touch import Site
    from .settings import Settings

# The switch body is at least this far (mm) below the nozzle tip: a probe
# with less could not reach the bed before the nozzle does.
BODY_BELOW_NOZZLE = 1.0

# A smaller z_offset (mm) of the probe cannot have been measured on a switch.
SMALLEST_Z_OFFSET = 2.0

# How far a probe that was never measured may reach below the nozzle (mm), where
# its z_offset is no better.  Common ones reach 5 to 9 mm; long ones need a
# z_offset or a safe_z_height that is right.
UNMEASURED_PROBE = 10.0

# The free plunger reaches this much (mm) lower than the point at which it
# triggers; no micro switch has a longer pretravel.
FREE_PLUNGER = 1.0

# Plates of one printer differ in thickness by less than this (mm), so its bed is found
# so near to where the last good run has found it, seen from the pin.
BED_VARIES = 2.0

# A nozzle that meets its pin this much (mm) higher than where Z was homed on that pin
# does not meet it itself: something is below it.  Tools differ by less in length.
HIGHER_THAN_HOMED = 3.0

# So far (mm) below position_endstop a touch has to be able to go at least: homing
# again moves the trigger by some microsteps.
LEAST_ROOM = 0.05

# What to do about heights that may be outdated
HOME_AGAIN = "home Z again (G28 Z) after any levelling"

# Heights (mm) that differ by less are the same.
ROUNDING = 0.0000001

# Travel height (mm) where twice the probe's z_offset is no real height.
SMALLEST_SAFE_Z = 3.0
FALLBACK_SAFE_Z = 20.0

######################################################################
# The result
######################################################################


class Result(NamedTuple):
    """The parts and the outcome of one calibration (mm).

    Toolhead Z of the three triggers, the switch_offset that was calculated with, and the
    G-code Z offset.
    """

    probe: float
    switch: float
    nozzle: float
    switch_offset: float
    offset: float


class Kept(NamedTuple):
    """The heights of a good run as they hold for later ones (mm).

    switch - nozzle of its probe, how high the bed is above where the nozzle meets the pin,
    and how much lower the bed may be now.
    """

    body: float
    bed: float
    lower: float = BED_VARIES


def offset(
    probe: float, switch: float, nozzle: float, switch_offset: float
) -> float:
    """Return the G-code Z offset (mm): toolhead Z where the nozzle meets the bed.

    The part in brackets is how far the probe triggers below the nozzle, see the door.
    """
    return probe - (switch - nozzle + switch_offset)


def result_of(
    probe: float, switch: float, nozzle: float, switch_offset: float
) -> Result:
    """Return the result of three heights and a switch_offset (mm)."""
    z_offset = offset(probe, switch, nozzle, switch_offset)
    return Result(probe, switch, nozzle, switch_offset, z_offset)


def kept_of(
    nozzle: float, switch: float, bed: float, switch_offset: float
) -> Kept:
    """Return what holds for later runs, of toolhead Z of the three places (mm)."""
    z_offset = offset(bed, switch, nozzle, switch_offset)
    return Kept(switch - nozzle, z_offset - nozzle)


def reach_below(z_offset: float, more: float) -> float:
    """Return how far (mm) a probe may reach below the nozzle.

    'more' is added for what its z_offset is not sure of.
    """
    is_measured = z_offset >= SMALLEST_Z_OFFSET
    return (z_offset if is_measured else UNMEASURED_PROBE) + more


def check_offset(
    result: Result, margins: Tuple[float, float], zero: Optional[ZZero]
) -> None:
    """Raise TouchedWrong for an offset outside of margins (low, high).

    'zero' is where Z gets its zero, None: that is not known.
    """
    low, high = margins
    if low <= result.offset <= high:
        return
    raise TouchedWrong(
        f"offset {result.offset:.3f} is outside offset_margins {low:.3f} to {high:.3f}"
        f" (probe={result.probe:.3f} switch={result.switch:.3f}"
        f" nozzle={result.nozzle:.3f}); {HOME_AGAIN}, then check the three positions"
        f" and {corrected_zero(zero, result.offset)}"
    )


def corrected_zero(zero: Optional[ZZero], z_offset: float) -> str:
    """Return what would make the offset (mm) 0, in words.

    A bed that is lower than expected gets no number: that would bring the nozzle closer to
    it, and without plate or probe the bed only seems to be so low.
    """
    if zero is None:
        return "position_endstop"
    if z_offset < 0.0:
        return f"{zero.option} of section '{zero.section}'"
    return (
        f"{zero.option} of section '{zero.section}' ({zero.z:.3f} - {z_offset:.3f}:"
        f" try {zero.z - z_offset:.3f})"
    )


######################################################################
# Expected heights
######################################################################

# Where a touch should trigger: toolhead Z (mm), or None where that is not known.


def expect_nozzle(
    settings: Settings, last: Optional[Result], holds: bool
) -> Optional[float]:
    """Return where the nozzle should meet the pin.

    It meets the Z endstop where Z was homed, or, more exactly, where it did in the last run,
    as long as Z=0 is still that of the run ('holds').  A pin of its own is only known from
    the last run.
    """
    if last is None or not (holds or settings.position_endstop is None):
        return settings.position_endstop
    return last.nozzle


def expect_switch(
    settings: Settings, nozzle_z: float, last: Optional[Result]
) -> Optional[float]:
    """Return where the body should meet the pin.

    As far below the nozzle as in the last run; before the first one as far as z_offset of
    the probe says, if that was ever measured.
    """
    if last is not None:
        return nozzle_z + last.switch - last.nozzle
    if settings.z_offset < SMALLEST_Z_OFFSET:
        return None
    return nozzle_z + settings.z_offset - _switch_offset(settings)


def expect_bed(
    settings: Settings,
    nozzle_z: float,
    switch_z: float,
    last: Optional[Result],
) -> float:
    """Return where the probe should meet the bed.

    Where the last run had it; before the first one at an offset of 0.
    """
    gap = switch_z - nozzle_z + _switch_offset(settings)
    return gap + (last.offset if last is not None else 0.0)


def _switch_offset(settings: Settings) -> float:
    assert settings.switch_offset is not None
    return settings.switch_offset


######################################################################
# Floors
######################################################################

# The lowest toolhead Z (mm) of each touch.  None goes lower than a usable result can
# lie, nor below position_min: a lost probe or a dead switch then ends with the
# nozzle in the air.


def nozzle_floor(settings: Settings, expected_z: Optional[float]) -> float:
    """Return the floor of the nozzle's touch.

    It meets the Z endstop where Z was homed: what the *result* may be has no say in it.  How
    high a pin of its own is, is not known until it was touched.
    """
    homed_z = settings.position_endstop
    if homed_z is None:
        homed_z = expected_z
    if homed_z is None:
        return settings.position_min
    return max(settings.position_min, homed_z - settings.travel_margin)


def possible_offsets(
    settings: Settings, nozzle_z: float, kept: Optional[Kept]
) -> Tuple[float, float]:
    """Return what the offset can be (low, high; mm).

    As offset_margins say, and, once a run was good ('kept'), so near to the bed of that run
    as plates differ, or as the same one may be lower.
    """
    low, high = settings.offset_margins
    if kept is None:
        return low, high
    before = nozzle_z + kept.bed
    return max(low, before - kept.lower), min(high, before + BED_VARIES)


def floor_over(
    settings: Settings,
    floor: float,
    point: Optional[Tuple[float, float]],
    below: float = 0.0,
) -> float:
    """Return a floor that is no lower than the bed, over what the bed mesh covers.

    There no pin is lower than the bed, which meets the nozzle where the offset is.  'point' is
    X and Y (mm) of what touches, None: not known; 'below' how far (mm) it is below the nozzle.
    """
    area = settings.mesh_area
    if area is None or point is None or not pin.is_over(point, area):
        return floor
    return max(floor, settings.offset_margins[0] + below)


def least_body(settings: Settings) -> float:
    """Return how far (mm) the body is below the nozzle, at least."""
    if settings.z_offset < SMALLEST_Z_OFFSET:
        return BODY_BELOW_NOZZLE
    return settings.z_offset - _switch_offset(settings)


def switch_floor(
    settings: Settings,
    nozzle_z: float,
    expected_z: Optional[float],
    kept: Optional[Kept] = None,
) -> float:
    """Return the floor of the body's touch.

    The body is below the nozzle, in any case; where a trigger is expected, the touch ends
    travel_margin below it.  The probe's z_offset would be tighter, but many configurations
    hold a value there that was never measured.
    """
    floor = max(settings.position_min, nozzle_z + BODY_BELOW_NOZZLE)
    if kept is not None:
        floor = max(floor, nozzle_z + kept.body - BED_VARIES)
    if expected_z is None:
        return floor
    return max(floor, expected_z - settings.travel_margin)


def bed_floor(
    settings: Settings,
    nozzle_z: float,
    switch_z: float,
    kept: Optional[Kept] = None,
) -> float:
    """Return the floor of the probe's touch: a lower bed would give an offset that cannot be."""
    gap = switch_z - nozzle_z + _switch_offset(settings)
    low, _ = possible_offsets(settings, nozzle_z, kept)
    return max(settings.position_min, gap + low)


def below_margins(
    settings: Settings,
    lowest: float,
    kept: Optional[Kept],
    zero: Optional[ZZero],
    site: Site,
) -> str:
    """Return what to do where nothing triggered down to the floor of the bed.

    'lowest' is the offset (mm) there, 'kept' as in possible_offsets(), 'zero' as in
    check_offset().  Empty: with such margins the bed is not known to be low.
    """
    low = settings.offset_margins[0]
    check = (
        f"check that the plate is on, the probe (QUERY_PROBE) and {site.place()}, and"
        " that Z was homed (G28 Z) after any levelling"
    )
    if kept is not None and lowest > low:
        return (
            f"the last good run has found the bed {kept.lower:g} mm higher; {check}; if"
            " pin or bed is elsewhere now, run CALIBRATE_Z ACCEPT_CHANGE=1"
        )
    if low >= 0.0:
        return ""
    # In the set-up the user has not chosen it
    end = (
        f"the low end of offset_margins ({low:.3f})"
        if site.option
        else f"z={low:.3f}"
    )
    return (
        f"the bed is below {end}, or the probe is dead; {check}; only then correct"
        f" {corrected_zero(zero, low)}"
    )


def ended_by_position_min(
    settings: Settings,
    section: str,
    floor: float,
    expected_z: Optional[float],
) -> str:
    """Return why a touch without a trigger has ended where it did.

    That is position_min of 'section', where it could not go as far down as it may; otherwise
    empty.
    """
    position_min = settings.position_min
    if floor > position_min + ROUNDING:
        return ""
    is_low = (
        expected_z is None
        or expected_z - settings.travel_margin <= position_min - ROUNDING
    )
    if not is_low:
        return ""
    return f"position_min ({position_min:.3f}) of section '{section}'"


def unmeasured_bed_floor(settings: Settings, nozzle_z: float) -> float:
    """Return where the bed may be looked for with a probe of unknown length.

    The nozzle meets it below the upper margin.  Where levelling has lifted the bed, it has
    lifted the pin of the Z endstop with it.
    """
    floor = settings.offset_margins[1] + BODY_BELOW_NOZZLE
    if settings.position_endstop is not None:
        floor += max(0.0, nozzle_z - settings.position_endstop)
    return max(settings.position_min, floor)


def lowest_switch(
    settings: Settings,
    nozzle_z: float,
    bed_z: float,
    kept: Optional[Kept] = None,
) -> float:
    """Return the lowest height of the body on the pin if the probe triggered at bed_z.

    The offset can be no larger than that.
    """
    gap = bed_z - possible_offsets(settings, nozzle_z, kept)[1]
    return nozzle_z + gap - _switch_offset(settings)


######################################################################
# Travel heights
######################################################################

# Toolhead Z (mm) at which it moves in X and Y.  A minimum where the user
# or z_offset has it; never above the end of the axis.


def default_safe_z(probe_z_offset: float) -> float:
    """Return safe_z_height where it is left out: twice z_offset, if that is a real height."""
    safe_z = 2.0 * probe_z_offset
    return safe_z if safe_z >= SMALLEST_SAFE_Z else FALLBACK_SAFE_Z


def travel_height(
    settings: Settings, pin_z: Optional[float], body: Optional[float]
) -> float:
    """Return the height above a pin at pin_z and above the bed, which lies at about 0.

    pin_z None: not known.  'body' is how far (mm) the probe's body is below the nozzle, None:
    not known.
    """
    if pin_z is None:
        pin_z = settings.unmeasured_pin
    below = max(settings.z_offset, UNMEASURED_PROBE)
    if body is not None:
        below = body + (settings.switch_offset or 0.0) + FREE_PLUNGER
    clear = max(pin_z, 0.0) + below + settings.travel_margin
    return _at_least(settings, clear, pin_z)


def travel_height_to_bed(
    settings: Settings, nozzle_z: float, switch_z: float
) -> float:
    """Return the height above pin and bed with a probe that was measured.

    The bed may be as high as the upper margin lets it.
    """
    gap = switch_z - nozzle_z + _switch_offset(settings)
    highest = max(nozzle_z, settings.offset_margins[1])
    clear = highest + gap + FREE_PLUNGER + settings.travel_margin
    return _at_least(settings, clear, switch_z)


def _at_least(settings: Settings, clear: float, trigger_z: float) -> float:
    """Return 'clear', or as high as the user wants it after a touch at trigger_z."""
    wanted = max(settings.safe_z_height, trigger_z + settings.clearance)
    return min(max(clear, wanted), settings.position_max)
