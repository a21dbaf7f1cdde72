"""What is done on a walk, one step after the other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from hypothesis import strategies as st

from tools.campaign.walks.printers import POINT, Owned, printers
from tools.kit.carrying import POINT as MEMBRANE

# A step is its kind and what with: JSON, and readable
Step = tuple[str, Any]

AWAY = "SAVE_GCODE_STATE NAME=away\nG90\nG1 Z%g F1200\nG1 X%g Y%g F9000\nM400\n"
AWAY += "RESTORE_GCODE_STATE NAME=away"
# What a print does: the first layer, 0.3 mm above the bed
PRINT = "G90\nG1 Z15 F1200\nG1 X%g Y%g F9000\nG1 Z0.3 F600\nG1 X%g F3000\nG1 Z20 F1200"

# Of Klipper, on each printer
HOST = (
    "G28",
    "G28 X",
    "G28 X Y",
    "G28 Z",
    "M84",
    "G90",
    "G91",
    "M83",
    "G92 Z10",
    "SET_GCODE_OFFSET Z=0.1",
    "SET_GCODE_OFFSET Z=0",
    "SET_GCODE_OFFSET Z_ADJUST=-0.05 MOVE=0",
    "SAVE_GCODE_STATE NAME=mine",
    "RESTORE_GCODE_STATE NAME=mine",
    "ABORT",
    "ACCEPT",
    "STATUS",
    "SET_VELOCITY_LIMIT ACCEL=1500",
)
# An owner probes over the bed
OVER_BED = AWAY % (20, *POINT)
PROBE = (
    "QUERY_PROBE",
    *(f"{OVER_BED}\n{name}" for name in ("PROBE", "PROBE_ACCURACY SAMPLES=3")),
    f"{OVER_BED}\nPROBE_CALIBRATE",
)
# Whoever tries a dock out does not home in it, nor from behind it
OUT = "MOVE_AVOIDING_DOCK X=150 Y=150 SPEED=100"
OVER_MEMBRANE = AWAY % (20, *MEMBRANE)
# By the section that has them
OF_SECTION = {
    "z_calibration": (
        "CALIBRATE_Z",
        "CALIBRATE_Z",
        "CALIBRATE_Z BED_POSITION=100,120",
        "CALIBRATE_Z Z_ADJUST=0.03",
        "CALIBRATE_Z_ACCURACY CYCLES=2",
        "PROBE_Z_ACCURACY SAMPLES=3",
        "CALCULATE_SWITCH_OFFSET",
        "Z_CALIBRATION_SAVE_GCODE_OFFSET",
        "Z_CALIBRATION_SETUP",
    ),
    "auto_z_offset": (
        "AUTO_Z_CALIBRATE",
        "AUTO_Z_CALIBRATE",
        # At the place where the head is, so not over the pin of Z
        f"{OVER_BED}\nAUTO_Z_PROBE",
        "AUTO_Z_HOME_Z",
        "AUTO_Z_MEASURE_OFFSET",
        "AUTO_Z_LOAD_OFFSET",
        "AUTO_Z_SAVE_GCODE_OFFSET",
    ),
    "dockable_probe": (
        *(f"MOVE_TO_{name}_PROBE\n{OUT}" for name in ("APPROACH", "DOCK")),
        *(f"MOVE_TO_{name}_PROBE\n{OUT}" for name in ("EXTRACT", "INSERT")),
        f"MOVE_TO_DETACH_PROBE\n{OUT}",
        "ATTACH_PROBE",
        "DETACH_PROBE",
        "MOVE_AVOIDING_DOCK X=150 Y=150 SPEED=200",
        f"MOVE_AVOIDING_DOCK X=20 Y=300 SPEED=200\n{OUT}",
        "QUERY_DOCKABLE_PROBE",
        "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0",
        "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=1",
    ),
    "extra_probe membrane": (
        f"{OVER_MEMBRANE}\nEXTRA_PROBE PROBE=membrane",
        f"{OVER_MEMBRANE}\nEXTRA_PROBE_ACCURACY PROBE=membrane SAMPLES=3",
        "EXTRA_PROBE_CALIBRATE PROBE=membrane",
        "EXTRA_PROBE_CALIBRATE PROBE=membrane SAVE=1",
        "EXTRA_PROBE_CONTINUE PROBE=membrane",
        "EXTRA_PROBE_ABORT PROBE=membrane",
        "QUERY_EXTRA_PROBE PROBE=membrane",
    ),
    "quad_gantry_level": ("QUAD_GANTRY_LEVEL",),
    "z_tilt": ("Z_TILT_ADJUST",),
    "screws_tilt_adjust": ("SCREWS_TILT_CALCULATE",),
    "bed_mesh": (
        "BED_MESH_CALIBRATE",
        "BED_MESH_CLEAR",
        "BED_MESH_PROFILE LOAD=default",
    ),
    "pause_resume": ("PAUSE", "RESUME", "CANCEL_PRINT"),
}
WITH_PROBE = ("quad_gantry_level", "z_tilt", "screws_tilt_adjust", "bed_mesh")
OF_FEATURE = {
    "mesh": OF_SECTION["bed_mesh"],
    "mesh_zero": OF_SECTION["bed_mesh"],
    "screws": OF_SECTION["screws_tilt_adjust"],
    "pause": OF_SECTION["pause_resume"],
}
# What is calibrated with before a first layer
PRINTED = {"z_calibration": "CALIBRATE_Z", "auto_z_offset": "AUTO_Z_CALIBRATE"}
HANDS_OF_DOCK = ("put_probe_on", "lose_probe", "bring_probe_back")
HANDS_OF_MEMBRANE = ("lay_membrane", "take_membrane", "press_membrane")


def gcode_of(printer: Owned) -> list[str]:
    """All that its console takes."""
    found = list(HOST)
    probe = printer.scene.world.mag_probe
    # Klipper does not know of a probe that macros bring, and takes the nozzle
    probes = probe is None or probe.mode != "output"
    sections = set(printer.scene.sections)
    if sections & {"probe", "dockable_probe"} and probes:
        found += PROBE
    for section, commands in OF_SECTION.items():
        if section in sections and (probes or section not in WITH_PROBE):
            found += commands
    for name in sorted(printer.names):
        if probes or name not in ("mesh", "mesh_zero", "screws"):
            found += OF_FEATURE.get(name, ())
    return found


def _hands_of(printer: Owned) -> list[str]:
    world = printer.scene.world
    found: list[str] = []
    if world.dock is not None:
        found += HANDS_OF_DOCK
    if world.membrane is not None:
        found += HANDS_OF_MEMBRANE
    return found


def steps(printer: Owned) -> st.SearchStrategy:
    """What may be done on a printer, in any order."""
    commands = gcode_of(printer)
    own = [text for text in commands if text not in HOST]
    kinds = [
        st.tuples(st.just("gcode"), st.sampled_from(commands)),
        # Ours more often than what every printer has
        st.tuples(st.just("gcode"), st.sampled_from(own)),
        st.tuples(st.just("gcode"), st.just("G28")),
        st.tuples(st.just("wait"), st.sampled_from((1, 5, 40, 200))),
        st.tuples(
            st.just("away"), st.sampled_from(((20, 70, 60), (40, 200, 220)))
        ),
        st.tuples(st.just("lower"), st.sampled_from((0.5, 3.0))),
        st.tuples(st.just("answer"), st.integers(0, 3)),
        st.tuples(
            st.just("restart"), st.sampled_from(("RESTART", "FIRMWARE_RESTART"))
        ),
        st.tuples(
            st.just("both"),
            st.tuples(st.sampled_from(own), st.sampled_from(commands)),
        ),
    ]
    hands = _hands_of(printer)
    if hands:
        kinds.append(st.tuples(st.just("hand"), st.sampled_from(hands)))
    # A probe that nobody ever takes off is in the way of every print
    probe = printer.scene.world.mag_probe
    printed = [v for k, v in PRINTED.items() if printer.has(k)]
    if printer.scene.world.pin is not None:
        # A correction of the probe's heights is no offset of the pin's
        printed = [text for text in printed if text != "AUTO_Z_CALIBRATE"]
    if probe is not None and probe.mode == "fixed":
        printed = []
    if printed:
        kinds.append(st.tuples(st.just("print"), st.sampled_from(printed)))
    return st.one_of(kinds)


def walks(bases: Sequence[str] = ()) -> st.SearchStrategy:
    """A printer and 5 to 30 steps, the first of them a G28."""

    def with_steps(printer: Owned) -> st.SearchStrategy:
        later = st.lists(steps(printer), min_size=5, max_size=30)
        begins = later.map(lambda found: (("gcode", "G28"), *found))
        return st.tuples(st.just(printer), begins)

    return printers(bases).flatmap(with_steps)


def first_layer() -> str:
    """Over the point that was measured."""
    x, y = POINT
    return PRINT % (x, y, x + 10.0)
