"""Every fault at every operation: make faults.

    python -m tools.campaign [--host NAME] [--job NAME] [--case TEXT]
        [--seed N] [--pairs N] [--docks] [--each N]
        [--module FILE | --builtin]
        [--every-host] [--json FILE]

Each case runs on one of the hosts, another for another case; with --every-host
on all of them. For each command it prints how many faults it was given, how the
command ended, and the worst penetration: how much deeper (mm) than in a good
run each site was pressed. What was not survived is printed with the command
that repeats it.

--pairs: as many pairs of these faults, drawn by the seed, instead of one at a
time; those with both sensors dead are listed with the depth at which they
ended. A pair is repeated by its text as --case.

--docks: every command of a dockable probe, and those of the other modules with the
probe on the toolhead, on each kind of dock.

--module and --builtin: the same for a dockable_probe of others, as far as they
have what is broken; only harm is judged: something was hit, the printer is shut
down, the result is wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Optional

from simprinter.hosts.hosts import Host, find_hosts
from simprinter.hosts.session import GcodeError, SessionError
from simprinter.simulation import SimulationError
from tools.campaign.fault_cases import REFUSED, RIGHT, SHUT_DOWN, Setting
from tools.campaign.jobs import (
    ALL_JOBS,
    COMPARED,
    COMPARED_ON_DOCKS,
    DOCK_JOBS,
    JOBS,
    MORE_JOBS,
)
from tools.campaign.running import (
    Plan,
    attempt_all,
    draw_pairs,
    figures,
    plan,
)
from tools.kit.printer import given_module

_ENDS = (RIGHT, REFUSED, SHUT_DOWN)


def others(options: argparse.Namespace) -> Optional[dict[str, Path]]:
    """The modules of others that the command line asks for."""
    if options.module is not None:
        return given_module("dockable_probe", options.module)
    return {} if options.builtin else None


def row(found: dict[str, Any]) -> str:
    """A command's line of the table."""
    ends = "".join(f"{found['ended'][end]:>11}" for end in _ENDS)
    return (
        f"{found['job']:30}{found['runs']:>6}{found['survived']:>10}{ends}"
        f"  {depths_text(found['job'], found['worst'])}"
    )


def depths_text(job: str, depths: Mapping[str, float]) -> str:
    """How deep each site was pressed, and how deep it may be."""
    margins = ALL_JOBS[job].margins
    return "  ".join(
        f"{site} {depth:.2f}/{margins[site]:.2f}"
        for site, depth in depths.items()
    )


def say(text: str) -> None:
    """A line for people, at once."""
    print(text, flush=True)


def jobs_of(options: argparse.Namespace) -> list[str]:
    """The commands that the command line asks for."""
    named = MORE_JOBS if options.more else JOBS
    named = DOCK_JOBS if options.docks else named
    jobs = [job for job in named if options.job in job]
    if others(options) is None:
        return jobs
    compared = (*COMPARED, *COMPARED_ON_DOCKS)
    return [job for job in jobs if job in compared]


def planned(
    pool: Executor,
    hosts: Sequence[Host],
    options: argparse.Namespace,
    job: str,
) -> list[Plan]:
    """What each host is given of a command; nothing: it fails as it is."""
    modules = others(options)
    setting = Setting(options.seed, modules, modules is not None)
    parts = 1 if options.every_host or options.pairs else len(hosts)
    shares = [
        (part % parts, parts * options.each) for part in range(len(hosts))
    ]
    make = partial(plan, setting, options.case, job)
    try:
        return list(pool.map(make, hosts, shares))
    except (AssertionError, GcodeError, SessionError, SimulationError) as error:
        if not setting.of_others:
            raise
        text = str(error).partition(", at t=")[0]
        say(f"{job:30}fails with nothing broken: {text}")
        return []


