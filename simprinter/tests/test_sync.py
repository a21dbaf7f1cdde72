"""Triggers, and endstops against a firmware that samples tick by tick."""

from __future__ import annotations

from bisect import bisect_right
from typing import Callable, NamedTuple

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.mcu.board import TICK_NS
from simprinter.mcu.steppers import Steppers, StepTrack
from simprinter.mcu.sync import Endstops, TrsyncTable
from simprinter.tests.workbench import LOW32, Bench

STEPPER, TRSYNC, ENDSTOP = 1, 2, 3
PIN, REASON, EXPIRED = 7, 5, 9


class Settings(NamedTuple):
    """Sampling of one homing move, ticks."""

    sample: int
    count: int
    rest: int
    wanted: bool = True


class Outcome(NamedTuple):
    """When the endstop triggered, and the next_clock it reports."""

    trigger: int | None
    next_clock: int


def firmware(
    level: Callable[[int], bool], start: int, end: int, how: Settings
) -> Outcome:
    """What a micro-controller does that looks at the pin again and again.

    In words: every `rest` ticks until a sample is as wanted; then that sample
    and count - 1 more, `sample` ticks apart. One that differs sends it back to
    the tick `rest` after the first. The last one triggers.
    """
    first, reported = start, 0
    while first <= end:
        if level(first) != how.wanted:
            first += how.rest
            continue
        reported = first + how.rest
        tick, left = first, how.count - 1
        while left and level(tick + how.sample) == how.wanted:
            tick += how.sample
            left -= 1
        if not left:
            return Outcome(tick if tick <= end else None, reported)
        first += how.rest
    return Outcome(None, reported)


class Parts:
    """Drive and pins in one: one motor, and a pin with a waveform.

    The level depends on time (toggles) or on the motor, which runs upwards
    only: high from one position on, low again from another.
    """

    def __init__(self) -> None:
        self.the_track = StepTrack()
        self.toggles: list[int] = []  # ns, the pin begins low
        self.high_from: int | None = None
        self.low_from = 0
        self.bench: Bench
        self.endstops: Endstops
        self.armed_at: list[tuple[int, int]] = []
        self.disarmed_pins: list[int] = []
        self.settled: list[int] = []

    # The drive

    def track(self, step_pin: int, dir_pin: int) -> StepTrack:
        return self.the_track

    def steps_queued(self, start_ns: int) -> None:
        self.endstops.steps_queued(start_ns)

    def settle(self, ns: int) -> None:
        self.settled.append(ns)

    # The pins

    def level(self, pin: int, ns: int) -> bool:
        assert pin == PIN
        if self.high_from is None:
            return bool(bisect_right(self.toggles, ns) % 2)
        at = self.the_track.at(self.bench.board.clock_at(ns))
        return self.high_from <= at < self.low_from

    def edge(self, pin: int, wanted: bool, first_ns: int, last_ns: int):
        if self.high_from is None:
            times = [first_ns + 1, *self.toggles]
        else:
            board = self.bench.board
            span = board.clock_at(first_ns), board.clock_at(last_ns)
            limits = (self.high_from, self.low_from)
            changes = [board.ns(self.reached(at, *span)) for at in limits]
            times = [first_ns + 1, *changes]
        for ns in times:
            if first_ns < ns <= last_ns and self.level(pin, ns) == wanted:
                return ns
        return None

    def reached(self, position: int, first: int, last: int) -> int:
        """The first clock after first at which the motor is there.

        One after last if that is later.
        """
        while first < last:
            middle = (first + last + 1) // 2
            if self.the_track.at(middle) >= position:
                last = middle - 1
            else:
                first = middle
        return first + 1

    def armed(self, pin: int, ns: int) -> None:
        self.armed_at.append((pin, ns))

    def disarmed(self, pin: int) -> None:
        self.disarmed_pins.append(pin)

    def queried(self, pin: int, ns: int) -> None:
        assert pin == PIN


