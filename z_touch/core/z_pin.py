# The metal pin that Z is homed on, and how far the nozzle may press it.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# No section says that the Z endstop is a pin below the nozzle.  It is one where
# [z_calibration] has the nozzle press it, or where Z is homed beside what the bed
# mesh covers.

import collections

from . import options
from .pin_options import ENDSTOP_PIN, NOZZLE_POSITION

# So near (mm, in X and in Y) the nozzle may meet the pin: its half, and that of a
# worn nozzle's flat.
NEAR = 5.0

# A pin is pressed so far (mm) below where it triggers, at most.
BELOW_TRIGGER = 1.0

# A switch that triggers higher (mm) is at the other end of the axis.
HIGHEST = 10.0

# Where it is (mm, of the head), and the toolhead Z of its trigger
Pin = collections.namedtuple("Pin", "x y trigger_z")


# The pin that the sections of the printer tell of; None: nobody does.  'z_axis':
# axes.ZAxis
def read_pin(config, z_axis):
    trigger_z = low_switch(z_axis)
    if trigger_z is None:
        return None
    xy = _calibrated_at(config) or _homed_beside_mesh(config)
    return xy and Pin(xy[0], xy[1], trigger_z)


# The toolhead Z (mm) at which the switch triggers that Z is homed on; None: there
# is none near the bed.
def low_switch(z_axis):
    if z_axis is None or "z_virtual_endstop" in z_axis.endstop_pin:
        return None
    trigger_z = z_axis.position_endstop
    return trigger_z if trigger_z is None or trigger_z <= HIGHEST else None


# Where the nozzle is on the pin as [z_calibration] has it
def _calibrated_at(config):
    if not config.has_section("z_calibration"):
        return None
    section = options.Foreign(config.getsection("z_calibration"))
    values = options.read(section, (NOZZLE_POSITION, ENDSTOP_PIN))
    if values[ENDSTOP_PIN.name] is not None:
        # Another pin, whose height nobody knows yet
        return None
    site = values[NOZZLE_POSITION.name]
    return _home(config) if site is None else (site.x, site.y)


def _homed_beside_mesh(config):
    home, area = _home(config), mesh_area(config)
    if None in (home, area):
        return None
    return None if is_over(home, area, NEAR) else home


# What the bed mesh covers: its corners (X and Y, mm); None: it is round, or there is
# none
def mesh_area(config):
    ends = [
        _point(config, "bed_mesh", name) for name in ("mesh_min", "mesh_max")
    ]
    return None if None in ends else tuple(ends)


# Whether X and Y (mm) are in it, or that near to it
def is_over(xy, area, near=0.0):
    return all(
        low - near <= at <= high + near for at, low, high in zip(xy, *area)
    )


def _home(config):
    return _point(config, "safe_z_home", "home_xy_position")


def _point(config, section, option):
    if not config.has_section(section):
        return None
    read = config.getsection(section).getfloatlist
    point = read(option, None, count=2, note_valid=False)
    return point if point and all(map(options.is_finite, point)) else None


# Whether the nozzle stands over it now.  'pin': as read_pin()
def is_over_pin(host, pin):
    if pin is None:
        return False
    position = host.toolhead.get_position()
    return max(abs(a - b) for a, b in zip(position, (pin.x, pin.y))) <= NEAR


# The lowest toolhead Z (mm) of a touch where the head stands now; None: it is not
# over the pin.  'pin': as read_pin()
def floor(host, pin):
    is_over = is_over_pin(host, pin)
    return pin.trigger_z - BELOW_TRIGGER if is_over else None
