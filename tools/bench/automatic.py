"""How exact and how quick CALIBRATE_Z is with samples: auto.

    python -m tools.bench.automatic [--seeds N] [--host NAME] [--case NAME]
        [--json FILE]

Each seed is another printer of the voron scene, as in tools/bench/errors.py,
at the speeds of make bench, with a history of ten runs at the noise of its
switches, of as many touches as such runs have: more in the first two, before
anything is known. Besides, some have no history.
For each condition: mean, standard deviation and worst of the error of the true
gap (um), how many of the gaps were inside the uncertainty that was told,
seconds of the command, how many times the lower bound that is, touches that
count, and refusals. The exit code is 1 where a bound is not kept.

The bound is that of tools/bench/lower_bounds.py for so many touches, and with what
a host needs after each armed move.
"""

from __future__ import annotations

import argparse
import json
import math
import random
import re
import statistics
import sys
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple, Optional

from simprinter import Scene
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError
from simprinter.running import show
from simprinter.world import NoiseSpec, TextureSpec
from tools.bench.commands import STANDARD, calibrate_plan
from tools.bench.errors import UM, Condition, make_scene
from tools.bench.lower_bounds import lower_bound
from tools.kit.printer import Printer, choose_host
from tools.kit.product import statistics as module_statistics
from tools.kit.runs import make_run
from tools.kit.scenes import SCENES

HISTORY = 10
# As long as nothing is known of a site it is touched more often
FIRST = 2
# A host begins the next move so long (s) after an armed one has ended without a
# trigger (BUFFER_TIME_START of toolhead.py), or, within the same one, before all of
# that is sent (DRIP_TIME), and after a trigger, as it has asked the board meanwhile and
# has flushed ahead (BGFLUSH_HIGH_TIME of motion_queuing.py)
AFTER_WAY = 0.25
WITHIN_WAY = 0.15
AFTER_TOUCH = 0.4
TOUCHED = re.compile(r"z_calibration: (\w+) at z=\S+ \((\d+) touch")
WORTH = re.compile(r"Z-CALIBRATION: offset \S+ \+-(\S+) mm")


class Case(NamedTuple):
    """A condition, and what is to be kept under it; mm, um and seconds.

    touches: of each site in the runs of its history. outliers: chance and size
    of an outlier. spread: bed_spread on a textured plate, another one for each
    seed. known: whether there is a history. sigma, worst: of the error;
    seconds, ratio: on average.
    """

    name: str
    noise: float
    touches: int = 2
    samples: str = "auto"
    target: str = "0.008"
    outliers: tuple[float, float] = (0.0, 0.0)
    spread: Optional[str] = None
    known: bool = True
    sigma: Optional[float] = None
    worst: Optional[float] = None
    seconds: Optional[float] = None
    ratio: Optional[float] = None


CASES = (
    Case("3 um, three samples", 3.0, 3, "3"),
    Case("3 um", 3.0, sigma=4.0, seconds=15.0, ratio=1.15),
    Case(
        *("3 um, no history", 3.0),
        known=False,
        sigma=4.0,
        seconds=19.0,
        ratio=1.15,
    ),
    Case("3 um, target 0.005", 3.0, 5, target="0.005", sigma=2.6, seconds=44.0),
    Case("10 um", 10.0, 10, sigma=6.5),
    Case("3 um, texture", 3.0, spread="0"),
    Case("3 um, bed_spread 3", 3.0, 6, spread="3", target="0.013", sigma=7.0),
    Case("3 um, 1 % of 50 um", 3.0, outliers=(0.01, 0.05), worst=15.0),
)


class Trial(NamedTuple):
    """One printer: um, um and s; an error of None: refused."""

    error: Optional[float]
    worth: float = 0.0
    seconds: float = 0.0
    touches: int = 0
    bound: float = 1.0


def run_trial(host: Host, case: Case, seed: int) -> Trial:
    """One calibration of one printer that was homed."""
    scene = make_scene(SCENES["voron"], Condition(case.noise), seed)
    noise = NoiseSpec(case.noise / UM, *case.outliers)
    scene = scene.with_world(
        pin=replace(scene.world.pin, noise=noise),
        mag_probe=replace(scene.world.mag_probe, noise=noise),
    )
    options = {**STANDARD["z_calibration"], "samples": case.samples}
    if case.spread is not None:
        bed = replace(scene.world.bed, texture=TextureSpec(seed=seed))
        scene = scene.with_world(bed=bed)
        options["bed_spread"] = case.spread
    if case.samples == "auto":
        options["target_uncertainty"] = case.target
    with TemporaryDirectory() as folder:
        if case.known:
            write_history(Path(folder), scene, case, seed)
        options["history"] = folder
        changes = {**STANDARD, "z_calibration": options}
        with Printer(host, scene, changes, seed=seed) as printer:
            printer.homed()
            return measure(printer)


def write_history(folder: Path, scene: Scene, case: Case, seed: int) -> None:
    """As ten runs of this printer would have left it."""
    noise = case.noise / UM
    draw = random.Random(seed)
    is_spread = case.spread not in (None, "0")
    worn = {"bed": math.hypot(noise, TextureSpec.sigma)} if is_spread else {}
    counts = [module_statistics.LEAST_AT_FIRST] * FIRST + [case.touches] * (
        HISTORY - FIRST
    )
    runs = [
        make_run(
            draw,
            noise,
            touches=max(count, case.touches),
            worn=worn,
            moved=moved(scene),
            bed_spread=float(case.spread or 0.0),
        )
        for count in counts
    ]
    lines = "".join(json.dumps(run) + "\n" for run in runs)
    (folder / "printer.jsonl").write_text(lines)


