"""What the Z motors tell of how high the toolhead is."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import pytest

heights = importlib.import_module("z_touch.dockable_probe.height")


def moved(z, datum):
    """With these Z of the motors, and what they have moved besides."""
    steppers = [
        SimpleNamespace(get_commanded_position=lambda z=z: z) for z in z
    ]
    axes = SimpleNamespace(z_steppers=lambda: steppers, z_datum=lambda: datum)
    host = SimpleNamespace(axes=axes)
    return heights.Height.motors_z(SimpleNamespace(host=host))


def test_mean_of_what_the_motors_have_moved():
    assert moved([5.0, 5.0], [1.0, 2.0]) == pytest.approx(6.5)
    # Up; said to be elsewhere; levelled
    assert moved([12.0, 12.0], [1.0, 2.0]) == pytest.approx(13.5)
    assert moved([0.0, 0.0], [13.0, 14.0]) == pytest.approx(13.5)
    assert moved([0.0, 0.0], [11.0, 14.0]) == pytest.approx(12.5)


def test_motors_that_move_x_too_tell_nothing():
    assert moved([5.0, 5.0], []) is None


def test_motors_that_were_off_may_have_been_moved():
    height = SimpleNamespace(lifted=9.0, homed_z=3.0)
    # Some hosts tell a print time
    heights.Height.forget(height, 1.0)
    assert (height.lifted, height.homed_z) == (0.0, None)
