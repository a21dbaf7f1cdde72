"""examples/z_calibration: each is included and used, on every host.

As an owner would: `[include FILE.cfg]` below the sections of the printer, its
lines in PRINT_START, which the slicer calls.
"""

from __future__ import annotations

import configparser
import re
from collections.abc import Iterator
from operator import attrgetter
from pathlib import Path
from typing import Any

import pytest

from simprinter import Fault, heated
from simprinter.hosts.session import GcodeError
from tests.docs.documents import (
    COMMANDS,
    OPTIONS,
    options_of,
    part,
    rows,
    spans,
    text_of,
)
from tests.modules.example_owners import (
    CLEAN_NOZZLE,
    OWNERS,
    Owner,
    lines_of,
    print_start_of,
)
from tools.kit.cases import all_slow_but, slow
from tools.kit.klipper_sections import TOOL, bed_mesh
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import MICROSTEP, touched_sites

ROOT = Path(__file__).resolve().parents[2]
EXAMPLES = ROOT / "examples" / "z_calibration"
DOCUMENT = text_of("z_calibration")
# Sections around CALIBRATE_Z
MACROS, OFF, TOOLS = "calibrate_macros", "heaters_off_after_error", "tools"
PLATES = "plates"
FILES = sorted([*OWNERS, MACROS, OFF, TOOLS, PLATES])
BED, EXTRUDER, SOFT = 45.0, 185.0, 150
PRINT_START = f"PRINT_START BED={BED:g} EXTRUDER={EXTRUDER:g}"
# As other slicers call it
OTHERS = f"PRINT_START BED_TEMP={BED + 2:g} EXTRUDER_TEMP={EXTRUDER + 3:g}"
# All that have lines for it, whatever module they are of
STARTS = sorted(
    path
    for path in EXAMPLES.parent.glob("*/*.cfg")
    if "# Lines for your own PRINT_START" in path.read_text(encoding="utf-8")
)
LIMIT = 1800.0  # printer seconds


def text_of(name: str) -> str:
    """An example as it is."""
    return (EXAMPLES / f"{name}.cfg").read_text(encoding="utf-8")


def sections_of(name: str) -> dict[str, dict[str, str]]:
    """Its sections, without comments."""
    parser = configparser.RawConfigParser(
        strict=False, inline_comment_prefixes=("#",)
    )
    parser.read_string(text_of(name))
    return {s: dict(parser.items(s)) for s in parser.sections()}


def included(path: Path) -> dict[str, Any]:
    """What the owner's printer.cfg gets more: the file, and its lines."""
    return {f"include {path}": {}, **print_start_of(path)}


def print_start(printer: Printer) -> list[str]:
    """Run it; the console lines."""
    printer.session.require_ready()
    return printer.session.run(PRINT_START, LIMIT)


def formula_gap(printer: Printer) -> float:
    """True gap at Z=0 that a perfect calibration leaves, mm.

    What levelling has laid along the bed rises as the bed does: the body that
    is so far beside the plunger is met that much higher.
    """
    settings = printer.status("configfile")["settings"]
    section, world = settings["z_calibration"], printer.scene.world
    assert world.mag_probe is not None
    gap = world.mag_probe.switch_offset - section["switch_offset"]
    if not {"quad_gantry_level", "z_tilt"} & {*settings}:
        return gap
    home = settings.get("safe_z_home", {}).get("home_xy_position")
    nozzle = section.get("nozzle_xy_position") or home
    probe = settings["probe"]
    for number, (axis, slope) in enumerate(
        (("x", world.bed.slope_x), ("y", world.bed.slope_y))
    ):
        plunger = nozzle[number] - probe[f"{axis}_offset"]
        gap += slope * (section["switch_xy_position"][number] - plunger)
    return gap


