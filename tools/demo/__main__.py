"""A calibration to watch: real klippy on a simulated printer.

    python -m tools.demo [--host NAME] [--scene NAME]

Shows the console as klippy prints it, then what Z=0 was really worth before
and after. Every number comes from the run.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple, Optional

from simprinter import Scene
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError
from simprinter.running import show
from simprinter.shown import Shown
from simprinter.simulation import Stopwatch
from simprinter.world import CrashError
from tools.kit.printer import (
    NO_PRINTER,
    Printer,
    choose_host,
    firmware_of,
)
from tools.kit.scenes import SCENES, Sections

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


class ShownPrinter(Printer):
    """A printer whose console is shown."""

    def show(self) -> None:
        """Show the console from now on."""
        console = Shown(self.session.console, show)
        self.machine.simulation.peers.append(console)

    def run(self, script: str) -> list[str]:
        """Run G-code line by line, as typed."""
        answers = []
        for line in script.splitlines():
            show(f"> {line}")
            answers += super().run(line)
        return answers


class Outcome(NamedTuple):
    """What one run has shown, mm and printer seconds.

    result: last_result of the module. touches: by site, of CALIBRATE_Z alone.
    """

    result: dict[str, float]
    before: float
    after: float
    touches: Counter
    calibrating: float


def rehearse(printer: ShownPrinter) -> Outcome:
    """Home, measure the gap, calibrate, measure again."""
    printer.show()
    printer.run("G28")
    show("--- how far from the bed is the nozzle at Z=0, really?")
    before = printer.gap()
    show("--- calibrate")
    truth = printer.machine.truth
    count = len(truth.touches)
    watch = Stopwatch(printer.machine.simulation)
    printer.run("CALIBRATE_Z")
    _, calibrating = watch.seconds()
    touches = Counter(touch.site for touch in truth.touches[count:])
    show("--- and how far is it now?")
    after = printer.gap()
    result = printer.status("z_calibration")["last_result"]
    return Outcome(result, before, after, touches, calibrating)


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


def report(printer: ShownPrinter, outcome: Outcome) -> Optional[str]:
    """Print what came out; returns what is wrong with it, if anything."""
    scene = printer.scene
    microstep = scene.wiring.motors["z"].step_dist
    predicted = scene.formula_gap()
    configured = outcome.result["switch_offset"]
    problem = verdict(outcome.after, predicted, microstep)
    x, y = printer.bed_point()
    inside = "  (inside the bed)" if outcome.before < 0 else ""
    print(
        f"\nTrue nozzle-to-bed gap at G-code Z=0, over X{x:g} Y{y:g}\n"
        f"  before      {outcome.before:+.4f} mm{inside}\n"
        f"  after       {outcome.after:+.4f} mm\n"
        f"  predicted   {predicted:+.4f} mm  (this switch's real"
        f" {configured + predicted:.3f} - switch_offset {configured:.3f})"
    )
    if problem is None:
        print(
            f"  OK: after and predicted differ by"
            f" {abs(outcome.after - predicted):.4f} mm;"
            f" {ALLOWED_MICROSTEPS * microstep:.4f} mm"
            f" ({ALLOWED_MICROSTEPS} microsteps) are allowed"
        )
    print("\nTouches during CALIBRATE_Z")
    for site, words in TOUCHES.items():
        print(f"  {words:24}{outcome.touches[site]}")
    nearest = printer.machine.truth.min_gap
    print(f"  nearest the nozzle ever came to the bed: {nearest:.3f} mm")
    return problem


def demonstrate(
    host: Host,
    scene: Scene,
    changes: Optional[Sections] = None,
) -> int:
    """Run the demo on a host; the exit code.

    changes: to the scene's configuration, see Scene.config.
    """
    klippy = f"{firmware_of(host)} {host.version}"
    print(f"Host     {host.name}: {klippy}")
    print(f"Printer  {scene.name}: {scene.kinematics}, simulated\n")
    show("Console (> is typed, // and !! is what klippy answers)")
    with ShownPrinter(host, scene, changes) as printer:
        watch = Stopwatch(printer.machine.simulation)
        printer.session.require_ready()
        outcome = rehearse(printer)
        real, virtual = watch.seconds()
    problem = report(printer, outcome)
    print(
        f"\nTime     CALIBRATE_Z {outcome.calibrating:.1f} printer seconds; all"
        f" {virtual:.1f} in {real:.1f} real seconds,"
        f" {virtual / real:.0f} times as fast"
    )
    if problem is not None:
        print(f"\nFAILED: {problem}")
        return 1
    return 0


def _arguments(words: Optional[Sequence[str]]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="python -m tools.demo",
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
    return parser.parse_args(words)


def main(words: Optional[Sequence[str]] = None) -> int:
    """Run the demo; the exit code."""
    arguments = _arguments(words)
    try:
        show("Preparing (the first time takes a minute) ...")
        host = choose_host(arguments.host)
        return demonstrate(host, SHOWN[arguments.scene])
    except GcodeError as error:
        print(f"!! {error}")
    except CrashError as error:
        print(f"\nFAILED: {error}")
    except NO_PRINTER as error:
        print(f"error: {error}", file=sys.stderr)
    return 1


if __name__ == "__main__":
    sys.exit(main())
