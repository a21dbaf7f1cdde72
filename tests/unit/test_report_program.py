"""z_touch/report/program.py: the files that it writes, as klippy starts it."""

from __future__ import annotations

import json
import os
import random
import re
import resource
import subprocess
import sys
from pathlib import Path

import pytest

from tools.kit.runs import make_run, make_runs

ROOT = Path(__file__).resolve().parents[2]


def write_runs(path, runs):
    path.write_text("".join(json.dumps(run) + "\n" for run in runs))


def run_program(*words, given="", limit=None):
    """As klippy starts it; limit: of the files that it writes, bytes."""

    def limited():
        resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))

    return subprocess.run(
        [sys.executable, str(ROOT / "z_touch" / "report"), *map(str, words)],
        cwd="/",
        input=given,
        capture_output=True,
        text=True,
        check=False,
        preexec_fn=limited if limit else None,
    )


def test_picture_stands_beside_the_history_and_is_named(tmp_path):
    path = tmp_path / "new" / "voron.jsonl"
    done = run_program(path)
    assert (done.returncode, done.stderr) == (0, "")
    made = Path(done.stdout.removeprefix("the report is ").rstrip())
    assert re.fullmatch(r"report-voron-\d{8}-\d{6}\.svg", made.name)
    assert made.parent == path.parent
    assert "There are no runs yet" in made.read_text()
    assert os.listdir(path.parent) == [made.name]
    write_runs(path, [*make_runs(3), {"format": 3}])
    with path.open("a") as f:
        f.write("oops\n")
    done = run_program(path, "--picture", tmp_path / "mine.svg")
    assert done.stdout.splitlines() == [
        f"the report is {tmp_path}/mine.svg",
        f"1 damaged lines of {path} are left out",
        f"1 lines of {path} are of another version, and left out",
    ]
    assert "3 runs" in (tmp_path / "mine.svg").read_text()


FACTS = {
    "section": "z_calibration",
    "versions": {"Klipper": "v0.13.0"},
    "settings": {"z_calibration": {"speed": 50.0}},
    "status": {"notes": ["see /home/anna"], "valid": True, "history": {}},
}


@pytest.mark.parametrize("is_file", [False, True])
def test_text_to_attach_is_written_with_what_klippy_knows(tmp_path, is_file):
    path, facts = tmp_path / "printer.jsonl", tmp_path / "facts.json"
    # A wait is no run
    wait = make_run(random.Random(1), ok=False, sites={}, waited=[[0.0, 1.9]])
    write_runs(path, [*make_runs(12), wait])
    facts.write_text(json.dumps(FACTS))
    if is_file:
        done = run_program(path, "--facts", facts)
    else:
        done = run_program(path, "--facts", "-", given=json.dumps(FACTS))
    (line,) = [w for w in done.stdout.splitlines() if w.startswith("attach")]
    text = Path(line.split()[1]).read_text()
    for words in (
        "Klipper: v0.13.0\n",
        "Notes of the start:\nsee <path>\n",
        '{"valid": true}\n',
        "[z_calibration]\nspeed: 50.0\n",
    ):
        assert words in text
    assert text.count('"offset"') == 10
    assert "waited" not in text


@pytest.mark.parametrize("facts", ["5", "{", "{}"])
def test_facts_that_are_none_are_one_sentence(tmp_path, facts):
    done = run_program(tmp_path / "a.jsonl", "--facts", "-", given=facts)
    assert (done.returncode, done.stdout) == (1, "")
    assert len(done.stderr.splitlines()) == 1


def test_full_disk_leaves_no_half_of_a_report(tmp_path):
    path = tmp_path / "printer.jsonl"
    write_runs(path, make_runs(1))
    done = run_program(path, limit=2000)
    assert (done.returncode, done.stdout) == (1, "")
    assert "File too large" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert os.listdir(tmp_path) == ["printer.jsonl"]


def test_ten_reports_are_kept_and_nothing_else_goes(tmp_path):
    for number in range(12):
        (tmp_path / f"report-printer-20200101-0000{number:02}.svg").touch()
    # Of a clock that was set back since, of another printer, and by hand
    for name in ("printer-29990101-000000", "b-20200101-000000", "mine"):
        (tmp_path / f"report-{name}.svg").touch()
    done = run_program(tmp_path / "printer.jsonl")
    assert Path(done.stdout.split()[-1]).exists()
    left = sorted(path.name for path in tmp_path.glob("report-printer-*.svg"))
    assert len(left) == 10
    assert left[0] == "report-printer-20200101-000004.svg"
    assert len(list(tmp_path.iterdir())) == 12


def test_statistics_of_klippy_shadow_none_of_python(tmp_path):
    """klippy/extras has a file of that name, and z_touch stands beside it."""
    extras = tmp_path / "extras"
    extras.mkdir()
    (extras / "statistics.py").write_text("raise SystemExit('of klippy')\n")
    (extras / "z_touch").symlink_to(ROOT / "z_touch")
    done = subprocess.run(
        [sys.executable, str(extras / "z_touch" / "report"), "a.jsonl"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
