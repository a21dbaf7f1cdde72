"""A host that knows of a twisted X axis: the gap is right all the same."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.modules.test_z_touch_faults import OTHERS
from tools.kit.auto_z_offset import PROBE_PLACE, true_gap, world
from tools.kit.cases import slow
from tools.kit.docks import DOCK_SCENES, calibrating
from tools.kit.klipper_sections import bed_mesh
from tools.kit.load_errors import load
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES
from tools.kit.z_calibration import (
    BED,
    MICROSTEP,
    TRIGGER,
    calibration,
    with_extra,
)

# Both measurements of auto_z_offset have their heights there, and 0.15 mm
MEASURED = PROBE_PLACE
TWIST = 0.15 / MEASURED[0]
# Where twice as much is added to the heights of the probe
FAR = (2 * MEASURED[0], MEASURED[1])


def compensation(host, scene, start_x, end_x, *heights):
    """[axis_twist_compensation] that a host takes: mm from end to end of X."""
    options = {
        "calibrate_start_x": f"{start_x}",
        "calibrate_end_x": f"{end_x}",
        "calibrate_y": "120",
        "z_compensations": ", ".join(map(str, heights)),
    }
    ends = {
        "compensation_start_x": f"{start_x}",
        "compensation_end_x": f"{end_x}",
    }
    # Newer hosts need the ends, older ones refuse them
    for section in ({**options, **ends}, options):
        changes = {"axis_twist_compensation": section}
        if load(host, changes, scene)[0] == "ready":
            return changes
    raise AssertionError(f"{host.name} takes no [axis_twist_compensation]")


# The heights of a mesh have the twist in them
@pytest.mark.parametrize("corner", [slow(("250", "250")), ("90", "90")])
@pytest.mark.parametrize(
    "scene",
    [SCENES["voron"], calibrating(DOCK_SCENES["dock_gantry_switch"])],
    ids=["probe", "dockable_probe"],
)
def test_mesh_that_ends_before_the_point_of_a_twisted_axis(host, scene, corner):
    changes = compensation(host, scene, 0, 300, 0.1, 0.1)
    changes["bed_mesh"] = bed_mesh("50, 50", "250, 250")
    with Printer(host, scene, changes) as printer:
        printer.homed()
        ends = ",".join(corner)
        printer.run(f"BED_MESH_CALIBRATE MESH_MIN=50,50 MESH_MAX={ends}")
        printer.run("CALIBRATE_Z")
        gap = printer.gap((70.0, 70.0))
        wanted = printer.scene.formula_gap()
    assert gap == pytest.approx(wanted, abs=2 * MICROSTEP)


def test_probe_of_others_on_a_twisted_axis(host, tmp_path):
    """Its results may be anything: nobody asks what would be added to them."""
    changes = compensation(host, "voron", 0, 300, 0.1, 0.1)
    changes["extra"] = {}
    files = with_extra(tmp_path, OTHERS)
    with Printer(host, "voron", changes, modules=files) as printer:
        printer.machine.tolerate("body_bed", 1.0)
        printer.homed().run("CALIBRATE_Z")
        gap = printer.gap()
        wanted = printer.scene.formula_gap()
    assert gap == pytest.approx(wanted, abs=2 * MICROSTEP)


@pytest.mark.every_host(
    "homing knows of the twist on some hosts, on others it does not"
)
@pytest.mark.parametrize("home", [slow(MEASURED), FAR])
def test_corrected_probe_on_a_twisted_axis(host, home):
    inductive = SCENES["qidi"].world.inductive
    scene = world(inductive=replace(inductive, twist=-TWIST))
    changes = compensation(host, "qidi", 0, 200, 0.0, 200 * TWIST)
    changes["safe_z_home"] = {"home_xy_position": "%g, %g" % home}
    with Printer(host, scene, changes) as printer:
        printer.homed().run("G90\nPROBE")
        seen = printer.status("probe")["last_z_result"]
        if home == FAR and seen > 0.1:
            # A homing that does not know of it, 0.15 mm lower
            text = printer.fail("AUTO_Z_CALIBRATE")
            assert "home Z again (G28)" in text
            return
        printer.run("AUTO_Z_CALIBRATE")
        over = home[0] + inductive.x_offset, home[1] + inductive.y_offset
        gap = printer.scene.piezo_gap()
        assert printer.gap(over) == pytest.approx(gap, abs=2 * MICROSTEP)


# Where homing knows it, Z=0 is another one afterwards, and nobody would say so
@pytest.mark.every_host(
    "homing knows of the twist on some hosts, on others it does not"
)
def test_new_twist_is_told(host):
    correction = {"probe_z_correction": "-1.12"}
    # The toolhead has to reach both ends with the probe
    heights = (20 * TWIST, 200 * TWIST)
    changes = compensation(host, "qidi", 20, 200, *heights)
    changes["safe_z_home"] = {"home_xy_position": "%g, %g" % FAR}
    changes["auto_z_offset"] = correction
    with Printer(host, "qidi", changes) as printer:
        printer.homed().run("G90\nPROBE")
        knows = printer.status("probe")["last_z_result"] < 0.1
        lines = printer.run("AXIS_TWIST_COMPENSATION_CALIBRATE\nABORT")
    told = "another twist moves the Z=0 of G28" in "\n".join(lines)
    assert told is knows


def test_correction_goes_with_a_mesh_where_a_switch_homes_z(host):
    # The mesh has the twist on every host
    name = "piezo_cartesian"
    inductive = replace(SCENES[name].world.inductive, twist=-TWIST)
    scene = world(name, inductive=inductive)
    changes = {
        **compensation(host, name, 0, 200, 0.0, 200 * TWIST),
        "stepper_z": {
            "endstop_pin": "^PC8",
            "position_endstop": "0",
            "position_min": "-4",
        },
        "safe_z_home": None,
        "force_move": {"enable_force_move": "true"},
        "bed_mesh": {
            "mesh_min": "40,40",
            "mesh_max": "200,200",
            "speed": "150",
        },
    }
    with Printer(host, scene, changes) as printer:
        printer.session.require_ready()
        printer.run("SET_KINEMATIC_POSITION X=%g Y=%g Z=%g" % scene.start)
        printer.run("G90\nAUTO_Z_CALIBRATE\nBED_MESH_CALIBRATE")
        gap = scene.piezo_gap()
        assert true_gap(printer) == pytest.approx(gap, abs=2 * MICROSTEP)


@pytest.mark.every_host("hosts correct other heights with the twist")
def test_twist_is_in_no_height_of_z_calibration(host):
    # 0.15 mm at the bed, none at the pin
    changes = compensation(host, "voron", 150, 260, 0.15, 0.0)
    with Printer(host, "voron", changes) as printer:
        (probe, *_), _ = calibration(printer.homed())
        assert probe == pytest.approx(BED + TRIGGER, abs=MICROSTEP)
        gap = printer.scene.formula_gap()
        assert printer.gap() == pytest.approx(gap, abs=2 * MICROSTEP)
