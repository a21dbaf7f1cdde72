"""How long a calibration takes, next to the least that it could take.

    python -m tests.bench_calibration [--host NAME] [--module FILE]
        [--builtin] [--json FILE]

runs CALIBRATE_Z on the standard machine of every host: right after G28, again
in the same frame, and after another G28. It prints printer seconds, the lower
bound, the ratio of both, the recorded samples and all touches; then what each
lower bound consists of. The times are of the simulated printer, not of this
machine. --module measures another z_calibration.py in the same run, --builtin
the one a host ships itself, and prints ours / theirs. One that does not run
on a host is no failure of the benchmark; the line says why.

The lower bound is what no module can do without at the configured speeds: at
each site the way up to the travel height and across (not where the head is
there already), down at probing_speed to where the samples begin, the samples
with the lifts between them, and a last lift. It knows the true heights and
accelerations, but nothing of what a host needs to stop, ask or plan.
"""

from __future__ import annotations

import argparse
import configparser
import json
import math
import re
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Optional, Union

from tests.hostkit.api import ApiError
from tests.hostkit.hosts import Host, HostError, find_hosts
from tests.hostkit.printer import Printer, module_files
from tests.hostkit.session import GcodeError, SessionError
from tests.simprinter import SCENES, Scene
from tests.simprinter.scenes import Sections
from tests.simprinter.simulation import SimulationError
from tests.simprinter.world.bed import Bed
from tests.simprinter.world.truth import CrashError

SCENE = SCENES["voron"]
STANDARD: Sections = {
    "z_calibration": {
        "safe_z_height": "15",
        "probing_second_speed": "2",
        "probing_retract_dist": "2",
        "samples": "3",
    },
    "probe": {"samples": "3", "speed": "5", "lift_speed": "10"},
}

# Name of a run, and what is done before it
RUNS = (("after G28", "G28"), ("again", ""), ("after G28 again", "G28"))

# The sites of a calibration, as the truth calls them
SITES = ("nozzle_pin", "body_pin", "probe_bed")

# How modules say that they have recorded a sample: ours; others, whose words
# for it are the host's own for any touch.
RECORDED = (
    re.compile(r"z_calibration: \w+: touched at z="),
    re.compile(r"probe at \S+ is z="),
)


# Lower bound


class Limits(NamedTuple):
    """What the axes can do, mm/s and mm/s^2."""

    velocity: float
    accel: float
    z_velocity: float
    z_accel: float


class Stop(NamedTuple):
    """A site: where the head stands (mm), where it triggers, how often."""

    name: str
    x: float
    y: float
    trigger_z: float
    samples: int
    speed: float
    retract: float
    lift_speed: float


class Plan(NamedTuple):
    """What a calibration has to do, in the frame of the configuration."""

    stops: Sequence[Stop]
    travel_z: float
    travel_speed: float
    approach_speed: float
    limits: Limits


class Part(NamedTuple):
    """Seconds of the lower bound: at a site, for one purpose."""

    site: str
    what: str
    seconds: float


PURPOSES = ("lift", "travel", "approach", "samples", "retracts")


def move_seconds(
    distance: float, speed: float, accel: float, stops: bool = True
) -> float:
    """Shortest time of a move from rest, mm and s.

    stops: at rest again at its end; a touch ends at full speed.
    """
    ramps = 2 if stops else 1
    if distance < ramps * speed * speed / (2.0 * accel):
        # Never at full speed
        return ramps * math.sqrt(2.0 * distance / (ramps * accel))
    return distance / speed + ramps * speed / (2.0 * accel)


