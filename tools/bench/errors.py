"""How far off commands are on noisy sensors, against the machine's truth.

A trial is one printer that homes and measures once. Every seed is another
printer: heights of pin, bed and probe differ by parts of a microstep and more,
and so does the noise of every touch, those of homing included.
"""

from __future__ import annotations

import random
import re
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Union

from simprinter import Scene
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError, SessionError
from simprinter.world import NoiseSpec
from simprinter.world.bed import Bed
from tools.bench.commands import (
    AUTO_Z_CALIBRATE,
    CALIBRATE_Z,
    PROBE_Z_ACCURACY,
    Command,
)
from tools.bench.timing import ours
from tools.kit.auto_z_offset import POINT
from tools.kit.printer import Printer
from tools.kit.scenes import Sections

# One touch in a hundred triggers earlier, that is higher, by so much (mm)
OUTLIER_CHANCE = 0.01
OUTLIER = 0.05

# By how much (mm) the heights of a seed's printer differ at most
SPREAD = 0.05

UM = 1000.0
_NUMBER = re.compile(r"-?\d+(\.\d+)?")


class Condition(NamedTuple):
    """Noise of the sensors (um), and samples_tolerance where it is changed."""

    sigma: float
    tolerance: str = ""

    def __str__(self) -> str:
        text = f"{self.sigma:g} um"
        return f"{text}, tolerance {self.tolerance}" if self.tolerance else text


CONDITIONS = (Condition(0.0), Condition(3.0), Condition(10.0))
# What an owner of such a switch has to write, to be refused less often
TOLERANT = Condition(10.0, "0.05")


# In um, by what was measured; or why the command has refused
Errors = dict[str, Union[float, str]]


class Measurement(NamedTuple):
    """What is done on a printer that is homed, and its errors in mm by name.

    It raises GcodeError where a command refuses.
    """

    names: tuple[str, ...]
    measure: Callable[[Printer], dict[str, float]]


class Procedure(NamedTuple):
    """All that is done on a printer, and under which conditions.

    Only the first measurement has a tolerance.
    """

    command: Command
    measurements: tuple[Measurement, ...]
    conditions: tuple[Condition, ...] = CONDITIONS


class Trial(NamedTuple):
    """One printer: can be sent to another process."""

    host: Host
    procedure: str
    condition: Condition
    seed: int


# Machines


def make_scene(scene: Scene, condition: Condition, seed: int) -> Scene:
    """The scene with the heights and the noise of one seed."""
    draw = random.Random(f"heights/{seed}")

    def shifted(z: float) -> float:
        return z + draw.uniform(-SPREAD, SPREAD)

    noise = NoiseSpec(condition.sigma / UM, OUTLIER_CHANCE, OUTLIER)
    world = scene.world
    changes: dict[str, Any] = {
        "bed": replace(world.bed, z0=shifted(world.bed.z0))
    }
    if world.pin is not None:
        z = shifted(world.pin.z)
        changes["pin"] = replace(world.pin, z=z, noise=noise)
    if world.mag_probe is not None:
        drop = shifted(world.mag_probe.body_drop)
        changes["mag_probe"] = replace(
            world.mag_probe, body_drop=drop, noise=noise
        )
    if world.inductive is not None:
        distance = shifted(world.inductive.sense_distance)
        changes["inductive"] = replace(
            world.inductive, sense_distance=distance, noise=noise
        )
    if world.bed_sensor is not None:
        late = replace(noise, latency=world.bed_sensor.noise.latency)
        changes["bed_sensor"] = replace(world.bed_sensor, noise=late)
    return scene.with_world(**changes)


def make_changes(command: Command, condition: Condition) -> Sections:
    """The changes to printer.cfg under a condition."""
    if not condition.tolerance:
        return command.changes
    # [z_calibration] follows [probe]
    section = "probe" if command.module == "z_calibration" else command.module
    before = command.changes.get(section) or {}
    changed = {**before, "samples_tolerance": condition.tolerance}
    return {**command.changes, section: changed}


# What is measured, against what


def calibrate_errors(printer: Printer) -> dict[str, float]:
    """True gap at Z=0 minus the one that a perfect CALIBRATE_Z leaves."""
    printer.run(CALIBRATE_Z.script)
    return {CALIBRATE_Z.name: printer.gap() - printer.scene.formula_gap()}


def accuracy_errors(printer: Printer) -> dict[str, float]:
    """Reported average height of the pin minus the true one."""
    lines = printer.run(PROBE_Z_ACCURACY.script)
    error = reported_average(lines) - pin_height(printer)
    return {PROBE_Z_ACCURACY.name: error}


