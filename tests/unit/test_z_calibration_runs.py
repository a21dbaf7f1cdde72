"""z_touch/z_calibration/runs.py: lines of the history, and what they say of a new run."""

from __future__ import annotations

import json
import math
import random

import pytest

from tools.kit.runs import as_kept, make_run, make_runs, read
from z_touch.z_calibration import runs

# Lines as a hand, a power loss or another program may leave them

START = b'{"format": 4, "ok": false, "time": 1, "sites": {}'
SITE = b'{"format": 4, "ok": false, "time": 1, "sites": {%s}}'
CYCLE = START + b', "cycles": [{%s}]}'


@pytest.mark.parametrize(
    "line",
    [
        b"hello",
        b"[]",
        b"\xff\xfe\x00",
        b"[" * 100_000,
        b'{"format": 4, "ok": 1, "time": 1, "sites": {}}',
        # A good run has all its sites
        b'{"format": 4, "ok": true, "time": 1, "sites": {}}',
        b'{"format": 4, "ok": false, "sites": {}}',
        b'{"format": 4, "ok": false, "time": "now", "sites": {}}',
        b'{"format": 4, "ok": false, "time": NaN, "sites": {}}',
        b'{"format": 4, "ok": false, "time": 1e300, "sites": {}}',
        b'{"format": 4, "ok": false, "time": 1, "sites": []}',
        SITE % (b'"pin": {"z": 1, "sd": 0, "n": 2, "samples": [1]}',),
        SITE % (b'"bed": {"sd": 0, "n": 2, "samples": []}',),
        SITE % (b'"bed": {"z": 1, "sd": 0, "n": 2, "samples": ["a"]}',),
        CYCLE % (b'"nozzle": [1], "switch": [1], "bed": [1]',),
        CYCLE % (b'"time": 1, "nozzle": [1], "switch": [1], "bed": []',),
        START + b', "dirty": 5}',
        START + b', "nozzle_at": [1]}',
        START + b', "warnings": 5}',
        START + b', "warnings": [{"about": "bed"}]}',
        START + b', "reason": null}',
        START + b', "offset": ' + b"9" * 200_000 + b"}",
        START + b', "reason": "' + b"a" * runs.LONGEST + b'"}',
    ],
)
def test_damaged_line_is_counted_and_costs_no_other(line):
    good = runs.line_of(read(make_runs(1))[0])
    found = runs.parse_all([good, line + b"\r\n", good])
    assert (len(found.runs), found.damaged, found.other) == (2, 1, 0)


def test_refused_run_may_lack_sites():
    (run,) = read([json.loads(START + b"}")])
    assert (run.ok, run.sites, run.uncertainty) == (False, {}, None)


def test_lines_of_other_versions_are_counted_for_themselves():
    lines = [
        b'{"format": 3, "ok": "perhaps"}',
        b'{"format": 5}',
        b"{}",
        b"",
        b"x",
    ]
    assert runs.parse_all(lines) == ([], 1, 3)


def test_number_that_is_none_is_not_written():
    (run,) = read(make_runs(1))
    with pytest.raises(ValueError):
        runs.line_of(runs.Run(True, math.nan, run.sites))


def test_accuracy_run_is_read_as_it_was_written():
    cycle = {"time": 20.0, "nozzle": [1.6], "switch": [8.0], "bed": [7.0]}
    records = make_runs(1, cycles=[cycle] * 2, step=0.0025)
    (run,) = read(records)
    assert run.cycles[0] == runs.Cycle(20.0, (1.6,), (8.0,), (7.0,))
    assert runs.parse_all([runs.line_of(run)]).runs == [run]


# What a site's record has


def test_records_of_a_site():
    samples = [1.0, 1.001, 1.05, 1.002]
    found = runs.site_run(samples, 1.0012)
    assert as_kept(found) == {
        "z": 1.0012,
        "sd": 0.001,
        "n": 3,
        "samples": (1.0, 1.001, 1.05, 1.002),
    }
    # At points of a textured plate that is no outlier
    points = [(150.0, 120.0 + i) for i in range(4)]
    found = runs.site_run(samples, 1.0, usual=0.017, points=points)
    assert found.n == 4


def test_spread_is_that_of_all_touches():
    """Rejected ones, too; but neither outliers nor what is no noise at all."""
    rejected = [1.0, 1.009, 1.004, 0.998, 1.006, 1.3]
    found = runs.site_run([1.004, 1.006], 1.005, touches=rejected)
    assert found.samples == (1.004, 1.006)
    assert found.touches == tuple(rejected)
    assert (found.n, found.sd) == (5, pytest.approx(0.00445, abs=1e-5))


