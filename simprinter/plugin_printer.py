"""A printer of anybody's: his printer.cfg, his world, his plugins."""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Optional, Union

from . import printer_cfg as printer_cfgs
from . import world_file
from .faults import Fault
from .hosts.hosts import Host, HostError
from .hosts.printer import Printer
from .printer_cfg import PrinterCfg
from .scene import Scene, Sections
from .world import Pose, Touch, Truth

# A file, or what would stand in it
Text = Union[str, Path]


class PluginPrinter(Printer):
    """Real klippy with plugins on a machine of a world file; see `start`.

    Frame of all places: the world's, mm. On leaving without another error,
    CrashError tells what was hurt, FaultError which fault has not struck.
    """

    @property
    def console(self) -> list[str]:
        """All lines that the console has shown."""
        return self.session.console

    @property
    def errors(self) -> list[str]:
        """Those of them that are errors, as they stand there after `!! `."""
        return [line[3:] for line in self.console if line.startswith("!! ")]

    @property
    def truth(self) -> Truth:
        """What really happened: touches, crashes, depths; reaches no klippy."""
        return self.machine.truth

    @property
    def touches(self) -> list[Touch]:
        """Each contact so far: time, site, where."""
        return self.truth.touches

    def tip(self, carriage: int = 0) -> Pose:
        """Where the nozzle tip really is; carriage: 1 for that of the second."""
        return self.machine.tip(carriage)

    def break_down(self, name: str, **about: object) -> None:
        """From now on something is broken: a Fault's name and arguments."""
        self.machine.break_down(Fault(name, **about))

    def repair(self) -> None:
        """Nothing is broken any more."""
        self.machine.repair()

    def hold(self, signal: str, level: Optional[bool]) -> None:
        """A hand keeps a switch pressed (True) or free (False); None: lets go.

        signal: its name in [signals] of the world.
        """
        if signal not in self.machine.world.signals:
            known = sorted(self.machine.world.signals)
            raise ValueError(
                f"no signal {signal!r} in this world, have {known}"
            )
        self.machine.hold(signal, level)

    def lay_membrane(
        self, is_laid: bool = True, signal: str = "membrane"
    ) -> None:
        """A hand lays a membrane switch on the bed, or takes it away.

        signal: its name in [signals] of the world.
        """
        self.machine.lay_membrane(is_laid, signal)


def read_scene(printer_cfg: Text, world: Optional[Text] = None) -> Scene:
    """The machine of a printer.cfg and a world file.

    Each is a file or, with more than a line, its text. Without a world, one is
    made of the printer.cfg. Raises PrinterCfgError and WorldFileError.
    """
    with tempfile.TemporaryDirectory() as folder:
        beside = Path(folder)
        cfg = printer_cfgs.read(_file(printer_cfg, beside / "printer.cfg"))
        if world is None:
            world = world_file.made_from(cfg)
        known = world_file.read(_file(world, beside / "world.toml"))
    return world_file.scene_of(cfg, known)


def _file(given: Text, scratch: Path) -> Path:
    if isinstance(given, str) and "\n" in given:
        scratch.write_text(given, encoding="utf-8")
        return scratch
    return Path(given).expanduser()


def start(
    host: Host,
    printer_cfg: Text,
    world: Optional[Text] = None,
    extras: Iterable[Union[str, Path]] = (),
    changes: Optional[Sections] = None,
    faults: Iterable[Fault] = (),
    seed: int = 0,
) -> PluginPrinter:
    """Start klippy with plugins on the machine; see read_scene for the first two.

    extras: files and folders that a user copies to klippy/extras. changes: to
    sections of the printer.cfg: options by section, None takes one away.
    Raises HostError where a file is missing, SessionError with klippy's message
    where it does not get ready.
    """
    printer = PluginPrinter(
        host,
        read_scene(printer_cfg, world),
        changes,
        faults,
        seed,
        modules_of(extras),
    )
    try:
        printer.session.require_ready()
        # Nobody is faster; klippy sets its outputs for the first time 0.2 s
        # later, and loses those that a command changes before
        printer.session.wait(1.0)
    except BaseException as error:
        printer.__exit__(type(error), error, error.__traceback__)
        raise
    return printer


def modules_of(extras: Iterable[Union[str, Path]]) -> Mapping[str, Path]:
    """Files and folders by the names that klippy knows them by."""
    modules: dict[str, Path] = {}
    for given in extras:
        path = Path(given).expanduser()
        is_plain = path.is_dir() or path.suffix == ".py"
        name = path.stem if is_plain else path.name
        if is_plain and not re.fullmatch(r"\w+", name):
            raise HostError(f"{path}: klippy has no modules of such a name")
        modules[name] = path
    return modules


__all__ = [
    "PluginPrinter",
    "PrinterCfg",
    "modules_of",
    "read_scene",
    "start",
]
