"""What a calibration costs, next to the least that it could: make bench.

    python -m tools.bench [--host NAME] [--seeds N] [--json FILE] [--chart FILE]

On the standard machine of every host it measures each of our COMMANDS:

- printer seconds right after G28, again in the same frame, and after another
  G28, next to the lower bound (see lower_bounds), and CPU time of klippy's process;
- time of loading and memory of the modules;
- on the main host, errors over many seeds on noisy sensors (see errors).

Printer seconds are those of the simulated printer; CPU and loading are of this
machine, and measured while nothing else of the benchmark runs. It prints the
tables of docs/performance.md. Figures and chart are below BUILD_DIR/bench, too.
"""

from __future__ import annotations

import argparse
import json
import platform
import re
import subprocess
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any, Optional

from simprinter.hosts.environment import REPO_ROOT, build_dir
from simprinter.hosts.hosts import Host, find_hosts, main_host
from simprinter.running import show
from tools.bench import chart, tables
from tools.bench.commands import COMMANDS
from tools.bench.cost import loadings
from tools.bench.errors import Errors, Trial, plan_trials, run_trial, summaries
from tools.bench.timing import measure
from tools.kit.printer import module_files

WORKERS = 2
SEEDS = 50


def parse(arguments: Optional[Sequence[str]]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench",
        description="Measure calibrations: time, errors, cost.",
    )
    parser.add_argument("--host", default="", help="part of the hosts' names")
    parser.add_argument(
        "--seeds", type=int, default=SEEDS, help="printers for the errors"
    )
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--chart", type=Path, help="draw the chart there")
    return parser.parse_args(arguments)


def timings(hosts: Sequence[Host]) -> Iterator[dict[str, Any]]:
    """All times of all commands, for a file; told as they come."""
    for command in COMMANDS:
        for host in hosts:
            runs = measure(host, command)
            shown = ", ".join(
                f"{run.name} {run.seconds:.2f}/{run.bound:.2f} s"
                for run in runs
            )
            show(f"{command.name}, {host.name}: {shown}")
            yield {
                "host": host.name,
                "command": command.name,
                "runs": [run.figures() for run in runs],
            }


def run_all(trials: Sequence[Trial]) -> Iterator[Errors]:
    """The errors of all trials in their order, with the progress shown."""
    with ProcessPoolExecutor(WORKERS) as pool:
        for done, errors in enumerate(pool.map(run_trial, trials), 1):
            yield errors
            if done % 50 == 0 or done == len(trials):
                show(f"errors: {done} of {len(trials)} printers")


def about(hosts: Sequence[Host]) -> dict[str, Any]:
    """What was measured, and on what."""
    modules = [file.name for file in module_files().values()]
    described = subprocess.run(
        ["git", "log", "-1", "--format=%h", "--", *modules],
        cwd=REPO_ROOT,
        capture_output=True,
        encoding="utf-8",
        check=False,
    )
    return {
        "revision": described.stdout.strip() or "unknown",
        "hosts": [host.name for host in hosts],
        "python": platform.python_version(),
        "processor": processor(),
    }


def processor() -> str:
    """The name of this machine's processor."""
    try:
        information = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        information = ""
    match = re.search(r"^model name\s*:\s*(.+)$", information, re.MULTILINE)
    return match[1] if match else platform.machine()


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, print, write; return the exit code."""
    options = parse(arguments)
    hosts = [host for host in find_hosts() if options.host in host.name]
    if not hosts:
        show(f"no host has {options.host!r} in its name")
        return 1
    # What needs the machine for itself comes first
    figures: dict[str, Any] = {"about": about(hosts)}
    figures["costs"] = [cost for host in hosts for cost in loadings(host)]
    figures["timings"] = list(timings(hosts))
    noisy = main_host() if main_host() in hosts else hosts[0]
    trials = plan_trials(noisy, options.seeds)
    figures["errors"] = summaries(trials, run_all(trials))
    folder = build_dir() / "bench"
    folder.mkdir(exist_ok=True)
    for file in filter(None, (folder / "performance.json", options.json)):
        text = json.dumps(figures, indent=1)
        file.write_text(text + "\n", encoding="utf-8")
    for file in filter(None, (folder / "performance.svg", options.chart)):
        chart.draw(figures, file)
    show(tables.render(str(folder / "performance.json")))
    show(f"also in {folder}: performance.json, performance.svg")
    return 0


if __name__ == "__main__":
    sys.exit(main())
