"""What a broker, Telegraf's stand-in and Prometheus need for many printers.

    python -m tools.farm --printers 10 100 1000 --minutes 10

Real mosquitto and Prometheus (Debian has both), our own files of
examples/print_farm, printers that are only their messages: each calibrates
every ten minutes, and of 100 runs one is refused.  Prints one row for each
number of printers.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import psutil
from tabulate import tabulate

from tools.farm import servers
from tools.farm.printers import Hall, Printer

INTERVAL = 600.0  # s between two runs of a printer
REFUSED = 0.01
# As prometheus.yml has it
COLLECTED = 30.0
DAY = 86400.0
# A refusal that is not told within this time (s) is lost
LONGEST = 300.0
HEADERS = (
    "printers",
    "messages/s",
    "MB/day over the network",
    "broker CPU %",
    "broker MB",
    "stand-in CPU %",
    "stand-in MB",
    "Prometheus CPU %",
    "Prometheus MB",
    "Prometheus disk MB/day",
    "refusal to alert s, median",
    "worst",
)


class Usage:
    """CPU time and memory of a process between two moments."""

    def __init__(self, server: servers.Server):
        assert server.process is not None
        self._process = psutil.Process(server.process.pid)
        self._before = self._cpu()

    def _cpu(self) -> float:
        times = self._process.cpu_times()
        return times.user + times.system

    def cells(self, seconds: float) -> tuple[str, str]:
        """Percent of a core, and MB."""
        percent = 100.0 * (self._cpu() - self._before) / seconds
        memory = self._process.memory_info().rss / 1e6
        return f"{percent:.2f}", f"{memory:.0f}"


def samples_stored(port: int) -> float:
    """How many samples Prometheus has taken since it began."""
    return servers.metric(port, "prometheus_tsdb_head_samples_appended_total")


def delays(hall: Hall, watched: Printer, port: int, count: int) -> list[float]:
    """Seconds from a refusal of the watched printer to its alert."""
    alert, taken = ("CalibrationRefused", watched.name), []

    def fires(wanted: bool) -> bool:
        hall.live(time.monotonic() + 0.5, REFUSED, watched)
        return (alert in servers.firing(port)) is wanted

    for _ in range(count):
        began = time.monotonic()
        watched.calibrated(False)
        servers.until(lambda: fires(True), f"{alert}", LONGEST)
        taken.append(time.monotonic() - began)
        watched.calibrated(True)
        servers.until(lambda: fires(False), f"the end of {alert}", LONGEST)
    return taken


def row(
    count: int,
    minutes: float,
    folder: Path,
    seed: int,
    interval: float = INTERVAL,
    every: float = COLLECTED,
) -> list[Any]:
    """One number of printers. Raises AssertionError if a refusal is lost.

    Each calibrates every `interval` s, Prometheus looks every `every` s.
    """
    with ExitStack() as stack:
        broker = stack.enter_context(servers.mosquitto(folder))
        telegraf = stack.enter_context(servers.telegraf(broker.port))
        prometheus = stack.enter_context(
            servers.prometheus(folder, telegraf.port, every)
        )
        hall = Hall(count, broker.port, interval, seed)
        stack.callback(hall.close)
        watched = hall.printers[0]
        # Until all of them have said something
        hall.live(time.monotonic() + interval + every, REFUSED, watched)
        usages = [Usage(s) for s in (broker, telegraf, prometheus)]
        stored = samples_stored(prometheus.port)
        sent = sum(printer.sent for printer in hall.printers)
        octets = sum(printer.bytes for printer in hall.printers)
        began = time.monotonic()
        hall.live(began + 60.0 * minutes, REFUSED, watched)
        seconds = time.monotonic() - began
        used = [cell for usage in usages for cell in usage.cells(seconds)]
        sent = sum(printer.sent for printer in hall.printers) - sent
        octets = sum(printer.bytes for printer in hall.printers) - octets
        # 1.5 bytes for a sample, as Prometheus's documents say
        samples = samples_stored(prometheus.port) - stored
        disk = 1.5 * samples / seconds * DAY / 1e6
        taken = delays(hall, watched, prometheus.port, 5)
    return [
        count,
        f"{sent / seconds:.2f}",
        f"{octets / seconds * DAY / 1e6:.1f}",
        *used,
        f"{disk:.1f}",
        f"{statistics.median(taken):.0f}",
        f"{max(taken):.0f}",
    ]


def main() -> int:
    """Return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument(
        "--printers", type=int, nargs="+", default=[10, 100, 1000]
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    missing = [n for n in ("mosquitto", "prometheus") if not servers.program(n)]
    if missing:
        sys.stderr.write(
            f"error: not installed: {', '.join(missing)}"
            f" (Debian: apt install {' '.join(missing)})\n"
        )
        return 1
    rows = []
    for count in options.printers:
        with TemporaryDirectory(prefix="farm-") as folder:
            rows.append(row(count, options.minutes, Path(folder), options.seed))
        sys.stdout.write(f"{count} printers: done\n")
    columns = list(zip(HEADERS, *rows))
    sys.stdout.write(tabulate(columns, headers="firstrow", tablefmt="github"))
    sys.stdout.write("\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
