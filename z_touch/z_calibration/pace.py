"""How fast and how far the toolhead moves in CALIBRATE_Z where its section leaves that open.

Pure functions.  Speeds of touches are always the user's: what a switch says depends on
them.  The rest follows from the machine, and Z is never moved faster than its user moves
it elsewhere:

  from place to place   TRAVEL_SPEED, as high as the toolhead is
  up                    the larger of lift_speed of [probe] and homing_speed of
                        [stepper_z], never above max_z_velocity
  down, armed           the same, or slower, so that half of travel_margin is enough to
                        stop
  between touches       lifted by SHORTEST_LIFT, or more where the switch is still pressed
                        then, see place.py

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math

from ..sampling import Sampling

# XY speed (mm/s): half of what users of magnetic probes set
TRAVEL_SPEED = 100.0

# Lift (mm) between two touches: more than the play of a usual Z axis and the
# hysteresis of a usual micro switch
SHORTEST_LIFT = 0.5

# No switch is still pressed so far (mm) above where it has triggered
LONGEST_LIFT = 3.0

# Hosts stop the motors of another board within so many seconds (TRSYNC_TIMEOUT)
BOARDS_APART = 0.025


def armed_speed(margin: float, axis_speed: float, axis_accel: float) -> float:
    """Return the speed (mm/s) of a way down to where nothing should be yet.

    Whatever it meets there presses for no more than half the margin (mm).
    """
    way = margin / 2.0
    return min(
        axis_speed, math.sqrt(2.0 * way * axis_accel), way / BOARDS_APART
    )


def least_lift(speed: float, accel: float) -> float:
    """Return the lift (mm) that gets a touch to its speed (mm/s) on half of its way."""
    return max(SHORTEST_LIFT, speed**2 / accel)


def shortened(sampling: Sampling, accel: float) -> Sampling:
    """Return a sampling with the shortest lift, unless the user has less."""
    lift = least_lift(sampling.speed, accel)
    return sampling._replace(retract_dist=min(sampling.retract_dist, lift))
