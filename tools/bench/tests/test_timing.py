"""The times of the benchmark, on real klippy."""

from __future__ import annotations

import time

import pytest

from tools.bench import timing
from tools.bench.commands import (
    ACCURACY_SAMPLES,
    ATTACH_AND_DETACH,
    AUTO_Z_CALIBRATE,
    CALIBRATE_Z,
    HOME_AND_MESH,
    PROBE_Z_ACCURACY,
    STANDARD,
)
from tools.bench.cost import cpu_seconds
from tools.bench.text import touches_text
from tools.bench.timing import RUNS, measure, ours, reason, recorded
from tools.kit.printer import Printer, module_files

MICROSTEP = 0.0025


def test_recorded_samples():
    own = "// z_calibration: nozzle: touched at z=1.600000"
    host = "// probe at 152.000,125.250 is z=7.013750"
    # Our lines come with those of the host's own probing
    assert recorded([own, own, own, host]) == 3
    assert recorded([host, host]) == 2
    auto = "// auto_z_offset: bed sensor: triggered at z=-1.320000"
    assert recorded([auto, host, auto.replace("bed sensor", "probe")]) == 2
    assert recorded(["// something else"]) is None


def test_touches_in_words():
    counts = {"probe_bed": 3, "nozzle_pin": 4, "nozzle_bed": 1}
    assert touches_text(CALIBRATE_Z, counts) == "4+0+3 nozzle_bed:1"


def measured(host, command):
    return measure(host, ours(command.module), command)


def test_standard_machine_is_calibrated_in_time(host):
    runs = measured(host, CALIBRATE_Z)
    assert [run.name for run in runs] == [name for name, _ in RUNS]
    first, again, _ = runs
    assert first.seconds <= 25.0
    for run in runs:
        assert run.ratio == pytest.approx(run.seconds / run.bound)
        assert run.ratio > 1.0
        assert run.samples == 9
        assert 9 <= sum(run.touches.values()) <= 10
        assert all(run.touches[site] >= 3 for site in CALIBRATE_Z.sites)
    # In the same frame the head comes from the bed
    assert first.start[:2] == pytest.approx((206.0, 306.0))
    assert again.start[:2] == pytest.approx((152.0, 125.25))


@pytest.mark.slow
def test_quick_touches_are_counted_and_are_no_samples(host):
    quick = {"samples": "2", "probing_first_fast": "true"}
    section = {**STANDARD["z_calibration"], **quick}
    changes = {**STANDARD, "z_calibration": section}
    command = CALIBRATE_Z._replace(changes=changes)
    for run in measured(host, command):
        # A quick touch at each site, then two
        counts = [run.touches[site] for site in CALIBRATE_Z.sites]
        assert (counts, run.samples) == ([3, 3, 3], 6)


@pytest.mark.slow
def test_lower_bound_ends_where_the_touches_are(host):
    scene = CALIBRATE_Z.scene
    plan = CALIBRATE_Z.plan(scene, STANDARD)
    with Printer(
        host, scene, changes=STANDARD, modules=module_files()
    ) as printer:
        printer.homed().run("CALIBRATE_Z\nM400")
        touches = printer.machine.truth.touches
    frame = plan.stops[0].trigger_z - scene.world.pin.z
    for site, stop in zip(CALIBRATE_Z.sites, plan.stops):
        last = [touch for touch in touches if touch.site == site][-1]
        height = last.trigger_z + frame
        assert height == pytest.approx(stop.trigger_z, abs=MICROSTEP)
        assert last.x == pytest.approx(stop.x, abs=0.02)
        assert last.y == pytest.approx(stop.y, abs=0.02)


@pytest.mark.slow
def test_accuracy_is_timed(host):
    for run in measured(host, PROBE_Z_ACCURACY):
        assert run.ratio > 1.0
        assert run.touches == {"nozzle_pin": ACCURACY_SAMPLES}
        assert run.samples == ACCURACY_SAMPLES
        assert run.cpu > 0.0


def test_cycles_are_timed_with_the_gcode_of_the_user(host):
    for run in measured(host, AUTO_Z_CALIBRATE):
        prepare = [p.seconds for p in run.parts if p.what == "prepare"]
        # Eight moves of 0.6 mm in it, at 500 mm/s^2 at most
        assert prepare[0] > 8 * 2.0 * (0.6 / 500.0) ** 0.5
        assert not any(prepare[1:])
        assert 1.0 < run.ratio <= 1.5
        # Three cycles; on its way to the bed the nozzle takes the probe along
        assert run.touches == {"nozzle_bed": 3, "inductive_bed": 6}
        assert run.samples == 6


# Seconds that other modules take on their hosts, at least: docs/performance.md.
# Where the head stood still for each look at the probe a mesh took 73.8.
@pytest.mark.parametrize(
    ("command", "others", "touches"),
    [(ATTACH_AND_DETACH, 7.0, 0), (HOME_AND_MESH, 73.0, 27)],
    ids=["trip", "mesh"],
)
def test_probe_is_fetched_quickly(host, monkeypatch, command, others, touches):
    monkeypatch.setattr(timing, "RUNS", RUNS[:1])
    (run,) = measured(host, command)
    assert run.ratio > 1.0
    assert run.seconds < others
    assert run.touches.get("probe_bed", 0) == touches


def test_cpu_is_that_of_klippy(host):
    with Printer(host) as printer:
        printer.session.require_ready()
        simulation = printer.machine.simulation
        before = cpu_seconds(simulation)
        # Work of this process is none of klippy, which waits
        end = time.process_time() + 0.2
        while time.process_time() < end:
            pass
        assert cpu_seconds(simulation) - before < 0.1
        printer.run("G28\nM400")
        assert cpu_seconds(simulation) > before


def test_reason_is_one_line():
    assert reason(ValueError("error: no\nlog\nlog")) == "error: no"
    assert reason(ValueError("the machine was hurt:\n  a: 1\n  b: 2")) == (
        "the machine was hurt: a: 1"
    )
    assert reason(ValueError()) == "ValueError()"
