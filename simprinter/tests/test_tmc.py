"""TMC2209 drivers behind their UART."""

from __future__ import annotations

import math
from typing import Optional

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.mcu.tmc import (
    CHOPCONF,
    GCONF,
    IFCNT,
    IHOLD_IRUN,
    Tmc2209,
    TmcUarts,
    add_serial_bits,
    crc8,
    strip_serial_bits,
)
from simprinter.tests.workbench import Bench

OID, PIN = 8, 90


class UartBench(Bench):
    """Two drivers on one line, addresses 0 and 3."""

    def __init__(self) -> None:
        self.first, self.second = Tmc2209(), Tmc2209()
        self.spoil: list[tuple[Tmc2209, Optional[bytes]]] = []
        drivers = {(PIN, 0): self.first, (PIN, 3): self.second}
        super().__init__(TmcUarts(drivers, self._spoiled))
        self.tell(
            f"config_tmcuart oid={OID} rx_pin={PIN} pull_up=1 tx_pin={PIN}"
            " bit_time=1250"
        )

    def _spoiled(self, driver: Tmc2209, written: Optional[bytes]) -> bool:
        return (driver, written) in self.spoil

    def send(self, data: bytes, read: int) -> bytes:
        """A datagram without its checksum; what comes back."""
        line = add_serial_bits(data + bytes([crc8(data)]))
        answer = self.ask(f"tmcuart_send oid={OID} read={read}", write=line)
        return answer["read"]

    def write(self, register: int, value: int, address: int = 0) -> bytes:
        head = bytes((0xF5, address, register | 0x80))
        return self.send(head + value.to_bytes(4, "big"), 0)

    def read(self, register: int, address: int = 0) -> int:
        wire = self.send(bytes((0xF5, address, register)), 10)
        assert len(wire) == 10
        data = strip_serial_bits(wire)
        return int.from_bytes(data[3:7], "big")


@pytest.fixture
def bench() -> UartBench:
    return UartBench()


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
