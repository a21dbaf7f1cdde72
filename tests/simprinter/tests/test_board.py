"""The micro-controller's core: clock, events, configuration, shutdown."""

from __future__ import annotations

import json
import zlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.simprinter.mcu.board import (
    CLOCK_FREQ,
    PORTS,
    TICK_NS,
    Crystal,
    Peripheral,
    command,
    pin_name,
)
from tests.simprinter.tests.workbench import LOW32, Bench
from tests.simprinter.wiring import pin_number


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


# Dictionary


def test_identify_in_chunks(bench):
    data = b""
    while True:
        answer = bench.ask("identify", offset=len(data), count=40)
        assert answer["offset"] == len(data)
        assert len(answer["data"]) <= 40
        data += answer["data"]
        if not answer["data"]:
            break
    told = json.loads(zlib.decompress(data))
    assert told["commands"].keys() >= {"switch_lamp oid=%c on=%c", "get_clock"}
    assert told["responses"].keys() >= {"lamp_state oid=%c on=%c", "starting"}
    assert told["config"]["CLOCK_FREQ"] == 10**9 // TICK_NS
    # Klippy paces its output by this
    assert "SERIAL_BAUD" not in told["config"]


def test_pins_by_name(bench):
    content = json.loads(bench.board.dictionary.json)
    pins = content["enumerations"]["pin"]
    # A range [first, count] counts the name's number up, as klippy reads it
    named = {
        f"{name[:-1]}{i}": first + i
        for name, (first, count) in pins.items()
        for i in range(count)
    }
    assert len(named) == 16 * len(PORTS)
    for name, number in named.items():
        assert pin_number(name) == number
        assert pin_name(number) == name


# Clock


def test_clocks_and_nanoseconds(bench):
    board = bench.board
    start = board.clock()
    assert board.ns(start) == bench.ns
    bench.ns += 3 * TICK_NS - 1
    assert board.clock() == start + 2
    bench.ns += 1
    assert board.clock() == start + 3
    assert board.clock_at(board.ns(12345)) == 12345


def test_clock_on_the_wire_wraps_and_uptime_does_not(bench):
    assert bench.now() < 1 << 32
    assert bench.ask("get_uptime") == {"high": 0, "clock": bench.now()}
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


def test_stats_come_every_five_seconds_on_any_crystal():
    bench = Bench(crystal=Crystal(tick_ns=40))
    bench.tell("finalize_config", crc=1)
    bench.run_to(bench.now() + 12 * 25_000_000)
    assert len(bench.said("stats")) == 2


@given(st.integers(0, 1 << 34), st.integers(-(1 << 31) + 1, (1 << 31) - 1))
def test_widen_finds_the_nearest_clock(ticks, distance):
    bench = Bench()
    bench.ns += ticks * TICK_NS
    clock = bench.now() + distance
    assert bench.board.widen(clock & LOW32) == clock


# Events


def test_events_run_in_order_and_at_their_clock(bench):
    now, ran = bench.now(), []
    for name, delay in (("c", 30), ("a", 10), ("b", 20), ("b2", 20)):
        bench.board.schedule(
            now + delay, lambda clock, name=name: ran.append((name, clock))
        )
    assert not bench.board.run_due()
    bench.run_to(now + 19)
    assert ran == [("a", now + 10)]
    bench.run_to(now + 30)
    assert ran[1:] == [("b", now + 20), ("b2", now + 20), ("c", now + 30)]


def test_events_that_are_overdue_run_as_of_their_clock(bench):
    now, ran = bench.now(), []
    bench.board.schedule(now + 10, ran.append)
    bench.ns += 50 * TICK_NS
    assert bench.board.run_due()
    assert ran == [now + 10]
    assert not bench.board.run_due()


def test_cancelled_event_neither_runs_nor_wakes(bench):
    now, ran = bench.now(), []
    early = bench.board.schedule(now + 10, ran.append)
    bench.board.schedule(now + 20, ran.append)
    early.cancel()
    assert bench.board.next_event_ns() == bench.board.ns(now + 20)
    bench.run_to(now + 20)
    assert ran == [now + 20]


def test_events_may_schedule_and_cancel_others(bench):
    now, ran = bench.now(), []
    victim = bench.board.schedule(now + 20, ran.append)

    def first(clock: int) -> None:
        victim.cancel()
        bench.board.schedule(clock, ran.append)

    bench.board.schedule(now + 10, first)
    bench.run_to(now + 30)
    assert ran == [now + 10]


