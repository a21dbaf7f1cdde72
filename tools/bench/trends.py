"""What is told of many runs: how many drifts and changes, true ones and false ones.

    python -m tools.bench.trends [--printers N] [--noise UM]

Printers at random, without klippy, 500 runs each, and after each run what the module
would say. One line for each kind of printer: alarms of drift and of a spread that
has grown, and changes that are told, of all printers together; with --all each of them.
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
from tools.kit.runs import make_run

RUNS = 500
EVENT = 200
NEW_NOZZLE = -0.21


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


def plates(
    block: int, apart: float, *, named: bool = False
) -> Callable[[random.Random, int], dict]:
    """Two plates in turn, so many runs each on average."""
    on = [0]

    def options(draw: random.Random, number: int) -> dict:
        if number == 0:
            on[0] = 0
        on[0] ^= draw.random() < 1.0 / block
        plate = {"plate": "AB"[on[0]]} if named else {}
        return {"moved": {"bed": apart * on[0]}, **plate}

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


def drifting_plates(draw: random.Random, number: int) -> dict:
    """The same with two plates that have names."""
    plate = draw.randrange(2)
    late = max(number - EVENT, 0)
    moved = {"switch": 1e-4 * min(late, 200), "bed": 0.04 * plate}
    return {"moved": moved, "plate": "AB"[plate]}


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
    Story("two plates with PLATE", plates(10, 0.04, named=True)),
    Story("all of it, one by one", many),
    Story("drift of 0.01", drift),
    Story("drift, two named plates", drifting_plates),
    Story("noise from 2 to 8 um", growth),
)


class Told(NamedTuple):
    """Numbers of runs, and what was told with them."""

    drifts: list
    spreads: list
    changes: list


def live(story: str, noise: float, homing: float, seed: int) -> Told:
    """One printer."""
    (options,) = [s.options for s in STORIES if s.name == story]
    draw = random.Random(f"{story}/{noise}/{seed}")
    told, runs = Told([], [], []), []
    for number in range(RUNS):
        given = {"noise": noise, "homing": homing, "touches": 3}
        given.update(options(draw, number))
        runs.append(make_run(draw, **given))
        found = trend.find(runs)
        runs[-1].update(wear=found.wear, changed=found.changed)
        for name in found.wear:
            kind = told.spreads if "spread" in name else told.drifts
            kind.append((number, name))
        for change in found.changed:
            if change["told"]:
                told.changes.append((number, change["what"], change["by"]))
    return told


def main(words: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.trends")
    parser.add_argument("--printers", type=int, default=20)
    parser.add_argument("--noise", type=float, default=3.0)
    parser.add_argument("--homing", type=float, default=3.0)
    parser.add_argument("--only", default="")
    parser.add_argument("--all", action="store_true")
    given = parser.parse_args(words)
    with ProcessPoolExecutor(2) as pool:
        for story in STORIES:
            if given.only not in story.name:
                continue
            one = partial(
                live, story.name, given.noise / 1000, given.homing / 1000
            )
            found = list(pool.map(one, range(given.printers)))
            counts = [
                sum(len(getattr(told, kind)) for told in found)
                for kind in Told._fields
            ]
            sys.stdout.write(
                f"{story.name:28} drifts {counts[0]:4} spreads {counts[1]:4}"
                f" changes {counts[2]:4}\n"
            )
            if given.all:
                for told in found:
                    sys.stdout.write(f"    {told}\n")
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
