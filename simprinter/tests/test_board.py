"""The micro-controller's core: clock, events, configuration, shutdown."""

from __future__ import annotations

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.mcu.board import (
    CLOCK_FREQ,
    TICK_NS,
    Crystal,
    Peripheral,
    command,
)
from simprinter.tests.workbench import LOW32, Bench


class Lamp(Peripheral):
    """A part that notes what happens to it."""

    RESPONSES = ("lamp_state oid=%c on=%c",)

    def __init__(self) -> None:
        self.heard: list[str] = []

    def stop(self) -> None:
        self.heard.append("stop")

    def reset(self) -> None:
        self.heard.append("reset")

    @command("switch_lamp oid=%c on=%c")
    def _switch(self, oid: int, on: int) -> None:
        self.heard.append(f"{oid}={on}")
        self.board.respond("lamp_state", oid=oid, on=on)


@pytest.fixture
def lamp() -> Lamp:
    return Lamp()


@pytest.fixture
def bench(lamp: Lamp) -> Bench:
    return Bench(lamp)


# Clock


def test_clock_on_the_wire_wraps_and_uptime_does_not(bench):
    board, start = bench.board, bench.now()
    bench.ns += 3 * TICK_NS - 1
    assert (board.clock(), board.ns(start + 3)) == (start + 2, bench.ns + 1)
    assert bench.ask("get_uptime") == {"high": 0, "clock": start + 2}
    bench.run_to((1 << 32) + 7)
    assert bench.ask("get_clock") == {"clock": 7}
    assert bench.ask("get_uptime") == {"high": 1, "clock": 7}


def test_board_with_a_crystal_of_its_own():
    # It says 40.004 MHz and ticks 100 ppm slower
    bench = Bench(crystal=Crystal(tick_ns=25, ppm=100, first_wrap=7))
    told = json.loads(bench.board.dictionary.json)
    assert told["config"]["CLOCK_FREQ"] == 40_004_000
    start = bench.now()
    assert start == (1 << 32) - 7 * 40_000_000
    assert bench.board.ns(start) == bench.ns
    assert bench.board.clock_at(bench.ns + 99) == start + 3
    bench.ns += 7 * 10**9
    assert bench.ask("get_uptime") == {"high": 1, "clock": 0}


@given(st.integers(0, 1 << 34), st.integers(-(1 << 31) + 1, (1 << 31) - 1))
def test_widen_finds_the_nearest_clock(ticks, distance):
    bench = Bench()
    bench.ns += ticks * TICK_NS
    clock = bench.now() + distance
    assert bench.board.widen(clock & LOW32) == clock


# Events


def test_events_run_in_order_as_of_their_clock(bench):
    now, ran = bench.now(), []
    events = {
        name: bench.board.schedule(
            now + delay, lambda clock, name=name: ran.append((name, clock))
        )
        for name, delay in (("x", 5), ("c", 30), ("a", 10), ("b", 20))
    }
    events["x"].cancel()
    assert bench.board.next_event_ns() == bench.board.ns(now + 10)

    def change(clock: int) -> None:
        events["c"].cancel()
        bench.board.schedule(clock, lambda clock: ran.append(("d", clock)))

    bench.board.schedule(now + 20, change)
    assert not bench.board.run_due()
    bench.run_to(now + 19)
    assert ran == [("a", now + 10)]
    # Overdue: run as of their time all the same
    bench.ns += 50 * TICK_NS
    assert bench.board.run_due()
    assert ran[1:] == [("b", now + 20), ("d", now + 20)]
    assert not bench.board.run_due()


def test_what_is_due_comes_before_what_arrives(bench, lamp):
    # A line may be read a little after an event was due
    bench.board.schedule(
        bench.now() + 10, lambda clock: lamp.heard.append("event")
    )
    bench.ns += 20 * TICK_NS
    bench.tell("switch_lamp oid=0 on=1")
    assert lamp.heard == ["event", "0=1"]


# Configuration and shutdown


# The fault: silence


def test_silent_board_neither_listens_nor_answers(bench, lamp):
    silent = []
    bench.board.is_silent = lambda: bool(silent)
    bench.tell("finalize_config crc=1")
    bench.tell("switch_lamp oid=1 on=1")
    assert len(bench.answers) == 1
    silent.append(True)
    bench.tell("switch_lamp oid=2 on=1")
    bench.tell("get_clock")
    bench.board.respond("lamp_state", oid=3, on=1)
    bench.run_to(bench.now() + 20 * CLOCK_FREQ)
    assert lamp.heard == ["1=1"]
    assert len(bench.answers) == 1
    silent.clear()
    assert bench.ask("get_clock") == {"clock": bench.now() & LOW32}
