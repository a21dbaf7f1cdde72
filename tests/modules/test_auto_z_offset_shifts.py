"""AUTO_Z_CALIBRATE where Klipper's own features shift Z: the gap, and the words."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tools.kit.auto_z_offset import (
    MICROSTEP,
    POINT,
    section,
    told,
    true_gap,
    with_extras,
    world,
)
from tools.kit.cases import slow
from tools.kit.klipper_sections import bed_mesh, profile
from tools.kit.scenes import SCENES

STEPS = 2 * MICROSTEP
MESH = bed_mesh("50, 50", "200, 200")
# So much higher is the bed at the point than at 60, 60
HIGHER = 0.1


@pytest.mark.parametrize(
    ("sections", "wrong", "words"),
    [
        (
            {"bed_tilt": {"z_adjust": "0.017"}},
            0.017,
            "bed_tilt: Z is shifted by 0.017 mm here",
        ),
        ({"bed_tilt": {"z_adjust": "0.01"}}, 0.01, None),
        # Homed where the bed is lower by what the tilt makes good, in each cycle
        (
            {
                "safe_z_home": {"home_xy_position": "100, 60"},
                "bed_tilt": {"z_adjust": "0.08"},
                **section(offset_samples="2"),
            },
            -0.017,
            None,
        ),
    ],
)
def test_shift_that_makes_the_gap_wrong_is_told(start, sections, wrong, words):
    """What is as large as noise is not; more is in docs/features.csv."""
    slope = HIGHER / (POINT[1] - 60.0)
    bed = replace(SCENES["qidi"].world.bed, slope_y=slope, z0=-slope * POINT[1])
    printer = start(world(bed=bed), sections).homed()
    lines = printer.run("AUTO_Z_CALIBRATE")
    gap = printer.scene.piezo_gap() + wrong
    assert true_gap(printer) == pytest.approx(gap, abs=2 * STEPS)
    (text,) = told(lines, "the gap is wrong by") if words else ("",)
    assert (words or "") in text
    assert bool(words) is bool(told(lines, "the gap is wrong by"))


# Z is homed with the probe over the point; the mesh is higher there by so much
@pytest.mark.every_host("one sends no event where the probe homes Z")
@pytest.mark.parametrize(
    ("zero", "slope", "is_told"),
    [
        ("190, 190", 0.0013, True),
        # As much as noise
        ("190, 190", 0.00005, False),
        (f"{POINT[0]}, {POINT[1]}", 0.0013, False),
        (None, 0.0013, False),
    ],
)
def test_mesh_that_is_not_zero_where_z_was_homed_is_told(
    start, zero, slope, is_told
):
    bed = replace(SCENES["qidi"].world.bed, slope_x=slope, slope_y=slope)
    mesh = bed_mesh("40, 40", "200, 200")
    if zero is not None:
        mesh["zero_reference_position"] = zero
    printer = start(world(bed=bed), {"bed_mesh": mesh}).homed()
    printer.run("AUTO_Z_CALIBRATE\nG28")
    assert not told(printer.run("AUTO_Z_LOAD_OFFSET"), "the gap is wrong by")
    right = true_gap(printer)
    printer.run("G28\nBED_MESH_CALIBRATE")
    lines = printer.run("AUTO_Z_LOAD_OFFSET")
    wrong = true_gap(printer) - right
    found = told(lines, "where Z was homed with the probe: the gap is wrong")
    assert len(found) == is_told
    assert (abs(wrong) > 0.015) is is_told
    if is_told:
        assert f"bed_mesh: Z is shifted by {wrong:.2f}"[:-1] in found[0]
        assert f"at {POINT[0]:.1f}, {POINT[1]:.1f}, where" in found[0]


def test_shift_of_another_module_is_told(start):
    """By a transform that nothing here knows by its name."""
    height = -0.12
    changes = {"lift": {"height": f"{height}"}}
    printer = start("qidi", changes, modules=with_extras("lift")).homed()
    lines = printer.run("AUTO_Z_CALIBRATE")
    gap = printer.scene.piezo_gap() + height
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    words = f"another feature: Z is shifted by {height:.3f} mm here"
    assert len(told(lines, words)) == 1


BELOW = {"auto_z_offset": {"z_offset": "-0.05"}, "probe": {"z_offset": "2"}}


ZERO = "%g, %g" % POINT
OWN_MESH = {**MESH, "zero_reference_position": ZERO}
LOADS = "BED_MESH_PROFILE LOAD=default"
NO_ZERO = "bed_mesh has no zero at 119.8, 126.8"


# After it Z counts from the bed: the probe's error of 0.73 mm is in its own mesh
@pytest.mark.parametrize(
    ("sections", "before", "words", "wrong"),
    [
        ({"bed_tilt": {"z_adjust": "-0.15"}}, "", "shifted by -0.150", -0.15),
        slow({"bed_tilt": {"z_adjust": "0.01"}}, "", None, 0.01),
        (
            {"bed_mesh": MESH, "bed_mesh default": profile((-0.2,) * 3, MESH)},
            LOADS,
            "bed_mesh: Z is shifted by -0.2",
            -0.2,
        ),
        ({"bed_mesh": MESH}, "", NO_ZERO, 0.0),
        slow({"bed_mesh": OWN_MESH}, "", None, 0.0),
    ],
)
def test_zero_of_the_bed_sensor_below_a_shift(
    start, sections, before, words, wrong
):
    printer = start("qidi", {**BELOW, **sections}).homed()
    lines = printer.run(f"{before}\nAUTO_Z_HOME_Z")
    assert true_gap(printer) == pytest.approx(wrong, abs=2 * STEPS)
    told_of = [
        line for line in lines if "shifted by" in line or NO_ZERO in line
    ]
    assert len(told_of) == bool(words)
    assert not words or words in told_of[0]


# Some hosts keep it when Z is homed with the probe; QIDI's goes to Z=3
def test_g92_does_not_lower_what_prepare_gcode_does(start):
    printer = start("qidi").homed()
    over = "G90\nG1 Z20 F900\nG1 X%g Y%g F6000\nG92 Z26" % POINT
    lines = printer.run(f"{over}\nAUTO_Z_PROBE")
    assert told(lines, "G92 had moved Z=0 by -6.000 mm: undone, as G28 does")
    printer.machine.truth.require_no_crash()


def test_g92_of_prepare_gcode_is_undone(start):
    own = {"prepare_gcode": "\n  SET_PIN PIN=bed_sensor VALUE=1\n  G92 Z26"}
    printer = start("qidi", {"auto_z_offset": own}).homed()
    assert told(printer.run("AUTO_Z_CALIBRATE"), "G92 had moved Z=0 by")
    gap = printer.scene.piezo_gap()
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)


@pytest.mark.slow
def test_g92_is_undone_where_the_correction_is_loaded(start):
    printer = start("qidi").homed()
    printer.run("AUTO_Z_CALIBRATE\nG28\nG90\nG1 Z20 F900\nG92 Z10")
    lines = printer.run("AUTO_Z_LOAD_OFFSET")
    assert told(lines, "G92 had moved Z=0 by 10.000 mm: undone, as G28 does")
    gap = printer.scene.piezo_gap()
    assert true_gap(printer) == pytest.approx(gap, abs=STEPS)
    # What only makes good for it is no baby step
    printer.run("G1 Z20 F900\nG92 Z19.7\nSET_GCODE_OFFSET Z_ADJUST=-0.3")
    text = printer.fail("AUTO_Z_SAVE_GCODE_OFFSET")
    assert "G92 has moved Z=0 by 0.300 mm" in text
    printer.run("AUTO_Z_LOAD_OFFSET")
    # Where it is refused all stays
    printer.run("SET_GCODE_OFFSET Z=0\nAUTO_Z_HOME_Z\nG1 Z20 F900\nG92 Z10")
    assert "Z was set by" in printer.fail("AUTO_Z_LOAD_OFFSET")
    assert printer.status("gcode_move")["gcode_position"][2] == 10.0
