"""The core of the simulated micro-controller: clock, events, commands.

Peripherals declare the commands they understand with `command(...)` and the
answers they give in RESPONSES; the board collects both into the dictionary
that a host downloads. Clocks are ticks of the board, 64 bits wide inside and
32 bits on the wire.
"""

from __future__ import annotations

import heapq
import itertools
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

from ..wire.messages import Dictionary
from . import pins
from .dialect import Dialect

TICK_NS = 20
CLOCK_FREQ = 10**9 // TICK_NS
# The 32-bit clock wraps this long (s) after the start, so that every longer
# run crosses the wrap
_FIRST_WRAP = 20
_STATS_NS = 5 * 10**9
# Items in the queue that steppers and outputs share
MOVE_COUNT = 1024
SHUTDOWN_REASONS = (
    "Command request",
    "Timer too close",
    "Move queue overflow",
    "Stepper too far in past",
    "Can't reset time when stepper active",
    "Missed scheduling of next digital out event",
    "Scheduled digital out event will exceed max_duration",
    "Missed scheduling of next hard pwm event",
    "Scheduled pwm event will exceed max_duration",
    "update_digital_out not valid with active queue",
    "ADC out of range",
)


class ShutdownError(Exception):
    """What firmware shuts down for; the text is one of SHUTDOWN_REASONS."""


def command(text: str, in_shutdown: bool = False) -> Callable:
    """Mark a method as the handler of the command with this format."""

    def mark(method: Callable) -> Callable:
        method.command_text = text  # type: ignore[attr-defined]
        method.in_shutdown = in_shutdown  # type: ignore[attr-defined]
        return method

    return mark


class Peripheral:
    """A part of the board; `board` is set when it is plugged in."""

    RESPONSES: tuple[str, ...] = ()
    board: Board

    def handlers(self) -> Iterable[Callable]:
        """Bound methods marked with `command`."""
        for name in dir(type(self)):
            if hasattr(getattr(type(self), name), "command_text"):
                yield getattr(self, name)

    def stop(self) -> None:
        """The board shuts down."""

    def reset(self) -> None:
        """The board reboots: forget everything configured."""

    def waiting(self, clock: int) -> int:
        """How many items of the move queue are taken at a clock."""
        return 0


class Crystal(NamedTuple):
    """What makes a board's clock tick.

    tick_ns: how long a tick really takes; ppm: by how much it ticks slower
    than its CLOCK_FREQ says; first_wrap: s from the start until the 32-bit
    clock wraps
    """

    tick_ns: int = TICK_NS
    ppm: int = 0
    first_wrap: int = _FIRST_WRAP

    def nominal_freq(self) -> int:
        """What the board says of its clock, Hz."""
        return 10**9 * (10**6 + self.ppm) // (self.tick_ns * 10**6)


USUAL_CRYSTAL = Crystal()
USUAL_DIALECT = Dialect()
_REASON_IDS = {text: i + 1 for i, text in enumerate(SHUTDOWN_REASONS)}


