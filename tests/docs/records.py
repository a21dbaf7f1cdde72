"""What is known of each module for the test of its document."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple, Optional

from tools.kit.scenes import SCENES, Sections, heated

# An answer that is the document's own block of code
SHOWN = "as the document shows it"


class Module(NamedTuple):
    """A module, its document, and a printer on which both can be tried.

    steps: G-code to run with the document's sections and with `surroundings`; each with the line that
    its answer has to have, if any. old: the heading of options of other
    releases. given: the only options of the module without a default that are
    always there. sources: of what its defaults are taken from, no two alike.
    late: options whose default shows only when something is measured, which
    tests/modules looks at; phases: those of no step, which it looks at, too.
    """

    name: str
    scene: str
    surroundings: Sections
    steps: Mapping[str, Optional[str]]
    old: str
    given: tuple[str, ...]
    sources: Sections
    late: Mapping[str, str]
    phases: frozenset[str] = frozenset()


_DWELL = {"gcode": "G4 P1"}
# Of a printer that can heat its nozzle
_PLAIN = SCENES["voron"]
_HEATERS = {
    name: options
    for name, options in heated(_PLAIN).sections.items()
    if name not in _PLAIN.sections
}

Z_CALIBRATION = Module(
    name="z_calibration",
    scene="voron",
    surroundings={
        **_HEATERS,
        "respond": {},
        "display_status": {},
        "stepper_z": {"position_endstop": "1.9"},
        "z_calibration": {
            # What paper finds on this printer; its section begins lower
            "switch_offset": "0.44",
            "before_switch_gcode": "G4 P1",
            "error_gcode": "M118 failed",
        },
        "gcode_macro ATTACH_PROBE": _DWELL,
        "gcode_macro DOCK_PROBE": _DWELL,
        "gcode_macro CLEAN_NOZZLE": _DWELL,
        "gcode_macro QUAD_GANTRY_LEVEL": _DWELL,
    },
    steps={
        "CALIBRATE_Z": SHOWN,
        # The same frame
        "CALIBRATE_Z SWITCH_OFFSET=0.44": None,
        "PROBE_Z_ACCURACY SAMPLES=3": SHOWN,
        "Z_CALIBRATION_WAIT MAX=2": SHOWN,
        "Z_CALIBRATION_NOZZLE_GROWTH": None,
        "CALIBRATE_Z_IF_NEEDED": "echo: offset 0.46 holds, measured with"
        " switch_offset 0.44",
        "CALIBRATE_Z SWITCH_OFFSET=much": None,
        # Beside the bed, as this printer keeps its probe attached
        "G1 Z20 F900\nG1 X20 Y305 F6000\nG1 Z0.05 F600\nM400": None,
        "CALCULATE_SWITCH_OFFSET SAVE=1": SHOWN,
        "G28 Z\nCALIBRATE_Z_IF_NEEDED": "echo: calibrating: Z was homed again",
        "PRINT_START BED=40 EXTRUDER=160": "// Z-CALIBRATION: probe=7.315"
        " - (switch=8.315 - nozzle=1.900 + switch_offset=0.440)"
        " --> new offset=0.460000",
        "SET_GCODE_OFFSET Z_ADJUST=0.02": None,
        "Z_CALIBRATION_SAVE_GCODE_OFFSET": SHOWN,
        # The second one shows all that is asked
        "Z_CALIBRATION_SETUP\nZ_CALIBRATION_SETUP": SHOWN,
        "Z_CALIBRATION_SETUP STEP=PIN Z=+1": None,
        "Z_CALIBRATION_SETUP STEP=PIN ANSWER=NO": None,
        "Z_CALIBRATION_SETUP STEP=ABORT": None,
        # Its report ends when it does, and says so among whatever comes next
        "CALIBRATE_Z_ACCURACY CYCLES=2": None,
    },
    old="Old names",
    given=("bed_xy_position", "switch_offset"),
    sources={
        "safe_z_home": {"home_xy_position": "201, 202"},
        "stepper_z": {
            "homing_speed": "7.25",
            "second_homing_speed": "3.125",
            "homing_retract_dist": "2.75",
            "position_min": "-1.75",
        },
        "probe": {
            "samples": "4",
            "samples_tolerance": "0.011",
            "samples_tolerance_retries": "7",
            "samples_result": "average",
            "speed": "4.5",
            "sample_retract_dist": "2.25",
            "lift_speed": "9.5",
        },
    },
    late={
        "bed_xy_position": "`zero_reference_position` of `[bed_mesh]`",
        "history": "`z_calibration`",
    },
    phases=frozenset({"clean_gcode", "heating", "setup", "waiting"}),
)

AUTO_Z_OFFSET = Module(
    name="auto_z_offset",
    scene="qidi",
    surroundings={
        "respond": {},
        "probe": {"z_offset": "1.0"},
        "gcode_macro BED_MESH_PROFILE": _DWELL,
        "axis_twist_compensation": {
            "calibrate_start_x": "25",
            "calibrate_end_x": "220",
            "calibrate_y": "122",
        },
    },
    steps={
        "CHECK_PROBE": "echo: not measured since klippy started, saved is 0.0",
        "AUTO_Z_CALIBRATE": SHOWN,
        "CHECK_PROBE ": "echo: -0.12, spread 0.0",
        "AUTO_Z_LOAD_OFFSET": None,
        "AUTO_Z_SAVE_GCODE_OFFSET": None,
        "AUTO_Z_MEASURE_OFFSET": None,
        "AUTO_Z_TWIST": None,
        "AUTO_Z_WAIT MAX=2": None,
        "AUTO_Z_PROBE": None,
        "SET_GCODE_OFFSET Z=0\nAUTO_Z_HOME_Z": None,
    },
    old="How do I migrate from the original module?",
    given=("pin", "prepare_gcode"),
    sources={"probe": {"z_offset": "1.0"}},
    phases=frozenset({"waiting"}),
    late={
        "bed_xy_position": "middle of the axes",
        "corrected_probe_z_offset": "`z_offset` of `[probe]`",
    },
)

MODULES = (Z_CALIBRATION, AUTO_Z_OFFSET)
