"""What tests of [auto_z_offset] have in common."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any, NamedTuple, Optional

from tools.kit.printer import Printer, module_files
from simprinter import Scene
from tools.kit.scenes import SCENES

MICROSTEP = 0.0025
# Of the qidi scene, mm: where both sensors touch, and in klippy's frame after
# G28 the triggers of the sensor and of the probe
POINT = (119.75, 126.75)
# The toolhead there, with the probe above the point
PROBE_PLACE = (POINT[0] - 17.6, POINT[1] - 4.4)
DEPTH = SCENES["qidi"].piezo_depth()
SENSOR = -1.2695 - DEPTH
AIR_GAP = float(SCENES["qidi"].sections["auto_z_offset"]["z_offset"])
CORRECTION = SENSOR + AIR_GAP

FORMULA = re.compile(
    r"sensor=(\S+) - \(probe=(\S+) - probe z_offset=(\S+)\)"
    r" \+ z_offset=(\S+) --> correction=(\S+)"
)

# Where each sensor meets the bed
SITES = {"bed_sensor": "nozzle_bed", "probe": "inductive_bed"}


class Formula(NamedTuple):
    """The numbers of a result line, mm."""

    sensor: float
    probe: float
    probe_z_offset: float
    z_offset: float
    correction: float


def section(**options: Optional[str]) -> dict[str, Any]:
    """Changes to [auto_z_offset] only."""
    return {"auto_z_offset": options}


def formulas(lines: list[str]) -> list[Formula]:
    """The numbers of all result lines."""
    found = [m for m in map(FORMULA.search, lines) if m]
    return [Formula(*map(float, m.groups())) for m in found]


def told(lines: list[str], text: str) -> list[str]:
    """The lines that contain the text."""
    return [line for line in lines if text in line]


def touches(printer: Printer, start: int = 0) -> list[Any]:
    """What was touched, without the homing of X and Y."""
    sites = ("nozzle_bed", "inductive_bed")
    found = printer.machine.truth.touches[start:]
    return [touch for touch in found if touch.site in sites]


def sites(printer: Printer, start: int = 0) -> list[str]:
    """Names of the sites touched, in order."""
    return [touch.site for touch in touches(printer, start)]


def true_gap(printer: Printer) -> float:
    """True gap (mm) at G-code Z=0 over the point of the measurement."""
    return printer.gap(POINT)


def state(printer: Printer) -> dict[str, Any]:
    """All that a failed command must leave as it was."""
    drivers = printer.machine.drivers
    return {
        "offset": printer.offset(),
        "max_accel": printer.status("toolhead")["max_accel"],
        "homed": printer.status("toolhead")["homed_axes"],
        "currents": {n: d.current()[1:] for n, d in drivers.items()},
        "status": printer.status("auto_z_offset"),
        "pending": pending(printer),
        "absolute": printer.status("gcode_move")["absolute_coordinates"],
    }


def pending(printer: Printer) -> dict[str, Any]:
    """What SAVE_CONFIG would write."""
    status = printer.status("configfile")
    return dict(status["save_config_pending_items"])


def seconds(printer: Printer, script: str) -> float:
    """Printer seconds until the last move of a script has ended."""
    clock = printer.machine.simulation.clock
    before = clock.now()
    printer.run(f"{script}\nM400")
    return (clock.now() - before) / 1e9


def lowest(printer: Printer) -> float:
    """Depth (mm) of the nozzle below the plate at its deepest."""
    return printer.machine.truth.deepest_in_bed()


def with_extras(*names: str) -> dict[str, Path]:
    """The modules, and extras of tests by name."""
    folder = Path(__file__).with_name("extras")
    return {**module_files(), **{n: folder / f"{n}.py" for n in names}}


def world(scene: str = "qidi", **changes: Any) -> Scene:
    """A scene with another world."""
    return SCENES[scene].with_world(**changes)
