"""How high the head is above what it has touched, by the motors."""

from __future__ import annotations

import importlib
from types import SimpleNamespace

import pytest

touching = importlib.import_module("z_touch.touching")


class FakeHost:
    """Z motors: where the host believes each, and what the others add."""

    def __init__(self):
        self.z, self.datum, self.events = [5.0, 5.0], [1.0, 2.0], {}
        self.printer = SimpleNamespace(
            register_event_handler=self.events.__setitem__
        )

    def z_steppers(self):
        return [
            SimpleNamespace(get_commanded_position=lambda z=z: z)
            for z in self.z
        ]

    def z_datum(self):
        return self.datum


def test_height_above_the_last_touch():
    host = FakeHost()
    last = touching.LastTouch(host)
    assert last.height() is None
    last.note()
    assert last.height() == 0.0
    # Up, said to be elsewhere, levelled
    host.z = [12.0, 12.0]
    assert last.height() == pytest.approx(7.0)
    host.z, host.datum = [0.0, 0.0], [13.0, 14.0]
    assert last.height() == pytest.approx(7.0)
    host.datum = [11.0, 14.0]
    assert last.height() == pytest.approx(6.0)
    # Some hosts tell a print time
    host.events["stepper_enable:motor_off"](1.0)
    assert last.height() is None


def test_motors_that_move_x_too_tell_nothing():
    host = FakeHost()
    last = touching.LastTouch(host)
    last.note()
    host.datum = []
    assert last.height() is None
    last.note()
    assert last.height() is None
