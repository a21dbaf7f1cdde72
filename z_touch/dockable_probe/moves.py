# The moves of the head: to the dock, into it, out of it, and around it.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import touch as touching
from . import detour
from .settings import (
    POSITIONS,
    clear_height,
    dock_height,
    nearest_distance,
    travel_height,
)

# From above a dock that all positions are above the head goes so far (mm) aside.
ASIDE = 40.0

# A place so near (mm) is where homing has left the head: hosts correct it by part
# of a step after the event that tells the end.
NEAR_END = 0.5


# The way that homing X and Y has come: clear of the dock, as the head went there.
# It holds until X or Y is homed again, or the motors are off.
class Trace:
    def __init__(self, host):
        self.host = host
        register = host.printer.register_event_handler
        register("homing:home_rails_begin", self._begins)
        register("homing:home_rails_end", self._ends)
        self.forget()

    def forget(self):
        # Each an axis (0: X) and how far (mm) the head has gone along it
        self.moves = []
        # Where it has ended; where the next one began, as host.axes.motors_xy()
        self.end = self.begun_at = None

    # The moves that have led to that place; empty: homing has ended elsewhere
    def to(self, position):
        if self.end is None or detour.distance(position, self.end) > NEAR_END:
            return []
        return self.moves

    def _begins(self, homing_state, rails):
        if (
            self.host.axes.homed_axis(rails) is None
            or self.host.axes.has_two_heads()
        ):
            return
        self.moves = list(self.to(self.host.toolhead.get_position()))
        # Nothing is known of a homing that fails
        self.end = None
        self.begun_at = self.host.axes.motors_xy()

    def _ends(self, homing_state, rails):
        axis = self.host.axes.homed_axis(rails)
        if axis is None or self.begun_at is None:
            return
        # X and Y of the host are set in homing
        moved = self.host.axes.motors_xy()[axis] - self.begun_at[axis]
        self.moves.append((axis, moved))
        self.end = tuple(self.host.toolhead.get_position()[:2])
        self.begun_at = None


# How high the head was clear of what the probe has touched, since Z was homed: a
# z_offset that is too small is no height to travel at.
class Clearance:
    def __init__(self, host):
        # Toolhead Z (mm)
        self.z = 0.0
        register = host.printer.register_event_handler
        register("homing:home_rails_begin", self._homes)

    def note(self, z):
        self.z = max(self.z, z)

    # Z is another one from now on
    def forget(self):
        self.z = 0.0

    # Not sent everywhere where Z is homed with the probe
    def _homes(self, homing_state, rails):
        if 2 in homing_state.get_axes():
            self.forget()

    # With the probe on it the head goes no lower (toolhead Z, mm), but to touch
    def lowest(self, settings):
        return max(travel_height(settings), self.z)


