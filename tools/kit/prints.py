"""A print of the card that stands still."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from tools.kit.printer import Printer


def paused(start: Callable[..., Printer], folder: Path, *scene: Any) -> Printer:
    """A homed printer, and a print on it that PAUSE has stopped."""
    (folder / "a.gcode").write_text("G4 P1000\n" * 9)
    card = {"virtual_sdcard": {"path": str(folder)}}
    printer = start(*scene, changes={**card, "pause_resume": {}}).homed()
    for command in ("SDCARD_PRINT_FILE FILENAME=a.gcode", "PAUSE"):
        printer.run(command)
        printer.session.wait(2.0)
    return printer