def test_what_is_due_comes_before_what_arrives(bench, lamp):
    # A line may be read a little after an event was due
    bench.board.schedule(
        bench.now() + 10, lambda clock: lamp.heard.append("event")
    )
    bench.ns += 20 * TICK_NS
    bench.tell("switch_lamp", oid=0, on=1)
    assert lamp.heard == ["event", "0=1"]


# Configuration and shutdown


def test_configuration(bench):
    config = {"is_config": 0, "crc": 0, "is_shutdown": 0, "move_count": 1024}
    assert bench.ask("get_config") == config
    bench.tell("allocate_oids", count=9)
    assert bench.ask("get_config") == config
    bench.tell("finalize_config", crc=0xDEADBEEF)
    config.update(is_config=1, crc=0xDEADBEEF)
    assert bench.ask("get_config") == config


def test_statistics_once_configured(bench):
    bench.run_to(bench.now() + 12 * CLOCK_FREQ)
    assert bench.said("stats") == []
    bench.tell("finalize_config", crc=1)
    bench.run_to(bench.now() + 10 * CLOCK_FREQ)
    assert len(bench.said("stats")) == 2


def test_shutdown_is_told_once_and_stops_every_part(bench, lamp):
    bench.tell("emergency_stop")
    bench.tell("emergency_stop")
    ((name, values),) = bench.answers
    assert name == "shutdown"
    assert values["clock"] == bench.now() & LOW32
    enums = json.loads(bench.board.dictionary.json)["enumerations"]
    reason = values["static_string_id"]
    assert reason == enums["static_string_id"]["Command request"]
    assert lamp.heard == ["stop"]
    assert bench.board.journal.shutdowns == 1


def test_board_that_is_shut_down_refuses_commands(bench, lamp):
    bench.tell("emergency_stop")
    lamp.heard.clear()
    bench.answers.clear()
    bench.tell("switch_lamp", oid=1, on=1)
    assert bench.answers == [("is_shutdown", {"static_string_id": 1})]
    assert lamp.heard == []
    # It still answers what a host needs to find out and to get on
    assert bench.ask("get_config")["is_shutdown"] == 1
    assert bench.ask("get_clock") == {"clock": bench.now() & LOW32}
    assert bench.ask("get_uptime")["clock"] == bench.now() & LOW32
    assert bench.ask("identify", offset=0, count=4)["data"]


def test_clear_shutdown(bench, lamp):
    bench.tell("emergency_stop")
    bench.tell("clear_shutdown")
    assert bench.ask("get_config")["is_shutdown"] == 0
    bench.tell("switch_lamp", oid=1, on=1)
    assert lamp.heard[-1] == "1=1"


@pytest.mark.parametrize("was_shut_down", [False, True])
def test_reset_forgets_the_configuration(bench, lamp, was_shut_down):
    ran = []
    bench.tell("finalize_config", crc=5)
    bench.board.schedule(bench.now() + 100, ran.append)
    if was_shut_down:
        bench.tell("emergency_stop")
        lamp.heard.clear()
    bench.tell("reset")
    assert lamp.heard == ["stop", "reset"]
    assert bench.ask("get_config")["is_config"] == 0
    assert bench.ask("get_config")["is_shutdown"] == 0
    assert bench.board.journal.resets == 1
    # The clock goes on, and so do the board's own events
    bench.tell("finalize_config", crc=6)
    bench.run_to(bench.now() + 6 * CLOCK_FREQ)
    assert ran == []
    assert len(bench.said("stats")) == 1


def test_commands_of_one_block_run_in_order(bench, lamp):
    by_name = {m.name: m for m in bench.board.dictionary.commands.values()}
    switch = by_name["switch_lamp"]
    content = switch.encode({"oid": 1, "on": 1})
    content += by_name["emergency_stop"].encode({})
    content += switch.encode({"oid": 2, "on": 1})
    bench.board.receive(content)
    assert lamp.heard == ["1=1", "stop"]
    said = [name for name, _ in bench.answers]
    assert said == ["lamp_state", "shutdown", "is_shutdown"]


# The fault: silence


def test_silent_board_neither_listens_nor_answers(bench, lamp):
    silent = []
    bench.board.is_silent = lambda: bool(silent)
    bench.tell("finalize_config", crc=1)
    bench.tell("switch_lamp", oid=1, on=1)
    assert len(bench.answers) == 1
    silent.append(True)
    bench.tell("switch_lamp", oid=2, on=1)
    bench.tell("get_clock")
    bench.board.respond("lamp_state", oid=3, on=1)
    bench.run_to(bench.now() + 20 * CLOCK_FREQ)
    assert lamp.heard == ["1=1"]
    assert len(bench.answers) == 1
    silent.clear()
    assert bench.ask("get_clock") == {"clock": bench.now() & LOW32}
