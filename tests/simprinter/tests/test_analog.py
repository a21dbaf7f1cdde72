"""Analog inputs: samples on time, averaged in sum, and checked."""

from __future__ import annotations

import pytest

from tests.simprinter.mcu.analog import AnalogInputs
from tests.simprinter.tests.workbench import LOW32, Bench

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

    def query(self, clock: int, count=8, low=0, high=0xFFFF, checks=0) -> None:
        self.tell(
            f"query_analog_in oid={OID} clock={clock} sample_ticks=50"
            f" sample_count={count} rest_ticks=1000 min_value={low}"
            f" max_value={high} range_check_count={checks}"
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


# 8 samples of the middle are 16384; the ends of the range still belong to it
@pytest.mark.parametrize(
    ("low", "high", "checks", "good"),
    [
        (16384, 16384, 1, True),
        (16385, 20000, 1, False),
        (0, 16383, 1, False),
        (0, 16383, 0, True),
    ],
)
def test_range(bench, low, high, checks, good):
    bench.query(bench.now(), low=low, high=high, checks=checks)
    bench.run_to(bench.now() + 5000)
    assert bench.board.state.is_shutdown is not good


def test_shutdown_only_after_enough_bad_samples_in_a_row(bench):
    start = bench.now()
    bad = {0, 1, 3, 4, 6, 7, 8}
    bench.volts = lambda clock: 1.0 if (clock - start) // 1000 in bad else 0.5
    bench.query(start, high=20_000, checks=3)
    bench.run_to(start + 7999)
    assert not bench.board.state.is_shutdown
    assert len(bench.states()) == 8
    bench.run_to(start + 50_000)
    assert bench.board.state.is_shutdown
    # That is the last report
    assert len(bench.states()) == 8
