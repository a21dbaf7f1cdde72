"""Analog inputs."""

from __future__ import annotations

from collections.abc import Callable

from .board import Event, Peripheral, ShutdownError, command

_ADC_MAX = 4095


class AnalogInputs(Peripheral):
    """All analog inputs; `read(pin, ns)` gives the voltage as 0..1."""

    RESPONSES = ("analog_in_state oid=%c next_clock=%u value=%hu",)

    def __init__(self, read: Callable[[int, int], float]):
        self._read = read
        self._pins: dict[int, int] = {}
        self._events: dict[int, Event] = {}

    def stop(self) -> None:
        """A board that is shut down stops sampling."""
        for event in self._events.values():
            event.cancel()
        self._events.clear()

    def reset(self) -> None:
        """Forget the configuration."""
        self._pins.clear()

    @command("config_analog_in oid=%c pin=%u")
    def _config(self, oid: int, pin: int) -> None:
        self._pins[oid] = pin

    @command(
        "query_analog_in oid=%c clock=%u sample_ticks=%u sample_count=%c"
        " rest_ticks=%u min_value=%hu max_value=%hu range_check_count=%c"
    )
    def _query(
        self,
        oid: int,
        clock: int,
        sample_ticks: int,
        count: int,
        rest_ticks: int,
        *limits: int,
    ) -> None:
        low, high, checks = limits
        if oid in self._events:
            self._events.pop(oid).cancel()
        if not count:
            return

        wrong = 0

        def sample(now: int) -> None:
            nonlocal wrong
            level = self._read(self._pins[oid], self.board.ns(now))
            value = round(level * _ADC_MAX) * count
            wrong = 0 if low <= value <= high else wrong + 1
            if wrong and wrong >= checks:
                raise ShutdownError("ADC out of range")
            self._events[oid] = self.board.schedule(now + rest_ticks, sample)
            self.board.respond(
                "analog_in_state",
                oid=oid,
                next_clock=(now + rest_ticks) & 0xFFFFFFFF,
                value=value,
            )

        start = self.board.widen(clock)
        self.board.require_in_time(start)
        self._events[oid] = self.board.schedule(start, sample)
