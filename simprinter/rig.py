"""The mechanics between a board's pins and the world.

Steps become the pose of the nozzle tip, the world's signals become electrical
levels, outputs reach the world. Times are ns on the clock of the simulation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from .mcu.board import Board
from .mcu.steppers import StepTrack
from .wiring import MAIN, HeaterState, Wiring, is_inverted, pin_number
from .world import Delta, Kinematics, Pose, World

# The world is told of a moving head this often; see LIMITS.md
COMMIT_NS = 10_000_000
# The heater that the world's nozzle grows with, see HotendSpec
HOTEND = "extruder"
# Positions older than this are asked for by nobody (the slowest sensor's
# latency is far below)
_MEMORY_NS = 2_000_000_000


class MotorAxis:
    """A motor's travel in mm as a function of its board's clock."""

    __slots__ = ("_scale", "_start", "board", "track")

    def __init__(self, step_dist: float, positive_dir: int, start: float):
        self._scale = step_dist if positive_dir else -step_dist
        self._start = start
        self.track = StepTrack()
        self.board: Board | None = None

    def mm(self, clock: int) -> float:
        """Travel at a clock, mm in the frame of the world's kinematics."""
        track = self.track
        # Most motors stand still most of the time
        if clock >= track.last_clock:
            return self._start + track.position * self._scale
        return self._start + track.at(clock) * self._scale


class Rig:
    """All motors and the world they move."""

    def __init__(
        self,
        world: World,
        kinematics: Kinematics | Delta,
        wiring: Wiring,
        begin: Mapping[str, float],
        now_ns: Callable[[], int],
    ):
        """begin: travel of every motor at first, mm."""
        self.world = world
        self.wiring = wiring
        self._kinematics = kinematics
        self._zero_ns = now_ns()
        self._committed = self._zero_ns
        self.axes = {
            name: MotorAxis(
                motor.step_dist, not is_inverted(motor.dir_pin), begin[name]
            )
            for name, motor in wiring.motors.items()
        }
        self.heaters = {
            name: HeaterState(heater, self._zero_ns)
            for name, heater in wiring.heaters.items()
        }
        # Whose clock each motor follows
        self._motors: dict[Board | None, dict[str, MotorAxis]] = {
            None: dict(self.axes)
        }
        # Told of new steps: those of one board change what another sees
        self.on_steps: list[Callable[[int], None]] = []
        # Told of what the host has a board do, just before: kind, what with
        # and when (ns). "touch" and "query" of a signal, "write" to a driver
        self.on_operation: list[Callable[[str, str, int], None]] = []
        world.observe(0.0, *self.poses(self._zero_ns))

    def seconds(self, ns: int) -> float:
        """The world's time at ns."""
        return (ns - self._zero_ns) * 1e-9

    def poses(self, ns: int) -> tuple[Pose, ...]:
        """Where the motors have put each carriage's nozzle tip, world frame, mm."""
        return self._kinematics.poses(self.travel(ns))

    def pose(self, ns: int) -> Pose:
        """Where the motors have put the nozzle tip of the first carriage."""
        return self._kinematics.pose(self.travel(ns))

    def steps_queued(self, start_ns: int) -> None:
        """Some motor's steps beginning after start_ns have changed."""
        for listener in self.on_steps:
            listener(start_ns)

    def operation(self, kind: str, subject: str, ns: int) -> None:
        """The host has a board do something now or at ns."""
        for listener in self.on_operation:
            listener(kind, subject, ns)

    def connect(self, name: str, board: Board) -> StepTrack:
        """A board drives this motor from now on; its track."""
        axis = self.axes[name]
        del self._motors[axis.board][name]
        self._motors.setdefault(board, {})[name] = axis
        axis.board = board
        return axis.track

    def travel(self, ns: int) -> Mapping[str, float]:
        """Travel of every motor, mm."""
        travel = {}
        for board, motors in self._motors.items():
            # A motor that has no board stands still
            clock = 0 if board is None else board.clock_at(ns)
            for name, axis in motors.items():
                travel[name] = axis.mm(clock)
        return travel

    def settle(self, ns: int) -> None:
        """Let the world live until ns."""
        busy_until = self._busy_until(ns)
        while self._committed < ns:
            until = ns
            if self._committed < busy_until:
                until = min(ns, self._committed + COMMIT_NS)
            self.world.observe(self.seconds(until), *self.poses(until))
            self._committed = until
        for board, motors in self._motors.items():
            if board is not None:
                clock = board.clock_at(ns - _MEMORY_NS)
                for axis in motors.values():
                    axis.track.forget(clock)

    def _busy_until(self, ns: int) -> int:
        """Until when (ns) those motors step that begin to before ns."""
        ends = [
            board.ns(axis.track.last_clock)
            for board, motors in self._motors.items()
            if board is not None
            for axis in motors.values()
            if axis.track.begins_by(board.clock_at(ns))
        ]
        return max(ends, default=0)

    def asserted(self, signal: str, ns: int) -> bool:
        """Whether the board sees a signal at ns (tracks must be known)."""
        seen = ns - round(self.world.latency(signal) * 1e9)
        poses = self.poses(seen)
        return self.world.level(signal, self.seconds(seen), *poses)

    def edge(self, signal: str, wanted: bool, first: int, last: int):
        """First ns in (first, last] at which a signal is as wanted, or None.

        A signal that comes and goes within COMMIT_NS may be missed.
        """
        before = first
        while before < last:
            after = min(before + COMMIT_NS, last)
            if self.asserted(signal, after) == wanted:
                return self._bisect(signal, wanted, before, after)
            before = after
        return None

    def _bisect(self, signal: str, wanted: bool, before: int, after: int):
        while after - before > 1:
            middle = (before + after) // 2
            if self.asserted(signal, middle) == wanted:
                after = middle
            else:
                before = middle
        return after


