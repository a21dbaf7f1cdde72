"""Prints of the virtual card."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any


def of_card(folder: Path, lines: Iterable[str]) -> dict[str, Any]:
    """What printer.cfg needs for a print of these lines, which is print.gcode."""
    (folder / "print.gcode").write_text("\n".join([*lines, ""]))
    return {"virtual_sdcard": {"path": str(folder)}}
