"""The file of runs, whatever happens to it, and what runs of before say."""

from __future__ import annotations

import json
import math
import os
import random
import resource

import pytest

from tools.kit.runs import as_kept, make_run, make_runs, read
from z_touch.z_calibration import run_log, runs


@pytest.fixture
def path(tmp_path):
    return str(tmp_path / "z_calibration" / "printer.jsonl")


def add(path, count, **changes):
    for run in read(make_runs(count, **changes)):
        run_log.add_line(path, runs.line_of(run))


def parsed(path):
    lines, is_whole = run_log.last_lines(path)
    assert is_whole
    return runs.parse_all(lines)


def content(path):
    with open(path, "rb") as f:
        return f.read()


# The file


def test_it_stands_beside_printer_cfg_and_has_its_name():
    """Two of them in one folder have two."""
    for config, folder, wanted in (
        ("/a/b/printer.cfg", "z_calibration", "/a/b/z_calibration/printer"),
        ("/a/b/voron.2.cfg", "z_calibration", "/a/b/z_calibration/voron.2"),
        ("/a/b/printer.cfg", "/c/d", "/c/d/printer"),
        ("/a/b/printer.cfg", "~/d", f"{os.path.expanduser('~')}/d/printer"),
    ):
        assert run_log.path_of(config, folder) == f"{wanted}.jsonl"
    assert run_log.path_of("/a/printer.cfg", None) is None


def test_runs_are_read_as_they_were_written(path):
    add(path, 3)
    assert parsed(path) == (read(make_runs(3)), 0, 0)


def test_no_file_is_no_run(path):
    assert parsed(path) == ([], 0, 0)


def test_line_cut_by_a_power_loss_costs_itself_only(path):
    add(path, 3)
    with open(path, "r+b") as f:
        f.truncate(len(f.read()) - 40)
    add(path, 1)
    found = parsed(path)
    assert (len(found.runs), found.damaged) == (3, 1)


def test_full_disk_leaves_every_line_whole(path):
    add(path, 3)
    before = content(path)
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(before) + 50, limits[1]))
    try:
        with pytest.raises(OSError):
            add(path, 1)
        with pytest.raises(OSError):
            run_log.write_anew(path, [before, before])
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert content(path) == before
    assert os.listdir(os.path.dirname(path)) == ["printer.jsonl"]
    add(path, 1)
    assert len(parsed(path).runs) == 4


def test_it_is_written_anew_as_a_whole(path):
    add(path, 5)
    lines, _ = run_log.last_lines(path)
    run_log.write_anew(path, lines[-2:])
    assert parsed(path).runs == read(make_runs(5))[-2:]


