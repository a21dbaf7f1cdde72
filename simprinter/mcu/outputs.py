"""Digital and PWM outputs."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable

from .board import Event, Peripheral, ShutdownError, command

# (pin, time in ns, duty 0..1): where outputs report their changes
OutputSink = Callable[[int, int, float], None]


class Output:
    """One configured output.

    limit: ticks that it may stay at another duty than the one for a shutdown,
    0: for ever. kind: digital or pwm, in the firmware's words.
    """

    def __init__(
        self, kind: str, pin: int, cycle_ticks: int, default: float, limit: int
    ):
        self.kind = kind
        self.pin = pin
        self.cycle_ticks = cycle_ticks
        self.shutdown_duty = default
        self.limit = limit
        self.queue: deque[tuple[int, float]] = deque()
        self.ends: int | None = None  # when another duty has to follow
        self.event: Event | None = None

    def clear(self) -> None:
        """Forget what was to come."""
        if self.event:
            self.event.cancel()
        self.queue.clear()
        self.event = self.ends = None

    def require_follows(self, clock: int) -> None:
        """Raises ShutdownError if a change at a clock comes after the end."""
        if self.ends is not None and self.ends < clock:
            text = f"Scheduled {self.kind} event will exceed max_duration"
            raise ShutdownError(text)


class Outputs(Peripheral):
    """All outputs of a board; every change is passed to the sink."""

    def __init__(self, sink: OutputSink):
        self._sink = sink
        self.by_oid: dict[int, Output] = {}

    def stop(self) -> None:
        """Every output goes to what was configured for a shutdown."""
        now = self.board.ns(self.board.clock())
        for output in self.by_oid.values():
            output.clear()
            self._sink(output.pin, now, output.shutdown_duty)

    def reset(self) -> None:
        """Forget the configuration."""
        self.by_oid.clear()

    def waiting(self, clock: int) -> int:
        """Changes that are to come."""
        return sum(len(output.queue) for output in self.by_oid.values())

    def _set_at(self, clock: int, output: Output, duty: float) -> None:
        self.board.take_move()
        output.queue.append((clock, duty))
        if len(output.queue) == 1:
            output.require_follows(clock)
            self.board.require_in_time(clock)
            self._load_at(clock, output)

    def _load_at(self, clock: int, output: Output) -> None:
        if output.event:
            output.event.cancel()
        output.event = self.board.schedule(
            clock, lambda now: self._load(output, now)
        )

    def _load(self, output: Output, now: int) -> None:
        if not output.queue:
            kind = "hard pwm" if output.kind == "pwm" else output.kind
            raise ShutdownError(f"Missed scheduling of next {kind} event")
        self._set(output, now, output.queue.popleft()[1])

    def _set(self, output: Output, now: int, duty: float) -> None:
        """Change it, and see to what has to follow."""
        self._sink(output.pin, self.board.ns(now), duty)
        is_limited = output.limit and duty != output.shutdown_duty
        output.ends = now + output.limit if is_limited else None
        following = output.ends
        if output.queue:
            following = output.queue[0][0]
            output.require_follows(following)
        if following is not None:
            self._load_at(max(following, now), output)

    def _add(self, oid: int, output: Output, duty: float) -> None:
        self.by_oid[oid] = output
        self._sink(output.pin, self.board.ns(self.board.clock()), duty)

    @command(
        "config_digital_out oid=%c pin=%u value=%c default_value=%c"
        " max_duration=%u"
    )
    def _config_digital(
        self, oid: int, pin: int, value: int, default: int, limit: int
    ) -> None:
        output = Output("digital out", pin, 0, float(default), limit)
        self._add(oid, output, float(value))

    @command("set_digital_out_pwm_cycle oid=%c cycle_ticks=%u")
    def _set_cycle(self, oid: int, cycle_ticks: int) -> None:
        self.by_oid[oid].cycle_ticks = cycle_ticks

    @command("queue_digital_out oid=%c clock=%u on_ticks=%u")
    def _queue_digital(self, oid: int, clock: int, on_ticks: int) -> None:
        output = self.by_oid[oid]
        cycle = output.cycle_ticks
        duty = on_ticks / cycle if cycle else float(bool(on_ticks))
        self._set_at(self.board.widen(clock), output, duty)

    @command("update_digital_out oid=%c value=%c")
    def _update_digital(self, oid: int, value: int) -> None:
        output = self.by_oid[oid]
        if output.queue:
            text = "update_digital_out not valid with active queue"
            raise ShutdownError(text)
        output.clear()
        self._set(output, self.board.clock(), float(value))

    @command(
        "config_pwm_out oid=%c pin=%u cycle_ticks=%u value=%hu"
        " default_value=%hu max_duration=%u"
    )
    def _config_pwm(
        self,
        oid: int,
        pin: int,
        cycle_ticks: int,
        value: int,
        default: int,
        limit: int,
    ) -> None:
        output = Output("pwm", pin, cycle_ticks, default / 255.0, limit)
        self._add(oid, output, value / 255.0)

    @command("queue_pwm_out oid=%c clock=%u value=%hu")
    def _queue_pwm(self, oid: int, clock: int, value: int) -> None:
        output = self.by_oid[oid]
        self._set_at(self.board.widen(clock), output, value / 255.0)

    @command("set_digital_out pin=%u value=%c")
    def _set_digital(self, pin: int, value: int) -> None:
        self._sink(pin, self.board.ns(self.board.clock()), float(value))

    @command("set_pwm_out pin=%u cycle_ticks=%u value=%hu")
    def _set_pwm(self, pin: int, _cycle_ticks: int, value: int) -> None:
        self._sink(pin, self.board.ns(self.board.clock()), value / 255.0)


class Neopixels(Peripheral):
    """Strips of lamps that take what they are told and show nothing."""

    RESPONSES = ("neopixel_result oid=%c success=%c",)

    @command(
        "config_neopixel oid=%c pin=%u data_size=%hu bit_max_ticks=%u"
        " reset_min_ticks=%u"
    )
    def _config(self, oid: int, *_about: int) -> None:
        pass

    @command("neopixel_update oid=%c pos=%hu data=%*s")
    def _update(self, oid: int, position: int, data: bytes) -> None:
        pass

    @command("neopixel_send oid=%c")
    def _send(self, oid: int) -> None:
        self.board.respond("neopixel_result", oid=oid, success=1)
