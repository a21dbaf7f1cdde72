"""On the program and on our own board a run comes to the same, exactly."""

from __future__ import annotations

import pytest

from simprinter import Fault
from tests.firmware.programs import (
    RUNS,
    FirmwarePrinter,
    allowed,
    both,
    difference,
    record,
)
from tools.kit.printer import has_kinematics

# Where a fault strikes: the third touch of a sensor, or the only one
_AT = {"membrane": 2, "bed_sensor": 2}
_KINDS = ("stuck_open", "stuck_closed", "trigger_never")
_OFF = ("trigger_early", "trigger_late")
_SENSORS = {
    "CALIBRATE_Z": ("z_endstop", "probe"),
    "piezo_cartesian: AUTO_Z_CALIBRATE": ("probe", "bed_sensor"),
    "EXTRA_PROBE": ("membrane",),
    "PROBE, dockable, with sensors": ("probe",),
}


def _sensor_faults():
    for name, signals in _SENSORS.items():
        for signal in signals:
            n = _AT.get(signal, 3)
            for kind in _KINDS:
                yield name, Fault(kind, n, signal=signal)
            for kind in _OFF:
                yield name, Fault(kind, n, signal=signal, mm=0.3)
    yield "CALIBRATE_Z", Fault("probe_falls", 2)
    yield "CALIBRATE_Z", Fault("probe_falls", 2, when="touch")
    yield "PROBE, dockable", Fault("attach_fails", persistent=True)
    yield "PROBE, dockable", Fault("dock_fails", 2, persistent=True)


FAULTS = list(_sensor_faults())


@pytest.mark.parametrize("name", RUNS)
def test_run_is_as_on_our_board(host, name):
    run = RUNS[name]
    if not has_kinematics(host, run.scene):
        pytest.skip(f"{host.name} does not know these kinematics")
    own, real = both(host, run)
    assert own.touches
    assert difference(own, real) <= allowed(run)


@pytest.mark.parametrize(
    ("name", "fault"),
    FAULTS,
    ids=[f"{n}-{f.name}-{f.subject}" for n, f in FAULTS],
)
def test_fault_ends_as_on_our_board(host, name, fault):
    own, real = both(host, RUNS[name], [fault])
    assert real == own


def test_two_runs_are_equal(host):
    run = RUNS["CALIBRATE_Z"]
    records = []
    for _ in range(2):
        with FirmwarePrinter(host, run.scene) as printer:
            records.append(record(printer, run.script))
    assert records[0] == records[1]