# The head, and what is known of how high it is
class Moves:
    # 'host': host.Host; 'settings': settings.Settings
    def __init__(self, host, settings):
        self.host = host
        self.use(settings)
        # Where nobody knows Z: how far (mm) the head was lifted for the dock, and
        # where the Z motors were then, see motors_z()
        self.lifted, self.lifted_to = 0.0, None
        # See note_bed()
        self.homed_z = None
        self.clear = Clearance(host)
        # See stay()
        self.stayed_at = None
        # How homing X and Y has come to where the head stands
        self.trace = Trace(host)
        register = host.printer.register_event_handler
        register("stepper_enable:motor_off", self.forget)

    def use(self, settings):
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

    # The motors are off: the head may be moved by hand, or sink.  Some hosts
    # tell the print time.
    def forget(self, *unused):
        self.lifted, self.homed_z = 0.0, None
        self.trace.forget()

    ######################################################################
    # Where the head is
    ######################################################################

    # How far (mm) the Z motors have moved, up is positive, whatever Z was set
    # to; the mean of all of them.  None where they move X or Y, too.
    def motors_z(self):
        steppers, datum = self.host.axes.z_steppers(), self.host.axes.z_datum()
        moved = [
            stepper.get_commanded_position() + shift
            for stepper, shift in zip(steppers, datum)
        ]
        return sum(moved) / len(moved) if moved else None

    # Where the Z motors are now, see motors_z(), the probe has met the bed in
    # homing
    def note_bed(self):
        self.homed_z = self.motors_z()

    def is_homed(self, axes):
        homed = self.host.toolhead_status()["homed_axes"]
        return all(axis in homed for axis in axes)

    # Raises the host's error unless the axes are homed that lead to the dock,
    # or those that are named
    def require_homed(self, axes=None):
        if not self.settings.is_placed:
            raise self.host.error(
                "nothing says where the dock is; run DOCKABLE_PROBE_SETUP, which"
                " needs X and Y homed: G28 X Y is possible, also with the probe on"
            )
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

    # Whether the head is where a docking without a way back ends
    def is_at_detach(self):
        settings = self.settings
        return settings.is_placed and self.is_at(settings.detach_position)

    # 'is_wanted': the probe was fetched for a command that goes on from here
    def stay(self, is_wanted):
        stays = is_wanted and not self.is_at_detach()
        self.stayed_at = self.position() if stays else None

    # Whether nobody has moved the head since
    def stays(self):
        return self.stayed_at is not None and self.is_at(self.stayed_at)

    ######################################################################
    # Up and down
    ######################################################################

    # Z up to a height where the head is lower, never down.  Where nobody knows
    # Z, so much up in all, less what the head went down since, until the motors
    # are off.
    def lift(self, height):
        if self.is_homed("z"):
            self.lifted = 0.0
            touching.raise_to(self.host, height, self.settings.lift_speed)
            return
        more = height - self._lifted_now()
        if more > 0.0:
            self.host.motion.lift_unhomed(more, self.settings.lift_speed)
            self.lifted, self.lifted_to = height, self._motors_z_now()

    # Counted by the motors, as Z may have been homed and forgotten again, and
    # FORCE_MOVE tells nobody.
    def _lifted_now(self):
        here = self._motors_z_now()
        if not self.lifted or None in (here, self.lifted_to):
            return self.lifted
        return self.lifted + (here - self.lifted_to)

    # The motors count their steps only when those were made.
    def _motors_z_now(self):
        self.host.toolhead.flush_step_generation()
        return self.motors_z()

    # Up for the way to the dock, to the toolhead Z that it returns.  'on_the_way': what
    # is more than to be clear of the bed comes with the first straight line, on which
    # the head is nowhere nearer to a bed askew than at one of its ends.
    def lift_for_dock(self, on_the_way=False):
        settings = self.settings
        height = max(dock_height(settings), self.clear.z)
        is_high = settings.dock_position.z or not settings.dock_fixed_z
        if on_the_way and not is_high and self.is_homed("z"):
            self.lift(max(clear_height(settings), self.clear.z))
        else:
            self.lift(height)
        return height

    # Up or down; z None: stay
    def go_to_height(self, z):
        if z is not None and z != self.host.motion.z():
            speed = self.settings.lift_speed
            self.host.toolhead.manual_move([None, None, z], speed)

    # To the Z of a position, where a dock has a height of its own
    def go_to_z_of(self, position):
        if not self.settings.dock_fixed_z:
            self.go_to_height(position.z)

    ######################################################################
    # To the dock and back
    ######################################################################

    # To X and Y of a position, around the dock; with 'into' also where that is in
    # the circle, otherwise to its edge.  'rise' (toolhead Z): up to it on the first
    # straight line, where the head is lower
    def travel(self, position, speed, into=False, rise=None):
        start, limits = self.position(), self.host.axes.limits()[:2]
        goal = self._within_reach(position, limits)
        self._leave_upwards()
        is_there = into and detour.distance(start, goal) < NEAR_END
        try:
            points = (
                [] if is_there else self._points_around(start[:2], goal, limits)
            )
        except detour.NoDetour:
            raise self.host.error(
                "no way from %.3f, %.3f to %.3f, %.3f around the dock in the"
                " reach of X and Y; move the head away from it, or lower"
                " safe_dock_distance (%.3f)"
                % (start[:2] + goal + (self.zone.radius,))
            )
        for x, y in points + [goal] * into:
            z = self.position().z
            up = None if None in (rise, z) else max(rise, z)
            touching.move_xyz(
                self.host, (x, y, up), speed, self.settings.lift_speed
            )

    # To a place around the dock that anybody may have asked for
    def travel_beside(self, position, speed):
        if self.is_in_dock(position):
            raise self.host.error(
                "%.3f, %.3f is in the dock; MOVE_TO_DOCK_PROBE goes there"
                % (position.x, position.y)
            )
        self.travel(position, speed, into=True)

    # Around the dock; out of the corner where homing has put the head, or back
    # into it, along the way that homing came, where nothing else leads there
    def _points_around(self, start, goal, limits):
        zone, via = self.zone, self.settings.safe_position
        try:
            return detour.around(start, goal, zone, limits, via)
        except detour.NoDetour:
            if self.trace.to(start):
                trace = self.trace.to(start)
                return detour.out_of_corner(
                    start, goal, zone, limits, trace, via
                )
            out = detour.out_of_corner(
                goal, start, zone, limits, self.trace.to(goal), via
            )
            return out[::-1]

    # After homing the head stands a part of a step beyond the limit.
    def _within_reach(self, position, limits):
        steppers = self.host.toolhead.get_kinematics().get_steppers()
        step = max(stepper.get_step_dist() for stepper in steppers)
        step += detour.ROUNDING
        for axis, xy, (low, high) in zip("XY", position, limits):
            if not low - step <= xy <= high + step:
                raise self.host.error(
                    "%s=%.3f is outside of %.3f to %.3f, the reach of the axis;"
                    " choose a place inside" % (axis, xy, low, high)
                )
        return tuple(
            min(max(xy, low), high) for xy, (low, high) in zip(position, limits)
        )

    # Out of a dock that is entered from above the way is up, at first.
    def _leave_upwards(self):
        start = self.position()
        if self.settings.dock_fixed_z or start.z is None:
            return
        if not self.is_in_dock(start):
            return
        for row in POSITIONS:
            position = getattr(self.settings, row.name)
            if self.is_in_dock(position) and position.z is not None:
                self.lift(position.z)

    # From straight above the dock to the edge of the circle, and as far as its
    # nearest position, on the side of the bed: a host that goes on from there goes
    # down at first.
    def leave_top(self):
        start, limits = self.position(), self.host.axes.limits()[:2]
        if not self.is_in_dock(start):
            return
        # It may be hardly above it.
        self._leave_upwards()
        middle = [0.5 * (low + high) for low, high in limits]
        nearest = nearest_distance(self.settings._asdict())
        radius = max(self.zone.radius, nearest)
        radius = radius or min(ASIDE, detour.distance(start, middle))
        if not radius:
            return
        zone = self.zone._replace(radius=radius)
        x, y = detour.find_exit(start, zone, limits, other=middle)
        touching.move_xy(self.host, x, y, self.settings.travel_speed)

    # Whether X and Y are those of the dock itself
    def is_in_dock(self, position):
        return detour.is_in_dock(position, self.zone)

    # Whether the head is in there now, not over a dock that is entered from above
    def stands_in_dock(self):
        position, dock_z = self.position(), self.settings.dock_position.z
        if not self.is_in_dock(position):
            return False
        if self.settings.dock_fixed_z or None in (position.z, dock_z):
            return True
        return position.z < dock_z + detour.SMALLEST_DISTANCE

    # To a position of the dock's, high enough for what hangs on the head.  Of a
    # dock that has a height of its own it may be above the head, where the way
    # up is clear of the dock, and below, where only the place itself is.
    def go_beside(self, position):
        self.require_homed()
        rise = self.lift_for_dock(on_the_way=True)
        if not self.settings.dock_fixed_z and position.z is not None:
            self.lift(position.z)
        self.travel(position, self.settings.travel_speed, into=True, rise=rise)
        self.go_to_z_of(position)

    # Into the dock, straight from a position outside of it.  In there already, by hand
    # or by the owner's G-code a little beside its middle, to that.
    def go_in(self, beside):
        self.require_homed()
        dock, speed = self.settings.dock_position, self.settings.attach_speed
        if not self.is_at(beside) and not self.stands_in_dock():
            self.go_beside(beside)
        self.go_to_z_of(dock)
        touching.move_xy(self.host, dock.x, dock.y, speed)

    # Straight out of the dock to a position, by way of its middle; from elsewhere, also
    # from above it, around the dock.  'is_on_trip': what has lifted the head there is
    # G-code of the owner's that is a part of the way.
    def go_out(self, position, speed, is_on_trip=False):
        self.require_homed()
        is_above = not is_on_trip and not self.stands_in_dock()
        if is_above or not self.is_in_dock(self.position()):
            self.go_beside(position)
            return
        dock = self.settings.dock_position
        touching.move_xy(self.host, dock.x, dock.y, speed)
        self.go_to_z_of(position)
        touching.move_xy(self.host, position.x, position.y, speed)

    # Back over where the head was, and down there, but not lower than 'lowest';
    # 'lowest' None: only over it.  Not back into the dock itself, but to the
    # very place beside it: somebody means to touch there.
    def go_back(self, position, lowest=None):
        self.lift_for_dock()
        into = not self.is_in_dock(position)
        self.travel(position, self.settings.travel_speed, into)
        if None not in (lowest, position.z, self.position().z):
            self.go_to_height(max(position.z, lowest))