class HomingBench(Bench):
    """A bench with a stepper, a trsync and an endstop."""

    def __init__(self) -> None:
        self.parts = Parts()
        steppers = Steppers(self.parts)
        trsyncs = TrsyncTable(steppers)
        endstops = Endstops(self.parts, trsyncs)
        self.parts.endstops = endstops
        self.parts.bench = self
        super().__init__(steppers, trsyncs, endstops)
        self.config_stepper(STEPPER, 1, 2)
        self.tell(f"config_trsync oid={TRSYNC}")
        self.tell(f"config_endstop oid={ENDSTOP} pin={PIN} pull_up=1")

    def arm(self, report: int = 0, ticks: int = 0) -> None:
        self.start_trsync(report, ticks)
        self.tell(f"stepper_stop_on_trigger oid={STEPPER} trsync_oid={TRSYNC}")

    def start_trsync(self, report: int = 0, ticks: int = 0) -> None:
        self.tell(
            f"trsync_start oid={TRSYNC} report_clock={report or self.now()}"
            f" report_ticks={ticks} expire_reason={EXPIRED}"
        )

    def trigger(self) -> None:
        self.tell(f"trsync_trigger oid={TRSYNC} reason={REASON}")

    def set_timeout(self, clock: int) -> None:
        self.tell(f"trsync_set_timeout oid={TRSYNC} clock={clock}")

    def home(self, start: int, how: Settings) -> None:
        self.tell(
            f"endstop_home oid={ENDSTOP} clock={start}"
            f" sample_ticks={how.sample} sample_count={how.count}"
            f" rest_ticks={how.rest} pin_value={int(how.wanted)}"
            f" trsync_oid={TRSYNC} trigger_reason={REASON}"
        )

    def state(self) -> dict[str, int]:
        return self.ask(f"endstop_query_state oid={ENDSTOP}")

    def outcome(self, since: int) -> Outcome:
        """What came of homing, in full clocks if it began at since."""

        def widen(clock: int) -> int:
            return since + ((clock - since) & LOW32)

        reports = self.said("trsync_state")
        next_clock = self.state()["next_clock"]
        return Outcome(
            widen(reports[-1]["clock"]) if reports else None,
            widen(next_clock) if next_clock else 0,
        )


@pytest.fixture
def bench() -> HomingBench:
    return HomingBench()


# The trsync


def test_trigger_stops_the_steppers_once_and_is_always_answered(bench):
    bench.arm()
    bench.move(STEPPER, bench.now(), 1000, 100)
    bench.run_to(bench.now() + 10_500)
    answer = {"oid": TRSYNC, "can_trigger": 0, "trigger_reason": REASON}
    answer["clock"] = 0
    # The host waits for the answer, and for the first reason
    for reason in (REASON, REASON + 1):
        assert (
            bench.ask(f"trsync_trigger oid={TRSYNC} reason={reason}") == answer
        )
    bench.run_to(bench.now() + 1_000_000)
    assert bench.position(STEPPER) == 10
    # What listened does so no more
    bench.start_trsync()
    bench.move(STEPPER, bench.now(), 1000, 10)
    bench.trigger()
    bench.run_to(bench.now() + 20_000)
    assert bench.position(STEPPER) == 20


@pytest.mark.parametrize("ticks", [0, 1000])
def test_reports_are_periodic_and_end_with_the_trigger_command(bench, ticks):
    start = bench.now() + 500
    bench.arm(start, ticks)
    bench.run_to(start + 3999)
    reports = bench.said("trsync_state")
    assert reports == [
        {
            "oid": TRSYNC,
            "can_trigger": 1,
            "trigger_reason": 0,
            "clock": (start + n * 1000) & LOW32,
        }
        for n in range(4 if ticks else 0)
    ]
    bench.trigger()
    bench.run_to(start + 100_000)
    assert len(bench.said("trsync_state")) == len(reports) + 1


def test_reports_go_on_after_an_endstop_has_triggered(bench):
    bench.arm(bench.now() + 1000, 1000)
    bench.parts.toggles = [bench.ns + 1500 * TICK_NS]
    bench.home(bench.now(), Settings(10, 2, 100))
    bench.run_to(bench.now() + 3500)
    reports = [
        (answer["can_trigger"], answer["trigger_reason"])
        for answer in bench.said("trsync_state")
    ]
    assert reports == [(1, 0), (0, REASON), (0, REASON), (0, REASON)]


