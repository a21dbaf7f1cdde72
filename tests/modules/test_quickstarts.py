"""The quick starts of docs/, followed word for word on the printer that each is for."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

from simprinter import heated
from simprinter.world import AxisSwitchSpec
from tests.docs.documents import blocks, ini_blocks, part
from tests.modules.example_owners import OWNERS
from tests.modules.test_auto_z_offset_examples import machine_of, sections_of
from tests.modules.test_z_calibration_examples import (
    BED,
    EXTRUDER,
    assert_ready_to_print,
    print_start,
)
from tools.kit.auto_z_offset import POINT as QIDI_POINT
from tools.kit.auto_z_offset import told
from tools.kit.dockable_probe import GANTRY
from tools.kit.extra_probe import (
    CALIBRATE,
    CONTINUE,
    MICROSTEP,
    NAME,
    fixed_switch,
    lay,
)
from tools.kit.scenes import SCENES

DOCS = Path(__file__).resolve().parents[2] / "docs"
PAGES = sorted(path.stem for path in DOCS.glob("quickstart_*.md"))


def text_of(name: str) -> str:
    """A page as it is."""
    return (DOCS / f"{name}.md").read_text(encoding="utf-8")


def section_of(name: str, title: str) -> dict:
    """The sections that a quick start shows below a heading."""
    return ini_blocks(part(text_of(name), title))


# Voron: the section and the macro of the middle are run by test_readme


@pytest.mark.parametrize(
    ("owner", "title"),
    [
        ("voron_late_probe", "The probe is in the way of the nozzle"),
        ("separate_pin", "Z is homed with the probe"),
    ],
)
def test_other_vorons_begin_with_their_section(start, tmp_path, owner, title):
    text = part(text_of("quickstart_voron_klicky"), title)
    file = tmp_path / "mine.cfg"
    file.write_text(blocks(text, "ini")[0])
    printer = start(OWNERS[owner].scene, changes={f"include {file}": {}})
    printer.session.require_ready()
    lines = printer.run("G28\nZ_CALIBRATION_SETUP")
    assert "// action:prompt_show" in lines


def test_numbers_of_the_pin_are_those_of_the_example():
    shown = section_of("quickstart_voron_klicky", "Z is homed with the probe")
    file = DOCS.parent / "examples" / "z_calibration" / "separate_pin.cfg"
    example = sections_of(file)["z_calibration"]
    for option in ("endstop_pin", "position_min"):
        value = shown["z_calibration"][option].partition("#")[0].strip()
        assert example[option] == value


# Voron 0


def voron0():
    """A Voron 0 as Voron's own file has it: Z is homed 120 mm below the bed."""
    scene = SCENES["membrane"]
    world = scene.world
    x, y, _ = world.switches
    place = replace(world.membrane, x=60.0, y=60.0)
    scene = scene.with_world(
        switches=(x, y, AxisSwitchSpec("z_endstop", "z", 120.6137, 1)),
        membrane=place,
    )
    axis = {
        "position_endstop": "120",
        "position_max": "120",
        "position_min": "-1.5",
        "homing_speed": "20",
        "second_homing_speed": "3.0",
        "homing_retract_dist": "3.0",
    }
    stepper = {**scene.sections["stepper_z"], **axis}
    sections = {**scene.sections, "stepper_z": stepper}
    return heated(replace(scene, sections=sections))


