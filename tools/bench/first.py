"""What the first real printer may compare its figures with.

    python -m tools.bench.first [--printers 20] [--host NAME]

Each printer is the voron scene as printers are at home (simprinter/real.py), with
another plate and other noise, switched on twenty minutes before.  On each the lines of
docs/first_real_printer.md are run.  Shown are the median and the extremes of what the
console says, and what it cannot know: by how much the true gap is off.
"""

from __future__ import annotations

import argparse
import re
import statistics
import sys
from collections.abc import Iterable, Sequence

from simprinter.hosts.hosts import Host
from simprinter.real import as_real
from tools.bench.errors import UM
from tools.kit.printer import Printer, choose_host
from tools.kit.scenes import SCENES

WARM = 1200.0
COMMANDS = (
    "PROBE_ACCURACY",
    "PROBE_Z_ACCURACY",
    "CALIBRATE_Z",
    "CALIBRATE_Z",
    "CALIBRATE_Z_ACCURACY CYCLES=6",
)
IDLE = {"idle_timeout": {"timeout": "14400"}}


def number(pattern: str, lines: Iterable[str]) -> float:
    """The first number that a pattern finds in what the console says."""
    return float(re.search(pattern, "\n".join(lines))[1])


def figures(host: Host, seed: int) -> dict[str, float]:
    """What is seen on one printer: mm and seconds."""
    scene = as_real(SCENES["voron"], seed)
    changes = {"z_calibration": {"samples": "auto"}, **IDLE}
    with Printer(host, scene, changes, seed=seed) as printer:
        clock = printer.machine.simulation.clock
        printer.homed()
        printer.session.wait(WARM)
        printer.run("G28\nG1 Z20 F900\nG1 X152 Y125.25 F6000")
        found: dict[str, float] = {}
        said: dict[str, list[str]] = {}
        offsets = []
        for command in COMMANDS:
            began = clock.now()
            lines = said[command] = printer.run(command)
            if command == "CALIBRATE_Z":
                found["seconds"] = (clock.now() - began) * 1e-9
                offsets.append(number(r"new offset=(\S+)", lines))
                found["gap"] = printer.gap() - printer.scene.formula_gap()
            if command == "PROBE_ACCURACY":
                printer.run("G1 Z20 F900")
        found["probe"] = number(r"range ([\d.]+)", said["PROBE_ACCURACY"])
        found["pin"] = number(r"range ([\d.]+)", said["PROBE_Z_ACCURACY"])
        found["+-"] = number(r"\+-([\d.]+) mm", said["CALIBRATE_Z"])
        found["apart"] = abs(offsets[1] - offsets[0])
        report = said[COMMANDS[-1]]
        whole = r"ACCURACY: offset: .*%s ([\d.]+)"
        found["sigma"] = number(whole % "deviation", report)
        found["range"] = number(whole % "range", report)
        found["drift"] = abs(number(r"ACCURACY: offset: .*drift (\S+)", report))
        found["one run"] = number(r"one CALIBRATE_Z: \+-([\d.]+)", report)
        return found


def main(words: Sequence[str]) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m tools.bench.first")
    parser.add_argument("--printers", type=int, default=20)
    parser.add_argument("--host", metavar="NAME", help="klippy to run")
    given = parser.parse_args(words)
    host = choose_host(given.host)
    rows = [figures(host, seed) for seed in range(1, given.printers + 1)]
    for name in rows[0]:
        values = sorted(row[name] for row in rows)
        unit, scale = ("s", 1.0) if name == "seconds" else ("um", UM)
        low, high = (values[i] * scale for i in (0, -1))
        middle = statistics.median(values) * scale
        sys.stdout.write(
            f"{name:8} {middle:7.1f} {unit} ({low:.1f} to {high:.1f})\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
