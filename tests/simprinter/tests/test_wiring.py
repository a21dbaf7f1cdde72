"""Pin texts and heaters."""

from __future__ import annotations

import math

import pytest

from tests.simprinter.mcu.board import Crystal
from tests.simprinter.wiring import (
    BoardSpec,
    Heater,
    HeaterState,
    Motor,
    Wiring,
    board_of,
    is_inverted,
    pin_number,
)

SECOND = 10**9


@pytest.mark.parametrize(
    ("text", "number", "inverted"),
    [
        ("PA0", 0, False),
        ("PA15", 15, False),
        ("!PB0", 16, True),
        ("^PC3", 35, False),
        ("^!PI15", 143, True),
        ("~!PD2", 50, True),
        ("^!zboard:PC2", 34, True),
    ],
)
def test_pins(text, number, inverted):
    assert pin_number(text) == number
    assert is_inverted(text) is inverted


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("PC2", "mcu"),
        ("^!PC2", "mcu"),
        ("mcu:PC2", "mcu"),
        ("zboard:PC2", "zboard"),
        ("^!zboard:PC2", "zboard"),
    ],
)
def test_boards_of_pins(text, board):
    assert board_of(text) == board


@pytest.mark.parametrize(
    "text", ["", "!", "A0", "PA", "PZ0", "PAx", "gpio3", "z:", "z:^PC2"]
)
def test_what_is_no_pin(text):
    with pytest.raises(ValueError, match="no pin"):
        pin_number(text)


ZBOARD = {"zboard": BoardSpec(Crystal(tick_ns=25), latency=0.002)}
NEAR, FAR = Motor("PA0", "PA1", 0.01), Motor("zboard:PA0", "!zboard:PA1", 0.01)


def test_what_is_wired_to_one_board():
    wiring = Wiring(
        motors={"x": NEAR, "z": FAR},
        inputs={"probe": "^PC3", "z_endstop": "^!zboard:PC3"},
        outputs={"probe_attach": "zboard:PD0"},
        heaters={"bed": Heater("PH0", "PI0")},
        boards=ZBOARD,
    )
    near, far = wiring.on_board("mcu"), wiring.on_board("zboard")
    assert near.motors == {"x": NEAR}
    assert near.inputs == {"probe": "^PC3"}
    assert near.outputs == {}
    assert near.heaters == wiring.heaters
    assert far.motors == {"z": FAR}
    assert far.inputs == {"z_endstop": "^!zboard:PC3"}
    assert far.outputs == {"probe_attach": "zboard:PD0"}
    assert far.heaters == {}


def test_boards_with_the_main_one_first():
    plain, two = Wiring({}, {}), Wiring({}, {}, boards=ZBOARD)
    assert plain.all_boards() == {"mcu": BoardSpec()}
    assert list(two.all_boards().items()) == [
        ("mcu", BoardSpec()),
        ("zboard", ZBOARD["zboard"]),
    ]


@pytest.mark.parametrize(
    ("wired", "message"),
    [
        ({"inputs": {"probe": "^zbord:PC3"}}, "no such board.*zbord:PC3"),
        ({"outputs": {"magnet": "zbord:PC3"}}, "no such board"),
        ({"heaters": {"bed": Heater("PH0", "zbord:PI0")}}, "no such board"),
        ({"heaters": {"bed": Heater("PH0", "zboard:PI0")}}, "one board"),
        ({"motors": {"z": Motor("PA0", "zboard:PA1", 0.01)}}, "one board"),
        (
            {"motors": {"z": Motor("PA0", "PA1", 0.01, uart="zboard:PE0")}},
            "one board",
        ),
    ],
)
def test_impossible_wiring_is_refused(wired, message):
    parts = {"motors": {}, "inputs": {}, "boards": ZBOARD, **wired}
    with pytest.raises(ValueError, match=message):
        Wiring(**parts)


def test_heater_approaches_its_end_exponentially():
    heater = HeaterState(
        Heater("PA0", "PA1", power=2.0, loss=0.01, ambient=20.0), 0
    )
    heater.set_duty(0.5, 0)
    # Ends 100 degrees above ambient, with a time constant of 100 s
    for seconds in (1, 50, 100, 300):
        heater.advance(seconds * SECOND)
        expected = 120.0 - 100.0 * math.exp(-seconds / 100)
        assert heater.celsius == pytest.approx(expected)
    heater.set_duty(0.0, 300 * SECOND)
    hot = heater.celsius
    heater.advance(400 * SECOND)
    assert heater.celsius == pytest.approx(20.0 + (hot - 20.0) / math.e)


def test_heater_is_the_same_however_often_it_is_looked_at():
    often = HeaterState(Heater("PA0", "PA1"), 0)
    seldom = HeaterState(Heater("PA0", "PA1"), 0)
    for heater in (often, seldom):
        heater.set_duty(0.7, SECOND)
    for n in range(100):
        often.voltage(SECOND + n * SECOND)
    assert often.voltage(100 * SECOND) == pytest.approx(
        seldom.voltage(100 * SECOND)
    )


def test_heater_does_not_go_back_in_time():
    heater = HeaterState(Heater("PA0", "PA1"), 10 * SECOND)
    heater.set_duty(1.0, 10 * SECOND)
    heater.advance(5 * SECOND)
    assert heater.celsius == 25.0


@pytest.mark.parametrize(
    ("celsius", "ohm"),
    # Beta equation with 100 kOhm at 25 C and beta 3950, worked out apart
    [(25.0, 100_000.0), (100.0, 6975.2), (200.0, 744.6)],
)
def test_thermistor(celsius, ohm):
    heater = HeaterState(Heater("PA0", "PA1", ambient=celsius), 0)
    share = heater.voltage(0)
    assert share == pytest.approx(ohm / (ohm + 4700.0), rel=1e-3)