def assert_soft_and_clean(lines: list[str]) -> None:
    """The nozzle was soft, cleaned, and only then measured."""
    text = "\n".join(lines)
    cleaned = re.search(r"cleaned at (\d+) C, target (\d+)", text)
    touched = text.find("nozzle at z=")
    assert cleaned
    assert cleaned.end() < touched
    assert int(cleaned[2]) == SOFT, "too hot, or too cold, when it is cleaned"
    assert int(cleaned[1]) == pytest.approx(SOFT, abs=6)


def assert_ready_to_print(printer: Printer, owner: Owner) -> None:
    """The heaters hot, the probe away, and the true gap right."""
    for name, target in (("heater_bed", BED), ("extruder", EXTRUDER)):
        heater = printer.status(name)
        assert heater["target"] == target
        assert heater["temperature"] > target - 3.0, f"{name} is not hot"
    kinds = [event.kind for event in printer.machine.truth.events]
    assert kinds
    assert kinds == ["attach", "dock"] * (len(kinds) // 2)
    status = printer.status("z_calibration")
    assert (status["valid"], status["reason"]) == (True, "")
    assert printer.machine.truth.touches[-1].site == "probe_bed"
    wanted, gap = formula_gap(printer), printer.gap(owner.bed)
    assert gap == pytest.approx(wanted, abs=2 * MICROSTEP), "the gap is wrong"
    for point in owner.far:
        # Levelling and mesh have errors of their own
        gap = printer.gap(point)
        assert gap == pytest.approx(wanted, abs=4 * MICROSTEP), "mesh"


# As they are


@pytest.mark.parametrize(
    "name", all_slow_but(["voron24_klicky"], sorted(OWNERS))
)
def test_print_start_ends_at_the_right_height(start, name):
    owner = OWNERS[name]
    path = EXAMPLES / f"{name}.cfg"
    printer = start(owner.scene, changes=included(path))
    lines = print_start(printer)
    assert_soft_and_clean(lines)
    assert "is far from position_endstop" not in "\n".join(lines)
    assert_ready_to_print(printer, owner)


@pytest.mark.slow
def test_next_print_starts_as_well(host):
    # The offset of the first one, a large one, would miss the dock
    owner = OWNERS["euclid"]
    changes = included(EXAMPLES / "euclid.cfg")
    with Printer(host, owner.scene, changes) as printer:
        print_start(printer)
        printer.run("SET_GCODE_OFFSET Z_ADJUST=6 MOVE=1")
        print_start(printer)
        assert_ready_to_print(printer, owner)


@pytest.mark.slow
@pytest.mark.parametrize(
    "path",
    STARTS,
    ids=attrgetter("stem"),
)
def test_print_start_without_temperatures_does_nothing(start, path):
    printer = start(heated(SCENES["voron"]), changes=print_start_of(path))
    targets = ["heater_bed", "extruder"]
    printer.session.require_ready()
    text = printer.fail("PRINT_START MATERIAL=ABS")
    assert "'BED_TEMP'" in text
    assert [printer.status(name)["target"] for name in targets] == [0.0, 0.0]
    assert printer.status("toolhead")["homed_axes"] == ""


@pytest.mark.slow
def test_slicer_that_sends_other_names(host):
    owner = OWNERS["cartesian_switch"]
    changes = included(EXAMPLES / "cartesian_switch.cfg")
    with Printer(host, owner.scene, changes) as printer:
        printer.session.require_ready()
        printer.session.run(OTHERS, LIMIT)
        found = [
            printer.status(name)["target"]
            for name in ("heater_bed", "extruder")
        ]
        assert found == [BED + 2, EXTRUDER + 3]


def test_every_example_is_run():
    assert sorted(path.stem for path in EXAMPLES.iterdir()) == FILES


# As documented


def commands_of(name: str) -> Iterator[list[str]]:
    """Every line of G-code in a file, in words, comments included."""
    if name in OWNERS:
        lines = lines_of(EXAMPLES / f"{name}.cfg").splitlines()
        yield from (line.split() for line in lines)
    for section in sections_of(name).values():
        for option, value in section.items():
            if option.endswith("gcode"):
                yield from (line.split() for line in value.split("\n") if line)


@pytest.mark.parametrize("name", sorted({*FILES} - {MACROS, PLATES}))
def test_options_are_documented(name):
    current = [option.name for option in options_of(part(DOCUMENT, OPTIONS))]
    old = [option.name for option in options_of(part(DOCUMENT, "Old names"))]
    used = set(sections_of(name)["z_calibration"])
    assert used
    assert used <= set(current) - set(old)


@pytest.mark.parametrize("name", sorted([*OWNERS, MACROS, PLATES]))
def test_parameters_are_documented(name):
    below = part(part(DOCUMENT, COMMANDS), "CALIBRATE_Z")
    known = {spans(row[0])[0] for row in rows(below)}
    runs = [words for words in commands_of(name) if words[0] == "CALIBRATE_Z"]
    assert runs
    for words in runs:
        given = {w.partition("=")[0] for w in words[1:] if "=" in w}
        assert given <= known


# With mistakes


def told(printer: Printer) -> str:
    """Why an example does not get as far as printing."""
    state, message = printer.session.start()
    if state != "ready":
        assert printer.machine.truth.touches == []
        return message
    with pytest.raises(GcodeError) as caught:
        print_start(printer)
    assert printer.session.state()[0] == "ready"
    return str(caught.value)


@pytest.mark.parametrize(
    ("name", "old", "new", "message"),
    [
        # Levelling lowers this gantry by more than a millimetre
        slow(
            *("voron24_klicky", "#     G28 Z  ", "#     M400 #"),
            "home Z again (G28 Z) after any levelling",
        ),
        (
            *("trident_z_tilt", "nozzle_xy_position: 173, 300.5\n"),
            "nozzle_xy_position: 183, 300\n",
            "check nozzle_xy_position",
        ),
        # Where the nozzle is
        slow(
            *("cartesian_switch", "221.5, 118", "244, 118"),
            "check switch_xy_position",
        ),
        (
            *("cartesian_switch", "start_gcode: ATTACH_PROBE\n", ""),
            "it is not attached, or not wired as normally closed; attach it in"
            " start_gcode or before_switch_gcode and check it with QUERY_PROBE",
        ),
    ],
)
def test_mistake_of_an_owner_is_told(host, tmp_path, name, old, new, message):
    owner, text = OWNERS[name], text_of(name)
    assert text.count(old) == 1
    path = tmp_path / f"{name}.cfg"
    path.write_text(text.replace(old, new), encoding="utf-8")
    with Printer(host, owner.scene, included(path)) as printer:
        assert message in told(printer)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("attach_fails", "Probe stowed, not deployed"),
        ("dock_fails", "Probe deployed, not stowed"),
    ],
)
def test_euclid_macros_look_at_the_probe(host, fault, message):
    owner = OWNERS["euclid"]
    changes = included(EXAMPLES / "euclid.cfg")
    for number in (1, 2):
        faults = [Fault(fault, n=number, command="PRINT_START")]
        with Printer(host, owner.scene, changes, faults) as printer:
            assert message in told(printer)


