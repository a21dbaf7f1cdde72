"""Printer seconds of the commands, beside their lower bounds.

The times are of the simulated printer, not of this machine; CPU seconds are of
this machine.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from simprinter.hosts.hosts import Host
from tools.bench.commands import Command
from tools.bench.cost import cpu_seconds
from tools.bench.lower_bounds import Plan, lower_bound
from tools.kit.printer import FOLDER, Printer, module_files

# Name of a run, and what is done before it
RUNS = (("after G28", "G28"), ("again", ""), ("after G28 again", "G28"))


class Run(NamedTuple):
    """One command: where it began (mm), what it took and what it did.

    bound: the lower bound, s. touches: all of them, by site. cpu: seconds of
    klippy's process.
    """

    name: str
    start: tuple[float, float, float]
    seconds: float
    bound: float
    touches: Mapping[str, int]
    cpu: float

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
            "touches": dict(self.touches),
            "cpu": round(self.cpu, 3),
        }


def ours(module: str) -> dict[str, Path]:
    """A module of this repository, as it is installed."""
    return {name: module_files()[name] for name in (module, FOLDER)}


def measure(host: Host, command: Command) -> list[Run]:
    """All runs, on one printer."""
    plan = command.plan(command.scene, command.changes)
    runs = []
    with Printer(
        host,
        command.scene,
        changes=command.changes,
        modules=ours(command.module),
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
    missing = [site for site in command.sites if not touches.get(site)]
    assert not missing, (
        f"{command.name} has not touched {missing}: {lines[-1:]}"
    )
    return Run(name, start, seconds, lower_bound(plan, start), touches, cpu)
