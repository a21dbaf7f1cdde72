"""What happened in one calibration, moment by moment, seen from the side."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

from simprinter import Machine, Scene
from simprinter.world import MagProbeSpec, PinSpec

# Printer seconds between two looks at the motors; a touch at 2 mm/s moves
# 0.02 mm meanwhile
LOOK_EVERY = 0.01
SITES = ("nozzle_pin", "body_pin", "probe_bed")


class Moment(NamedTuple):
    """Where everything is at a time.

    t: printer seconds since the recording began. along: of the nozzle's tip,
    mm on the axis that is seen. z, pin: heights of the nozzle's tip and of the
    pin's top, mm in the world's frame. attached: whether the head has the
    probe.
    """

    t: float
    along: float
    z: float
    pin: float
    attached: bool


class Mark(NamedTuple):
    """A touch: when, of which site, and where the two met, as in Moment."""

    t: float
    site: str
    along: float
    z: float


def axis_of(scene: Scene) -> int:
    """Which axis to show, 0 for X, 1 for Y: the probe is beside the nozzle."""
    probe = _parts(scene)[1]
    return 0 if abs(probe.x_offset) > abs(probe.y_offset) else 1


def probe_offset(scene: Scene) -> float:
    """Where the probe is on the axis that is shown, mm from the nozzle."""
    probe = _parts(scene)[1]
    return (probe.x_offset, probe.y_offset)[axis_of(scene)]


class Recorder:
    """Looks at a machine while it is used as a context manager.

    Takes part in the simulation like an API client that only listens.
    """

    def __init__(self, machine: Machine):
        self.moments: list[Moment] = []
        self.marks: list[Mark] = []
        self._machine = machine
        self._axis = axis_of(machine.scene)
        self._begin = self._next = machine.simulation.clock.now()
        self._touches = len(machine.truth.touches)

    def __enter__(self) -> Recorder:
        self._machine.simulation.peers.append(self)
        return self

    def __exit__(self, *unused: object) -> None:
        self._machine.simulation.peers.remove(self)
        self.pump()
        self._mark()

    def fileno(self) -> int:
        """There is nothing to wait for."""
        return -1

    def pump(self) -> bool:
        """Look at what has passed. Nobody else has to be told."""
        while self._next <= self._machine.simulation.clock.now():
            self.moments.append(self._moment(self._next))
            self._next += round(LOOK_EVERY * 1e9)
        return False

    def settled(self) -> bool:
        """Never holds up the time."""
        return True

    def _moment(self, ns: int) -> Moment:
        rig = self._machine.rig
        pose = rig.pose(ns)
        attached = rig.world.probe_state(rig.seconds(ns)) == "attached"
        pin = pin_top(self._machine.scene, pose, attached)
        t = (ns - self._begin) * 1e-9
        return Moment(t, pose[self._axis], pose.z, pin, attached)

    def _mark(self) -> None:
        scene = self._machine.scene
        probe = _parts(scene)[1]
        beside = probe_offset(scene)
        # Of each site: where the two meet, from the nozzle's tip
        places = {
            "nozzle_pin": (0.0, 0.0),
            "body_pin": (beside, -probe.body_drop),
            "probe_bed": (beside, -probe.body_drop - probe.switch_offset),
        }
        begin = self._machine.rig.seconds(self._begin)
        for touch in self._machine.truth.touches[self._touches :]:
            if touch.site not in places:
                continue
            aside, above = places[touch.site]
            along = (touch.x, touch.y)[self._axis] + aside
            z = touch.trigger_z + above
            self.marks.append(Mark(touch.t - begin, touch.site, along, z))


def pin_top(
    scene: Scene, pose: Sequence[float], attached: bool = True
) -> float:
    """The height of the pin's top below a head at a pose, mm in the world."""
    pin, probe = _parts(scene)
    x, y, z = pose
    top = pin.z + pin.pretravel
    if math.hypot(x - pin.x, y - pin.y) <= pin.radius:
        top = min(top, z)
    aside = (x + probe.x_offset - pin.x, y + probe.y_offset - pin.y)
    if attached and max(map(abs, aside)) <= probe.half_width:
        top = min(top, z - probe.body_drop)
    return top


def _parts(scene: Scene) -> tuple[PinSpec, MagProbeSpec]:
    pin, probe = scene.world.pin, scene.world.mag_probe
    assert pin is not None and probe is not None
    return pin, probe


def thin(
    points: Sequence[Sequence[float]], tolerance: float
) -> list[Sequence[float]]:
    """Those points (t, value, ...) between which the others lie on lines.

    Each value is at no time further off than the tolerance.
    """
    kept = {0, len(points) - 1}
    open_ends = [(0, len(points) - 1)]
    while open_ends:
        first, last = open_ends.pop()
        worst, at = tolerance, None
        for index in range(first + 1, last):
            off = _off_line(points[first], points[index], points[last])
            if off > worst:
                worst, at = off, index
        if at is not None:
            kept.add(at)
            open_ends += [(first, at), (at, last)]
    return [points[index] for index in sorted(kept)]


def _off_line(
    first: Sequence[float], point: Sequence[float], last: Sequence[float]
) -> float:
    share = (point[0] - first[0]) / (last[0] - first[0])
    return max(
        abs(value - begin - share * (end - begin))
        for begin, value, end in zip(first[1:], point[1:], last[1:])
    )
