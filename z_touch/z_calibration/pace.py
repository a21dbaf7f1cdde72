"""How fast and how far the head moves in CALIBRATE_Z where its section leaves that open.

Pure functions.  Speeds of touches are always the user's: what a switch says depends on
them.  The rest follows from the machine, and Z is never moved faster than its user moves
it elsewhere:

  from place to place   TRAVEL_SPEED, as high as the head is
  up                    the larger of lift_speed of [probe] and homing_speed of
                        [stepper_z], never above max_z_velocity
  down, armed           the same, or slower, so that half of travel_margin is enough to
                        stop
  between touches       lifted by SHORTEST_LIFT, or more where the switch is still pressed
                        then, see measuring.py

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

import math

# XY speed (mm/s): half of what users of magnetic probes set
TRAVEL_SPEED = 100.0

# Lift (mm) between two touches: more than the play of a usual Z axis and the
# hysteresis of a usual micro switch
SHORTEST_LIFT = 0.5

# No switch is still pressed so far (mm) above where it has triggered
LONGEST_LIFT = 3.0

# Hosts stop the motors of another board within so many seconds (TRSYNC_TIMEOUT)
BOARDS_APART = 0.025


def armed_speed(margin, axis_speed, axis_accel):
    """Return the speed (mm/s) of a way down to where nothing should be yet.

    Whatever it meets there presses for no more than half the margin (mm).
    """
    way = margin / 2.0
    return min(
        axis_speed, math.sqrt(2.0 * way * axis_accel), way / BOARDS_APART
    )


def least_lift(speed, accel):
    """Return the lift (mm) that gets a touch to its speed (mm/s) on half of its way."""
    return max(SHORTEST_LIFT, speed**2 / accel)


def of_run(settings, z_speed, z_accel):
    """Return the settings.Settings of one CALIBRATE_Z.

    z_speed: as fast as the user moves Z elsewhere (mm/s); z_accel: of Z (mm/s^2).
    """
    pin, probe, given = settings.pin, settings.probe, settings.said
    if "lift_speed" not in given:
        pin = pin._replace(lift_speed=z_speed)
        probe = probe._replace(lift_speed=z_speed)
    settings = settings._replace(z_speed=pin.lift_speed)
    if may_lengthen(settings):
        probe = shortened(probe, z_accel)
        if settings.wiggle_xy_offsets is None:
            pin = shortened(pin, z_accel)
    if "probing_speed" not in given:
        fastest = min(z_speed, settings.z_speed)
        speed = armed_speed(settings.travel_margin, fastest, z_accel)
        settings = settings._replace(probing_speed=speed)
    if "speed" not in given:
        settings = settings._replace(speed=TRAVEL_SPEED)
    return settings._replace(pin=pin, probe=probe)


def shortened(sampling, accel):
    """Return a sampling with the shortest lift, unless the user has less."""
    lift = least_lift(sampling.speed, accel)
    return sampling._replace(retract_dist=min(sampling.retract_dist, lift))


def may_lengthen(settings):
    """Return whether the lifts between touches are the module's, as in CALIBRATE_Z."""
    is_run = settings.z_speed is not None
    return is_run and "probing_retract_dist" not in settings.said
