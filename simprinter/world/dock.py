"""Where the detachable probe is, and the moves that change it.

Times are printer seconds; positions world frame, mm.
"""

from __future__ import annotations

import enum
import math
import random
from typing import Callable, Optional, Sequence

from ..faults import Faults
from .lines import Output
from .spec import DockSpec, MagProbeSpec, Vector

# Gauss without end would leave no height above which nothing can be touched
SEAT_SIGMAS = 3.0


class ProbeState(enum.Enum):
    """Where the probe is."""

    ATTACHED = "attached"
    DOCKED = "docked"
    LOST = "lost"


class Holder:
    """The probe's state as a function of time, one change remembered.

    A change may lie ahead (an attaching device needs time), and a level may
    be asked for shortly before it, so both states are known.
    unsettled: settled() has yet to tell of the change.
    """

    __slots__ = ("_before", "_since", "_state", "unsettled")

    def __init__(self, state: ProbeState) -> None:
        self._before = state
        self._state = state
        self._since = -math.inf
        self.unsettled = False

    def at(self, t: float) -> ProbeState:
        """State at time t."""
        return self._state if t >= self._since else self._before

    def held(self, t: float) -> bool:
        """Whether the probe is at the toolhead at time t."""
        state = self._state if t >= self._since else self._before
        return state is ProbeState.ATTACHED

    def change(self, t: float, state: ProbeState, delay: float = 0.0) -> None:
        """From t + delay on the probe is elsewhere."""
        self._before = self.at(t)
        self._state = state
        self._since = t + delay
        self.unsettled = self._before is not state

    def cancel(self, t: float) -> None:
        """Call off a change that lies ahead of time t."""
        if t < self._since:
            self._state = self._before
            self._since = -math.inf
            self.unsettled = False

    def settled(self, t: float) -> Optional[tuple[float, ProbeState]]:
        """A change that has come true since the last call: (time, state)."""
        if not self.unsettled or t < self._since:
            return None
        self.unsettled = False
        return self._since, self._state


