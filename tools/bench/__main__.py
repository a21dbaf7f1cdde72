"""What a calibration costs, next to the least that it could: make bench.

    python -m tools.bench [--host NAME] [--module FILE] [--builtin]
        [--seeds N] [--errors-on NAME] [--json FILE] [--chart FILE]

On the standard machine of every host it measures CALIBRATE_Z,
PROBE_Z_ACCURACY and AUTO_Z_CALIBRATE:

- printer seconds right after G28, again in the same frame, and after another
  G28, next to the lower bound (see bounds), and CPU time of klippy's process;
- time of loading and memory of the modules;
- errors over many seeds on noisy sensors (see errors).

Printer seconds are those of the simulated printer; CPU and loading are of this
machine, and measured while nothing else of the benchmark runs. --module
measures another z_calibration.py in the same run, --builtin the one a host
ships itself, and prints ours / theirs for CALIBRATE_Z. One that does not run
on a host is no failure of the benchmark; the line says why.

Text, figures and chart are written below BUILD_DIR/bench, too.
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

from simprinter.hosts.environment import REPO_ROOT, HostError, build_dir
from simprinter.hosts.hosts import Host, find_hosts
from tools.bench import chart, tables
from tools.bench.commands import CALIBRATE_Z, COMMANDS, Command
from tools.bench.cost import loadings, other_loading
from tools.bench.errors import (
    OUTLIER,
    OUTLIER_CHANCE,
    PROCEDURES,
    UM,
    Errors,
    Trial,
    plan_trials,
    run_trial,
    summaries,
)
from tools.bench.timing import OURS, Subject, attempt, ours, reason
from tools.kit.printer import given_module, module_files

WORKERS = 2
SEEDS = 50
BUILTIN = "the host's own"


class Output:
    """Lines for people, at once, and kept for a file."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def say(self, *lines: str) -> None:
        """Print them."""
        for line in lines:
            self.lines.append(line)
            print(line, flush=True)  # noqa: T201


def parse(arguments: Optional[Sequence[str]]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.bench",
        description="Measure calibrations: time, errors, cost.",
    )
    parser.add_argument("--host", default="", help="part of the hosts' names")
    parser.add_argument(
        "--module",
        action="append",
        default=[],
        type=Path,
        metavar="FILE",
        help="measure this z_calibration.py, too",
    )
    parser.add_argument(
        "--builtin",
        action="store_true",
        help="measure the host's own module, too",
    )
    parser.add_argument(
        "--seeds", type=int, default=SEEDS, help="for the errors; 0: none"
    )
    parser.add_argument(
        "--errors-on",
        action="append",
        metavar="NAME",
        help="part of the names of the hosts to measure errors on (all)",
    )
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--chart", type=Path, help="draw the chart there")
    return parser.parse_args(arguments)


def others(options: argparse.Namespace) -> list[Subject]:
    """What the command line asks for besides ours."""
    found = [
        Subject(str(file), given_module("z_calibration", file))
        for file in options.module
    ]
    if options.builtin:
        found.append(Subject(BUILTIN, {}))
    return found


def subjects(command: Command, besides: Sequence[Subject]) -> list[Subject]:
    """All modules to run a command of, ours first."""
    found = [ours(command.module)]
    return found + list(besides) if command is CALIBRATE_Z else found


# Phases


def time_command(
    command: Command,
    hosts: Sequence[Host],
    besides: Sequence[Subject],
    output: Output,
) -> list[dict[str, Any]]:
    """All times of a command, for a file; printed."""
    modules = subjects(command, besides)
    outcomes = {
        (host.name, module.name): attempt(host, module, command)
        for host in hosts
        for module in modules
    }
    output.say("", tables.times(command, outcomes))
    done = [o for o in outcomes.values() if not isinstance(o, str)]
    output.say(tables.bounds(command, [run for runs in done for run in runs]))
    return [
        {
            "host": host,
            "module": module,
            "command": command.name,
            "failure": outcome if isinstance(outcome, str) else None,
            "runs": []
            if isinstance(outcome, str)
            else [run.figures() for run in outcome],
        }
        for (host, module), outcome in outcomes.items()
    ]


