"""TMC2209 stepper drivers on a single-wire UART.

Register numbers, bit positions and the datagram format are from the TMC2209
datasheet (rev. 1.09), sections 4 and 5.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple, Optional

from .board import Peripheral, command

GCONF, GSTAT, IFCNT, IOIN = 0x00, 0x01, 0x02, 0x06
IHOLD_IRUN, CHOPCONF, DRV_STATUS = 0x10, 0x6C, 0x6F
_RESET = {GCONF: 0x41, IOIN: 0x21 << 24, CHOPCONF: 0x10000053}
_STANDSTILL = 1 << 31
_VSENSE = 1 << 17
_WRITE = 0x80


def crc8(data: bytes) -> int:
    """The datagram checksum: polynomial 0x07, bytes LSB first."""
    crc = 0
    for byte in data:
        for _ in range(8):
            feedback = (crc >> 7) ^ (byte & 1)
            crc = (crc << 1) & 0xFF
            if feedback:
                crc ^= 0x07
            byte >>= 1
    return crc


def add_serial_bits(data: bytes) -> bytes:
    """Bytes as they are on the wire: start bit 0, 8 bits LSB first, stop 1."""
    bits = 0
    for i, byte in enumerate(data):
        bits |= ((byte << 1) | 0x200) << (10 * i)
    return bits.to_bytes((len(data) * 10 + 7) // 8, "little")


def strip_serial_bits(wire: bytes) -> bytes:
    """Inverse of add_serial_bits."""
    bits = int.from_bytes(wire, "little")
    count = len(wire) * 8 // 10
    return bytes((bits >> (10 * i + 1)) & 0xFF for i in range(count))


class CurrentChange(NamedTuple):
    """Motor current from a moment on: ns, then amperes RMS."""

    ns: int
    run: float
    hold: float


class Tmc2209:
    """One driver: registers, and the current they mean."""

    def __init__(self, sense_resistor: float = 0.110):
        """sense_resistor in ohm, as on the board."""
        self._sense_resistor = sense_resistor
        self._registers = dict(_RESET)
        self._writes = 0
        self.currents: list[CurrentChange] = []

    def read(self, register: int) -> int:
        """Value of a register; those that can only be written read 0."""
        if register == IFCNT:
            return self._writes & 0xFF
        if register == DRV_STATUS:
            return _STANDSTILL
        if register == IHOLD_IRUN:
            return 0
        return self._registers.get(register, 0)

    def write(self, register: int, value: int, ns: int) -> None:
        """Write a register at a time (ns)."""
        self._writes += 1
        if register == GSTAT:  # flags are cleared by writing ones
            value = self._registers.get(GSTAT, 0) & ~value
        self._registers[register] = value
        if register in (IHOLD_IRUN, CHOPCONF):
            self._note_current(ns)

    def current(self) -> CurrentChange:
        """The current in force."""
        if not self.currents:
            return CurrentChange(0, 0.0, 0.0)
        return self.currents[-1]

    def _note_current(self, ns: int) -> None:
        value = self._registers.get(IHOLD_IRUN, 0)
        run, hold = (value >> 8) & 0x1F, value & 0x1F
        change = CurrentChange(ns, self._amperes(run), self._amperes(hold))
        if change[1:] != self.current()[1:]:
            self.currents.append(change)

    def _amperes(self, scale: int) -> float:
        # Datasheet section 9, "Calculation of RMS current"
        low_range = self._registers.get(CHOPCONF, 0) & _VSENSE
        full_scale = 0.180 if low_range else 0.325
        return (
            (scale + 1)
            / 32.0
            * full_scale
            / (self._sense_resistor + 0.020)
            / math.sqrt(2.0)
        )


class TmcUarts(Peripheral):
    """The UART pins of a board and the drivers behind them.

    drivers maps (pin number, address) to the driver. `spoiled(driver,
    written)` decides for each datagram whether the line eats it (a fault);
    written is the register and its value, None for a read.
    """

    RESPONSES = ("tmcuart_response oid=%c read=%*s",)

    def __init__(
        self,
        drivers: dict[tuple[int, int], Tmc2209],
        spoiled: Callable[[Tmc2209, Optional[bytes]], bool],
    ):
        self._drivers = drivers
        self._spoiled = spoiled
        self._pins: dict[int, int] = {}

    def reset(self) -> None:
        """Forget the configuration; drivers keep theirs."""
        self._pins.clear()

    @command("config_tmcuart oid=%c rx_pin=%u pull_up=%c tx_pin=%u bit_time=%u")
    def _config(
        self, oid: int, rx_pin: int, pull_up: int, tx_pin: int, bit_time: int
    ) -> None:
        self._pins[oid] = rx_pin

    @command("tmcuart_send oid=%c write=%*s read=%c")
    def _send(self, oid: int, write: bytes, read: int) -> None:
        data = strip_serial_bits(write)
        answer = self._datagram(self._pins[oid], data)
        if not read:
            answer = b""
        self.board.respond("tmcuart_response", oid=oid, read=answer)

    def _datagram(self, pin: int, data: bytes) -> bytes:
        if len(data) < 4 or crc8(data[:-1]) != data[-1]:
            return b""
        address, register = data[1], data[2]
        driver = self._drivers.get((pin, address))
        if driver is None:
            return b""
        is_write = bool(register & _WRITE)
        if self._spoiled(driver, data[2:7] if is_write else None):
            return b""
        if is_write:
            value = int.from_bytes(data[3:7], "big")
            now = self.board.ns(self.board.clock())
            driver.write(register & ~_WRITE, value, now)
            return b""
        value = driver.read(register)
        head = bytes((0x05, 0xFF, register)) + value.to_bytes(4, "big")
        return add_serial_bits(head + bytes((crc8(head),)))
