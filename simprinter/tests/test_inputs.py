"""Buttons, counters, lamps, outputs that never change, analog inputs."""

from __future__ import annotations

import pytest

from simprinter.hosts.printer import dialect_of
from simprinter.mcu.analog import BatchedAnalogInputs
from simprinter.mcu.board import CLOCK_FREQ, Board
from simprinter.mcu.dialect import Dialect
from simprinter.mcu.inputs import Buttons, Counters
from simprinter.mcu.outputs import Neopixels, Outputs
from simprinter.mcu.pins import PINS, enumeration, numbered
from simprinter.tests.workbench import Bench

SECOND = CLOCK_FREQ


@pytest.mark.parametrize("inverted", [False, True])
def test_buttons_tell_of_changes_until_they_are_acknowledged(inverted):
    high = {7: inverted, 8: inverted}
    bench = Bench(Buttons(lambda pin, ns: high[pin]))
    at = bench.now()
    rest = 3 if inverted else 0
    bench.tell(
        "config_buttons oid=1 button_count=2",
        "buttons_add oid=1 pos=0 pin=7 pull_up=1",
        "buttons_add oid=1 pos=1 pin=8 pull_up=1",
        f"buttons_query oid=1 clock={at} rest_ticks=100000 retransmit_count=50"
        f" invert={rest}",
    )
    bench.run_to(at + SECOND)
    assert bench.said("buttons_state") == []
    high[8] = not inverted
    bench.run_to(at + 2 * SECOND)
    high[8] = inverted
    bench.run_to(at + 3 * SECOND)
    pressed = rest ^ 2
    assert [said["state"] for said in bench.said("buttons_state")] == [
        bytes([pressed]),
        bytes([pressed, rest]),
    ]
    bench.tell("buttons_ack oid=1 count=2")
    high[7] = not inverted
    bench.run_to(at + 4 * SECOND)
    last = bench.said("buttons_state")[-1]
    assert last == {"oid": 1, "ack_count": 2, "state": bytes([rest ^ 1])}
    # Told to look no more
    bench.tell(
        f"buttons_query oid=1 clock={at} rest_ticks=0 retransmit_count=0"
        " invert=0"
    )
    high[7] = inverted
    bench.run_to(at + 5 * SECOND)
    assert bench.said("buttons_state")[-1] == last


def test_buttons_are_looked_at_every_50_ms():
    """As often as firmware does would be most of what happens."""
    looks = []
    bench = Bench(Buttons(lambda pin, ns: bool(looks.append(ns))))
    at = bench.now()
    bench.tell(
        "config_buttons oid=1 button_count=1",
        "buttons_add oid=1 pos=0 pin=7 pull_up=1",
        f"buttons_query oid=1 clock={at} rest_ticks=100000 retransmit_count=50"
        " invert=0",
    )
    bench.run_to(at + SECOND)
    assert len(looks) == 21


def test_counter_tells_of_a_fan_that_stands_still():
    bench = Bench(Counters())
    at = bench.now()
    bench.tell(
        "config_counter oid=1 pin=4 pull_up=1",
        f"query_counter oid=1 clock={at} poll_ticks=1000 sample_ticks={SECOND}",
    )
    bench.run_to(at + 3 * SECOND)
    told = bench.said("counter_state")
    assert len(told) == 3
    assert {said["count"] for said in told} == {0}


def test_lamps_take_what_they_are_told():
    bench = Bench(Neopixels())
    bench.tell(
        "config_neopixel oid=1 pin=4 data_size=3 bit_max_ticks=1"
        " reset_min_ticks=1"
    )
    bench.tell("neopixel_update oid=1 pos=0", data=b"abc")
    assert bench.ask("neopixel_send oid=1") == {"oid": 1, "success": 1}


def test_outputs_that_never_change_are_set_once():
    changes = []
    bench = Bench(Outputs(lambda pin, ns, duty: changes.append((pin, duty))))
    bench.tell(
        "set_digital_out pin=4 value=1",
        "set_pwm_out pin=5 cycle_ticks=10 value=51",
    )
    assert changes == [(4, 1.0), (5, 0.2)]


@pytest.mark.parametrize("size", [2, 6])
def test_analog_readings_come_in_batches(size):
    """Little-endian; the clock is that of the next reading."""
    levels = iter(range(100))
    analog = BatchedAnalogInputs(lambda pin, ns: next(levels) / 4095)
    bench = Bench(analog)
    at = bench.now() + 100
    bench.tell(
        "config_analog_in oid=1 pin=2",
        f"query_analog_in oid=1 clock={at} sample_ticks=10 sample_count=4"
        f" rest_ticks=1000 bytes_per_report={size} min_value=0 max_value=16380"
        " range_check_count=4",
    )
    bench.run_to(at + 6000)
    values, clocks = [], []
    for said in bench.said("analog_in_state"):
        assert len(said["values"]) == size
        values += memoryview(said["values"]).cast("H")
        clocks.append((said["next_clock"] - at) & 0xFFFFFFFF)
    count = size // 2
    assert values == [4 * n for n in range(7 // count * count)]
    assert clocks == [1000 * n for n in range(count, 8, count)]


def test_board_says_whose_firmware_it_has():
    board = Board(lambda: 0, [], Dialect("Kalico"))
    assert b'"app": "Kalico"' in board.dictionary.json


@pytest.mark.every_host("a board speaks as the sources of its own host ask")
def test_board_of_a_host_understands_what_its_sources_name(host):
    """Hosts look commands up in the words of their own version."""
    dialect = dialect_of(host)
    klippy = host.directory / "base" / "klippy"
    assert dialect.analog_batches is (
        "values=%*s" in (klippy / "mcu.py").read_text()
    )


def test_pins_have_numbers_of_their_own():
    numbers = []
    for name, (first, count) in enumeration().items():
        root = name.rstrip("0123456789")
        begin = int(name[len(root) :])
        for offset in range(count):
            number = numbered(f"{root}{begin + offset}")
            assert number == first + offset
            numbers.append(number)
    assert sorted(numbers) == list(range(len(numbers)))
    for name in PINS.replace(",", "").split(" and ")[0].split(" to "):
        numbered(name.split()[0])


@pytest.mark.parametrize("name", ["", "PA", "PA32", "PM0", "gpio64", "P5.0"])
def test_other_pins_are_refused(name):
    with pytest.raises(ValueError, match="no pin"):
        numbered(name)
