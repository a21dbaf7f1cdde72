"""How exact and how quick CALIBRATE_Z is with samples: auto.

    python -m tools.bench.automatic [--seeds N] [--host NAME]

Each seed is another printer of the voron scene, as in tools/bench/errors.py,
with a history of ten runs at the noise of its switches, of as many touches as
such runs have: more in the first two, before anything is known.
For each condition: mean, standard deviation and worst of the error of the true
gap (um), how many of the gaps were inside the uncertainty that was told,
seconds of the command, touches that count, and refusals. The exit code is 1
where a bound is not kept.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import re
import statistics
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, Optional

from simprinter import SCENES
from simprinter.hosts.hosts import Host, find_hosts
from simprinter.hosts.session import GcodeError
from simprinter.world import NoiseSpec, TextureSpec
from tests.unit.runs import make_run
from tools.bench.errors import UM, Condition, make_scene
from tools.kit.printer import Printer
from z_touch.uncertainty.adaptive import LEAST_AT_FIRST

HISTORY = 10
# As long as nothing is known of a site it is touched more often
FIRST = 2
WORTH = re.compile(r"new offset=\S+ \+-(\S+)")


class Case(NamedTuple):
    """A condition, and what is to be kept under it; mm, um and seconds.

    touches: of each site in the runs of its history. outliers: chance and size
    of an outlier. spread: bed_spread on a textured plate, another one for each
    seed. sigma, worst: of the error; seconds: on average.
    """

    name: str
    noise: float
    touches: int = 2
    samples: str = "auto"
    target: str = "0.008"
    outliers: tuple[float, float] = (0.0, 0.0)
    spread: Optional[str] = None
    sigma: Optional[float] = None
    worst: Optional[float] = None
    seconds: Optional[float] = None


CASES = (
    Case("3 um, three samples", 3.0, 3, "3"),
    Case("3 um", 3.0, sigma=4.0, seconds=20.5),
    Case("3 um, target 0.005", 3.0, 5, target="0.005", sigma=2.6, seconds=44.0),
    Case("10 um", 10.0, 10, sigma=6.5),
    Case("3 um, texture", 3.0, spread="0"),
    Case("3 um, bed_spread 3", 3.0, 6, spread="3", target="0.014", sigma=7.0),
    Case("3 um, 1 % of 50 um", 3.0, outliers=(0.01, 0.05), worst=15.0),
)


class Trial(NamedTuple):
    """One printer: um, um and s; an error of None: refused."""

    error: Optional[float]
    worth: float = 0.0
    seconds: float = 0.0
    touches: int = 0


def run_trial(host: Host, case: Case, seed: int) -> Trial:
    """One calibration of one printer that was homed."""
    scene = make_scene(SCENES["voron"], Condition(case.noise), seed)
    noise = NoiseSpec(case.noise / UM, *case.outliers)
    scene = scene.with_world(
        pin=replace(scene.world.pin, noise=noise),
        mag_probe=replace(scene.world.mag_probe, noise=noise),
    )
    options = {"samples": case.samples}
    if case.spread is not None:
        bed = replace(scene.world.bed, texture=TextureSpec(seed=seed))
        scene = scene.with_world(bed=bed)
        options["bed_spread"] = case.spread
    if case.samples == "auto":
        options["target_uncertainty"] = case.target
    with TemporaryDirectory() as folder:
        write_history(Path(folder), case, seed)
        options["history"] = folder
        with Printer(
            host, scene, {"z_calibration": options}, seed=seed
        ) as printer:
            printer.homed()
            return measure(printer)


def write_history(folder: Path, case: Case, seed: int) -> None:
    """As ten runs would have left it."""
    noise = case.noise / UM
    draw = random.Random(seed)
    is_spread = case.spread not in (None, "0")
    worn = {"bed": math.hypot(noise, TextureSpec.sigma)} if is_spread else {}
    counts = [LEAST_AT_FIRST] * FIRST + [case.touches] * (HISTORY - FIRST)
    runs = [
        make_run(draw, noise, touches=max(count, case.touches), worn=worn)
        for count in counts
    ]
    lines = "".join(json.dumps(run) + "\n" for run in runs)
    (folder / "history.jsonl").write_text(lines)


def measure(printer: Printer) -> Trial:
    """What a calibration leaves."""
    clock = printer.machine.simulation.clock
    printer.session.wait(2.0)
    began = clock.now()
    try:
        lines = printer.run("CALIBRATE_Z\nM400")
    except GcodeError:
        return Trial(None)
    seconds = (clock.now() - began) * 1e-9
    error = printer.gap() - printer.scene.formula_gap()
    worth = [m for m in map(WORTH.search, lines) if m]
    count = sum("touched at z=" in line for line in lines)
    return Trial(error * UM, float(worth[0][1]) * UM, seconds, count)


def rows(case: Case, trials: Sequence[Trial]) -> Iterator[str]:
    """The figures, then each bound that is not kept."""
    good = [trial for trial in trials if trial.error is not None]
    errors = [trial.error for trial in good]
    seconds = statistics.mean(trial.seconds for trial in good)
    sigma, worst = statistics.stdev(errors), max(errors, key=abs)
    inside = sum(abs(t.error) <= t.worth + 0.5 for t in good) / len(good)
    touches = statistics.mean(trial.touches for trial in good)
    yield (
        f"{case.name:22} mean {statistics.mean(errors):+5.1f}  sd {sigma:5.2f}"
        f"  worst {worst:+6.1f}  inside {inside:4.0%}  {seconds:5.1f} s"
        f"  {touches:4.1f} touches  {len(trials) - len(good)} refused"
    )
    for name, value, bound in (
        ("sd", sigma, case.sigma),
        ("worst", abs(worst), case.worst),
        ("seconds", seconds, case.seconds),
        ("refused", len(trials) - len(good), 0),
    ):
        if bound is not None and value > bound:
            yield f"    NOT KEPT: {name} {value:.2f}, at most {bound:g}"


def tell(line: str) -> None:
    """A line of the table, at once."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def main(words: Sequence[str]) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.automatic")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--host", default="", help="part of its name")
    given = parser.parse_args(words)
    (host, *_) = [h for h in reversed(find_hosts()) if given.host in h.name]
    tell(f"{host.name}, {given.seeds} printers, um and seconds")
    is_kept = True
    with ProcessPoolExecutor(2) as pool:
        for case in CASES:
            work = partial(run_trial, host, case)
            for row in rows(case, list(pool.map(work, range(given.seeds)))):
                tell(row)
                is_kept &= "NOT KEPT" not in row
    return 0 if is_kept else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
