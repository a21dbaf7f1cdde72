"""Reports of printers on which something has happened, for the documents.

    python -m tools.gallery [--host NAME] [--folder DIR] [NAME ...]

Each is a printer as at home (simprinter/real.py) that is switched on, heated,
homed and calibrated on one day after the other, with a real klippy. Writes what
that has kept and drawn: report_NAME.jsonl and report_NAME.svg, into docs/.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Optional

from simprinter import (
    Fault,
    Machine,
    Scene,
    VirtualClock,
    build_directory,
    heated,
)
from simprinter.clock import WALL_START_NS
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError, LiveSession
from simprinter.real import as_real
from simprinter.world import OozeSpec
from tools.kit.printer import (
    RunningPrinter,
    choose_host,
    dialect_of,
    module_files,
)
from tools.kit.scenes import SCENES, Sections
from z_touch.history import file, report

DOCS = Path(__file__).resolve().parents[2] / "docs"
# How the documents call it, and where it is at home
OWNER = "/home/pi/printer_data/config/printer.cfg"
WARM = "M140 S60\nM104 S150\nM190 S60\nM109 S150\nG28"
DAY_NS = 86_400 * 10**9
# mm by which the bed is elsewhere on another day (1 sigma) [estimate]
EACH_DAY = 0.004
# Of a script (printer seconds)
_LONGEST = 3600.0
# After some first layers
TUNED = {"switch_offset": "0.68"}


class Day(NamedTuple):
    """One run of klippy."""

    scene: Scene
    script: str = "CALIBRATE_Z"
    options: dict[str, Optional[str]] = {}
    faults: Iterable[Fault] = ()


def probe(scene: Scene, deeper: float, sigma: float) -> Scene:
    """Another switch in the probe: mm it triggers deeper, mm it varies by."""
    spec = scene.world.mag_probe
    assert spec is not None
    noise = replace(spec.noise, sigma=sigma)
    offset = spec.switch_offset - deeper
    worn = replace(spec, switch_offset=offset, noise=noise)
    return scene.with_world(mag_probe=worn)


def bed(scene: Scene, higher: float) -> Scene:
    """Another bed: mm higher."""
    spec = scene.world.bed
    return scene.with_world(bed=replace(spec, z0=spec.z0 + higher))


def good(day: int, scene: Scene) -> Day:
    """Nothing happens but what happens to everybody."""
    tuned = TUNED if day >= 4 else {}
    if day == 15:
        lost = [Fault("attach_fails")]
        return Day(scene, options=tuned, faults=lost)
    return Day(scene, options=tuned)


def dirt(day: int, scene: Scene) -> Day:
    """A drop of plastic stays below the nozzle, hard as it is cold."""
    if day == 23:
        return Day(scene.with_world(ooze=OozeSpec(0.04, kept=1.0)))
    return Day(scene)


def wear(day: int, scene: Scene) -> Day:
    """The probe's switch triggers deeper day by day, and varies more."""
    return Day(probe(scene, 0.0009 * day, 0.0014 + 0.0001 * day))


def plate(day: int, scene: Scene) -> Day:
    """Another plate, thicker by 0.12 mm."""
    return Day(bed(scene, 0.12) if day >= 20 else scene)


def accuracy(day: int, scene: Scene) -> Day:
    """The probe is seated anew in each cycle, elsewhere each time."""
    spec = scene.world.mag_probe
    assert spec is not None
    loose = scene.with_world(mag_probe=replace(spec, reseat=0.04))
    # All has grown by then
    return Day(loose, "G4 P1500000\nG28\nCALIBRATE_Z_ACCURACY")


# Days, and what happens on them
STORIES: dict[str, tuple[int, Callable[[int, Scene], Day]]] = {
    "good": (30, good),
    "dirt": (24, dirt),
    "wear": (45, wear),
    "plate": (27, plate),
    "accuracy": (1, accuracy),
}


def changes_of(day: Day, folder: Path) -> Sections:
    """To the scene's configuration."""
    options = {"history": str(folder), "samples": "3", **day.options}
    tolerance = {"samples_tolerance": "0.02", "samples_tolerance_retries": "3"}
    return {"z_calibration": options, "probe": tolerance}


def live(host: Host, day: Day, wall_ns: int, seed: int, place: Path) -> None:
    """Switch it on, calibrate, switch it off. place: of klippy's files."""
    clock = VirtualClock(build_directory(), wall_ns)
    dialect = dialect_of(host)
    machine = Machine(day.scene, seed, day.faults, clock, dialect)
    config = day.scene.config(
        machine.serials, changes_of(day, place / "history")
    )
    installed = host.install(module_files())

    def begin(machine: Machine) -> LiveSession:
        return LiveSession(installed, machine, config, place)

    with RunningPrinter(machine, begin) as printer:
        printer.session.require_ready()
        printer.run(WARM)
        # A run that is refused is part of the history
        with suppress(GcodeError):
            printer.session.run(day.script, _LONGEST)
        printer.session.wait(2.0)


def tell(name: str, host: Host, days: Optional[int] = None) -> list[bytes]:
    """The lines of a printer's history after all that happened to it."""
    count, story = STORIES[name]
    draw = random.Random(name)
    scene = as_real(heated(SCENES["cartesian"]))
    date = 0.7
    with tempfile.TemporaryDirectory(prefix="gallery-") as folder:
        place = Path(folder)
        count = count if days is None else days
        for number in range(count):
            here = bed(scene, draw.gauss(0.0, EACH_DAY))
            date += draw.choice((1, 1, 1, 2, 3)) + draw.uniform(-0.1, 0.1)
            wall_ns = WALL_START_NS + round(date * DAY_NS)
            live(host, story(number, here), wall_ns, number, place)
        lines = (place / "history" / file.FILE).read_bytes().splitlines()
    assert len(lines) == count
    return [at_home(line) for line in lines]


def at_home(line: bytes) -> bytes:
    """The same from the printer that the documents have."""
    record = {**json.loads(line), "printer": OWNER}
    return json.dumps(record, sort_keys=True).encode() + b"\n"


def draw(lines: Iterable[bytes]) -> str:
    """The report of such lines, with the hours of Greenwich."""
    before = os.environ.get("TZ")
    os.environ["TZ"] = "UTC"
    time.tzset()
    try:
        records = [file.parse(line) for line in lines]
        return report.svg(records, printer=OWNER)
    finally:
        os.environ.pop("TZ")
        if before is not None:
            os.environ["TZ"] = before
        time.tzset()


def main(words: Optional[Sequence[str]] = None) -> int:
    """Write the reports; the exit code."""
    parser = argparse.ArgumentParser(prog="python -m tools.gallery")
    parser.add_argument("names", metavar="NAME", nargs="*", help=str(STORIES))
    parser.add_argument("--host", metavar="NAME")
    parser.add_argument("--folder", type=Path, default=DOCS)
    arguments = parser.parse_args(words)
    host = choose_host(arguments.host)
    for name in arguments.names or STORIES:
        print(f"{name}: {STORIES[name][0]} days", flush=True)  # noqa: T201
        lines = tell(name, host)
        path = arguments.folder / f"report_{name}"
        path.with_suffix(".jsonl").write_bytes(b"".join(lines))
        path.with_suffix(".svg").write_text(draw(lines), encoding="ascii")
    return 0


if __name__ == "__main__":
    sys.exit(main())
