"""Every fault at every operation, then printers at random: make faults.

    python -m tests.campaign [--host NAME] [--job NAME] [--case TEXT]
        [--seed N] [--only faults|printers] [--json FILE]

Each case runs on one of the hosts, another for another case; EVERY_HOST=1: on
all of them. For each command it prints how many faults it was given, how the
command ended, and the worst penetration: how much deeper (mm) than in a good
run each site was pressed. What was not survived is printed with the command
that repeats it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import time
from collections.abc import Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Optional

from tests.campaign.faults import REFUSED, RIGHT, SHUT_DOWN
from tests.campaign.jobs import JOBS
from tests.campaign.running import attempt_all, figures, plan
from tests.hostkit.hosts import Host, find_hosts

_ENDS = (RIGHT, REFUSED, SHUT_DOWN)


def row(found: dict[str, Any]) -> str:
    """A command's line of the table."""
    ends = "".join(f"{found['ended'][end]:>11}" for end in _ENDS)
    worst = "  ".join(
        f"{site} {depth:.2f}/{JOBS[found['job']].margins[site]:.2f}"
        for site, depth in found["worst"].items()
    )
    return (
        f"{found['job']:30}{found['runs']:>6}{found['survived']:>10}{ends}"
        f"  {worst}"
    )


def say(text: str) -> None:
    """A line for people, at once."""
    print(text, flush=True)


def run_faults(
    pool: Executor, hosts: Sequence[Host], options: argparse.Namespace
) -> list[dict[str, Any]]:
    """All commands; prints as it goes."""
    heads = "".join(f"{end:>11}" for end in _ENDS)
    say("Faults: ended as; worst penetration beyond a good run's / margin, mm")
    say(f"{'':30}{'runs':>6}{'survived':>10}{heads}")
    table = []
    every = bool(os.environ.get("EVERY_HOST"))
    for job in [job for job in JOBS if options.job in job]:
        shares = [
            (0, 1) if every else (part, len(hosts))
            for part in range(len(hosts))
        ]
        make = partial(plan, options.seed, options.case, job)
        done = attempt_all(pool, list(pool.map(make, hosts, shares)))
        table.append(figures(job, done))
        say(row(table[-1]))
        for one in done:
            if one.outcome.problems:
                say(one.text())
    return table


def parse(arguments: Optional[Sequence[str]]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.campaign",
        description="Faults and random printers, on real klippies.",
    )
    parser.add_argument("--host", default="", help="part of the hosts' names")
    parser.add_argument("--job", default="", help="part of a command's name")
    parser.add_argument("--case", default="", help="part of a case's text")
    parser.add_argument("--seed", type=int, default=0, help="of all noise")
    parser.add_argument("--only", choices=("faults", "printers"))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--json", type=Path, help="write the figures there")
    return parser.parse_args(arguments)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run it all; the exit code is 0 if everything was survived."""
    options = parse(arguments)
    hosts = [host for host in find_hosts() if options.host in host.name]
    began = time.monotonic()
    say(f"hosts: {', '.join(host.name for host in hosts)}")
    good, report = True, {}
    context = get_context("spawn")
    with ProcessPoolExecutor(options.workers, context) as pool:
        if options.only != "printers":
            table = report["faults"] = run_faults(pool, hosts, options)
            runs = sum(found["runs"] for found in table)
            survived = sum(found["survived"] for found in table)
            say(f"{survived} of {runs} faults survived, seed {options.seed}")
            good = good and runs > 0 and survived == runs
    say(f"{(time.monotonic() - began) / 60.0:.1f} min")
    if options.json is not None:
        options.json.write_text(json.dumps(report, indent=2) + "\n")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
