"""Printers with a dock and with all that lowers the nozzle over the bed."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from simprinter.world import BedSensorSpec, MembraneSpec
from tools.kit.docks import DOCK_SCENES, calibrating
from tools.kit.printer import FOLDER, Printer, module_files
from tools.kit.scenes import Scene

# Where the membrane lies (mm), and how thick it is at its trigger
POINT = (60.0, 60.0)
THICKNESS = 0.25
OVER = f"G90\nG1 Z20 F900\nG1 X{POINT[0]} Y{POINT[1]} F6000\n"

# Every command that moves, by what it does and the section that it is of
Z = (
    "CALIBRATE_Z",
    "CALIBRATE_Z_ACCURACY CYCLES=2",
    "PROBE_Z_ACCURACY SAMPLES=2",
    "Z_CALIBRATION_WAIT MAX=2",
)
AUTO = (
    "AUTO_Z_PROBE",
    "AUTO_Z_HOME_Z",
    "AUTO_Z_MEASURE_OFFSET",
    "AUTO_Z_CALIBRATE",
    "AUTO_Z_TWIST SAMPLE_COUNT=2",
    "AUTO_Z_WAIT MAX=2",
)
HOMES = ("CALIBRATE_Z_ACCURACY CYCLES=2 HOME=1",)
EXTRA = ("EXTRA_PROBE PROBE=membrane", "EXTRA_PROBE_ACCURACY PROBE=membrane")
ATTACH = ("ATTACH_PROBE",)
TRIPS = (
    *ATTACH,
    "PROBE",
    "MOVE_TO_APPROACH_PROBE",
    "MOVE_AVOIDING_DOCK X=100",
)
# What asks a person
ASK = ("EXTRA_PROBE_CALIBRATE PROBE=membrane",)
Z_SETUP = ("Z_CALIBRATION_SETUP",)
DOCK_SETUP = ("DOCKABLE_PROBE_SETUP",)
SETUPS = Z_SETUP + DOCK_SETUP
TOUCHES = Z + AUTO + EXTRA
SECTION = {
    **dict.fromkeys(Z + HOMES + Z_SETUP, "z_calibration"),
    **dict.fromkeys(AUTO, "auto_z_offset"),
    **dict.fromkeys(EXTRA + ASK, "extra_probe membrane"),
    **dict.fromkeys(TRIPS + DOCK_SETUP, "dockable_probe"),
}

_SECTIONS: dict[str, dict[str, str]] = {
    "extra_probe membrane": {
        "pin": "^!PF5",
        "z_offset": f"{THICKNESS}",
        "xy_position": f"{POINT[0]}, {POINT[1]}",
        "samples": "1",
        "lift_speed": "10",
    },
    "auto_z_offset": {
        "pin": "PC7",
        "z_offset": "0.2",
        "samples": "1",
        "offset_samples": "2",
        "lift_speed": "10",
        "cycles_tolerance": "1",
        "prepare_gcode": "\n  G90",
    },
}


def _with_section(scene: Scene, name: str, **inputs: str) -> Scene:
    return replace(
        scene,
        sections={**scene.sections, name: _SECTIONS[name]},
        wiring=replace(scene.wiring, inputs={**scene.wiring.inputs, **inputs}),
    )


def with_membrane(scene: Scene) -> Scene:
    """The same with a membrane, which a hand has to lay, and its section."""
    name = "extra_probe membrane"
    return _with_section(scene, name, membrane="^!PF5").with_world(
        membrane=MembraneSpec(
            *POINT, thickness=0.3, press=0.05, radius=9.0, laid=False
        )
    )


def with_all(scene: Scene) -> Scene:
    """The same with a membrane, a sensor below the bed, and our sections."""
    scene = with_membrane(calibrating(scene))
    scene = _with_section(scene, "auto_z_offset", bed_sensor="PC7")
    return scene.with_world(bed_sensor=BedSensorSpec(press_depth=0.04))


SWITCH = with_all(DOCK_SCENES["dock_gantry_switch"])
QUICK: dict[str, Any] = {"samples": "1", "attach_speed": "50"}


def pressed(printer: Printer) -> float:
    """How deep (mm) the probe was pressed into the bed, at the deepest."""
    truth = printer.machine.truth
    return max(truth.depth("probe_bed"), truth.depth("body_bed"))


def without_our_dock() -> dict[str, Any]:
    """Our modules, but for dockable_probe."""
    files = module_files()
    names = ("z_calibration", "auto_z_offset", "extra_probe", FOLDER)
    return {name: files[name] for name in names}
