"""Digital and PWM outputs."""

from __future__ import annotations

import pytest

from tests.simprinter.mcu.outputs import Outputs
from tests.simprinter.tests.workbench import Bench


class OutputBench(Bench):
    """Notes changes as (pin, clock, duty)."""

    def __init__(self) -> None:
        self.changes: list[tuple[int, int, float]] = []
        super().__init__(Outputs(self._changed))

    def _changed(self, pin: int, ns: int, duty: float) -> None:
        self.changes.append((pin, self.board.clock_at(ns), duty))

    def digital(self, value: int = 0, default: int = 0, cycle: int = 0) -> None:
        """Configure oid 2 on pin 40."""
        self.tell(
            "config_digital_out",
            oid=2,
            pin=40,
            value=value,
            default_value=default,
            max_duration=0,
        )
        if cycle:
            self.tell("set_digital_out_pwm_cycle", oid=2, cycle_ticks=cycle)

    def pwm(self, value: int = 0, default: int = 0) -> None:
        """Configure oid 3 on pin 50."""
        self.tell(
            "config_pwm_out",
            oid=3,
            pin=50,
            cycle_ticks=5000,
            value=value,
            default_value=default,
            max_duration=0,
        )

    def queue(self, clock: int, on_ticks: int) -> None:
        self.tell("queue_digital_out", oid=2, clock=clock, on_ticks=on_ticks)


@pytest.fixture
def bench() -> OutputBench:
    return OutputBench()


@pytest.mark.parametrize("value", [0, 1])
def test_configured_level_holds_at_once(bench, value):
    bench.digital(value, 1 - value)
    assert bench.changes == [(40, bench.now(), float(value))]


def test_queued_changes_happen_at_their_clocks(bench):
    start = bench.now()
    bench.digital()
    bench.queue(start + 100, 1)
    bench.queue(start + 250, 0)
    bench.run_to(start + 99)
    assert len(bench.changes) == 1
    bench.run_to(start + 1000)
    assert bench.changes[1:] == [(40, start + 100, 1.0), (40, start + 250, 0.0)]
    assert bench.board.journal.late == []


def test_queued_across_the_wrap_of_the_clock(bench):
    bench.run_to((1 << 32) - 50)
    bench.digital()
    bench.queue((1 << 32) + 50, 1)
    bench.run_to((1 << 32) + 100)
    assert bench.changes[1:] == [(40, (1 << 32) + 50, 1.0)]


@pytest.mark.parametrize(
    ("on_ticks", "duty"), [(0, 0.0), (250, 0.25), (1000, 1.0)]
)
def test_soft_pwm(bench, on_ticks, duty):
    bench.digital(cycle=1000)
    bench.queue(bench.now() + 10, on_ticks)
    bench.run_to(bench.now() + 10)
    assert bench.changes[-1] == (40, bench.now(), duty)


def test_late_change_is_counted_and_made(bench):
    bench.digital()
    bench.queue(bench.now() - 30, 1)
    bench.run_to(bench.now())
    assert bench.changes[-1] == (40, bench.now(), 1.0)
    assert bench.board.journal.late == [30]


def test_update_is_immediate(bench):
    bench.digital()
    bench.tell("update_digital_out", oid=2, value=1)
    assert bench.changes[-1] == (40, bench.now(), 1.0)


def test_hard_pwm(bench):
    start = bench.now()
    bench.pwm(value=51)
    bench.tell("queue_pwm_out", oid=3, clock=start + 100, value=255)
    bench.run_to(start + 200)
    bench.tell("queue_pwm_out", oid=3, clock=start + 300, value=102)
    bench.run_to(start + 300)
    assert bench.changes == [
        (50, start, 0.2),
        (50, start + 100, 1.0),
        (50, start + 300, 0.4),
    ]


def test_shutdown_sets_the_levels_configured_for_it(bench):
    bench.digital(value=0, default=1)
    bench.pwm(value=255, default=51)
    bench.changes.clear()
    bench.tell("emergency_stop")
    assert sorted(bench.changes) == [
        (40, bench.now(), 1.0),
        (50, bench.now(), 0.2),
    ]


def test_shutdown_drops_what_was_queued(bench):
    # A heater must not come on after an emergency stop
    bench.digital()
    bench.queue(bench.now() + 100, 1)
    bench.tell("emergency_stop")
    bench.tell("clear_shutdown")
    bench.changes.clear()
    bench.run_to(bench.now() + 1000)
    assert bench.changes == []
    bench.queue(bench.now() + 100, 1)
    bench.run_to(bench.now() + 100)
    assert bench.changes == [(40, bench.now(), 1.0)]


def test_reset_forgets_the_outputs(bench):
    bench.digital(value=1)
    bench.tell("reset")
    assert bench.changes[-1] == (40, bench.now(), 0.0)
    bench.changes.clear()
    bench.tell("emergency_stop")
    assert bench.changes == []
