"""docs/features.csv tells what Klipper's own features do to the gap."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from simprinter import Scene
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError
from simprinter.world import MeshSpec
from tools.kit.auto_z_offset import POINT
from tools.kit.cases import all_slow_but
from tools.kit.klipper_sections import TOOL, bed_mesh, profile
from tools.kit.load_errors import load
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES, heated
from tools.kit.z_calibration import MICROSTEP

DOCUMENT = Path(__file__).resolve().parents[2] / "docs" / "features.csv"
COMMANDS = {"z_calibration": "CALIBRATE_Z", "auto_z_offset": "AUTO_Z_CALIBRATE"}
POINTS = {"z_calibration": (150.0, 150.0), "auto_z_offset": POINT}
# The bed is so much higher 100 mm further back
SLOPE = 0.05

MESH = bed_mesh("50, 50", "200, 200")
ZERO = {"zero_reference_position": "%g, %g"}
TWIST = {
    "calibrate_start_x": "0",
    "calibrate_end_x": "200",
    "calibrate_y": "120",
    "z_compensations": "0.0, 0.2",
}
TWIST_ENDS = {"compensation_start_x": "0", "compensation_end_x": "200"}
HEAT = {
    "temp_coeff": "0.002",
    "sensor_type": "temperature_host",
    "min_temp": "-100",
    "max_temp": "100",
}
SCREWS = {"screw1": "50, 50", "screw2": "150, 150", "screw3": "50, 150"}
LEVEL = {"speed": "100", "horizontal_move_z": "15", "retries": "5"}
GANTRY = {
    **LEVEL,
    "gantry_corners": "\n  -60,-10\n  360,370",
    "points": "\n  50,25\n  50,225\n  250,225\n  250,25",
    "max_adjust": "10",
    "retry_tolerance": "0.02",
}
EXCLUDE = "\n".join(
    f"EXCLUDE_OBJECT{what} NAME=one"
    for what in ("_DEFINE", "_START", "", "_END")
)


class Case(NamedTuple):
    """A feature: its sections, and G-code around the command.

    `words` are in what is told of it.
    """

    sections: dict[str, dict[str, str]]
    before: str = ""
    after: str = ""
    words: str = ""


PROBED = "BED_MESH_CALIBRATE"
CASES = {
    "none": Case({}),
    "`[bed_mesh]`, zero at the point": Case(
        {"bed_mesh": {**MESH, **ZERO}}, PROBED, words="bed_mesh"
    ),
    "`[bed_mesh]`, zero at the point, loaded after it": Case(
        {"bed_mesh": {**MESH, **ZERO}}, "", PROBED, "bed_mesh"
    ),
    "`[bed_mesh]`, zero at 60, 60": Case(
        {"bed_mesh": {**MESH, "zero_reference_position": "60, 60"}},
        PROBED,
        words="bed_mesh",
    ),
    "`[bed_mesh]`, zero at 60, 60, loaded after it": Case(
        {"bed_mesh": {**MESH, "zero_reference_position": "60, 60"}},
        "",
        PROBED,
        "bed_mesh",
    ),
    "`[bed_mesh]` without zero": Case(
        {"bed_mesh": MESH}, PROBED, words="bed_mesh"
    ),
    "`[bed_mesh]` without zero, loaded after it": Case(
        {"bed_mesh": MESH}, "", PROBED, "bed_mesh"
    ),
    "adaptive mesh, without zero": Case(
        {"bed_mesh": MESH},
        f"{PROBED} MESH_MIN=90,90 MESH_MAX=170,170",
        words="bed_mesh",
    ),
    "`[bed_tilt]`": Case(
        {"bed_tilt": {"x_adjust": "0.001", "z_adjust": "0.03"}},
        words="bed_tilt",
    ),
    "`[skew_correction]`": Case(
        {"skew_correction": {}}, "SET_SKEW XY=140,142,100"
    ),
    "`[axis_twist_compensation]`": Case({"axis_twist_compensation": TWIST}),
    "`[z_thermal_adjust]`, 50 K since homing": Case(
        {"z_thermal_adjust": HEAT}, "HEAT", words="z_thermal_adjust"
    ),
    "`[z_tilt]`, `[quad_gantry_level]`, then `G28 Z`": Case(
        {"quad_gantry_level": GANTRY}, "QUAD_GANTRY_LEVEL\nG28 Z"
    ),
    "`[bed_screws]`": Case({"bed_screws": SCREWS}),
    "`[input_shaper]`": Case(
        {"input_shaper": {"shaper_freq_x": "50", "shaper_freq_y": "40"}}
    ),
    "`[endstop_phase]`": Case({"endstop_phase stepper_x": {}}),
    "`[save_variables]`": Case(
        {"save_variables": {"filename": "VARIABLES"}},
        "SAVE_VARIABLE VARIABLE=z VALUE=1",
    ),
    "`[firmware_retraction]`": Case({"firmware_retraction": {}}),
    "`[exclude_object]`, one excluded": Case({"exclude_object": {}}, EXCLUDE),
    "offset 0.3 of the last print": Case({}, "SET_GCODE_OFFSET Z=0.3"),
    "`SAVE_GCODE_STATE`, `RESTORE_GCODE_STATE`": Case(
        {}, "SAVE_GCODE_STATE", "RESTORE_GCODE_STATE", "RESTORE_GCODE_STATE"
    ),
    "`PAUSE`, `RESUME`": Case(
        {"pause_resume": {}}, "PAUSE", "RESUME", "RESUME"
    ),
    "`G91`, `M83`": Case({}, "G91\nM83"),
    "`G92 Z`, 0.3 lower": Case({}, "G1 Z30 F900\nG92 Z29.7", words="G92"),
    "another tool, `Z_ADJUST=0.3`": Case(
        {"extruder1": TOOL},
        "",
        "ACTIVATE_EXTRUDER EXTRUDER=extruder1\nSET_GCODE_OFFSET Z_ADJUST=0.3",
        "extruder1 is active",
    ),
}


def scene_of(module: str, case: Case) -> Scene:
    """Its bed slopes, and a probe's z_offset is 0.3 mm too large."""
    scene = SCENES["voron" if module == "z_calibration" else "qidi"]
    bed = replace(scene.world.bed, slope_y=SLOPE / 100.0)
    z0 = bed.z0 - POINTS[module][1] * SLOPE / 100.0
    scene = scene.with_world(bed=replace(bed, z0=z0))
    return (
        heated(scene)
        if {"extruder1", "firmware_retraction"} & {*case.sections}
        else scene
    )


