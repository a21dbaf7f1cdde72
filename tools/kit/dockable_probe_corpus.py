"""Simulated machines out of real [dockable_probe] sections."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

from simprinter import Scene
from simprinter.world import AxisSwitchSpec, DockSpec, Pose
from tools.kit.docks import DOCK_SCENES
from tools.kit.z_calibration_corpus import indented

ENTRIES = json.loads(
    (
        Path(__file__).parents[2] / "tests" / "corpus" / "dockable_probe.json"
    ).read_text()
)
# What is wrong with the others, as klippy says it
BROKEN = {
    16: "dock_position",
    17: "set dock_fixed_z: True if the dock is at the toolhead's height",
    18: "'approach_position' in section 'dockable_probe' (47, 231) is at",
    22: "z_offset",
    24: "z_offset",
    25: "pin",
    26: "z_offset",
    27: "probe",
    30: "set dock_fixed_z: True if the dock is at the toolhead's height",
    32: "approach_position",
}
# What the messages of some advise, which has to lead to a printer that works
ADVISED = {17: {"dock_fixed_z": "True"}, 30: {"dock_fixed_z": "True"}}
# Partial ones, as the rest of them stands in another file
COMPLETED = {23: {"z_offset": "6.9"}, 0: {"z_offset": "6.9"}}


def places(options: dict[str, str]) -> dict[str, tuple[float, ...]]:
    """The positions of a section, by what they are for; old names, too."""
    found = {}
    for name in ("dock", "approach", "extract", "insert", "detach"):
        text = options.get(f"{name}_position", "")
        if text.strip():
            found[name] = tuple(float(part) for part in text.split(","))
    x, y = found["dock"][:2]
    length = float(options.get("dock_safe_distance", "0"))
    for old, name in (("dock_angle", "approach"), ("detach_angle", "detach")):
        if old in options:
            a = math.radians(float(options[old]))
            found[name] = (x + length * math.cos(a), y + length * math.sin(a))
    return found


def _way(dock: tuple[float, ...], place: tuple[float, ...]) -> tuple:
    dx, dy = place[0] - dock[0], place[1] - dock[1]
    length = math.hypot(dx, dy)
    return (dx / length, dy / length, 0.0)


def needs_z(options: dict[str, str]) -> bool:
    """Whether Z has to be homed before the dock can be found."""
    if "dock_fixed_z" in options:
        return options["dock_fixed_z"].lower() == "false"
    return any(len(place) > 2 for place in places(options).values())


def homes_with_probe(entry: dict[str, Any]) -> bool:
    """Whether Z is homed with the probe; so it is where nothing is known of it."""
    stepper_z = (entry.get("context") or {}).get("stepper_z") or {}
    return stepper_z.get("endstop_pin", "probe:").startswith("probe:")


def section_of(entry: dict[str, Any], index: int) -> dict[str, str]:
    """The section with the pin of the simulated machine."""
    options = {k: indented(v) for k, v in entry["options"].items()}
    options.update(COMPLETED.get(index, {}))
    if options.get("pin") is not None:
        options["pin"] = "^PC3"
    return options


def _axes(found: dict[str, tuple[float, ...]]) -> list[tuple[float, float]]:
    axes = []
    for i in (0, 1):
        values = [place[i] for place in found.values()]
        axes.append((min([*values, 0.0]) - 20.0, max([*values, 240.0]) + 60.0))
    return axes


def scene_of(index: int, **advised: str) -> Scene:
    """A cartesian machine that such a section may be of; `advised`: what is changed."""
    entry = ENTRIES[index]
    options = {**section_of(entry, index), **advised}
    found = places(options)
    name = "dock_gantry" if homes_with_probe(entry) else "dock_gantry_switch"
    scene = DOCK_SCENES[name]
    dock = found["dock"]
    (x_min, x_max), (y_min, y_max) = _axes(found)
    sections = dict(scene.sections)
    for axis, low, high in (("x", x_min, x_max), ("y", y_min, y_max)):
        sections[f"stepper_{axis}"] = {
            **(sections[f"stepper_{axis}"] or {}),
            "position_min": f"{low}",
            "position_max": f"{high}",
            "position_endstop": f"{high}",
        }
    sections["printer"] = {
        **(sections["printer"] or {}),
        "kinematics": "cartesian",
    }
    for unused in (
        "quad_gantry_level",
        "screws_tilt_adjust",
        "axis_twist_compensation",
        "safe_z_home",
    ):
        sections.pop(unused, None)
    home = {"home_xy_position": f"{x_max - 10}, {y_max - 10}", "z_hop": "10"}
    if not homes_with_probe(entry):
        sections["safe_z_home"] = home
    sections["dockable_probe"] = options
    sections["gcode_macro _PROBE_SAFE_Y"] = {"gcode": "\n  G4 P1"}
    sections["bed_mesh"] = {
        "speed": "200",
        "horizontal_move_z": "20",
        "mesh_min": "90, 90",
        "mesh_max": "140, 140",
        "probe_count": "3, 3",
    }
    z_offset = float(options["z_offset"])
    hang = z_offset if z_offset >= 1.0 else 6.9
    probe = scene.world.mag_probe
    assert probe is not None
    bed_z = scene.world.bed.z0
    release = found["detach"]
    if options.get("detach_gcode"):
        # It strips the probe off by itself, along Y
        release = (dock[0], dock[1] + 40.0)
    if len(release) > 2 and _way(dock, release) == _way(
        dock, found["approach"]
    ):
        release = (dock[0], dock[1], release[2])
    away = _way(dock, release) if release[:2] != dock[:2] else (0.0, 0.0, -1.0)
    z = found["approach"][2] if len(found["approach"]) > 2 else 0.0
    z = dock[2] if len(dock) > 2 else z
    world = replace(
        scene.world,
        pin=None
        if scene.world.pin is None
        else replace(
            scene.world.pin,
            x=x_max - 10.0,
            y=y_max - 10.0,
        ),
        bed=replace(
            scene.world.bed, x_min=0.0, y_min=0.0, x_max=400.0, y_max=400.0
        ),
        switches=(
            AxisSwitchSpec("x_endstop", "x", x_max + 0.003),
            AxisSwitchSpec("y_endstop", "y", y_max + 0.003),
        ),
        mag_probe=replace(
            probe,
            x_offset=float(options.get("x_offset", "0")),
            y_offset=float(options.get("y_offset", "0")),
            body_drop=hang - 0.485,
        ),
        dock=DockSpec(
            dock[0],
            dock[1],
            z + 0.3 if needs_z(options) else bed_z,
            approach=_way(dock, found.get("extract", found["approach"])),
            release=away,
            cone=20.0,
            lifted=not needs_z(options),
            body=10.0,
            lanes=(_way(dock, found["approach"]), (0.0, -1.0, 0.0))
            if options.get("detach_gcode")
            else (_way(dock, found["approach"]),),
        ),
    )
    start = Pose(x_max - 15.0, y_max - 15.0, 12.0)
    return replace(
        scene,
        name=f"corpus{index}",
        kinematics="cartesian",
        sections=sections,
        world=world,
        start=start,
    )
