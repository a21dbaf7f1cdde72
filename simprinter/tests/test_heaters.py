"""Heaters."""

from __future__ import annotations

import math

import pytest

from simprinter.wiring import (
    Heater,
    HeaterState,
)

SECOND = 10**9


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
