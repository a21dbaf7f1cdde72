"""What of a module each of its commands runs through: make shape.

    python -m tools.shape [--json FILE] [NAME=FILE ...]

runs each command once, as tests/quick does, on real klippy, and prints how many
functions of ours it runs through, in how many files and calls, and how many of
their frames are at most above a probing move ("-": it makes none). NAME=FILE:
the same four of another module, such as z_calibration=~/other/z_calibration.py.
--json: the rows are written there, too, for docs/developing.md.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from simprinter.hosts.api import ApiError
from simprinter.hosts.hosts import Host, HostError, main_host
from simprinter.hosts.session import GcodeError, SessionError
from simprinter.simulation import SimulationError
from simprinter.world import CrashError
from tests.quick import runs as quick
from tests.quick import test_auto_z_offset_quick as auto_z_offset
from tests.quick import test_dockable_probe_quick as dockable_probe
from tests.quick import test_extra_probe_quick as extra_probe
from tests.quick import test_z_calibration_quick as z_calibration
from tools.kit.printer import (
    FOLDER,
    MODULES,
    Printer,
    given_module,
    module_files,
)
from tools.kit.tables import markdown

EXTRA = Path(quick.EXTRA).with_name("shape.py")
HEADS = ("functions", "files", "calls", "frames")
# What SHAPE has counted, by command
Shapes = dict[str, dict[str, int]]


class Case(NamedTuple):
    """A printer, and what is run on it."""

    scene: Any
    changes: Mapping[str, Any]
    runs: Sequence[quick.Run]


def counted(runs: Sequence[quick.Run]) -> list[quick.Run]:
    """The same, of each its last line, the command, counted."""
    found = []
    for run in runs:
        before, _, command = run.script.rpartition("\n")
        found.append(run._replace(script=f'{before}\nSHAPE RUN="{command}"'))
    return found


# Nowhere else that command goes well
KEPT = z_calibration.section(offset_gcode="SHAPE RUN=Z_CALIBRATION_KEEP_OFFSET")
# Others take no fewer samples
THREE = {"auto_z_offset": {"samples": "3"}, **auto_z_offset.TWISTED}
DOCKED = {
    **dockable_probe.section(**dockable_probe.QUICK),
    **dockable_probe.WITHOUT_TWIST,
}
CASES = {
    "z_calibration": (
        Case(z_calibration.HEATED, {}, counted(z_calibration.GOOD)),
        Case("voron", KEPT, [quick.Run("CALIBRATE_Z", "")]),
    ),
    "auto_z_offset": (
        Case("qidi", THREE, counted(auto_z_offset.GOOD + auto_z_offset.LAST)),
    ),
    "dockable_probe": (
        Case(dockable_probe.GANTRY, DOCKED, counted(dockable_probe.GOOD)),
    ),
    "extra_probe": (Case("membrane", {}, counted(extra_probe.GOOD)),),
}
# Of the host, and looked at by ours
GUARDED = (
    z_calibration.GUARDED
    | auto_z_offset.GUARDED
    | dockable_probe.GUARDED
    | extra_probe.GUARDED
)


def started(
    host: Host, case: Case, modules: Mapping[str, Path], names: Sequence[str]
) -> Printer:
    """A homed printer that counts what is in `names`."""
    return Printer(
        host,
        case.scene,
        {**case.changes, "commands": {}, "shape": {"modules": ",".join(names)}},
        modules={**modules, "commands": quick.EXTRA, "shape": EXTRA},
    ).homed()


def shapes(printer: Printer) -> Shapes:
    """What was counted of each command."""
    return printer.status("shape")["shapes"]


def ours(host: Host, module: str) -> Shapes:
    """Of all commands of a module; raises LookupError for one without a run."""
    found: Shapes = {}
    commands: set[str] = set()
    for case in CASES[module]:
        names = [module, FOLDER]
        with started(host, case, module_files(), names) as printer:
            quick.go_well(printer, case.runs)
            found.update(shapes(printer))
            commands |= quick.ours(printer)
    missing = commands - GUARDED - {*found}
    if missing:
        raise LookupError(f"tests/quick has no good run of {sorted(missing)}")
    return found


# What another module may lead to
FAILURES = (
    ApiError,
    CrashError,
    GcodeError,
    HostError,
    OSError,
    SessionError,
    SimulationError,
)
# Of a module that has fewer options than ours
UNKNOWN = re.compile(r"Option '(\w+)' is not valid in section '([\w ]+)'")


def others(host: Host, module: str, file: Path) -> tuple[Shapes, list[str]]:
    """Of another module of that name; why what does not run does not."""
    found: Shapes = {}
    reasons: list[str] = []
    cases = [*CASES[module]]
    while cases:
        case = cases.pop()
        files = given_module(module, file)
        try:
            with started(host, case, files, [*files]) as printer:
                reasons += refused(printer, case.runs)
                found.update(shapes(printer))
        except FAILURES as error:
            unknown = UNKNOWN.search(str(error))
            if unknown is None:
                reasons.append(reason(error))
                continue
            option, section = unknown.groups()
            less = {**case.changes.get(section, {}), option: None}
            changes = {**case.changes, section: less}
            cases.append(case._replace(changes=changes))
    return found, reasons


def reason(error: Exception) -> str:
    """What an error says, without what klippy's log has to add."""
    lines = str(error).strip().splitlines() or [repr(error)]
    if lines[0].endswith(":"):
        return " ".join(line.strip() for line in lines[:2])
    return lines[0]


