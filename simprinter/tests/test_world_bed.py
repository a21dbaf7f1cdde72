"""The plate's surface."""

from __future__ import annotations

import math
import statistics
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.tests.world_machines import BED as BED_OF_MAG
from simprinter.tests.world_machines import (
    MAG,
    MEMBRANE,
    MIDDLE,
    PIEZO,
    Driver,
    make,
)
from simprinter.world import Bed, BedSpec, MeshSpec, TextureSpec

HEIGHTS = ((0.0, 0.2, -0.1), (0.3, 0.1, 0.05), (-0.2, 0.0, 0.4))
GRID = MeshSpec(10.0, 20.0, 110.0, 220.0, HEIGHTS)
BED = Bed(BedSpec(mesh=GRID))


@pytest.mark.parametrize("row", range(3))
@pytest.mark.parametrize("column", range(3))
def test_mesh_points_are_met_and_exact_in_between(row, column):
    x, y = 10.0 + 50.0 * column, 20.0 + 100.0 * row
    assert BED.height(x, y) == pytest.approx(HEIGHTS[row][column])
    if row < 2 and column < 2:
        (a, b), (c, d) = (
            r[column : column + 2] for r in HEIGHTS[row : row + 2]
        )
        quarter = 0.75 * (0.75 * a + 0.25 * b) + 0.25 * (0.75 * c + 0.25 * d)
        assert BED.height(x + 12.5, y + 25.0) == pytest.approx(quarter)


@given(x=st.floats(-300, 600), y=st.floats(-300, 600))
def test_beyond_the_mesh_the_edge_holds(x, y):
    edge = BED.height(min(110, max(10, x)), min(220, max(20, y)))
    assert BED.height(x, y) == pytest.approx(edge)


@given(x=st.floats(0, 300), y=st.floats(0, 300))
def test_plane_comes_on_top_and_nothing_is_above_the_highest(x, y):
    bed = Bed(BedSpec(z0=1, slope_x=-0.01, slope_y=0.02, mesh=GRID))
    plane = 1 - 0.01 * x + 0.02 * y
    assert bed.height(x, y) == pytest.approx(plane + BED.height(x, y))
    assert bed.height(x, y) <= bed.highest + 1e-12


def test_plate_ends_at_its_limits():
    bed = Bed(BedSpec())
    for at in ((0, 0), (300, 300)):
        assert bed.covers(*at)
    for at in ((-0.001, 10), (10, 300.001), (300.001, 10), (10, -0.001)):
        assert not bed.covers(*at)


def test_texture_has_its_spread_and_its_length_and_no_mean():
    plates = [Bed(BedSpec(texture=TextureSpec(seed=s))) for s in range(60)]
    at = [(11.7 * i, 7.3 * i) for i in range(1, 25)]

    def product(apart):
        pairs = [
            bed.met(x, y) * bed.met(x + apart, y)
            for bed in plates
            for x, y in at
        ]
        return statistics.mean(pairs) / 0.015**2

    heights = [bed.met(x, y) for bed in plates for x, y in at]
    assert statistics.mean(heights) == pytest.approx(0.0, abs=0.001)
    assert statistics.stdev(heights) == pytest.approx(0.015, rel=0.06)
    assert product(0.5) == pytest.approx(math.exp(-1.0), abs=0.07)
    assert product(2.0) == pytest.approx(0.0, abs=0.07)
    assert max(heights) <= plates[0].highest == pytest.approx(0.06)
    again = Bed(BedSpec(texture=TextureSpec(seed=3)))
    assert [again.met(*p) for p in at] == [plates[3].met(*p) for p in at]


def test_texture_is_met_by_tip_and_plunger_and_bridged_by_the_rest():
    rough = replace(BED_OF_MAG, texture=TextureSpec(seed=4))
    surface = Bed(rough)
    x, y = MIDDLE
    worlds = {
        "nozzle": (replace(PIEZO, bed=rough), "bed_sensor", (x, y), True),
        "plunger": (replace(MAG, bed=rough), "probe", (x + 5, y + 25), True),
        "coil": (replace(PIEZO, bed=rough), "probe", (x + 17.6, y), False),
    }
    for spec, signal, at, meets in worlds.values():
        plain = replace(spec, bed=BED_OF_MAG)
        found = []
        for each in (plain, spec):
            driver = Driver(make(each))
            if signal == "bed_sensor":
                driver.world.set_output("bed_sensor_enable", 0.0, 1.0)
            found.append(driver.find(signal))
        bump = surface.met(*at) - surface.height(*at)
        assert abs(bump) > 0.001
        expected = bump if meets else 0.0
        assert found[1] - found[0] == pytest.approx(expected, abs=1e-9)
    truth = make(replace(MAG, bed=rough)).truth
    smooth = make(replace(MAG, bed=BED_OF_MAG)).truth
    assert truth.true_gap(x, y, 1.0) == smooth.true_gap(x, y, 1.0)


def test_membrane_bridges_a_texture():
    rough = replace(BED_OF_MAG, texture=TextureSpec(seed=4))
    found = []
    for bed in (BED_OF_MAG, rough):
        driver = Driver(make(replace(MEMBRANE, bed=bed)))
        driver.go(30.0, 20.0)
        found.append(driver.find("membrane"))
    assert found[0] == pytest.approx(found[1], abs=1e-9)
