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

_KINDS = ("stuck_open", "stuck_closed", "trigger_never")
_OFF = ("trigger_early", "trigger_late")
# Where a fault strikes: the site, and which of its touches, homing included
_TOUCHES = {
    "CALIBRATE_Z": (("nozzle_pin", 3), ("probe_bed", 2)),
    "piezo_cartesian: AUTO_Z_CALIBRATE": (
        ("inductive_bed", 3),
        ("nozzle_bed", 2),
    ),
    "EXTRA_PROBE": (("nozzle_membrane", 2),),
    "PROBE, dockable, with sensors": (("probe_bed", 3),),
}


def _sensor_faults():
    for name, touches in _TOUCHES.items():
        for site, touch in touches:
            for kind in _KINDS:
                yield name, Fault(kind, site=site, touch=touch)
            for kind in _OFF:
                yield name, Fault(kind, site=site, touch=touch, mm=0.3)
    for when in ("lift", "touch"):
        about = {"site": "body_pin", "touch": 2}
        yield "CALIBRATE_Z", Fault("probe_falls", when=when, **about)
    yield "PROBE, dockable", Fault("attach_fails", persistent=True)
    yield "PROBE, dockable", Fault("dock_fails", n=2, persistent=True)


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
