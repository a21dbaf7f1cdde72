"""Inputs that are watched: buttons, and counters of a fan's turns."""

from __future__ import annotations

from collections.abc import Callable

from .board import CLOCK_FREQ, Event, Peripheral, command

# Firmware looks every 2 ms, which would be most of what happens; see LIMITS.md
_LOOK_TICKS = CLOCK_FREQ // 20


class _Buttons:
    """Some pins that are told of together."""

    def __init__(self, count: int):
        self.pins: list[int] = [0] * count
        self.seen = 0
        self.told: list[int] = []
        self.acknowledged = 0
        self.event: Event | None = None


class Buttons(Peripheral):
    """All of them; `level(pin, ns)` tells whether a pin is high."""

    RESPONSES = ("buttons_state oid=%c ack_count=%c state=%*s",)

    def __init__(self, level: Callable[[int, int], bool]):
        self._level = level
        self._groups: dict[int, _Buttons] = {}

    def reset(self) -> None:
        """Forget the configuration."""
        self._groups.clear()

    @command("config_buttons oid=%c button_count=%c")
    def _config(self, oid: int, count: int) -> None:
        self._groups[oid] = _Buttons(count)

    @command("buttons_add oid=%c pos=%c pin=%u pull_up=%c")
    def _add(self, oid: int, position: int, pin: int, _pull_up: int) -> None:
        self._groups[oid].pins[position] = pin

    @command(
        "buttons_query oid=%c clock=%u rest_ticks=%u retransmit_count=%c"
        " invert=%c"
    )
    def _query(
        self, oid: int, clock: int, rest_ticks: int, _again: int, invert: int
    ) -> None:
        group = self._groups[oid]
        if group.event:
            group.event.cancel()
        group.seen, group.told = invert, []
        group.acknowledged = 0
        if not rest_ticks:
            return
        rest = max(rest_ticks, _LOOK_TICKS)

        def look(now: int) -> None:
            group.event = self.board.schedule(now + rest, look)
            ns = self.board.ns(now)
            levels = [self._level(pin, ns) for pin in group.pins]
            state = sum(high << bit for bit, high in enumerate(levels))
            if state != group.seen:
                group.seen = state
                group.told.append(state)
                self.board.respond(
                    "buttons_state",
                    oid=oid,
                    ack_count=group.acknowledged & 0xFF,
                    state=bytes(group.told),
                )

        group.event = self.board.schedule(self.board.widen(clock), look)

    @command("buttons_ack oid=%c count=%c")
    def _acknowledge(self, oid: int, count: int) -> None:
        group = self._groups[oid]
        group.acknowledged += count
        del group.told[:count]


class Counters(Peripheral):
    """Counters whose pins never change: fans without a tachometer."""

    RESPONSES = ("counter_state oid=%c next_clock=%u count=%u count_clock=%u",)

    def __init__(self) -> None:
        self._events: dict[int, Event] = {}

    def reset(self) -> None:
        """Forget the configuration."""
        self._events.clear()

    @command("config_counter oid=%c pin=%u pull_up=%c")
    def _config(self, oid: int, pin: int, _pull_up: int) -> None:
        pass

    @command("query_counter oid=%c clock=%u poll_ticks=%u sample_ticks=%u")
    def _query(
        self, oid: int, clock: int, poll_ticks: int, sample_ticks: int
    ) -> None:
        if oid in self._events:
            self._events.pop(oid).cancel()
        rest = sample_ticks + poll_ticks

        def tell(now: int) -> None:
            self._events[oid] = self.board.schedule(now + rest, tell)
            self.board.respond(
                "counter_state",
                oid=oid,
                next_clock=(now + poll_ticks) & 0xFFFFFFFF,
                count=0,
                count_clock=0,
            )

        self._events[oid] = self.board.schedule(self.board.widen(clock), tell)
