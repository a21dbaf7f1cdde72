"""Digital and PWM outputs."""

from __future__ import annotations

import pytest

from simprinter.mcu.outputs import Outputs
from simprinter.tests.workbench import Bench

DIGITAL, PWM = 40, 50


class OutputBench(Bench):
    """Notes changes as (pin, clock, duty)."""

    def __init__(self) -> None:
        self.changes: list[tuple[int, int, float]] = []
        super().__init__(Outputs(self._changed))

    def _changed(self, pin: int, ns: int, duty: float) -> None:
        self.changes.append((pin, self.board.clock_at(ns), duty))

    def configure(self, kind: str, value: int = 0, shutdown: int = 0) -> None:
        """kind: digital, on pin 40, or pwm, on pin 50; oid 2."""
        pin, cycle = (DIGITAL, "") if kind == "digital" else (PWM, "5000")
        self.tell(
            f"config_{kind}_out oid=2 pin={pin} value={value}"
            f" default_value={shutdown} max_duration=0"
            + (cycle and f" cycle_ticks={cycle}")
        )

    def queue_output(self, clock: int, on_ticks: int) -> None:
        self.tell(f"queue_digital_out oid=2 clock={clock} on_ticks={on_ticks}")


@pytest.fixture
def bench() -> OutputBench:
    return OutputBench()


# The second is across the wrap of the clock
@pytest.mark.parametrize("start", [0, (1 << 32) - 50])
def test_queued_changes_happen_at_their_clocks(bench, start):
    bench.run_to(start)
    start = bench.now()
    bench.configure("digital", value=1)
    bench.queue_output(start + 100, 0)
    bench.queue_output(start + 250, 1)
    bench.run_to(start + 99)
    assert bench.changes == [(DIGITAL, start, 1.0)]
    bench.run_to(start + 1000)
    assert bench.changes[1:] == [
        (DIGITAL, start + 100, 0.0),
        (DIGITAL, start + 250, 1.0),
    ]
    assert bench.board.journal.shutdowns == []
    bench.tell("update_digital_out oid=2 value=0")
    assert bench.changes[-1] == (DIGITAL, bench.now(), 0.0)


@pytest.mark.parametrize(
    ("kind", "full", "level"),
    [("digital", 1, "on_ticks"), ("pwm", 255, "value")],
)
def test_shutdown_sets_its_own_level_and_drops_what_was_queued(
    bench, kind, full, level
):
    # A heater must not come on after an emergency stop
    bench.configure(kind, shutdown=full)
    off = f"queue_{kind}_out oid=2 {level}=0 clock={bench.now() + 100}"
    bench.tell(off)
    bench.tell("emergency_stop")
    bench.tell("clear_shutdown")
    bench.run_to(bench.now() + 99)
    assert bench.changes[-1][2] == 1.0
    bench.run_to(bench.now() + 1000)
    assert bench.changes[-1][2] == 1.0
    bench.tell(f"queue_{kind}_out oid=2 {level}=0 clock={bench.now()}")
    bench.run_to(bench.now())
    assert bench.changes[-1][1:] == (bench.now(), 0.0)