# The macros around CALIBRATE_Z


def with_macros(**sections: Any) -> dict[str, Any]:
    """What the owner's printer.cfg gets more."""
    path = EXAMPLES / f"{MACROS}.cfg"
    return {
        "gcode_macro CLEAN_NOZZLE": CLEAN_NOZZLE,
        f"include {path}": {},
        **sections,
    }


@pytest.fixture
def macros(start):
    """The voron with the macros, homed."""
    return start(heated(SCENES["voron"]), with_macros()).homed()


def measured(printer: Printer, script: str) -> bool:
    """Run it; whether it has touched anything."""
    before = len(printer.machine.truth.touches)
    printer.run(script)
    return bool(touched_sites(printer, before))


def test_calibration_is_made_only_if_needed(macros):
    assert measured(macros, "CALIBRATE_Z_IF_NEEDED")
    offset = macros.offset()
    assert offset != 0.0
    macros.run("SET_GCODE_OFFSET Z=0.3")
    assert not measured(macros, "CALIBRATE_Z_IF_NEEDED")
    assert macros.offset() == pytest.approx(offset, abs=1e-6)
    assert measured(macros, "CALIBRATE_Z_IF_NEEDED SWITCH_OFFSET=0.4")
    assert macros.offset() == pytest.approx(offset + 0.04, abs=2 * MICROSTEP)
    assert measured(macros, "G28 Z\nCALIBRATE_Z_IF_NEEDED")
    assert macros.gap() == pytest.approx(
        macros.scene.formula_gap(), abs=2 * MICROSTEP
    )


