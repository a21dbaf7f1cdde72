"""bed_spread: the nozzle on a textured plate, at points around the configured one."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from itertools import combinations

import pytest

from simprinter.world import TextureSpec
from tools.kit.auto_z_offset import POINT, section, touches
from tools.kit.scenes import SCENES

AT = re.compile(r"bed sensor: triggered at z=\S+ at (\S+), (\S+)$")


def rough(seed, sigma=0.015):
    texture = TextureSpec(sigma=sigma, seed=seed)
    bed = replace(SCENES["qidi"].world.bed, texture=texture)
    return SCENES["qidi"].with_world(bed=bed)


def points_of(printer, script="AUTO_Z_CALIBRATE"):
    """Where the nozzle has touched in a command (mm), and what that said."""
    before = len(printer.machine.truth.touches)
    lines = printer.run(script)
    found = touches(printer, before)
    return [(t.x, t.y) for t in found if t.site == "nozzle_bed"], lines


@pytest.mark.parametrize(
    ("samples", "cycles", "retract"), [("1", "6", "3"), ("3", "2", "0.2")]
)
def test_each_touch_is_at_a_point_of_its_own(start, samples, cycles, retract):
    """Also between two touches, where the nozzle is lifted clear of the plate."""
    options = {"samples": samples, "offset_samples": cycles}
    options["sample_retract_dist"] = retract
    changes = section(bed_spread="3", **options)
    printer = start(rough(1), changes=changes).homed()
    points, lines = points_of(printer)
    told = [m.groups() for m in map(AT.search, lines) if m]
    assert [
        pytest.approx(tuple(map(float, p)), abs=0.02) for p in told
    ] == points
    assert len(points) == 6
    assert max(math.dist(point, POINT) for point in points) <= 3.0
    assert min(math.dist(a, b) for a, b in combinations(points, 2)) > 0.9
    assert printer.machine.truth.drag("nozzle_bed") == 0.0


def test_each_run_has_other_points(start):
    # So that no dent is met each time
    changes = section(bed_spread="3", samples="3", offset_samples="1")
    printer = start(rough(1), changes=changes).homed()
    first, _ = points_of(printer)
    before = len(printer.machine.truth.touches)
    printer.run("G28\nAUTO_Z_CALIBRATE")
    touches = printer.machine.truth.touches[before:]
    second = [(t.x, t.y) for t in touches if t.site == "nozzle_bed"]
    assert len(first) == len(second) == 3
    apart = [math.dist(a, b) for a in first for b in second]
    assert min(apart) > 0.3


def test_texture_is_no_reason_to_begin_again(start):
    """samples_tolerance is for one point, and cycles_tolerance, too."""
    options = {"samples_tolerance": "0.01", "cycles_tolerance": "0.01"}
    changes = section(bed_spread="3", samples="6", **options)
    points, lines = points_of(start(rough(2), changes=changes).homed())
    assert len(points) == 18
    assert not any("differ" in line for line in lines)
    changes = section(bed_spread="3", samples="6", **options)
    text = (
        start(rough(2, 0.07), changes=changes).homed().fail("AUTO_Z_CALIBRATE")
    )
    assert "samples_tolerance is 0.1100 mm" in text


@pytest.mark.slow
def test_point_of_a_command_stays_one(start):
    changes = section(bed_spread="3", samples="3")
    printer = start(rough(1), changes=changes).homed()
    printer.run("G1 X100 Y100 F6000\nM400")
    points, _ = points_of(printer, "AUTO_Z_PROBE")
    assert points == [pytest.approx((100.0, 100.0), abs=0.02)] * 3
