"""Klipper's own sections, as they stand beside ours."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import Optional

from tools.kit.klipper_sections import bed_mesh, profile

Section = Mapping[str, Optional[str]]

# In reach of each probe, on the smallest of the beds
_MESH = bed_mesh("40, 40", "200, 200", horizontal_move_z="10")


def _wrapped(command: str, gcode: str) -> dict[str, Section]:
    """A macro of that name; {own}: what the host has under it."""
    own = "G28.1" if command == "G28" else f"_HOST_{command}"
    text = gcode.replace("{own}", own + " {rawparams}")
    macro = {"rename_existing": own, "gcode": f"\n  {text}"}
    return {f"gcode_macro {command}": macro}


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
    "twist": {
        "axis_twist_compensation": {
            "speed": "200",
            "horizontal_move_z": "10",
            "calibrate_start_x": "60",
            "calibrate_end_x": "180",
            "calibrate_y": "120",
        }
    },
    # What an adaptive mesh has been made with before
    "saved_mesh": {"bed_mesh default": profile((0.1, 0.0, -0.1), _MESH)},
    # The machines have what it needs, see scene.heated()
    "hot": {},
    "card": {"virtual_sdcard": {"path": "{card}"}},
    "wrapped_offset": _wrapped("SET_GCODE_OFFSET", "{own}"),
    "wrapped_homing": _wrapped("G28", "{own}\n  SET_GCODE_OFFSET Z=0"),
    "wrapped_mesh": _wrapped("BED_MESH_CALIBRATE", "G28\n  {own}"),
    # As the macros of a Klicky do
    "wrapped_probe": _wrapped("PROBE", "M117 x\n  {own}\n  M117 y"),
}
# One of each at most, what needs another one, and what cannot stand beside it
MESHES = ("mesh", "mesh_zero")
FRAMES = ("tilt", "skew", "twist", "heat")
ALONE = sorted(FEATURES.keys() - {*MESHES, *FRAMES, "respond"})
OF_MESH = {"wrapped_mesh", "saved_mesh"}
_PROBES = {"probe", "dockable_probe"}


def possible(
    names: Collection[str], of_scene: Collection[str]
) -> frozenset[str]:
    """Those that a host takes together; of_scene: sections that are there."""
    found, there = set(names), set(of_scene)
    has_mesh = "bed_mesh" in there or found & set(MESHES)
    if has_mesh:
        found.discard("tilt")
    else:
        found -= OF_MESH
    if not there & _PROBES:
        found -= {"twist", "wrapped_probe"}
    return frozenset(found)


def sections(names: Collection[str], **paths: str) -> dict[str, Section]:
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