def test_run_that_has_failed_says_that_a_calibration_is_needed(macros):
    """A longer nozzle was screwed in without homing: 1.5 mm into the bed."""
    macros.run("CALIBRATE_Z\nG1 Z60 F900\nM400")
    macros.machine.world.exchange_nozzle(1.5)
    macros.fail("CALIBRATE_Z")
    assert macros.status("z_calibration")["measured"]
    assert "the switch did not answer" in macros.fail("CALIBRATE_Z_IF_NEEDED")
    assert "echo: calibrating: the last run has failed" in (
        macros.session.console
    )
    macros.run("G28\nCALIBRATE_Z_IF_NEEDED")
    assert macros.gap() == pytest.approx(
        macros.scene.formula_gap(), abs=2 * MICROSTEP
    )
    assert not measured(macros, "CALIBRATE_Z_IF_NEEDED")


# What offset_gcode adds belongs to it, and Z_ADJUST is for one print
@pytest.mark.slow
def test_what_holds_is_what_was_applied(start):
    code = "\n  SET_GCODE_OFFSET Z={params.Z|float + 0.05}"
    own = {"offset_gcode": f"{code}\n  Z_CALIBRATION_KEEP_OFFSET"}
    section = {**SCENES["voron"].sections["z_calibration"], **own}
    changes = with_macros(z_calibration=section)
    printer = start(heated(SCENES["voron"]), changes).homed()
    assert measured(printer, "CALIBRATE_Z_IF_NEEDED")
    applied = printer.offset()
    assert not measured(printer, "CALIBRATE_Z_IF_NEEDED")
    assert printer.offset() == pytest.approx(applied, abs=1e-6)
    lines = printer.run("Z_CALIBRATION_SAVE_GCODE_OFFSET SAVE=0")
    assert any("nothing was changed with baby steps" in n for n in lines)
    assert measured(printer, "CALIBRATE_Z_IF_NEEDED Z_ADJUST=-0.05")
    assert measured(printer, "CALIBRATE_Z_IF_NEEDED")
    assert printer.offset() == pytest.approx(applied, abs=2 * MICROSTEP)


@pytest.mark.slow
@pytest.mark.parametrize("before", [0, 200])
def test_nozzle_is_soft_and_clean_for_the_calibration(macros, before):
    macros.run(f"M109 S{before}")
    lines = macros.run("CALIBRATE_Z_CLEAN")
    assert_soft_and_clean(lines)
    assert macros.status("extruder")["target"] == SOFT


def second_tool(tmp_path):
    """Its nozzle is as hot as a soft one, always."""
    path = tmp_path / "temp"
    path.write_text("150000")
    return {"extruder1": {**TOOL, "sensor_path": str(path)}}


@pytest.mark.slow
def test_the_nozzle_of_the_active_tool_is_soft(start, tmp_path):
    scene = heated(SCENES["voron"])
    changes = with_macros(**second_tool(tmp_path))
    printer = start(scene, changes).homed()
    printer.run("ACTIVATE_EXTRUDER EXTRUDER=extruder1\nCALIBRATE_Z_CLEAN")
    assert printer.status("z_calibration")["valid"]
    assert printer.status("extruder1")["target"] == SOFT
    assert printer.status("extruder")["target"] == 0


