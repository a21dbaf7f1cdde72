"""The program is stopped, lost, or left alone for a while."""

from __future__ import annotations

import os
import re
import signal
import threading

import pytest

from simprinter.hosts.session import GcodeError
from tests.firmware.programs import RUNS, FirmwarePrinter, record

RUN = RUNS["CALIBRATE_Z"]
MOMENTS = 20
# CALIBRATE_Z takes a bit longer on every host, s
TAKES = 15.0
AS_IT_SHOULD_BE = "new offset=0.16"
# What the host or the program says of one that came too late
LATE = "Timer too close|Rescheduled timer in the past"


def begun(printer, seconds):
    """CALIBRATE_Z on a homed printer, so long (s) after its begin."""
    session = printer.homed().session
    command = session.begin("CALIBRATE_Z\nM400")
    end = session.machine.simulation.clock.now() + round(seconds * 1e9)
    session.run_until(
        command, lambda: session.machine.simulation.clock.now() >= end
    )
    return command


def steps(printer):
    axes = printer.machine.rig.axes
    return {name: axis.track.position for name, axis in axes.items()}


def finish(printer, command, after=0.1):
    """What is said of a command after which the printer stands still.

    From so long (s) after now.
    """
    printer.session.wait(after)
    before = steps(printer)
    with pytest.raises(GcodeError) as error:
        printer.session.finish(command)
    printer.session.wait(15.0)
    assert steps(printer) == before
    state, message = printer.session.state()
    assert state == "shutdown"
    return f"{error.value}\n{message}"


@pytest.mark.parametrize("moment", range(MOMENTS))
def test_emergency_stop(host, moment):
    with FirmwarePrinter(host, RUN.scene) as printer:
        command = begun(printer, TAKES * moment / MOMENTS)
        printer.session.stop()
        assert "webhooks request" in finish(printer, command)
        printer.session.restart("FIRMWARE_RESTART")
        lines = printer.homed().run("CALIBRATE_Z")
        assert AS_IT_SHOULD_BE in lines[-1]


@pytest.mark.parametrize("seconds", [0.0, 5.0, 10.0])
def test_lost_program(host, seconds):
    with FirmwarePrinter(host, RUN.scene) as printer:
        command = begun(printer, seconds)
        printer.machine.board.kill()
        assert "Lost communication with MCU" in finish(printer, command)


def test_stopped_in_real_time_is_no_difference(host):
    """Klippy waits for the program, as time stands still."""
    records = []
    for stops in (False, True):
        with FirmwarePrinter(host, RUN.scene) as printer:
            printer.session.require_ready()
            pid = printer.machine.board.pid
            go_on = threading.Timer(1.0, os.kill, (pid, signal.SIGCONT))
            if stops:
                os.kill(pid, signal.SIGSTOP)
                go_on.start()
            records.append(record(printer, RUN.script))
    assert records[0] == records[1]


@pytest.mark.parametrize("seconds", [5.0, 10.0])
def test_program_stands_still_for_a_second(host, seconds):
    with FirmwarePrinter(host, RUN.scene) as printer:
        command = begun(printer, seconds)
        printer.machine.board.stop_for(1.0)
        assert re.search(LATE, finish(printer, command, 1.1))


@pytest.mark.parametrize("seconds", [2.0, 5.0, 7.0, 10.0])
def test_klippy_stands_still_for_a_second(host, seconds):
    """A touch ends by itself, 0.25 s after the host was last heard of."""
    with FirmwarePrinter(host, RUN.scene) as printer:
        command = begun(printer, seconds)
        printer.machine.simulation.stop_klippy(1.0)
        with pytest.raises(GcodeError) as error:
            printer.session.finish(command)
        state, message = printer.session.state()
        if state == "shutdown":
            assert re.search(LATE, message)
            return
        assert "Communication timeout during homing" in str(error.value)
        assert AS_IT_SHOULD_BE in printer.run("CALIBRATE_Z")[-1]
