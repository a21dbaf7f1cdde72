"""How a machine is wired: which pin is which motor, switch or heater.

Pins are spelled as in a printer configuration; a `!` there says that the
wire's sense is reversed, and the same text goes into the configuration.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from .mcu.board import PORTS


def pin_number(text: str) -> int:
    """Number of a pin such as `^!PA3`. ValueError where there is none."""
    name = text.lstrip("^~!")
    if name[:1] != "P" or name[1:2] not in PORTS or not name[2:].isdigit():
        raise ValueError(f"no pin {text!r} on the board")
    return PORTS.index(name[1]) * 16 + int(name[2:])


def is_inverted(text: str) -> bool:
    """Whether the pin's sense is reversed."""
    return "!" in text


@dataclass(frozen=True)
class Motor:
    """A motor's pins and the travel of one microstep, mm.

    uart and address: the driver's single-wire UART, where it has one.
    """

    step_pin: str
    dir_pin: str
    step_dist: float
    uart: str = ""
    address: int = 0
    enable_pin: str = ""


@dataclass(frozen=True)
class Heater:
    """A heater with its thermistor (100 kOhm at 25 C, beta 3950, 4.7 kOhm).

    power: C/s at full duty; loss: 1/s towards ambient.
    """

    pin: str
    sensor_pin: str
    power: float = 4.0
    loss: float = 0.008
    ambient: float = 25.0


@dataclass(frozen=True)
class Wiring:
    """Everything on the board's pins.

    inputs and outputs map the world's signals to pins.
    """

    motors: Mapping[str, Motor]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str] = field(default_factory=dict)
    heaters: Mapping[str, Heater] = field(default_factory=dict)


class HeaterState:
    """Temperature of one heater over time."""

    def __init__(self, heater: Heater, ns: int):
        self._heater = heater
        self._ns = ns
        self._duty = 0.0
        self.celsius = heater.ambient

    def advance(self, ns: int) -> None:
        """Heat or cool until ns (first-order, exact between changes)."""
        seconds = (ns - self._ns) * 1e-9
        if seconds <= 0:
            return
        heater = self._heater
        end = heater.ambient + self._duty * heater.power / heater.loss
        rest = math.exp(-heater.loss * seconds)
        self.celsius = end + (self.celsius - end) * rest
        self._ns = ns

    def set_duty(self, duty: float, ns: int) -> None:
        """Change the duty (0..1) at ns."""
        self.advance(ns)
        self._duty = duty

    def voltage(self, ns: int) -> float:
        """What the thermistor's pin sees, as a share of the reference."""
        self.advance(ns)
        kelvin = self.celsius + 273.15
        ohm = 100_000.0 * math.exp(3950.0 * (1 / kelvin - 1 / 298.15))
        return ohm / (ohm + 4_700.0)