def test_membrane_of_a_voron_0_ends_with_the_bed_at_zero(start):
    sections = section_of("quickstart_voron0", "2. Write a section")
    own = {
        name: value.partition("#")[0].strip()
        for name, value in sections["extra_probe membrane"].items()
    }
    assert own["pin"] == "^!gpio16"
    # The input of the simulated board, wired in the same way
    own["pin"] = "^!PF5"
    room = {
        name: value.partition("#")[0].strip()
        for name, value in sections["stepper_z"].items()
    }
    changes = {"extra_probe membrane": own, "stepper_z": room}
    printer = start(voron0(), changes=changes)
    printer.session.require_ready()
    typed = blocks(text_of("quickstart_voron0"), "")[0]
    printer.run("G28")
    printer.run(f"{CALIBRATE} SAVE=1")
    lay(printer)
    printer.run(CONTINUE)
    printer.machine.lay_membrane(False)
    printer.run(CONTINUE)
    printer.session.restart("SAVE_CONFIG")
    printer.run("G28")
    assert printer.gap((60.0, 60.0)) == pytest.approx(0.0, abs=2 * MICROSTEP)
    printer.run(typed)
    assert printer.status("toolhead")["position"][:3] == [60.0, 60.0, 0.1]
    assert printer.machine.truth.min_gap > 0.0


# A switch beside the bed


def test_nozzle_switch_is_right_after_another_nozzle(start):
    page = "quickstart_nozzle_switch"
    shown = ini_blocks(text_of(page))
    own = {
        name: value.partition("#")[0].strip()
        for name, value in shown["extra_probe nozzle_switch"].items()
    }
    assert own["pin"] == "^!PE12"
    own["pin"] = "^PF6"
    macro = shown["gcode_macro PRINT_START"]
    code = re.sub(r" *QUAD_GANTRY_LEVEL.*\n", "", macro["gcode"])
    macro = {"gcode": code}
    over = (191.0, 165.0)
    scene = heated(fixed_switch(at=(289.0, 361.0), over=over, size=370.0))
    sections = {n: s for n, s in scene.sections.items() if n != NAME}
    # Paper has found it
    sections["probe"] = {**sections["probe"], "z_offset": "2.2713"}
    scene = replace(scene, sections=sections)
    name = "extra_probe nozzle_switch"
    changes = {name: own, "gcode_macro PRINT_START": macro}
    measure, try_it = blocks(text_of(page), "")
    printer = start(scene, changes=changes).homed()
    (line,) = told(printer.run(measure), "Result is z=")
    height = float(re.search(r"z=(-?[\d.]+)", line)[1])
    own["switch_height"] = f"{height:.3f}"
    again = start(scene, changes=changes)
    again.session.require_ready()
    lines = again.run(try_it)
    (line,) = told(lines, "new offset=")
    assert abs(float(line.split("new offset=")[1])) < 0.01
    # Another nozzle, whose tip is 0.1 mm lower
    probe = scene.world.inductive
    lower = replace(probe, sense_distance=probe.sense_distance - 0.1)
    printed = start(scene.with_world(inductive=lower), changes=changes)
    printed.session.require_ready()
    printed.session.run("PRINT_START BED=45 EXTRUDER=185", 1800.0)
    assert printed.offset() == pytest.approx(0.1, abs=0.02)
    assert printed.gap(over) == pytest.approx(0.0, abs=2.5 * MICROSTEP)


# QIDI


@pytest.mark.parametrize(
    ("name", "probe", "lowest"),
    [("q1_pro_freedi", "0", "-4"), ("plus4_freedi", "1.0", "-2")],
)
def test_qidi_is_measured_as_the_page_says(start, name, probe, lowest):
    scene, changes = machine_of(name)
    text = " ".join(text_of("quickstart_qidi").split())
    assert f"`z_offset: {probe}`" in text
    assert f"`probe_z_min: {lowest}`" in text
    assert float(changes["probe"]["z_offset"]) == float(probe)
    assert float(changes["auto_z_offset"]["probe_z_min"]) == float(lowest)
    assert changes["auto_z_offset"]["z_offset"] == "0.2"
    printer = start(scene, changes=changes)
    printer.session.require_ready()
    printer.run("SET_PIN PIN=bed_sensor VALUE=1")
    assert "auto_z_offset:open" in " ".join(printer.run("QUERY_ENDSTOPS"))
    lines = printer.run("CALIBRATE_OFFSET BED=40")
    (line,) = told(lines, "AUTO_Z_CALIBRATE: average of 3, range")
    assert float(re.search(r"range ([\d.]+)", line)[1]) < 0.02
    printer.run("G90\nG1 Z0 F300")
    gap = printer.gap(QIDI_POINT)
    # "about 0.15 mm above the bed"
    assert 0.1 < gap < 0.2
    # Two steps down, kept: the sum goes into z_offset with its sign
    for _ in range(2):
        printer.run("SET_GCODE_OFFSET Z_ADJUST=-0.02 MOVE=1")
    printer.run("AUTO_Z_SAVE_GCODE_OFFSET")
    printer.session.restart("SAVE_CONFIG")
    changes["auto_z_offset"]["z_offset"] = "0.16"
    again = start(scene, changes=changes)
    again.session.require_ready()
    again.run("CALIBRATE_OFFSET BED=40")
    assert again.gap(QIDI_POINT) == pytest.approx(gap - 0.04, abs=0.01)


