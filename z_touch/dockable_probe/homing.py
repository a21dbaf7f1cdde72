"""Homing, with the probe and without it.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Optional, Sequence, Tuple

from ..attached import DOCKED

if TYPE_CHECKING:
    from ..host.own_probe import Installed
    from .height import Height
    from .path import Position
    from .probe import DockedProbe
    from .settings import Settings

# Homing goes down twice: to find the bed, and slowly again from a little above.
FIRST, SECOND = "first", "second"

# The second way down of homing ends so far (mm) below the first trigger.
SECOND_REACH = 1.0


class ZHoming:
    """How Z is homed with the probe: where, and how far down."""

    def __init__(self, height: Height, settings: Settings):
        self.height = height
        self.settings = settings
        # Where the toolhead stands meanwhile, as klippy finds when it connects; None: where
        # it is then
        self.xy: Optional[Tuple[float, float]] = None
        # The way down that comes next, None where Z is not being homed
        self.way: Optional[str] = None

    def begin(self, is_homing: bool) -> None:
        """Note that a command begins that probes."""
        self.way = FIRST if is_homing else None

    def end(self) -> bool:
        """Note that it has ended; return whether it was homing."""
        was_homing, self.way = self.way is not None, None
        return was_homing

    def goal(self, position: Position) -> Position:
        """Return where the toolhead is to be for it."""
        if self.way is None or self.xy is None:
            return position
        return position._replace(x=self.xy[0], y=self.xy[1])

    def reach(self) -> Optional[float]:
        """Return how far (mm) below z_offset the way down may go that begins now.

        At first as deep as any touch, then hardly deeper than the first one.  It is counted
        by the motors, as homing and others say of Z what they like.  None: nothing tells how
        high the toolhead is.
        """
        motors_z, homed_z = self.height.motors_z(), self.height.homed_z
        if motors_z is None or homed_z is None:
            return None
        beyond = SECOND_REACH
        if self.way == FIRST:
            beyond = self.settings.z_offset - self.settings.lowest
        return motors_z - homed_z + beyond

    def met_bed(self) -> None:
        """Note that the way down has ended on the bed.

        Touches elsewhere tell nothing of how high the bed is: there it may be much higher, or
        the gantry lower.
        """
        self.height.note_bed()
        self.way = SECOND


class BeforeHoming:
    """What is done about the probe before axes are homed that do not need it."""

    def __init__(
        self, probe: DockedProbe, installed: Installed, is_lifted: bool
    ):
        """'is_lifted': the user lifts the toolhead before X and Y are homed."""
        self.host = probe.host
        self.probe = probe
        self.installed = installed
        self.is_lifted = is_lifted
        register = self.host.printer.register_event_handler
        register("homing:home_rails_begin", self._before_xy)
        register("homing:home_rails_begin", self._before_z)

    def docks_before_z(self) -> bool:
        """Return whether the probe is docked before Z is homed."""
        wanted = self.probe.settings.detach_dockable_before_z_home
        return not self.installed.is_z_endstop() if wanted is None else wanted

    def _may_be_on(self, state: str) -> bool:
        return state != DOCKED or self.probe.sensors.is_doubtful()

    def _before_xy(self, _homing_state: Any, rails: Sequence[Any]) -> None:
        """Lift an attached probe, which may be lower than the bed, as Z is not known yet."""
        if self.is_lifted or self.host.axes.homed_axis(rails) is None:
            return
        if self._may_be_on(self.probe.sensors.confirm()):
            self.probe.moves.lift(self.probe.settings.travel_z)

    def _before_z(self, homing_state: Any, _rails: Sequence[Any]) -> None:
        """Dock it where Z is homed without it, as it may be in the way."""
        is_z, homes_z = (
            2 in homing_state.get_axes(),
            self.installed.is_z_endstop(),
        )
        if not self.docks_before_z() or not is_z or homes_z:
            return
        # Without X and Y it cannot be docked, which is said where it is not
        is_on = self._may_be_on(self.probe.sensors.look())
        if self.host.is_homed("xy") or is_on:
            self.probe.dock_and_come_back()
