"""The loop that lets klippy and the simulated machine live on one clock."""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable, Iterable
from typing import Protocol, Union

from .children import Children
from .clock import NEVER, RealClock, VirtualClock
from .firmware import FirmwareBoard
from .mcu.board import Board
from .wire.link import Link, RawLink

# Klippy may compute this long (s, real) without falling asleep once; only a
# dead end takes longer
_STALL_LIMIT = 60.0
# And this long (s, real) nobody may seem to wait for anything: one that is on
# its way to wake another, or to its end
_DEAD_END = 2.0
# How long (s, real) klippy may speak before it is answered: it may wait for
# the answer without falling asleep, where a line is full
_SPEECH = 0.01
# How long (s, real) a paced clock stands before it is asked again whether it
# should go on at all
_LOOK_EVERY = 0.05


class SimulationError(Exception):
    """The simulation cannot go on."""


class Peer(Protocol):
    """Something else that talks to klippy, such as an API client."""

    def fileno(self) -> int:
        """Readable when klippy has said something; -1 while not connected."""

    def pump(self) -> bool:
        """Move what can be moved; whether anything was."""

    def settled(self) -> bool:
        """Whether all that was said has been received, on both sides."""


class Pace:
    """Keeps a clock from running ahead of real time, `speed` times as fast.

    It may fall behind, as it stands while klippy computes; it catches up then.
    """

    def __init__(self, clock: VirtualClock | RealClock, speed: float):
        self._start_ns = clock.now()
        self._began = time.monotonic()
        self.speed = speed

    def seconds_until(self, target_ns: int) -> float:
        """Real seconds before the clock may show this; negative: it may."""
        passed = (target_ns - self._start_ns) * 1e-9 / self.speed
        return self._began + passed - time.monotonic()