# Dock


def test_dock_is_ready_to_be_shown(start):
    """The section of the page, and what it says one sees before the set-up."""
    shown = section_of("quickstart_dock", "2. Write a section")
    own = {
        name: value.partition("#")[0].strip()
        for name, value in shown["dockable_probe"].items()
    }
    assert own["pin"] == "^PG15"
    own["pin"] = "^PC3"
    scene = GANTRY
    kept = {n: s for n, s in scene.sections.items() if n != "dockable_probe"}
    place = {"safe_z_position": "150, 130"}
    kept.pop("safe_z_home", None)
    printer = start(
        replace(scene, sections=kept),
        changes={"dockable_probe": {**own, **place}},
    )
    printer.session.require_ready()
    assert "DOCKED" in " ".join(printer.run("GET_PROBE_STATUS"))
    printer.run("G28 X Y")
    printer.machine.world.put_probe_on(printer.now())
    assert "ATTACHED" in " ".join(printer.run("GET_PROBE_STATUS"))
    lines = printer.run("DOCKABLE_PROBE_SETUP")
    assert "// action:prompt_show" in lines
    printer.run("DOCKABLE_PROBE_SETUP STEP=ABORT")


# Slicers

# What the slicers put in the place of their names
PLACEHOLDERS = {
    "[bed_temperature_initial_layer_single]": BED,
    "[nozzle_temperature_initial_layer]": EXTRUDER,
    "[first_layer_bed_temperature]": BED,
    "{first_layer_temperature[initial_extruder]}": EXTRUDER,
    "{first_layer_temperature[initial_extruder] +"
    " extruder_temperature_offset[initial_extruder]}": EXTRUDER,
    "{material_bed_temperature_layer_0}": BED,
    "{material_print_temperature_layer_0}": EXTRUDER,
}
SLICERS = ("orca", "prusa", "super", "cura")


@pytest.mark.parametrize("slicer", SLICERS)
def test_lines_of_the_slicer_start_the_print(start, slicer):
    text = text_of("slicers")
    (lines,) = blocks(text, slicer)
    for name, value in PLACEHOLDERS.items():
        lines = lines.replace(name, f"{value:g}")
    assert not re.search(r"[\[{]", lines), "a name that is not known here"
    assert (
        lines.splitlines()[-1]
        == f"PRINT_START BED={BED:g} EXTRUDER={EXTRUDER:g}"
    )
    if slicer != SLICERS[0]:
        return
    owner = OWNERS["voron24_klicky"]
    macro = ini_blocks(part(text, "Which line does what in PRINT_START?"))
    file = DOCS.parent / "examples" / "z_calibration" / "voron24_klicky.cfg"
    changes = {f"include {file}": {}, **macro}
    printer = start(owner.scene, changes=changes)
    printer.session.require_ready()
    for line in lines.splitlines()[:-1]:
        printer.run(line)
    print_start(printer)
    assert_ready_to_print(printer, owner)


def test_every_quick_start_is_followed_here():
    with_sections = {name for name in PAGES if "```ini" in text_of(name)}
    assert with_sections == {
        "quickstart_dock",
        "quickstart_nozzle_switch",
        "quickstart_voron0",
        "quickstart_voron_klicky",
    }
