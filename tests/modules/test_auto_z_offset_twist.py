"""AUTO_Z_TWIST: right in the middle and at the sides, by what the host itself adds."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter.world import Bed
from tools.kit.auto_z_offset import (
    MICROSTEP,
    POINT,
    PROBE_PLACE,
    formulas,
    pending,
    state,
    told,
    touches,
    world,
)
from tools.kit.klipper_sections import bed_mesh
from tools.kit.load_errors import load
from tools.kit.printer import Printer
from tools.kit.scenes import SCENES

# What an owner wants of it (mm)
RIGHT = 0.01
STEPS = 2 * MICROSTEP
TWISTED = "axis_twist_compensation"
ENDS_X = {
    "calibrate_start_x": "20",
    "calibrate_end_x": "225",
    "calibrate_y": f"{POINT[1]:g}",
}
ENDS_Y = {
    "calibrate_start_y": "20",
    "calibrate_end_y": "225",
    "calibrate_x": f"{POINT[0]:g}",
}
INDUCTIVE = SCENES["qidi"].world.inductive
# Rolled more at the right end: 0.27 mm from end to end
BENT = {"twist": 0.0005, "bend": 4e-6}
WITH_MESH = {
    "safe_z_home": {"home_xy_position": "%g, %g" % PROBE_PLACE},
    "bed_mesh": {
        **bed_mesh("20, 20", "225, 225"),
        "probe_count": "6, 4",
        "horizontal_move_z": "6",
        "zero_reference_position": "%g, %g" % POINT,
    },
}
ALONG = (25.0, 60.0, 95.0, 150.0, 190.0, 220.0)
ALONG_X = [(x, POINT[1]) for x in ALONG]
ALONG_Y = [(POINT[0], y) for y in ALONG]


def twisted(**twist):
    """The world of a printer with such a rail."""
    return world(inductive=replace(INDUCTIVE, **twist))


def with_section(**more):
    """Changes to the sections: the host's own, with another option or two."""
    return {TWISTED: {**ENDS_X, **more}}


def knows_y(host):
    """Whether the host takes the options of Y."""
    return load(host, with_section(**ENDS_Y), "qidi")[0] == "ready"


def errors_seen(printer, places):
    """By how much (mm) the host's PROBE is wrong about the bed, with the probe over it."""
    bed = Bed(printer.scene.world.bed)
    found = []
    for x, y in places:
        head = x - INDUCTIVE.x_offset, y - INDUCTIVE.y_offset
        printer.run("G90\nG1 Z6 F900\nG1 X%g Y%g F6000\nPROBE" % head)
        seen = printer.status("probe")["last_z_result"]
        found.append(seen - bed.height(x, y))
    return found


def spread(heights):
    """From the lowest to the highest, mm."""
    return max(heights) - min(heights)


@pytest.mark.every_host("hosts count and save a twist differently")
def test_right_in_the_middle_and_at_the_sides(host):
    """The owner's way through it, from the wrong first layer to the right one."""
    scene, gap = twisted(**BENT), SCENES["qidi"].piezo_gap()
    changes = {**with_section(), **WITH_MESH}
    with Printer(host, scene, changes) as printer:
        printer.homed().run("AUTO_Z_CALIBRATE\nBED_MESH_CALIBRATE")
        left, right = ALONG_X[0], ALONG_X[-1]
        assert printer.gap(POINT) == pytest.approx(gap, abs=STEPS)
        assert printer.gap(left) < gap - 0.08
        assert printer.gap(right) > gap + 0.08

        printer.run("BED_MESH_CLEAR\nG28")
        lines = printer.run("AUTO_Z_TWIST")
        assert told(lines, "along X: z_compensations: 0.1")
        assert told(lines, "after SAVE_CONFIG run G28, AUTO_Z_CALIBRATE and")
        # Where the toolhead stood with the probe over the ends; older hosts look the
        # values up between the ends of the nozzle's line
        saved = pending(printer)[TWISTED]
        ends = ("2.400", "207.400") if knows_y(host) else ("20.000", "225.000")
        assert saved["compensation_start_x"] == ends[0]
        assert saved["compensation_end_x"] == ends[1]
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28\nAUTO_Z_CALIBRATE")
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28\nBED_MESH_CALIBRATE\nAUTO_Z_LOAD_OFFSET")
        gaps = [printer.gap(place) for place in [POINT, *ALONG_X]]
        assert gaps == pytest.approx([gap] * len(gaps), abs=RIGHT)
        printer.run("BED_MESH_CLEAR")
        assert spread(errors_seen(printer, ALONG_X)) <= RIGHT


