"""The plate's surface."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.world import Bed, BedSpec, MeshSpec

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
