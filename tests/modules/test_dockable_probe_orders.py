"""Ordinary commands in ordinary orders around a dock: nothing is hit."""

from __future__ import annotations

import contextlib
from dataclasses import replace

import pytest

from simprinter.hosts.session import GcodeError
from tools.campaign.walks.machines import BASES, overridden
from tools.kit.carrying import QUICK, pressed, with_all
from tools.kit.cases import slow
from tools.kit.dockable_probe import trips, where
from tools.kit.docks import DOCK_SCENES
from tools.kit.printer import firmware_of

OVER = "G90\nG1 Z20 F900\nG1 X150 Y150 F6000"
STAYS = {"restore_toolhead": "False"}
SCREWS = {
    "bed_screws": {
        "screw1": "15, 270",
        "screw2": "240, 30",
        "screw3": "60, 30",
        "speed": "100",
    }
}
INTO = "MOVE_TO_DOCK_PROBE"
TWIST = "AXIS_TWIST_COMPENSATION_CALIBRATE"
BY_HAND = "BED_MESH_CALIBRATE METHOD=manual"
AROUND = "MOVE_AVOIDING_DOCK X=20 Y=300 SPEED=100"
# The machine, options of the dock, and what is done
ORDERS = {
    "G28 Z from the dock": ("dock_near_pin", {}, [INTO, "G28 Z"]),
    "Z_TILT_ADJUST from detach_position": (
        "dock_frame",
        {},
        ["MOVE_TO_DETACH_PROBE", "Z_TILT_ADJUST"],
    ),
    "twist from detach_position": (
        "dock_frame",
        {},
        ["MOVE_TO_DETACH_PROBE", TWIST],
    ),
    "a mesh by hand from the dock": ("dock_frame", {}, [INTO, BY_HAND]),
    "into the way of a servo": (
        "dock_servo",
        {},
        ["G1 X60 Y300 F6000", "ATTACH_PROBE"],
    ),
    "into the way of a servo, to dock": (
        "dock_servo",
        {},
        ["ATTACH_PROBE", "G1 X60 Y300 F6000", "DETACH_PROBE"],
    ),
    "twist over a dock": ("dock_above", STAYS, ["PROBE", TWIST]),
    "a mesh by hand over a dock": ("dock_above", STAYS, ["PROBE", BY_HAND]),
    "twist from approach_position over a dock": (
        "dock_above",
        {},
        ["MOVE_TO_APPROACH_PROBE", TWIST],
    ),
    "a servo that was left out": (
        "dock_servo",
        {},
        ["PROBE", INTO, AROUND, "G28"],
    ),
    "screws across the dock": (
        "dock_gantry",
        STAYS,
        ["PROBE", "BED_SCREWS_ADJUST"],
    ),
    "a mesh from over the dock": (
        "dock_above",
        STAYS,
        ["ATTACH_PROBE", "BED_MESH_CALIBRATE"],
    ),
    "EXTRA_PROBE_CALIBRATE from the dock": (
        "dock_gantry_switch",
        {},
        [INTO, "EXTRA_PROBE_CALIBRATE PROBE=membrane"],
    ),
    "a probe that is on, from detach_position": (
        "dock_frame",
        {},
        ["ATTACH_PROBE", "MOVE_TO_DETACH_PROBE", "Z_TILT_ADJUST"],
    ),
    "the same without trips": (
        "dock_frame",
        {},
        [
            "ATTACH_PROBE",
            "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=0",
            "MOVE_TO_DETACH_PROBE",
            "Z_TILT_ADJUST",
        ],
    ),
    "G28 from beside the dock": ("dock_gantry", {}, [AROUND, "G28"]),
    "CALIBRATE_Z from the dock": (
        "dock_gantry_switch",
        {},
        [INTO, "CALIBRATE_Z"],
    ),
}
USUAL = ("G28 Z from the dock", "into the way of a servo")


@pytest.mark.every_host
@pytest.mark.parametrize(
    "order", [order if order in USUAL else slow(order) for order in ORDERS]
)
def test_nothing_is_hit(start, order):
    base, options, scripts = ORDERS[order]
    changes = {"dockable_probe": {**QUICK, **options}, **SCREWS}
    printer = start(BASES[base], changes).homed()
    printer.run("\n".join([OVER, *scripts, "M400"]))
    printer.session.wait(2.0)
    printer.machine.truth.require_no_crash()
    assert pressed(printer) < 0.1


