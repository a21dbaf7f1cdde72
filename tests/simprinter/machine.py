"""A simulated printer, put together from a scene."""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Optional, Union

from .clock import RealClock, VirtualClock
from .faults import Fault, Faults
from .mcu.analog import AnalogInputs
from .mcu.board import Board
from .mcu.outputs import Outputs
from .mcu.steppers import Steppers
from .mcu.sync import Endstops, TrsyncTable
from .mcu.tmc import Tmc2209, TmcUarts
from .rig import Port, Rig
from .scenes import Scene
from .simulation import Simulation
from .wiring import pin_number
from .world import Pose, Truth, World, make_kinematics

_REPO = Path(__file__).resolve().parents[2]


def build_directory() -> Path:
    """Where compiled parts are kept."""
    # A relative one means the repository's, wherever klippy is started
    return _REPO / (os.environ.get("BUILD_DIR") or "build") / "simprinter"


class Machine:
    """A printer with its board, waiting for a klippy.

    Everything random comes from one seed. Use as a context manager: on
    leaving without another error, the crash detector has its say.
    """

    def __init__(
        self,
        scene: Scene,
        seed: int = 0,
        faults: Iterable[Fault] = (),
        clock: Optional[Union[VirtualClock, RealClock]] = None,
        app: str = "Klipper",
    ):
        """app: the host the board's firmware was made for.

        clock defaults to a virtual one.
        """
        self.scene = scene
        self.seed = seed
        self.faults = Faults(faults)
        self._tolerated: dict[str, float] = {}
        self.simulation = Simulation(clock or VirtualClock(build_directory()))
        now_ns = self.simulation.clock.now
        self.world = World(scene.world, seed, self.faults)
        kinematics = make_kinematics(scene.kinematics, scene.z_motors)
        start = scene.start
        self.rig = Rig(self.world, kinematics, scene.wiring, start, now_ns)
        self.drivers: dict[str, Tmc2209] = {}
        self.board = self._make_board(app)
        self.link = self.simulation.add_board(self.board)
        self.board.is_silent = self._is_silent

    def _make_board(self, app: str) -> Board:
        port = Port(self.rig)
        steppers = Steppers(port)
        trsyncs = TrsyncTable(steppers)
        endstops = Endstops(port, trsyncs)
        parts = [
            steppers,
            trsyncs,
            endstops,
            Outputs(port.set_output),
            AnalogInputs(port.voltage),
            TmcUarts(self._make_drivers(), self._spoiled),
        ]
        board = Board(self.simulation.clock.now, parts, app)
        port.board = board
        port.on_steps = endstops.steps_queued
        return board

    def _make_drivers(self) -> dict[tuple[int, int], Tmc2209]:
        by_pin = {}
        for name, motor in self.scene.wiring.motors.items():
            if motor.uart:
                self.drivers[name] = Tmc2209()
                pin = pin_number(motor.uart)
                by_pin[pin, motor.address] = self.drivers[name]
        return by_pin

    def _spoiled(self, driver: Tmc2209, is_write: bool) -> bool:
        name = next(n for n, d in self.drivers.items() if d is driver)
        kind = "tmc_write_error" if is_write else "tmc_read_error"
        return self.faults.fires(kind, name) is not None

    def _is_silent(self) -> bool:
        now = self.rig.seconds(self.simulation.clock.now())
        return self.faults.due("mcu_silent", now)

    def __enter__(self) -> Machine:
        return self

    def __exit__(self, kind: object, *unused: object) -> None:
        try:
            if kind is None:
                self.truth.require_no_crash(self._tolerated)
        finally:
            self.close()

    def tolerate(self, site: str, depth: float) -> None:
        """Let the crash detector accept this depth (mm) at a site.

        For tests of a dead switch, which is pressed as far as the floor of
        the touch allows; anything deeper, or elsewhere, stays a crash.
        """
        self._tolerated[site] = depth

    def close(self) -> None:
        """Give everything back."""
        self.simulation.close()

    @property
    def truth(self) -> Truth:
        """What really happened up to now."""
        self.rig.settle(self.simulation.clock.now())
        return self.world.truth

    def tip(self) -> Pose:
        """Where the nozzle tip really is: world frame, mm."""
        now = self.simulation.clock.now()
        return self.rig.pose(now)

    def gap_at_zero(
        self, z: float, xy: Optional[tuple[float, float]] = None
    ) -> float:
        """The true nozzle-to-bed gap that G-code Z=0 stands for, mm.

        z: the G-code Z (mm) at which the head stands now, by order of the
        last finished move. xy: over which point of the bed, world frame
        (default: where the head is). Known from the motors' steps alone.
        """
        tip = self.tip()
        x, y = (tip.x, tip.y) if xy is None else xy
        now = self.rig.seconds(self.simulation.clock.now())
        return self.truth.true_gap(x, y, tip.z - z, now)