def test_timeout_triggers_unless_it_is_put_off(bench):
    start = bench.now()
    bench.arm()
    bench.move(STEPPER, start, 1000, 1000)
    bench.set_timeout(start + 5500)
    bench.run_to(start + 5000)
    bench.set_timeout(start + 9500)
    bench.run_to(start + 9499)
    assert bench.said("trsync_state") == []
    bench.run_to(start + 100_000)
    (report,) = bench.said("trsync_state")
    assert (report["can_trigger"], report["trigger_reason"]) == (0, EXPIRED)
    assert report["clock"] == (start + 9500) & LOW32
    assert bench.position(STEPPER) == 9
    # After it, and by a new start, a timeout is nothing
    bench.set_timeout(bench.now() + 100)
    bench.run_to(bench.now() + 1000)
    bench.arm()
    bench.set_timeout(bench.now() + 100)
    bench.arm()
    bench.run_to(bench.now() + 1000)
    assert bench.said("trsync_state") == [report]


@pytest.mark.parametrize("late", [0, 1])
@pytest.mark.parametrize(
    "command",
    [
        lambda bench, clock: bench.arm(clock, 1000),
        lambda bench, clock: bench.set_timeout(clock),
        lambda bench, clock: bench.home(clock, Settings(10, 2, 100)),
    ],
    ids=["report", "timeout", "endstop"],
)
def test_what_comes_too_late_shuts_down(bench, command, late):
    bench.arm()
    command(bench, bench.now() - late)
    assert bench.board.journal.shutdowns == ["Timer too close"] * late


def test_shutdown_disarms(bench):
    bench.arm(bench.now() + 1000, 1000)
    bench.home(bench.now(), Settings(10, 2, 100))
    bench.parts.toggles = [bench.ns + 5000 * TICK_NS]
    assert bench.parts.disarmed_pins == []
    bench.tell("emergency_stop")
    assert bench.parts.disarmed_pins == [PIN]
    bench.run_to(bench.now() + 100_000)
    assert bench.said("trsync_state") == []


# The endstop's sampling


SETTINGS = st.builds(
    Settings,
    sample=st.integers(1, 40),
    count=st.integers(1, 6),
    rest=st.integers(1, 120),
    wanted=st.booleans(),
)
# Toggles some ticks apart, seldom on a tick
WAVES = st.lists(st.integers(1, 4000) | st.integers(1, 40), max_size=30)


# Near the start, and where the clock wraps while it looks
BEGINS = st.sampled_from((0, (1 << 32) - 2500))


