"""The errors of the benchmark: what they are measured from, and their sums."""

from __future__ import annotations

from dataclasses import replace

import pytest

from tests.bench import errors
from tests.bench.commands import AUTO_Z_CALIBRATE, CALIBRATE_Z
from tests.bench.errors import (
    CONDITIONS,
    CORRECTION,
    OUTLIER,
    PROCEDURES,
    SPREAD,
    TOLERANT,
    Condition,
    NoError,
    Trial,
    make_changes,
    make_scene,
    plan_trials,
    reported_average,
    rows,
    run_trial,
    summarize,
)
from tests.bench.timing import Subject, ours
from tests.simprinter.world import NoiseSpec

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


def test_levels_of_noise_are_those_that_are_told():
    assert [str(c) for c in (*CONDITIONS, TOLERANT)] == [
        "0 um",
        "3 um",
        "10 um",
        "10 um, tolerance 0.05",
    ]


def heights(scene):
    world = scene.world
    parts = (world.pin, world.mag_probe, world.inductive)
    names = ("z", "body_drop", "sense_distance")
    found = [getattr(p, n) for p, n in zip(parts, names) if p is not None]
    return [world.bed.z0, *found]


@pytest.mark.parametrize("command", [CALIBRATE_Z, AUTO_Z_CALIBRATE])
def test_every_seed_has_heights_of_its_own(command):
    before = heights(command.scene)
    machines = [heights(make_scene(command.scene, NONE, s)) for s in range(50)]
    assert machines[7] == heights(make_scene(command.scene, NONE, 7))
    for number, height in enumerate(before):
        shifts = [machine[number] - height for machine in machines]
        assert len(set(shifts)) == 50
        assert max(map(abs, shifts)) <= SPREAD
        assert max(shifts) - min(shifts) > SPREAD


def test_heights_leave_what_a_perfect_calibration_leaves():
    scene = CALIBRATE_Z.scene
    assert make_scene(scene, NONE, 1).formula_gap() == scene.formula_gap()
    scene = AUTO_Z_CALIBRATE.scene
    assert make_scene(scene, NONE, 1).piezo_gap() == scene.piezo_gap()


def test_tolerance_is_the_only_change():
    assert make_changes(CALIBRATE_Z, NONE) == CALIBRATE_Z.changes
    changes = make_changes(CALIBRATE_Z, TOLERANT)
    assert changes["probe"].pop("samples_tolerance") == "0.05"
    assert changes == CALIBRATE_Z.changes


def test_every_seed_of_every_condition_is_tried(one_host):
    trials = plan_trials(one_host, ours("z_calibration"), "pin", 3)
    tried = [(trial.condition, trial.seed) for trial in trials]
    assert tried == [
        (c, seed) for c in (*CONDITIONS, TOLERANT) for seed in range(3)
    ]


# Statistics


def test_summary_by_hand():
    refusal = NoError("no", True)
    crash = NoError("hurt", False)
    found = summarize([1.0, refusal, -5.0, 4.0, crash, refusal])
    assert (found.count, found.refused, found.failed) == (6, 2, 1)
    assert found.mean == pytest.approx(0.0)
    # Half of the sum of the squares of 1, 5 and 4
    assert found.sigma == pytest.approx(21.0**0.5)
    assert found.worst == -5.0
    assert found.reasons == {"no": 2, "hurt": 1}


@pytest.mark.parametrize(
    "outcomes, wanted",
    [
        ([], (None, None, None)),
        ([NoError("no", True)], (None, None, None)),
        ([2.0], (2.0, None, 2.0)),
        ([2.0, 2.0], (2.0, 0.0, 2.0)),
    ],
)
def test_summary_of_few(outcomes, wanted):
    assert summarize(outcomes)[1:4] == wanted


def test_rows_keep_conditions_apart(one_host):
    subject = ours("z_calibration")
    trials = [
        Trial(one_host, subject, "pin", condition, seed)
        for condition in CONDITIONS[:2]
        for seed in range(2)
    ]
    found = [{"A": 1.0}, {"A": 3.0}, {"A": 10.0}, {"A": NoError("no", True)}]
    first, second = (row.figures() for row in rows(trials, found))
    assert (first["noise"], first["mean"], first["worst"]) == ("0 um", 2.0, 3.0)
    assert (second["noise"], second["mean"]) == ("3 um", 10.0)
    assert (second["seeds"], second["refused"]) == (2, 1)


def test_average_of_the_console():
    lines = [
        "// z_calibration: nozzle: touched at z=1.600000",
        "// probe z accuracy results: maximum 1.6, minimum -1.7, range 0.1,"
        " average -0.150000, median 1.6, standard deviation 0.01",
    ]
    assert reported_average(lines) == -0.15


# Real klippy


def trial(host, procedure, condition=NONE, seed=3):
    module = PROCEDURES[procedure].command.module
    return Trial(host, ours(module), procedure, condition, seed)


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
    one_host, monkeypatch, no_outliers
):
    """20 um are added to the offset after it was calculated and told."""
    before = run_trial(trial(one_host, "pin"))[CALIBRATE_Z.name]
    more = "SET_GCODE_OFFSET Z={params.Z|float + 0.02} MOVE=0"
    section = {**CALIBRATE_Z.changes["z_calibration"], "offset_gcode": more}
    changes = {**CALIBRATE_Z.changes, "z_calibration": section}
    command = CALIBRATE_Z._replace(changes=changes)
    procedure = PROCEDURES["pin"]._replace(command=command)
    monkeypatch.setitem(PROCEDURES, "pin", procedure)
    after = run_trial(trial(one_host, "pin"))[CALIBRATE_Z.name]
    assert after - before == pytest.approx(20.0, abs=0.1)


def test_sensors_that_are_early_each_time(one_host, monkeypatch):
    """The bed seems higher by as much; the probe is early in homing, too."""
    monkeypatch.setattr(errors, "OUTLIER_CHANCE", 1.0)
    early = OUTLIER * 1000.0
    found = run_trial(trial(one_host, "pin"))
    found.update(run_trial(trial(one_host, "piezo")))
    correction = found.pop(CORRECTION)
    assert found == pytest.approx(
        dict.fromkeys(found, early), abs=2.0 * MICROSTEP_UM
    )
    assert correction == pytest.approx(0.0, abs=2.0 * MICROSTEP_UM)


def test_refusal_is_counted_with_its_reason(one_host, no_outliers):
    noisy = trial(one_host, "pin", Condition(30.0))
    found = run_trial(noisy)[CALIBRATE_Z.name]
    assert found.refused
    assert "samples differ by # mm" in found.text


def test_machine_that_does_not_start_is_a_failure(one_host, tmp_path):
    file = tmp_path / "other.py"
    file.write_text("def load_config(config):\n    raise config.error('no')\n")
    other = Subject("other", {"z_calibration": file})
    found = run_trial(Trial(one_host, other, "pin", NONE, 0))
    assert list(found) == [CALIBRATE_Z.name]
    assert not found[CALIBRATE_Z.name].refused
