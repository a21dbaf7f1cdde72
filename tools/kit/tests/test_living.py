"""A printer that lives by itself, for those who only know klippy's socket."""

from __future__ import annotations

import json
import socket
import time
from contextlib import closing

import pytest

SPEED = 20.0
END = b"\x03"


def connected(printer):
    """A connection that the simulation knows nothing of."""
    path = printer.session.data / "comms" / "klippy.sock"
    client = socket.socket(socket.AF_UNIX)
    client.settimeout(30.0)
    client.connect(str(path))
    return client


def ask(client, method, **params):
    """One request's result."""
    message = {"id": 1, "method": method, "params": params}
    client.sendall(json.dumps(message).encode() + END)
    answer = b""
    while not answer.endswith(END):
        answer += client.recv(65536)
    return json.loads(answer[:-1])["result"]


def test_others_are_served_and_time_passes(start):
    printer = start()
    printer.session.require_ready()
    first = printer.machine.simulation.clock.now() * 1e-9
    began = time.monotonic()
    with printer.session.living(SPEED), closing(connected(printer)) as client:
        ask(client, "gcode/script", script="G28\nG1 X100 F6000\nM400")
        time_now = ask(client, "objects/query", objects={})["eventtime"]
        passed = time_now - first
        assert 5.0 < passed <= SPEED * (time.monotonic() - began)
    assert printer.session.position()[0] == pytest.approx(100.0)
    assert printer.machine.board.journal.shutdowns == []
    # Afterwards the clock jumps again: a minute is left to a busy machine
    began = time.monotonic()
    printer.session.wait(60.0 * SPEED)
    assert time.monotonic() - began < 60.0
