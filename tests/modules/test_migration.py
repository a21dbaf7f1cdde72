"""What docs/migration.md says of printers that come from other plugins."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tests.modules.example_owners import OWNERS
from tools.kit.auto_z_offset import MICROSTEP, POINT, told
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import refusal

DOCS = Path(__file__).resolve().parents[2] / "docs"

# As the file of Klicky has it: names of 2021, the probe attached late, and a
# macro around the command
KLICKY = {
    "display_status": {},
    "z_calibration": {
        "probe_nozzle_x": "226",
        "probe_nozzle_y": "210",
        "probe_switch_x": "254",
        "probe_switch_y": "204.5",
        "probe_bed_x": "110",
        "probe_bed_y": "110",
        "switch_offset": "0.5",
        "max_deviation": "1.5",
        "clearance": "7.5",
        "speed": "200",
        "probing_first_fast": "true",
        "start_gcode": "Dock_Probe_Unlock",
        "before_switch_gcode": "Attach_Probe",
        "end_gcode": "Dock_Probe",
    },
    "gcode_macro CALIBRATE_Z": {
        "rename_existing": "BASE_CALIBRATE_Z",
        "gcode": "\n  M117 calibrating\n  SET_GCODE_OFFSET Z=0"
        "\n  BASE_CALIBRATE_Z\n  M117",
    },
}
# As FreeDi has it for a Q1 Pro, with what the document changes
FREEDI = {
    "probe": {"z_offset": "1.0", "samples": "2", "sample_retract_dist": "2"},
    "auto_z_offset": {
        "z_offset": "0.07",
        "calibrated_z_offset": None,
        "speed": "13",
        "probe_accel": "50",
        "probe_hop": "5",
        "samples": "5",
        "samples_result": "median",
        "samples_tolerance": "0.013",
        "samples_tolerance_retries": "5",
        "offset_samples": "3",
        "prepare_gcode": "\n  G90\n  G0 Z3\n  G91"
        "\n  SET_PIN PIN=bed_sensor VALUE=0\n  M204 S10000"
        "\n  {% for i in range(6) %}\n  G1 Z5 F1200\n  G1 Z-5 F1200"
        "\n  {% endfor %}\n  G1 Z3\n  G90"
        "\n  SET_PIN PIN=bed_sensor VALUE=1",
    },
    "gcode_macro PRINT_START": {
        "gcode": "\n  BED_MESH_CLEAR\n  M140 S{params.BED}\n  G28"
        "\n  AUTO_Z_LOAD_OFFSET\n  M104 S{params.HOTEND}"
    },
    "bed_mesh": {
        "mesh_min": "40,40",
        "mesh_max": "200,200",
        "probe_count": "3,3",
    },
}


def test_klickys_own_file_goes_on_working(start):
    owner = OWNERS["voron_late_probe"]
    printer = start(owner.scene, changes=KLICKY)
    printer.session.require_ready()
    assert told(printer.session.console, "'max_deviation' is now called")
    printer.run("G28\nSET_GCODE_OFFSET Z=0.3\nCALIBRATE_Z")
    gap = printer.scene.world.mag_probe.switch_offset - 0.5
    assert printer.gap(owner.bed) == pytest.approx(gap, abs=2 * MICROSTEP)
    kinds = [event.kind for event in printer.machine.truth.events]
    assert kinds == ["attach", "dock"]


def test_freedis_section_as_the_document_changes_it(start):
    scene = SCENES["qidi"]
    printer = start(scene, changes=FREEDI)
    printer.session.require_ready()
    assert told(printer.session.console, "auto_z_offset: speed 13 is limited")
    printer.run("G28\nAUTO_Z_CALIBRATE")
    printer.session.restart("SAVE_CONFIG")
    printer.run("PRINT_START BED=40 HOTEND=180")
    gap = 0.07 - scene.piezo_depth(9.49)
    assert printer.gap(POINT) == pytest.approx(gap, abs=4 * MICROSTEP)


def test_option_that_stops_the_original_module_is_in_the_section(host):
    """Klipper says nothing of an unknown option that SAVE_CONFIG has written."""
    text = (DOCS / "migration.md").read_text(encoding="utf-8")
    name, said = re.search(
        r"With `(\w+)` in the section\s+Klipper does not start then \(`(.+?)`\)",
        text,
        re.DOTALL,
    ).groups()
    said = " ".join(said.split())
    for example in DOCS.parent.glob("examples/auto_z_offset/*_freedi.cfg"):
        lines = example.read_text(encoding="utf-8").splitlines()
        assert any(line.startswith(f"{name}: ") for line in lines), example
    # Unknown to the original is what nobody reads, as this is here
    changes = {"auto_z_offset": {f"{name}s": "-4"}}
    assert said in refusal(host, changes, "qidi").replace(f"{name}s", name)
    going_back = (DOCS / "auto_z_offset.md").read_text(encoding="utf-8")
    assert f"such as `{name}`" in going_back.split("**Going back**")[1]


def test_locked_probe_is_put_away_as_documented(start):
    owner = OWNERS["voron_late_probe"]
    text = (DOCS / "z_calibration.md").read_text(encoding="utf-8")
    (line,) = re.findall(r"`error_gcode: (\w+)`", text)
    # Of a locked probe Klicky's own Dock_Probe does nothing
    own = {"end_gcode": "G4 P1", "error_gcode": line, "max_deviation": "0.01"}
    section = {**KLICKY["z_calibration"], **own}
    changes = {**KLICKY, "z_calibration": section}
    printer = start(owner.scene, changes=changes).homed()
    assert "outside offset_margins" in printer.fail("CALIBRATE_Z")
    kinds = [event.kind for event in printer.machine.truth.events]
    assert kinds == ["attach", "dock"]
