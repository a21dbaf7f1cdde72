"""What [auto_z_offset] needs of the printer, looked at when klippy connects.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List

from ..errors import CalibrationError
from . import shifts
from .heights import BELOW_SWITCH, fastest_touch, travel_height
from .motors import Motors, braking_accel
from .sites import check_sites

if TYPE_CHECKING:
    from ..host.printer import Host
    from .settings import Settings


def check_printer(host: Host, settings: Settings) -> None:
    """Raise CalibrationError for a printer that cannot be measured."""
    _check_probe(host)
    _check_heights(host, settings)
    check_sites(host, settings)


def _check_probe(host: Host) -> None:
    """Check that there is a probe that can be told where to end."""
    probe = host.probing.probe
    if probe is None:
        raise CalibrationError(
            "Section 'probe' is missing: auto_z_offset corrects the inductive"
            " probe that Z is homed with"
        )
    if not host.probing.can_end_at_floor():
        raise CalibrationError(
            f"Section 'probe' ({probe.__class__.__name__}): this probe cannot be told"
            " how far down to look, and a missing trigger would drive the nozzle into"
            " the bed; auto_z_offset needs a [probe], [smart_effector] or [bltouch];"
            " write one, or remove section 'auto_z_offset'"
        )


def _check_heights(host: Host, settings: Settings) -> None:
    """Check that the travel heights are within the axis, and that a touch reaches the bed."""
    assert host.axes.z_axis is not None
    high = host.axes.limits()[2][1]
    section = host.axes.z_axis.section
    top = travel_height(host.probing.homed_probe_z(), settings.probe_hop)
    if top > high:
        raise CalibrationError(
            f"Option 'probe_hop' in section '{host.section}': the toolhead would travel at"
            f" z={top:.3f}, above position_max ({high:.3f}) of section '{section}';"
            " write a smaller value, or correct z_offset of the probe"
        )
    if settings.floor.z >= top - settings.probe_hop:
        raise CalibrationError(
            f"Option 'probe_z_min' in section '{host.section}': no touch could reach the"
            f" bed from there, z={settings.floor.z:.3f} is the lowest; write a value"
            f" below 0, and position_min of section '{section}', too"
        )


def printer_notes(host: Host, settings: Settings, motors: Motors) -> List[str]:
    """Return what the user is told of a printer that can be measured, empty texts among it."""
    notes = []
    if settings.z_current_factor < 1.0 and motors.left_alone:
        notes.append(
            f"z_current_factor has no effect on {', '.join(motors.left_alone)}: no TMC"
            " driver of its own whose current may be changed"
        )
    accel = braking_accel(host, settings.probe_accel)
    wanted = settings.sampling.speed
    speed = fastest_touch(wanted, accel)
    if speed < wanted:
        notes.append(
            f"speed {wanted:g} is limited to {speed:.2f} mm/s on the bed sensor: with"
            f" {accel:g} mm/s^2 the toolhead could not stop soon enough below the bed"
        )
    if not host.axes.homes_with_probe():
        notes.append(
            "Z is not homed with the probe, so the correction holds with a bed"
            " mesh of this probe only"
        )
        notes.append(shifts.wrong_mesh(host))
    return notes


def first_touch_note(host: Host, settings: Settings) -> str:
    """Return what is told of a first touch that may go far into the bed.

    Empty: it may not, or the user has said so.  Only a correction, or a touch since Z was
    homed, says better how low the bed is.
    """
    floor = settings.floor.z
    is_own = settings.probe_z_min is not None
    if is_own or not host.axes.homes_with_probe() or floor > -BELOW_SWITCH:
        return ""
    return (
        "until AUTO_Z_CALIBRATE has run once, a bed sensor that does not answer lets"
        f" the nozzle be pressed {-floor:g} mm into the bed ({settings.floor.why}); watch"
        " the first run, or set probe_z_min about 1 mm below the lowest that the bed can"
        " be"
    )
