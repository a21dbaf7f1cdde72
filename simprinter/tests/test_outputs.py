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

    def configure(
        self, kind: str, value: int = 0, shutdown: int = 0, limit: int = 0
    ) -> None:
        """kind: digital, on pin 40, or pwm, on pin 50; oid 2.

        limit: its max_duration, ticks.
        """
        pin, cycle = (DIGITAL, "") if kind == "digital" else (PWM, "5000")
        self.tell(
            f"config_{kind}_out oid=2 pin={pin} value={value}"
            f" default_value={shutdown} max_duration={limit}"
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


# Of each kind: its full duty, how that is called, and the firmware's words
KINDS = pytest.mark.parametrize(
    ("kind", "level", "words"),
    [
        ("digital", "on_ticks=1", "digital out"),
        ("pwm", "value=255", "hard pwm"),
    ],
)


def test_late_change_shuts_down(bench):
    bench.configure("digital")
    bench.queue_output(bench.now(), 1)
    bench.run_to(bench.now())
    assert bench.changes[-1] == (DIGITAL, bench.now(), 1.0)
    bench.queue_output(bench.now() - 1, 0)
    assert bench.shutdown() == "Timer too close"


@KINDS
def test_output_that_is_no_longer_refreshed_shuts_down(
    bench, kind, level, words
):
    bench.configure(kind, limit=1000)
    start = bench.now() + 50
    # Two are to come, then one at a time
    for clock in (start, start + 1000, start + 1600):
        bench.run_to(clock - 620)
        bench.tell(f"queue_{kind}_out oid=2 {level} clock={clock}")
    bench.run_to(start + 2599)
    assert bench.changes[-1][1:] == (start + 1600, 1.0)
    bench.run_to(start + 9000)
    assert bench.shutdown() == f"Missed scheduling of next {words} event"
    assert bench.changes[-1][1:] == (start + 2600, 0.0)


@KINDS
@pytest.mark.parametrize("is_waiting", [True, False])
def test_next_change_is_not_too_far_ahead(
    bench, kind, level, words, is_waiting
):
    bench.configure(kind, limit=1000)
    start = bench.now() + 50
    first, second = (
        f"queue_{kind}_out oid=2 {level} clock={clock}"
        for clock in (start, start + 1001)
    )
    bench.tell(first, *[second] * is_waiting)
    bench.run_to(start)
    if not is_waiting:
        bench.tell(second)
    words = words.replace("hard ", "")
    reason = f"Scheduled {words} event will exceed max_duration"
    assert bench.shutdown() == reason


@pytest.mark.parametrize(
    ("value", "shutdown", "ends"),
    [(1, 0, True), (0, 1, True), (0, 0, False), (1, 1, False)],
)
def test_only_what_a_shutdown_would_change_is_limited(
    bench, value, shutdown, ends
):
    bench.configure("digital", 1 - value, shutdown, 1000)
    for level in (1 - value, value, value):
        bench.tell(f"update_digital_out oid=2 value={level}")
        bench.run_to(bench.now() + 600)
    assert bench.board.journal.shutdowns == []
    bench.run_to(bench.now() + 400)
    assert bool(bench.board.journal.shutdowns) == ends
    assert bench.changes[-1][2] == (shutdown if ends else value)


def test_changes_take_items_of_the_move_queue(bench):
    size = bench.ask("get_config")["move_count"]
    bench.configure("digital")
    start = bench.now() + 100
    for n in range(size + 1):
        assert bench.board.journal.shutdowns == []
        bench.queue_output(start + n, 1)
        if n == 0:
            bench.run_to(start)
    bench.queue_output(start + size + 1, 1)
    assert bench.shutdown() == "Move queue overflow"


def test_change_at_once_amid_changes_to_come(bench):
    bench.configure("digital")
    bench.queue_output(bench.now() + 100, 1)
    bench.tell("update_digital_out oid=2 value=0")
    reason = "update_digital_out not valid with active queue"
    assert bench.shutdown() == reason


def test_pwm_by_software_and_by_hardware(bench):
    start = bench.now()
    bench.configure("digital")
    bench.tell("set_digital_out_pwm_cycle oid=2 cycle_ticks=1000")
    bench.queue_output(start + 10, 250)
    bench.run_to(start + 10)
    assert bench.changes[-1] == (DIGITAL, start + 10, 0.25)
    bench.configure("pwm", value=51)
    bench.tell(f"queue_pwm_out oid=2 clock={start + 100} value=255")
    bench.run_to(start + 200)
    assert bench.changes[-2:] == [
        (PWM, start + 10, 0.2),
        (PWM, start + 100, 1.0),
    ]


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


def test_reset_forgets_the_outputs(bench):
    bench.configure("digital", value=1)
    bench.tell("reset")
    assert bench.changes[-1] == (DIGITAL, bench.now(), 0.0)
    bench.changes.clear()
    bench.tell("emergency_stop")
    assert bench.changes == []
