"""What really happened: for tests only, nothing of it reaches a host.

World frame, mm, seconds.  Depths are positive downward, beyond the trigger
height of that moment (noise and thermal growth included).  Sites:

    nozzle_pin   nozzle tip on the Z pin        body_pin  probe body on it
    probe_bed    probe plunger on the plate     body_bed  its body on the plate
    nozzle_bed   nozzle tip on the plate        nozzle_membrane
    inductive_bed, and the axis switches by their signal names
    nozzle_SIGNAL, body_SIGNAL: on another pin or membrane than the first
    dock         the toolhead in what holds the probe
    SIGNAL_bed, SIGNAL_body_bed, SIGNAL_body_pin and so on, SIGNAL_dock: of another
                 detachable probe than the first, by its signal
    second_nozzle_bed and the like: the nozzle of the second carriage there
    carriages    the second carriage against the first
"""

from __future__ import annotations

import math
from typing import Callable, Mapping, NamedTuple, Optional

from .kinematics import Pose

# Two sums of the same numbers may differ by this much (mm)
ROUNDING = 1e-6


class Touch(NamedTuple):
    """A switch or surface was pressed.

    x, y, z: pose of that nozzle's carriage at the commit that found it
    trigger_z: Pose.z (axis switches: axis position) at which this touch
        triggers, exactly
    """

    t: float
    site: str
    x: float
    y: float
    z: float
    trigger_z: float


class ProbeEvent(NamedTuple):
    """kind: attach, dock, lost, attach_failed or dock_failed; signal: which probe's."""

    t: float
    kind: str
    signal: str = "probe"


class Crash(NamedTuple):
    """Something was hurt.

    kind: "depth" (mm beyond the trigger) or "drag" (mm of XY travel)
    past_stop: mm of the depth that lie beyond a hard stop
    t, pose: when and where it was worst, of that nozzle's carriage
    """

    site: str
    kind: str
    depth: float
    allowed: float
    t: float
    pose: Pose
    past_stop: float = 0.0

    def __str__(self) -> str:
        what = "deep" if self.kind == "depth" else "dragged"
        stop = ""
        if self.past_stop > 0.0:
            stop = f", {self.past_stop:.4f} mm past its hard stop"
        x, y, z = self.pose
        return (
            f"{self.site}: {self.depth:.4f} mm {what}, {self.allowed:.4f}"
            f" allowed{stop}, at t={self.t:.4f}"
            f" x={x:.3f} y={y:.3f} z={z:.4f}"
        )


class CrashError(AssertionError):
    """The machine was driven into something."""


class Truth:
    """The record of one run.  Written by the world, read by tests.

    min_gap: smallest nozzle-to-plate gap ever (mm), infinity if no nozzle
    was ever over the plate. lowest: the lowest Pose.z, wherever that was.
    """

    __slots__ = (
        "_crashes",
        "_depths",
        "_drags",
        "_gap",
        "events",
        "lowest",
        "min_gap",
        "touches",
    )

    def __init__(
        self, gap: Callable[[float, float, float, float, int], float]
    ) -> None:
        self._gap = gap
        self._crashes: dict[tuple[str, str], Crash] = {}
        self._depths: dict[str, float] = {}
        self._drags: dict[str, float] = {}
        self.events: list[ProbeEvent] = []
        self.touches: list[Touch] = []
        self.min_gap = math.inf
        self.lowest = math.inf

    # Reading

    def true_gap(
        self, x: float, y: float, z: float, t: float = 0.0, carriage: int = 0
    ) -> float:
        """Tip to plate (mm) for a Pose at time t; negative is into it.

        carriage: whose tip, 0 or 1.
        """
        return self._gap(x, y, z, t, carriage)

    def deepest_in_bed(self) -> float:
        """Deepest a nozzle tip went below the plate's surface, mm."""
        return max(0.0, -self.min_gap)

    def touch_count(self, site: Optional[str] = None) -> int:
        """Touches of one site, or of all."""
        if site is None:
            return len(self.touches)
        return sum(1 for touch in self.touches if touch.site == site)

    def depth(self, site: str) -> float:
        """Deepest ever beyond the trigger, mm; 0 if never touched."""
        return self._depths.get(site, 0.0)

    def drag(self, site: str) -> float:
        """XY travel in contact, mm, all contacts together."""
        return self._drags.get(site, 0.0)

    def crashes(self) -> list[Crash]:
        """The worst of each site and kind, in order of time."""
        return sorted(self._crashes.values(), key=lambda crash: crash.t)

    def require_no_crash(
        self, tolerated: Optional[Mapping[str, float]] = None
    ) -> None:
        """Raise CrashError saying what was hurt, where and how badly.

        tolerated: mm by site, for tests of what a dead switch leads to.
        """
        tolerated = tolerated or {}
        crashes = [
            crash
            for crash in self.crashes()
            if crash.kind != "depth"
            or crash.depth > tolerated.get(crash.site, 0.0)
        ]
        if crashes:
            lines = "\n  ".join(str(crash) for crash in crashes)
            raise CrashError(f"the machine was hurt:\n  {lines}")

    def forget(self) -> None:
        """Crashes and the lowest place count from now on only."""
        self._crashes.clear()
        self.lowest = math.inf

    # Writing, by the world

    def add_drag(self, site: str, moved: float) -> None:
        """Count mm of XY travel in contact."""
        self._drags[site] = self._drags.get(site, 0.0) + moved

    def add_depth(self, site: str, depth: float) -> None:
        """Keep the deepest."""
        if depth > self._depths.get(site, 0.0):
            self._depths[site] = depth

    def judge(self, crash: Crash) -> None:
        """Keep it if it is a crash and the worst of its kind."""
        if crash.depth <= crash.allowed + ROUNDING:
            return
        key = (crash.site, crash.kind)
        worst = self._crashes.get(key)
        if worst is None or crash.depth > worst.depth:
            self._crashes[key] = crash
