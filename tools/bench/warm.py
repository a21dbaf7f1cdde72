"""What CALIBRATE_Z is worth on a machine that still warms up, and in which order.

    python -m tools.bench.warm [--host NAME]

Every part of the voron scene grows as those of the printer in a published plot did
(simprinter/real.py), from switching on; its switches vary as such switches do. Shown
are

- twenty runs in a row as in that plot, each begun EVERY seconds after the one before:
  the range of the offsets that are told, how far the true gap is off right after each
  run, and what the history has said;
- the true gap some PRINT seconds after switching on, by what was done when;
- how long Z_CALIBRATION_WAIT waits on it, and on one that warms up slowly, and what
  grows afterwards.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple, Optional

from simprinter import Scene
from simprinter.hosts.hosts import Host
from simprinter.real import SWITCH, warming_up
from simprinter.running import show
from simprinter.world import DriftSpec, NoiseSpec
from tools.bench.errors import UM
from tools.kit.printer import Printer, choose_host
from tools.kit.scenes import SCENES

RUNS = 20
# Seconds: the plot stands from the thirteenth run on, some ten minutes after the first
EVERY = 45.0
# Minutes after switching on at which somebody begins to print, and a long print
WAITS = (0, 5, 10, 15)
PRINT = 3600.0
SCRIPTS = (
    "Z_CALIBRATION_WAIT",
    "Z_CALIBRATION_WAIT LIMIT=0.002",
    "Z_CALIBRATION_WAIT LIMIT=0.005",
    "Z_CALIBRATION_WAIT MAX=60",
)
OFFSET = re.compile(r"new offset=(\S+)$")
# A frame that follows its chamber by 0.0088 mm per C (pull request 6855 of Klipper), 15 C
# warmer in the end, which takes an hour (issue 162 of protoloft/klipper_z_calibration)
SLOW = DriftSpec(nozzle=0.132 / 1200.0, tau=1200.0)
# No wait takes as long (s)
LONGEST = 7500.0
# What the history says of runs, and a run of itself
TOLD = re.compile(r"has drifted|has changed|has grown|in earlier runs")


def warming(drift: Optional[DriftSpec] = None) -> Scene:
    """The voron as it is switched on; default: as in the plot."""
    world, noise = SCENES["voron"].world, NoiseSpec(SWITCH)
    return SCENES["voron"].with_world(
        drift=drift or warming_up(),
        pin=replace(world.pin, noise=noise),
        mag_probe=replace(world.mag_probe, noise=noise),
    )


class Row(NamedTuple):
    """Runs in a row: offsets and errors of the true gap (um), and what was told."""

    offsets: list[float]
    errors: list[float]
    told: list[str]

    @property
    def range(self) -> float:
        return max(self.offsets) - min(self.offsets)


class Print(NamedTuple):
    """Errors of the true gap (um): as the print begins, and after PRINT seconds."""

    first_layer: float
    later: float


def off(printer: Printer) -> float:
    """By how much (um) the gap of now is too large; below 0 the nozzle is too low."""
    return (printer.gap() - printer.scene.formula_gap()) * UM


def row(host: Host, before: str = "") -> Row:
    """Twenty runs from switching on, each after a script."""
    found = Row([], [], [])
    with Printer(host, warming(), _options(), seed=1) as printer:
        clock = printer.machine.simulation.clock
        printer.homed()
        for _ in range(RUNS):
            began = clock.now()
            lines = printer.run(f"{before}\nCALIBRATE_Z".strip())
            told = [m for m in map(OFFSET.search, lines) if m]
            found.offsets.append(float(told[0][1]) * UM)
            found.errors.append(off(printer))
            spent = (clock.now() - began) * 1e-9
            printer.session.wait(max(0.0, EVERY - spent))
        console = printer.session.console
        found.told.extend(line for line in console if TOLD.search(line))
    return found


def printed(host: Host, minutes: float, script: str, early: str = "") -> Print:
    """A print that begins so many minutes after switching on, by a script.

    early: what was run right after switching on.
    """
    with Printer(host, warming(), _options(), seed=1) as printer:
        printer.homed()
        if early:
            printer.run(early)
        printer.session.wait(60.0 * minutes)
        if script:
            printer.run(script)
        first_layer = off(printer)
        printer.session.wait(PRINT)
        return Print(first_layer, off(printer))


class Wait(NamedTuple):
    """A wait, in minutes, and what came of it."""

    minutes: float
    then: Print


def waited(host: Host, drift: DriftSpec, script: str) -> Wait:
    """A script from switching on, then CALIBRATE_Z and a print."""
    with Printer(host, warming(drift), _options(), seed=1) as printer:
        printer.machine.tolerate("nozzle_pin", 0.2)
        printer.homed()
        clock = printer.machine.simulation.clock
        began = clock.now()
        if script:
            printer.session.run(script, LONGEST)
        minutes = (clock.now() - began) * 1e-9 / 60.0
        printer.run("CALIBRATE_Z")
        first_layer = off(printer)
        printer.session.wait(PRINT)
        return Wait(minutes, Print(first_layer, off(printer)))


def _options() -> dict:
    """The motors stay on."""
    idle = {"timeout": f"{4 * PRINT:g}"}
    return {"z_calibration": {"samples": "auto"}, "idle_timeout": idle}


def main(words: Sequence[str]) -> int:
    """Print both tables."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.warm")
    parser.add_argument("--host", metavar="NAME", help="klippy to run")
    given = parser.parse_args(words)
    host = choose_host(given.host)
    show(f"{host.name}, um")
    for name, before in (("CALIBRATE_Z", ""), ("G28 Z before it", "G28 Z")):
        found = row(host, before)
        sigma = statistics.pstdev(found.offsets)
        show(
            f"{RUNS} in a row, {name}: range {found.range:.1f}, sigma {sigma:.1f},"
            f" gap off by {max(found.errors, key=abs):+.1f} at most"
        )
        for line in found.told:
            show(f"    {line}")
    once = ("CALIBRATE_Z", "G28 Z\nCALIBRATE_Z")
    for minutes in WAITS:
        for name, script, early in (
            ("calibrated at switching on", "", once[0]),
            ("the same, G28 Z before the print", "G28 Z", once[0]),
            ("CALIBRATE_Z before the print", once[0], ""),
            ("G28 Z, CALIBRATE_Z before the print", once[1], ""),
        ):
            found = printed(host, minutes, script, early)
            show(
                f"{minutes:3d} min: {name:36} first layer {found.first_layer:+6.1f}"
                f"  later {found.later:+6.1f}"
            )
    for name, drift in (("plot", warming_up()), ("slow", SLOW)):
        for script in ("G4 P600000", *SCRIPTS):
            found = waited(host, drift, script)
            show(
                f"{name}: {script:34} {found.minutes:4.1f} min  first layer"
                f" {found.then.first_layer:+6.1f}  later {found.then.later:+6.1f}"
            )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
