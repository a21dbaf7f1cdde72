"""Printer seconds of the commands, beside their lower bounds.

The times are of the simulated printer, not of this machine; CPU seconds are of
this machine.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Optional, Union

from simprinter.hosts.api import ApiError
from simprinter.hosts.hosts import Host, HostError
from simprinter.hosts.session import GcodeError, SessionError
from simprinter.simulation import SimulationError
from simprinter.world.truth import CrashError
from tools.bench.commands import Command
from tools.bench.cost import cpu_seconds
from tools.bench.lower_bounds import Part, Plan, lower_bound
from tools.kit.printer import FOLDER, Printer, module_files

# Name of a run, and what is done before it
RUNS = (("after G28", "G28"), ("again", ""), ("after G28 again", "G28"))

# How modules say that they have recorded samples, how many or each: ours; others,
# whose words for it are the host's own for any touch.
RECORDED = (
    re.compile(r"z_calibration: \w+ at z=\S+ \((\d+) touch"),
    re.compile(r"^// PROBE_Z_ACCURACY at .* \(samples=(\d+) "),
    re.compile(r"auto_z_offset: [a-z ]+: (triggered) at z="),
    re.compile(r"(probe at) \S+ is z="),
)


class Run(NamedTuple):
    """One command: where it began (mm), what it took and what it did.

    samples: recorded ones, None where the module does not tell.
    touches: all of them, by site. cpu: seconds of klippy's process; idle: what
    it takes in as many printer seconds of standing still.
    """

    name: str
    start: tuple[float, float, float]
    seconds: float
    parts: tuple[Part, ...]
    samples: Optional[int]
    touches: Mapping[str, int]
    cpu: float = 0.0
    idle: float = 0.0

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
            "start": [round(p, 3) for p in self.start],
            "seconds": round(self.seconds, 3),
            "bound": round(self.bound, 3),
            "ratio": round(self.ratio, 3),
            "samples": self.samples,
            "touches": dict(self.touches),
            "cpu": round(self.cpu, 3),
            "idle_cpu": round(self.idle, 3),
        }


# The name of what is in this repository
OURS = "ours"


class Subject(NamedTuple):
    """Modules to measure, as they are installed."""

    name: str
    modules: Mapping[str, Path]


class NoCalibrationError(Exception):
    """A command ended well, but has not measured all there is."""


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


def ours(module: str) -> Subject:
    """A module of this repository."""
    return Subject(
        OURS, {name: module_files()[name] for name in (module, FOLDER)}
    )


def measure(host: Host, subject: Subject, command: Command) -> list[Run]:
    """All runs, on one printer. Raises one of FAILURES."""
    plan = command.plan(command.scene, command.changes)
    runs = []
    with Printer(
        host, command.scene, changes=command.changes, modules=subject.modules
    ) as printer:
        printer.session.require_ready()
        if command.prepare:
            plan = plan._replace(prepare=prepare_seconds(printer, command))
        for name, before in RUNS:
            printer.run(f"{before}\nM400")
            runs.append(run_command(printer, command, name, plan))
    return runs


def prepare_seconds(printer: Printer, command: Command) -> float:
    """Printer seconds of the user's own G-code, where it is to run."""
    plan = command.plan(command.scene, command.changes)
    first = plan.stops[0]
    printer.run(
        f"G28\nG90\nG1 Z{first.travel_z} F600\nG1 X{first.x} Y{first.y} F6000"
        "\nM400"
    )
    clock = printer.machine.simulation.clock
    began = clock.now()
    printer.run(command.prepare + "\nM400")
    return (clock.now() - began) * 1e-9


def run_command(
    printer: Printer, command: Command, name: str, plan: Plan
) -> Run:
    """One command, with nothing left to move before and after it."""
    machine = printer.machine
    clock = machine.simulation.clock
    start = printer.session.position()
    before = len(machine.truth.touches)
    cpu_before, began = cpu_seconds(machine.simulation), clock.now()
    lines = printer.run(command.script + "\nM400")
    seconds = (clock.now() - began) * 1e-9
    cpu = cpu_seconds(machine.simulation) - cpu_before
    touches = Counter(touch.site for touch in machine.truth.touches[before:])
    require_touched(command, touches, lines)
    parts = lower_bound(plan, start)
    idle = idle_seconds(printer, seconds)
    return Run(name, start, seconds, parts, recorded(lines), touches, cpu, idle)


def require_touched(
    command: Command, touches: Mapping[str, int], lines: Sequence[str]
) -> None:
    """Raises NoCalibrationError if one of the sites was left out."""
    missing = [site for site in command.sites if not touches.get(site)]
    if missing:
        raise NoCalibrationError(
            f"{command.name} has not touched {', '.join(missing)}; the console"
            f" ends with {lines[-1:]}"
        )


def idle_seconds(printer: Printer, seconds: float) -> float:
    """CPU seconds of klippy while the printer stands still for so long."""
    simulation = printer.machine.simulation
    before = cpu_seconds(simulation)
    printer.session.wait(seconds)
    return cpu_seconds(simulation) - before


def recorded(lines: Sequence[str]) -> Optional[int]:
    """Samples that a module has told of on the console."""
    for pattern in RECORDED:
        found = [said for line in lines for said in pattern.findall(line)]
        if found:
            return sum(int(said) if said.isdigit() else 1 for said in found)
    return None


def attempt(host: Host, subject: Subject, command: Command) -> Outcome:
    """The runs, or in one line why there are none."""
    try:
        return measure(host, subject, command)
    except FAILURES as error:
        return reason(error)


def reason(error: Exception) -> str:
    """What an error says, without what klippy's log has to add."""
    lines = str(error).strip().splitlines() or [repr(error)]
    if lines[0].endswith(":"):
        return " ".join(line.strip() for line in lines[:2])
    return lines[0]
