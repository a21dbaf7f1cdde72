"""Motors to nozzle tip and back."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simprinter.world import make_kinematics

KINDS = ("cartesian", "corexy", "corexz", "hybrid_corexy", "hybrid_corexz")
ONE = [("z", 10.0, 20.0)]
TWO = [("z", 0.0, 100.0), ("z1", 200.0, 100.0)]
THREE = [("z", 0.0, 0.0), ("z1", 100.0, 200.0), ("z2", 200.0, 0.0)]
FOUR = [
    ("z", -50.0, 0.0),
    ("z1", -50.0, 300.0),
    ("z2", 350.0, 300.0),
    ("z3", 350.0, 0.0),
]
SEVERAL = (TWO, THREE, FOUR)
COORDINATE = st.floats(-500, 500)


@pytest.mark.parametrize(
    ("kind", "z_motors"),
    [*((kind, ONE) for kind in KINDS), *(("corexy", z) for z in SEVERAL)],
)
@given(tip=st.tuples(COORDINATE, COORDINATE, COORDINATE))
def test_motors_lead_back_to_the_tip(kind, z_motors, tip):
    kin = make_kinematics(kind, z_motors)
    assert kin.pose(kin.motors(tip)) == pytest.approx(tip, abs=1e-8)


@pytest.mark.parametrize("z_motors", [THREE, FOUR])
def test_plane_through_the_motors(z_motors):
    kin = make_kinematics("cartesian", z_motors)
    motors = {"x": 70.0, "y": 40.0}
    for name, x, y in z_motors:
        motors[name] = 5.0 + 0.01 * x - 0.02 * y
    assert kin.pose(motors).z == pytest.approx(5.0 + 0.7 - 0.8)


def test_two_motors_tilt_along_their_line_only():
    kin = make_kinematics("cartesian", TWO)
    motors = {"x": 50.0, "y": 0.0, "z": 1.0, "z1": 3.0}
    assert kin.pose(motors).z == pytest.approx(1.5)
    assert kin.pose({**motors, "y": 300.0}).z == pytest.approx(1.5)
    one_spot = make_kinematics("cartesian", [("z", 1, 1), ("z1", 1, 1)])
    assert one_spot.pose(motors).z == pytest.approx(2.0)


def test_four_motors_off_one_plane_take_the_best_plane():
    kin = make_kinematics("cartesian", FOUR)
    motors = kin.motors((150, 150, 10), {"z": 1.0, "z2": 1.0})
    # A twist: opposite corners up has no best tilt, half of it as height
    assert kin.pose(motors) == pytest.approx((150, 150, 10.5))


@pytest.mark.parametrize(
    ("kind", "z_motors"),
    [
        ("polar", ONE),
        ("corexz", TWO),
        ("hybrid_corexz", TWO),
        ("cartesian", []),
        ("cartesian", [("z", 0, 0), ("z", 1, 1)]),
        ("cartesian", [("z9", 0, 0)]),
    ],
)
def test_impossible_machines_are_refused(kind, z_motors):
    with pytest.raises(ValueError, match="kinematics|z_motors"):
        make_kinematics(kind, z_motors)
