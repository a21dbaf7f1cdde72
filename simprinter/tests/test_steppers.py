"""Step tracks against lists of steps, and the commands of a stepper."""

from __future__ import annotations

from bisect import bisect_right

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.mcu.board import CLOCK_FREQ
from simprinter.mcu.steppers import Steppers, StepTrack, steps_in
from simprinter.tests.workbench import LOW32, Bench


def ticks_of(interval: int, count: int, add: int) -> list[int]:
    """Ticks of all steps after the move's clock, as the firmware counts."""
    ticks, clock = [], 0
    for _ in range(count):
        clock += interval
        interval += add
        ticks.append(clock)
    return ticks


@st.composite
def moves(draw, longest: int = 300) -> tuple[int, int, int]:
    """(interval, count, add) whose intervals stay above zero.

    Klippy's compression makes adds of 16 bits, negative while speeding up.
    """
    count = draw(st.integers(1, longest))
    add = draw(st.integers(-0x8000, 0x7FFF) | st.integers(-3, 3))
    lowest = 1 - min(0, add) * (count - 1)
    interval = draw(st.integers(lowest, lowest + 200) | st.integers(lowest))
    return min(interval, max(lowest, LOW32)), count, add


@given(moves(), st.data())
def test_steps_in_counts_like_a_loop(move, data):
    ticks = ticks_of(*move)
    near = data.draw(st.sampled_from(ticks))
    elapsed = data.draw(
        st.integers(near - 2, near + 2) | st.integers(-5, ticks[-1] + 1000)
    )
    assert steps_in(elapsed, *move) == bisect_right(ticks, elapsed)


@pytest.mark.parametrize(
    "move",
    [
        (0x7FFFFFFF, 65535, 1),
        (0x7FFFFFFF, 65535, -32767),
        (32767 * 65534 + 1, 65535, -32767),
        (1, 65535, 32767),
        (1, 65535, 0),
    ],
    ids=str,
)
def test_steps_in_at_the_limits_of_the_protocol(move):
    ticks = ticks_of(*move)
    for n in (1, 2, 777, 32768, 65534, 65535):
        tick = ticks[n - 1]
        assert steps_in(tick - 1, *move) == n - 1
        assert steps_in(tick, *move) == n
    assert steps_in(ticks[-1] * 2 + 10**9, *move) == 65535


class NaiveTrack:
    """Every single step as (clock, sign)."""

    def __init__(self) -> None:
        self.steps: list[tuple[int, int]] = []
        self.last_clock = 0

    def append(self, start: int, move: tuple[int, int, int], sign: int) -> None:
        ticks = ticks_of(*move)
        self.steps += [(start + tick, sign) for tick in ticks]
        self.last_clock = start + ticks[-1]

    def cut(self, clock: int) -> None:
        self.steps = [step for step in self.steps if step[0] <= clock]
        self.last_clock = min(self.last_clock, clock)

    def at(self, clock: int) -> int:
        return sum(sign for tick, sign in self.steps if tick <= clock)


def probes(naive: NaiveTrack) -> list[int]:
    """Clocks at which something may be off by one."""
    ticks = {tick for tick, _ in naive.steps} | {0, naive.last_clock}
    return sorted({tick + d for tick in ticks for d in (-1, 0, 1)})


SIGNS = st.sampled_from((-1, 1))
# What happens to a track: a move that follows on, one that is counted from a
# clock given anew (gap before its first step, and how long before that its
# clock is), a cut at a share of all there is
EVENTS = st.lists(
    st.tuples(st.just("move"), moves(12), SIGNS)
    | st.tuples(
        st.just("restart"), moves(12), SIGNS, st.integers(1, 500), st.booleans()
    )
    | st.tuples(st.just("cut"), st.floats(0.0, 1.2)),
    min_size=1,
    max_size=12,
)


