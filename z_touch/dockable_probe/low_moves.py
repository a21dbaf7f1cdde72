"""Moves of G-code that go down while the probe may be attached.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Optional, Sequence

from .. import attached
from ..attached import DOCKED
from . import path
from .path import Position
from .settings import HIGHER

if TYPE_CHECKING:
    from .carrier import Carrier
    from .probe import DockedProbe


class LowMoves:
    r"""What looks at them: the Watch of host/gcode_moves.py.

    The probe is longer than the nozzle.  A toolhead that G-code takes down to a first layer
    would press it into the bed, all of its length but its travel:

        |_____|  toolhead
         | |  \/                 - - - Z of the toolhead
         |_|       nozzle
          | probe                from z_offset (mm) on it meets the bed
        =========  bed           - - - Z=0

    Only a move that goes down is looked at: a toolhead that is low already was brought there
    by somebody who has looked, or has a Z that homing has made up.  One that has gone down at
    the dock, where macros may, is looked at when it leaves that place without going up.  A
    docking that is to come is made then; otherwise the move is refused.
    """

    def __init__(self, probe: DockedProbe, carrier: Carrier):
        self.host = probe.host
        self.probe = probe
        self.carrier = carrier
        self.attached = attached.of(self.host.printer)
        # Whether G28 is under way, with whatever homing_override does
        self.is_homing = False
        # Whether the user leads a probe that was put on by hand to where its dock is
        self.is_led = False
        # X and Y (mm) where a move has ended that only _is_at_dock() allows, None: none has
        self.let_down_at: Optional[Position] = None

    def is_on(self) -> bool:
        """Return whether there is anything to look at: the probe may be attached."""
        return self.probe.known.is_guarded()

    def _meets_bed(self) -> float:
        """Return from which toolhead Z (mm) on the probe may meet the bed."""
        return self.probe.settings.z_offset + HIGHER

    def leaves_low(
        self, start: Sequence[float], goal: Sequence[float], z: float
    ) -> bool:
        """Return whether a move leaves where the toolhead was let down, and stays low.

        'start' and 'goal' as G-code has them, 'z' the toolhead Z (mm) that it leads to.
        """
        place = self.let_down_at
        return (
            place is not None
            and z < self._meets_bed()
            and path.distance(start, place) < path.ROUNDING
            and path.distance(goal, place) >= path.ROUNDING
        )

    def may_go(self, goal: Sequence[float], z: float) -> bool:
        """Return whether a move to 'z' (toolhead Z, mm) may be made as it is.

        False: the probe is to be docked before.  Raises the host's error otherwise.  May
        pause.  Beside what a paused print has printed the probe may be in the way at any
        height.
        """
        is_paused = self.host.print_state() == "paused"
        is_high = z >= self._meets_bed() and not is_paused
        place = Position(goal[0], goal[1], goal[2])
        if is_high or self._is_known_to(place):
            return True
        if self._is_at_dock(place):
            self.let_down_at = place
            return True
        if self.carrier.state() == DOCKED:
            # Two pins of their own say so: no further look is needed
            self.probe.known.be_told(DOCKED)
            return True
        is_asking = self.attached.is_asking(self.host)
        if self.probe.keeping.is_pending() and not is_asking:
            return False
        what = (
            f"what is printed on the way down to z={goal[2]:.3f}"
            if is_paused
            else f"the bed from z={self._meets_bed():.3f} on; that is higher than"
            f" z={goal[2]:.3f}"
        )
        raise self.host.error(
            f"the probe may be on the toolhead ({self.carrier.reads()}), and may meet"
            f" {what}; run DETACH_PROBE first"
        )

    def make_way(self) -> None:
        """Dock the probe, the toolhead then just where it was.  May pause."""
        self.probe.dock_and_come_back()

    def _is_known_to(self, goal: Position) -> bool:
        """Return whether what moves the toolhead knows what is attached.

        Homing, a trip, a measurement with the user's G-code, a person with paper or who leads
        the probe to its dock, or what stays in the dock.
        """
        moves = self.probe.moves
        return (
            self.is_homing
            or self.probe.dock.underway.is_any()
            or not self.probe.settings.is_placed
            or self.attached.is_measuring()
            or self._is_by_hand()
            or (moves.stands_in_dock() and moves.is_in_dock(goal))
        )

    def _is_by_hand(self) -> bool:
        """Return whether a person moves the toolhead, with paper or by our set-up."""
        if self.host.print_state():
            # A printer that prints has a clear bed
            return False
        is_led = self.is_led and self.host.section in self.attached.questions
        return is_led or self.host.probing.is_manual_probing()

    def _is_at_dock(self, goal: Position) -> bool:
        """Return whether a move goes to where macros dock that do without our trips.

        To the dock or one of its positions; without a print, where no trips are made by
        themselves, to anywhere in the circle, which may reach over the bed.  A print has
        nothing to do there, unless its macros go to the positions.
        """
        auto, is_printing = self.probe.keeping.auto, self.host.print_state()
        if is_printing and auto:
            return False
        moves = self.probe.moves
        if not (is_printing or auto) and path.is_inside(goal, moves.zone):
            return True
        return moves.is_in_dock(goal) or any(
            path.distance(goal, position) < path.ROUNDING
            for position in self.probe.settings.positions.values()
        )
