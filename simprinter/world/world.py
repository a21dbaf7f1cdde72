"""The physical machine behind the board's pins.

World frame: mm, x right, y back, z up, origin arbitrary; time is printer
seconds.  A pose is a nozzle tip as the motors have put it: one of each
carriage, the first one's first.  Nothing here knows of steps, ticks, bytes or
of what a host believes.

level() answers "what if" and changes nothing; observe() commits.  Between two
commits the committed state (noise of the next touch, hysteresis, the probe's
whereabouts) stands still, so a caller may search for the moment of a trigger
by asking level() as often as it likes.
"""

from __future__ import annotations

import math
import random
from typing import Optional, Sequence

from ..faults import PROBE_SITES, Faults
from .bed import Bed
from .dock import Keeper, ProbeState
from .kinematics import Pose
from .lines import Line
from .ooze import Ooze
from .parts import Builder, Parts, attach_output
from .sites import Finding, Near, Poses, lowest
from .spec import MagProbeSpec, WorldSpec
from .thermal import Drift
from .truth import Crash, ProbeEvent, Touch, Truth


class World:
    """One machine in one run.

    seed: source of all noise; the same seed and the same sequence of touches
    give the same numbers.  truth: see Truth; for tests only.
    """

    __slots__ = (
        "_bed",
        "_builder",
        "_ceiling",
        "_drift",
        "_early",
        "_faults",
        "_held",
        "_keepers",
        "_last_t",
        "_last_poses",
        "_looking",
        "_low",
        "_next_fault",
        "_ooze",
        "_parts",
        "_side",
        "spec",
        "truth",
    )

    def __init__(
        self, spec: WorldSpec, seed: int, faults: Optional[Faults] = None
    ) -> None:
        self.spec = spec
        self.truth = Truth(self._gap)
        self._bed = Bed(spec.bed)
        self._drift = Drift(spec.drift, spec.hotend)
        self._faults = Faults() if faults is None else faults
        # Of the detachable probes, by their signals
        self._keepers = {
            probe.signal: self._keeper_of(probe, seed)
            for probe in spec.probes()
        }
        for keeper in self._keepers.values():
            keeper.others = [
                other
                for other in self._keepers.values()
                if other is not keeper
                and other.spec.on_second == keeper.spec.on_second
            ]
        self._ooze = Ooze(spec.ooze)
        self._builder = Builder(
            spec,
            seed,
            self._bed,
            self._drift,
            self._ooze,
            tuple(self._keepers.values()),
        )
        self._parts: Parts = self._builder.build()
        sensors = self._parts.sensors
        self._ceiling = max(sensor.ceiling() for sensor in sensors)
        # Mm above that at which a fault may have something touched
        self._early = 0.0
        # Signals with which a move looks for a touch
        self._looking: dict[str, Line] = {}
        self._last_poses: Optional[Poses] = None
        self._last_t = -math.inf
        # Something near the plate has yet to be let go
        self._low = False
        # On which side of the first the second carriage is, 1: in the
        # direction of X; 0: not known yet
        self._side = 0.0
        # Kept so by hand
        self._held: dict[str, bool] = {}
        self._next_fault = self._expect_faults()

    def _keeper_of(self, probe: MagProbeSpec, seed: int) -> Keeper:
        """Who attaches and docks this probe."""
        is_first = probe is self.spec.mag_probe
        name, signal = "" if is_first else f"/{probe.signal}", probe.signal
        keeper = Keeper(
            probe,
            self.spec.dock_of(probe),
            self._faults,
            lambda t, kind: self.truth.events.append(
                ProbeEvent(t, kind, signal)
            ),
            random.Random(f"{seed}/seat{name}"),
        )
        keeper.falls_at = PROBE_SITES if is_first else ()
        return keeper

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of the signals level() knows."""
        return tuple(self._parts.lines)

    @property
    def outputs(self) -> tuple[str, ...]:
        """Names of the outputs set_output() knows."""
        return tuple(self._parts.outputs)

    def level(self, signal: str, t: float, *poses: Sequence[float]) -> bool:
        """Whether the signal would be asserted at time t and poses.  Pure."""
        if signal in self._held:
            return self._held[signal]
        return self._parts.lines[signal].level(t, poses)

    def hold(self, signal: str, level: Optional[bool]) -> None:
        """A hand keeps the signal asserted or not; None: it lets go."""
        self._held.pop(signal, None)
        if level is not None:
            self._held[signal] = level

    def latency(self, signal: str) -> float:
        """Seconds from the physical change to the level at the board."""
        return self._parts.lines[signal].latency

    def touch_armed(self, signal: str, t: float) -> None:
        """A homing or probing operation on this signal starts at time t."""
        line = self._looking[signal] = self._parts.lines[signal]
        line.arm(t, self._faults)
        self._expect_touches()

    def touch_ended(self, signal: str) -> None:
        """That operation has ended, with a touch or without."""
        line = self._looking.pop(signal, None)
        if line is not None:
            line.disarm()

    def set_output(self, signal: str, t: float, value: float) -> None:
        """The board sets an output to value (0..1) at time t."""
        edge = self._parts.outputs[signal].set(t, value)
        if not edge:
            return
        for keeper in self._keepers.values():
            probe = keeper.spec
            if probe.mode == "output" and signal == attach_output(probe):
                on = self._parts.outputs[signal].on(t)
                wanted = ProbeState.ATTACHED if on else ProbeState.DOCKED
                keeper.ask(t, wanted, probe.attach_time)

    def probe_state(self, t: float, signal: str = "probe") -> str:
        """Where a detachable probe is: attached, docked, lost or none.

        signal: of which one, as in what follows.
        """
        keeper = self._keepers.get(signal)
        return "none" if keeper is None else keeper.at(t).value

    def dock_is_out(self, t: float, signal: str = "probe") -> bool:
        """Whether the dock stands where its probe is met, or is to."""
        keeper = self._keepers.get(signal)
        swing = None if keeper is None else keeper.swing
        return swing is None or swing.on(t)

    def lose_probe(self, t: float, signal: str = "probe") -> None:
        """The probe falls off the toolhead at time t, where it is carried."""
        if signal in self._keepers:
            self._keepers[signal].lose(t)

    def bring_probe_back(self, t: float, signal: str = "probe") -> None:
        """A lost probe is put where it was at first, at time t."""
        if signal in self._keepers:
            self._keepers[signal].bring_back(t)

    def put_probe_on(self, t: float, signal: str = "probe") -> None:
        """Somebody puts the probe on the toolhead at time t."""
        if signal in self._keepers:
            self._keepers[signal].put_on(t)

    def take_probe_off(self, t: float, signal: str = "probe") -> None:
        """Somebody takes the probe off the toolhead at time t."""
        if signal in self._keepers:
            self._keepers[signal].take_off(t)

    def heat_hotend(self, t: float, celsius: float) -> None:
        """The hotend has that temperature at time t."""
        self._drift.heat(t, celsius)

    def smear_nozzle(self, t: float, height: float) -> None:
        """So much plastic (mm) is left below the nozzle; 0: it is wiped off."""
        self._ooze.smear(t, height)
        self._drift.allow(height)

    def exchange_nozzle(self, lower: float) -> None:
        """The nozzle of now hangs so many mm lower than that at first."""
        self._drift.exchange_nozzle(lower)

    def exchange_plate(self, higher: float) -> None:
        """The plate of now is so many mm higher than that at first."""
        self._drift.exchange_plate(higher)

    @property
    def laid(self) -> dict[str, bool]:
        """Whether each membrane switch lies on the plate, the first one first."""
        return dict(self._builder.laid)

    @property
    def membrane_is_laid(self) -> bool:
        """Whether the membrane switch, the first one, lies on the plate."""
        return next(iter(self._builder.laid.values()), False)

    def dirt(self, t: float) -> float:
        """How far (mm) plastic hangs below the nozzle at time t."""
        return self._ooze.height(t)

    def near(self, t: float, *poses: Sequence[float]) -> list[Near]:
        """What is below the parts of a toolhead that is there; changes nothing."""
        return [
            near
            for sensor in self._parts.sensors
            for near in sensor.near(t, poses)
        ]

    def lay_membrane(self, is_laid: bool, signal: str = "membrane") -> None:
        """Somebody lays a membrane switch on the plate, or takes it away.

        signal: of which; ValueError where there is none.
        """
        laid = self._builder.laid
        if signal not in laid:
            raise ValueError(f"no membrane {signal!r} here, have {[*laid]}")
        laid[signal] = is_laid

    def expect_faults(self) -> None:
        """Look at the faults again, as there are others now."""
        self._next_fault = self._expect_faults()
        for line in self._looking.values():
            line.expect_touches(self._faults)
        self._expect_touches()

    def mend(self) -> None:
        """There are no faults any more."""
        for line in self._parts.lines.values():
            line.mend()
        self.expect_faults()

    def observe(self, t: float, *poses: Sequence[float]) -> None:
        """Commit where the nozzles are at time t, in order of time."""
        if t < self._last_t:
            raise ValueError(f"observe: t={t!r} is before {self._last_t!r}")
        pose = poses[0]
        if t >= self._next_fault:
            self._next_fault = self._mark_due(t)
        for line in self._looking.values():
            line.observe(t, poses, self._faults)
        for keeper in self._keepers.values():
            self._pass_dock(keeper, t, poses)
        if self.spec.second_carriage is not None:
            self._keep_apart(t, poses, self.spec.second_carriage.clearance)
        self._ooze.observe(t, pose)
        for switch in self._parts.switches:
            finding = switch.commit(poses)
            if finding is not None:
                self._take(t, poses, finding, 0.0)
        z = lowest(poses)
        self.truth.lowest = min(self.truth.lowest, z)
        drift = self._drift
        bound = drift.bound(t) if drift.active else 0.0
        low = z <= self._ceiling + self._early + bound
        if low or self._low:
            self._commit_contacts(t, poses)
            self._low = low
        # Only a nozzle this low can come nearer to the plate than ever
        if z - self._bed.highest - bound < self.truth.min_gap:
            self._commit_gaps(t, poses)
        self._last_poses = poses
        self._last_t = t

    def _pass_dock(self, keeper: Keeper, t: float, poses: Poses) -> None:
        """A toolhead takes a probe along, strips it off, or hits its dock."""
        probe = keeper.spec
        keeper.observe(t, poses[probe.on_second])
        name = "dock"
        if probe is not self.spec.mag_probe:
            name = f"{probe.signal}_dock"
        for pose in poses:
            self._hit(name, keeper.dock_depth(t, pose), t, pose)

    def _keep_apart(self, t: float, poses: Poses, clearance: float) -> None:
        """Carriages on one rail do not pass each other."""
        apart = poses[1][0] - poses[0][0]
        self._side = self._side or math.copysign(1.0, apart)
        self._hit("carriages", clearance - self._side * apart, t, poses[1])

    def _hit(
        self, site: str, depth: float, t: float, pose: Sequence[float]
    ) -> None:
        """So many mm in what may not be touched; none: it was not."""
        if depth > 0.0:
            here = Pose(*pose)
            self.truth.judge(Crash(site, "depth", depth, 0.0, t, here))

    def _commit_gaps(self, t: float, poses: Poses) -> None:
        for carriage, (x, y, z) in enumerate(poses):
            if self._bed.covers(x, y):
                gap = self._gap(x, y, z, t, carriage)
                self.truth.min_gap = min(self.truth.min_gap, gap)

    def _commit_contacts(self, t: float, poses: Poses) -> None:
        last = self._last_poses or poses
        moved = [
            math.hypot(now[0] - before[0], now[1] - before[1])
            for now, before in zip(poses, last)
        ]
        for sensor in self._parts.sensors:
            for finding in sensor.commit(t, poses, moved):
                self._take(t, poses, finding, moved[finding.site.carriage])

    def _take(
        self, t: float, poses: Poses, finding: Finding, moved: float
    ) -> None:
        """Write down what was found, and let the probe fall if it must."""
        site, truth = finding.site, self.truth
        if finding.met:
            for fault in site.faults:
                self._faults.strikes(fault)
            self._faults.touched(site.name)
        x, y, z = poses[site.carriage]
        if finding.pressed and not finding.was_pressed:
            truth.touches.append(Touch(t, site.name, x, y, z, finding.trigger))
            for keeper in self._keepers.values():
                keeper.touched(t, site.name)
        lifted = finding.was_pressed and not finding.pressed
        for keeper in self._keepers.values() if lifted else ():
            keeper.lifted(t, site.name)
        if lifted and site.name.startswith("nozzle_"):
            self._ooze.flatten(t)
        here = Pose(x, y, z)
        if finding.pressed:
            depth = finding.depth
            past = max(0.0, depth - site.hard_stop)
            truth.add_depth(site.name, depth)
            truth.judge(
                Crash(site.name, "depth", depth, site.allowed, t, here, past)
            )
        if finding.drag:
            truth.add_drag(site.name, moved)
            drag, allowed = finding.drag, site.allowed_drag
            truth.judge(Crash(site.name, "drag", drag, allowed, t, here))

    def _gap(
        self, x: float, y: float, z: float, t: float, carriage: int
    ) -> float:
        """Tip of that carriage to plate, mm; positive above it."""
        # Filament fills a texture, so its mean surface counts
        surface = self._bed.height(x, y) + self._drift.bed(t)
        # The second nozzle stays cold
        growth = 0.0 if carriage else self._drift.nozzle(t)
        return z - growth - surface

    def _expect_faults(self) -> float:
        lines = self._parts.lines
        sites = {site.name for line in lines.values() for site in line.sites}
        for fault in self._faults:
            if not fault.name.startswith(("stuck_", "trigger_")):
                continue
            known = sorted(sites if fault.at_site else lines)
            if fault.subject not in known:
                raise ValueError(
                    f"{fault!r}: no such {fault.what}, have {known}"
                )
        times = [line.expect(self._faults) for line in lines.values()]
        return min(times, default=math.inf)

    def _expect_touches(self) -> None:
        sensors = self._parts.sensors
        for sensor in sensors:
            sensor.expect()
        self._early = max(sensor.early for sensor in sensors)

    def _mark_due(self, t: float) -> float:
        """Let faults by time count as fired; time of the next, or infinity."""
        for name in self._parts.lines:
            for fault in ("stuck_open", "stuck_closed"):
                self._faults.due(fault, t, name)
        pending = [
            fault.t
            for fault in self._faults.unfired()
            if fault.t is not None and fault.name.startswith("stuck_")
        ]
        return min(pending, default=math.inf)
