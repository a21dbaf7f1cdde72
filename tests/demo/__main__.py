"""A calibration to watch: real klippy on a simulated printer.

    python -m tests.demo [--host NAME] [--scene NAME] [--svg PATH] [--list]

Shows the console as klippy prints it, then what Z=0 was really worth before
and after, and draws what was measured. Every number comes from the run.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

from tests.demo.picture import Heights, draw
from tests.hostkit.environment import build_dir
from tests.hostkit.hosts import (
    Host,
    HostError,
    checkout_hosts,
    find_hosts,
    missing_hosts,
)
from tests.hostkit.printer import Printer, firmware_of
from tests.hostkit.session import GcodeError, SessionError
from tests.simprinter import SCENES, Scene
from tests.simprinter.clock import ClockError
from tests.simprinter.scenes import Sections
from tests.simprinter.simulation import SimulationError, Stopwatch
from tests.simprinter.world import CrashError

# How far (Z microsteps) the true gap may be off what the formula predicts
ALLOWED_MICROSTEPS = 2

# It is z_calibration that is shown
SHOWN = {
    name: scene
    for name, scene in SCENES.items()
    if "z_calibration" in scene.sections
}
TOUCHES = {
    "nozzle_pin": "nozzle on the pin",
    "body_pin": "switch body on the pin",
    "probe_bed": "probe on the bed",
    "nozzle_bed": "nozzle on the bed",
}


class ShownConsole:
    """Prints what klippy answers at the moment it does.

    Takes part in the simulation like an API client that only listens.
    """

    def __init__(self, lines: list[str]):
        """lines: the console, which grows."""
        self._lines = lines
        self._shown = len(lines)

    def fileno(self) -> int:
        """There is nothing to wait for."""
        return -1

    def pump(self) -> bool:
        """Print what is new. Nobody else has to be told."""
        for line in self._lines[self._shown :]:
            print(line, flush=True)
        self._shown = len(self._lines)
        return False

    def settled(self) -> bool:
        """Never holds up the time."""
        return True


class ShownPrinter(Printer):
    """A printer whose console is shown."""

    def show(self) -> None:
        """Show the console from now on."""
        console = ShownConsole(self.session.console)
        self.machine.simulation.peers.append(console)

    def run(self, script: str) -> list[str]:
        """Run G-code line by line, as typed."""
        answers = []
        for line in script.splitlines():
            print(f"> {line}", flush=True)
            answers += super().run(line)
        return answers


@dataclass(frozen=True)
class Outcome:
    """What one run has shown, mm and printer seconds.

    result: z_calibration's last_result; touches: of CALIBRATE_Z alone
    """

    result: dict[str, float]
    gap_before: float
    gap_after: float
    touches: Counter
    nearest: float
    calibrating: float


def rehearse(printer: ShownPrinter) -> Outcome:
    """Home, measure the gap, calibrate, measure again."""
    printer.show()
    printer.run("G28")
    print("--- how far from the bed is the nozzle at Z=0, really?", flush=True)
    gap_before = printer.gap()
    print("--- calibrate", flush=True)
    machine = printer.machine
    before = Counter(touch.site for touch in machine.truth.touches)
    watch = Stopwatch(machine.simulation)
    printer.run("CALIBRATE_Z")
    _, calibrating = watch.seconds()
    touches = Counter(touch.site for touch in machine.truth.touches) - before
    print("--- and how far is it now?", flush=True)
    gap_after = printer.gap()
    return Outcome(
        result=printer.status("z_calibration")["last_result"],
        gap_before=gap_before,
        gap_after=gap_after,
        touches=touches,
        nearest=machine.truth.min_gap,
        calibrating=calibrating,
    )


def verdict(gap: float, predicted: float, microstep: float) -> Optional[str]:
    """What is wrong with a gap (mm), None if it is as predicted."""
    allowed = ALLOWED_MICROSTEPS * microstep
    off = gap - predicted
    # The gap is a difference of heights: 1e-9 is for their rounding
    if abs(off) <= allowed + 1e-9:
        return None
    return (
        f"the true gap is {gap:.4f} mm, the formula predicts {predicted:.4f}"
        f" mm: {abs(off):.4f} mm too {'large' if off > 0 else 'small'},"
        f" {allowed:.4f} mm are allowed"
    )


def report(scene: Scene, outcome: Outcome) -> Optional[str]:
    """Print what came out; returns what is wrong with it, if anything."""
    microstep = scene.wiring.motors["z"].step_dist
    predicted = scene.formula_gap()
    configured = outcome.result["switch_offset"]
    problem = verdict(outcome.gap_after, predicted, microstep)
    x, y = (option.strip() for option in _bed_point(scene).split(","))
    print(f"\nTrue nozzle-to-bed gap at G-code Z=0, over X{x} Y{y}")
    side = "  (inside the bed)" if outcome.gap_before < 0 else ""
    print(f"  before      {outcome.gap_before:+.4f} mm{side}")
    print(f"  after       {outcome.gap_after:+.4f} mm")
    print(
        f"  predicted   {predicted:+.4f} mm  (this switch's real"
        f" {configured + predicted:.3f} - switch_offset {configured:.3f})"
    )
    if problem is None:
        print(
            f"  OK: after and predicted differ by"
            f" {abs(outcome.gap_after - predicted):.4f} mm;"
            f" {ALLOWED_MICROSTEPS * microstep:.4f} mm"
            f" ({ALLOWED_MICROSTEPS} microsteps) are allowed"
        )
    print("\nTouches during CALIBRATE_Z")
    for site, words in TOUCHES.items():
        print(f"  {words:24}{outcome.touches[site]}")
    print(
        f"  nearest the nozzle ever came to the bed: {outcome.nearest:.3f} mm"
    )
    return problem


def demonstrate(
    host: Host,
    scene: Scene,
    svg: Path,
    changes: Optional[Sections] = None,
) -> int:
    """Run the demo on a host; the exit code.

    changes: to the scene's configuration, see Scene.config.
    """
    print(f"Host     {host.name}: {firmware_of(host)}, version {host.version}")
    print(f"Printer  {scene.name}: {scene.kinematics}, simulated\n")
    print("Console (> is typed, // and !! is what klippy answers)", flush=True)
    with ShownPrinter(host, scene, changes) as printer:
        watch = Stopwatch(printer.machine.simulation)
        printer.session.require_ready()
        outcome = rehearse(printer)
        real, virtual = watch.seconds()
    problem = report(scene, outcome)
    print(
        f"\nTime     CALIBRATE_Z {outcome.calibrating:.1f} printer seconds; all"
        f" {virtual:.1f} in {real:.1f} real seconds,"
        f" {virtual / real:.0f} times as fast"
    )
    svg.parent.mkdir(parents=True, exist_ok=True)
    svg.write_text(draw(heights(host, scene, outcome)), encoding="utf-8")
    print(f"Picture  {_shown_path(svg)}")
    if problem is not None:
        print(f"\nFAILED: {problem}")
        return 1
    return 0


def heights(host: Host, scene: Scene, outcome: Outcome) -> Heights:
    """What the picture shows."""
    result = outcome.result
    return Heights(
        title="Z offset calibration, drawn from a run on a simulated printer",
        subtitle=(
            f"{firmware_of(host)} {host.version} ({host.name}) on the"
            f" {scene.kinematics} machine '{scene.name}'; all heights to scale,"
            " measured at the moment of the touch"
        ),
        nozzle=result["nozzle"],
        switch=result["switch"],
        probe=result["probe"],
        switch_offset=result["switch_offset"],
        offset=result["offset"],
        gap_before=outcome.gap_before,
        gap_after=outcome.gap_after,
        predicted=scene.formula_gap(),
    )


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
    reasons = [text for key, text in missing_hosts().items() if key == name]
    raise HostError(
        reasons[0]
        if reasons
        else f"there is no host {name!r}, only {_names(hosts)}"
    )


def _names(hosts: Sequence[Host]) -> str:
    return ", ".join(host.name for host in hosts)


def _bed_point(scene: Scene) -> str:
    section: Any = scene.sections["z_calibration"]
    return section["bed_xy_position"]


def _shown_path(path: Path) -> str:
    """Relative where that is shorter."""
    try:
        return str(path.resolve().relative_to(Path.cwd()))
    except ValueError:
        return str(path)


def _arguments(words: Optional[Sequence[str]]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tests.demo",
        description="CALIBRATE_Z by real klippy on a simulated printer",
    )
    parser.add_argument("--host", metavar="NAME", help="klippy to run")
    parser.add_argument(
        "--scene",
        metavar="NAME",
        choices=sorted(SHOWN),
        default="voron",
        help=f"simulated machine: {', '.join(sorted(SHOWN))}",
    )
    parser.add_argument(
        "--svg",
        metavar="PATH",
        type=Path,
        help="where the picture goes (demo/calibration.svg in BUILD_DIR)",
    )
    parser.add_argument(
        "--list", action="store_true", help="show hosts and scenes only"
    )
    return parser.parse_args(words)


def _list() -> int:
    os.environ.setdefault("ALLOW_MISSING_HOSTS", "1")
    for host in find_hosts():
        print(f"host   {host.name}: {firmware_of(host)} {host.version}")
    for scene in SHOWN.values():
        print(f"scene  {scene.name}: {scene.kinematics}")
    return 0


def main(words: Optional[Sequence[str]] = None) -> int:
    """Run the demo; the exit code."""
    arguments = _arguments(words)
    try:
        print("Preparing (the first time takes a minute) ...", flush=True)
        if arguments.list:
            return _list()
        svg = arguments.svg or build_dir() / "demo" / "calibration.svg"
        host = choose_host(arguments.host)
        return demonstrate(host, SHOWN[arguments.scene], svg)
    except GcodeError as error:
        print(f"!! {error}")
    except CrashError as error:
        print(f"\nFAILED: {error}")
    except (
        ClockError,
        HostError,
        OSError,
        SessionError,
        SimulationError,
    ) as error:
        print(f"error: {error}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