class Simulation:
    """Boards, their lines and peers around one klippy process.

    Steps are counted so that tests can tell the speed: `jumps` of the clock,
    `virtual_ns` passed.
    """

    def __init__(self, clock: VirtualClock | RealClock):
        self.clock = clock
        self._boards: list[Union[Board, FirmwareBoard]] = []
        self._programs: list[FirmwareBoard] = []
        self._links: list[tuple[Link, int]] = []
        self.peers: list[Peer] = []
        self.pace: Pace | None = None  # a virtual clock jumps freely without
        is_virtual = isinstance(clock, VirtualClock)
        self._children = Children(clock) if is_virtual else None
        self._children_pace: Pace | None = None
        # While a child of klippy's lives, printer time goes by so many times
        # as fast as its own; to wait less for one that hangs
        self.children_speed = 1.0
        self.process_fd = -1  # readable when the process has ended
        # Klippy has run since its end and what it may have said were looked at
        self._has_run = True
        self.started_ns = clock.now()
        self.jumps = 0

    def add_board(self, board: Board, latency_ns: int = 0) -> Link:
        """Give a board its serial line, with its latency."""
        return self._connect(
            board, Link(board.receive, latency_ns, self.clock.now)
        )

    def add_program(self, board: FirmwareBoard, latency_ns: int = 0) -> Link:
        """The same for a program, which lives on a virtual clock only."""
        link = RawLink(board.receive, latency_ns, self.clock.now)
        board.hang_up = link.hang_up
        self._programs.append(board)
        return self._connect(board, link)

    def _connect(self, board: Union[Board, FirmwareBoard], link: Link) -> Link:
        clock = self.clock
        index = clock.add_tty(link.device)
        if isinstance(clock, VirtualClock):
            # Most of the time nobody has spoken, and reading costs more
            link.is_spoken_to = lambda: clock.may_have_written(
                index, link.received
            )
            link.is_heard = lambda: clock.tty_is_open(index)
        board.send = link.send
        self._links.append((link, index))
        self._boards.append(board)
        return link

    @property
    def virtual_ns(self) -> int:
        """Time passed on the clock of the simulation."""
        return self.clock.now() - self.started_ns

    def run_until(
        self, done: Callable[[], bool], timeout: float, what: str
    ) -> None:
        """Let everybody live until done() or for timeout printer seconds.

        On a virtual clock klippy has also dealt with everything that belongs
        to the last instant. Raises SimulationError naming `what` on timeout,
        when klippy ends, or when nobody waits for anything any more.
        """
        end_ns = self.clock.now() + round(timeout * 1e9)
        self._has_run = True
        while True:
            while self._pump():
                pass
            ended = self._has_run and self.process_ended()
            self._has_run = ended
            finished = done()
            if finished and (ended or not self.clock.virtual):
                return
            if ended:
                if self._pump() or done():
                    continue
                raise SimulationError(f"{what}: klippy has ended")
            if self.clock.now() >= end_ns and not finished:
                raise SimulationError(f"{what}: {timeout:.0f} s have passed")
            if isinstance(self.clock, RealClock):
                self._wait_real(end_ns)
            elif self._pass_time(end_ns, finished, what):
                return

    def process_ended(self) -> bool:
        """Whether klippy is gone."""
        if self.process_fd < 0:
            return False
        # select() takes no number above 1023
        waiting = select.poll()
        waiting.register(self.process_fd, select.POLLIN)
        return bool(waiting.poll(0))

    def _pump(self) -> bool:
        moved = False
        for board in self._boards:
            moved |= board.run_due()
        for link, _ in self._links:
            moved |= link.pump()
        if self._has_run:
            for peer in self.peers:
                moved |= peer.pump()
        return moved

    def _next_event(self, end_ns: int) -> int:
        links = (link for link, _ in self._links)
        times = [part.next_event_ns() for part in (*self._boards, *links)]
        return min([end_ns, *(due for due in times if due is not None)])

    def _wait_real(self, end_ns: int) -> None:
        wait = (self._next_event(end_ns) - self.clock.now()) * 1e-9
        self._wait_for_klippy(self._descriptors(), max(0.0, wait))

    def _pass_time(self, end_ns: int, finished: bool, what: str) -> bool:
        """Move the clock, or wait for klippy where it is not at rest.

        When finished the clock stands; returns whether klippy is at rest.
        """
        clock = self.clock
        assert isinstance(clock, VirtualClock)
        # Bytes on their way may wake klippy while we look; advance() refuses
        # to move the clock if they did
        wakes = clock.wakes()
        if self._quiet():
            if self._programs and not self._programs_rest(wakes):
                return False
            now = clock.now()
            self._keep_pace_with_children()
            target = now if finished else self._target(end_ns)
            if target >= NEVER:
                self._wait_for_anybody(what)
                return False
            if self._is_held_back(target):
                return False
            if target > now:
                target = self._live_until(target)
            moved = clock.advance(max(target, now), wakes)
            self.jumps += moved and not finished
            return moved and finished
        if any(link.received for link, _ in self._links):
            self._require_joined(what)
        if not self._wait_for_doorbell(_STALL_LIMIT):
            raise SimulationError(
                f"{what}: klippy is busy for {_STALL_LIMIT:.0f} s of real time"
            )
        return False

    def _keep_pace_with_children(self) -> None:
        """Have a pace while a child lives: real time, from its start on."""
        assert self._children is not None
        if not self._children.look():
            self._children_pace = None
        elif self._children_pace is None:
            self._children_pace = Pace(self.clock, self.children_speed)

    def _wait_for_anybody(self, what: str) -> None:
        """Wait for who is on his way, or for a child, as no time will come."""
        if self._children_pace is None:
            limit, reason = _DEAD_END, "nobody waits for anything"
        else:
            limit = _STALL_LIMIT
            reason = f"klippy waits for a child for {limit:.0f} s of real time"
        assert isinstance(self.clock, VirtualClock)
        assert self._children is not None
        rang = self._wait_for_doorbell(limit, self._children.filenos())
        # Whoever was woken meanwhile, and computes, rings when he sleeps again
        if not rang and self.clock.everybody_sleeps():
            raise SimulationError(f"{what}: {reason}")

    def _programs_rest(self, wakes: int) -> bool:
        """Let programs hear what klippy has said; whether none had to.

        Klippy, too, must be at rest: nobody may wake while programs live.
        """
        clock = self.clock
        assert isinstance(clock, VirtualClock)
        if not clock.advance(clock.now(), wakes) or clock.wakes() != wakes:
            return False
        return not any([program.listen() for program in self._programs])

    def _live_until(self, target_ns: int) -> int:
        """Let programs live until then, or until one speaks; the time then."""
        while self._programs:
            first, *others = sorted(self._programs, key=FirmwareBoard.deadline)
            if first.deadline() > target_ns:
                break
            limit = min([target_ns, *(other.deadline() for other in others)])
            reached = first.live_until(limit)
            if first.next_event_ns() is not None:
                return reached
        return target_ns

    def stop_klippy(self, seconds: float) -> None:
        """Klippy, at rest, does not run for so long, but programs do."""
        end_ns = self.clock.now() + round(seconds * 1e9)
        for program in self._programs:
            while program.deadline() <= end_ns:
                program.live_until(end_ns)
        clock = self.clock
        assert isinstance(clock, VirtualClock)
        clock.advance(end_ns, clock.wakes())

    def _is_held_back(self, target_ns: int) -> bool:
        """Whether the pace forbids this time; if so, some time has passed.

        Less than needed where others speak to klippy meanwhile: it may want
        to be woken earlier then.
        """
        paces = self.pace, self._children_pace
        waits = [pace.seconds_until(target_ns) for pace in paces if pace]
        wait = max(waits, default=0.0)
        if wait <= 0.0:
            return False
        assert self._children is not None
        self._wait_for_doorbell(
            min(wait, _LOOK_EVERY), self._children.filenos()
        )
        return True

    def _wait_for_doorbell(
        self, seconds: float, others: Iterable[int] = ()
    ) -> bool:
        """Wait until klippy speaks or falls asleep; whether it did.

        others: descriptors that end the wait, too.
        """
        clock = self.clock
        assert isinstance(clock, VirtualClock)
        rang = False
        if not clock.everybody_sleeps():
            # It mostly speaks several times before it falls asleep
            few = [clock.doorbell, *self._process()]
            rang = self._wait_for_klippy(few, min(seconds, _SPEECH))
        if not rang:
            descriptors = [*self._descriptors(), clock.doorbell, *others]
            rang = self._wait_for_klippy(descriptors, seconds)
        clock.answer_doorbell()
        return rang

    def _target(self, end_ns: int) -> int:
        """When the next thing happens; NEVER if nothing will."""
        clock = self.clock
        assert isinstance(clock, VirtualClock)
        deadline = clock.next_deadline()
        target = min(deadline, self._next_event(NEVER))
        if self._children_pace:
            # How long git takes to tell klippy its version at the start is
            # nothing that a machine may depend on
            if deadline >= NEVER and not self._is_in_contact():
                return NEVER
            # Whoever is woken by a child finds that time has passed
            step_ns = _LOOK_EVERY * 1e9 * self._children_pace.speed
            target = min(target, clock.now() + round(step_ns))
        if self._programs:
            return min(target, end_ns)
        return target if target >= NEVER else min(target, end_ns)

    def _is_in_contact(self) -> bool:
        """Whether klippy and a board can hear each other."""
        clock = self.clock
        assert isinstance(clock, VirtualClock)
        return any(clock.tty_is_open(index) for _, index in self._links)

    def _require_joined(self, what: str) -> None:
        """A klippy that speaks but never came to our clock never will."""
        assert isinstance(self.clock, VirtualClock)
        if not self.clock.joined():
            raise SimulationError(
                f"{what}: klippy runs in real time, {self.clock.library}"
                " was not preloaded"
            )

    def _quiet(self) -> bool:
        """Whether nothing can happen before the clock moves."""
        clock = self.clock
        assert isinstance(clock, VirtualClock)
        if not clock.everybody_sleeps():
            return False
        for link, index in self._links:
            if not link.settled():
                return False
            if not clock.tty_settled(index, link.sent, link.received):
                return False
        return all(peer.settled() for peer in self.peers)

    def _descriptors(self) -> list[int]:
        found = [link.fileno() for link, _ in self._links]
        found += [p.fileno() for p in self.peers if p.fileno() >= 0]
        return found + self._process()

    def _process(self) -> list[int]:
        return [] if self.process_fd < 0 else [self.process_fd]

    def _wait_for_klippy(
        self, descriptors: Iterable[int], seconds: float
    ) -> bool:
        self._has_run = True
        poller = select.poll()
        for fd in descriptors:
            poller.register(fd, select.POLLIN)
        return bool(poller.poll(seconds * 1000.0))

    def close(self) -> None:
        """Hang up all lines and give the clock back.

        Klippy has ended; what it has started and left behind is ended, too.
        """
        if self._children is not None:
            self._children.end()
        for link, _ in self._links:
            link.close()
        for program in self._programs:
            program.close()
        if self.process_fd >= 0:
            os.close(self.process_fd)
        self.clock.close()


class Stopwatch:
    """Real and printer seconds of a stretch of a simulation."""

    def __init__(self, simulation: Simulation):
        self._simulation = simulation
        self._real = time.monotonic()
        self._virtual = simulation.virtual_ns

    def seconds(self) -> tuple[float, float]:
        """(real, printer) seconds since it was made."""
        virtual = (self._simulation.virtual_ns - self._virtual) * 1e-9
        return time.monotonic() - self._real, virtual
