# How fast and how far the head moves with samples: auto, where its owner leaves that
# open.  Pure functions.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Speeds of touches are always the owner's: what a switch says depends on them.  The
# rest follows from the machine:
#
#   from place to place  FREE_TRAVEL_SPEED; down to the travel height on the way, if the
#                        owner has said what the Z axis can do
#   up, no touch         what the Z axis can do, likewise
#   down, armed          as fast as half of travel_margin is enough to stop
#   between touches      lifted by SHORTEST_LIFT, or more where the switch is still
#                        pressed then, see measuring.py

import math

# XY speed (mm/s): half of what owners of magnetic probes use
FREE_TRAVEL_SPEED = 100.0

# Lift (mm) between two touches: more than the play of a usual Z axis and the
# hysteresis of a usual micro switch
SHORTEST_LIFT = 0.5

# No switch is still pressed so far (mm) above where it has triggered
LONGEST_LIFT = 3.0

# Hosts stop the motors of another board within so many seconds (TRSYNC_TIMEOUT)
BOARDS_APART = 0.025


# Speed (mm/s) of a way down to where nothing should be yet: whatever it meets there
# presses for no more than half the margin (mm).
def armed_speed(margin, axis_speed, axis_accel):
    way = margin / 2.0
    return min(
        axis_speed, math.sqrt(2.0 * way * axis_accel), way / BOARDS_APART
    )


# Lift (mm) that gets a touch to its speed (mm/s) on half of its way
def least_lift(speed, accel):
    return max(SHORTEST_LIFT, speed**2 / accel)


# settings.Settings of a run; 'axis_speed' and 'axis_accel' are what Z can do, None: its
# owner has not said, so nothing of Z is quicker than he has it.
def of_run(settings, axis_speed, axis_accel):
    if not settings.counting.is_free:
        return settings
    pin, probe = settings.pin, settings.probe
    if axis_speed is None:
        axis_speed = settings.probing_speed
    elif "lift_speed" not in settings.said:
        pin = pin._replace(lift_speed=axis_speed)
        probe = probe._replace(lift_speed=axis_speed)
    if may_lengthen(settings):
        probe = shortened(probe, axis_accel)
        if settings.wiggle_xy_offsets is None:
            pin = shortened(pin, axis_accel)
    if "probing_speed" not in settings.said:
        margin = settings.travel_margin
        speed = armed_speed(margin, axis_speed, axis_accel)
        settings = settings._replace(probing_speed=speed)
    if "speed" not in settings.said:
        settings = settings._replace(speed=FREE_TRAVEL_SPEED)
    return settings._replace(pin=pin, probe=probe)


# With the shortest lift, but for an owner who has less
def shortened(sampling, accel):
    lift = least_lift(sampling.speed, accel)
    return sampling._replace(retract_dist=min(sampling.retract_dist, lift))


# Whether the lifts between touches are the module's
def may_lengthen(settings):
    return (
        settings.counting.is_free
        and "probing_retract_dist" not in settings.said
    )
