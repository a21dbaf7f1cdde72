"""Walks on simulated printers, the world as the judge: make faults, make walks.

    python -m tools.campaign faults [--job NAME] [--case TEXT] [--each N]
        [--pairs N [--after]] [--docks | --more] [--seed N]
    python -m tools.campaign walks [--count N] [--seed N]
    both: [--host NAME] [--workers N] [--product DIR] [--json FILE]
        [--folder FOLDER] [--replay FILE]

faults: every fault at every operation of every command. A new printer is homed,
something breaks once in a command, is mended, and the command runs again. Each
case is on one of the hosts, another for another case. For each command it prints
how many faults it was given, how the command ended, and the worst penetration:
how much deeper (mm) than in a good run each site was pressed. --pairs: as many
pairs of these faults, drawn by the seed, instead of one at a time; those with both
sensors dead are listed with the depth at which they ended. --after: the second of
two strikes in the next run, when the first is mended. --docks: every command
of a dockable probe, and those of the other modules with the probe on the toolhead,
on each kind of dock.

walks: a drawn printer, and 5 to 30 steps of what owners, Klipper and another
client do, and hands. One that fails is made as short as it gets.

What has failed is written to the folder with its printer.cfg; --replay goes it
again, and shows the console. --product: with the modules of another checkout.
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
from simprinter.running import show
from tools.campaign import faults, running
from tools.campaign.jobs import ALL_JOBS, DOCK_JOBS, JOBS, MORE_JOBS
from tools.campaign.running import Done, Plan, Report, Share
from tools.campaign.walker import REFUSED, RIGHT, SHUT_DOWN

_ENDS = (RIGHT, REFUSED, SHUT_DOWN)


def tell(done: Done, folder: Path) -> None:
    """What was wrong, if anything, and what shows it again."""
    if done.outcome.harm:
        file = running.write(done, folder)
        show(
            f"{done.name}: {done.outcome.harm}\n    --replay {file} --host {done.host}"
        )


# Every fault at every operation


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


def planned(
    pool: Executor,
    hosts: Sequence[Host],
    options: argparse.Namespace,
    job: str,
) -> list[Plan]:
    """What each host is given of a command."""
    modules = running.modules_of(options.product)
    # A pair is drawn from all cases of a host
    turns = 1 if options.pairs else len(hosts)
    shares = [
        Share(number % turns, options.each * turns, options.case)
        for number in range(len(hosts))
    ]
    make = partial(running.plan, job, seed=options.seed, modules=modules)
    return list(pool.map(make, hosts, shares))


def run_faults(
    pool: Executor, hosts: Sequence[Host], options: argparse.Namespace
) -> bool:
    """All commands; prints as it goes. Whether all was survived."""
    began = time.monotonic()
    heads = "".join(f"{end:>11}" for end in _ENDS)
    show("Faults: ended as; worst penetration beyond a good run's / margin, mm")
    show(f"{'':30}{'runs':>6}{'survived':>10}{heads}")
    named = MORE_JOBS if options.more else JOBS
    named = DOCK_JOBS if options.docks else named
    jobs = [job for job in named if options.job in job]
    plans: dict[str, list[Plan]] = {}
    if options.pairs:
        every_one = [
            one for job in jobs for one in planned(pool, hosts, options, job)
        ]
        singles = [one.cases for one in every_one]
        drawn = faults.pairs(
            singles, options.pairs, options.seed, options.after
        )
        for one, cases in zip(every_one, drawn):
            job = one.good.expected.job.name
            plans.setdefault(job, []).append(one._replace(cases=cases))
    about = {
        "hosts": [host.name for host in hosts],
        "seed": options.seed,
        "each": options.each,
    }
    table = []
    for job in jobs:
        done = running.go_faults(
            pool, plans[job] if plans else planned(pool, hosts, options, job)
        )
        if not done:
            continue
        table.append(running.figures(job, done))
        show(row(table[-1]))
        for text in table[-1]["agreed"]:
            show(f"  both touches wrong alike: {text}")
        for one in table[-1]["blind"]:
            show(f"  both sensors dead: {one['case']} on {one['host']}:")
            depths = depths_text(job, one["depths"])
            show(f"    {one['reason'] or one['ended']}; {depths}")
        for one in done:
            tell(one, options.folder)
        # A run that is broken off leaves what it has found
        about["minutes"] = (time.monotonic() - began) / 60.0
        write_faults(options, about, table)
    runs = sum(found["runs"] for found in table)
    survived = sum(found["survived"] for found in table)
    minutes = (time.monotonic() - began) / 60.0
    show(
        f"\n{survived} of {runs} faults survived; seed {options.seed},"
        f" {minutes:.1f} min"
    )
    return survived == runs > 0


def write_faults(
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
    found = {"about": about, "faults": list(table)}
    if options.docks:
        report["docks"] = found
    elif options.pairs:
        report["after" if options.after else "pairs"] = found
    else:
        report.update(found)
    options.json.write_text(json.dumps(report, indent=1) + "\n")


# Any order of commands


def run_walks(
    pool: Executor, hosts: Sequence[Host], options: argparse.Namespace
) -> bool:
    """All seeds; prints what does harm as it goes. Whether nothing did."""
    began = time.monotonic()
    seeds = range(options.seed, options.seed + options.count)
    hosts_in_turn = [hosts[seed % len(hosts)] for seed in seeds]
    go = partial(running.go_drawn, modules=running.modules_of(options.product))
    report = Report()
    for done in pool.map(go, seeds, hosts_in_turn):
        report.add(done)
        tell(done, options.folder)
    minutes = (time.monotonic() - began) / 60.0
    show(report.text())
    show(f"seeds {seeds.start} to {seeds.stop - 1}, {minutes:.1f} min")
    if options.json:
        ends = [seeds.start, seeds.stop - 1]
        figures = {"hosts": [host.name for host in hosts], "seeds": ends}
        figures.update(report.figures())
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return not report.harmed


# The command line


def parse(arguments: Optional[Sequence[str]]) -> argparse.Namespace:
    """The command line."""
    both = argparse.ArgumentParser(add_help=False)
    both.add_argument("--host", default="", help="part of the hosts' names")
    both.add_argument("--workers", type=int, default=2)
    both.add_argument("--product", type=Path, help="another checkout's modules")
    both.add_argument("--json", type=Path, help="write the figures there")
    both.add_argument("--folder", type=Path, default=Path("build/walks"))
    both.add_argument("--replay", type=Path, metavar="FILE")
    parser = argparse.ArgumentParser(
        prog="python -m tools.campaign",
        description="Walks on simulated printers, the world as the judge.",
    )
    commands = parser.add_subparsers(dest="command", required=True)
    one = commands.add_parser(
        "faults", parents=[both], help="every fault at every operation"
    )
    one.set_defaults(run=run_faults)
    one.add_argument("--job", default="", help="part of a command's name")
    one.add_argument("--case", default="", help="part of a case's text")
    one.add_argument("--seed", type=int, default=0, help="of all noise")
    one.add_argument(
        "--each", type=int, default=1, metavar="N", help="one of N cases only"
    )
    one.add_argument(
        "--pairs", type=int, default=0, help="two faults at a time, so often"
    )
    one.add_argument(
        "--after",
        action="store_true",
        help="of two the second in the next run, when the first is mended",
    )
    one.add_argument(
        "--docks", action="store_true", help="faults on each kind of dock"
    )
    one.add_argument(
        "--more",
        action="store_true",
        help="the commands that wait or heat instead of the others",
    )
    one = commands.add_parser(
        "walks", parents=[both], help="any order of commands on any printer"
    )
    one.set_defaults(run=run_walks)
    one.add_argument("--count", type=int, default=200, help="of walks")
    one.add_argument("--seed", type=int, default=1, help="of the first one")
    return parser.parse_args(arguments)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run it all; the exit code is 0 if nothing was harmed."""
    options = parse(arguments)
    hosts = [host for host in find_hosts() if options.host in host.name]
    if not hosts:
        sys.exit(f"no host is named like {options.host!r}")
    show(f"hosts: {', '.join(host.name for host in hosts)}")
    if options.replay:
        modules = running.modules_of(options.product)
        outcome = running.replay(options.replay, hosts[0], modules, show)
        show(outcome.harm or "nothing was harmed")
        return 1 if outcome.harm else 0
    # What a worker has imported must not be forked
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        return 0 if options.run(pool, hosts, options) else 1


if __name__ == "__main__":
    sys.exit(main())