class Port:
    """One board's view of the rig: pin numbers instead of names."""

    def __init__(self, rig: Rig, name: str = MAIN):
        """name: the board's."""
        self._rig = rig
        wiring = rig.wiring.on_board(name)
        self._motors = {
            (pin_number(m.step_pin), pin_number(m.dir_pin)): name
            for name, m in wiring.motors.items()
        }
        self._inputs = {
            pin_number(pin): (signal, is_inverted(pin))
            for signal, pin in wiring.inputs.items()
        }
        self._outputs = {
            pin_number(pin): (signal, is_inverted(pin))
            for signal, pin in wiring.outputs.items()
        }
        self._heater_pins = {
            pin_number(h.pin): name
            for name, h in wiring.heaters.items()
            if h.pin
        }
        self._sensor_pins = {
            pin_number(h.sensor_pin): name for name, h in wiring.heaters.items()
        }
        self.board: Board | None = None

    def track(self, step_pin: int, dir_pin: int) -> StepTrack:
        """The track of the motor on these pins; a new one where none is."""
        name = self._motors.get((step_pin, dir_pin))
        if name is None:  # an extruder, say: it moves nothing in this world
            return StepTrack()
        if self.board is None:
            return self._rig.axes[name].track
        return self._rig.connect(name, self.board)

    def steps_queued(self, start_ns: int) -> None:
        """New steps may change what an endstop will see."""
        self._rig.steps_queued(start_ns)

    def settle(self, ns: int) -> None:
        """Let the world live until ns."""
        self._rig.settle(ns)

    def level(self, pin: int, ns: int) -> bool:
        """Electrical level of an input; one that is not wired reads low."""
        signal, inverted = self._inputs.get(pin, ("", False))
        if not signal:
            return False
        self._settle_to_now()
        return self._rig.asserted(signal, ns) != inverted

    def edge(self, pin: int, wanted: bool, first: int, last: int):
        """First ns in (first, last] with the wanted level, or None."""
        signal, inverted = self._inputs.get(pin, ("", False))
        if not signal:
            return None
        return self._rig.edge(signal, wanted != inverted, first, last)

    def armed(self, pin: int, ns: int) -> None:
        """An endstop on this pin starts to look."""
        signal, _ = self._inputs.get(pin, ("", False))
        if signal:
            self._settle_to_now()
            self._rig.operation("touch", signal, ns)
            self._rig.world.touch_armed(signal, self._rig.seconds(ns))

    def disarmed(self, pin: int) -> None:
        """An endstop on this pin looks no longer."""
        signal, _ = self._inputs.get(pin, ("", False))
        if signal:
            self._settle_to_now()
            self._rig.world.touch_ended(signal)

    def queried(self, pin: int, ns: int) -> None:
        """The host asks for the level of this pin."""
        signal, _ = self._inputs.get(pin, ("", False))
        if signal:
            self._rig.operation("query", signal, ns)

    def set_output(self, pin: int, ns: int, duty: float) -> None:
        """An output changed."""
        if pin in self._heater_pins:
            self._rig.heaters[self._heater_pins[pin]].set_duty(duty, ns)
            return
        signal, inverted = self._outputs.get(pin, ("", False))
        if signal:
            self._rig.settle(ns)
            value = 1.0 - duty if inverted else duty
            self._rig.world.set_output(signal, self._rig.seconds(ns), value)

    def voltage(self, pin: int, ns: int) -> float:
        """Analog level as a share of the reference; open inputs float."""
        name = self._sensor_pins.get(pin)
        if name is None:
            return 0.5
        heater = self._rig.heaters[name]
        voltage = heater.voltage(ns)
        world = self._rig.world
        if name == HOTEND and world.spec.hotend is not None:
            self._rig.settle(ns)
            world.heat_hotend(self._rig.seconds(ns), heater.celsius)
        return voltage

    def _settle_to_now(self) -> None:
        assert self.board is not None
        self._rig.settle(self.board.ns(self.board.clock()))