def sections_of(
    host: Host, module: str, case: Case, folder: Path
) -> dict[str, Any]:
    """The sections as this machine and this host want them."""
    made: dict[str, Any] = {
        name: dict(options) for name, options in case.sections.items()
    }
    zero = made.get("bed_mesh", {}).get("zero_reference_position", "")
    if "%" in zero:
        made["bed_mesh"]["zero_reference_position"] = zero % POINTS[module]
    for options in made.values():
        if options.get("sensor_type") == "temperature_host":
            options["sensor_path"] = str(folder / "temp")
    if "save_variables" in made:
        made["save_variables"]["filename"] = str(folder / "variables.cfg")
    if module == "z_calibration":
        made["probe"] = {"z_offset": "7.2"}
    elif "quad_gantry_level" in made:
        made = {
            "z_tilt": {
                **LEVEL,
                "points": "\n  60,100\n  180,100",
                "z_positions": "\n  -10,120\n  260,120",
            }
        }
    if "axis_twist_compensation" in made:
        newer = {"axis_twist_compensation": {**TWIST, **TWIST_ENDS}}
        if load(host, newer, scene_of(module, case).name)[0] == "ready":
            made.update(newer)
    return made


def look(
    host: Host, module: str, case: Case, folder: Path
) -> tuple[float, str]:
    """The true gap at Z=0 over the point (mm), and how it was told."""
    (folder / "temp").write_text("25000")
    sections = sections_of(host, module, case, folder)
    with Printer(host, scene_of(module, case), sections) as printer:
        printer.session.require_ready()
        printer.session.wait(20.0 * ("z_thermal_adjust" in sections))
        printer.homed()
        if case.before == "HEAT":
            (folder / "temp").write_text("75000")
            printer.session.wait(20.0)
        elif case.before:
            before = case.before
            if "z_tilt" in sections:
                before = before.replace("QUAD_GANTRY_LEVEL", "Z_TILT_ADJUST")
            printer.run(before)
        touched = len(printer.machine.truth.touches)
        told = ""
        try:
            lines = printer.run(COMMANDS[module])
        except GcodeError as error:
            assert case.words in str(error)
            told = "refused"
            lines = printer.run(f"G28\n{COMMANDS[module]}")
        assert len(printer.machine.truth.touches) > touched
        if case.after:
            printer.run(case.after)
        status = printer.status(module)
        reason = status.get("reason", "")
        # Not by a retraction of the feature, or the like
        printer.run("G90\nM82\nG1 X20 Y20 F6000")
        if case.words and any(case.words in line for line in lines):
            told = "line"
        if case.words in reason and case.words:
            told = "`reason`"
        return printer.gap(POINTS[module]), told


