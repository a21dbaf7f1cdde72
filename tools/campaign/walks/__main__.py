"""Random walks: make walks.

    python -m tools.campaign.walks [--count N] [--seed N] [--host NAME]
        [--base NAME] [--product DIR] [--against DIR] [--json FILE]
        [--replay FILE]

A walk is a drawn printer, and 5 to 30 steps of what owners, Klipper and another
client do, and hands. After each step the simulated world judges: nothing is hit
or pressed, no internal error, no shutdown, no hang, nothing left behind by a
refusal, and the gap is right or a warning says why not. One that fails is made
as short as it gets, and written to FOLDER/SEED.json with its printer.cfg;
--replay goes it again, and shows the console.

--product: with the modules of another checkout. --against: a walk with refusals
is gone on that checkout's modules, too; what they do not refuse is told.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Optional

from simprinter.hosts.hosts import Host, find_hosts
from tools.campaign.walks import walking
from tools.campaign.walks.machines import BASES
from tools.campaign.walks.walking import Report


def say(text: str) -> None:
    """A line for people, at once."""
    print(text, flush=True)


def parse(arguments: Optional[Sequence[str]]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tools.campaign.walks",
        description="Any order of commands on any printer, on real klippies.",
    )
    parser.add_argument("--count", type=int, default=200, help="of walks")
    parser.add_argument("--seed", type=int, default=1, help="of the first one")
    parser.add_argument("--host", default="", help="part of the hosts' names")
    parser.add_argument("--base", choices=sorted(BASES), help="of the machines")
    parser.add_argument(
        "--product", type=Path, help="another checkout's modules"
    )
    parser.add_argument(
        "--against",
        type=Path,
        help="tell what another checkout does not refuse",
    )
    parser.add_argument("--simpler", type=int, default=walking.SIMPLER)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--folder", type=Path, default=Path("build/walks"))
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--replay", type=Path, metavar="FILE")
    return parser.parse_args(arguments)


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """The exit code is 0 if nothing was harmed."""
    options = parse(arguments)
    hosts = [host for host in find_hosts() if options.host in host.name]
    if not hosts:
        sys.exit(f"no host is named like {options.host!r}")
    modules = walking.modules_of(options.product)
    if options.replay:
        outcome = walking.replay(options.replay, hosts[0], modules, say)
        say(outcome.harm or "nothing was harmed")
        return 1 if outcome.harm else 0
    began = time.monotonic()
    seeds = range(options.seed, options.seed + options.count)
    hosts_in_turn: list[Host] = [hosts[seed % len(hosts)] for seed in seeds]
    go = partial(
        walking.walk_of,
        bases=(options.base,) if options.base else (),
        modules=modules,
        simpler=options.simpler,
        against=walking.modules_of(options.against),
    )
    report = Report()
    # What a worker has imported must not be forked
    with ProcessPoolExecutor(options.workers, get_context("spawn")) as pool:
        for done in pool.map(go, seeds, hosts_in_turn):
            report.add(done)
            told = done.outcome.harm
            if done.alone:
                told = told or f"only this product: {done.alone}"
            if told:
                file = walking.write(done, options.folder)
                say(f"{told}\n    --replay {file} --host {done.host}")
    minutes = (time.monotonic() - began) / 60.0
    say(report.text())
    say(f"seeds {seeds.start} to {seeds.stop - 1}, {minutes:.1f} min")
    if options.json:
        ends = [seeds.start, seeds.stop - 1]
        figures = {"hosts": [host.name for host in hosts], "seeds": ends}
        figures.update(report.figures())
        options.json.write_text(json.dumps(figures, indent=1) + "\n")
    return 1 if report.harmed else 0


if __name__ == "__main__":
    sys.exit(main())
