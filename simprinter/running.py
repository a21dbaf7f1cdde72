"""simprinter run: a G-code file, and what comes of it."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from .plugin_printer import PluginPrinter
from .shown import Shown

SAMPLE = Path(__file__).with_name("sample")
# Printer seconds that a line of G-code may take
LINE_LIMIT = 3600.0


def show(line: str) -> None:
    """On the terminal, at once."""
    sys.stdout.write(f"{line}\n")
    sys.stdout.flush()


def run(printer: PluginPrinter, lines: Iterable[str]) -> None:
    """Run G-code line by line as typed, and show what comes of it.

    Raises GcodeError with klippy's words at the first that fails, CrashError
    where the machine was hurt.
    """
    machine = printer.machine
    console = Shown(printer.console, show, machine.world.truth)
    machine.simulation.peers.append(console)
    for line in map(str.strip, lines):
        if line and not line.startswith(";"):
            show(f"> {line}")
            printer.session.run(line, LINE_LIMIT)
    # What is under way ends, and what it has touched is known
    printer.session.run("M400", LINE_LIMIT)
    truth = printer.truth
    console.pump()
    truth.require_no_crash()
