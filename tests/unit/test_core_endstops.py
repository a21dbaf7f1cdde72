"""An endstop that is looked at while commands may ask the same pin."""

from __future__ import annotations

import threading
from types import SimpleNamespace

from z_touch.core.endstops import Endstops


class Mutex:
    """As the one that klippy's commands take in turn."""

    def __init__(self):
        self.lock = threading.Lock()
        self.test = self.lock.locked

    def __enter__(self):
        assert self.lock.acquire(blocking=False)

    def __exit__(self, *error):
        self.lock.release()


def test_pin_is_asked_by_one_at_a_time():
    mutex, asked = Mutex(), []
    endstop = SimpleNamespace(
        query_endstop=lambda time: asked.append((time, mutex.test())) or 1
    )
    gcode = SimpleNamespace(get_mutex=lambda: mutex)
    host = SimpleNamespace(gcode=gcode, print_time=lambda: 3.0)
    endstops = SimpleNamespace(host=host)
    with mutex:
        assert Endstops.read_between_commands(endstops, endstop) is None
    assert asked == []
    # A command that begins meanwhile waits
    assert Endstops.read_between_commands(endstops, endstop) is True
    assert asked == [(3.0, True)]
    assert not mutex.test()