def cost_figures(
    hosts: Sequence[Host], besides: Sequence[Subject], output: Output
) -> list[dict[str, Any]]:
    """What loading takes; one that cannot be loaded is left out, and told."""
    found = []
    for host in hosts:
        found += [{**cost, "other": False} for cost in loadings(host)]
        for subject in besides:
            file = subject.modules.get("z_calibration")
            if file is None:
                continue
            try:
                cost = other_loading(host, subject.name, file)
                found.append({**cost, "other": True})
            except HostError as error:
                output.say(f"{host.name}: {reason(error)}")
    return found


def error_figures(
    host: Host,
    timings: Sequence[dict[str, Any]],
    besides: Sequence[Subject],
    seeds: int,
) -> list[dict[str, Any]]:
    """The errors on a host of all that has run there when it was timed."""
    failed = {
        (timing["module"], timing["command"])
        for timing in timings
        if timing["host"] == host.name and timing["failure"]
    }
    trials: list[Trial] = []
    for name, procedure in PROCEDURES.items():
        command = procedure.command
        for subject in subjects(command, besides):
            if (subject.name, command.name) not in failed:
                trials += plan_trials(host, subject, name, seeds)
    return summaries(trials, run_all(trials))


def run_all(trials: Sequence[Trial]) -> Iterator[Errors]:
    """The errors of all trials in their order, with the progress shown."""
    with ProcessPoolExecutor(WORKERS) as pool:
        for done, errors in enumerate(pool.map(run_trial, trials), 1):
            yield errors
            if done % 50 == 0 or done == len(trials):
                print(  # noqa: T201
                    f"errors: {done} of {len(trials)} printers",
                    file=sys.stderr,
                    flush=True,
                )


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
        "outlier_um": OUTLIER * UM,
        "outlier_chance": OUTLIER_CHANCE,
    }


def processor() -> str:
    """The name of this machine's processor."""
    try:
        information = Path("/proc/cpuinfo").read_text(encoding="utf-8")
    except OSError:
        information = ""
    match = re.search(r"^model name\s*:\s*(.+)$", information, re.MULTILINE)
    return match[1] if match else platform.machine()


def measure_all(
    options: argparse.Namespace, hosts: Sequence[Host], output: Output
) -> dict[str, Any]:
    """All phases: what needs the machine for itself comes first.

    What is known is kept below BUILD_DIR from then on, host by host.
    """
    besides = others(options)
    figures: dict[str, Any] = {"about": about(hosts)}
    figures["costs"] = cost_figures(hosts, besides, output)
    output.say(tables.costs(figures["costs"]))
    timings = figures["timings"] = []
    for command in COMMANDS:
        timings += time_command(command, hosts, besides, output)
    errors = figures["errors"] = []
    write_json(figures, folder() / "performance.json")
    for host in hosts:
        # No names: all
        is_meant = any(n in host.name for n in options.errors_on or [""])
        if options.seeds and is_meant:
            of_host = error_figures(host, timings, besides, options.seeds)
            output.say("", tables.errors(of_host))
            errors += of_host
            write_json(figures, folder() / "performance.json")
    output.say(tables.reasons(errors))
    return figures


# Files


def folder() -> Path:
    """Where everything is written that was not asked for elsewhere."""
    found = build_dir() / "bench"
    found.mkdir(exist_ok=True)
    return found


def write_json(figures: dict[str, Any], file: Path) -> None:
    """The figures."""
    file.write_text(json.dumps(figures, indent=1) + "\n", encoding="utf-8")


def write_files(
    options: argparse.Namespace, figures: dict[str, Any], output: Output
) -> None:
    """What was asked for, and copies below BUILD_DIR."""
    for file in filter(None, (folder() / "performance.json", options.json)):
        write_json(figures, file)
    for file in filter(None, (folder() / "performance.svg", options.chart)):
        chart.draw(figures, file)
    (folder() / "performance.txt").write_text(
        "\n".join(output.lines) + "\n", encoding="utf-8"
    )
    print(f"also in {folder()}: performance.txt, .json, .svg")  # noqa: T201


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Measure, print, write; return the exit code."""
    options = parse(arguments)
    output = Output()
    hosts = [host for host in find_hosts() if options.host in host.name]
    if not hosts:
        output.say(f"no host has {options.host!r} in its name")
        return 1
    figures = measure_all(options, hosts, output)
    write_files(options, figures, output)
    own = [t for t in figures["timings"] if t["module"] == OURS]
    return int(any(timing["failure"] for timing in own))


if __name__ == "__main__":
    sys.exit(main())