def lower_bound(
    plan: Plan, start: tuple[float, float, float]
) -> tuple[Part, ...]:
    """The moves that no calibration from `start` (mm) can do without."""
    limits = plan.limits
    x, y, z = start
    parts = []
    for stop in plan.stops:
        away = math.hypot(stop.x - x, stop.y - y)
        up = max(0.0, plan.travel_z - z) if away else 0.0
        top = stop.trigger_z + stop.retract
        down = max(
            0.0, (plan.travel_z if away else min(z, plan.travel_z)) - top
        )
        seconds = (
            _z_seconds(limits, up, stop.lift_speed),
            move_seconds(
                away, min(plan.travel_speed, limits.velocity), limits.accel
            ),
            _z_seconds(limits, down, plan.approach_speed),
            stop.samples
            * _z_seconds(limits, stop.retract, stop.speed, stops=False),
            (stop.samples - 1)
            * _z_seconds(limits, stop.retract, stop.lift_speed),
        )
        parts += [Part(stop.name, *part) for part in zip(PURPOSES, seconds)]
        x, y, z = stop.x, stop.y, stop.trigger_z
    up = max(0.0, plan.travel_z - z)
    last = _z_seconds(limits, up, plan.stops[-1].lift_speed)
    return (*parts, Part("end", "lift", last))


def _z_seconds(
    limits: Limits, distance: float, speed: float, stops: bool = True
) -> float:
    speed = min(speed, limits.z_velocity)
    return move_seconds(distance, speed, limits.z_accel, stops)


def make_plan(scene: Scene, changes: Sections) -> Plan:
    """What a scene's configuration and its true heights ask for.

    Of the options with a default, the standard machine's are understood.
    """
    config = configparser.ConfigParser(delimiters=(":",), interpolation=None)
    config.read_string(scene.config("", changes))
    own, probe, z_axis = (
        config[name] for name in ("z_calibration", "probe", "stepper_z")
    )
    pin_samples = (
        own.getint("samples", probe.getint("samples")),
        own.getfloat("probing_second_speed"),
        own.getfloat("probing_retract_dist"),
        own.getfloat("lift_speed", probe.getfloat("lift_speed")),
    )
    bed_samples = (
        probe.getint("samples"),
        probe.getfloat("speed"),
        probe.getfloat("sample_retract_dist"),
        probe.getfloat("lift_speed"),
    )
    nozzle = _pair(own["nozzle_xy_position"])
    switch = _pair(own["switch_xy_position"])
    bed_x, bed_y = _pair(own["bed_xy_position"])
    bed_x -= probe.getfloat("x_offset")
    bed_y -= probe.getfloat("y_offset")
    world = scene.world
    pin, true_probe = world.pin, world.mag_probe
    assert pin is not None
    assert true_probe is not None
    # Homing makes position_endstop of the height at which the pin triggers
    pin_z = z_axis.getfloat("position_endstop")
    bed_z = pin_z - pin.z + true_probe.body_drop + true_probe.switch_offset
    bed_z += Bed(world.bed).height(
        bed_x + true_probe.x_offset, bed_y + true_probe.y_offset
    )
    limits = config["printer"]
    return Plan(
        stops=(
            Stop("nozzle", *nozzle, pin_z, *pin_samples),
            Stop("switch", *switch, pin_z + true_probe.body_drop, *pin_samples),
            Stop("bed", bed_x, bed_y, bed_z, *bed_samples),
        ),
        travel_z=own.getfloat("safe_z_height"),
        travel_speed=own.getfloat("speed", 50.0),
        approach_speed=own.getfloat(
            "probing_speed", z_axis.getfloat("homing_speed")
        ),
        limits=Limits(
            limits.getfloat("max_velocity"),
            limits.getfloat("max_accel"),
            limits.getfloat("max_z_velocity"),
            limits.getfloat("max_z_accel"),
        ),
    )


def _pair(text: str) -> tuple[float, float]:
    x, y = map(float, text.split(","))
    return x, y


# Measuring


class Run(NamedTuple):
    """One CALIBRATE_Z: where it began (mm), what it took and what it did.

    samples: recorded ones, None where the module does not tell.
    touches: all of them, by site.
    """

    name: str
    start: tuple[float, float, float]
    seconds: float
    parts: tuple[Part, ...]
    samples: Optional[int]
    touches: Mapping[str, int]

    @property
    def bound(self) -> float:
        """The lower bound, s."""
        return math.fsum(part.seconds for part in self.parts)

    @property
    def ratio(self) -> float:
        """How many times the lower bound it took."""
        return self.seconds / self.bound

    def figures(self) -> dict[str, Any]:
        """All of it, for a file."""
        return {
            "run": self.name,
            "start": self.start,
            "seconds": self.seconds,
            "bound": self.bound,
            "ratio": self.ratio,
            "parts": [part._asdict() for part in self.parts],
            "samples": self.samples,
            "touches": dict(self.touches),
        }


