"""z_touch/history/report.py: what the picture shows, from any history."""

from __future__ import annotations

import json
import random
import re
import resource
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from tests.unit.runs import HEIGHTS, make_run, make_runs
from tests.unit.stretches import AT_A_STRETCH, Stretches
from z_touch.history import file as history
from z_touch.history import report
from z_touch.history import svg as plots

ROOT = Path(__file__).resolve().parents[2]
SVG = "{http://www.w3.org/2000/svg}"


def refused(reason, **changes):
    run = make_run(random.Random(1), ok=False, offset=None, **changes)
    del run["sites"]["bed"]
    return {**run, "reason": reason}


def drawn(records):
    """The texts, the elements by tag, and the root."""
    root = ET.fromstring(report.svg(records))
    texts = [element.text or "" for element in root.iter(f"{SVG}text")]
    return texts, root


def test_all_there_is_to_see():
    runs = [*make_runs(20), refused("bed: nothing there"), *make_runs(5, 2)]
    texts, root = drawn(runs)
    titles = [
        "Z calibration",
        "26 runs, 2023-11-1",
        "last offset 0.160 mm +-0.006 (95 %)",
        "Offset (mm)",
        "Height of the nozzle (mm)",
        "Height of the switch (mm)",
        "Height of the bed (mm)",
        "Switch - nozzle (mm)",
        "Spread of each site (um)",
        "Temperatures (C)",
        "Refused: 1",
        "2023-11-1",
    ]
    found = iter(texts)
    for title in titles:
        assert any(text.startswith(title) for text in found), title
    assert texts[-1].endswith("bed: nothing there")
    assert sum(p.get("class") == "x" for p in root.iter(f"{SVG}path")) == 1
    # Uncertainty of the offset, and how far switch - nozzle may depart
    assert len(list(root.iter(f"{SVG}polygon"))) == 2
    lines = list(root.iter(f"{SVG}polyline"))
    assert [len(line.get("points").split()) for line in lines] == [25] * 8 + [
        26
    ] * 2


def test_heights_are_where_they_belong():
    runs = make_runs(3, homing=0.0, noise=0.0)
    runs[1]["offset"] = 0.26
    root = drawn(runs)[1]
    line = next(iter(root.iter(f"{SVG}polyline"))).get("points").split()
    points = [tuple(map(float, point.split(","))) for point in line]
    assert (
        points[0][1] == points[2][1] == pytest.approx(points[1][1] + 88, abs=15)
    )
    assert points[1][0] - points[0][0] == pytest.approx(
        points[2][0] - points[1][0], abs=0.2
    )


def test_samples_of_the_last_accuracy_run():
    cycles = [{name: [z, z + 0.002] for name, z in HEIGHTS.items()}] * 5
    run = make_run(random.Random(1), cycles=cycles, verdict="All is well.")
    older = {**run, "cycles": cycles[:2]}
    texts, root = drawn([*make_runs(3), older, run])
    assert "All is well." in texts
    assert any("5 cycles" in text for text in texts)
    dots = len(list(root.iter(f"{SVG}circle")))
    assert dots == 5 * 2 * 3 + 3 * 10
    texts, root = drawn([run])
    assert "All is well." in texts


@pytest.mark.parametrize(
    "records",
    [
        [],
        make_runs(1),
        [refused("")],
        [refused("x" * 400 + " <&> \x00\x1f\u00e9\ud800\U0001f600")],
        make_runs(3, uncertainty=None, temperatures={}),
        make_runs(2, cycles=[], verdict=3),
        make_runs(2, cycles=[{"nozzle": [1.0], "bed": []}]),
        make_runs(3, time=9e11),
        make_runs(2, offset=1e11),
        make_runs(2, offset=-1e-12),
    ],
)
def test_anything_in_the_file_is_drawn(records):
    lines = [json.dumps(record).encode() for record in records]
    texts, _ = drawn(list(map(history.parse, lines)))
    assert texts


def width_of(letters, css):
    """At most, in the picture's units; bold ones are wider."""
    return len(letters) * {"t": 10.5, "h": 7.6}.get(css[:1], 7.0)


