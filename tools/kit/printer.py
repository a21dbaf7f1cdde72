"""A simulated printer with our modules on it."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, Optional, Union

from simprinter import Fault, Scene
from simprinter.hosts import printer
from simprinter.hosts.hosts import Host
from simprinter.hosts.printer import (
    NO_PRINTER,
    choose_host,
    dialect_of,
    firmware_of,
    has_kinematics,
    knows_kinematics,
)
from tools.kit import failing
from tools.kit.scenes import SCENES, Sections

__all__ = [
    "FOLDER",
    "MODULES",
    "NO_PRINTER",
    "Printer",
    "RunningPrinter",
    "choose_host",
    "dialect_of",
    "firmware_of",
    "given_module",
    "has_kinematics",
    "knows_kinematics",
    "module_files",
    "saved_before",
]

ROOT = Path(__file__).resolve().parents[2]
MODULES = ("z_calibration", "auto_z_offset", "dockable_probe", "extra_probe")
# Of the rooms behind them
FOLDER = "z_touch"


def module_files() -> dict[str, Path]:
    """All that this repository puts beside klippy's own, by name."""
    found = {name: ROOT / f"{name}.py" for name in MODULES}
    return {**found, FOLDER: ROOT / FOLDER}


def given_module(name: str, file: Path) -> dict[str, Path]:
    """A module from any file, with the folder beside it, or else ours."""
    beside = file.parent / FOLDER
    return {name: file, FOLDER: beside if beside.is_dir() else ROOT / FOLDER}


class _OverBed:
    """What is asked of a printer of ours: where it is calibrated, and the time."""

    def bed_point(self) -> tuple[float, float]:
        """That point, mm."""
        x, y = self.scene.sections["z_calibration"]["bed_xy_position"].split(
            ","
        )
        return float(x), float(y)

    def now(self) -> float:
        """Seconds of the simulated world."""
        return self.machine.rig.seconds(self.machine.simulation.clock.now())

    def gap(self, xy: Optional[tuple[float, float]] = None) -> float:
        """As of any printer; default: where the calibration measures."""
        return super().gap(self.bed_point() if xy is None else xy)


class RunningPrinter(_OverBed, printer.RunningPrinter):
    """A machine with klippy on it; leaving it checks for crashes and faults."""


class Printer(_OverBed, printer.Printer):
    """A scene's machine with a host and our modules on it."""

    def __init__(
        self,
        host: Host,
        scene: Union[str, Scene] = "voron",
        changes: Optional[Sections] = None,
        faults: Iterable[Fault] = (),
        seed: int = 0,
        modules: Optional[Mapping[str, Path]] = None,
        real_time: bool = False,
    ):
        modules = module_files() if modules is None else modules
        scene = SCENES[scene] if isinstance(scene, str) else scene
        super().__init__(host, scene, changes, faults, seed, modules, real_time)
        self.host, self.extras = host, tuple(modules.values())
        failing.watch(self)

    def __exit__(self, *error: Any) -> Optional[bool]:
        failing.leave(self)
        return super().__exit__(*error)


def saved_before(printer: RunningPrinter, section: str, line: str) -> None:
    """Klippy restarts with what SAVE_CONFIG had written some day."""
    file = printer.session.data / "config" / "printer.cfg"
    block = (
        "#*# <---------------------- SAVE_CONFIG ---------------------->",
        "#*# DO NOT EDIT THIS BLOCK OR BELOW. The contents are auto-generated.",
        "#*#",
        f"#*# [{section}]",
        f"#*# {line}",
        "",
    )
    file.write_text(file.read_text() + "\n" + "\n".join(block))
    printer.session.restart("RESTART")