class Dock:
    """Watches the toolhead pass through the dock's reach."""

    __slots__ = (
        "_approach",
        "_cosine",
        "_innermost",
        "_is_stripped",
        "_middle",
        "_reach",
        "_release",
        "_spec",
        "_stroke",
        "swing",
    )

    def __init__(self, spec: DockSpec) -> None:
        self._middle: Vector = (spec.x, spec.y, spec.z)
        self._reach = spec.reach
        self._approach = _unit(spec.approach)
        self._release = _unit(spec.release)
        self._cosine = math.cos(math.radians(spec.cone))
        # Up (1) or down (-1) in it strips off where it goes with the toolhead, else 0
        is_upright = spec.lifted and not any(self._release[:2])
        self._stroke = self._release[2] if is_upright else 0.0
        # Whether that was done in this visit: the toolhead is not joined any more
        self._is_stripped = False
        self._spec = spec
        # The output that swings it out, None where it stands still
        self.swing = Output(spec.out_from) if spec.swing else None
        # Nearest pose of the present visit, None while outside
        self._innermost: Optional[Vector] = None

    def _is_out(self, t: float) -> bool:
        swing = self.swing
        return swing is None or (
            swing.on(t) and swing.lasts(t) >= self._spec.swing
        )

    def _swings(self, t: float) -> bool:
        return self.swing is not None and self.swing.lasts(t) < self._spec.swing

    def reaches(self, t: float, pose: Sequence[float]) -> bool:
        """Whether a toolhead at `pose` is joined with a probe in the dock."""
        return self._is_out(t) and self._is_near(pose) and not self._is_stripped

    def _is_near(self, pose: Sequence[float]) -> bool:
        dx = pose[0] - self._middle[0]
        # Nearly always far away: spare the square root
        if dx > self._reach or dx < -self._reach:
            return False
        return self._distance(pose) <= self._reach

    def _distance(self, pose: Sequence[float]) -> float:
        if self._spec.lifted:
            return math.dist(pose[:2], self._middle[:2])
        return math.dist(pose, self._middle)

    def depth(self, t: float, pose: Sequence[float]) -> float:
        """How deep (mm) a toolhead at `pose` is in what holds the probe."""
        spec = self._spec
        dx, dy = pose[0] - spec.x, pose[1] - spec.y
        depth = spec.body - math.hypot(dx, dy)
        if depth <= 0.0 or not (spec.lifted or pose[2] < spec.z + spec.top):
            return 0.0
        if self._swings(t):
            return depth
        if not self._is_out(t):
            return max(0.0, spec.reach - self._distance(pose))
        for ux, uy, _ in (spec.approach, spec.release, *spec.lanes):
            length = math.hypot(ux, uy)
            if not length:
                # Straight up from the middle
                depth = min(depth, math.hypot(dx, dy) - spec.lane)
                if depth <= 0.0:
                    return 0.0
                continue
            along = (dx * ux + dy * uy) / length
            aside = abs(dx * uy - dy * ux) / length - spec.lane
            if along >= -spec.lane and aside <= 0.0:
                return 0.0
            depth = min(depth, max(aside, -along - spec.lane))
        return depth

    def _strips(self, pose: Sequence[float]) -> bool:
        """Whether a toolhead went so far up or down in it that the probe came off."""
        if not self._stroke:
            return False
        if self._innermost is None or self._distance(pose) > self._reach / 2:
            return False
        moved = (pose[2] - self._innermost[2]) * self._stroke
        if moved < 0.0:
            # From here on
            self._innermost = (*self._innermost[:2], pose[2])
        return moved >= self._reach

    def left_towards(
        self, t: float, pose: Sequence[float]
    ) -> Optional[ProbeState]:
        """Commit a pose; says what leaving the reach just now asks for.

        ATTACHED: left in the approach direction, which takes the probe.
        DOCKED: left in the release direction, which strips it off.
        None: did not leave, or left another way.
        The direction is that from the visit's innermost pose.
        """
        deepest = self._innermost
        if self._is_stripped:
            self._is_stripped = self._is_near(pose)
            return None
        if self.reaches(t, pose):
            if self._strips(pose):
                self._innermost, self._is_stripped = None, True
                return ProbeState.DOCKED
            is_nearer = deepest is None or (
                self._distance(pose) <= self._distance(deepest)
            )
            if deepest is not None and self._stroke:
                # The stroke is counted from where it began
                is_nearer = self._distance(pose) < self._distance(deepest)
            if is_nearer:
                self._innermost = (pose[0], pose[1], pose[2])
            return None
        self._innermost = None
        if deepest is None:
            return None
        x, y, z = deepest
        away = _unit((pose[0] - x, pose[1] - y, pose[2] - z))
        if _dot(away, self._approach) >= self._cosine:
            return ProbeState.ATTACHED
        if _dot(away, self._release) >= self._cosine:
            return ProbeState.DOCKED
        return None


