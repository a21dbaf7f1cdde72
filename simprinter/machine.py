"""A simulated printer, put together from a scene."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Optional, Union

from .clock import RealClock, VirtualClock
from .faults import Fault, Faults
from .firmware import FirmwareBoard
from .mcu.analog import AnalogInputs, BatchedAnalogInputs
from .mcu.board import USUAL_DIALECT, Board
from .mcu.dialect import Dialect
from .mcu.inputs import Buttons, Counters
from .mcu.outputs import Neopixels, Outputs
from .mcu.steppers import Steppers
from .mcu.sync import Endstops, TrsyncTable
from .mcu.tmc import Tmc2209, TmcUarts
from .places import build_directory
from .rig import Port, Rig
from .scene import Scene
from .simulation import Simulation
from .wire.link import Link
from .wiring import MAIN, BoardSpec, Wiring, pin_number
from .world import Pose, Truth, World, make_kinematics
from .world.sites import Near


class Machine:
    """A printer with its boards, waiting for a klippy.

    boards and links (their serial lines) go by name; board and link are the
    main one's. Everything random comes from one seed. Use as a context
    manager: on leaving without another error, the crash detector has its say, and a
    fault that has not struck is an error.
    """

    def __init__(
        self,
        scene: Scene,
        seed: int = 0,
        faults: Iterable[Fault] = (),
        clock: Optional[Union[VirtualClock, RealClock]] = None,
        dialect: Dialect = USUAL_DIALECT,
        firmware: Optional[Path] = None,
    ):
        """dialect: of the host that the boards' firmware was made for.

        firmware: a program that takes the place of each board.

        clock defaults to a virtual one.
        """
        self.scene = scene
        self.seed = seed
        self.faults = Faults(faults)
        self._require_known_boards()
        self._tolerated: dict[str, float] = {}
        self.simulation = Simulation(clock or VirtualClock(build_directory()))
        now_ns = self.simulation.clock.now
        self.world = World(scene.world, seed, self.faults)
        kinematics = make_kinematics(
            scene.kinematics,
            scene.z_motors,
            scene.world.towers,
            scene.world.second_carriage,
        )
        begin = kinematics.motors(scene.start, scene.z_skew)
        self.rig = Rig(self.world, kinematics, scene.wiring, begin, now_ns)
        self.drivers: dict[str, Tmc2209] = {}
        self._last_change: dict[str, tuple[bytes, bool]] = {}
        self.boards: dict[str, Union[Board, FirmwareBoard]] = {}
        self.links: dict[str, Link] = {}
        for name, spec in scene.wiring.all_boards().items():
            latency_ns = round(spec.latency * 1e9)
            if firmware is None:
                board = self._make_board(name, spec, dialect)
                link = self.simulation.add_board(board, latency_ns)
            else:
                board = self._make_program(name, firmware)
                link = self.simulation.add_program(board, latency_ns)
            self.boards[name], self.links[name] = board, link
        self.board, self.link = self.boards[MAIN], self.links[MAIN]

    def _require_known_boards(self) -> None:
        known = self.scene.wiring.all_boards()
        for fault in self.faults:
            if fault.name == "mcu_silent" and fault.subject not in (
                None,
                *known,
            ):
                raise ValueError(f"{fault!r}: have boards {sorted(known)}")

    def _make_board(
        self, name: str, spec: BoardSpec, dialect: Dialect
    ) -> Board:
        port = Port(self.rig, name)
        steppers = Steppers(port)
        trsyncs = TrsyncTable(steppers)
        endstops = Endstops(port, trsyncs)
        batches = dialect.analog_batches
        analog = BatchedAnalogInputs if batches else AnalogInputs
        parts = [
            steppers,
            trsyncs,
            endstops,
            Outputs(port.set_output),
            analog(port.voltage),
            Buttons(port.level),
            Counters(),
            Neopixels(),
            TmcUarts(
                self._make_drivers(self.scene.wiring.on_board(name)),
                self._spoiled,
            ),
        ]
        board = Board(self.simulation.clock.now, parts, dialect, spec.crystal)
        board.is_silent = lambda: self._is_silent(name)
        port.board = board
        self.rig.on_steps.append(endstops.steps_queued)
        return board

    def _make_program(self, name: str, program: Path) -> FirmwareBoard:
        now_ns, directory = self.simulation.clock.now, build_directory()
        return FirmwareBoard(now_ns, program, directory, self.rig, name)

    def _make_drivers(self, wiring: Wiring) -> dict[tuple[int, int], Tmc2209]:
        by_pin = {}
        for name, motor in wiring.motors.items():
            if motor.uart:
                self.drivers[name] = Tmc2209()
                pin = pin_number(motor.uart)
                by_pin[pin, motor.address] = self.drivers[name]
        return by_pin

    def _spoiled(self, driver: Tmc2209, written: Optional[bytes]) -> bool:
        name = next(n for n, d in self.drivers.items() if d is driver)
        if written is None:
            return self.faults.fires("tmc_read_error", name) is not None
        if self._last_change.get(name, (b"", False))[0] != written:
            self.rig.operation("write", name, self.simulation.clock.now())
            lost = self.faults.fires("tmc_change_lost", name) is not None
            self._last_change[name] = (written, lost)
        lost = self._last_change[name][1]
        return self.faults.fires("tmc_write_error", name) is not None or lost

    def _is_silent(self, board: str) -> bool:
        now = self.rig.seconds(self.simulation.clock.now())
        return self.faults.due("mcu_silent", now, board)

    def __enter__(self) -> Machine:
        return self

    def __exit__(self, kind: object, *unused: object) -> None:
        try:
            if kind is None:
                self.truth.require_no_crash(self._tolerated)
                self.faults.require_struck()
        finally:
            self.close()

    @property
    def serials(self) -> dict[str, str]:
        """The serial device of each board."""
        return {name: link.path for name, link in self.links.items()}

    def tolerate(self, site: str, depth: float) -> None:
        """Let the crash detector accept this depth (mm) at a site.

        For tests of a dead switch, which is pressed as far as the floor of
        the touch allows; anything deeper, or elsewhere, stays a crash.
        """
        self._tolerated[site] = depth

    def break_down(self, fault: Fault) -> None:
        """Add a fault now; what it is about is counted from now on."""
        self.faults.add(fault)
        self.world.expect_faults()

    def repair(self) -> None:
        """Take all faults away; what they have done stays done."""
        self.faults.clear()
        self.world.mend()

    def lay_membrane(
        self, is_laid: bool = True, signal: str = "membrane"
    ) -> None:
        """Lay a membrane switch on the plate, or take it away, now."""
        self.rig.settle(self.simulation.clock.now())
        self.world.lay_membrane(is_laid, signal)

    def hold(self, signal: str, level: Optional[bool]) -> None:
        """Keep a signal asserted or not by hand, from now on; None: let go."""
        self.rig.settle(self.simulation.clock.now())
        self.world.hold(signal, level)

    def close(self) -> None:
        """Give everything back."""
        self.simulation.close()

    @property
    def truth(self) -> Truth:
        """What really happened up to now."""
        self.rig.settle(self.simulation.clock.now())
        return self.world.truth

    def near(self) -> list[Near]:
        """What is below the parts of the toolhead now, and whether it is pressed."""
        now = self.simulation.clock.now()
        self.rig.settle(now)
        return self.world.near(self.rig.seconds(now), *self.rig.poses(now))

    def tip(self, carriage: int = 0) -> Pose:
        """Where the nozzle tip of a carriage really is: world frame, mm."""
        now = self.simulation.clock.now()
        return self.rig.poses(now)[carriage]

    def gap_at_zero(
        self,
        z: float,
        xy: Optional[tuple[float, float]] = None,
        carriage: int = 0,
    ) -> float:
        """The true nozzle-to-bed gap that G-code Z=0 stands for, mm.

        z: the G-code Z (mm) at which the toolhead stands now, by order of the
        last finished move. xy: over which point of the bed, world frame
        (default: where the toolhead is). carriage: whose nozzle, 0 or 1. Known
        from the motors' steps alone.
        """
        tip = self.tip(carriage)
        x, y = (tip.x, tip.y) if xy is None else xy
        now = self.rig.seconds(self.simulation.clock.now())
        return self.truth.true_gap(x, y, tip.z - z, now, carriage)
