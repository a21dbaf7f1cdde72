"""The probe as what lowers the nozzle has to mind it.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .. import attached, touch
from ..attached import DOCKED, UNKNOWN
from . import path
from .path import Position

if TYPE_CHECKING:
    from .probe import DockedProbe


class Carrier:
    """Where the probe is, and its way onto the toolhead and off it: an attached.Carrier."""

    def __init__(self, probe: DockedProbe):
        self.host = probe.host
        self.probe = probe
        self.moves = probe.moves
        self.sensors = probe.sensors
        attached.of(self.host.printer).join(self)

    @property
    def auto(self) -> bool:
        """Whether it goes to the dock by itself."""
        return self.probe.keeping.auto

    def state(self) -> str:
        """Return ATTACHED, DOCKED or UNKNOWN, the toolhead standing.  May pause.

        Docked by 'pin' alone may be attached, and pressed: then the toolhead is lifted for a
        second look, and comes back where it is docked.
        """
        sensors, moves = self.sensors, self.moves
        state, z = sensors.look(), moves.position().z
        is_certain = self.probe.known.proven == DOCKED or sensors.senses
        clear_z = self.probe.settings.travel_z
        if state != DOCKED or is_certain or z is None or z >= clear_z:
            return self._believed(state)
        moves.lift(clear_z)
        state = self._believed(sensors.look())
        if state == DOCKED:
            moves.go_to_height(z)
        return state

    def _believed(self, state: str) -> str:
        """Return UNKNOWN for a probe that nothing has docked: its wire may be broken."""
        is_doubtful = state == DOCKED and self.sensors.is_doubtful()
        return UNKNOWN if is_doubtful else state

    def reads(self) -> str:
        """Return what that follows from, in words."""
        return self.sensors.describe()

    def dock_and_come_back(self) -> None:
        """Dock the probe, the toolhead then just where it was; or raise.  May pause."""
        self.probe.dock_and_come_back()

    def dock_pending(self) -> None:
        """Dock now, where that was to happen in a while.  May pause."""
        self.probe.keeping.hurry()

    def mark(self) -> object:
        """Return what is_put_on() compares with.

        ATTACH_PROBE says that the probe is put on, also where it was already; a delayed
        docking, that it is not.
        """
        return self.probe.keeping.times_held

    def is_put_on(self, mark: object, was_docked: bool) -> bool:
        """Return whether the user has attached the probe to stay since a mark was made."""
        keeping = self.probe.keeping
        if keeping.is_held:
            return was_docked or keeping.times_held != mark
        is_free = not keeping.is_pending()
        return was_docked and is_free and self.state() != DOCKED

    def fetch(self) -> None:
        """Attach the probe, to stay; or raise.  May pause."""
        self.host.gcode.run_script_from_command("ATTACH_PROBE")

    def go_to(self, x: float, y: float, speed: float) -> None:
        """Move around the dock, and to the very place.

        One in the circle that the user has chosen is reached straight where the way comes no
        nearer to the dock than its ends do.
        """
        start, goal = self.moves.position(), Position(x, y, None)
        zone = self.moves.zone
        nearest = min(path.distance(start, zone), path.distance(goal, zone))
        least = path.least_distance(start, goal, zone)
        if path.is_inside(goal, zone) and least > nearest - path.ROUNDING:
            touch.move_xy(self.host, x, y, speed)
        else:
            self.moves.travel(goal, speed, into=True)
