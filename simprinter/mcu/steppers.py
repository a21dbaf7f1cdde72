"""Steppers: the exact count of steps at every tick."""

from __future__ import annotations

import bisect
import math
from typing import Protocol

from .board import Peripheral, ShutdownError, command

_CLOCK = 0xFFFFFFFF


class StepTrack:
    """All steps of one motor as a function of the board's clock.

    Each queued move is kept as (clock it is relative to, interval, count, add,
    direction, position before): its n-th step falls n * interval + add * n *
    (n - 1) / 2 ticks after that clock. A step counts from its own tick on.
    """

    def __init__(self) -> None:
        # When each move takes over from the one before. That is not the clock
        # it is relative to: hosts reset that to 0, long before older moves
        self._begins: list[int] = []
        self._moves: list[tuple[int, int, int, int, int, int]] = []
        self._rest = 0  # position before the first move kept
        self.last_clock = 0  # of the last step queued
        self.position = 0  # after everything queued

    def append(
        self,
        interval: int,
        count: int,
        add: int,
        sign: int,
        start: int | None = None,
    ) -> int:
        """Queue a move; the clock after which positions change.

        start: the clock it is relative to, that of the last step if None.
        """
        begin = self.last_clock
        if start is None:
            start = begin
        ticks = interval * count + add * count * (count - 1) // 2
        begin = max(begin, start)
        self._begins.append(begin)
        self._moves.append((start, interval, count, add, sign, self.position))
        self.position += sign * count
        self.last_clock = start + ticks
        return begin

    def newest(self) -> int:
        """Clock of the first step of what was queued last."""
        start, interval, *_ = self._moves[-1]
        return start + interval

    def at(self, clock: int) -> int:
        """Position (steps) at a clock."""
        if clock >= self.last_clock:
            return self.position
        i = bisect.bisect_right(self._begins, clock) - 1
        if i < 0:
            return self._rest
        start, interval, count, add, sign, before = self._moves[i]
        steps = steps_in(clock - start, interval, count, add)
        return before + sign * steps

    def waiting(self, clock: int) -> int:
        """How many of the moves have not begun at a clock."""
        return len(self._begins) - bisect.bisect_right(self._begins, clock)

    def begins_by(self, clock: int) -> bool:
        """Whether any move that is known begins by a clock."""
        return bool(self._begins) and clock >= self._begins[0]

    def cut(self, clock: int) -> None:
        """Forget all steps after a clock."""
        self.position = self.at(clock)
        while self._begins and self._begins[-1] >= clock:
            self._begins.pop()
            self._moves.pop()
        if self._begins:
            start, interval, _, add, sign, before = self._moves[-1]
            count = abs(self.position - before)
            if count:
                self._moves[-1] = (start, interval, count, add, sign, before)
            else:
                self._begins.pop()
                self._moves.pop()
        if not self._begins:
            self._rest = self.position
        self.last_clock = min(self.last_clock, clock)

    def forget(self, clock: int) -> None:
        """Drop what nobody will ask for: positions before a clock."""
        keep = bisect.bisect_right(self._begins, clock) - 1
        if keep > 0:
            self._rest = self._moves[keep][5]
            del self._begins[:keep], self._moves[:keep]


