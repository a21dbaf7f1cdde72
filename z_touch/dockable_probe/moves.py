"""Moves of the toolhead: around the dock, into it, and out of it.

What moves may pause.  "To the dock" is to one of its positions, which may lie in the circle
around it.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List, Optional, Sequence

from .. import touch
from . import path
from .path import Position
from .settings import nearest_distance

if TYPE_CHECKING:
    from ..host.printer import Host
    from .height import Height
    from .settings import Settings

# From above a dock that all positions are above the toolhead goes so far (mm) aside.
ASIDE = 40.0

# A place so near (mm) is where homing has left the toolhead: hosts correct it by part of a
# step after the event that tells the end.
NEAR_END = 0.5


class Moves:
    """The toolhead and one dock."""

    def __init__(self, host: Host, settings: Settings, height: Height):
        self.host = host
        self.settings = settings
        self.zone = settings.zone
        self.height = height

    ######################################################################
    # Where the toolhead is
    ######################################################################

    def is_way_known(self) -> bool:
        """Return whether the axes are homed that lead to the dock."""
        axes = "xy" if self.settings.dock_fixed_z else "xyz"
        return self.settings.is_placed and self.host.is_homed(axes)

    def require_homed(self, axes: Optional[str] = None) -> None:
        """Raise the host's error unless the axes are homed that lead to the dock, or these."""
        if not self.settings.is_placed:
            raise self.host.error(
                "nothing says where the dock is; run DOCKABLE_PROBE_SETUP, which"
                " needs X and Y homed: G28 X Y is possible, also with the probe on"
            )
        axes = axes or ("xy" if self.settings.dock_fixed_z else "xyz")
        missing = [a.upper() for a in axes if not self.host.is_homed(a)]
        if missing:
            raise self.host.error(
                f"not homed: {', '.join(missing)}; the way to the dock is not known"
                f" before; home first (G28 {' '.join(missing)})"
            )

    def position(self) -> Position:
        """Return where the toolhead is; Z is None where it is not homed."""
        x, y, z = self.host.toolhead.get_position()[:3]
        return Position(x, y, z if self.host.is_homed("z") else None)

    def is_at(self, position: Position) -> bool:
        """Return whether X and Y are there."""
        return path.distance(self.position(), position) < path.ROUNDING

    def is_at_detach(self) -> bool:
        """Return whether the toolhead is where a docking without a way back ends."""
        settings = self.settings
        return settings.is_placed and self.is_at(settings.detach_position)

    def is_in_dock(self, position: path.Place) -> bool:
        """Return whether X and Y are those of the dock itself."""
        return path.is_in_dock(position, self.zone)

    def stands_in_dock(self) -> bool:
        """Return whether the toolhead is in there now, not over a dock entered from above."""
        position, dock_z = self.position(), self.settings.dock_position.z
        if not self.is_in_dock(position):
            return False
        if self.settings.dock_fixed_z or position.z is None or dock_z is None:
            return True
        return position.z < dock_z + path.SMALLEST_DISTANCE

    def is_near_dock(self) -> bool:
        """Return whether the toolhead is in the circle, or at a position of the dock."""
        is_near = path.is_inside(self.position(), self.zone)
        return is_near or any(
            self.is_at(position)
            for position in self.settings.positions.values()
            if not self.is_in_dock(position)
        )

    ######################################################################
    # Up and down
    ######################################################################

    def lift(self, z: float) -> None:
        """Lift to z (mm), never down; see Height.lift()."""
        self.height.lift(z, self.settings.lift_speed)

    def lift_for_dock(self, on_the_way: bool = False) -> float:
        """Lift for the way to the dock; return its toolhead Z (mm).

        'on_the_way': what is more than to be clear of the bed comes with the first straight
        line, on which the toolhead is nowhere nearer to a bed askew than at one of its ends.
        """
        settings, clear_z = self.settings, self.height.clear_z
        z = max(settings.way_z, clear_z)
        if on_the_way and not self._is_high() and self.host.is_homed("z"):
            self.lift(max(settings.clear_z, clear_z))
        else:
            self.lift(z)
        return z

    def _is_high(self) -> bool:
        """Return whether the dock has a height of its own."""
        settings = self.settings
        return bool(settings.dock_position.z or not settings.dock_fixed_z)

    def go_to_height(self, z: Optional[float]) -> None:
        """Move up or down to z (mm); None: stay."""
        if z is not None and z != self.host.motion.z():
            speed = self.settings.lift_speed
            self.host.toolhead.manual_move([None, None, z], speed)

    def _go_to_z_of(self, position: Position) -> None:
        """Move to the Z of a position, where a dock has a height of its own."""
        if not self.settings.dock_fixed_z:
            self.go_to_height(position.z)

    ######################################################################
    # Around the dock
    ######################################################################

    def travel(
        self,
        position: Position,
        speed: float,
        into: bool = False,
        rise: Optional[float] = None,
        sink: Optional[float] = None,
    ) -> None:
        """Move to X and Y of a position around the dock.

        With 'into' also where that is in the circle, otherwise to its edge.  'rise' (toolhead
        Z, mm): up to it on the first straight line, where the toolhead is lower; 'sink': to it
        on the last one.
        """
        start, limits = self.position(), self.host.axes.limits()[:2]
        goal = self._within_reach(position, limits)
        self._leave_upwards()
        is_there = into and path.distance(start, goal) < NEAR_END
        points: List[path.Point] = []
        try:
            if not is_there:
                via = self.settings.safe_position
                points = path.around(start[:2], goal, self.zone, limits, via)
        except path.NoWay:
            raise self.host.error(
                f"no way from {start.x:.3f}, {start.y:.3f} to {goal[0]:.3f},"
                f" {goal[1]:.3f} around the dock in the reach of X and Y; move the"
                " toolhead away from it, or lower safe_dock_distance"
                f" ({self.zone.radius:.3f})"
            )
        # Beside the circle the way ends there anyway
        ends = points and path.distance(points[-1], goal) < path.ROUNDING
        way = points + [goal] * (into and not ends)
        for number, (x, y) in enumerate(way, 1):
            z = self.position().z
            if rise is not None and z is not None:
                z = max(rise, z)
            if sink is not None and number == len(way):
                z = sink
            touch.move_xyz(
                self.host, (x, y, z), speed, self.settings.lift_speed
            )

    def travel_beside(self, position: Position, speed: float) -> None:
        """Move around the dock to a place that anybody may have asked for."""
        if self.is_in_dock(position):
            raise self.host.error(
                f"{position.x:.3f}, {position.y:.3f} is in the dock;"
                " MOVE_TO_DOCK_PROBE goes there"
            )
        self.travel(position, speed, into=True)

    def _within_reach(
        self, position: Position, limits: path.Limits
    ) -> path.Point:
        """Return X and Y of a position; after homing it is part of a step out of reach."""
        steppers = self.host.toolhead.get_kinematics().get_steppers()
        step = max(stepper.get_step_dist() for stepper in steppers)
        step += path.ROUNDING
        xy = position.x, position.y
        for axis, at, (low, high) in zip("XY", xy, limits):
            if not low - step <= at <= high + step:
                raise self.host.error(
                    f"{axis}={at:.3f} is outside of {low:.3f} to {high:.3f}, the"
                    " reach of the axis; choose a place inside"
                )
        x, y = (min(max(at, low), high) for at, (low, high) in zip(xy, limits))
        return x, y

    def _leave_upwards(self) -> None:
        """Lift out of a dock that is entered from above, at first."""
        start = self.position()
        if self.settings.dock_fixed_z or start.z is None:
            return
        if not self.is_in_dock(start):
            return
        for position in self.settings.positions.values():
            if self.is_in_dock(position) and position.z is not None:
                self.lift(position.z)

    def leave_top(self) -> None:
        """Move away from straight above the dock.

        To the edge of the circle, and as far as its nearest position, on the side of the bed:
        a host that goes on from there goes down at first.
        """
        start, limits = self.position(), self.host.axes.limits()[:2]
        if not self.is_in_dock(start):
            return
        # It may be hardly above it
        self._leave_upwards()
        x, y = (0.5 * (low + high) for low, high in limits)
        places = {"dock_position": self.settings.dock_position}
        nearest = nearest_distance({**places, **self.settings.positions})
        radius = max(self.zone.radius, nearest)
        radius = radius or min(ASIDE, path.distance(start, (x, y)))
        if not radius:
            return
        zone = self.zone._replace(radius=radius)
        exit_x, exit_y = path.find_exit(start[:2], zone, limits, other=(x, y))
        touch.move_xy(self.host, exit_x, exit_y, self.settings.travel_speed)

    def make_way_for_homing(self, axes: Sequence[int]) -> bool:
        """Move to where homing these axes (0: X) does not pass the dock.

        Rather for both axes: the other one may be homed next, from where this ends.  Returns
        whether there is such a place.
        """
        ends = self.host.axes.xy_ends()
        wanted = {axis: end for axis, end in ends.items() if axis in axes}
        if not wanted:
            return False
        start, limits = self.position(), self.host.axes.limits()[:2]
        via = self.settings.safe_position
        for lines in (ends, wanted):
            if path.is_clear_for_homing(start, lines, self.zone):
                return True
            for x, y in path.places_for_homing(start, lines, self.zone, limits):
                try:
                    path.around(start[:2], (x, y), self.zone, limits, via)
                except path.NoWay:
                    continue
                self.go_beside(Position(x, y, None))
                return True
        return False

    ######################################################################
    # To the dock and back
    ######################################################################

    def go_beside(self, position: Position) -> None:
        """Move to a position of the dock, high enough for an attached probe.

        Of a dock that has a height of its own it may be above the toolhead, where the way up
        is clear of the dock, and below, where only the place itself is.
        """
        self.require_homed()
        rise = self.lift_for_dock(on_the_way=True)
        if not self.settings.dock_fixed_z and position.z is not None:
            self.lift(position.z)
        self.travel(position, self.settings.travel_speed, into=True, rise=rise)
        self._go_to_z_of(position)

    def go_in(self, beside: Position) -> None:
        """Move straight into the dock from a position outside of it.

        In there already, by hand or by the user's G-code a little beside its middle, to that.
        """
        self.require_homed()
        dock, speed = self.settings.dock_position, self.settings.attach_speed
        if not self.is_at(beside) and not self.stands_in_dock():
            self.go_beside(beside)
        self._go_to_z_of(dock)
        touch.move_xy(self.host, dock.x, dock.y, speed)

    def go_out(
        self, position: Position, speed: float, is_on_trip: bool
    ) -> None:
        """Move straight out of the dock to a position, by way of its middle.

        From elsewhere, also from above it, around the dock.  'is_on_trip': what has lifted the
        toolhead there is G-code of the user that is a part of the way.
        """
        self.require_homed()
        is_above = not is_on_trip and not self.stands_in_dock()
        if is_above or not self.is_in_dock(self.position()):
            self.go_beside(position)
            return
        dock = self.settings.dock_position
        touch.move_xy(self.host, dock.x, dock.y, speed)
        self._go_to_z_of(position)
        touch.move_xy(self.host, position.x, position.y, speed)

    def go_back(
        self, position: Position, lowest: Optional[float] = None
    ) -> None:
        """Move back over where the toolhead was, and down there, no lower than 'lowest' (mm).

        'lowest' None: only over it, clear of the bed with the probe on.  Not back into the
        dock itself, but to the very place beside it: something is to be touched there.
        """
        z = position.z if self.host.is_homed("z") else None
        if not self.is_at(position):
            self.lift_for_dock()
            into, sink = not self.is_in_dock(position), None
            if z is not None and not self._is_high():
                # As it came, see lift_for_dock()
                sink = max(z, self.settings.clear_z, self.height.clear_z)
            self.travel(position, self.settings.travel_speed, into, sink=sink)
        if lowest is not None and z is not None:
            self.go_to_height(max(z, lowest))
