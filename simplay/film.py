"""What a page is shown of the machine: its parts, then frame by frame.

World frame, mm: x right, y back, z up. Made in the simulation's thread, of the
truth alone; nothing of it reaches klippy.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict
from typing import Any, Optional

from simplay.sites import sites_of
from simplay.watcher import Watcher
from simprinter import Scene
from simprinter.world import Pose
from simprinter.world.spec import Spec

# Real seconds between two frames
EVERY = 1 / 20
# Places on the way between two frames: of so many printer nanoseconds each, and
# no more than so many
_STEP_NS, _MOST_STEPS = 50_000_000, 24
# Decimals of mm in what is sent
_UM, _TENTH_UM = 3, 4


def parts_of(scene: Scene) -> dict[str, Any]:
    """The machine as it is built, without its noise."""
    world = scene.world
    bed = _shown(world.bed)
    del bed["mesh"]
    coil = world.inductive
    return {
        "bed": bed,
        "bed_sensor": world.bed_sensor is not None,
        "pins": [_shown(pin) for pin in world.pins()],
        "membranes": [_shown(part) for part in world.membranes()],
        "probes": [
            {**_shown(probe), "dock": dock and _shown(dock)}
            for probe in world.probes()
            for dock in (world.dock_of(probe),)
        ],
        "inductive": coil and _shown(coil),
        "sites": {n: met._asdict() for n, met in sites_of(world).items()},
    }


def _shown(part: Spec) -> dict[str, Any]:
    return {k: value for k, value in asdict(part).items() if k != "noise"}


class Film:
    """Frames of what a watcher sees, as long as somebody looks.

    is_watched: whether anybody does. show: takes a frame.
    """

    def __init__(
        self,
        watcher: Watcher,
        is_watched: Callable[[], bool],
        show: Callable[[dict[str, Any]], None],
    ):
        self._watcher = watcher
        self._machine = watcher.machine
        self._is_watched = is_watched
        self._show = show
        self._shown = 0.0
        self._last_ns: Optional[int] = None
        # The carriage that has moved last
        self._active = 0
        self._tips: tuple[Pose, ...] = ()

    def look(self) -> None:
        """Show a frame if it is time for one."""
        now = time.monotonic()
        if now - self._shown < EVERY or not self._is_watched():
            return
        self._shown = now
        self._show(self.frame())

    def frame(self) -> dict[str, Any]:
        """What there is to see now."""
        machine, watcher = self._machine, self._watcher
        simulation = machine.simulation
        now = simulation.clock.now()
        seconds, tips = machine.rig.seconds(now), machine.rig.poses(now)
        world = machine.world
        self._find_active(tips)
        return {
            "t": round(seconds, 2),
            "way": self._way(now),
            "active": self._active,
            "tips": [_rounded(tip, _UM) for tip in tips],
            "near": [
                (near.site, round(near.distance, _TENTH_UM), near.pressed)
                for near in world.near(seconds, *tips)
            ],
            "on": [s for s in world.signals if machine.rig.asserted(s, now)],
            "touches": [
                (t.site, *_rounded(t[1:], _UM)) for t in watcher.touches()
            ],
            "probes": [
                world.probe_state(seconds, probe.signal)
                for probe in world.spec.probes()
            ],
            "laid": list(world.laid.values()),
            "dirt": round(world.dirt(seconds), _UM),
            "gap": None if watcher.gap is None else round(watcher.gap, _UM),
            "spot": watcher.spot,
            "speed": simulation.pace.speed if simulation.pace else 0.0,
        }

    def _find_active(self, tips: tuple[Pose, ...]) -> None:
        """Which carriage moves along X, the first one where both do."""
        for carriage, (tip, last) in enumerate(zip(tips, self._tips)):
            if abs(tip.x - last.x) > 10.0**-_UM:
                self._active = carriage
                break
        self._tips = tips

    def _way(self, now: int) -> list[tuple[float, ...]]:
        """Where the tip was since the last frame; where it is last of all."""
        begin = now if self._last_ns is None else self._last_ns
        self._last_ns = now
        count = min(_MOST_STEPS, (now - begin) // _STEP_NS)
        times = [now - i * _STEP_NS for i in range(count - 1, 0, -1)]
        poses = self._machine.rig.poses
        places: list[tuple[float, ...]] = []
        for ns in (*times, now):
            place = _rounded(poses(ns)[self._active], _UM)
            if not places or places[-1] != place:
                places.append(place)
        return places


def _rounded(numbers: tuple[float, ...] | Pose, digits: int):
    return tuple(round(number, digits) for number in numbers)
