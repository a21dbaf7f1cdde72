"""The command simprinter: real klippy on a simulated printer."""

from __future__ import annotations

import argparse
import shutil
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Optional

from . import __version__, printer_cfg, running, world_file
from .hosts import starting
from .options import EXPECTED, add_printer, host_of
from .plugin_printer import start
from .printer_cfg import PrinterCfgError


def main(arguments: Optional[Sequence[str]] = None) -> int:
    """Run the command; its exit status."""
    options = _parser().parse_args(arguments)
    try:
        return options.do(options) or 0
    except EXPECTED as error:
        sys.stderr.write(f"error: {error}\n")
        return 1
    finally:
        starting.close()


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser("simprinter", description=__doc__)
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")

    command = commands.add_parser(
        "run",
        help="run a G-code file and print the console and all contacts; exit"
        " status 1 after an error or a crash",
    )
    command.set_defaults(do=_run)
    command.add_argument("printer_cfg", type=Path, metavar="printer.cfg")
    command.add_argument("gcode", type=Path, metavar="commands.gcode")
    add_printer(command)

    command = commands.add_parser(
        "world", help="make a world file from a printer.cfg"
    )
    command.set_defaults(do=_world)
    command.add_argument(
        "printer_cfg", type=Path, nargs="?", metavar="printer.cfg"
    )
    command.add_argument(
        "--schema", action="store_true", help="print what a world file may hold"
    )

    command = commands.add_parser(
        "sample", help="write a printer.cfg and its world.toml to begin with"
    )
    command.set_defaults(do=_sample)
    command.add_argument("folder", type=Path, nargs="?", default=Path())
    return parser


def _run(options: argparse.Namespace) -> None:
    host = host_of(options)
    lines = options.gcode.read_text(encoding="utf-8").splitlines()
    running.show(f"{host.name} ({host.version})")
    with start(
        host,
        options.printer_cfg,
        options.world,
        options.extras,
        seed=options.seed,
    ) as printer:
        running.run(printer, lines)


def _world(options: argparse.Namespace) -> None:
    if options.schema:
        file = Path(world_file.__file__).with_name("world.schema.json")
        sys.stdout.write(file.read_text(encoding="utf-8"))
        return
    if options.printer_cfg is None:
        raise PrinterCfgError("name a printer.cfg, or give --schema")
    cfg = printer_cfg.read(options.printer_cfg)
    sys.stdout.write(world_file.made_from(cfg))


def _sample(options: argparse.Namespace) -> None:
    options.folder.mkdir(parents=True, exist_ok=True)
    for file in sorted(running.SAMPLE.iterdir()):
        target = options.folder / file.name
        if target.exists():
            raise PrinterCfgError(f"{target}: is there already; name a folder")
        shutil.copyfile(file, target)
        running.show(f"{target}")


if __name__ == "__main__":
    sys.exit(main())
