"""The errors of the benchmark: what they are measured from, and their sums."""

from __future__ import annotations

from dataclasses import replace

import pytest

from simprinter.world import NoiseSpec
from tools.bench import errors
from tools.bench.commands import AUTO_Z_CALIBRATE, CALIBRATE_Z
from tools.bench.errors import (
    CONDITIONS,
    CORRECTION,
    OUTLIER,
    PROCEDURES,
    TOLERANT,
    Condition,
    NoError,
    Trial,
    make_changes,
    make_scene,
    reported_average,
    run_trial,
    summaries,
)
from tools.bench.timing import Subject, ours

MICROSTEP_UM = 2.5
NONE = Condition(0.0)

# Machines


def test_noise_is_on_all_sensors_that_are_used():
    wanted = NoiseSpec(0.003, 0.01, OUTLIER)
    world = make_scene(CALIBRATE_Z.scene, CONDITIONS[1], 1).world
    assert world.pin.noise == world.mag_probe.noise == wanted
    world = make_scene(AUTO_Z_CALIBRATE.scene, CONDITIONS[1], 1).world
    assert world.inductive.noise == wanted
    # It goes on telling late what it has felt
    assert world.bed_sensor.noise == replace(wanted, latency=0.002)


def test_every_seed_is_another_printer_with_the_same_perfect_gap():
    scenes = [make_scene(CALIBRATE_Z.scene, NONE, seed) for seed in range(20)]
    worlds = [scene.world for scene in scenes]
    for heights in (
        {world.bed.z0 for world in worlds},
        {world.pin.z for world in worlds},
        {world.mag_probe.body_drop for world in worlds},
    ):
        assert len(heights) == 20
    gap = CALIBRATE_Z.scene.formula_gap()
    assert {scene.formula_gap() for scene in scenes} == {gap}


def test_tolerance_is_the_only_change():
    assert make_changes(CALIBRATE_Z, NONE) == CALIBRATE_Z.changes
    changes = make_changes(CALIBRATE_Z, TOLERANT)
    assert changes["probe"].pop("samples_tolerance") == "0.05"
    assert changes == CALIBRATE_Z.changes


# Sums


def trial(host, procedure, condition=NONE, seed=3):
    module = PROCEDURES[procedure].command.module
    return Trial(host, ours(module), procedure, condition, seed)


def test_sums_keep_conditions_apart(host):
    first, second = (trial(host, "pin", c) for c in CONDITIONS[:2])
    refusal, crash = NoError("no", True), NoError("hurt", False)
    outcomes = [1.0, refusal, -5.0, 4.0, crash, refusal]
    trials = [first] * len(outcomes) + [second]
    found = [{"A": outcome} for outcome in (*outcomes, 2.0)]
    many, one = summaries(trials, found)
    assert many["noise"] == "0 um"
    counts = [many[name] for name in ("seeds", "refused", "failed")]
    assert counts == [6, 2, 1]
    # sigma: half of the sum of the squares of 1, 5 and 4
    numbers = [many[name] for name in ("mean", "sigma", "worst")]
    assert numbers == pytest.approx([0.0, 21.0**0.5, -5.0], abs=0.005)
    assert many["reasons"] == {"no": 2, "hurt": 1}
    assert (one["noise"], one["mean"], one["sigma"]) == ("3 um", 2.0, None)


def test_average_of_the_console():
    lines = [
        "// z_calibration: nozzle: touched at z=1.600000",
        "// probe z accuracy results: maximum 1.6, minimum -1.7, range 0.1,"
        " average -0.150000, median 1.6, standard deviation 0.01",
    ]
    assert reported_average(lines) == -0.15


# Real klippy


@pytest.fixture
def no_outliers(monkeypatch):
    monkeypatch.setattr(errors, "OUTLIER_CHANCE", 0.0)


@pytest.mark.parametrize("procedure", PROCEDURES)
def test_error_without_noise_is_below_two_microsteps(
    host, procedure, no_outliers
):
    found = run_trial(trial(host, procedure))
    names = [n for m in PROCEDURES[procedure].measurements for n in m.names]
    assert list(found) == names
    for error in found.values():
        assert abs(error) < 2.0 * MICROSTEP_UM


def test_error_is_that_of_the_gap_and_not_of_what_is_reported(
    host, monkeypatch, no_outliers
):
    """20 um are added to the offset after it was calculated and told."""
    before = run_trial(trial(host, "pin"))[CALIBRATE_Z.name]
    more = "SET_GCODE_OFFSET Z={params.Z|float + 0.02} MOVE=0"
    section = {**CALIBRATE_Z.changes["z_calibration"], "offset_gcode": more}
    changes = {**CALIBRATE_Z.changes, "z_calibration": section}
    command = CALIBRATE_Z._replace(changes=changes)
    procedure = PROCEDURES["pin"]._replace(command=command)
    monkeypatch.setitem(PROCEDURES, "pin", procedure)
    after = run_trial(trial(host, "pin"))[CALIBRATE_Z.name]
    assert after - before == pytest.approx(20.0, abs=0.1)


@pytest.mark.slow
def test_sensors_that_are_early_each_time(host, monkeypatch):
    """The bed seems higher by as much; the probe is early in homing, too."""
    monkeypatch.setattr(errors, "OUTLIER_CHANCE", 1.0)
    found = run_trial(trial(host, "pin"))
    found.update(run_trial(trial(host, "piezo")))
    wanted = {name: OUTLIER * 1000.0 for name in found} | {CORRECTION: 0.0}
    assert found == pytest.approx(wanted, abs=2.0 * MICROSTEP_UM)


@pytest.mark.slow
def test_refusal_and_failure_are_told_apart(host, no_outliers, tmp_path):
    found = run_trial(trial(host, "pin", Condition(30.0)))
    refusal = found[CALIBRATE_Z.name]
    assert refusal.refused
    assert "samples differ by # mm" in refusal.text
    file = tmp_path / "other.py"
    file.write_text("def load_config(config):\n    raise config.error('no')\n")
    other = Subject("other", {"z_calibration": file})
    found = run_trial(Trial(host, other, "pin", NONE, 0))
    assert list(found) == [CALIBRATE_Z.name]
    assert not found[CALIBRATE_Z.name].refused
