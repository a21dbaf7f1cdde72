"""Digital and PWM outputs."""

from __future__ import annotations

from collections.abc import Callable

from .board import Event, Peripheral, command

# (pin, time in ns, duty 0..1): where outputs report their changes
OutputSink = Callable[[int, int, float], None]


class Output:
    """One configured output."""

    def __init__(self, pin: int, cycle_ticks: int, shutdown_duty: float):
        self.pin = pin
        self.cycle_ticks = cycle_ticks
        self.shutdown_duty = shutdown_duty


class Outputs(Peripheral):
    """All outputs of a board; every change is passed to the sink."""

    def __init__(self, sink: OutputSink):
        self._sink = sink
        self.by_oid: dict[int, Output] = {}
        self._queued: set[Event] = set()

    def stop(self) -> None:
        """Every output goes to what was configured for a shutdown."""
        for event in self._queued:
            event.cancel()
        self._queued.clear()
        now = self.board.ns(self.board.clock())
        for output in self.by_oid.values():
            self._sink(output.pin, now, output.shutdown_duty)

    def reset(self) -> None:
        """Forget the configuration."""
        self.by_oid.clear()

    def _set_at(self, clock: int, output: Output, duty: float) -> None:
        late = self.board.clock() - clock
        if late > 0:
            self.board.journal.late.append(late)

        def change(now: int) -> None:
            self._queued.discard(event)
            self._sink(output.pin, self.board.ns(now), duty)

        event = self.board.schedule(max(clock, self.board.clock()), change)
        self._queued.add(event)

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
        self._add(oid, Output(pin, 0, float(default)), float(value))

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
        now = self.board.ns(self.board.clock())
        self._sink(self.by_oid[oid].pin, now, float(value))

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
        self._add(oid, Output(pin, cycle_ticks, default / 255.0), value / 255.0)

    @command("queue_pwm_out oid=%c clock=%u value=%hu")
    def _queue_pwm(self, oid: int, clock: int, value: int) -> None:
        output = self.by_oid[oid]
        self._set_at(self.board.widen(clock), output, value / 255.0)