# Whatever a macro does at once after its last touch
@pytest.mark.every_host
@pytest.mark.parametrize("delayed", ["True", "False"])
def test_first_layer_at_once(start, tmp_path, delayed):
    lines = "G28\nG90\nG1 Z0.3 F600\nG1 X200 Y150 F3000\nG1 X100\n"
    (tmp_path / "a.gcode").write_text(lines)
    own = {**QUICK, "allow_delayed_detach": delayed}
    card = {"virtual_sdcard": {"path": str(tmp_path)}}
    changes = {"dockable_probe": own, **card}
    printer = start(DOCK_SCENES["dock_gantry"], changes)
    printer.session.require_ready()
    printer.run("SDCARD_PRINT_FILE FILENAME=a.gcode")
    printer.session.wait(120)
    printer.machine.truth.require_no_crash()
    assert where(printer) == "docked"


# Afterwards nobody would find the dock, and homing goes on from where the head is
@pytest.mark.slow
@pytest.mark.every_host
@pytest.mark.parametrize("end", ["M84", "SAVE_CONFIG"])
@pytest.mark.parametrize(
    ("base", "restore"), [("dock_bed", "True"), ("dock_near_pin", "False")]
)
def test_what_ends_a_docking_that_is_to_come(start, base, restore, end):
    own = {**QUICK, "allow_delayed_detach": "True", "restore_toolhead": restore}
    printer = start(BASES[base], {"dockable_probe": own}).homed()
    script = f"{OVER}\nBED_MESH_CALIBRATE"
    if end == "SAVE_CONFIG":
        printer.session.restart(f"{script}\n{end}")
    else:
        printer.run(f"{script}\n{end}")
    assert where(printer) == "docked"
    assert trips(printer)[-1] == "dock"
    printer.run("G28\nM400")
    printer.machine.truth.require_no_crash()


# Z is anything for a moment there, and the way to such a dock goes by it
@pytest.mark.slow
@pytest.mark.every_host
@pytest.mark.parametrize(
    ("base", "script"),
    [
        ("dock_bed", "ATTACH_PROBE\nG28\nG28"),
        slow("dock_above", "MOVE_TO_APPROACH_PROBE\nG28\nG28"),
    ],
)
def test_homing_override_and_a_dock_with_a_height(start, base, script):
    scene = overridden(BASES[base])
    printer = start(scene, {"dockable_probe": dict(QUICK)}).homed()
    printer.run(f"{OVER}\n{script}\nM400")
    assert where(printer) == "docked"
    printer.machine.truth.require_no_crash()


@pytest.mark.every_host
@pytest.mark.slow
def test_tilt_by_hand_of_kalico(start, host):
    if firmware_of(host) != "Kalico":
        pytest.skip("it has no z_tilt_ng")
    scene = with_all(DOCK_SCENES["dock_frame"])
    tilt = {
        **scene.sections["z_tilt"],
        "points": "100, 100\n  150, 230\n  250, 100",
        "extra_points": "150, 100\n  100, 150\n  250, 150",
    }
    changes = {
        "z_calibration": None,
        "z_tilt": None,
        "z_tilt_ng": tilt,
        "dockable_probe": dict(QUICK),
    }
    flat = replace(scene.world.bed, slope_x=0.0, slope_y=0.0)
    printer = start(scene.with_world(bed=flat), changes).homed()
    printer.run(f"{OVER}\nATTACH_PROBE\nZ_TILT_CALIBRATE METHOD=manual")
    assert where(printer) == "docked"
    with contextlib.suppress(GcodeError):
        printer.run("TESTZ Z=-7\nM400")
    assert pressed(printer) < 0.1


# "About how far" the probe hangs below the nozzle is what the set-up asks for
@pytest.mark.every_host
@pytest.mark.parametrize("z_offset", ["4", slow("4.8")])
@pytest.mark.parametrize(
    "then", ["PROBE", slow("ATTACH_PROBE"), slow("BED_MESH_CALIBRATE")]
)
def test_z_offset_that_is_too_small(start, z_offset, then):
    own = {**QUICK, "z_offset": z_offset}
    printer = start(DOCK_SCENES["dock_gantry_switch"], {"dockable_probe": own})
    printer.homed().run(f"{OVER}\nPROBE\n{then}\nM400")
    assert printer.machine.truth.drag("probe_bed") < 0.5
    assert pressed(printer) < 0.2
    # Z is another one once it was homed again
    printer.run("G28")
    height = printer.session.position()[2]
    printer.run("ATTACH_PROBE")
    assert printer.session.position()[2] >= height


@pytest.mark.parametrize("z", ["4", "12"])
def test_dock_that_is_lower_than_the_probe_hangs_is_told(start, z):
    own = {"dock_position": f"50, 308, {z}"}
    printer = start(DOCK_SCENES["dock_bed"], {"dockable_probe": own})
    printer.session.require_ready()
    printer.session.wait(10.0)
    told = "".join(printer.status("dockable_probe")["notes"])
    assert (f"Z of the dock ({z}) is less than the probe hangs" in told) == (
        z == "4"
    )
