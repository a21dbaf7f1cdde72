"""Small programs that live on the clock of a simulation."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any, Callable

from simprinter import VirtualClock, build_directory
from simprinter.simulation import Simulation


class Program:
    """A process in a simulation, in place of klippy.

    Use as a context manager; the process and the simulation end with it.
    """

    def __init__(
        self,
        command: list[str],
        prepare: Callable[[Simulation], Any] = lambda simulation: None,
        reads: bool = False,
    ):
        """prepare is called before the process starts.

        reads: its standard input is what is given to write().
        """
        clock = VirtualClock(build_directory())
        self.simulation = Simulation(clock)
        prepare(self.simulation)
        self._output = os.memfd_create("output")
        self._popen = subprocess.Popen(
            command,
            env={**os.environ, **clock.environment()},
            stdin=subprocess.PIPE if reads else subprocess.DEVNULL,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            pass_fds=clock.inherited_fds(),
        )
        self.simulation.process_fd = os.pidfd_open(self._popen.pid)

    def __enter__(self) -> Program:
        return self

    def __exit__(self, *unused: object) -> None:
        self._popen.kill()
        self._popen.wait()
        if self._popen.stdin is not None:
            self._popen.stdin.close()
        os.close(self._output)
        self.simulation.close()

    def write(self, data: bytes) -> None:
        """Give it something to read."""
        assert self._popen.stdin is not None
        self._popen.stdin.write(data)
        self._popen.stdin.flush()

    def finish(self, timeout: float = 1e6) -> list[str]:
        """Let it run to its end; the lines it has printed."""
        simulation = self.simulation
        simulation.run_until(simulation.process_ended, timeout, "program")
        status = self._popen.wait()
        text = self.output()
        assert status == 0, text
        return text.splitlines()

    def output(self) -> str:
        """What it has printed so far."""
        size = os.fstat(self._output).st_size
        return os.pread(self._output, size, 0).decode()


# For all programs; now() is 0 at their start
_PRELUDE = """
import os, queue, select, socket, subprocess, sys, threading, time
def now():
    return time.monotonic_ns() - START
START = time.monotonic_ns()
"""


def python(source: str, *arguments: str) -> list[str]:
    """Command to run a Python program."""
    return [sys.executable, "-c", _PRELUDE + source, *arguments]


def run_python(source: str, *arguments: str) -> list[str]:
    """Lines printed by a Python program on its own in a simulation."""
    with Program(python(source, *arguments)) as program:
        return program.finish()


def compile_c(source: str, directory: Path) -> list[str]:
    """Command to run a C program."""
    code = directory / "program.c"
    code.write_text(source)
    binary = directory / "program"
    subprocess.run(
        ["gcc", "-Wall", "-O1", "-o", binary, code, "-lpthread"], check=True
    )
    return [str(binary)]