def test_only_its_end_is_read(path, monkeypatch):
    """Of a line in the middle of which that begins nothing is."""
    add(path, 9)
    monkeypatch.setattr(run_log, "MOST_BYTES", len(content(path)) // 2)
    lines, is_whole = run_log.last_lines(path)
    assert not is_whole
    found = runs.parse_all(lines)
    assert (found.runs, found.damaged) == (read(make_runs(9))[-4:], 0)


LINE = b'{"format": 4, "ok": false, "time": 1, "sites": {}'


@pytest.mark.parametrize(
    "line",
    [
        b"hello",
        b"[]",
        b"\xff\xfe\x00",
        b'{"format": 4, "ok": 1, "time": 1, "sites": {}}',
        b'{"format": 4, "ok": true, "time": 1, "sites": {}}',
        b'{"format": 4, "ok": false, "sites": {}}',
        b'{"format": 4, "ok": false, "time": "now", "sites": {}}',
        b'{"format": 4, "ok": false, "time": NaN, "sites": {}}',
        b'{"format": 4, "ok": false, "time": 1e300, "sites": {}}',
        b'{"format": 4, "ok": false, "time": 1, "sites": []}',
        *(
            b'{"format": 4, "ok": false, "time": 1, "sites": {%s}}' % (sites,)
            for sites in (
                b'"nozzle": 1.6',
                b'"pin": {}',
                b'"bed": {"sd": 0, "n": 2, "samples": []}',
                b'"nozzle": {"z": 1, "sd": 0, "n": 2, "samples": ["a"]}',
                b'"bed": {"z": 1, "sd": 0, "n": 2, "samples": [1],'
                b' "points": [[1]]}',
                b'"bed": {"z": 1, "sd": 0, "n": 2, "samples": [1],'
                b' "points": 1}',
            )
        ),
        *(
            LINE + b", " + field + b"}"
            for field in (
                b'"bed_spread": "wide"',
                b'"temperatures": [1]',
                b'"temperatures": {"a": "b"}',
                b'"uncertainty": "much"',
                b'"cycles": "none"',
                b'"cycles": [{"time": 1, "nozzle": [1], "switch": [1],'
                b' "bed": ["a"]}]',
                b'"cycles": [{"time": 1, "nozzle": [1], "switch": [1],'
                b' "bed": []}]',
                b'"cycles": [{"nozzle": [1], "switch": [1], "bed": [1]}]',
                b'"extruder": 5',
                b'"dirty": 5',
                b'"nozzle_at": [1]',
                b'"warnings": 5',
                b'"warnings": ["bed: a"]',
                b'"warnings": [{"text": "bed: a"}]',
                b'"warnings": [{"about": "bed"}]',
                b'"reason": null',
                b'"a": ' + b'{"a":' * 20_000 + b"1" + b"}" * 20_000,
                b'"offset": ' + b"9" * 200_000,
                b'"reason": "' + b"a" * runs.LONGEST + b'"',
            )
        ),
        b"[" * 100_000,
        b"\0" * 1_000_000,
    ],
)
def test_line_edited_by_hand_is_left_out_and_stays(path, line):
    add(path, 2)
    with open(path, "ab") as f:
        f.write(line + b"\r\n")
    add(path, 1)
    found = parsed(path)
    assert (len(found.runs), found.damaged, found.other) == (3, 1, 0)
    assert line in content(path)


def test_refused_run_may_lack_sites():
    (run,) = read([json.loads(LINE + b"}")])
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


def test_accuracy_run_is_read_as_it_was_written(path):
    cycle = {"time": 20.0, "nozzle": [1.6], "switch": [8.0], "bed": [7.0]}
    records = make_runs(1, cycles=[cycle] * 2, step=0.0025)
    (run,) = read(records)
    assert run.cycles[0] == runs.Cycle(20.0, (1.6,), (8.0,), (7.0,))
    run_log.add_line(path, runs.line_of(run))
    assert parsed(path).runs == [run]


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


# The status


def test_nothing_is_known_at_first():
    assert run_log.status_of([]) == {
        "runs": 0,
        "results": [],
        "spread": {"nozzle": None, "switch": None, "bed": None},
        "switch_nozzle": None,
    }


def test_status_of_runs():
    status = run_log.status_of(read(make_runs(12)))
    assert (status["runs"], len(status["results"])) == (12, 10)
    assert status["results"][-1] == {
        "time": 1.7e9 + 9e4 * 11,
        "ok": True,
        "offset": 0.16,
        "uncertainty": 0.006,
        "reason": "",
    }
    assert status["switch_nozzle"] == pytest.approx(6.415, abs=0.01)
    assert status["spread"]["bed"] == pytest.approx(0.003, rel=0.8)
    assert run_log.status_of(read(make_runs(4)))["switch_nozzle"] is None


def test_status_has_the_spread_of_the_bed_spread_of_now():
    records = make_runs(5, touches=9)
    records += make_runs(5, touches=9, bed_spread=3.0, worn={"bed": 0.02})
    spread = run_log.status_of(read(records))["spread"]
    assert spread["bed"] > 3 * spread["nozzle"]
    records += make_runs(1, touches=9)
    now = run_log.status_of(read(records))["spread"]
    assert now["bed"] < 2 * spread["nozzle"]


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


def test_exchanged_nozzle_is_told_once():
    before = make_runs(20)
    other = make_runs(8, 2, moved={"switch": 0.2, "bed": 0.2})
    told = [
        bool(runs.departure(body(run), bodies([*before, *other[:n]], run)))
        for n, run in enumerate(other)
    ]
    assert told == [True] + [False] * 7


def test_residue_is_told_among_runs_that_were_as_hot():
    """38 um at a noise of 3 um: all found, no false warning in 500 runs."""
    draw = random.Random(9)
    known, told = [], 0
    for _ in range(500):
        run = read([make_run(draw)])[0]
        past = runs.bodies_as_hot(known[-60:], run.temperatures)
        told += bool(runs.departure(run.body(), past))
        if len(past) > 19:
            found = runs.departure(run.body() - 0.038, past)
            assert found == pytest.approx(-0.038, abs=0.015)
        known.append(run)
    assert told == 0


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
    assert runs.departure(dirty, bodies(cold, cold[0]))
    assert not runs.departure(dirty, bodies(cold, hot[-1]))
    # Told once: the next run is as the last one was
    assert not runs.departure(dirty, [*bodies(cold, cold[0]), dirty])
    # Too few say nothing
    assert not runs.departure(dirty, bodies(cold, cold[0])[:4])
