"""Sections of Klipper's own, as tests put them beside ours."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Optional

Section = dict[str, Optional[str]]

# [extruder1], beside that of the scenes
TOOL: Section = {
    "step_pin": "PG3",
    "dir_pin": "PG4",
    "enable_pin": "!PG5",
    "microsteps": "16",
    "rotation_distance": "22.6",
    "nozzle_diameter": "0.4",
    "filament_diameter": "1.75",
    "heater_pin": "PH5",
    "sensor_type": "temperature_host",
    "control": "watermark",
    "min_temp": "0",
    "max_temp": "300",
}


def bed_mesh(low: str, high: str, **more: Optional[str]) -> Section:
    """[bed_mesh] of three by three points between two corners of the bed."""
    return {
        "mesh_min": low,
        "mesh_max": high,
        "probe_count": "3, 3",
        "speed": "200",
        "horizontal_move_z": "12",
        **more,
    }


def profile(heights: Sequence[float], mesh: Section) -> Section:
    """A saved [bed_mesh default]: heights (mm) from the front to the back."""
    low, high = str(mesh["mesh_min"]), str(mesh["mesh_max"])
    (min_x, min_y), (max_x, max_y) = low.split(","), high.split(",")
    return {
        "version": "1",
        "points": "".join(f"\n  {z}, {z}, {z}" for z in heights),
        "algo": "lagrange",
        "tension": "0.2",
        "mesh_x_pps": "2",
        "mesh_y_pps": "2",
        "x_count": "3",
        "y_count": "3",
        "min_x": min_x.strip(),
        "min_y": min_y.strip(),
        "max_x": max_x.strip(),
        "max_y": max_y.strip(),
    }
