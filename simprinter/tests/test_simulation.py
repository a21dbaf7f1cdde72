"""The loop around boards, lines, peers and a process."""

from __future__ import annotations

import os
import signal
import time
from threading import Timer

import pytest

from simprinter import RealClock, VirtualClock, build_directory
from simprinter import simulation as simulation_module
from simprinter.mcu.board import Board
from simprinter.simulation import (
    Pace,
    Simulation,
    SimulationError,
    Stopwatch,
)
from simprinter.tests.programs import Program, python

SECOND = 10**9
SLEEP = "while True: time.sleep(0.7)"
WAIT = "threading.Event().wait()"
BUSY = "while True: pass"


def never() -> bool:
    """What is waited for in vain."""
    return False


def test_timeout_names_what_was_waited_for():
    with Program(python(SLEEP)) as program:
        simulation = program.simulation
        simulation.run_until(lambda: True, 5.0, "nothing")
        assert (simulation.virtual_ns, simulation.jumps) == (0, 0)
        with pytest.raises(SimulationError, match="^tea: 5 s have passed$"):
            simulation.run_until(never, 5.0, "tea")
        # Not later, though the process sleeps beyond it
        assert simulation.virtual_ns == 5 * SECOND
        assert 0 < simulation.jumps < 20


def test_end_of_the_process():
    with Program(python("time.sleep(2)")) as program:
        simulation = program.simulation
        assert not simulation.process_ended()
        with pytest.raises(SimulationError, match="^tea: klippy has ended$"):
            simulation.run_until(never, 5.0, "tea")
        assert simulation.process_ended()
        assert simulation.virtual_ns == 2 * SECOND


@pytest.mark.parametrize(
    ("source", "message"), [(WAIT, "nobody waits"), (BUSY, "klippy is busy")]
)
def test_process_that_waits_for_nothing_or_never(monkeypatch, source, message):
    # Python itself starts within that
    monkeypatch.setattr(simulation_module, "_STALL_LIMIT", 3.0)
    failure = pytest.raises(SimulationError, match=f"^tea: {message}")
    with Program(python(source)) as program, failure:
        program.simulation.run_until(never, 5.0, "tea")
    assert program.simulation.virtual_ns == 0


def test_process_on_its_way_out_is_given_time():
    # A process that ends has left the clock some milliseconds before
    with Program(python(WAIT)) as program:
        pidfd = program.simulation.process_fd
        kill = Timer(0.5, signal.pidfd_send_signal, (pidfd, signal.SIGKILL))
        program.simulation.run_until(
            program.simulation.clock.everybody_sleeps, 5.0, "falling asleep"
        )
        kill.start()
        with pytest.raises(SimulationError, match="^tea: klippy has ended$"):
            program.simulation.run_until(never, 5.0, "tea")
        kill.join()


def test_process_that_is_woken_and_computes_is_no_dead_end(monkeypatch):
    """As klippy does while it starts, on a machine with much to do."""
    monkeypatch.setattr(simulation_module, "_DEAD_END", 0.5)
    source = """
os.read(0, 1)
while time.process_time() < 1.5: # the processor's time is real
    pass
print(now())
"""
    with Program(python(source), reads=True) as program:
        program.simulation.run_until(
            program.simulation.clock.everybody_sleeps, 5.0, "falling asleep"
        )
        wake = Timer(0.2, program.write, (b"x",))
        wake.start()
        assert program.finish() == ["0"]
        wake.join()


@pytest.mark.parametrize("latency_ns", [0, 3_000_000])
def test_boards_and_lines_live_though_the_process_sleeps(latency_ns):
    made = []

    def prepare(simulation):
        board = Board(simulation.clock.now, [])
        made.extend((board, simulation.add_board(board, latency_ns)))

    with Program(python(WAIT), prepare) as program:
        simulation, (board, link), ran = program.simulation, made, []
        start = board.clock()
        for ticks in (300, 100, 200):
            board.schedule(start + ticks, lambda _: ran.append(board.clock()))
        simulation.run_until(lambda: len(ran) == 3, 1.0, "events")
        assert ran == [start + ticks for ticks in (100, 200, 300)]
        before = simulation.virtual_ns
        board.shut_down()
        simulation.run_until(lambda: link.sent > 0, 1.0, "answer")
        assert simulation.virtual_ns == before + latency_ns


class Peer:
    """Not settled the first `delay` times; readable always."""

    def __init__(self, delay: int):
        self.delay = delay
        self.pumped = 0
        self._reader, self._writer = os.pipe()
        os.write(self._writer, b"x")

    def fileno(self) -> int:
        return self._reader

    def pump(self) -> bool:
        self.pumped += 1
        return False

    def settled(self) -> bool:
        self.delay -= 1
        return self.delay < 0

    def close(self) -> None:
        os.close(self._reader)
        os.close(self._writer)


def test_clock_waits_for_peers():
    peer = Peer(5)
    with Program(python(SLEEP)) as program:
        simulation = program.simulation
        simulation.peers.append(peer)
        simulation.run_until(lambda: peer.delay <= 0, 5.0, "peer")
        assert simulation.virtual_ns == 0
        assert peer.pumped > 5
        simulation.run_until(
            lambda: simulation.virtual_ns >= SECOND, 5.0, "second"
        )
    peer.close()


def test_paced_clock_does_not_run_ahead_of_real_time():
    with Program(python("while True: time.sleep(0.1)")) as program:
        simulation, ahead = program.simulation, []
        watch = Stopwatch(simulation)
        simulation.pace = Pace(simulation.clock, 20.0)

        def look():
            real, virtual = watch.seconds()
            ahead.append(virtual - 20.0 * real)
            return virtual >= 10.0

        simulation.run_until(look, 100.0, "ten seconds")
        assert max(ahead) < 1e-6
    assert watch.seconds()[1] == pytest.approx(10.0, abs=0.1)


def test_paced_clock_serves_who_speaks_meanwhile():
    # Asleep for an hour, unless somebody writes
    source = "while True: select.select([0], [], [], 3600); os.read(0, 1)"
    with Program(python(source), reads=True) as program:
        simulation = program.simulation
        simulation.pace = Pace(simulation.clock, 1.0)
        with pytest.raises(SimulationError, match="have passed"):
            simulation.run_until(never, 0.2, "falling asleep")
        wakes = simulation.clock.wakes()
        program.write(b"x")
        simulation.run_until(
            lambda: simulation.clock.wakes() > wakes, 5.0, "waking up"
        )


def test_real_time_is_the_same_loop():
    simulation = Simulation(RealClock())
    try:
        board = Board(simulation.clock.now, [])
        simulation.add_board(board)
        ran, start = [], time.monotonic()
        board.schedule(board.clock() + 5_000_000, ran.append)  # 0.1 s
        simulation.run_until(lambda: bool(ran), 30.0, "event")
        assert time.monotonic() - start >= 0.09
        with pytest.raises(SimulationError, match="have passed"):
            simulation.run_until(never, 0.1, "tea")
    finally:
        simulation.close()


def test_closing_leaves_nothing_behind():
    before = set(os.listdir("/proc/self/fd"))
    simulation = Simulation(VirtualClock(build_directory()))
    board = Board(simulation.clock.now, [])
    link = simulation.add_board(board)
    page = simulation.clock.environment()["VCLOCK_PAGE"]
    assert os.path.exists(page)
    simulation.close()
    assert not os.path.exists(page)
    assert not os.path.lexists(link.path)
    assert set(os.listdir("/proc/self/fd")) == before
