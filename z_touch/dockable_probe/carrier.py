"""The probe as others have to mind it: what lowers the nozzle, and moves of G-code.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Sequence

from .. import attached, touch
from ..attached import DOCKED, UNKNOWN
from . import path
from .path import Position
from .settings import HIGHER

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


class LowMoves:
    r"""What moves of G-code may do while the probe may be attached.

    The probe is longer than the nozzle.  A toolhead that G-code takes down to a first layer
    would press it into the bed, all of its length but its travel:

        |_____|  toolhead
         | |  \/                 - - - Z of the toolhead
         |_|       nozzle
          | probe                from z_offset (mm) on it meets the bed
        =========  bed           - - - Z=0

    Only a move that goes down is looked at: a toolhead that is low already was brought there
    by somebody who has looked, or has a Z that homing has made up.  A docking that is to come
    is made then; otherwise the move is refused.
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

    def is_on(self) -> bool:
        """Return whether there is anything to look at: the probe may be attached."""
        return self.probe.known.may_be_on

    def _meets_bed(self) -> float:
        """Return from which toolhead Z (mm) on the probe may meet the bed."""
        return self.probe.settings.z_offset + HIGHER

    def may_go(self, goal: Sequence[float], z: float) -> bool:
        """Return whether a move down to 'z' (toolhead Z, mm) may be made as it is.

        False: the probe is to be docked before.  Raises the host's error otherwise.  May
        pause.  Beside what a paused print has printed the probe may be in the way at any
        height.
        """
        is_paused = self.host.print_state() == "paused"
        is_high = z >= self._meets_bed() and not is_paused
        if is_high or self._is_known_to(goal):
            return True
        if self.carrier.state() == DOCKED:
            # Two pins of their own say so: nobody need look again
            self.probe.known.be_told(DOCKED)
            return True
        if self.probe.keeping.is_pending() and not self._is_asking():
            return False
        what = (
            f"what is printed on the way down to z={goal[2]:.3f}"
            if is_paused
            else f"the bed from z={self._meets_bed():.3f} on; that is higher than"
            f" z={goal[2]:.3f}"
        )
        raise self.host.error(
            f"the probe may be on the head ({self.carrier.reads()}), and may meet"
            f" {what}; run DETACH_PROBE first"
        )

    def make_way(self) -> None:
        """Dock the probe, the toolhead then just where it was.  May pause."""
        self.probe.dock_and_come_back()

    def _is_known_to(self, goal: Sequence[float]) -> bool:
        """Return whether what moves the toolhead knows what is attached.

        Homing, a trip, a measurement with the user's G-code, somebody who leads the probe to
        its dock, or who goes there.
        """
        return (
            self.is_homing
            or self.probe.dock.underway.is_any()
            or not self.probe.settings.is_placed
            or self.attached.is_measuring()
            or (self.is_led and self._is_asking())
            or self._is_at_dock(Position(goal[0], goal[1], goal[2]))
        )

    def _is_asking(self) -> bool:
        # Whoever prints has cleared the bed
        is_asking = self.attached.is_asking(self.host)
        return is_asking and not self.host.print_state()

    def _is_at_dock(self, goal: Position) -> bool:
        """Return whether a move stays in the dock, or goes to one of its positions.

        A print has nothing to do at those, but for macros that do without our trips: the
        circle may reach over the bed.
        """
        moves, positions = self.probe.moves, self.probe.settings.positions
        if moves.stands_in_dock() and moves.is_in_dock(goal):
            return True
        if self.host.print_state() and self.probe.keeping.auto:
            return False
        return path.is_inside(goal, moves.zone) or any(
            path.distance(goal, position) < path.ROUNDING
            for position in positions.values()
        )
