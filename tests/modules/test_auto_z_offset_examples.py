"""examples/auto_z_offset: each is loaded and used, on every host.

As an owner would: the file's sections in printer.cfg, its macro to calibrate,
a bed mesh, SAVE_CONFIG, and its lines in PRINT_START.  Only pins, and where the probe
hangs, are the simulated machine's.
"""

from __future__ import annotations

import configparser
import re
from dataclasses import replace
from pathlib import Path

import pytest

from tests.modules.example_owners import lines_of, print_start_of
from tools.kit.auto_z_offset import MICROSTEP, POINT, told
from tools.kit.cases import all_slow_but
from tools.kit.corpus import indented
from tools.kit.scenes import SCENES

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "auto_z_offset"
# Scene, and the file's pins with those of the scene
MACHINES = {
    "q1_pro": ("qidi_two_boards", {"!gpio21": "^!PF0"}),
    "plus4": ("qidi", {"^!Toolhead:PA10": "^!PF0"}),
    "q1_pro_freedi": ("qidi", {"!Toolhead:gpio21": "^!PF0"}),
    "plus4_freedi": ("qidi", {"^!Toolhead:PA10": "^!PF0"}),
    "x_max3": ("qidi", {"^!MKS_THR:gpio21": "^!PF0", "^PC3": "PC1"}),
}
MESH = {
    "speed": "150",
    "horizontal_move_z": "5",
    "mesh_min": "40,40",
    "mesh_max": "200,200",
    "probe_count": "3,3",
}
# The lowest trigger of the bed sensor that owners of a Q1 Pro have reported, and
# the room (mm) that braking takes below it
REPORTED, BRAKING = -2.74, 1.0
LEVELLING = {
    "z_positions": "\n  -30,122\n  275,122",
    "points": "\n  40,122\n  190,122",
    "speed": "150",
    "horizontal_move_z": "5",
}


def sections_of(path):
    """The sections of a file, as Klipper reads them."""
    parser = configparser.RawConfigParser(
        strict=False, inline_comment_prefixes=(";", "#")
    )
    parser.read_string(path.read_text(encoding="utf-8"))
    return {
        name: {key: indented(value) for key, value in parser.items(name)}
        for name in parser.sections()
    }


def machine_of(name):
    """The scene that the file is for, and the changes that it makes."""
    scene_name, pins = MACHINES[name]
    scene = SCENES[scene_name]
    sections = sections_of(EXAMPLES / f"{name}.cfg")
    for section in sections.values():
        if section.get("pin") in pins:
            section["pin"] = pins[section["pin"]]
    probe = sections["probe"]
    offsets = float(probe["x_offset"]), float(probe["y_offset"])
    home = f"{POINT[0] - offsets[0]}, {POINT[1] - offsets[1]}"
    switched = "output_pin bed_sensor" in sections
    world = scene.world
    scene = scene.with_world(
        inductive=replace(
            world.inductive, x_offset=offsets[0], y_offset=offsets[1]
        ),
        bed_sensor=replace(world.bed_sensor, enable_output=switched),
    )
    if not switched:
        wiring = replace(scene.wiring, outputs={})
        scene = replace(scene, wiring=wiring)
    gone = ("probe", "output_pin bed_sensor", "auto_z_offset")
    kept = {n: s for n, s in scene.sections.items() if n not in gone}
    changes = {
        **sections,
        **print_start_of(EXAMPLES / f"{name}.cfg"),
        "bed_mesh": MESH,
        "z_tilt": LEVELLING,
        "safe_z_home": {"home_xy_position": home},
    }
    return replace(scene, sections=kept), changes


@pytest.mark.parametrize("name", all_slow_but(["q1_pro"], sorted(MACHINES)))
def test_example_prints_at_the_right_height(start, name):
    scene, changes = machine_of(name)
    own = changes["auto_z_offset"]
    speed = float(own["speed"])
    gap = float(own["z_offset"]) - scene.piezo_depth(speed)
    printer = start(scene, changes=changes)
    printer.session.require_ready()
    # Nothing in it is late, too fast, or ignored
    assert told(printer.session.console, "auto_z_offset:") == []
    lines = printer.run("CALIBRATE_OFFSET BED=40")
    assert told(lines, "AUTO_Z_CALIBRATE: average of 3")
    assert printer.gap(POINT) == pytest.approx(gap, abs=2 * MICROSTEP)
    printer.run("BED_MESH_CALIBRATE")
    printer.session.restart("SAVE_CONFIG")
    names = {"q1_pro": "BED_TEMP=40 EXTRUDER_TEMP=180"}
    printer.run(f"PRINT_START {names.get(name, 'BED=40 HOTEND=180')}")
    # The mesh is between its points over there
    assert printer.gap(POINT) == pytest.approx(gap, abs=4 * MICROSTEP)


@pytest.mark.parametrize("name", sorted(MACHINES))
def test_print_start_loads_what_the_module_has_saved(name):
    path = EXAMPLES / f"{name}.cfg"
    sections = sections_of(path)
    # SAVE_CONFIG cannot change what an included file has
    assert not re.search("correct", " ".join(sections["auto_z_offset"]))
    begin = [line.split()[0] for line in lines_of(path).splitlines()]
    assert "AUTO_Z_CALIBRATE" not in begin
    # What the slicers' profiles for these printers send, and those of others
    assert {"BED", "HOTEND", "BED_TEMP", "EXTRUDER_TEMP"} == set(
        re.findall(r"params\.(\w+)", lines_of(path))
    )
    before = begin[: begin.index("AUTO_Z_LOAD_OFFSET")]
    assert {"G28", "BED_MESH_PROFILE"} <= set(before)


def test_every_example_is_run():
    assert {path.stem for path in EXAMPLES.glob("*.cfg")} == set(MACHINES)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["q1_pro", "plus4"])
def test_freedi_has_the_same_sensors(name):
    """Only the names of boards differ."""
    own, freedi = (
        sections_of(EXAMPLES / f"{name}{which}.cfg")
        for which in ("", "_freedi")
    )
    for section in own.values():
        if "pin" in section:
            section["pin"] = re.sub(r"U_1:|Toolhead:", "", section["pin"])
    for section in freedi.values():
        if "pin" in section:
            section["pin"] = section["pin"].replace("Toolhead:", "")
    assert own == freedi


@pytest.mark.slow
@pytest.mark.parametrize("name", ["q1_pro", "q1_pro_freedi"])
def test_q1_pro_as_its_owners_have_it(name):
    read = configparser.ConfigParser(interpolation=None, delimiters=(":",))
    read.read_string((EXAMPLES / f"{name}.cfg").read_text(encoding="utf-8"))
    floor = read["auto_z_offset"].getfloat("probe_z_min")
    assert -5.0 < floor < REPORTED - BRAKING
    # Without power the sensor reads triggered
    pin = read["output_pin bed_sensor"]
    assert (pin["value"], pin["shutdown_value"]) == ("1", "1")
