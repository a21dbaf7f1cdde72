"""Machines and small tools for the tests of the world."""

from __future__ import annotations

from dataclasses import replace

from simprinter.faults import Fault, Faults
from simprinter.world import (
    AxisSwitchSpec,
    BedSensorSpec,
    BedSpec,
    DockSpec,
    InductiveSpec,
    MagProbeSpec,
    MembraneSpec,
    MeshSpec,
    PinSpec,
    Pose,
    World,
    WorldSpec,
)

BED = BedSpec(
    z0=0.3,
    slope_x=1e-3,
    slope_y=-5e-4,
    mesh=MeshSpec(50, 50, 250, 250, ((0.0, 0.05), (-0.02, 0.1))),
)
PIN = PinSpec(x=200.0, y=310.0, z=3.0, radius=2.0)
PROBE = MagProbeSpec(
    x_offset=5.0, y_offset=25.0, body_drop=4.9, switch_offset=0.5
)
MAG = WorldSpec(bed=BED, pin=PIN, mag_probe=PROBE)
OUTPUT = replace(
    MAG,
    mag_probe=replace(PROBE, mode="output", initial="docked", attach_time=0.25),
    probe_sense=True,
    dock_sense=True,
)
DOCK = replace(
    MAG,
    mag_probe=replace(PROBE, mode="dock", initial="docked"),
    dock=DockSpec(x=20.0, y=300.0, z=20.0, reach=3.0, approach=(0, -1, 0)),
    probe_sense=True,
    dock_sense=True,
)
PIEZO = WorldSpec(
    bed=BED,
    switches=(
        AxisSwitchSpec("x_endstop", "x", 300.0, 1),
        AxisSwitchSpec("y_endstop", "y", -5.0, -1, hard_stop=1.0),
        AxisSwitchSpec("z_endstop", "z", 0.0, -1),
    ),
    inductive=InductiveSpec(17.6, 0.0, 2.5),
    bed_sensor=BedSensorSpec(press_depth=0.04, enable_output=True),
)
MEMBRANE = replace(
    MAG, membrane=MembraneSpec(30.0, 20.0, 0.3, press=0.1, radius=8.0)
)
# Nozzle positions: tip over the pin, body over the pin, middle of the plate
OVER_PIN = (200.0, 310.0)
BODY_OVER_PIN = (195.0, 285.0)
MIDDLE = (150.0, 150.0)
HIGH = 60.0


def make(spec: WorldSpec, *faults: Fault, seed: int = 1) -> World:
    """A world whose head has just arrived high above the middle."""
    world = World(spec, seed, Faults(faults))
    world.observe(0.0, Pose(*MIDDLE, HIGH))
    return world


class Driver:
    """Moves a toolhead in straight lines, 5 ms per commit, like the board."""

    def __init__(self, world: World, speed: float = 100.0) -> None:
        self.world = world
        self.speed = speed
        self.t = 0.0
        self.pose = Pose(*MIDDLE, HIGH)

    def go(
        self,
        x: float | None = None,
        y: float | None = None,
        z: float | None = None,
    ) -> None:
        """Move to the coordinates given."""
        wanted = zip((x, y, z), self.pose)
        goal = Pose(*(old if new is None else new for new, old in wanted))
        start = self.pose
        way = max(abs(a - b) for a, b in zip(goal, start))
        steps = max(1, int(way / (self.speed * 0.005)) + 1)
        for step in range(1, steps):
            part = step / steps
            between = (a + part * (b - a) for a, b in zip(start, goal))
            self._commit(Pose(*between))
        self._commit(goal)

    def stay(self, seconds: float) -> None:
        """Stand still for so long."""
        self.t += seconds
        self._commit(self.pose)

    def _commit(self, pose: Pose) -> None:
        self.t += 0.005
        self.pose = pose
        self.world.observe(self.t, pose)

    def find(self, signal: str, lowest: float = -5.0) -> float:
        """Highest z at which the signal is asserted here, by bisection."""
        x, y, high = self.pose
        low = lowest
        for _ in range(60):
            middle = 0.5 * (low + high)
            if self.world.level(signal, self.t, Pose(x, y, middle)):
                low = middle
            else:
                high = middle
        return low

    def touch(self, signal: str, lift: float = 2.0) -> float:
        """Arm, go down to the trigger, commit it, lift; the trigger z."""
        self.world.touch_armed(signal, self.t)
        trigger = self.find(signal)
        self.go(z=trigger + 0.1)
        self.go(z=trigger)
        self.go(z=trigger + lift)
        return trigger