def reported_average(lines: Sequence[str]) -> float:
    """The average (mm) that PROBE_Z_ACCURACY has told."""
    found = re.findall(r"average (-?[\d.]+)", "\n".join(lines))
    return float(found[-1])


def pin_height(printer: Printer) -> float:
    """Toolhead Z (mm) at which the nozzle really triggers the pin."""
    world = printer.scene.world
    assert world.pin is not None
    # Of G-code Z=0, world frame
    zero = printer.gap() + Bed(world.bed).height(*printer.bed_point())
    return world.pin.z - zero + printer.offset()


def cycles_errors(printer: Printer) -> dict[str, float]:
    """True gap at Z=0 minus the one that a perfect AUTO_Z_CALIBRATE leaves.

    And the same after a perfect homing: what is wrong with the correction
    alone, without what the noise of the last homing adds.
    """
    scene = printer.scene
    assert scene.world.inductive is not None
    printer.run(AUTO_Z_CALIBRATE.script)
    homed = scene.world.inductive.sense_distance + printer.offset()
    return {
        AUTO_Z_CALIBRATE.name: printer.gap(POINT) - scene.piezo_gap(),
        CORRECTION: homed - scene.piezo_gap(),
    }


CORRECTION = f"{AUTO_Z_CALIBRATE.name}, its correction alone"
PROCEDURES = {
    "pin": Procedure(
        CALIBRATE_Z,
        (
            Measurement((CALIBRATE_Z.name,), calibrate_errors),
            Measurement((PROBE_Z_ACCURACY.name,), accuracy_errors),
        ),
        (*CONDITIONS, TOLERANT),
    ),
    "piezo": Procedure(
        AUTO_Z_CALIBRATE,
        (Measurement((AUTO_Z_CALIBRATE.name, CORRECTION), cycles_errors),),
    ),
}


# Trials


def run_trial(trial: Trial) -> Errors:
    """The errors of one printer."""
    procedure = PROCEDURES[trial.procedure]
    command = procedure.command
    measurements = procedure.measurements
    if trial.condition.tolerance:
        measurements = measurements[:1]
    errors: Errors = {}
    with Printer(
        trial.host,
        make_scene(command.scene, trial.condition, trial.seed),
        make_changes(command, trial.condition),
        seed=trial.seed,
        modules=ours(command.module),
    ) as printer:
        printer.homed()
        for measurement in measurements:
            errors.update(outcome(measurement, printer))
    return errors


def outcome(measurement: Measurement, printer: Printer) -> Errors:
    """Its errors; or why the command has refused.

    Raises SessionError where klippy is not ready any more.
    """
    try:
        found = measurement.measure(printer)
    except GcodeError as error:
        if printer.session.state()[0] != "ready":
            raise SessionError(str(error)) from error
        # Without numbers, to count those that are alike
        why = _NUMBER.sub("#", str(error).splitlines()[0])
        return dict.fromkeys(measurement.names, why)
    return {name: error * UM for name, error in found.items()}


def summarize(outcomes: Sequence[Union[float, str]]) -> dict[str, Any]:
    """Outcomes of many seeds, um; None where there are too few.

    sigma: sample standard deviation. worst: farthest from zero, with its sign.
    """
    errors = [o for o in outcomes if not isinstance(o, str)]
    reasons = Counter(o for o in outcomes if isinstance(o, str))

    def rounded(least: int, of: Callable[[list[float]], float]) -> Any:
        return round(of(errors), 2) if len(errors) >= least else None

    return {
        "seeds": len(outcomes),
        "mean": rounded(1, statistics.mean),
        "sigma": rounded(2, statistics.stdev),
        "worst": rounded(1, lambda errors: max(errors, key=abs)),
        "refused": sum(reasons.values()),
        "reasons": dict(reasons.most_common()),
    }


def plan_trials(host: Host, seeds: int) -> list[Trial]:
    """All procedures, all conditions, all seeds."""
    return [
        Trial(host, name, condition, seed)
        for name, procedure in PROCEDURES.items()
        for condition in procedure.conditions
        for seed in range(seeds)
    ]


def summaries(
    trials: Sequence[Trial], found: Iterable[Errors]
) -> list[dict[str, Any]]:
    """The trials in groups, in the order in which they come."""
    groups: dict[tuple[str, ...], list[Any]] = {}
    for trial, errors in zip(trials, found):
        for what, error in errors.items():
            key = (trial.host.name, what, str(trial.condition))
            groups.setdefault(key, []).append(error)
    heads = ("host", "command", "noise")
    return [
        {**dict(zip(heads, key)), **summarize(group)}
        for key, group in groups.items()
    ]
