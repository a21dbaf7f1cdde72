"""Analog inputs."""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import NamedTuple

from .board import Event, Peripheral, ShutdownError, command

_ADC_MAX = 4095
_BYTES_PER_SAMPLE = 2


class _Query(NamedTuple):
    """What the host wants to know of an input; clocks in ticks.

    count: samples of a reading. low, high, checks: so many readings in a row
    outside of these are too many.
    """

    start: int
    count: int
    rest_ticks: int
    low: int
    high: int
    checks: int


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
        self, oid: int, clock: int, _ticks: int, count: int, *rest: int
    ) -> None:
        query = _Query(self.board.widen(clock), count, *rest)

        def tell(value: int, next_clock: int) -> None:
            self.board.respond(
                "analog_in_state", oid=oid, next_clock=next_clock, value=value
            )

        self._begin(oid, query, tell)

    def _begin(
        self, oid: int, query: _Query, tell: Callable[[int, int], None]
    ) -> None:
        """Read from now on; tell: takes each value and the next's clock."""
        if oid in self._events:
            self._events.pop(oid).cancel()
        if not query.count:
            return
        wrong = 0

        def sample(now: int) -> None:
            nonlocal wrong
            level = self._read(self._pins[oid], self.board.ns(now))
            value = round(level * _ADC_MAX) * query.count
            wrong = 0 if query.low <= value <= query.high else wrong + 1
            if wrong and wrong >= query.checks:
                raise ShutdownError("ADC out of range")
            following = now + query.rest_ticks
            self._events[oid] = self.board.schedule(following, sample)
            tell(value, following & 0xFFFFFFFF)

        self.board.require_in_time(query.start)
        self._events[oid] = self.board.schedule(query.start, sample)


class BatchedAnalogInputs(AnalogInputs):
    """The same with several readings in a report, see Dialect."""

    RESPONSES = ("analog_in_state oid=%c next_clock=%u values=%*s",)

    @command(
        "query_analog_in oid=%c clock=%u sample_ticks=%u sample_count=%c"
        " rest_ticks=%u bytes_per_report=%c"
        " min_value=%hu max_value=%hu range_check_count=%c"
    )
    def _query(
        self, oid: int, clock: int, _ticks: int, count: int, *rest: int
    ) -> None:
        rest_ticks, size, *limits = rest
        query = _Query(self.board.widen(clock), count, rest_ticks, *limits)
        readings = bytearray()

        def tell(value: int, next_clock: int) -> None:
            readings.extend(struct.pack("<H", value))
            if len(readings) + _BYTES_PER_SAMPLE > size:
                self.board.respond(
                    "analog_in_state",
                    oid=oid,
                    next_clock=next_clock,
                    values=bytes(readings),
                )
                readings.clear()

        self._begin(oid, query, tell)
