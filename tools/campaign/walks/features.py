"""Klipper's own sections, as they stand beside ours."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Optional

from tools.kit.klipper_sections import bed_mesh

Section = Mapping[str, Optional[str]]

# In reach of each probe, on the smallest of the beds
_MESH = bed_mesh("40, 40", "200, 200", horizontal_move_z="10")

# Each by a name; a printer takes any of them, but for what excludes each other
FEATURES: Mapping[str, Mapping[str, Section]] = {
    "mesh": {"bed_mesh": _MESH},
    "mesh_zero": {"bed_mesh": {**_MESH, "zero_reference_position": "150, 150"}},
    "tilt": {"bed_tilt": {"x_adjust": "0.0005", "y_adjust": "-0.001"}},
    "skew": {"skew_correction": {}},
    "heat": {
        "z_thermal_adjust": {
            "temp_coeff": "0.002",
            "sensor_type": "temperature_host",
            "sensor_path": "{temperature}",
            "min_temp": "0",
            "max_temp": "100",
            "smooth_time": "1",
            "z_adjust_off_above": "50",
        }
    },
    "screws": {
        "screws_tilt_adjust": {
            "screw1": "60, 30",
            "screw2": "180, 30",
            "screw3": "120, 190",
            "speed": "200",
            "horizontal_move_z": "10",
            "screw_thread": "CW-M4",
        }
    },
    "shaper": {"input_shaper": {"shaper_freq_x": "50", "shaper_freq_y": "40"}},
    "exclude": {"exclude_object": {}},
    "variables": {"save_variables": {"filename": "{variables}"}},
    "idle": {"idle_timeout": {"timeout": "120"}},
    "retraction": {"firmware_retraction": {"retract_length": "1"}},
    "pause": {"pause_resume": {}},
    "respond": {"respond": {}},
    "wrapped_offset": {
        "gcode_macro SET_GCODE_OFFSET": {
            "rename_existing": "SET_OFFSET_OF_HOST",
            "gcode": "\n  SET_OFFSET_OF_HOST {rawparams}",
        }
    },
    "wrapped_homing": {
        "gcode_macro G28": {
            "rename_existing": "G28.1",
            "gcode": "\n  G28.1 {rawparams}\n  SET_GCODE_OFFSET Z=0",
        }
    },
    "wrapped_mesh": {
        "gcode_macro BED_MESH_CALIBRATE": {
            "rename_existing": "MESH_OF_HOST",
            "gcode": "\n  G28\n  MESH_OF_HOST {rawparams}",
        }
    },
}
# What needs another one, or cannot stand beside it
NEEDS = {"wrapped_mesh": ("mesh", "mesh_zero")}
APART = [{"mesh", "tilt"}, {"mesh_zero", "tilt"}]


def is_possible(names: frozenset[str], of_scene: Collection[str]) -> bool:
    """Whether a host takes these together; of_scene: sections that are there."""
    if "bed_mesh" in of_scene:
        names = names | {"mesh"}
    if any(pair <= names for pair in APART):
        return False
    return all(
        names & set(needed) for name, needed in NEEDS.items() if name in names
    )


def sections(names: frozenset[str], **paths: str) -> dict[str, Section]:
    """What is written into printer.cfg; paths: of files by their name."""
    found: dict[str, Section] = {}
    for name in sorted(names):
        for section, options in FEATURES[name].items():
            found[section] = {
                option: _filled(text, paths) for option, text in options.items()
            }
    return found


def _filled(text: Optional[str], paths: Mapping[str, str]) -> Optional[str]:
    for name, path in paths.items():
        if text is not None:
            text = text.replace("{%s}" % name, path)
    return text