class Keeper:
    """A probe's fate: attaching, docking, falling, and their faults.

    tell(t, kind) is called with each event (kinds: truth.ProbeEvent). falls_at:
    sites at whose contacts it may fall. others: those of the same carriage, of
    which that carries one at a time.
    """

    __slots__ = (
        "_at_first",
        "_dock",
        "_falls_from",
        "_faults",
        "_holder",
        "_random",
        "_reseat",
        "_seat",
        "_tell",
        "falls_at",
        "lowest",
        "others",
        "spec",
    )

    def __init__(
        self,
        spec: MagProbeSpec,
        dock: Optional[DockSpec],
        faults: Faults,
        tell: Callable[[float, str], None],
        generator: random.Random,
    ) -> None:
        self.spec = spec
        self.falls_at: Sequence[str] = ()
        self.others: Sequence[Keeper] = ()
        self._at_first = ProbeState(spec.initial)
        self._holder = Holder(self._at_first)
        self._dock = None if dock is None else Dock(dock)
        self._faults = faults
        self._tell = tell
        self._falls_from: Optional[str] = None
        self._random = generator
        self._reseat = spec.reseat
        # It never hangs lower than it should by more (mm)
        self.lowest = SEAT_SIGMAS * spec.reseat
        self._seat = self._draw_seat()

    def seat(self) -> float:
        """How far (mm) it hangs lower than it should."""
        return self._seat

    def _draw_seat(self) -> float:
        if not self._reseat:
            return 0.0
        spread = self._random.gauss(0.0, 1.0)
        return self._reseat * max(-SEAT_SIGMAS, min(SEAT_SIGMAS, spread))

    def at(self, t: float) -> ProbeState:
        """Where the probe is at time t."""
        return self._holder.at(t)

    def held(self, t: float) -> bool:
        """Whether the toolhead carries the probe at time t."""
        return self._holder.held(t)

    def connected(self, t: float, pose: Sequence[float]) -> bool:
        """Whether probe and head are joined, carried or met in the dock."""
        state = self._holder.at(t)
        if state is ProbeState.DOCKED and self._dock is not None:
            return self._dock.reaches(t, pose)
        return state is ProbeState.ATTACHED

    def in_dock(self, t: float, pose: Sequence[float]) -> bool:
        """Whether the probe sits in the dock, joined with the toolhead or not."""
        state = self._holder.at(t)
        if state is ProbeState.ATTACHED and self._dock is not None:
            return self._dock.reaches(t, pose)
        return state is ProbeState.DOCKED

    def observe(self, t: float, pose: Sequence[float]) -> None:
        """Commit a pose."""
        if self._holder.unsettled:
            self._settle(t)
        if self._dock is not None:
            wanted = self._dock.left_towards(t, pose)
            if wanted is not None:
                self.ask(t, wanted, 0.0)

    @property
    def swing(self) -> Optional[Output]:
        """The output that swings the dock out, None where it stands still."""
        return None if self._dock is None else self._dock.swing

    def dock_depth(self, t: float, pose: Sequence[float]) -> float:
        """How deep (mm) a toolhead at `pose` is in the dock's body."""
        return 0.0 if self._dock is None else self._dock.depth(t, pose)

    def ask(self, t: float, wanted: ProbeState, delay: float) -> None:
        """An attempt to attach or dock, done t + delay; may fail.

        Calls off an attempt that is not done yet.
        """
        self._holder.cancel(t)
        state = self._holder.at(t)
        if wanted is ProbeState.ATTACHED:
            origin, fault = ProbeState.DOCKED, "attach_fails"
        else:
            origin, fault = ProbeState.ATTACHED, "dock_fails"
        if state is not origin:
            return
        is_taken = any(other.held(t) for other in self.others)
        if self._faults.fires(fault) or (
            wanted is ProbeState.ATTACHED and is_taken
        ):
            self._tell(t, fault.replace("fails", "failed"))
            return
        self._change(t, wanted, delay)

    def touched(self, t: float, site: str) -> None:
        """Something touched something; only the probe's touches count."""
        if site not in self.falls_at:
            return
        fault = self._faults.fires("probe_falls", site)
        if fault is None:
            return
        if fault.when == "touch":
            self._change(t, ProbeState.LOST, 0.0)
        else:
            self._falls_from = site

    def lifted(self, t: float, site: str) -> None:
        """The probe left what it touched."""
        if self._falls_from == site:
            self._falls_from = None
            self._change(t, ProbeState.LOST, 0.0)

    def lose(self, t: float) -> None:
        """It falls off at time t, not before now, if the toolhead has it then."""
        if self._holder.held(t):
            self._holder.change(t, ProbeState.LOST, 0.0)

    def bring_back(self, t: float) -> None:
        """If it is lost, somebody puts it where it was at first."""
        if self._holder.at(t) is ProbeState.LOST:
            self._holder.change(t, self._at_first, 0.0)

    def put_on(self, t: float) -> None:
        """Somebody puts it on the toolhead, wherever it was."""
        if not self._holder.held(t):
            self._change(t, ProbeState.ATTACHED, 0.0)

    def take_off(self, t: float) -> None:
        """Somebody takes it off the toolhead and lays it where it is kept."""
        if self._holder.held(t):
            self._change(t, ProbeState.DOCKED, 0.0)

    def _change(self, t: float, state: ProbeState, delay: float) -> None:
        self._holder.change(t, state, delay)
        self._settle(t)

    def _settle(self, t: float) -> None:
        change = self._holder.settled(t)
        if change is not None:
            since, state = change
            if state is ProbeState.ATTACHED:
                self._seat = self._draw_seat()
            self._tell(since, _EVENTS[state])


_EVENTS = {
    ProbeState.ATTACHED: "attach",
    ProbeState.DOCKED: "dock",
    ProbeState.LOST: "lost",
}


def _unit(vector: Vector) -> Vector:
    length = math.hypot(*vector)
    return vector[0] / length, vector[1] / length, vector[2] / length


def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
