"""How a machine is wired: which pin is which motor, switch or heater.

Pins are spelled as in a printer configuration; a `!` there says that the
wire's sense is reversed, and the same text goes into the configuration. A pin
of another board than the main one has that board's name before it, behind the
modifiers: `^!zboard:PC2`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

from .mcu.board import USUAL_CRYSTAL, Crystal
from .mcu.pins import numbered

# The board that klippy takes pins without a board's name to be on
MAIN = "mcu"


def _split(text: str) -> tuple[str, str]:
    """(board, pin) without modifiers."""
    board, colon, name = text.lstrip("^~!").rpartition(":")
    return (board if colon else MAIN), name


def board_of(text: str) -> str:
    """Name of the board that a pin is on."""
    return _split(text)[0]


def pin_number(text: str) -> int:
    """Number on its board of a pin such as `^!PA3` or `^zboard:PC2`.

    ValueError where there is none.
    """
    return numbered(_split(text)[1])


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

    def pins(self) -> tuple[str, ...]:
        """Those that have to be on one board."""
        pins = (self.step_pin, self.dir_pin, self.uart, self.enable_pin)
        return tuple(pin for pin in pins if pin)


@dataclass(frozen=True)
class Heater:
    """A heater with its thermistor (100 kOhm at 25 C, beta 3950, 4.7 kOhm).

    pin: empty where nothing heats what the thermistor sees. power: C/s at full
    duty; loss: 1/s towards ambient; ambient: C.
    """

    pin: str
    sensor_pin: str
    power: float = 4.0
    loss: float = 0.008
    ambient: float = 25.0

    def pins(self) -> tuple[str, ...]:
        """Those that have to be on one board."""
        return tuple(pin for pin in (self.pin, self.sensor_pin) if pin)


@dataclass(frozen=True)
class BoardSpec:
    """What makes one board differ from another.

    latency: seconds that a byte is under way to or from the host
    """

    crystal: Crystal = USUAL_CRYSTAL
    latency: float = 0.0


@dataclass(frozen=True)
class Wiring:
    """Everything on the boards' pins.

    inputs and outputs map the world's signals to pins. boards: all boards
    there are beside the main one, by name.
    """

    motors: Mapping[str, Motor]
    inputs: Mapping[str, str]
    outputs: Mapping[str, str] = field(default_factory=dict)
    heaters: Mapping[str, Heater] = field(default_factory=dict)
    boards: Mapping[str, BoardSpec] = field(default_factory=dict)

    def __post_init__(self) -> None:
        known = {MAIN, *self.boards}
        for pins in self._together():
            boards = {board_of(pin) for pin in pins}
            if not boards <= known:
                raise ValueError(f"no such board, have {sorted(known)}: {pins}")
            if len(boards) > 1:
                raise ValueError(f"these belong on one board: {pins}")

    def _together(self) -> Iterator[tuple[str, ...]]:
        """Pins that have to be on one board, group by group."""
        for motor in self.motors.values():
            yield motor.pins()
        for heater in self.heaters.values():
            yield heater.pins()
        for pin in (*self.inputs.values(), *self.outputs.values()):
            yield (pin,)

    def all_boards(self) -> dict[str, BoardSpec]:
        """Every board by its name, the main one first."""
        return {MAIN: BoardSpec(), **self.boards}

    def on_board(self, name: str) -> Wiring:
        """What is wired to one board."""

        def here(parts: Mapping, pin: Callable[[Any], str]) -> dict:
            return {
                key: part
                for key, part in parts.items()
                if board_of(pin(part)) == name
            }

        return replace(
            self,
            motors=here(self.motors, lambda motor: motor.step_pin),
            inputs=here(self.inputs, str),
            outputs=here(self.outputs, str),
            heaters=here(self.heaters, lambda heater: heater.sensor_pin),
        )


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