def moved(scene: Scene) -> dict[str, float]:
    """By how much (mm) its heights are others than those of the drawn runs.

    Toolhead Z: homed on the pin, so that a higher one lowers the bed.
    """
    usual, world = SCENES["voron"].world, scene.world
    drop = world.mag_probe.body_drop - usual.mag_probe.body_drop
    rise = world.bed.z0 - usual.bed.z0 - (world.pin.z - usual.pin.z)
    return {"switch": drop, "bed": drop + rise}


def measure(printer: Printer) -> Trial:
    """What a calibration leaves."""
    clock = printer.machine.simulation.clock
    printer.session.wait(2.0)
    began, start = clock.now(), printer.session.position()
    try:
        lines = printer.run("CALIBRATE_Z\nM400")
    except GcodeError:
        return Trial(None)
    seconds = (clock.now() - began) * 1e-9
    error = printer.gap() - printer.scene.formula_gap()
    worth = [m for m in map(WORTH.search, lines) if m]
    counts = {m[1]: int(m[2]) for m in map(TOUCHED.search, lines) if m}
    told = float(worth[0][1]) * UM
    bound = bound_of(printer.scene, counts, start)
    return Trial(error * UM, told, seconds, sum(counts.values()), bound)


def bound_of(
    scene: Scene, counts: Mapping[str, int], start: tuple[float, float, float]
) -> float:
    """Seconds that so many touches of each site take at least."""
    plan = calibrate_plan(scene, STANDARD)
    stops = [stop._replace(samples=counts[stop.name]) for stop in plan.stops]
    plan = plan._replace(stops=tuple(stops))
    x, y, z = (round(value, 3) for value in start)
    moves = lower_bound(plan, (x, y, z))
    # The way down of each site is armed, too, to the pin in one move with a touch
    waits = AFTER_WAY + WITHIN_WAY * (len(stops) - 1)
    waits += AFTER_TOUCH * sum(counts.values())
    return moves + waits


class Figures(NamedTuple):
    """What came of a case.

    um: mean, sigma and worst of the error; inside: share of the gaps that were within
    the uncertainty that was told. seconds, ratio, touches: on average.
    """

    name: str
    printers: int
    refused: int
    mean: float
    sigma: float
    worst: float
    inside: float
    seconds: float
    ratio: float
    touches: float


def figures(case: Case, trials: Sequence[Trial]) -> Figures:
    """Of all printers that were not refused."""
    good = [trial for trial in trials if trial.error is not None]
    errors = [trial.error for trial in good]
    inside = sum(abs(t.error) <= t.worth + 0.5 for t in good)
    return Figures(
        name=case.name,
        printers=len(trials),
        refused=len(trials) - len(good),
        mean=statistics.mean(errors),
        sigma=statistics.stdev(errors),
        worst=max(errors, key=abs),
        inside=inside / len(good),
        seconds=statistics.mean(trial.seconds for trial in good),
        ratio=statistics.mean(trial.seconds / trial.bound for trial in good),
        touches=statistics.mean(trial.touches for trial in good),
    )


def rows(case: Case, found: Figures) -> Iterator[str]:
    """The figures, then each bound that is not kept."""
    yield (
        f"{case.name:22} mean {found.mean:+5.1f}  sd {found.sigma:5.2f}"
        f"  worst {found.worst:+6.1f}  inside {found.inside:4.0%}"
        f"  {found.seconds:5.1f} s  {found.ratio:4.2f} x"
        f"  {found.touches:4.1f} touches  {found.refused} refused"
    )
    for name, value, bound in (
        ("sd", found.sigma, case.sigma),
        ("worst", abs(found.worst), case.worst),
        ("seconds", found.seconds, case.seconds),
        ("ratio", found.ratio, case.ratio),
        ("refused", found.refused, 0),
    ):
        if bound is not None and value > bound:
            yield f"    NOT KEPT: {name} {value:.2f}, at most {bound:g}"


def main(words: Sequence[str]) -> int:
    """Print the table; return the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.automatic")
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--host", metavar="NAME", help="klippy to run")
    parser.add_argument("--case", default="", help="part of its name")
    parser.add_argument("--json", type=Path, help="write the figures there")
    given = parser.parse_args(words)
    host = choose_host(given.host)
    cases = [case for case in CASES if given.case in case.name]
    show(f"{host.name}, {given.seeds} printers, um and seconds")
    is_kept, done = True, []
    with ProcessPoolExecutor(2) as pool:
        for case in cases:
            work = partial(run_trial, host, case)
            trials = list(pool.map(work, range(given.seeds)))
            done.append(figures(case, trials))
            for row in rows(case, done[-1]):
                show(row)
                is_kept &= "NOT KEPT" not in row
    if given.json:
        cases = [one._asdict() for one in done]
        about = {"host": host.name, "cases": cases}
        given.json.write_text(json.dumps(about, indent=1) + "\n")
    return 0 if is_kept else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
