"""A link in what moves of G-code pass before they reach the toolhead.

    G1, arcs, RESTORE_GCODE_STATE, baby steps -> links of the host and ours -> toolhead

The host calls such a link a move transform, and gcode_move.set_move_transform() is its own
way to add one: exclude_object, skew_correction, tuning_tower and z_thermal_adjust do so.  There
is no other way to see a move before it is made: G1 may be a macro's, arcs and restored
states send no command.  It is on each host since the package of 2023, and one that is in the
chain may be found in the `next` of others, so this one is never removed.

Moves of modules (probing, homing, trips to a dock) do not come here.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, List, Protocol, Sequence

if TYPE_CHECKING:
    from .printer import Host

# A move that goes down by less (mm) is rounding
NO_WAY_DOWN = 1e-3


class Watch(Protocol):
    """What looks at moves of G-code that go down, and at some others."""

    def is_on(self) -> bool:
        """Return whether there is anything to look at; asked at each move."""

    def leaves_low(
        self, start: Sequence[float], goal: Sequence[float], z: float
    ) -> bool:
        """Return whether may_go() is asked of a move that does not go down, too.

        'start' and 'goal' are X, Y and Z (mm) as G-code has them, 'z' the toolhead Z that it
        leads to.
        """

    def may_go(self, goal: Sequence[float], z: float) -> bool:
        """Return whether a move may be made now; raise the host's error: never.

        'goal' is X, Y and Z (mm) as G-code has it, 'z' the toolhead Z that it leads to.  May
        pause.
        """

    def make_way(self) -> None:
        """Do what has to be done before it, the toolhead then where it was.  May pause."""


class GcodeMoves:
    """The link; from klippy:ready on it is in the chain for good."""

    def __init__(self, host: Host, watch: Watch):
        self.host = host
        self.watch = watch
        # The next link, at last the toolhead
        self.next: Any = None
        # What is in the chain for good is there then
        host.printer.register_event_handler("klippy:ready", self._join)

    def _join(self) -> None:
        gcode_move = self.host.gcode_state.gcode_move()
        self.next = gcode_move.set_move_transform(self, force=True)

    def get_position(self) -> List[float]:
        """Return where the toolhead is as G-code has it."""
        position: List[float] = self.next.get_position()
        return position

    def move(self, newpos: Sequence[float], speed: float) -> None:
        """Move to X, Y, Z and E (mm) at a speed (mm/s).  May pause."""
        if not self.watch.is_on() or self._may_go(newpos):
            self.next.move(newpos, speed)
            return
        goal = list(newpos)
        gcode_move = self.host.gcode_state.gcode_move()
        # The host counts from there already, and so would G-code that runs now
        gcode_move.reset_last_position()
        self.watch.make_way()
        self.next.move(goal, speed)
        gcode_move.reset_last_position()

    def _may_go(self, newpos: Sequence[float]) -> bool:
        start = self.next.get_position()
        down = start[2] - newpos[2]
        z = self.host.toolhead.get_position()[2] - down
        if down < NO_WAY_DOWN and not self.watch.leaves_low(start, newpos, z):
            return True
        return self.watch.may_go(newpos, z)
