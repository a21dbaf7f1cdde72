"""TMC2209 drivers behind their UART."""

from __future__ import annotations

import math
from typing import Optional

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.mcu.tmc import (
    CHOPCONF,
    DRV_STATUS,
    GCONF,
    GSTAT,
    IFCNT,
    IHOLD_IRUN,
    IOIN,
    Tmc2209,
    TmcUarts,
    add_serial_bits,
    crc8,
    strip_serial_bits,
)
from simprinter.tests.workbench import Bench

OID, PIN = 8, 90


# Datagrams


def slow_crc8(data: bytes) -> int:
    """Division by x^8 + x^2 + x + 1, the bytes taken lowest bit first."""
    bits = int("0" + "".join(f"{byte:08b}"[::-1] for byte in data), 2) << 8
    for top in range(len(data) * 8 + 7, 7, -1):
        if bits >> top & 1:
            bits ^= 0x107 << (top - 8)
    return bits


@pytest.mark.parametrize(
    ("data", "crc"),
    # Requests to read GCONF, IFCNT and IOIN of driver 0, seen on real lines
    [(b"\x05\x00\x00", 0x48), (b"\x05\x00\x02", 0x8F), (b"\x05\x00\x06", 0x6F)],
)
def test_crc_of_known_datagrams(data, crc):
    assert crc8(data) == crc


@given(st.binary(max_size=12))
def test_crc_is_the_division(data):
    assert crc8(data) == slow_crc8(data)


@given(st.binary(max_size=12))
def test_bits_on_the_line(data):
    # Start bit 0, data lowest bit first, stop bit 1
    wire = add_serial_bits(data)
    bits = "".join(f"{byte:08b}"[::-1] for byte in wire)
    wanted = "".join("0" + f"{byte:08b}"[::-1] + "1" for byte in data)
    assert bits.rstrip("0") == wanted.rstrip("0")
    assert strip_serial_bits(wire) == data


class UartBench(Bench):
    """Two drivers on one line, addresses 0 and 3."""

    def __init__(self) -> None:
        self.first, self.second = Tmc2209(), Tmc2209()
        self.spoil: list[tuple[Tmc2209, Optional[bytes]]] = []
        self.asked: list[tuple[Tmc2209, Optional[bytes]]] = []
        drivers = {(PIN, 0): self.first, (PIN, 3): self.second}
        super().__init__(TmcUarts(drivers, self._spoiled))
        self.configure()

    def configure(self) -> None:
        self.tell(
            f"config_tmcuart oid={OID} rx_pin={PIN} pull_up=1 tx_pin={PIN}"
            " bit_time=1250"
        )

    def _spoiled(self, driver: Tmc2209, written: Optional[bytes]) -> bool:
        self.asked.append((driver, written))
        return (driver, written) in self.spoil

    def send(self, data: bytes, read: int) -> bytes:
        """A datagram without its checksum; what comes back."""
        data += bytes([slow_crc8(data)])
        return self.raw(data, read)

    def raw(self, data: bytes, read: int) -> bytes:
        answer = self.ask(
            f"tmcuart_send oid={OID} read={read}", write=add_serial_bits(data)
        )
        return answer["read"]

    def write(self, register: int, value: int, address: int = 0) -> bytes:
        head = bytes((0xF5, address, register | 0x80))
        return self.send(head + value.to_bytes(4, "big"), 0)

    def read(self, register: int, address: int = 0) -> int:
        wire = self.send(bytes((0xF5, address, register)), 10)
        assert len(wire) == 10
        data = strip_serial_bits(wire)
        assert data[:3] == bytes((0x05, 0xFF, register))
        assert data[7] == slow_crc8(data[:7])
        return int.from_bytes(data[3:7], "big")


@pytest.fixture
def bench() -> UartBench:
    return UartBench()


def test_values_after_power_up_and_what_is_written(bench):
    # Datasheet: GCONF with internal sense off, CHOPCONF, version 0x21
    assert bench.read(CHOPCONF) == 0x10000053
    assert bench.read(IOIN) >> 24 == 0x21
    assert bench.read(GSTAT) == 0
    assert bench.read(DRV_STATUS) == 1 << 31
    assert bench.write(GCONF, 0x1C0) == b""
    # A register that can only be written, and flags cleared by ones
    bench.write(IHOLD_IRUN, 0x1F1F)
    bench.write(GSTAT, 7)
    assert bench.read(IHOLD_IRUN) == bench.read(GSTAT) == 0
    bench.tell("reset")
    bench.configure()
    assert bench.read(GCONF) == 0x1C0
    assert bench.read(GCONF, address=3) == 0x41
    # Nobody is at another address
    assert bench.send(bytes((0xF5, 1, GCONF)), 10) == b""


def test_every_write_counts(bench):
    for n in range(300):
        assert bench.read(IFCNT) == n % 256
        bench.write(GCONF, n // 3)  # the same value counts as well
    assert bench.read(IFCNT, address=3) == 0


def test_damaged_datagram_is_ignored(bench):
    data = bytes((0xF5, 0, GCONF | 0x80, 0, 0, 1, 0))
    damaged = data + bytes([slow_crc8(data) ^ 4])
    assert bench.raw(damaged, 0) == b""
    assert bench.read(GCONF) == 0x41
    assert bench.read(IFCNT) == 0
    assert bench.raw(b"\x05\x00\x4e", 10) == b""
    assert [written for _, written in bench.asked] == [None, None]


def test_spoiled_datagram_is_lost(bench):
    bench.spoil = [(bench.first, bytes((GCONF | 0x80, 0, 0, 0, 1)))]
    bench.write(GCONF, 1)
    assert bench.read(IFCNT) == 0
    assert bench.read(GCONF) == 0x41
    bench.write(GCONF, 1, address=3)
    assert bench.read(GCONF, address=3) == 1
    bench.spoil = [(bench.first, None)]
    assert bench.send(bytes((0xF5, 0, GCONF)), 10) == b""


# Currents


def amperes(scale: int, full_scale: float, resistor: float) -> float:
    """RMS current by the datasheet: (CS + 1)/32 * V / (R + 20 mOhm) / √2."""
    return (scale + 1) / 32 * full_scale / (resistor + 0.02) / math.sqrt(2)


@given(st.integers(0, 31), st.integers(0, 31), st.booleans())
def test_current_from_the_registers(run, hold, low_range):
    driver = Tmc2209(sense_resistor=0.075)
    driver.write(CHOPCONF, 0x10000053 | (low_range << 17), 1)
    driver.write(IHOLD_IRUN, 8 << 16 | run << 8 | hold, 2)
    full_scale = 0.180 if low_range else 0.325
    current = driver.current()
    assert current.run == pytest.approx(amperes(run, full_scale, 0.075))
    assert current.hold == pytest.approx(amperes(hold, full_scale, 0.075))


def test_changes_of_current_are_kept_with_their_time(bench):
    assert bench.first.current().run == 0.0
    times = []
    for value in (0x1000, 0x1000, 0x0800):
        bench.ns += 1_000_000
        times.append(bench.board.ns(bench.now()))
        bench.write(IHOLD_IRUN, value)
    bench.write(GCONF, 0x1C0)
    assert [change.ns for change in bench.first.currents] == [
        times[0],
        times[2],
    ]
    bench.write(CHOPCONF, 0x10000053 | 1 << 17)
    runs = [change.run for change in bench.first.currents]
    assert runs == sorted(runs, reverse=True)
    assert len(runs) == 3
