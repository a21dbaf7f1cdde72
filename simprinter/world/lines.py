"""Signals to the board and outputs from it, with the faults of a signal.

A level is True when the signal is asserted ("triggered", "present").
"""

from __future__ import annotations

import math
from typing import Callable, Optional, Sequence

from ..faults import Faults
from .sensors import TouchState

PoseLevel = Callable[[float, Sequence[float]], bool]


class Line:
    """One signal: its true level unless it is stuck.

    latency: seconds from the physical change to the board's pin.
    """

    __slots__ = ("_level", "_state", "_stuck", "_timed", "latency", "name")

    def __init__(
        self,
        name: str,
        level: PoseLevel,
        state: Optional[TouchState] = None,
        latency: float = 0.0,
    ) -> None:
        self.name = name
        self.latency = latency
        self._level = level
        self._state = state
        self._timed = (math.inf, False)
        # (from time t on, at this level)
        self._stuck = self._timed

    def expect(self, faults: Faults) -> float:
        """Learn of faults by time; seconds of the first, or infinity."""
        low = faults.begins("stuck_open", self.name)
        high = faults.begins("stuck_closed", self.name)
        self._timed = self._stuck = min((low, False), (high, True))
        return self._timed[0]

    def mend(self) -> None:
        """What faults have done to a touch is over."""
        if self._state is not None:
            self._state.mend()

    def level(self, t: float, pose: Sequence[float]) -> bool:
        """Level at time t for a head at `pose`; changes nothing."""
        if t >= self._stuck[0]:
            return self._stuck[1]
        return self._level(t, pose)

    def arm(self, t: float, faults: Faults) -> None:
        """A homing or probing operation starts on this signal."""
        low = faults.fires("stuck_open", self.name)
        high = faults.fires("stuck_closed", self.name)
        early = faults.fires("trigger_early", self.name)
        late = faults.fires("trigger_late", self.name)
        never = faults.fires("trigger_never", self.name)
        self._stuck = self._timed
        if low is not None or high is not None:
            self._stuck = min(self._timed, (t, low is None))
        if self._state is not None:
            distance = 0.0 if early is None else early.mm
            distance -= 0.0 if late is None else late.mm
            self._state.arm(distance, never is not None)


class Output:
    """A board output as the world sees it: on from a part of its range.

    The value before the last edge is kept, as levels are asked for with a
    latency.
    """

    __slots__ = ("_before", "_least", "_on", "_since")

    def __init__(self, least: float = 0.5) -> None:
        self._least = least
        self._on = False
        self._before = False
        self._since = -math.inf

    def set(self, t: float, value: float) -> bool:
        """Take over a value 0..1; returns whether this was an edge."""
        on = value >= self._least
        if on == self._on:
            return False
        self._before, self._on, self._since = self._on, on, t
        return True

    def on(self, t: float) -> bool:
        """Whether it is on at time t."""
        return self._on if t >= self._since else self._before

    def lasts(self, t: float) -> float:
        """For how long (s) it has been as it is at time t."""
        return t - self._since if t >= self._since else math.inf
