"""simprinter run and simprinter bench: a G-code file, and how fast it went."""

from __future__ import annotations

import os
import re
import sys
import time
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from .hosts import starting
from .hosts.hosts import Host
from .plugin_printer import PluginPrinter, start
from .shown import Shown
from .simulation import Stopwatch

SAMPLE = Path(__file__).with_name("sample")
# Printer seconds that a line of G-code may take
LINE_LIMIT = 3600.0


def show(line: str) -> None:
    """On the terminal, at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def run(printer: PluginPrinter, lines: Iterable[str]) -> None:
    """Run G-code line by line as typed, and show what comes of it.

    Raises GcodeError with klippy's words at the first that fails, CrashError
    where the machine was hurt.
    """
    machine = printer.machine
    console = Shown(printer.console, show, machine.world.truth)
    machine.simulation.peers.append(console)
    for line in map(str.strip, lines):
        if line and not line.startswith(";"):
            show(f"> {line}")
            printer.session.run(line, LINE_LIMIT)
    # What is under way ends, and what it has touched is known
    printer.session.run("M400", LINE_LIMIT)
    truth = printer.truth
    console.pump()
    truth.require_no_crash()


class Figures(NamedTuple):
    """What a printer costs.

    speeds: by command, times real time and times what processors had to work,
    the second as on a core that has nothing else to do. first, later: s of real time until a
    klippy is ready, where nothing was kept and where its modules are imported
    already. klippy, simulator: MB of memory.
    """

    speeds: dict[str, tuple[float, float]]
    first: float
    later: float
    klippy: float
    simulator: float


def measure(
    host: Host, files: Sequence[object], commands: Iterable[str]
) -> Figures:
    """Start printers and run G28 and these commands. files: see start()."""
    starting.close()
    times = []
    for _ in range(4):
        began = time.monotonic()
        with start(host, *files):
            times.append(time.monotonic() - began)
    speeds = {}
    with start(host, *files) as printer:
        whole = _Watch(printer)
        for command in ("G28", *commands):
            watch = _Watch(printer)
            printer.run(command)
            speeds[command] = watch.speeds()
        if len(speeds) > 1:
            speeds["together"] = whole.speeds()
        klippy = _megabytes(str(printer.session.pid))
    return Figures(speeds, times[0], min(times[1:]), klippy, _megabytes("self"))


class _Watch:
    """Of a stretch of a printer's life: printer seconds, real, and worked."""

    def __init__(self, printer: PluginPrinter):
        self._stopwatch = Stopwatch(printer.machine.simulation)
        self._pid = printer.session.pid
        self._worked = self._work()

    def _work(self) -> float:
        """Processor time of klippy and of the simulator, s."""
        text = Path(f"/proc/{self._pid}/stat").read_text(encoding="ascii")
        # Behind the program's name, which may have spaces
        ticks = text.rpartition(")")[2].split()[11:13]
        klippy = sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK")
        return klippy + time.process_time()

    def speeds(self) -> tuple[float, float]:
        """Times real time, and times what was worked."""
        real, virtual = self._stopwatch.seconds()
        return virtual / real, virtual / (self._work() - self._worked)


def _megabytes(process: str) -> float:
    """What a process holds, with the pages that it shares with others."""
    text = Path("/proc", process, "smaps_rollup").read_text(encoding="ascii")
    found = re.search(r"^Rss:\s+(\d+) kB", text, re.MULTILINE)
    assert found
    return int(found[1]) / 1024.0


def told(figures: Figures) -> list[str]:
    """The figures, a line each."""
    lines = [
        f"{command}: {real:.0f} times real time, {worked:.0f} times processor"
        " time"
        for command, (real, worked) in figures.speeds.items()
    ]
    return [
        *lines,
        f"start: {figures.first:.2f} s the first time,"
        f" {figures.later:.2f} s after that",
        f"memory: klippy {figures.klippy:.0f} MB, simulator"
        f" {figures.simulator:.0f} MB",
    ]