def run_faults(
    pool: Executor, hosts: Sequence[Host], options: argparse.Namespace
) -> list[dict[str, Any]]:
    """All commands; prints as it goes."""
    heads = "".join(f"{end:>11}" for end in _ENDS)
    say("Faults: ended as; worst penetration beyond a good run's / margin, mm")
    say(f"{'':30}{'runs':>6}{'survived':>10}{heads}")
    table = []
    jobs = jobs_of(options)
    plans: dict[str, list[Plan]] = {}
    if options.pairs:
        every_one = [
            one for job in jobs for one in planned(pool, hosts, options, job)
        ]
        for one in draw_pairs(every_one, options.pairs, options.seed):
            plans.setdefault(one.job, []).append(one)
    for job in jobs:
        done = attempt_all(
            pool, plans[job] if plans else planned(pool, hosts, options, job)
        )
        if not done:
            continue
        table.append(figures(job, done))
        say(row(table[-1]))
        for text in table[-1]["agreed"]:
            say(f"  both touches wrong alike: {text}")
        for one in table[-1]["blind"]:
            depths = depths_text(job, one["depths"])
            say(f"  both sensors dead: {one['case']} on {one['host']}:")
            say(f"    {one['reason'] or one['ended']}; {depths}")
        # A run that is broken off leaves what it has found
        about = {"seed": options.seed, "each": options.each}
        write_json(options, about, table)
        for one in done:
            if one.outcome.problems:
                say(one.text())
    return table


def parse(arguments: Optional[Sequence[str]]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.campaign",
        description="Faults at every operation, on real klippies.",
    )
    parser.add_argument("--host", default="", help="part of the hosts' names")
    parser.add_argument("--job", default="", help="part of a command's name")
    parser.add_argument(
        "--more",
        action="store_true",
        help="the commands that wait or heat instead of the others",
    )
    parser.add_argument("--case", default="", help="part of a case's text")
    parser.add_argument("--seed", type=int, default=0, help="of all noise")
    parser.add_argument(
        "--module",
        type=Path,
        metavar="FILE",
        help="faults of this dockable_probe.py instead of ours",
    )
    parser.add_argument(
        "--builtin",
        action="store_true",
        help="faults of the host's own dockable_probe instead of ours",
    )
    parser.add_argument(
        "--every-host", action="store_true", help="each case on all of them"
    )
    parser.add_argument(
        "--docks", action="store_true", help="faults on each kind of dock"
    )
    parser.add_argument(
        "--each", type=int, default=1, metavar="N", help="one of N cases only"
    )
    parser.add_argument(
        "--pairs", type=int, default=0, help="two faults at a time, so often"
    )
    parser.add_argument("--workers", type=int, default=3)
    parser.add_argument("--json", type=Path, help="write the figures there")
    return parser.parse_args(arguments)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run it all; the exit code is 0 if everything was survived."""
    options = parse(arguments)
    hosts = [host for host in find_hosts() if options.host in host.name]
    say(f"hosts: {', '.join(host.name for host in hosts)}")
    began = time.monotonic()
    # What a worker has imported must not be forked
    context = get_context("spawn")
    with ProcessPoolExecutor(options.workers, context) as pool:
        table = run_faults(pool, hosts, options)
    about = {
        "hosts": [host.name for host in hosts],
        "seed": options.seed,
        "each": options.each,
        "minutes": (time.monotonic() - began) / 60.0,
    }
    write_json(options, about, table)
    return 0 if is_well(about, table) else 1


def is_well(about: dict[str, Any], table: Sequence[dict[str, Any]]) -> bool:
    """Say and return whether everything is as it must be."""
    runs = sum(found["runs"] for found in table)
    survived = sum(found["survived"] for found in table)
    say(
        f"\n{survived} of {runs} faults survived; seed {about['seed']},"
        f" {about['minutes']:.1f} min"
    )
    return survived == runs > 0


def write_json(
    options: argparse.Namespace,
    about: dict[str, Any],
    table: Sequence[dict[str, Any]],
) -> None:
    """All figures to a file, if wanted; what they do not replace in it stays."""
    if options.json is None:
        return
    report = {}
    if options.json.exists():
        report = json.loads(options.json.read_text())
    if options.docks:
        report["docks"] = {"about": about, "faults": list(table)}
    elif options.pairs:
        report["pairs"] = {"about": about, "faults": list(table)}
    else:
        report["about"] = about
        report["faults"] = list(table)
    options.json.write_text(json.dumps(report, indent=1) + "\n")


if __name__ == "__main__":
    sys.exit(main())
