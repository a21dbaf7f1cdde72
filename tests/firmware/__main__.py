"""The figures of docs/reliability.md, and how fast it is.

    FIRMWARE=... python -m tests.firmware [--json FILE] [--workers N]

runs everything on each host, on our own board and on the host's program, and
compares every height.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from simprinter.hosts.hosts import Host, find_hosts
from simprinter.simulation import Stopwatch
from tests.firmware.programs import (
    RUNS,
    FirmwarePrinter,
    compare,
    dictionary,
    program_for,
)


def speed(host: Host) -> float:
    """Printer seconds per real second of G28 and CALIBRATE_Z."""
    with FirmwarePrinter(host, RUNS["CALIBRATE_Z"].scene) as printer:
        printer.session.require_ready()
        watch = Stopwatch(printer.machine.simulation)
        printer.run("G28\nCALIBRATE_Z\nM400")
        real, virtual = watch.seconds()
    return virtual / real


def main() -> int:
    """Print or write the figures; the exit code is 0 if nothing differs."""
    parser = argparse.ArgumentParser(prog="python -m tests.firmware")
    parser.add_argument("--json", type=Path, help="write them there")
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    hosts = [host for host in find_hosts() if program_for(host)]
    cells: dict[str, list[str]] = {}
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        for name in RUNS:
            cells[name] = list(pool.map(compare, hosts, [name] * len(hosts)))
            print(name, *cells[name], sep="  ", flush=True)  # noqa: T201
    heads = ["command or scene", *(heading(host) for host in hosts)]
    rows = [[name, *row] for name, row in cells.items()]
    text = json.dumps({"heads": heads, "rows": rows}, indent=1)
    if options.json is not None:
        options.json.write_text(text + "\n", encoding="utf-8")
    for host in hosts:
        ratio = statistics.median(speed(host) for _ in range(3))
        print(f"{host.name}: {ratio:.1f} times real time")  # noqa: T201
    return int("WRONG" in text)


def heading(host: Host) -> str:
    """A host and its program."""
    program = program_for(host)
    assert program is not None
    return f"{host.name}, firmware {dictionary(program).version}"


if __name__ == "__main__":
    sys.exit(main())