def steps_in(elapsed: int, interval: int, count: int, add: int) -> int:
    """How many steps of a move have been made after elapsed ticks."""
    if elapsed < interval:
        return 0
    if not add:
        return min(elapsed // interval, count)
    # Solve n * interval + add * n * (n - 1) / 2 = elapsed for n; a float gets
    # within one step, whole numbers settle it
    linear = interval - add / 2
    root = linear * linear + 2.0 * add * elapsed
    guess = count
    if root >= 0.0:
        guess = min(int((math.sqrt(root) - linear) / add), count)

    def ticks(n: int) -> int:
        return n * interval + add * n * (n - 1) // 2

    while guess < count and ticks(guess + 1) <= elapsed:
        guess += 1
    while guess > 0 and ticks(guess) > elapsed:
        guess -= 1
    return guess


def _too_far_in_past(_clock: int) -> None:
    raise ShutdownError("Stepper too far in past")


class Stepper:
    """One configured stepper."""

    def __init__(self, track: StepTrack):
        self.track = track
        self.direction = 0
        self.needs_reset = False
        self.zero = 0  # track position that the host counts from
        # What the next interval counts from instead of the last step; 32
        # bits, 0 at the start
        self.step_clock: int | None = 0


class Drive(Protocol):
    """Where motors report to: the mechanics behind the board."""

    def track(self, step_pin: int, dir_pin: int) -> StepTrack:
        """The track of the motor on these pins."""

    def steps_queued(self, start_ns: int) -> None:
        """New steps begin after start_ns."""

    def settle(self, ns: int) -> None:
        """Everything up to ns has happened."""


class Steppers(Peripheral):
    """All steppers of a board."""

    RESPONSES = ("stepper_position oid=%c pos=%i",)

    def __init__(self, drive: Drive):
        self._drive = drive
        self.by_oid: dict[int, Stepper] = {}

    def stop(self) -> None:
        """Halt all motors where they are."""
        for stepper in self.by_oid.values():
            self.halt(stepper, self.board.clock())

    def reset(self) -> None:
        """Forget the configuration."""
        self.by_oid.clear()

    def waiting(self, clock: int) -> int:
        """Moves that are to come."""
        steppers = self.by_oid.values()
        return sum(stepper.track.waiting(clock) for stepper in steppers)

    def halt(self, stepper: Stepper, clock: int) -> None:
        """Stop a motor at a clock; it then waits for a new step clock."""
        self._drive.settle(self.board.ns(clock))
        stepper.track.cut(clock)
        stepper.direction = 0
        stepper.needs_reset = True

    @command(
        "config_stepper oid=%c step_pin=%c dir_pin=%c invert_step=%c"
        " step_pulse_ticks=%u"
    )
    def _config(
        self, oid: int, step_pin: int, dir_pin: int, *_pulse: int
    ) -> None:
        stepper = Stepper(self._drive.track(step_pin, dir_pin))
        stepper.zero = stepper.track.position
        self.by_oid[oid] = stepper

    @command("queue_step oid=%c interval=%u count=%hu add=%hi")
    def _queue_step(self, oid: int, interval: int, count: int, add: int):
        self.board.take_move()
        stepper = self.by_oid.get(oid)
        # Some are on their way when the board is reset
        if stepper is None or stepper.needs_reset:
            return
        track = stepper.track
        start = track.last_clock
        base, stepper.step_clock = stepper.step_clock, None
        if base is None and start < self.board.clock():
            base = start
        if base is not None:
            # Only the 32-bit sum is sure to be near to now: the base may be 0
            # or so long ago that the interval has wrapped
            first = self.board.widen((base + interval) & _CLOCK)
            self.board.require_in_time(first)
            start = first - interval
        elif interval > _CLOCK // 2:
            # Found out when the move before it has ended
            self.board.schedule(start, _too_far_in_past)
            return
        sign = 1 if stepper.direction else -1
        begin = track.append(interval, count, add, sign, start)
        self._drive.steps_queued(self.board.ns(begin))

    @command("set_next_step_dir oid=%c dir=%c")
    def _set_dir(self, oid: int, direction: int) -> None:
        if oid in self.by_oid:
            self.by_oid[oid].direction = direction

    @command("reset_step_clock oid=%c clock=%u")
    def _reset_clock(self, oid: int, clock: int) -> None:
        stepper = self.by_oid.get(oid)
        if stepper is not None:
            if stepper.track.last_clock > self.board.clock():
                raise ShutdownError("Can't reset time when stepper active")
            stepper.step_clock = clock
            stepper.needs_reset = False

    @command("stepper_get_position oid=%c")
    def _get_position(self, oid: int) -> None:
        stepper = self.by_oid[oid]
        position = stepper.track.at(self.board.clock()) - stepper.zero
        self.board.respond("stepper_position", oid=oid, pos=position)
