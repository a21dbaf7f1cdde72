"""Endstops and the trigger synchronisation that stops steppers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from .board import Board, Event, Peripheral, command
from .steppers import Steppers

# How far ahead an armed endstop looks for its edge in one go
_LOOK_AHEAD_NS = 50_000_000


class Trsync:
    """One trigger: who triggers it and what it stops."""

    def __init__(self, oid: int, board: Board):
        self.oid = oid
        self._board = board
        self.signals: list[Callable[[int], None]] = []
        self.can_trigger = False
        self.reason = 0
        self.expire_reason = 0
        self._report: Event | None = None
        self._expire: Event | None = None
        self._report_ticks = 0

    def start(self, clock: int, ticks: int, expire_reason: int) -> None:
        """Arm it; report every `ticks` from clock on."""
        self.clear()
        self.can_trigger = True
        self.expire_reason = expire_reason
        self._report_ticks = ticks
        if ticks:
            self._board.require_in_time(clock)
            self._report = self._board.schedule(clock, self._periodic)

    def set_timeout(self, clock: int) -> None:
        """Trigger by itself at a clock unless told a later one."""
        if not self.can_trigger:
            return
        if self._expire:
            self._expire.cancel()
        self._board.require_in_time(clock)
        self._expire = self._board.schedule(clock, self._expired)

    def trigger(self, reason: int, clock: int) -> None:
        """Stop everything that listens, once, as of clock, and report it."""
        if self.can_trigger:
            self.fire(reason, clock)
            self.report(clock)

    def fire(self, reason: int, clock: int) -> None:
        """The same without the report."""
        if not self.can_trigger:
            return
        self.can_trigger = False
        self.reason = reason
        signals, self.signals = self.signals, []
        for signal in signals:
            signal(clock)

    def clear(self) -> None:
        """Disarm and forget who listens."""
        self.silence()
        self.signals = []
        self.can_trigger = False
        self.reason = self.expire_reason = 0

    def silence(self) -> None:
        """No more reports, no timeout."""
        for event in (self._report, self._expire):
            if event:
                event.cancel()
        self._report = self._expire = None

    def report(self, clock: int) -> None:
        """Tell the host."""
        self._board.respond(
            "trsync_state",
            oid=self.oid,
            can_trigger=int(self.can_trigger),
            trigger_reason=self.reason,
            clock=clock & 0xFFFFFFFF,
        )

    def _periodic(self, clock: int) -> None:
        self.report(clock)
        self._report = self._board.schedule(
            clock + self._report_ticks, self._periodic
        )

    def _expired(self, clock: int) -> None:
        self._expire = None
        self.trigger(self.expire_reason, clock)


class TrsyncTable(Peripheral):
    """All trsyncs of a board and the steppers they stop."""

    RESPONSES = (
        "trsync_state oid=%c can_trigger=%c trigger_reason=%c clock=%u",
    )

    def __init__(self, steppers: Steppers):
        self._steppers = steppers
        self.by_oid: dict[int, Trsync] = {}

    def stop(self) -> None:
        """Disarm all."""
        for trsync in self.by_oid.values():
            trsync.clear()

    def reset(self) -> None:
        """Forget the configuration."""
        self.by_oid.clear()

    @command("config_trsync oid=%c")
    def _config(self, oid: int) -> None:
        self.by_oid[oid] = Trsync(oid, self.board)

    @command(
        "trsync_start oid=%c report_clock=%u report_ticks=%u expire_reason=%c"
    )
    def _start(self, oid: int, clock: int, ticks: int, reason: int) -> None:
        self.by_oid[oid].start(self.board.widen(clock), ticks, reason)

    @command("trsync_set_timeout oid=%c clock=%u")
    def _set_timeout(self, oid: int, clock: int) -> None:
        self.by_oid[oid].set_timeout(self.board.widen(clock))

    @command("trsync_trigger oid=%c reason=%c")
    def _trigger(self, oid: int, reason: int) -> None:
        trsync = self.by_oid[oid]
        trsync.fire(reason, self.board.clock())
        trsync.silence()
        # Always answered: the host waits for it
        trsync.report(0)

    @command("stepper_stop_on_trigger oid=%c trsync_oid=%c")
    def _stop_on_trigger(self, oid: int, trsync_oid: int) -> None:
        stepper = self._steppers.by_oid[oid]
        self.by_oid[trsync_oid].signals.append(
            lambda clock: self._steppers.halt(stepper, clock)
        )


class Sense(Protocol):
    """Where pins get their levels from."""

    def level(self, pin: int, ns: int) -> bool:
        """Electrical level of a pin at a time not far from now."""

    def edge(self, pin: int, wanted: bool, first_ns: int, last_ns: int):
        """First time in (first_ns, last_ns] with the wanted level, or None."""

    def armed(self, pin: int, ns: int) -> None:
        """An endstop on this pin starts to look."""

    def disarmed(self, pin: int) -> None:
        """It looks no longer."""

    def queried(self, pin: int, ns: int) -> None:
        """The host asks for the level of this pin."""


class Endstop:
    """One endstop input and its current search."""

    def __init__(self, pin: int):
        self.pin = pin
        self.homing = False
        self.next_clock = 0
        self.search: Search | None = None


class Search:
    """A running endstop_home: where it samples and whom it triggers."""

    def __init__(self, start: int, rest: int, sample: int, count: int):
        self.start = start
        self.rest = rest
        self.sample = sample
        self.count = count
        self.wanted = False
        self.fire: Callable[[int], None] = lambda clock: None
        self.event: Event | None = None
        # New steps before this clock may change what was found; 0 once a
        # sample has matched, as the others are taken one by one
        self.looked_until = start

    def grid(self, clock: int) -> int:
        """The first sampling clock at or after a clock."""
        steps = -(-(clock - self.start) // self.rest)
        return self.start + max(0, steps) * self.rest


class Endstops(Peripheral):
    """All endstops of a board.

    Instead of sampling every few microseconds the edge is computed from the
    steps already queued; it is then sampled on exactly the ticks the firmware
    would use: every rest_ticks until the first match, then sample_count times
    every sample_ticks. Steps that arrive later for a time already looked at
    start the look again.
    """

    RESPONSES = ("endstop_state oid=%c homing=%c next_clock=%u pin_value=%c",)

    def __init__(self, sense: Sense, trsyncs: TrsyncTable):
        self._sense = sense
        self._trsyncs = trsyncs
        self.by_oid: dict[int, Endstop] = {}

    def stop(self) -> None:
        """End all searches."""
        for endstop in self.by_oid.values():
            self._end(endstop)

    def reset(self) -> None:
        """Forget the configuration."""
        self.by_oid.clear()

    def steps_queued(self, start_ns: int) -> None:
        """New steps: look again where they can matter.

        From now on, as an edge found before they begin is still to come.
        """
        start = self.board.clock_at(start_ns)
        for endstop in self.by_oid.values():
            search = endstop.search
            if search and start < search.looked_until:
                self._look_at(endstop, max(search.start, self.board.clock()))

    def _end(self, endstop: Endstop) -> None:
        if endstop.search and endstop.search.event:
            endstop.search.event.cancel()
        endstop.search = None
        if endstop.homing:
            endstop.homing = False
            self._sense.disarmed(endstop.pin)

    def _look_at(self, endstop: Endstop, clock: int) -> None:
        """Look for the edge from clock on, when the clock gets there."""
        search = endstop.search
        assert search is not None
        if search.event:
            search.event.cancel()
        clock = search.grid(clock)
        search.looked_until = clock
        search.event = self.board.schedule(
            clock, lambda now: self._look(endstop, now)
        )

    def _look(self, endstop: Endstop, clock: int) -> None:
        search = endstop.search
        assert search is not None
        board = self.board
        first = board.ns(clock)
        if self._sense.level(endstop.pin, first) == search.wanted:
            endstop.next_clock = clock + search.rest
            search.looked_until = 0
            self._sample(endstop, clock, 1)
            return
        last = first + _LOOK_AHEAD_NS
        found = self._sense.edge(endstop.pin, search.wanted, first, last)
        if found is None:
            self._look_at(endstop, board.clock_at(last))
            return
        # Round up: a tick that is not over yet cannot show the edge
        tick = search.grid(board.clock_at(found - 1) + 1)
        search.looked_until = board.clock_at(last)
        search.event = board.schedule(
            tick, lambda now: self._look(endstop, now)
        )

    def _sample(self, endstop: Endstop, first: int, taken: int) -> None:
        """Take the samples that follow the first match; the last triggers."""
        search = endstop.search
        assert search is not None
        clock = first + (taken - 1) * search.sample
        level = self._sense.level(endstop.pin, self.board.ns(clock))
        if level != search.wanted:
            self._look_at(endstop, first + search.rest)
        elif taken == search.count:
            search.fire(clock)
        else:
            search.event = self.board.schedule(
                clock + search.sample,
                lambda now: self._sample(endstop, first, taken + 1),
            )

    @command("config_endstop oid=%c pin=%c pull_up=%c")
    def _config(self, oid: int, pin: int, pull_up: int) -> None:
        self.by_oid[oid] = Endstop(pin)

    @command(
        "endstop_home oid=%c clock=%u sample_ticks=%u sample_count=%c"
        " rest_ticks=%u pin_value=%c trsync_oid=%c trigger_reason=%c"
    )
    def _home(
        self,
        oid: int,
        clock: int,
        sample_ticks: int,
        sample_count: int,
        *rest: int,
    ) -> None:
        rest_ticks, pin_value, trsync_oid, reason = rest
        endstop = self.by_oid[oid]
        self._end(endstop)
        if not sample_count:
            return
        start = self.board.widen(clock)
        self.board.require_in_time(start)
        search = Search(start, rest_ticks, sample_ticks, sample_count)
        search.wanted = bool(pin_value)
        trsync = self._trsyncs.by_oid[trsync_oid]
        search.fire = lambda now: trsync.trigger(reason, now)
        endstop.search = search
        endstop.homing = True
        self._sense.armed(endstop.pin, self.board.ns(start))
        self._look_at(endstop, start)

    @command("endstop_query_state oid=%c")
    def _query(self, oid: int) -> None:
        endstop = self.by_oid[oid]
        now = self.board.ns(self.board.clock())
        self._sense.queried(endstop.pin, now)
        self.board.respond(
            "endstop_state",
            oid=oid,
            homing=int(endstop.homing),
            next_clock=endstop.next_clock & 0xFFFFFFFF,
            pin_value=int(self._sense.level(endstop.pin, now)),
        )