@pytest.mark.every_host("some hosts know a twist along X only")
def test_along_y(host):
    scene = twisted(twist=0.001, twist_y=-0.001)
    if not knows_y(host):
        with Printer(host, scene, with_section()) as printer:
            text = printer.homed().fail("AUTO_Z_TWIST AXIS=Y")
            assert "of this Klipper knows X only; AXIS=Y needs one" in text
        return
    with Printer(host, scene, with_section(**ENDS_Y)) as printer:
        printer.homed()
        assert spread(errors_seen(printer, ALONG_Y)) > 0.15
        # X first, which stays in force beside it
        printer.run("AUTO_Z_TWIST")
        printer.session.restart("SAVE_CONFIG")
        lines = printer.run("G28\nAUTO_Z_TWIST AXIS=y SAMPLE_COUNT=3")
        assert told(lines, "along Y: zy_compensations: -0.1")
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28")
        assert spread(errors_seen(printer, ALONG_Y + ALONG_X)) <= RIGHT


# Where the touches are


@pytest.mark.parametrize("samples", [1, 4])
def test_both_touch_the_same_points(host, samples):
    changes = with_section()
    changes["auto_z_offset"] = {
        "samples": f"{samples}",
        "offset_samples": "2",
    }
    with Printer(host, "qidi", changes) as printer:
        printer.homed().run("G4 P100")
        first = len(printer.machine.truth.touches)
        printer.run("AUTO_Z_TWIST SAMPLE_COUNT=3")
        found = touches(printer, first)
    places = (20.0, 122.5, 225.0)
    # As often as AUTO_Z_CALIBRATE touches its point
    wanted = [x for x in places for _ in range(max(samples, 2))]
    nozzle = [t for t in found if t.site == "nozzle_bed"]
    assert [t.x for t in nozzle] == pytest.approx(wanted, abs=0.02)
    across = [POINT[1]] * len(wanted)
    assert [t.y for t in nozzle] == pytest.approx(across, abs=0.02)
    # It senses the bed as well while the nozzle is pressed on it
    at = [t for t in found if t not in nozzle and t.y < POINT[1] - 1.0]
    assert [t.x + INDUCTIVE.x_offset for t in at] == pytest.approx(
        wanted, abs=0.02
    )
    assert [t.y + INDUCTIVE.y_offset for t in at] == pytest.approx(
        across, abs=0.02
    )


def test_textured_plate_is_touched_around_each_point(host):
    changes = with_section()
    changes["auto_z_offset"] = {"bed_spread": "3"}
    with Printer(host, "qidi", changes) as printer:
        printer.homed().run("G4 P100")
        first = len(printer.machine.truth.touches)
        printer.run("AUTO_Z_TWIST SAMPLE_COUNT=2")
        found = touches(printer, first)
    nozzle = [t for t in found if t.site == "nozzle_bed"]
    for x, three in ((20.0, nozzle[:3]), (225.0, nozzle[3:])):
        away = [abs(t.x - x) + abs(t.y - POINT[1]) for t in three]
        assert len(three) == 3
        assert 0.5 < min(away) < max(away) < 5.0


# 0.6 mm from point to point, up or down
@pytest.mark.parametrize("slope", [0.012, -0.012])
def test_bed_that_is_not_level(host, slope):
    bed = replace(SCENES["qidi"].world.bed, slope_x=slope, z0=0.3 - 120 * slope)
    with Printer(host, world(bed=bed), with_section()) as printer:
        lines = printer.homed().run("AUTO_Z_TWIST")
        found = formulas(lines)
        assert len(found) == 5
        bent = abs(found[-1].sensor - found[0].sensor)
        assert bent == pytest.approx(205 * abs(slope), abs=0.01)
        assert spread([f.correction for f in found]) <= STEPS


# What stays as it was


def test_correction_and_offset_stay(host):
    changes = with_section()
    changes["auto_z_offset"] = {"probe_z_correction": "-1.12"}
    with Printer(host, twisted(twist=0.001), changes) as printer:
        printer.homed().run(
            "AUTO_Z_LOAD_OFFSET\nSET_GCODE_OFFSET Z_ADJUST=0.02"
        )
        before = state(printer)
        printer.run("AUTO_Z_TWIST SAMPLE_COUNT=2")
        after = state(printer)
        assert list(after.pop("pending")) == [TWISTED]
        assert before.pop("pending") == {}
        seen = after["status"].pop("last_z")
        assert before["status"].pop("last_z") is None
        assert seen == pytest.approx(-1.4, abs=0.05)
        assert after == before


# Refused before anything moves


