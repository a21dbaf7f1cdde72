"""Each host has what docs/klippy.csv says that it has."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.docs.klippy import missing, rows
from tools.kit.klipper_sections import bed_mesh
from tools.kit.printer import Printer, module_files
from tools.kit.scenes import SCENES, heated

EXTRA = Path(__file__).resolve().parents[2] / "tools" / "kit" / "extras"
HEAT = {
    "temp_coeff": "0.002",
    "sensor_type": "temperature_host",
    "min_temp": "-100",
    "max_temp": "100",
}
SCREWS = {"screw1": "50, 50", "screw2": "150, 150", "screw3": "50, 150"}
# A printer has one of them
MESH_OR_TILT = (
    {"bed_mesh": bed_mesh("50, 50", "200, 200")},
    {"bed_tilt": {"x_adjust": "0.001"}},
)


@pytest.mark.every_host("their attributes are not the same")
def test_host_has_what_is_touched(host, tmp_path):
    names = tmp_path / "names.json"
    names.write_text(json.dumps([(r.object, r.name) for r in rows()]))
    (tmp_path / "temp").write_text("25000")
    modules = {
        **module_files(),
        "klippy_objects": EXTRA / "klippy_objects.py",
    }
    present = set()
    for changes in MESH_OR_TILT:
        sections = {
            "klippy_objects": {"names": str(names)},
            "bed_screws": SCREWS,
            "axis_twist_compensation": {
                "calibrate_start_x": "20",
                "calibrate_end_x": "200",
                "calibrate_y": "100",
            },
            "pause_resume": {},
            "print_stats": {},
            "z_thermal_adjust": {
                **HEAT,
                "sensor_path": str(tmp_path / "temp"),
            },
            **changes,
        }
        scene = heated(SCENES["voron"])
        with Printer(host, scene, sections, modules=modules) as printer:
            printer.session.require_ready()
            found = printer.status("klippy_objects")["present"]
            present |= {(thing, name) for thing, name in found}
    assert missing(rows(), present) == []
