"""z_touch/z_calibration/run_log.py: the file of runs, whatever happens to it, and the status."""

from __future__ import annotations

import os
import resource

import pytest

from tools.kit.runs import make_runs, read
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
    assert parsed(path) == ([], 0, 0)
    add(path, 3)
    assert parsed(path) == (read(make_runs(3)), 0, 0)


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


@pytest.mark.parametrize(("part", "left"), [(0.5, 4), (1.0, 8)])
def test_only_its_end_is_read(path, monkeypatch, part, left):
    """Of a line that begins before it nothing is, were it by a byte."""
    add(path, 9)
    most = int(part * len(content(path))) - 1
    monkeypatch.setattr(run_log, "MOST_BYTES", most)
    lines, is_whole = run_log.last_lines(path)
    assert not is_whole
    found = runs.parse_all(lines)
    assert (found.runs, found.damaged) == (read(make_runs(9))[-left:], 0)


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
