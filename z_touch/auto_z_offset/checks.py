# What [auto_z_offset] needs of the printer, looked at when klippy connects.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from ..errors import CalibrationError
from . import shifts
from .heights import BELOW_SWITCH, fastest_touch, travel_height
from .motors import braking_accel
from .sites import check_sites


# Raises CalibrationError for a printer that cannot be measured.
def check_printer(host, settings):
    check_probe(host)
    check_heights(host, settings)
    check_sites(host, settings)


# A probe that has to be told where to end
def check_probe(host):
    probe = host.probing.probe
    if probe is None:
        raise CalibrationError(
            "Section 'probe' is missing: auto_z_offset corrects the inductive"
            " probe that Z is homed with"
        )
    if not host.probing.can_end_at_floor():
        raise CalibrationError(
            "Section 'probe' (%s): this probe cannot be told how far down to"
            " look, and a missing trigger would drive the nozzle into the bed;"
            " auto_z_offset needs a [probe], [smart_effector] or [bltouch];"
            " write one, or remove section 'auto_z_offset'"
            % (probe.__class__.__name__,)
        )


# Travel heights within the axis, and a bed that a touch can reach
def check_heights(host, settings):
    high = host.axes.limits()[2][1]
    section = host.axes.z_axis.section
    top = travel_height(host.probing.homed_probe_z(), settings.probe_hop)
    if top > high:
        raise CalibrationError(
            "Option 'probe_hop' in section '%s': the head would travel at"
            " z=%.3f, above position_max (%.3f) of section '%s'; write a"
            " smaller value, or correct z_offset of the probe"
            % (host.section, top, high, section)
        )
    if settings.floor.z >= top - settings.probe_hop:
        raise CalibrationError(
            "Option 'probe_z_min' in section '%s': no touch could reach the bed"
            " from there, z=%.3f is the lowest; write a value below 0, and"
            " position_min of section '%s', too"
            % (host.section, settings.floor.z, section)
        )


# What the user is told of a printer that can be measured, but not as he wrote
def printer_notes(host, settings, motors):
    notes = []
    if settings.z_current_factor < 1.0 and motors.left_alone:
        notes.append(
            "z_current_factor has no effect on %s: no TMC driver of its own"
            " whose current may be changed" % (", ".join(motors.left_alone),)
        )
    accel = braking_accel(host, settings.probe_accel)
    wanted = settings.sampling.speed
    speed = fastest_touch(wanted, accel)
    if speed < wanted:
        notes.append(
            "speed %g is limited to %.2f mm/s on the bed sensor: with %g mm/s^2"
            " the head could not stop soon enough below the bed"
            % (wanted, speed, accel)
        )
    if not host.axes.homes_with_probe():
        notes.append(
            "Z is not homed with the probe, so the correction holds with a bed"
            " mesh of this probe only"
        )
        notes.append(shifts.wrong_mesh(host))
    return notes


# What is told of a first touch that may go far into the bed; empty: it may not, or the user
# has said so.  Only a correction, or a touch since Z was homed, says better how low the bed is.
def first_touch_note(host, settings):
    floor = settings.floor.z
    is_own = settings.probe_z_min is not None
    if is_own or not host.axes.homes_with_probe() or floor > -BELOW_SWITCH:
        return ""
    return (
        "until AUTO_Z_CALIBRATE has run once, a bed sensor that does not answer lets"
        " the nozzle be pressed %g mm into the bed (%s); watch the first run, or set"
        " probe_z_min about 1 mm below the lowest that the bed can be"
        % (-floor, settings.floor.why)
    )
