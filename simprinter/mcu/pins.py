"""The pins that every board has, whatever chip its owner has.

Those of the STM32, SAM and AVR families, of RP2040 and Linux boards, and of the
LPC176x, so that a printer.cfg for any of them finds its own. Each can do
everything; see LIMITS.md.
"""

from __future__ import annotations

import re
from typing import NamedTuple

# For messages
PINS = "PA0 to PL31, gpio0 to gpio63 and P0.0 to P4.31"
_NAME = re.compile(r"(gpio|P[A-Z]|P\d\.)(\d+)")


class _Row(NamedTuple):
    """Pins called NAME with a number of these, and the first's number here."""

    name: str
    numbers: range
    first: int


def _rows() -> list[_Row]:
    ports = [f"P{port}" for port in "ABCDEFGHIJKL"]
    named = [(port, range(16)) for port in ports]
    named.append(("gpio", range(64)))
    named += [(f"P{port}.", range(32)) for port in range(5)]
    named += [(port, range(16, 32)) for port in ports]
    rows, first = [], 0
    for name, numbers in named:
        rows.append(_Row(name, numbers, first))
        first += len(numbers)
    return rows


_ROWS = _rows()


def numbered(name: str) -> int:
    """The number of a pin. ValueError where there is none of that name."""
    found = _NAME.fullmatch(name)
    if found is not None:
        number = int(found[2])
        for row in _ROWS:
            if row.name == found[1] and number in row.numbers:
                return row.first + number - row.numbers.start
    raise ValueError(f"no pin {name!r} on the board")


def enumeration() -> dict[str, list[int]]:
    """All pins as a dictionary has them: name of the first, number, count."""
    return {
        f"{row.name}{row.numbers.start}": [row.first, len(row.numbers)]
        for row in _ROWS
    }
