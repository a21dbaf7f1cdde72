"""Signals to the board and outputs from it, with the faults of a signal.

A level is True when the signal is asserted ("triggered", "present").
"""

from __future__ import annotations

import math
from typing import Callable, Optional, Sequence

from ..faults import Fault, Faults
from .sensors import TouchState
from .sites import Poses, Tracked

PoseLevel = Callable[[float, Poses], bool]

# Two ways to compute one moment may differ by this (s)
_ROUNDING = 1e-6


_STUCK = ("stuck_open", "stuck_closed")


class Line:
    """One signal: its true level unless it is stuck.

    latency: seconds from the physical change to the board's pin.
    sites: those that assert it.
    """

    __slots__ = (
        "_awaited",
        "_lasting",
        "_level",
        "_since",
        "_state",
        "_stuck",
        "latency",
        "name",
        "sites",
    )

    def __init__(
        self,
        name: str,
        level: PoseLevel,
        state: Optional[TouchState] = None,
        latency: float = 0.0,
        sites: Sequence[Tracked] = (),
    ) -> None:
        self.name = name
        self.latency = latency
        self.sites = tuple(sites)
        self._level = level
        self._state = state
        # (from time t on, at this level), and what of it stays
        self._stuck = self._lasting = (math.inf, False)
        # A move looks for a touch since then; what sticks if it is there
        self._since = math.inf
        self._awaited: list[tuple[Tracked, Fault]] = []

    def expect(self, faults: Faults) -> float:
        """Learn of faults by time; seconds of the first, or infinity."""
        low = faults.begins("stuck_open", self.name)
        high = faults.begins("stuck_closed", self.name)
        first = min((low, False), (high, True))
        self._lasting = min(self._lasting, first)
        self._stuck = min(self._stuck, first)
        return first[0]

    def mend(self) -> None:
        """What faults have done to it is over."""
        self._stuck = self._lasting = (math.inf, False)
        self._awaited = []
        if self._state is not None:
            self._state.mend()
        for site in self.sites:
            site.mend()

    def level(self, t: float, poses: Poses) -> bool:
        """Level at time t for a toolhead that is there; changes nothing."""
        if t >= self._stuck[0]:
            return self._stuck[1]
        if self._awaited:
            fault = self._sticks(t, poses)
            if fault is not None:
                return fault.name == "stuck_closed"
        return self._level(t, poses)

    def arm(self, t: float, faults: Faults) -> None:
        """A homing or probing operation starts on this signal."""
        self._stuck = self._lasting
        self._since = t
        for name in _STUCK:
            fault = faults.fires(name, self.name)
            if fault is not None:
                self._stick(fault)
        early = faults.fires("trigger_early", self.name)
        late = faults.fires("trigger_late", self.name)
        never = faults.fires("trigger_never", self.name)
        if self._state is not None:
            distance = 0.0 if early is None else early.mm
            distance -= 0.0 if late is None else late.mm
            self._state.arm(distance, never is not None)
        for site in self.sites:
            site.sought = True
        self.expect_touches(faults)

    def expect_touches(self, faults: Faults) -> None:
        """Learn what is wrong with the touches that are sought."""
        self._awaited = []
        for site in self.sites:
            if not site.sought:
                continue
            site.expect(faults)
            for name in _STUCK:
                fault = faults.at_next_touch(name, site.name)
                if fault is not None:
                    self._awaited.append((site, fault))

    def disarm(self) -> None:
        """That operation has ended."""
        self._awaited = []
        for site in self.sites:
            site.sought = False

    def observe(self, t: float, poses: Poses, faults: Faults) -> None:
        """Commit poses: it sticks if that is the touch which does it."""
        fault = self._sticks(t, poses) if self._awaited else None
        if fault is None:
            return
        self._awaited = []
        self._stick(fault)
        faults.strikes(fault)
        if fault.name == "stuck_closed":
            # More than this is not met
            for site in self.sites:
                if site.name == fault.subject and site.sought:
                    site.sought = False
                    faults.touched(site.name)

    def _sticks(self, t: float, poses: Poses) -> Optional[Fault]:
        """The fault that a toolhead that is there would have it stick by."""
        # Times of clocks are rounded
        if t < self._since - _ROUNDING:
            return None
        for site, fault in self._awaited:
            if site.is_below(t, poses):
                return fault
        return None

    def _stick(self, fault: Fault) -> None:
        state = (self._since, fault.name == "stuck_closed")
        self._stuck = min(self._stuck, state)
        if fault.persistent:
            self._lasting = min(self._lasting, state)


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
