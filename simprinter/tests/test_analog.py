"""Analog inputs: samples on time, averaged in sum, and checked."""

from __future__ import annotations

import pytest

from simprinter.mcu.analog import AnalogInputs
from simprinter.tests.workbench import LOW32, Bench

OID, PIN = 6, 80


class AnalogBench(Bench):
    """Bench with one input; `volts` is its level as a share, by clock."""

    def __init__(self) -> None:
        self.volts = lambda clock: 0.5
        super().__init__(AnalogInputs(self._read))
        self.tell(f"config_analog_in oid={OID} pin={PIN}")

    def _read(self, pin: int, ns: int) -> float:
        assert pin == PIN
        return self.volts(self.board.clock_at(ns))

    def query(self, clock: int, count: int = 8, checks: int = 9) -> None:
        self.tell(
            f"query_analog_in oid={OID} clock={clock} sample_ticks=50"
            f" sample_count={count} rest_ticks=1000 min_value=80"
            f" max_value={4000 * 8} range_check_count={checks}"
        )

    def states(self) -> list[tuple[int, int]]:
        """(next_clock, value) of every report."""
        return [
            (answer["next_clock"], answer["value"])
            for answer in self.said("analog_in_state")
        ]


@pytest.fixture
def bench() -> AnalogBench:
    return AnalogBench()


def test_reports_sums_at_the_times_asked_for(bench):
    start = bench.now() + 500
    bench.volts = lambda clock: (clock - start) / 4095
    bench.query(start)
    bench.run_to(start - 1)
    assert bench.states() == []
    bench.run_to(start + 2500)
    assert bench.states() == [
        ((start + (n + 1) * 1000) & LOW32, n * 1000 * 8) for n in range(3)
    ]


def test_count_of_zero_another_query_and_a_shutdown_end_it(bench):
    for end in (
        lambda: bench.query(0, count=0),
        lambda: bench.query(bench.now() + 9999),
        lambda: bench.tell("emergency_stop"),
    ):
        count = len(bench.states())
        bench.query(bench.now())
        bench.run_to(bench.now() + 100)
        end()
        bench.run_to(bench.now() + 5000)
        assert len(bench.states()) == count + 1


@pytest.mark.parametrize("level", [0.001, 0.99])
def test_out_of_range_for_a_while_shuts_down(bench, level):
    start = bench.now()
    bench.volts = lambda clock: level if clock != start + 1000 else 0.5
    bench.query(start, checks=3)
    bench.run_to(start + 3999)
    assert bench.board.journal.shutdowns == []
    bench.run_to(start + 4000)
    assert bench.shutdown() == "ADC out of range"


def test_query_that_comes_too_late(bench):
    bench.query(bench.now() - 1)
    assert bench.shutdown() == "Timer too close"
