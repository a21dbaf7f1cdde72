"""No command takes longer than it may: printer seconds, on real klippy."""

from __future__ import annotations

import pytest

from tools.bench import timing
from tools.bench.commands import (
    ATTACH_AND_DETACH,
    AUTO_Z_CALIBRATE,
    CALIBRATE_Z,
    HOME_AND_MESH,
)
from tools.bench.timing import RUNS, measure


def test_standard_machine_is_calibrated_in_time(host):
    runs = measure(host, CALIBRATE_Z)
    assert [run.name for run in runs] == [name for name, _ in RUNS]
    first, again, _ = runs
    assert first.seconds <= 23.5
    for run in runs:
        assert run.ratio > 1.0
        assert 9 <= sum(run.touches.values()) <= 10
        assert all(run.touches[site] >= 3 for site in CALIBRATE_Z.sites)
    # In the same frame the toolhead comes from the bed
    assert first.start[:2] == pytest.approx((206.0, 306.0))
    assert again.start[:2] == pytest.approx((152.0, 125.25))


def test_cycles_are_timed_with_the_gcode_of_the_user(host):
    for run in measure(host, AUTO_Z_CALIBRATE):
        # With eight moves of 0.6 mm in prepare_gcode, nearly a second
        assert run.bound == pytest.approx(8.45, abs=0.15)
        # It stands still around each touch of the bed sensor
        assert 1.0 < run.ratio <= 1.7
        # Three cycles; on its way to the bed the nozzle takes the probe along
        assert run.touches == {"nozzle_bed": 3, "inductive_bed": 6}


# Seconds that other modules take on their hosts, at least: docs/performance.md.
# Where the toolhead stood still for each look at the probe a mesh took 73.8.
@pytest.mark.parametrize(
    ("command", "others", "touches"),
    [(ATTACH_AND_DETACH, 7.0, 0), (HOME_AND_MESH, 73.0, 27)],
    ids=["trip", "mesh"],
)
def test_probe_is_fetched_quickly(host, monkeypatch, command, others, touches):
    monkeypatch.setattr(timing, "RUNS", RUNS[:1])
    (run,) = measure(host, command)
    assert run.ratio > 1.0
    assert run.seconds < others
    assert run.touches.get("probe_bed", 0) == touches