def test_no_text_is_outside_or_upon_another():
    cycles = [{name: [z] * 10 for name, z in HEIGHTS.items()}] * 200
    text = "a verdict of many words " * 9
    reason = "bed: no trigger, after all these words; check that " * 6
    runs = make_runs(200) + [refused(reason)] * 9
    runs.append(make_run(random.Random(1), cycles=cycles, verdict=text))
    root = drawn(runs)[1]
    _, _, width, height = map(float, root.get("viewBox").split())
    for dot in root.iter(f"{SVG}circle"):
        assert plots.LEFT <= float(dot.get("cx")) <= width - plots.RIGHT
    boxes = []
    for element in root.iter(f"{SVG}text"):
        x, y = float(element.get("x")), float(element.get("y"))
        css = element.get("class")
        long = width_of(element.text or "", css)
        x -= long if " e" in f" {css}" else long / 2 if " m" in css else 0
        assert x >= 0.0 and x + long <= width, element.text
        assert 10.0 <= y <= height - 3.0
        boxes.append((x, x + long, y - 9.0, y + 2.0, element.text))
    for number, a in enumerate(boxes):
        for b in boxes[:number]:
            apart = a[0] >= b[1] or b[0] >= a[1] or a[2] >= b[3] or b[2] >= a[3]
            assert apart or not (a[4] and b[4]), (a, b)


def test_many_runs_are_drawn_with_pauses_and_in_proportion():
    few, many = Stretches(), Stretches()
    few.count(report.svg, make_runs(500), few.pause)
    text = many.count(report.svg, make_runs(1000), many.pause)
    # Twice as many as elsewhere: the list of all runs is made at once
    assert max(many.lines) < 2 * AT_A_STRETCH
    # Not four times as much for twice as many
    assert sum(many.lines) < 3 * sum(few.lines)
    assert len(text) < 300_000


def test_nothing_but_itself_is_needed():
    text = report.svg(make_runs(20))
    assert "script" not in text and "@import" not in text
    assert re.findall(r"(?:href|url|src)", text) == []
    assert re.findall(r"https?://\S+", text) == ['http://www.w3.org/2000/svg"']
    assert "prefers-color-scheme:dark" in text


@pytest.mark.parametrize(
    ("low", "high", "wanted"),
    [
        (0.0, 1.0, ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]),
        (-0.0101, 0.0203, ["-0.01", "0.00", "0.01", "0.02"]),
        (20.0, 240.0, ["50", "100", "150", "200"]),
    ],
)
def test_ticks_are_round(low, high, wanted):
    ticks = plots.ticks(low, high)
    assert [f"{value:.{digits}f}" for value, digits in ticks] == wanted


# The file


def test_report_stands_beside_the_history(tmp_path):
    file = history.File(str(tmp_path / "new"), 100)
    path = Path(report.write(file, "printer.cfg"))
    assert re.fullmatch(r"report-\d{8}-\d{6}\.svg", path.name)
    assert "There are no runs yet" in path.read_text()
    for run in [*make_runs(3), *make_runs(9, printer="other.cfg")]:
        file.append(run)
    assert "3 runs" in Path(report.write(file, "printer.cfg")).read_text()


def test_ten_reports_are_kept_and_nothing_else_goes(tmp_path):
    for number in range(12):
        (tmp_path / f"report-20200101-0000{number:02}.svg").touch()
    # Of a clock that was set back since
    (tmp_path / "report-29990101-000000.svg").touch()
    (tmp_path / "report-mine.svg").touch()
    new = Path(report.write(history.File(str(tmp_path), 10), "printer.cfg"))
    assert new.exists()
    left = sorted(path.name for path in tmp_path.glob("report-*-*.svg"))
    assert len(left) == 10 and left[0] == "report-20200101-000004.svg"
    assert (tmp_path / "report-mine.svg").exists()


def test_full_disk_leaves_no_half_of_a_report(tmp_path):
    file = history.File(str(tmp_path), 10)
    file.append(make_run(random.Random(1)))
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
    try:
        with pytest.raises(OSError):
            report.write(file, "printer.cfg")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert [path.name for path in tmp_path.iterdir()] == [history.FILE]


def run_program(*words):
    return subprocess.run(
        [sys.executable, "-m", "z_touch.history.report", *map(str, words)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


def test_off_the_printer_it_is_drawn_from_the_file(tmp_path):
    path = tmp_path / "history.jsonl"
    runs = make_runs(4, printer="a.cfg") + make_runs(3)
    lines = "".join(json.dumps(run) + "\n" for run in runs)
    path.write_text(lines + "oops\n")
    done = run_program(path)
    assert (done.returncode, done.stdout) == (0, f"{tmp_path}/report.svg\n")
    assert "3 runs" in (tmp_path / "report.svg").read_text()
    done = run_program(path, tmp_path / "other.svg")
    assert (tmp_path / "other.svg").read_text() == (
        tmp_path / "report.svg"
    ).read_text()
    done = run_program()
    assert (
        done.returncode == 2 and "z_touch.history.report history" in done.stderr
    )
