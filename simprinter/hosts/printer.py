"""A simulated printer with a live klippy on it: what most tests work with."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Mapping
from contextlib import ExitStack
from functools import lru_cache
from pathlib import Path
from typing import Any, Optional

from simprinter import Fault, Machine, RealClock, Scene
from simprinter.clock import ClockError
from simprinter.hosts.hosts import (
    Host,
    HostError,
    checkout_hosts,
    find_hosts,
    missing_hosts,
)
from simprinter.hosts.session import GcodeError, LiveSession, SessionError
from simprinter.mcu.dialect import Dialect
from simprinter.scene import Sections
from simprinter.simulation import SimulationError

# Why there is no simulated printer, or none any more
NO_PRINTER = (ClockError, HostError, OSError, SessionError, SimulationError)


def firmware_of(host: Host) -> str:
    """The firmware a host insists on."""
    plugins = host.layout.module_dir.endswith("plugins")
    return "Kalico" if plugins else "Klipper"


@lru_cache(maxsize=None)
def dialect_of(host: Host) -> Dialect:
    """How that firmware speaks: as this version of the host expects."""
    source = host.directory / "base" / "klippy" / "mcu.py"
    return Dialect.of(firmware_of(host), source.read_text(encoding="utf-8"))


def choose_host(name: Optional[str]) -> Host:
    """The host of that name; without one a checkout, Klipper before others.

    Raises HostError if there is none.
    """
    # One host is enough here, so one that is missing is no reason to stop
    os.environ.setdefault("ALLOW_MISSING_HOSTS", "1")
    if name is None:
        hosts = checkout_hosts() or find_hosts()
        return min(hosts, key=lambda host: firmware_of(host) != "Klipper")
    hosts = find_hosts()
    for host in hosts:
        if host.name == name:
            return host
    known = ", ".join(host.name for host in hosts)
    unknown = f"there is no host {name!r}, only {known}"
    raise HostError(missing_hosts().get(name, unknown))


def has_kinematics(host: Host, scene: Scene) -> bool:
    """Whether a host knows the kinematics that a scene is configured with."""
    name = (scene.sections["printer"] or {})["kinematics"]
    return name is not None and knows_kinematics(host, name)


def knows_kinematics(host: Host, name: str) -> bool:
    """Whether a host has kinematics of that name."""
    klippy = (host.directory / "base" / host.layout.module_dir).parent
    return (klippy / "kinematics" / f"{name}.py").is_file()


class RunningPrinter:
    """A machine with klippy on it; leaving it checks for crashes and faults."""

    def __init__(
        self, machine: Machine, begin: Callable[[Machine], LiveSession]
    ):
        """begin: starts klippy on the machine."""
        with ExitStack() as stack:
            self.machine = stack.enter_context(machine)
            self.session = stack.enter_context(begin(machine))
            self._stack = stack.pop_all()
        self.scene = machine.scene

    def __enter__(self) -> RunningPrinter:
        return self

    def __exit__(self, *error: Any) -> Optional[bool]:
        return self._stack.__exit__(*error)

    def homed(self) -> RunningPrinter:
        """The same printer, ready and homed."""
        self.session.require_ready()
        self.run("G28")
        return self

    def run(self, script: str) -> list[str]:
        """Run G-code; its console lines. Raises GcodeError."""
        return self.session.run(script)

    def fail(self, script: str) -> str:
        """Run G-code that must fail; the error's text."""
        try:
            lines = self.run(script)
        except GcodeError as error:
            return str(error)
        raise AssertionError(f"{script!r} did not fail: {lines}")

    def stopped(self, script: str, site: str, after: float) -> str:
        """Run G-code and stop the printer as a user's button does.

        That long (s) after the script's first touch of a site. The error's
        text.
        """
        touches, session = self.machine.truth.touches, self.session
        before = len(touches)
        command = session.begin(script)
        session.run_until(
            command,
            lambda: any(touch.site == site for touch in touches[before:]),
        )
        session.wait(after)
        session.stop()
        try:
            lines = session.finish(command)
        except GcodeError as error:
            return str(error)
        raise AssertionError(f"{script!r} did not stop: {lines}")

    def status(self, name: str) -> dict[str, Any]:
        """Status fields of a printer object."""
        return self.session.status(name)

    def statuses(self, *names: str) -> dict[str, dict[str, Any]]:
        """Of several at one moment."""
        return self.session.statuses(dict.fromkeys(names))

    def offset(self) -> float:
        """The G-code Z offset in force, mm."""
        return self.status("gcode_move")["homing_origin"][2]

    def gap(self, xy: tuple[float, float]) -> float:
        """True nozzle-to-bed gap that G-code Z=0 stands for, mm.

        Moves the toolhead above it, so the answer comes from steps alone. xy:
        over which point.
        """
        x, y = xy
        self.run(f"G90\nG1 Z20 F900\nG1 X{x} Y{y} F6000\nG1 Z10 F900\nM400")
        self.session.wait(0.5)
        return self.machine.gap_at_zero(10.0, xy)


class Printer(RunningPrinter):
    """A scene's machine with a host and modules on it."""

    def __init__(
        self,
        host: Host,
        scene: Scene,
        changes: Optional[Sections] = None,
        faults: Iterable[Fault] = (),
        seed: int = 0,
        modules: Optional[Mapping[str, Path]] = None,
        real_time: bool = False,
    ):
        """changes: to the scene's configuration, see Scene.config.

        modules: see Host.install.
        """
        installed = host.install(modules or {})
        clock = RealClock() if real_time else None
        machine = Machine(scene, seed, faults, clock, dialect_of(host))
        config = scene.config(machine.serials, changes)
        super().__init__(
            machine, lambda machine: LiveSession(installed, machine, config)
        )