def refused(printer, command="AUTO_Z_TWIST"):
    """What a command says that must not begin."""
    first = len(touches(printer))
    position = printer.status("toolhead")["position"]
    text = printer.fail(command)
    assert len(touches(printer)) == first
    assert printer.status("toolhead")["position"] == position
    assert TWISTED not in pending(printer)
    return text


def test_section_is_missing(host):
    with Printer(host, "qidi") as printer:
        text = refused(printer.homed())
    assert text == (
        "auto_z_offset: section 'axis_twist_compensation' is missing, with which"
        " Klipper uses what is measured; write it, with calibrate_start_x,"
        " calibrate_end_x, calibrate_y"
    )


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (
            {"calibrate_end_x": "250"},
            "Point 5 of 5 in section 'axis_twist_compensation' needs the toolhead at"
            " X=250.000, outside its",
        ),
        (
            {"calibrate_start_x": "10"},
            "Point 1 of 5 in section 'axis_twist_compensation', with the probe above"
            " it, needs the toolhead at X=-7.600, outside its",
        ),
        (
            {"calibrate_y": "-2"},
            "with the probe above it, needs the toolhead at Y=-6.400, outside its",
        ),
        (
            {"calibrate_end_x": "20"},
            "calibrate_start_x and calibrate_end_x in section"
            " 'axis_twist_compensation' are both 20; write the two ends of the bed",
        ),
    ],
)
def test_points_that_are_none(host, options, words):
    with Printer(host, "qidi", with_section(**options)) as printer:
        text = refused(printer.homed())
    assert words in text


def test_spread_around_a_point_that_is_out_of_reach(host):
    changes = with_section(calibrate_end_x="243")
    with Printer(host, "qidi", changes) as printer:
        printer.homed().run("AUTO_Z_TWIST SAMPLE_COUNT=2")
    changes["auto_z_offset"] = {"bed_spread": "5"}
    with Printer(host, "qidi", changes) as printer:
        text = refused(printer.homed())
    assert (
        "'bed_spread: 5' in section 'auto_z_offset' needs the toolhead at X=24"
        in text
    )
    assert "; change calibrate_start_x, calibrate_end_x, calibrate_y" in text


def test_line_that_is_not_given(host):
    changes = {TWISTED: ENDS_Y}
    if load(host, changes, "qidi")[0] != "ready":
        pytest.skip("the host does not start without the line along X")
    with Printer(host, "qidi", changes) as printer:
        text = refused(printer.homed())
        assert "does not say where to measure; write calibrate_start_x," in text
        printer.run("AUTO_Z_TWIST AXIS=Y SAMPLE_COUNT=2")


@pytest.mark.parametrize(
    ("params", "words"),
    [
        ("SAMPLE_COUNT=1", "SAMPLE_COUNT must have minimum of 2"),
        ("SAMPLE_COUNT=51", "SAMPLE_COUNT must have maximum of 50"),
        ("AXIS=Z", "AXIS has to be X or Y"),
    ],
)
def test_wrong_parameters(host, params, words):
    with Printer(host, "qidi", with_section()) as printer:
        text = refused(printer.homed(), f"AUTO_Z_TWIST {params}")
    assert words in text


def test_mesh_in_force(host):
    with Printer(host, "qidi", {**with_section(), **WITH_MESH}) as printer:
        printer.homed().run("BED_MESH_CALIBRATE")
        text = refused(printer)
        assert (
            "a bed mesh is in force, which was probed with the twist in it; run"
            in text
        )
        printer.run("BED_MESH_CLEAR\nAUTO_Z_TWIST SAMPLE_COUNT=2")


@pytest.mark.every_host("hosts keep and forget a twist differently")
def test_twist_in_force(host):
    with Printer(host, twisted(twist=0.001), with_section()) as printer:
        printer.homed().run("AUTO_Z_TWIST SAMPLE_COUNT=2")
        wanted = pending(printer)[TWISTED]
        printer.session.restart("SAVE_CONFIG")
        printer.run("G28")
        text = refused(printer)
        assert (
            "z_compensations in section 'axis_twist_compensation' is in force"
            in text
        )
        # What it says to do
        printer.run("AXIS_TWIST_COMPENSATION_CALIBRATE AXIS=X\nABORT\nG28")
        printer.run("AUTO_Z_TWIST SAMPLE_COUNT=2")
        assert pending(printer)[TWISTED] == wanted


# What goes wrong on the way


def test_what_no_twist_is(host):
    changes = with_section()
    with Printer(host, twisted(twist=0.0055), changes) as printer:
        printer.homed()
        text = printer.fail("AUTO_Z_TWIST")
        assert "the error of the probe differs by 1.13" in text
        assert "1 mm is the limit of a twist" in text
        assert pending(printer) == {}
