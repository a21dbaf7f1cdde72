"""Prints from the virtual card: PRINT_START as our documents have it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Optional

from tools.kit.printer import ROOT

if TYPE_CHECKING:
    from tools.campaign.drawn.printers import Owned

FILE = "layer.gcode"
# The document of each section that makes Z=0 right, the first that a printer has
PAGES = {"z_calibration": "setup", "auto_z_offset": "auto_z_offset"}
LEVEL = {"quad_gantry_level": "QUAD_GANTRY_LEVEL", "z_tilt": "Z_TILT_ADJUST"}
_MACRO = re.compile(r"\[gcode_macro PRINT_START\]\ngcode:\n((?:    .*\n)+)")


@lru_cache(maxsize=None)
def _written(page: str) -> tuple[str, ...]:
    """The lines of that document's macro, without what it says of them."""
    text = (ROOT / "docs" / f"{page}.md").read_text()
    found = _MACRO.search(text)
    assert found is not None, f"docs/{page}.md has no PRINT_START"
    lines = (line.split("#")[0].strip() for line in found.group(1).splitlines())
    return tuple(filter(None, lines))


def can_print(printer: Owned) -> bool:
    """Whether it has a card, Z=0 is made right, and no probe is in the way."""
    probe = printer.scene.world.mag_probe
    is_in_the_way = probe is not None and probe.mode == "fixed"
    is_right = printer.has("z_calibration") or (
        printer.has("auto_z_offset") and not _loses_correction(printer)
    )
    return "card" in printer.names and is_right and not is_in_the_way


def _loses_correction(printer: Owned) -> bool:
    """A mesh with a zero takes nothing off where a switch homes Z: it is told."""
    sections = printer.scene.sections
    axis = sections.get("carriage z") or sections.get("stepper_z") or {}
    is_switch = axis.get("endstop_pin") != "probe:z_virtual_endstop"
    return is_switch and "mesh_zero" in printer.names


def macros(printer: Owned) -> dict[str, dict[str, Optional[str]]]:
    """The sections with them."""
    return {
        "gcode_macro PRINT_START": {
            "gcode": "".join(f"\n  {line}" for line in _start(printer))
        }
    }


def _start(printer: Owned) -> Iterator[str]:
    page = next((p for s, p in PAGES.items() if printer.has(s)), None)
    for line in _written(page) if page else ("G28",):
        yield from _fitted(line, printer)


def _fitted(line: str, printer: Owned) -> Iterator[str]:
    """What the owner makes of it who has no such thing, or another one."""
    name = line.split()[0]
    scene = printer.scene
    probe = scene.world.mag_probe
    # Klipper does not know of a probe that macros bring
    probes = probe is None or probe.mode != "output"
    if name == "QUAD_GANTRY_LEVEL":
        yield from (c for s, c in LEVEL.items() if s in scene.sections)
    elif name.startswith("BED_MESH"):
        has_mesh = {"mesh", "mesh_zero"} & printer.names
        if probes and (has_mesh or "bed_mesh" in scene.sections):
            yield "BED_MESH_CLEAR" if "CLEAR" in name else "BED_MESH_CALIBRATE"
    elif name in ("M109", "M190"):
        if "hot" in printer.names:
            yield line
    elif name != "CLEAN_NOZZLE":
        yield line


def write(folder: Path, layer: str) -> None:
    """The file of a print that is this first layer."""
    start = "PRINT_START BED_TEMP=50 EXTRUDER_TEMP=170\n"
    (folder / FILE).write_text(f"{start}{layer}\nG92 E0\n")