@pytest.mark.slow
def test_bed_is_measured_below_the_print(macros):
    before = len(macros.machine.truth.touches)
    macros.run("CALIBRATE_Z_AT_PRINT X_MIN=50 Y_MIN=60.5 X_MAX=110 Y_MAX=90")
    touches = macros.machine.truth.touches[before:]
    x, y = touches[-1].x, touches[-1].y
    # The toolhead, with the probe above the middle
    assert (x, y) == pytest.approx((80 + 2, 75.2 - 24.75), abs=0.06)


def with_plates(start, tmp_path, more=()):
    path = EXAMPLES / f"{PLATES}.cfg"
    variables = {"filename": str(tmp_path / "variables.cfg")}
    changes = {f"include {path}": {}, "save_variables": variables, **dict(more)}
    return start(changes=changes).homed()


def test_plates_keep_a_value(start, tmp_path):
    printer = with_plates(start, tmp_path)
    printer.run(
        "KEEP_PLATE PLATE=Textured Z=0.03\nKEEP_PLATE PLATE=satin Z=-0.01"
    )
    for plate, z_adjust in (("textured", 0.03), ("SATIN", -0.01), ("new", 0)):
        printer.run(f"CALIBRATE_Z_ON_PLATE PLATE={plate}")
        assert printer.status("z_calibration")["z_adjust"] == z_adjust
        assert printer.offset() == pytest.approx(0.16 + z_adjust, abs=0.001)


@pytest.mark.slow
def test_plates_keep_their_baby_steps(start, tmp_path):
    printer = with_plates(start, tmp_path)
    assert "CALIBRATE_Z_ON_PLATE first" in printer.fail("KEEP_Z_OF_PLATE")
    printer.run("CALIBRATE_Z_ON_PLATE PLATE=Textured")
    plain = printer.offset()
    # As at the end of many a print
    for script in ("Z=0", "Z_ADJUST=0.51"):
        printer.run(f"SET_GCODE_OFFSET {script}")
        assert "something has reset" in printer.fail("KEEP_Z_OF_PLATE")
        printer.run(f"SET_GCODE_OFFSET Z={plain}")
    printer.run("SET_GCODE_OFFSET Z_ADJUST=0.03\nKEEP_Z_OF_PLATE")
    # Also after a restart, and nothing counts twice
    printer.session.restart("RESTART")
    printer.run("G28\nCALIBRATE_Z_ON_PLATE PLATE=textured")
    assert printer.offset() == pytest.approx(plain + 0.03, abs=2 * MICROSTEP)
    printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.01\nKEEP_Z_OF_PLATE")
    printer.run("CALIBRATE_Z_ON_PLATE PLATE=textured")
    assert printer.offset() == pytest.approx(plain + 0.02, abs=2 * MICROSTEP)
    printer.run("CALIBRATE_Z_ON_PLATE")
    assert printer.offset() == pytest.approx(plain, abs=2 * MICROSTEP)


# What a mesh shifts is no baby step
@pytest.mark.slow
def test_plates_keep_nothing_else(start, tmp_path):
    mesh = bed_mesh("50, 50", "250, 250")
    more = {"bed_mesh": mesh, "probe": {"z_offset": "6.9"}}
    printer = with_plates(start, tmp_path, more)
    run = "G28\nBED_MESH_CALIBRATE\nCALIBRATE_Z_ON_PLATE PLATE=textured"
    printer.run(run)
    plain, steps = printer.offset(), 0.0
    for step in (0.02, 0.01):
        steps += step
        printer.run(f"SET_GCODE_OFFSET Z_ADJUST={step}\nKEEP_Z_OF_PLATE\n{run}")
        wanted = pytest.approx(plain + steps, abs=2 * MICROSTEP)
        assert printer.offset() == wanted