def play(events) -> tuple[StepTrack, NaiveTrack]:
    """The same events on both tracks."""
    track, naive = StepTrack(), NaiveTrack()
    for event in events:
        if event[0] == "cut":
            clock = round(naive.last_clock * event[1])
            track.cut(clock)
            naive.cut(clock)
            continue
        move, sign = event[1], event[2]
        start = naive.last_clock
        if event[0] == "restart":
            first = start + event[3]
            if event[4]:  # hosts reset to 0: a first interval of 32 bits
                move = (first, 1, 0)
            start = first - move[0]
            track.append(*move, sign, start)
        else:
            track.append(*move, sign)
        naive.append(start, move, sign)
    return track, naive


@given(EVENTS, st.floats(0.0, 1.0))
def test_track_knows_every_position(events, share):
    track, naive = play(events)
    assert track.position == naive.at(naive.last_clock)
    assert track.last_clock == naive.last_clock
    clocks = probes(naive)
    for clock in clocks:
        assert track.at(clock) == naive.at(clock)
        # Movement is never overlooked
        if any(tick <= clock for tick, _ in naive.steps):
            assert track.begins_by(clock)
    oldest = round(naive.last_clock * share)
    track.forget(oldest)
    for clock in clocks:
        if clock >= oldest:
            assert track.at(clock) == naive.at(clock)


def test_forgetting_shortens_the_list():
    track = StepTrack()
    for _ in range(1000):
        track.append(10, 10, 0, 1)
    assert not track.begins_by(-1)
    track.forget(90_000)
    # Whoever asks for what is forgotten gets the oldest position known
    assert track.at(0) == 9000
    assert track.at(90_010) == 9001


# Commands

OID = 4


class Mechanics:
    """One track for all motors; notes what it is told."""

    def __init__(self) -> None:
        self.the_track = StepTrack()
        self.pins: list[tuple[int, int]] = []
        self.steps_queued = (queued := []).append
        self.settle = (settled := []).append
        self.queued, self.settled = queued, settled

    def track(self, step_pin: int, dir_pin: int) -> StepTrack:
        self.pins.append((step_pin, dir_pin))
        return self.the_track


class StepperBench(Bench):
    """A bench with one stepper."""

    def __init__(self) -> None:
        self.mechanics = Mechanics()
        self.steppers = Steppers(self.mechanics)
        super().__init__(self.steppers)
        self.configure()

    def configure(self) -> None:
        self.config_stepper(OID, 17, 33)


@pytest.fixture
def bench() -> StepperBench:
    return StepperBench()


def test_direction_one_counts_up(bench):
    assert bench.mechanics.pins == [(17, 33)]
    start = bench.now()
    bench.reset_clock(OID, start)
    # Down until it is told
    bench.queue(OID, 1000, 1)
    for direction, count in ((1, 5), (0, 8), (1, 1)):
        bench.turn(OID, direction)
        bench.queue(OID, 1000, count)
    positions = []
    for n in range(16):
        bench.run_to(start + n * 1000)
        positions.append(bench.position(OID))
    wanted = [0, -1, 0, 1, 2, 3, 4, 3, 2, 1, 0, -1, -2, -3, -4, -3]
    assert positions == wanted
    # The world is told from when on positions change
    clocks = [bench.board.clock_at(ns) for ns in bench.mechanics.queued]
    assert clocks == [start + n * 1000 for n in (0, 1, 6, 14)]


def test_what_was_on_its_way_at_a_reset_moves_nothing(bench):
    bench.tell("reset")
    bench.turn(OID, 1)
    bench.reset_clock(OID, bench.now())
    bench.queue(OID, 1000, 5)
    assert bench.mechanics.queued == []
    # Nor does it count for the motor that is configured next
    bench.configure()
    bench.queue(OID, bench.now() + 1000)
    bench.run_to(bench.now() + 2000)
    assert bench.position(OID) == -1


# Seconds that the motor has rested; whether the step clock is reset to 0.
# Intervals have 32 bits, which is 86 s: longer ones have wrapped
@pytest.mark.parametrize("seconds", [1, 30, 43, 60, 130])
@pytest.mark.parametrize("resets", [True, False])
def test_motor_that_has_rested(bench, seconds, resets):
    bench.turn(OID, 1)
    # The step clock is zero at the start
    last = bench.now() + 5000
    bench.queue(OID, last - 4000)
    bench.queue(OID, 1000, 4)
    bench.run_to(last + seconds * CLOCK_FREQ)
    first = bench.now() + 5000
    if resets:
        bench.reset_clock(OID, 0)
    bench.queue(OID, (first if resets else first - last) & LOW32)
    bench.queue(OID, 100, 3, 10)
    for ahead, position in ((-1, 5), (0, 6), (100, 7), (209, 7), (210, 8)):
        bench.run_to(first + ahead)
        assert bench.position(OID) == position
    # Sensors look back by their latency, so what was before must not change
    assert bench.mechanics.the_track.at(last - 1) == 4
    assert bench.board.journal.shutdowns == []