class Board(Peripheral):
    """A micro-controller without its serial line.

    now_ns tells the time; `send` (set by whoever connects the line) takes
    encoded responses.
    """

    RESPONSES = (
        "uptime high=%u clock=%u",
        "clock clock=%u",
        "config is_config=%c crc=%u is_shutdown=%c move_count=%hu",
        "stats count=%u sum=%u sumsq=%u",
        "shutdown clock=%u static_string_id=%hu",
        "is_shutdown static_string_id=%hu",
        "starting",
    )

    def __init__(
        self,
        now_ns: Callable[[], int],
        peripherals: Iterable[Peripheral],
        dialect: Dialect = USUAL_DIALECT,
        crystal: Crystal = USUAL_CRYSTAL,
    ):
        self._now_ns = now_ns
        self._tick_ns = crystal.tick_ns
        first_clock = (1 << 32) - crystal.first_wrap * 10**9 // self._tick_ns
        self._epoch_ns = now_ns() - first_clock * self._tick_ns
        self._events: list = []
        self._order = itertools.count()
        self._parts: list[Peripheral] = [self, *peripherals]
        self._handlers: dict[str, Callable] = {}
        self.dictionary = self._collect(dialect, crystal.nominal_freq())
        self.send: Callable[[bytes], None] = lambda content: None
        # A fault: while this is true the board neither listens nor answers
        self.is_silent: Callable[[], bool] = lambda: False
        self.state = ConfigState()
        self.journal = Journal()
        self._moves = 0  # items taken at most
        self._schedule_stats()

    def _collect(self, dialect: Dialect, clock_freq: int) -> Dictionary:
        commands, responses = [], []
        for part in self._parts:
            part.board = self
            responses += part.RESPONSES
            for handler in part.handlers():
                text = handler.command_text
                self._handlers[text.split()[0]] = handler
                if not text.startswith("identify "):
                    commands.append(text)
        constants = {
            "CLOCK_FREQ": clock_freq,
            "STATS_SUMSQ_BASE": 256,
            "ADC_MAX": 4095,
            "PWM_MAX": 255,
            "MCU": "simulated",
        }
        enums = {"pin": pins.enumeration(), "static_string_id": _REASON_IDS}
        return Dictionary(commands, responses, constants, enums, dialect.app)

    # Time

    def clock(self) -> int:
        """The board's clock now."""
        return (self._now_ns() - self._epoch_ns) // self._tick_ns

    def ns(self, clock: int) -> int:
        """When the board's clock shows this value, ns."""
        return self._epoch_ns + clock * self._tick_ns

    def clock_at(self, ns: int) -> int:
        """The board's clock at a time in ns."""
        return (ns - self._epoch_ns) // self._tick_ns

    def widen(self, clock32: int) -> int:
        """The clock nearest to now that has these low 32 bits."""
        now = self.clock()
        diff = (clock32 - now) & 0xFFFFFFFF
        return now + (diff - (1 << 32) if diff & 0x80000000 else diff)

    def schedule(self, clock: int, action: Callable[[int], None]) -> Event:
        """Call action(clock) when the clock gets there."""
        event = Event(action)
        heapq.heappush(self._events, (clock, next(self._order), event))
        return event

    def require_in_time(self, clock: int) -> None:
        """Raises ShutdownError if a command for this clock comes too late."""
        if clock < self.clock():
            raise ShutdownError("Timer too close")

    def take_move(self) -> None:
        """Take an item of the move queue.

        Counted anew only where it might be full: items come back by themselves.
        """
        if self._moves >= MOVE_COUNT:
            now = self.clock()
            self._moves = sum(part.waiting(now) for part in self._parts)
            if self._moves >= MOVE_COUNT:
                raise ShutdownError("Move queue overflow")
        self._moves += 1

    def next_event_ns(self) -> int | None:
        """When something is due on the board, ns."""
        while self._events and self._events[0][2].action is None:
            heapq.heappop(self._events)
        return self.ns(self._events[0][0]) if self._events else None

    def run_due(self) -> bool:
        """Run what is due by now; whether there was anything."""
        ran = False
        while self._events and self._events[0][0] <= self.clock():
            clock, _, event = heapq.heappop(self._events)
            if event.action is not None:
                ran = True
                self._carry_out(event.action, clock)
        return ran

    # Messages

    def receive(self, content: bytes) -> None:
        """Run the commands of one block, after what was due before it."""
        self.run_due()
        for name, values in self.dictionary.parse(content):
            if self.is_silent():
                return
            handler = self._handlers[name]
            if self.state.is_shutdown and not handler.in_shutdown:
                number = self.state.shutdown_id
                self.respond("is_shutdown", static_string_id=number)
                continue
            self._carry_out(handler, *values)

    def _carry_out(self, action: Callable, *values: Any) -> None:
        try:
            action(*values)
        except ShutdownError as reason:
            self.shut_down(str(reason))

    def respond(self, name: str, **values: Any) -> None:
        """Send a response."""
        if not self.is_silent():
            self.send(self.dictionary.response(name, values))

    def shut_down(self, reason: str = "Command request") -> None:
        """Stop everything, as for an emergency stop."""
        state = self.state
        if state.is_shutdown:
            return
        state.is_shutdown, state.shutdown_id = True, _REASON_IDS[reason]
        self.journal.shutdowns.append(reason)
        for part in self._parts:
            part.stop()
        clock = self.clock() & 0xFFFFFFFF
        number = state.shutdown_id
        self.respond("shutdown", clock=clock, static_string_id=number)

    def _schedule_stats(self) -> None:
        ticks = _STATS_NS // self._tick_ns
        self.schedule(self.clock() + ticks, self._stats)

    def _stats(self, clock: int) -> None:
        if self.state.is_config:
            self.respond("stats", count=1, sum=1, sumsq=1)
        self._schedule_stats()

    # Commands every board has

    @command("identify offset=%u count=%c", in_shutdown=True)
    def _identify(self, offset: int, count: int) -> None:
        data = self.dictionary.identify_data[offset : offset + count]
        self.respond("identify_response", offset=offset, data=data)

    @command("get_uptime", in_shutdown=True)
    def _get_uptime(self) -> None:
        clock = self.clock()
        self.respond("uptime", high=clock >> 32, clock=clock & 0xFFFFFFFF)

    @command("get_clock", in_shutdown=True)
    def _get_clock(self) -> None:
        self.respond("clock", clock=self.clock() & 0xFFFFFFFF)

    @command("get_config", in_shutdown=True)
    def _get_config(self) -> None:
        state = self.state
        self.respond(
            "config",
            is_config=int(state.is_config),
            crc=state.crc,
            is_shutdown=int(state.is_shutdown),
            move_count=MOVE_COUNT,
        )

    @command("allocate_oids count=%c")
    def _allocate_oids(self, count: int) -> None:
        self.state.oid_count = count

    @command("finalize_config crc=%u")
    def _finalize_config(self, crc: int) -> None:
        self.state.crc = crc
        self.state.is_config = True

    @command("emergency_stop", in_shutdown=True)
    def _emergency_stop(self) -> None:
        self.shut_down()

    @command("clear_shutdown", in_shutdown=True)
    def _clear_shutdown(self) -> None:
        self.state.is_shutdown = False

    @command("reset", in_shutdown=True)
    def _reset(self) -> None:
        """Reboot: motors stay where they are, everything else is forgotten."""
        for part in self._parts:
            part.stop()
            part.reset()
        self.state = ConfigState()
        self._events.clear()
        self._schedule_stats()
        self.journal.resets += 1


class Event:
    """Something scheduled; cancel by taking its action away."""

    __slots__ = ("action",)

    def __init__(self, action: Callable[[int], None] | None):
        self.action = action

    def cancel(self) -> None:
        """Never run the action."""
        self.action = None


class ConfigState:
    """What a host has configured."""

    def __init__(self) -> None:
        self.is_config = False
        self.is_shutdown = False
        self.shutdown_id = 0
        self.crc = 0
        self.oid_count = 0


class Journal:
    """What happened to the board; tests read it."""

    def __init__(self) -> None:
        self.shutdowns: list[str] = []  # their reasons
        self.resets = 0
