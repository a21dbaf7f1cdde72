# The moves of the head: to the dock, into it, out of it, and around it.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

from ..core import touching
from . import detour
from .settings import POSITIONS, dock_height


# The head, and what is known of how high it is
class Moves(object):
    # 'host': host.Host; 'settings': settings.Settings
    def __init__(self, host, settings):
        self.host = host
        self.settings = settings
        dock = settings.dock_position
        self.zone = detour.Zone(
            dock.x,
            dock.y,
            settings.safe_dock_distance,
            [
                detour.direction(dock, getattr(settings, row.name))
                for row in POSITIONS
            ],
        )
        # Where nobody knows Z: whether the head was lifted for the dock
        self.is_lifted = False
        # Where the Z motors were, see motors_z(), when Z was homed with the
        # probe
        self.homed_z = None
        register = host.printer.register_event_handler
        register("stepper_enable:motor_off", self.forget)

    # The motors are off: the head may be moved by hand, or sink.  Some hosts
    # tell the print time.
    def forget(self, *unused):
        self.is_lifted, self.homed_z = False, None

    ######################################################################
    # Where the head is
    ######################################################################

    # How far (mm) the Z motors have moved, up is positive, whatever Z was set
    # to; the mean of all of them.  None where they move X or Y, too.
    def motors_z(self):
        steppers, datum = self.host.z_steppers(), self.host.z_datum()
        moved = [
            stepper.get_commanded_position() + shift
            for stepper, shift in zip(steppers, datum)
        ]
        return sum(moved) / len(moved) if moved else None

    def is_homed(self, axes):
        homed = self.host.toolhead_status()["homed_axes"]
        return all(axis in homed for axis in axes)

    # Raises the host's error unless the axes are homed that lead to the dock,
    # or those that are named
    def require_homed(self, axes=None):
        axes = axes or ("xy" if self.settings.dock_fixed_z else "xyz")
        missing = [axis.upper() for axis in axes if not self.is_homed(axis)]
        if missing:
            raise self.host.error(
                "not homed: %s; the way to the dock is not known before; home"
                " first (G28 %s)" % (", ".join(missing), " ".join(missing))
            )

    # Where the toolhead is; Z is None where nobody knows it
    def position(self):
        x, y, z = self.host.toolhead.get_position()[:3]
        return detour.Position(x, y, z if self.is_homed("z") else None)

    # Whether X and Y are there
    def is_at(self, position):
        return detour.distance(self.position(), position) < detour.ROUNDING

    ######################################################################
    # Up and down
    ######################################################################

    # Z up to a height where the head is lower, never down.  Where nobody knows
    # Z, so much up, once until Z is homed or the motors are off.
    def lift(self, height):
        if self.is_homed("z"):
            self.is_lifted = False
            touching.raise_to(self.host, height, self.settings.lift_speed)
        elif not self.is_lifted:
            self.host.lift_unhomed(height, self.settings.lift_speed)
            self.is_lifted = True

    def lift_for_dock(self):
        self.lift(dock_height(self.settings))

    # Up or down; z None: stay
    def go_to_height(self, z):
        if z is not None and z != self.host.z():
            speed = self.settings.lift_speed
            self.host.toolhead.manual_move([None, None, z], speed)

    # To the Z of a position, where a dock has a height of its own
    def go_to_z_of(self, position):
        if not self.settings.dock_fixed_z:
            self.go_to_height(position.z)

    ######################################################################
    # To the dock and back
    ######################################################################

    # To X and Y of a position, around the dock
    def travel(self, position, speed):
        start, limits = self.position(), self.host.axis_limits()[:2]
        # After homing the head stands a part of a step beyond the limit.
        goal = tuple(
            min(max(xy, low), high) for xy, (low, high) in zip(position, limits)
        )
        via = self.settings.safe_position
        try:
            points = detour.around(start, goal, self.zone, limits, via)
        except detour.NoDetour:
            raise self.host.error(
                "no way from %.3f, %.3f to %.3f, %.3f around the dock in the"
                " reach of X and Y; move the head away from it, or lower"
                " safe_dock_distance (%.3f)"
                % (start[:2] + goal + (self.zone.radius,))
            )
        for x, y in points:
            touching.move_xy(self.host, x, y, speed)

    # To a position outside of the dock, high enough for what hangs on the head
    def go_beside(self, position):
        self.require_homed()
        self.lift_for_dock()
        self.travel(position, self.settings.travel_speed)
        self.go_to_z_of(position)

    # Into the dock, straight from a position outside of it
    def go_in(self, beside):
        self.require_homed()
        dock, speed = self.settings.dock_position, self.settings.attach_speed
        if not self.is_at(beside) and not self.is_at(dock):
            self.go_beside(beside)
        self.go_to_z_of(dock)
        touching.move_xy(self.host, dock.x, dock.y, speed)

    # Straight out of the dock to a position; from elsewhere there, around the
    # dock
    def go_out(self, position, speed):
        self.require_homed()
        if not self.is_at(self.settings.dock_position):
            self.go_beside(position)
            return
        self.go_to_z_of(position)
        touching.move_xy(self.host, position.x, position.y, speed)

    # Back over where the head was, and down there, but not lower than 'lowest';
    # 'lowest' None: only over it
    def go_back(self, position, lowest=None):
        self.lift_for_dock()
        self.travel(position, self.settings.travel_speed)
        if None not in (lowest, position.z, self.position().z):
            self.go_to_height(max(position.z, lowest))
