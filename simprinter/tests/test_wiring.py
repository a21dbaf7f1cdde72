"""Pin texts and heaters."""

from __future__ import annotations

import math

import pytest

from simprinter.mcu.board import Crystal
from simprinter.wiring import (
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
    ("text", "board", "number", "inverted"),
    [
        ("PA0", "mcu", 0, False),
        ("PA15", "mcu", 15, False),
        ("!PB0", "mcu", 16, True),
        ("mcu:PC2", "mcu", 34, False),
        ("^!PI15", "mcu", 143, True),
        ("~!zboard:PD2", "zboard", 50, True),
        ("^zboard:PC2", "zboard", 34, False),
    ],
)
def test_pins(text, board, number, inverted):
    assert board_of(text) == board
    assert pin_number(text) == number
    assert is_inverted(text) is inverted


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
    # The main one is the first
    assert list(wiring.all_boards().items()) == [
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


@pytest.mark.parametrize("looks", [[], range(1, 300)])
def test_heater_approaches_its_end_exponentially(looks):
    """However often it is looked at."""
    start = 10 * SECOND
    heater = HeaterState(
        Heater("PA0", "PA1", power=2.0, loss=0.01, ambient=20.0), start
    )
    heater.set_duty(0.5, start)
    # It does not go back in time
    heater.advance(5 * SECOND)
    for seconds in looks:
        heater.voltage(start + seconds * SECOND)
    # Ends 100 degrees above ambient, with a time constant of 100 s
    heater.advance(start + 300 * SECOND)
    hot = 120.0 - 100.0 * math.exp(-3.0)
    assert heater.celsius == pytest.approx(hot)
    heater.set_duty(0.0, start + 300 * SECOND)
    heater.advance(start + 400 * SECOND)
    assert heater.celsius == pytest.approx(20.0 + (hot - 20.0) / math.e)


@pytest.mark.parametrize(
    ("celsius", "ohm"),
    # Beta equation with 100 kOhm at 25 C and beta 3950, worked out apart
    [(25.0, 100_000.0), (100.0, 6975.2), (200.0, 744.6)],
)
def test_thermistor(celsius, ohm):
    heater = HeaterState(Heater("PA0", "PA1", ambient=celsius), 0)
    share = heater.voltage(0)
    assert share == pytest.approx(ohm / (ohm + 4700.0), rel=1e-3)
