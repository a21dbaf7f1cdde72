"""A switch that stays where it is, such as one beside the bed that only the nozzle can press.

The nozzle touches the switch, whose trigger is switch_height above the bed; [probe] touches the
bed at bed_xy_position, and says where the bed is for Klipper:

  bed          = trigger - switch_height   toolhead Z at which the nozzle meets the bed
  probe height = probe - bed               what z_offset of [probe] should be

Every height is a toolhead Z in mm.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Optional, Tuple

from .. import attached, errors, pin, touch
from ..errors import CalibrationError
from ..sampling import Series
from .heights import NEAR_ZERO
from .settings import TRAVEL_SPEED

if TYPE_CHECKING:
    from ..host.printer import Host
    from ..host.probe import ProbeSession
    from ..touch import Site
    from .settings import Settings

# The nozzle has to be so near (mm) to xy_position for a touch of the switch.
NEAR_SWITCH = 5.0

# The toolhead travels at least so high (mm) above the switch, and above where the probe
# triggers.
CLEAR = 2.0

# A probe whose height differs by more (mm) from its z_offset is told.
SAME_HEIGHT = 0.1

# What a section still needs for EXTRA_PROBE_CALIBRATE
NO_HEIGHT = (
    "there is no switch_height; set it to how far above the bed the switch triggers,"
    " in mm: what EXTRA_PROBE over the switch says with Z=0 right on the bed"
)

# What to do about samples of the probe that differ
DIFFER = "check the probe with PROBE_ACCURACY"
TOO_LOW = "set a higher safe_z_height"


def check(
    host: Host,
    settings: Settings,
    axis_min: float,
    mesh_area: Optional[Tuple[pin.Point, pin.Point]],
) -> None:
    """Raise CalibrationError where a section with 'fixed: True' cannot work.

    'axis_min' (mm) is the lowest Z of the axis, 'mesh_area' what the bed mesh covers; None:
    that is not known.
    """
    section = f"in section '{host.section}'"
    height, switch = settings.switch_height, settings.xy_position
    if settings.z_offset:
        raise CalibrationError(
            f"Option 'z_offset: {settings.z_offset:g}' {section} is the thickness of a"
            " switch that lies on the bed; with 'fixed: True' give switch_height"
        )
    if switch is None:
        raise CalibrationError(
            f"Option 'fixed: True' {section} needs xy_position: X, Y of the toolhead when"
            " the nozzle is above the switch"
        )
    if host.probing.endstop() is None:
        raise CalibrationError(
            f"Option 'fixed: True' {section} needs a [probe] that touches the bed with a"
            " switch on a pin; home Z on the switch where there is none"
        )
    bed = touch.probe_site(host, settings.bed_xy_position)
    if bed is None:
        option = host.transforms.mesh_zero_option()
        raise CalibrationError(
            f"Option 'fixed: True' {section} needs bed_xy_position, the point of the bed"
            f" that the probe is to touch, or {option} in section 'bed_mesh'"
        )
    touch.check_reach(host, bed, touch.CHOOSE_ANOTHER)
    high = max(height or 0.0, host.probing.z_offset()) + CLEAR
    if settings.safe_z_height < high:
        raise CalibrationError(
            f"Option 'safe_z_height: {settings.safe_z_height:g}' {section} is not {CLEAR:g}"
            " mm above the switch, and above where the probe triggers; set it to"
            f" {high:g} or more"
        )
    if height is None:
        return
    if height <= axis_min:
        raise CalibrationError(
            f"Option 'switch_height: {height:g}' {section} is below the {axis_min:.3f}"
            " that Z goes down to; lower position_min of the Z axis"
        )
    place = switch.x, switch.y
    if height < 0.0 and mesh_area is not None and pin.is_over(place, mesh_area):
        raise CalibrationError(
            f"Option 'switch_height: {height:g}' {section} says that the switch is lower"
            f" than the bed, but xy_position {switch.x:g}, {switch.y:g} is over the bed;"
            " correct one of them"
        )


def check_place(host: Host, switch: Site) -> None:
    """Raise CalibrationError unless the nozzle is over the switch.

    How low a touch may go holds there only.
    """
    x, y = host.toolhead.get_position()[:2]
    distance = math.hypot(x - switch.x, y - switch.y)
    if distance > NEAR_SWITCH:
        raise CalibrationError(
            f"the nozzle is {distance:.1f} mm from the switch at xy_position"
            f" {switch.x:g}, {switch.y:g}; move it there first"
        )


def bed_point(host: Host, settings: Settings) -> Tuple[float, float]:
    """Return X and Y (mm) of the point of the bed that the probe touches."""
    bed = touch.probe_site(host, settings.bed_xy_position)
    # Checked when klippy connected
    assert bed is not None
    x_offset, y_offset = host.probing.offsets()[:2]
    return bed.x + x_offset, bed.y + y_offset


def touch_bed(host: Host, settings: Settings, bed_z: float) -> float:
    """Return where the probe triggers over the bed, as G28 sees it.  May pause.

    'bed_z' is where the nozzle would meet the bed: no touch goes lower.  Raises
    CalibrationError.
    """
    bed = touch.probe_site(host, settings.bed_xy_position)
    # Checked when klippy connected
    assert bed is not None
    everything = attached.of(host.printer)
    everything.go_to(host, bed.x, bed.y, TRAVEL_SPEED)
    sampling = host.probing.sampling()
    head = touch.Head(host, sampling, TOO_LOW)
    top, speed = host.motion.z(), f"{sampling.speed:.6f}"
    session = touch.probing(head, bed_z, top, PROBE_SPEED=speed)
    with errors.about("probe"), session as session_or_none:
        series = Series(sampling, DIFFER)
        while not series.is_complete():
            z = _probe_once(head, session_or_none, bed_z)
            host.say(f"probe: triggered at z={z:.6f}")
            why_again = series.add(z)
            if why_again:
                host.say(f"probe: {why_again}")
    # It is the nozzle that goes down next, whatever command does it
    everything.settle(host)
    return series.result()


def _probe_once(
    head: touch.Head, session: Optional[ProbeSession], bed_z: float
) -> float:
    """Touch once with the probe; return the height of the trigger."""
    head.retract()
    head.check_above(bed_z)
    try:
        return head.probe_bed(session, bed_z)
    except CalibrationError as e:
        where = ""
        if touch.is_at(head.host, bed_z):
            where = "where the nozzle meets the bed, by what the switch says"
        raise e.advised(touch.CHECK_PROBE, floor_reason=where)


def check_height(host: Host, probe_z: float, bed_z: float) -> str:
    """Return what the user is told of the height at which the probe has triggered.

    Empty: it is that of [probe].  Raises CalibrationError where it is another one altogether.
    """
    height, z_offset = probe_z - bed_z, host.probing.z_offset()
    change = height - z_offset
    found = (
        f"the probe triggers {height:.3f} mm above the bed, its z_offset is"
        f" {z_offset:.3f}"
    )
    if abs(change) > NEAR_ZERO:
        raise CalibrationError(
            f"{found}: over {NEAR_ZERO:g} mm apart; check that nothing lies on the bed, and"
            f" measure switch_height in section '{host.section}' again"
        )
    if abs(change) <= SAME_HEIGHT:
        return ""
    return (
        f"{found}: right after another nozzle, and SAVE=1 keeps it; after another plate"
        f" measure switch_height in section '{host.section}' again, as the switch does not"
        " lie on the plate"
    )