@pytest.mark.parametrize("stop", ["halt", "shutdown"])
def test_halted_stepper_drops_steps_until_its_clock_is_reset(bench, stop):
    start = bench.now()
    bench.move(OID, start, 1000, 100)
    bench.run_to(start + 10_500)
    if stop == "halt":
        bench.steppers.halt(bench.steppers.by_oid[OID], bench.now())
    else:
        bench.tell("emergency_stop")
        bench.tell("clear_shutdown")
    # The world settles before steps are taken back
    assert bench.mechanics.settled == [bench.ns]
    bench.queue(OID, 1000, 100)
    bench.run_to(start + 1_000_000)
    assert bench.position(OID) == 10
    bench.reset_clock(OID, bench.now())
    bench.queue(OID, 1000, 3)
    bench.run_to(bench.now() + 10_000)
    # Halting has also reset the direction
    assert bench.position(OID) == 7
    assert [bench.mechanics.the_track.at(start + n) for n in (999, 5000)] == [
        0,
        5,
    ]


def test_direction_given_while_halted_holds(bench):
    bench.steppers.halt(bench.steppers.by_oid[OID], bench.now())
    bench.move(OID, bench.now(), 1000, 3)
    bench.run_to(bench.now() + 10_000)
    assert bench.position(OID) == 3


def test_reboot_keeps_the_motor_and_counts_from_there(bench):
    for count, position in ((7, 7), (2, 9)):
        bench.move(OID, bench.now(), 1000, count)
        bench.run_to(bench.now() + 10_000)
        assert bench.mechanics.the_track.at(bench.now()) == position
        bench.tell("reset")
        bench.configure()
        assert bench.position(OID) == 0


@pytest.mark.parametrize("late", [0, 1])
def test_motor_at_rest_is_told_in_time(bench, late):
    bench.move(OID, bench.now() - 1000 - late, 1000, 5)
    bench.run_to(bench.now() + 5000)
    if late:
        assert bench.shutdown() == "Timer too close"
    else:
        assert bench.position(OID) == 5


def test_step_before_the_one_before_it(bench):
    start = bench.now()
    bench.move(OID, start, 1000, 5)
    bench.queue(OID, -(CLOCK_FREQ // 100) & LOW32)
    bench.run_to(start + 4999)
    assert bench.board.journal.shutdowns == []
    bench.run_to(start + 5000)
    assert bench.shutdown() == "Stepper too far in past"


def test_step_clock_of_a_moving_motor_stays(bench):
    start = bench.now()
    bench.move(OID, start, 1000, 5)
    bench.run_to(start + 5000)
    bench.reset_clock(OID, start + 6000)
    bench.queue(OID, 1000)
    assert bench.board.journal.shutdowns == []
    bench.reset_clock(OID, 0)
    assert bench.shutdown() == "Can't reset time when stepper active"


def test_move_queue_has_an_end(bench):
    size = bench.ask("get_config")["move_count"]
    start = bench.now()
    bench.move(OID, start, 1000, 2)
    # The first is no longer in the queue, and what has begun leaves it
    for _ in range(size):
        bench.queue(OID, 1000, 2)
    bench.run_to(start + 10_000)
    for _ in range(5):
        bench.queue(OID, 1000, 2)
    assert bench.board.journal.shutdowns == []
    bench.queue(OID, 1000, 2)
    assert bench.shutdown() == "Move queue overflow"
    # A shutdown empties it
    bench.tell("clear_shutdown")
    bench.move(OID, bench.now(), 1000, 1)
    bench.run_to(bench.now() + 1000)
    assert bench.position(OID) == 11
