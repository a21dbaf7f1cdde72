"""The plate's surface."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.simprinter.world import Bed, BedSpec, MeshSpec

HEIGHTS = ((0.0, 0.2, -0.1), (0.3, 0.1, 0.05), (-0.2, 0.0, 0.4))
GRID = MeshSpec(10.0, 20.0, 110.0, 220.0, HEIGHTS)
BED = Bed(BedSpec(mesh=GRID))


@pytest.mark.parametrize("row", range(3))
@pytest.mark.parametrize("column", range(3))
def test_mesh_points_are_met(row, column):
    x, y = 10.0 + 50.0 * column, 20.0 + 100.0 * row
    assert BED.height(x, y) == pytest.approx(HEIGHTS[row][column])


@given(x=st.floats(10, 110), y=st.floats(20, 220))
def test_between_the_points_no_corner_is_exceeded(x, y):
    column, row = min(1, int((x - 10) / 50)), min(1, int((y - 20) / 100))
    corners = [
        HEIGHTS[r][c] for r in (row, row + 1) for c in (column, column + 1)
    ]
    assert min(corners) - 1e-9 <= BED.height(x, y) <= max(corners) + 1e-9


def test_middle_of_a_cell_is_the_mean_of_its_corners():
    assert BED.height(35.0, 70.0) == pytest.approx(0.6 / 4)


@given(x=st.floats(-300, 600), y=st.floats(-300, 600))
def test_beyond_the_mesh_the_edge_holds(x, y):
    edge = BED.height(min(110, max(10, x)), min(220, max(20, y)))
    assert BED.height(x, y) == pytest.approx(edge)


@given(x=st.floats(0, 300), y=st.floats(0, 300))
def test_nothing_is_above_the_highest(x, y):
    bed = Bed(BedSpec(z0=1, slope_x=-0.01, slope_y=0.02, mesh=GRID))
    assert bed.height(x, y) <= bed.highest + 1e-12


def test_plane():
    bed = Bed(BedSpec(z0=1.0, slope_x=0.01, slope_y=-0.02))
    assert bed.height(100, 50) == pytest.approx(1.0 + 1.0 - 1.0)


@pytest.mark.parametrize(
    ("x", "y", "there"),
    [
        (0, 0, True),
        (300, 300, True),
        (-0.001, 10, False),
        (10, 300.001, False),
        (300.001, 10, False),
        (10, -0.001, False),
    ],
)
def test_plate_ends_at_its_limits(x, y, there):
    assert Bed(BedSpec()).covers(x, y) is there