class Subject(NamedTuple):
    """A module to measure, as it is installed."""

    name: str
    modules: Mapping[str, Path]


class NoCalibrationError(Exception):
    """CALIBRATE_Z ended well, but has not measured all there is."""


# What a module that is not ours may lead to
FAILURES = (
    ApiError,
    CrashError,
    GcodeError,
    HostError,
    NoCalibrationError,
    OSError,
    SessionError,
    SimulationError,
)

# The runs of a module on a host, or why there are none
Outcome = Union[list[Run], str]


def ours() -> Subject:
    """The module of this repository."""
    name = "z_calibration"
    return Subject("ours", {name: module_files()[name]})


def measure(
    host: Host, subject: Subject, changes: Sections = STANDARD
) -> list[Run]:
    """All runs, on one printer. Raises one of FAILURES."""
    plan = make_plan(SCENE, changes)
    runs = []
    with Printer(
        host, SCENE, changes=changes, modules=subject.modules
    ) as printer:
        printer.session.require_ready()
        for name, before in RUNS:
            printer.run(f"{before}\nM400")
            runs.append(calibrate(printer, name, plan))
    return runs


def calibrate(printer: Printer, name: str, plan: Plan) -> Run:
    """One CALIBRATE_Z, with nothing left to move before and after it."""
    machine = printer.machine
    clock = machine.simulation.clock
    start = printer.session.position()
    before = len(machine.truth.touches)
    began = clock.now()
    lines = printer.run("CALIBRATE_Z\nM400")
    seconds = (clock.now() - began) * 1e-9
    touches = Counter(touch.site for touch in machine.truth.touches[before:])
    missing = [site for site in SITES if not touches[site]]
    if missing:
        raise NoCalibrationError(
            f"CALIBRATE_Z has not touched {', '.join(missing)}; the console"
            f" ends with {lines[-1:]}"
        )
    return Run(
        name, start, seconds, lower_bound(plan, start), recorded(lines), touches
    )


def recorded(lines: Sequence[str]) -> Optional[int]:
    """Samples that a module has told of on the console."""
    for pattern in RECORDED:
        count = sum(len(pattern.findall(line)) for line in lines)
        if count:
            return count
    return None


def attempt(host: Host, subject: Subject) -> Outcome:
    """The runs, or in one line why there are none."""
    try:
        return measure(host, subject)
    except FAILURES as error:
        return reason(error)


def reason(error: Exception) -> str:
    """What an error says, without what klippy's log has to add."""
    lines = str(error).strip().splitlines() or [repr(error)]
    if lines[0].endswith(":"):
        return " ".join(line.strip() for line in lines[:2])
    return lines[0]


# Printing


def say(text: str = "") -> None:
    """A line for people, at once."""
    print(text, flush=True)  # noqa: T201


def row(name: str, cells: Sequence[str], width: int, rest: str = "") -> str:
    """A line of the table."""
    columns = "".join(f"  {cell:>16}" for cell in cells)
    return f"  {name:{width}}{columns}{rest}".rstrip()


def run_row(name: str, outcome: Outcome, width: int) -> str:
    """The runs of one module on one host."""
    if isinstance(outcome, str):
        return f"  {name:{width}}  {outcome}"
    cells = [f"{r.seconds:.2f}/{r.bound:.2f}={r.ratio:.2f}" for r in outcome]
    samples = _same(["?" if r.samples is None else r.samples for r in outcome])
    touches = _same([touches_text(r.touches) for r in outcome])
    return row(name, cells, width, f"  {samples:>7}  {touches}")


def touches_text(touches: Mapping[str, int]) -> str:
    """Touches of nozzle, switch and bed, and any others by their name."""
    text = "+".join(str(touches.get(site, 0)) for site in SITES)
    others = [s for s in touches if s not in SITES]
    return text + "".join(f" {site}:{touches[site]}" for site in others)


def _same(values: Sequence[object]) -> str:
    """One value where all are the same."""
    texts = list(map(str, values))
    return texts[0] if len(set(texts)) == 1 else "/".join(texts)