def table() -> dict[str, dict[str, tuple[str, str]]]:
    """What the document says, by feature and module: the gap, how it was told.

    Where a host differs, `other on <host>` follows after a semicolon.
    """
    with DOCUMENT.open(encoding="utf-8", newline="") as lines:
        _, *rows = csv.reader(lines)
    return {
        row[0]: {
            "z_calibration": (row[1], row[2]),
            "auto_z_offset": (row[3], row[4]),
        }
        for row in rows
    }


def of_host(cell: str, host: Host) -> str:
    """What a cell says of one host."""
    usual, *others = cell.split("; ")
    for other in others:
        value, _, name = other.partition(" on ")
        assert name == "Klipper since May 2026"
        if is_since_may_2026(host):
            return value
    return usual


def is_since_may_2026(host: Host) -> bool:
    """Whether homing with the probe is since 43baf9b83, whatever git calls the host."""
    (source,) = host.directory.glob("base/**/extras/homing.py")
    return "check_probe_first_home" in source.read_text(encoding="utf-8")


# Whose cells have values of hosts
HEAT = "`[z_thermal_adjust]`, 50 K since homing"
# Of each kind of words one is in make test
USUAL = (
    "`[bed_mesh]`, zero at 60, 60",
    "`[bed_mesh]` without zero, loaded after it",
    "`[skew_correction]`",
)
TITLES = [
    *all_slow_but(USUAL, [title for title in CASES if title != HEAT]),
    pytest.param(
        HEAT,
        marks=[
            pytest.mark.slow,
            pytest.mark.every_host("the table says that hosts differ"),
        ],
    ),
]


def test_every_feature_is_in_the_table():
    assert list(table()) == list(CASES)
    rows = table().items()
    differ = [t for t, row in rows if any("; " in c for c, _ in row.values())]
    assert differ == [HEAT]


@pytest.mark.parametrize("module", COMMANDS)
@pytest.mark.parametrize("title", TITLES)
def test_gap_is_that_of_the_table(host, title, module, tmp_path):
    gap, told = look(host, module, CASES[title], tmp_path)
    gap_cell, told_cell = table()[title][module]
    wanted = float(of_host(gap_cell, host))
    assert gap == pytest.approx(wanted, abs=2 * MICROSTEP), (gap, told)
    assert told == of_host(told_cell, host)


# Around a print at PRINT, and nowhere else
PRINT = (70.0, 70.0)
ADAPTIVE = f"{PROBED} MESH_MIN=50,50 MESH_MAX=90,90"


