"""How much faster than a real printer the simulation runs.

    python -m tools.bench.speed [HOST ...]

runs G28 and CALIBRATE_Z on the voron scene, once alone and twice at the same
time, and prints the ratio of printer seconds to real seconds, with and
without klippy's start. One line a host; the times are of this machine.
"""

from __future__ import annotations

import statistics
import sys
import time
from concurrent.futures import ProcessPoolExecutor

from simprinter.hosts.hosts import find_hosts
from simprinter.simulation import Stopwatch
from tools.kit.printer import Printer

RUNS = 3


def measure(name: str) -> tuple[float, float]:
    """(with klippy's start, without): printer seconds per real second."""
    host = next(host for host in find_hosts() if host.name == name)
    began = time.monotonic()
    with Printer(host) as printer:
        printer.session.require_ready()
        watch = Stopwatch(printer.machine.simulation)
        printer.run("G28\nCALIBRATE_Z\nM400")
        real, virtual = watch.seconds()
        whole = printer.machine.simulation.virtual_ns * 1e-9
    return whole / (time.monotonic() - began), virtual / real


def row(name: str, at_once: int) -> str:
    """Median ratios of several runs, at_once of them side by side."""
    with ProcessPoolExecutor(at_once) as pool:
        list(pool.map(measure, [name] * at_once))  # imports and caches
        found = list(pool.map(measure, [name] * RUNS * at_once))
    start, run = (statistics.median(ratios) for ratios in zip(*found))
    return f"{run:6.0f}x {start:6.0f}x"


def main(names: list[str]) -> int:
    """Print the table; return the exit code."""
    hosts = [h.name for h in find_hosts() if not names or h.name in names]
    width = max(map(len, hosts), default=4)
    print("printer seconds per real second: run, with klippy's start")
    print(f"{'host':{width}}  {'alone':>15}  {'two at once':>15}")
    for name in hosts:
        print(f"{name:{width}}  {row(name, 1)}  {row(name, 2)}")
    return 0 if hosts else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