def ratio_row(name: str, first: list[Run], other: list[Run], width: int) -> str:
    """How our times compare with others."""
    ratios = [a.seconds / b.seconds for a, b in zip(first, other)]
    cells = [f"{ratio:.2f}" for ratio in ratios]
    return row(f"ours / {name}", cells, width)


def bound_table(parts: Sequence[Part], start: Sequence[float]) -> list[str]:
    """A lower bound and what it consists of."""
    seconds = {(part.site, part.what): part.seconds for part in parts}
    sites = list(dict.fromkeys(part.site for part in parts))
    place = " ".join(f"{axis}{p:.1f}" for axis, p in zip("XYZ", start))
    heads = "".join(f"{head:>10}" for head in (*PURPOSES, "all"))
    lines = [f"lower bound from {place}, s", f"  {'':8}{heads}"]
    for site in sites:
        row_seconds = [seconds.get((site, what), 0.0) for what in PURPOSES]
        row_seconds.append(math.fsum(row_seconds))
        cells = "".join(f"{value:10.2f}" for value in row_seconds)
        lines.append(f"  {site:8}{cells}")
    sums = [
        math.fsum(part.seconds for part in parts if part.what == what)
        for what in PURPOSES
    ]
    cells = "".join(f"{value:10.2f}" for value in (*sums, math.fsum(sums)))
    return [*lines, f"  {'all':8}{cells}"]


def host_block(
    host: Host, outcomes: Mapping[str, Outcome], width: int
) -> list[str]:
    """The lines of one host, except its name."""
    own = outcomes["ours"]
    lines = []
    for name, outcome in outcomes.items():
        lines.append(run_row(name, outcome, width))
        both = isinstance(own, list) and isinstance(outcome, list)
        if name != "ours" and both:
            lines.append(ratio_row(name, own, outcome, width))
    return lines


def bound_tables(all_runs: Sequence[Run]) -> list[str]:
    """The lower bounds of all places from which a run began."""
    starts = {}
    for run in all_runs:
        starts.setdefault(tuple(round(p, 1) for p in run.start), run)
    lines = []
    for run in starts.values():
        lines += ["", *bound_table(run.parts, run.start)]
    return lines


def parse(arguments: Optional[Sequence[str]]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.bench_calibration",
        description="Measure calibrations against their lower bound.",
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
    parser.add_argument("--json", type=Path, help="write the figures there")
    return parser.parse_args(arguments)


def subjects(options: argparse.Namespace) -> list[Subject]:
    """What the command line asks for, ours first."""
    found = [ours()]
    found += [Subject(str(f), {"z_calibration": f}) for f in options.module]
    if options.builtin:
        found.append(Subject("the host's own", {}))
    return found


def report(host: Host, outcomes: Mapping[str, Outcome]) -> list[dict[str, Any]]:
    """All figures of a host, for a file."""
    return [
        {
            "host": host.name,
            "version": host.version,
            "module": name,
            "failure": outcome if isinstance(outcome, str) else None,
            "runs": []
            if isinstance(outcome, str)
            else [run.figures() for run in outcome],
        }
        for name, outcome in outcomes.items()
    ]


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Print the tables; return the exit code."""
    options = parse(arguments)
    hosts = [host for host in find_hosts() if options.host in host.name]
    if not hosts:
        say(f"no host has {options.host!r} in its name")
        return 1
    modules = subjects(options)
    width = 4
    if len(modules) > 1:
        width = max(len(f"ours / {module.name}") for module in modules[1:])
    say(
        "CALIBRATE_Z: printer seconds / lower bound = ratio; touches of nozzle,"
    )
    say("switch and bed")
    names = [name for name, _ in RUNS]
    say(row("", names, width, "  samples  touches"))
    all_runs, figures, good = [], [], True
    for host in hosts:
        say(host.name)
        outcomes = {module.name: attempt(host, module) for module in modules}
        for line in host_block(host, outcomes, width):
            say(line)
        good = good and isinstance(outcomes["ours"], list)
        figures += report(host, outcomes)
        for outcome in outcomes.values():
            all_runs += outcome if isinstance(outcome, list) else []
    for line in bound_tables(all_runs):
        say(line)
    if options.json is not None:
        options.json.write_text(json.dumps(figures, indent=2) + "\n")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
