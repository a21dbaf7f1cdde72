"""The programs that the user has built, each host's own, and printers on it."""

from __future__ import annotations

import functools
import math
import os
import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, Optional

from simprinter import Fault, Machine, Scene, build_directory
from simprinter.firmware import (
    DataDictionary,
    data_dictionary,
    gpio_names,
)
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError, LiveSession
from tools.campaign.jobs import JOBS
from tools.kit import extra_probe
from tools.kit.printer import (
    Printer,
    RunningPrinter,
    firmware_of,
    has_kinematics,
    module_files,
)
from tools.kit.scenes import SCENES, Sections

NOT_GIVEN = (
    "no micro-controller program is given: make test-firmware"
    " FIRMWARE=~/klipper/out/klipper.elf"
)


def given() -> list[Path]:
    """The programs that FIRMWARE names, separated by colons."""
    entries = os.environ.get("FIRMWARE", "").split(":")
    return [Path(entry).expanduser().resolve() for entry in entries if entry]


def dictionary(program: Path) -> DataDictionary:
    """What a program says of itself."""
    return data_dictionary(program, build_directory())


def program_for(host: Host) -> Optional[Path]:
    """The program of the host's own version, else the first it speaks with."""
    programs = sorted(given(), key=lambda one: not _is_own(one, host))
    return next((p for p in programs if not why_not(host, p)), None)


@functools.cache
def why_not(host: Host, program: Path) -> str:
    """What a host says of a program that it does not speak with, or nothing."""
    app = dictionary(program).app
    if app != firmware_of(host):
        return f"it is of {app}"
    scene = RUNS["CALIBRATE_Z"].scene
    with FirmwarePrinter(host, scene, program=program) as printer:
        if printer.session.start()[0] == "ready":
            return ""
        # What is shown is of all protocol errors the same
        return re.findall(r"\berror: (mcu .*)", printer.session.log())[-1]


def _is_own(program: Path, host: Host) -> bool:
    version = dictionary(program).version
    # 283 commits after a release: what packages call .dev283
    commits = f"{version}-".split("-")[1]
    described = re.sub(r"-0-g\w+|-dirty.*", "", version)
    return described == host.version or host.version.endswith(f".dev{commits}")


class FirmwarePrinter(RunningPrinter):
    """A printer as Printer, with a program in place of each board."""

    def __init__(
        self,
        host: Host,
        scene: Scene,
        changes: Optional[Sections] = None,
        faults: Iterable[Fault] = (),
        program: Optional[Path] = None,
    ):
        """program: without one the host's own."""
        program = program or program_for(host)
        assert program is not None
        installed = host.install(module_files())
        machine = Machine(scene, faults=faults, firmware=program)
        config = gpio_names(scene.config(machine.serials, changes))
        super().__init__(
            machine, lambda machine: LiveSession(installed, machine, config)
        )


class Run(NamedTuple):
    """What is run on both; name: of the command, or of a scene."""

    name: str
    scene: Scene
    script: str
    changes: Sections


def has_drivers(scene: Scene) -> bool:
    """Whether motors hang on drivers that klippy speaks to."""
    return any(motor.uart for motor in scene.wiring.motors.values())


def _commands() -> Iterator[Run]:
    """Every command of the campaign that needs no drivers."""
    for job in JOBS.values():
        if not has_drivers(job.scene):
            script = "\n".join(("G28", job.before, job.script, "M400"))
            yield Run(job.name, job.scene, script, job.changes)


# What a scene's module does, by its section
_SCRIPTS = {
    "z_calibration": "CALIBRATE_Z",
    "auto_z_offset": "AUTO_Z_CALIBRATE",
    extra_probe.NAME: "\n".join(
        # No hand is there to press it
        (f"{extra_probe.CALIBRATE} FLOOR=-1",) + 2 * (extra_probe.CONTINUE,)
    ),
}


def _scenes() -> Iterator[Run]:
    """Every scene without drivers, its module's own command."""
    for name, scene in SCENES.items():
        if has_drivers(scene):
            continue
        if scene.world.membrane is not None:
            scene = extra_probe.membrane(name, laid=True)
        (script,) = (_SCRIPTS[s] for s in _SCRIPTS if s in scene.sections)
        yield Run(
            f"{name}: {script.split()[0]}", scene, f"G28\n{script}\nM400", {}
        )


RUNS = {run.name: run for run in (*_commands(), *_scenes())}


MICROSTEP = 0.0025
# Not all of it is what a healthy printer does: a dead switch is pressed far
_FAR = 10.0
_SITES = ("body_bed", "body_pin", "nozzle_bed", "nozzle_pin", "probe_bed")


class Record(NamedTuple):
    """What a run has come to, exactly.

    lines: on the console, with every height, and the error. touches: where and
    at which height (mm) each site was pressed. steps: of each motor at the
    end.
    """

    lines: list[str]
    touches: list[tuple[str, float]]
    steps: dict[str, int]
    offset: float


def record(printer: RunningPrinter, script: str) -> Record:
    """Run it."""
    machine, session = printer.machine, printer.session
    for site in (*_SITES, "nozzle_membrane") if machine.faults else ():
        machine.tolerate(site, _FAR)
    session.require_ready()
    before, end = len(session.console), []
    try:
        printer.run(script)
    except GcodeError as error:
        end = [f"!! {error}"]
    if session.state()[0] == "ready":
        # A refused command may still lift the toolhead
        printer.run("M400")
    session.wait(0.5)
    return Record(
        # Messages name pins, which have other names on a program
        [gpio_names(line) for line in (*session.console[before:], *end)],
        [(touch.site, touch.trigger_z) for touch in machine.truth.touches],
        {name: axis.track.position for name, axis in machine.rig.axes.items()},
        printer.offset(),
    )


def both(
    host: Host, run: Run, faults: Iterable[Fault] = ()
) -> tuple[Record, Record]:
    """On our own board, and on the host's program."""
    records = []
    for kind in (Printer, FirmwarePrinter):
        with kind(host, run.scene, run.changes, faults) as printer:
            records.append(record(printer, run.script))
    return records[0], records[1]


_NUMBER = re.compile(r"-?\d+\.\d+")


def difference(own: Record, real: Record) -> float:
    """By how much (mm) a height or a motor's end differs at most.

    Infinity if anything else does.
    """
    texts = [[_NUMBER.sub("#", line) for line in r.lines] for r in (own, real)]
    places = [[site for site, _ in r.touches] for r in (own, real)]
    steps = [abs(own.steps[name] - real.steps[name]) for name in own.steps]
    if texts[0] != texts[1] or places[0] != places[1]:
        return math.inf
    pairs = zip(_heights(own), _heights(real))
    return max(max(steps) * MICROSTEP, *(abs(a - b) for a, b in pairs))


def _heights(found: Record) -> list[float]:
    told = [float(n) for line in found.lines for n in _NUMBER.findall(line)]
    return [*told, *(z for _, z in found.touches), found.offset]


def allowed(run: Run) -> float:
    """How much they may differ, mm.

    Of two boards the host guesses how far apart their clocks are: what stops
    the motors of another one may fall on the other side of a step.
    """
    return 0.0 if not run.scene.wiring.boards else MICROSTEP + 1e-6


def compare(host: Host, name: str) -> str:
    """How many touches, and by how much heights differ, um."""
    run = RUNS[name]
    if not has_kinematics(host, run.scene):
        return "-"
    own, real = both(host, run)
    off = difference(own, real)
    mark = "" if off <= allowed(run) else " WRONG"
    return f"{len(own.touches)}: {off * 1e3:g}{mark}"