@pytest.mark.slow
def test_plates_keep_nothing_of_another_tool(start, tmp_path):
    path = EXAMPLES / f"{PLATES}.cfg"
    variables = {"filename": str(tmp_path / "variables.cfg")}
    changes = {f"include {path}": {}, "save_variables": variables}
    scene = heated(SCENES["voron"])
    printer = start(scene, {**changes, **second_tool(tmp_path)}).homed()
    printer.run("CALIBRATE_Z_ON_PLATE PLATE=a")
    other = "ACTIVATE_EXTRUDER EXTRUDER=extruder1"
    printer.run(f"{other}\nSET_GCODE_OFFSET Z_ADJUST=-0.3")
    assert "extruder1 is active" in printer.fail("KEEP_Z_OF_PLATE")


@pytest.mark.slow
def test_tools_keep_their_offsets(start):
    path = EXAMPLES / f"{TOOLS}.cfg"
    scene = heated(SCENES["voron"])
    printer = start(scene, {f"include {path}": {}}).homed()
    assert "No Z offset of extruder yet" in printer.fail("USE_Z_OFFSET_OF_TOOL")
    printer.run("CALIBRATE_Z")
    offset = printer.offset()
    assert offset != 0.0
    # The other tool, with one of its own
    printer.run("SET_GCODE_OFFSET Z=0.3\nUSE_Z_OFFSET_OF_TOOL")
    assert printer.offset() == pytest.approx(offset, abs=1e-6)


@pytest.mark.slow
def test_names_are_nobody_elses():
    """No file of examples/ brings what printers have already."""
    theirs = "PRINT_START", "PRINT_END", "G28", "M401", "M402", "CLEAN_NOZZLE"
    shared = ("bed_mesh", "safe_z_home", "homing_override", "stepper_z")
    for path in EXAMPLES.parent.glob("*/*.cfg"):
        text = path.read_text(encoding="utf-8")
        found = re.findall(r"(?m)^\[(?:gcode_macro )?(\w+)\]", text)
        assert not {*theirs, *shared} & {*found}, path


@pytest.mark.slow
def test_heaters_are_turned_off_by_one_file_only():
    for path in EXAMPLES.parent.glob("*/*.cfg"):
        turns_off = "error_gcode" in path.read_text(encoding="utf-8")
        assert turns_off == (path.stem == OFF), path


@pytest.mark.slow
def test_macro_of_the_document_is_the_example():
    (shown,) = re.findall(
        r"(?s)(\[gcode_macro CALIBRATE_Z_IF_NEEDED\].*?endif %}\n)", DOCUMENT
    )
    assert shown in text_of(MACROS)


@pytest.mark.slow
def test_nothing_stays_hot_after_a_failure(start, tmp_path):
    about = {"site": "nozzle_pin", "touch": 2, "command": "CALIBRATE_Z"}
    faults = [Fault("trigger_never", **about)]
    scene = heated(SCENES["voron"])
    path = EXAMPLES / f"{OFF}.cfg"
    changes = {f"include {path}": {}, **second_tool(tmp_path)}
    printer = start(scene, changes, faults).homed()
    printer.machine.tolerate("nozzle_pin", 1.01)
    printer.run("M140 S40\nM104 T0 S150\nACTIVATE_EXTRUDER EXTRUDER=extruder1")
    printer.run("M104 S150")
    before = len(printer.session.console)
    error = printer.fail("CALIBRATE_Z")
    (line,) = [
        line
        for line in printer.session.console[before:]
        if line.startswith("echo: No print: ")
    ]
    assert "nozzle: the switch did not answer" in line
    assert "nozzle: the switch did not answer" in error
    for name in ("extruder", "extruder1", "heater_bed"):
        assert printer.status(name)["target"] == 0