def run_wave(
    wave: list[int], how: Settings, begin: int, wait: int, span: int
) -> None:
    """The same waveform for both; they must agree about everything."""
    bench = HomingBench()
    bench.run_to(begin)
    board = bench.board
    time = bench.ns
    for gap in wave:
        time += gap
        bench.parts.toggles.append(time)
    start = bench.now() + wait
    end = start + span
    bench.arm()
    bench.move(STEPPER, start, 7, 60_000)
    bench.home(start, how)
    bench.run_to(end)

    expected = firmware(
        lambda clock: bench.parts.level(PIN, board.ns(clock)), start, end, how
    )
    assert bench.outcome(start) == expected
    assert bench.parts.armed_at == [(PIN, board.ns(start))]
    last = end if expected.trigger is None else expected.trigger
    bench.run_to(end + 500_000)
    if expected.trigger is not None:
        assert bench.position(STEPPER) == min((last - start) // 7, 60_000)
        # The world has lived up to the stop and not beyond
        assert bench.parts.settled == [board.ns(last)]


@given(WAVES, SETTINGS, BEGINS, st.integers(0, 300))
def test_endstop_samples_like_the_firmware(wave, how, begin, wait):
    run_wave(wave, how, begin, wait, 5000)


@given(
    st.lists(st.integers(1_000_000, 30_000_000), max_size=4),
    SETTINGS.map(lambda how: how._replace(rest=how.rest * 40 + 1000)),
    BEGINS,
    st.integers(0, 100_000),
)
def test_endstop_sees_what_is_far_ahead(wave, how, begin, wait):
    run_wave(wave, how, begin, wait, 4_000_000)


@st.composite
def pieces(draw) -> list[tuple[int, int, int]]:
    """A move in pieces: (interval, count, ticks it is told before it begins).

    A piece may be told while the piece before it is still running.
    """
    return draw(
        st.lists(
            st.tuples(
                st.integers(5, 400), st.integers(1, 40), st.integers(0, 3000)
            ),
            min_size=1,
            max_size=8,
        )
    )


@given(pieces(), SETTINGS, st.integers(1, 120), st.integers(1, 25))
def test_steps_that_are_told_late_are_seen(plan, how, high, width):
    bench = HomingBench()
    parts = bench.parts
    parts.high_from, parts.low_from = high, high + width
    start = bench.now() + 4000
    steps, begins, clock = [], [], start
    for interval, count, _ in plan:
        begins.append(clock)
        steps += [clock + interval * (n + 1) for n in range(count)]
        clock += interval * count
    end = clock + 2000

    bench.arm()
    bench.reset_clock(STEPPER, start)
    bench.turn(STEPPER, 1)
    bench.home(start, how)
    told = bench.now()
    for (interval, count, ahead), begin in zip(plan, begins):
        told = max(told, begin - ahead)
        bench.run_to(told)
        bench.queue(STEPPER, interval, count)
    bench.run_to(end)

    def level(tick: int) -> bool:
        at = bisect_right(steps, tick)
        return parts.high_from <= at < parts.low_from

    expected = firmware(level, start, end, how)
    assert bench.outcome(start) == expected
    if expected.trigger is not None:
        assert bench.position(STEPPER) == bisect_right(steps, expected.trigger)


# The endstop's other commands


def test_state_tells_level_and_homing(bench):
    state = {"oid": ENDSTOP, "homing": 0, "next_clock": 0, "pin_value": 0}
    assert bench.state() == state
    bench.arm()
    bench.home(bench.now(), Settings(10, 4, 100))
    bench.parts.toggles = [bench.ns + 10]
    bench.run_to(bench.now() + 5)
    assert bench.state() == {**state, "homing": 1, "pin_value": 1}
    # As in the firmware, homing lasts until the host ends it
    bench.run_to(bench.now() + 5000)
    assert bench.state()["homing"] == 1
    next_clock = bench.state()["next_clock"]
    bench.home(0, Settings(0, 0, 0))
    end = {**state, "next_clock": next_clock, "pin_value": 1}
    assert bench.state() == end
    # One that is ended before its edge triggers nothing
    bench.arm()
    bench.home(bench.now(), Settings(10, 4, 100, wanted=False))
    bench.parts.toggles.append(bench.ns + 10_000)
    bench.home(0, Settings(0, 0, 0))
    count = len(bench.said("trsync_state"))
    bench.run_to(bench.now() + 10_000)
    assert len(bench.said("trsync_state")) == count


def test_homing_anew_replaces_the_old_search(bench):
    bench.arm()
    start = bench.now()
    bench.parts.toggles = [bench.ns + 10_000 * TICK_NS]
    bench.home(start, Settings(10, 4, 100))
    assert bench.parts.disarmed_pins == []
    bench.home(start + 20_000, Settings(10, 1, 100))
    assert bench.parts.disarmed_pins == [PIN]
    bench.run_to(start + 50_000)
    wanted = Outcome(start + 20_000, start + 20_100)
    assert bench.outcome(start) == wanted
    # Steps that follow the trigger start no new search
    bench.move(STEPPER, bench.now() + 6000, 5000, 10)
    bench.run_to(bench.now() + 60_000)
    assert bench.outcome(start) == wanted


def test_trigger_that_nobody_waits_for(bench):
    # The host may have been told by another board
    bench.arm()
    bench.trigger()
    count = len(bench.answers)
    bench.parts.toggles = [bench.ns]
    bench.home(bench.now(), Settings(10, 4, 100))
    bench.move(STEPPER, bench.now(), 100, 10)
    bench.run_to(bench.now() + 5000)
    assert len(bench.answers) == count
    assert bench.position(STEPPER) == 10