def test_spreads_are_those_of_the_last_twenty_runs():
    """Of refused ones, too."""
    records = make_runs(5, touches=5) + make_runs(19, 2, touches=3)
    refused = make_run(random.Random(3), ok=False, touches=4)
    del refused["sites"]["switch"]
    known = read([*records, refused])
    spreads = runs.spreads(known, "bed")
    assert [spread.dof for spread in spreads] == [2] * 19 + [3]
    missing = runs.spreads(known, "switch")
    assert [spread.dof for spread in missing] == [2] * 19 + [0]
    assert runs.spreads([], "bed") == []


@pytest.mark.parametrize("field", [{"dirty": True}, {"cleaned": "it was so"}])
def test_dirty_nozzle_says_nothing_of_a_clean_one(field):
    known = read([*make_runs(2), make_run(random.Random(1), **field)])
    spreads = [runs.spreads(known, site) for site in runs.SITES]
    assert [[s.dof > 0 for s in of_site] for of_site in spreads] == [
        [True, True, False],
        [True] * 3,
        [True] * 3,
    ]


def test_bed_of_another_bed_spread_says_nothing():
    """Of its touches; those of nozzle and switch are the same."""
    known = read(make_runs(3) + make_runs(4, bed_spread=3.0))
    counts = {
        (site, spread): sum(
            s.dof > 0 for s in runs.spreads(known, site, spread)
        )
        for site in runs.SITES
        for spread in (0.0, 3.0, 5.0)
    }
    assert [counts["bed", spread] for spread in (0.0, 3.0, 5.0)] == [3, 4, 0]
    assert {counts["nozzle", 5.0], counts["switch", 0.0]} == {7}


# switch - nozzle


def bodies(records, run=None):
    return runs.bodies_as_hot(
        read(records), (run or records[-1])["temperatures"]
    )


def body(record):
    return read([record])[0].body()


def test_it_wants_five_runs():
    assert runs.usual(bodies(make_runs(4))) is None
    known = runs.usual(bodies(make_runs(5)))
    assert known.middle == pytest.approx(6.415, abs=0.01)
    assert known.limit >= runs.FAR
    # It follows what changes slowly
    slow = make_runs(100, moved={}, noise=0.0, homing=0.0)
    for number, record in enumerate(slow):
        record["sites"]["switch"]["z"] = 8.0 + 0.0004 * number
    assert len(bodies(slow)) == runs.LATEST_RUNS
    assert runs.usual(bodies(slow)).middle == pytest.approx(
        6.4 + 0.0004 * 74.5, abs=0.003
    )


def test_one_run_that_departs_is_forgotten_two_are_another_nozzle():
    before, draw = make_runs(20), random.Random(2)
    other = {"switch": 0.2, "bed": 0.2}
    odd = [make_run(draw, moved=other) for _ in range(4)]
    assert len(bodies(before)) == 20
    assert len(bodies([*before, odd[0]])) == 21
    assert len(bodies([*before, odd[0], *make_runs(3, 3)])) == 24
    assert bodies([*before, *odd[:2]]) == [body(run) for run in odd[:2]]
    assert bodies([*before, *odd]) == [body(run) for run in odd]
    # Runs that were refused have no say
    refused = make_run(draw, ok=False, moved={"switch": 9.0})
    assert bodies([*before, refused, refused]) == bodies(before)
    assert bodies([], before[0]) == []


@pytest.mark.parametrize(("sd", "part"), [(0.003, 1.0), (0.006, 0.89)])
def test_so_much_residue_is_found_after_twenty_clean_runs(sd, part):
    """And two false warnings in 5,400 runs at most."""
    draw, found, told, many = random.Random(1), 0, 0, 1000
    for _ in range(many):
        past = [draw.gauss(6.4, sd) for _ in range(20)]
        found += bool(runs.departure(draw.gauss(6.362, sd), past))
    assert found >= part * many
    for _ in range(18):
        past = [draw.gauss(6.4, sd) for _ in range(300)]
        told += sum(
            bool(runs.departure(past[n], past[max(0, n - 50) : n]))
            for n in range(1, 300)
        )
    assert told <= 2


def test_residue_is_no_matter_of_runs_that_were_colder():
    cold = make_runs(20, temperatures={"extruder": 150.0, "heater_bed": 20.0})
    hot = make_runs(6, 2, moved={"nozzle": 0.038})
    dirty = body(hot[-1])
    found = runs.departure(dirty, bodies(cold, cold[0]))
    # The nozzle is longer, and the body less far below it
    assert found == pytest.approx(-0.038, abs=0.015)
    assert not runs.departure(dirty, bodies(cold, hot[-1]))
    # Told once: the next run is as the last one was
    assert not runs.departure(dirty, [*bodies(cold, cold[0]), dirty])
    # Too few say nothing
    assert not runs.departure(dirty, bodies(cold, cold[0])[:4])
