"""examples/dockable_probe: each is loaded and used, on every host."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from simprinter import heated
from tests.modules.example_owners import print_start_of
from tests.modules.test_auto_z_offset_examples import sections_of
from tools.kit.cases import all_slow_but
from tools.kit.dockable_probe import BED, GANTRY, SWITCH, trips, where
from tools.kit.docks import SLINGER

EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "dockable_probe"
MACHINES = {
    "gantry": GANTRY,
    "bed_slinger": SLINGER,
    "beside_the_bed": BED,
    "servo": GANTRY,
    "with_z_calibration": SWITCH,
}
MESH = {
    "zero_reference_position": "150, 150",
    "mesh_min": "30, 40",
    "mesh_max": "270, 270",
    "probe_count": "3, 3",
    "speed": "200",
    "horizontal_move_z": "12",
}


def machine_of(name):
    """The scene that a file is for, with its dock where the file says."""
    scene = heated(MACHINES[name])
    sections = sections_of(EXAMPLES / f"{name}.cfg")
    options = sections["dockable_probe"]
    options["pin"] = "^PC3"
    dock, probe = scene.world.dock, scene.world.mag_probe
    place = [float(v) for v in options["dock_position"].split(",")]
    world = replace(
        scene.world,
        dock=replace(dock, x=place[0], y=place[1]),
        mag_probe=replace(
            probe,
            x_offset=float(options["x_offset"]),
            y_offset=float(options["y_offset"]),
            body_drop=float(options["z_offset"]) - 0.485,
        ),
    )
    own = {k: v for k, v in scene.sections.items() if k not in sections}
    if name in ("bed_slinger", "gantry", "servo"):
        own.pop("safe_z_home", None)
    sections |= print_start_of(EXAMPLES / f"{name}.cfg")
    if name != "servo":
        sections["bed_mesh"] = MESH
    own.pop("quad_gantry_level", None)
    if "servo dock" in sections:
        sections["servo dock"]["pin"] = "PD5"
    return replace(scene, name=name, sections={**own, **sections}, world=world)


def test_each_example_has_a_machine():
    assert {path.stem for path in EXAMPLES.glob("*.cfg")} == set(MACHINES)


@pytest.mark.parametrize(
    "name", all_slow_but(["gantry", "with_z_calibration"], MACHINES)
)
def test_print_start(start, name):
    printer = start(machine_of(name))
    printer.session.require_ready()
    printer.run("PRINT_START BED=30 EXTRUDER=170")
    assert where(printer) == "docked"
    assert trips(printer).count("attach") == trips(printer).count("dock") > 0
    assert printer.machine.truth.min_gap > 0.0
    if name == "with_z_calibration":
        assert trips(printer) == ["attach", "dock"]
