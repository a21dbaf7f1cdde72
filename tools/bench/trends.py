"""What the report finds in many runs: drifts and changes, true ones and false ones.

    python -m tools.bench.trends [--printers N]

Printers at random, without klippy, 500 runs each, and after each tenth run what a report
would say. One line for each kind of printer: on how many printers a report has ever
told a drift, a spread that has grown, a change, and how many changes the last report
has.
"""

from __future__ import annotations

import argparse
import random
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from typing import NamedTuple

from tools.kit.product import trend
from tools.kit.runs import make_run, read

RUNS = 500
EVENT = 200
# Runs between two reports
LOOK = 10
NEW_NOZZLE = -0.21
# Of each touch and of homing, mm
NOISE = 0.003


class Story(NamedTuple):
    """Its name, and options(draw, number) of make_run."""

    name: str
    options: Callable[[random.Random, int], dict]


def nothing(_draw: random.Random, _number: int) -> dict:
    return {}


def after(moved: dict) -> Callable[[random.Random, int], dict]:
    """From the run EVENT on sites are elsewhere."""

    def options(_draw: random.Random, number: int) -> dict:
        return {"moved": moved if number >= EVENT else {}}

    return options


def plates(block: int, apart: float) -> Callable[[random.Random, int], dict]:
    """Two plates in turn, so many runs each on average."""
    on = [0]

    def options(draw: random.Random, number: int) -> dict:
        if number == 0:
            on[0] = 0
        on[0] ^= draw.random() < 1.0 / block
        return {"moved": {"bed": apart * on[0]}}

    return options


def many(draw: random.Random, number: int) -> dict:
    """Each of these once."""
    moved = dict.fromkeys(("nozzle", "switch", "bed"), 0.0)
    for begin, sites, by in (
        (80, ("nozzle", "switch", "bed"), -0.25),
        (200, ("bed",), 0.03),
        (320, ("nozzle",), NEW_NOZZLE),
    ):
        for site in sites:
            moved[site] += by * (number >= begin)
    return {"moved": moved}


def both(draw: random.Random, number: int) -> dict:
    """Two plates at random, another nozzle each hundredth run."""
    nozzle = 0.1 * (number // 100 % 2)
    return {"moved": {"nozzle": nozzle, "bed": 0.03 * draw.randrange(2)}}


def drift(_draw: random.Random, number: int) -> dict:
    """10 um in a hundred runs."""
    late = max(number - EVENT, 0)
    return {"moved": {"switch": 1e-4 * min(late, 100)}}


def growth(_draw: random.Random, number: int) -> dict:
    """From 2 to 8 um."""
    return {"worn": {"bed": 0.002 + 0.006 * number / RUNS}}


ALL = dict.fromkeys(("nozzle", "switch", "bed"), -0.25)
STORIES = (
    Story("nothing", nothing),
    Story("position_endstop - 0.25", after(ALL)),
    Story("position_endstop - 0.03", after(dict.fromkeys(ALL, -0.03))),
    Story("another nozzle, 0.21", after({"nozzle": NEW_NOZZLE})),
    Story("another nozzle, 0.015", after({"nozzle": -0.015})),
    Story("another plate, 0.05", after({"bed": 0.05})),
    Story("another plate, 0.01", after({"bed": 0.01})),
    Story("two plates, run by run", plates(2, 0.04)),
    Story("two plates, 3 runs each", plates(3, 0.04)),
    Story("two plates, 10 runs each", plates(10, 0.04)),
    Story("two plates, 30 runs each", plates(30, 0.04)),
    Story("two plates, 5 runs, 0.01", plates(5, 0.01)),
    Story("nozzle and plate as often", both),
    Story("all of it, one by one", many),
    Story("drift of 0.01", drift),
    Story("noise from 2 to 8 um", growth),
)


class Told(NamedTuple):
    """Numbers of runs, and what a report has told then; the changes of the last one."""

    drifts: list
    spreads: list
    changes: list
    last: list


def live(story: str, seed: int) -> Told:
    """One printer."""
    (options,) = [s.options for s in STORIES if s.name == story]
    draw = random.Random(f"{story}/{NOISE}/{seed}")
    told, known = Told([], [], [], []), []
    for number in range(RUNS):
        given = {"noise": NOISE, "homing": NOISE, "touches": 3}
        given.update(options(draw, number))
        known += read([make_run(draw, **given)])
        if number % LOOK != LOOK - 1:
            continue
        told.drifts.extend((number, d.height) for d in trend.drifts(known))
        told.spreads.extend((number, g.site) for g in trend.growths(known))
        told.last[:] = trend.changes(known)
        told.changes.extend(
            (number, change.height, round(change.by, 4)) for change in told.last
        )
    return told


def main(words: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.trends")
    parser.add_argument("--printers", type=int, default=20)
    given = parser.parse_args(words)
    with ProcessPoolExecutor(2) as pool:
        for story in STORIES:
            one = partial(live, story.name)
            found = list(pool.map(one, range(given.printers)))
            drifts, spreads, changes, _ = (
                sum(bool(getattr(told, kind)) for told in found)
                for kind in Told._fields
            )
            firsts = sorted(t.drifts[0][0] - EVENT for t in found if t.drifts)
            last = [len(told.last) for told in found]
            sys.stdout.write(
                f"{story.name:28} drifts {drifts:3} {firsts} spreads {spreads:3}"
                f" changes {changes:3}, {last} in the last report\n"
            )
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