def dented(module: str) -> Scene:
    """Where it is measured the bed is 0.15 mm lower than at the print."""
    scene = SCENES["voron" if module == "z_calibration" else "qidi"]
    x, y = POINTS[module]
    row = (0.0, 0.0, 0.0)
    dent = MeshSpec(
        x - 40.0, y - 40.0, x + 40.0, y + 40.0, (row, (0.0, -0.15, 0.0), row)
    )
    bed = replace(scene.world.bed, mesh=dent)
    return scene.with_world(bed=bed)


@pytest.mark.slow
@pytest.mark.parametrize("is_late", [False, True])
@pytest.mark.parametrize("zero", ["there", "none", "elsewhere"])
@pytest.mark.parametrize("module", COMMANDS)
def test_mesh_that_ends_before_the_point(host, module, zero, is_late):
    x, y = POINTS[module]
    places = {"there": {**ZERO}, "none": {}}
    options = {
        **MESH,
        **places.get(zero, {"zero_reference_position": "60, 60"}),
    }
    if zero == "there":
        options["zero_reference_position"] %= POINTS[module]
    with Printer(host, dented(module), {"bed_mesh": options}) as printer:
        printer.session.require_ready()
        printer.homed()
        if module == "auto_z_offset":
            # Where it homes, and so its mesh
            printer.run(f"G1 X{x} Y{y} F6000")
        scripts = [ADAPTIVE, COMMANDS[module]][:: -1 if is_late else 1]
        printer.run(scripts[0])
        told = "\n".join(printer.run(scripts[1]))
        gap = printer.gap(PRINT)
        status = printer.status(module)
        wanted = float(table()["none"][module][0])
    if module == "auto_z_offset":
        # A mesh with its zero there, and one without, is right
        is_right = zero != "elsewhere"
        assert (abs(gap - wanted) < 0.006) == is_right, gap
        assert ("the gap is wrong" in told) == (not is_right and not is_late)
        return
    is_right = zero == "there" or (zero == "none" and not is_late)
    assert (abs(gap - wanted) < 0.006) == is_right, gap
    if zero == "elsewhere" and not is_late:
        assert "the first layer may be wrong" in told
        assert "the gap is right" not in told
        assert any("ends before" in text for text in status["warnings"])
    elif is_right:
        assert "wrong" not in told and status["valid"]
    else:
        assert not status["valid"]


# klippy rounds the distances of its points down; the second moves the mesh to it
@pytest.mark.slow
@pytest.mark.parametrize(
    ("low", "high", "script"),
    [
        ("40, 40", "150, 150", ""),
        ("40, 40", "145, 145", "BED_MESH_OFFSET X=-10 Y=-10"),
    ],
)
def test_point_at_the_end_of_the_mesh(start, low, high, script):
    mesh = bed_mesh(low, high, zero_reference_position="60, 60")
    mesh["probe_count"] = "4, 4"
    printer = start("voron", changes={"bed_mesh": mesh}).homed()
    told = "\n".join(printer.run(f"{PROBED}\n{script}\nCALIBRATE_Z"))
    assert "ends before" not in told
    assert printer.status("z_calibration")["valid"]


# The offset was made for the mesh of before
@pytest.mark.parametrize(
    ("before", "line"),
    [
        ("BED_MESH_PROFILE LOAD=default", "BED_MESH_CLEAR"),
        ("M400", "BED_MESH_PROFILE LOAD=default"),
    ],
)
def test_offset_gcode_that_changes_the_mesh(start, before, line):
    code = f"\n  {line}\n  SET_GCODE_OFFSET Z={{params.Z}}"
    sections = {
        "bed_mesh": MESH,
        "bed_mesh default": profile((0.3, 0.35, 0.45), MESH),
        "z_calibration": {"offset_gcode": code},
    }
    printer = start(SCENES["voron"], sections).homed()
    printer.run(f"{before}\nCALIBRATE_Z")
    status = printer.status("z_calibration")
    assert not status["valid"]
    assert "bed_mesh" in status["reason"]
    assert abs(printer.gap() - printer.scene.formula_gap()) > 0.2