def refused(printer: Printer, runs: Sequence[quick.Run]) -> list[str]:
    """Run them; what those say that fail."""
    reasons = []
    for run in runs:
        if run.before is not None:
            run.before(printer)
        try:
            printer.run(run.script)
        except GcodeError as error:
            reasons.append(f"{run.script.strip()}: {reason(error)}")
    return reasons


def cells(shape: Mapping[str, int]) -> list[str]:
    """Of a table; "-" where it never probes, and for what there is not."""
    return [str(shape.get(head) or "-") for head in HEADS]


def parse(arguments: Sequence[str]) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m tools.shape")
    parser.add_argument("--json", type=Path, help="write the rows there")
    parser.add_argument(
        "others", nargs="*", metavar="NAME=FILE", help="other modules"
    )
    options = parser.parse_args(arguments)
    options.others = dict(one.partition("=")[::2] for one in options.others)
    if {*options.others} - {*MODULES}:
        parser.error(f"NAME=FILE, where NAME is one of {', '.join(MODULES)}")
    return options


def main(arguments: Sequence[str]) -> None:
    """Print a table of all commands, and what of other modules does not run."""
    options = parse(arguments)
    host, rows, told = main_host(), [], []
    for module in MODULES:
        theirs: Shapes = {}
        if module in options.others:
            file = Path(options.others[module]).expanduser()
            theirs, reasons = others(host, module, file)
            told += [f"{file}: {reason}" for reason in reasons]
        for name, shape in sorted(ours(host, module).items()):
            other = " ".join(cells(theirs.get(name, {})))
            rows.append([module, name, *cells(shape), other])
    if options.json:
        options.json.write_text(
            json.dumps({"host": host.name, "rows": rows}, indent=1) + "\n"
        )
    print(host.name, table(rows), *told, sep="\n")  # noqa: T201


def table(rows: Sequence[Sequence[str]]) -> str:
    """As Markdown."""
    return markdown(["module", "command", *HEADS, "the other's"], rows)


def render(file: str) -> str:
    """For a document: the commands of a file of --json that others have, too."""
    shapes = json.loads(Path(file).read_text(encoding="utf-8"))
    rows = [row for row in shapes["rows"] if row[-1].strip(" -")]
    return f"\nOn {shapes['host']}.\n\n{table(rows)}\n"


if __name__ == "__main__":
    main(sys.argv[1:])
