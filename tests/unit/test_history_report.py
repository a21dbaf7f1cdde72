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

from tests.unit.stretches import AT_A_STRETCH, Stretches
from tools.kit.runs import HEIGHTS, make_run, make_runs
from z_touch.history import file as history
from z_touch.history import report, verdict
from z_touch.history import svg as plots

ROOT = Path(__file__).resolve().parents[2]
STICKS = {"about": "nozzle", "text": "nozzle: it sticks"}
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


def paths(root, colour, kind="s"):
    found = root.iter(f"{SVG}path")
    return [p for p in found if p.get("class") == f"{kind}-{colour}"]


def points(line):
    corners = line.get("points").split()
    return [tuple(map(float, corner.split(","))) for corner in corners]


def test_all_there_is_to_see():
    runs = [*make_runs(20), refused("bed: nothing there"), *make_runs(5, 2)]
    for number, run in enumerate(runs):
        run.update(time=1.7e9 + 9e4 * number, revision="0.9.1")
    root = ET.fromstring(report.svg(runs, printer="mine/printer.cfg"))
    texts = [element.text or "" for element in root.iter(f"{SVG}text")]
    titles = [
        "Z calibration",
        "mine/printer.cfg",
        "26 runs, 2023-11-14 to 2023-12-10; z_calibration 0.9.1",
        "Good",
        "Nothing to do.",
        "Last run, 2023-12-10 ",
        "Nozzle",
        "Switch",
        "Bed",
        "Offset (mm)",
        "2023-11-1",
        "Nozzle on the pin (mm)",
        "Switch - nozzle (mm)",
        "Probe - switch (mm)",
        "Spread of touches (\u00b5m)",
        "Temperatures (C)",
        "Refused: 1",
        "2023-12-0",
    ]
    found = iter(texts)
    for title in titles:
        assert any(text.startswith(title) for text in found), title
    assert texts[-1].endswith("bed: nothing there")
    (cross,) = paths(root, "act")
    assert cross.get("d").count("M") == 1
    # Uncertainty of the offset, and how far switch - nozzle may depart
    assert len(list(root.iter(f"{SVG}polygon"))) == 2
    lines = list(root.iter(f"{SVG}polyline"))
    assert [len(points(line)) for line in lines] == [25] * 4 + [26] * 5


def test_heights_are_where_they_belong():
    runs = make_runs(3, homing=0.0, noise=0.0)
    runs[1]["offset"] = 0.26
    root = drawn(runs)[1]
    first, second, third = points(next(iter(root.iter(f"{SVG}polyline"))))
    assert first[1] == third[1] == pytest.approx(second[1] + 80, abs=2)
    assert second[0] - first[0] == pytest.approx(third[0] - second[0], abs=0.2)


def test_days_are_as_far_apart_as_they_were():
    runs = make_runs(3)
    runs[1]["time"] = runs[0]["time"] + 0.25 * 1.8e5
    first, second, third = points(next(drawn(runs)[1].iter(f"{SVG}polyline")))
    share = (second[0] - first[0]) / (third[0] - first[0])
    assert share == pytest.approx(0.25, abs=0.001)


def test_noise_of_a_good_printer_stays_small():
    """2 um are no mountains, whatever else there is."""
    lines = list(drawn(make_runs(30, noise=0.001, homing=0.001))[1].iter())
    for line in [e for e in lines if e.tag == f"{SVG}polyline"][:4]:
        heights = [y for _, y in points(line)]
        assert max(heights) - min(heights) < 0.25 * plots.PLOT


def test_band_of_switch_minus_nozzle_is_what_is_told():
    """Of the nozzle of now only, from 0.02 mm on."""
    runs = make_runs(10) + make_runs(10, moved={"nozzle": -0.2}, noise=0.001)
    band = report.band_of(runs, report.trend.no_pause)
    assert [pair is None for pair in band] == [True] * 10 + [False] * 10
    low, high = band[-1]
    assert high - low == pytest.approx(2 * 0.02)
    assert low < report.trend.body(runs[-1]) < high


def test_spreads_begin_at_nothing():
    runs = make_runs(20)
    for run in runs:
        for site in run["sites"].values():
            site["sd"] = 0.005
    _, root = drawn(runs)
    # Half of the least span, but for the room above
    zero = [e for e in root.iter(f"{SVG}text") if e.text == "0"][-1]
    (_, y), *_ = points(list(root.iter(f"{SVG}polyline"))[5])
    up = float(zero.get("y")) - 4 - y
    assert up == pytest.approx(plots.PLOT / 2 / 1.08, abs=0.2)


def test_touches_of_the_last_run_and_which_count():
    runs = make_runs(9, touches=3)
    bed = runs[-1]["sites"]["bed"]
    samples = bed["samples"]
    # A series that was rejected, of which one was like one that counts
    bed["touches"] = [samples[0] + 0.02, samples[1], samples[2], *samples]
    texts, root = drawn(runs)
    assert f"z {bed['z']:.3f} mm, sd {1000 * bed['sd']:.1f} \u00b5m" in texts
    circles = list(root.iter(f"{SVG}circle"))
    assert sum(c.get("r") == "4.0" for c in circles) == 9
    assert sum(c.get("r") == "4" for c in circles) == 3
    assert report.counted([1, 2, 3, 2], [3, 2]) == [False, False, True, True]


def spread_out(points, offs, spread=3.0):
    """A run whose bed was touched there, so many um off its height."""
    run = make_run(random.Random(1), bed_spread=spread)
    touches = [7.0 + off / 1000.0 for off in offs]
    run["sites"]["bed"] = {
        **history.site_record(touches, 7.0, 0.0025, points=points),
        "sd": 0.015,
    }
    return run


def test_points_of_the_bed():
    points = [(150.0, 125.0), (152.0, 125.0), (150.0, 128.0), (153.0, 129.0)]
    run = spread_out(points, [8.0, -8.0, 2.0, 0.0])
    texts, root = drawn([*make_runs(5), run])
    assert "the largest circle: by 8.0 \u00b5m" in texts
    ends = ["X 149.0", "X 154.0", "Y 124.5", "Y 129.5"]
    assert [t for t in texts if re.match(r"[XY] \d", t)] == ends
    high, low = (
        [c for c in root.iter(f"{SVG}circle") if c.get("class") == name]
        for name in ("f-c", "s-c")
    )
    radii = [float(c.get("r")) for c in high], [float(c.get("r")) for c in low]
    assert radii == ([8.0, 4.0], [8.0, 0.0])
    (x, y), (_, above), (right, same) = (
        (float(c.get("cx")), float(c.get("cy"))) for c in (*high, low[0])
    )
    # Y of the bed goes up, and the plan is as high as it is wide
    assert (same, x < right) == (y, True)
    assert (y - above) / 3.0 == pytest.approx((right - x) / 2.0, abs=0.1)
    assert_texts_apart(root)


def test_usual_spread_is_that_of_the_same_bed_spread():
    smooth = make_runs(9, touches=5)
    rough = make_runs(9, touches=5, bed_spread=3.0, worn={"bed": 0.02})
    usual = [
        report.usual_spread([*rough, *smooth], "bed", spread)
        for spread in (0.0, 3.0)
    ]
    assert usual[0] < 15.0 < 25.0 < usual[1]
    # Which one is drawn is that of the last run
    _, root = drawn([*rough, *smooth, spread_out([(1, 2)] * 2, [20.0, -20.0])])
    heights = [
        float(r.get("height"))
        for r in root.iter(f"{SVG}rect")
        if r.get("fill-opacity") == "0.15"
    ]
    assert heights[2] > 3 * heights[0]


def test_sites_that_were_not_reached():
    texts, _ = drawn([*make_runs(3), refused("bed: no trigger")])
    assert texts.count("not measured") == 1
    assert "The last run was refused: bed: no trigger." in texts


def test_marks_where_something_was_told():
    runs = make_runs(40)
    for run in runs[30:]:
        run["switch_offset"] = 0.5
    runs[10]["warnings"] = [STICKS]
    runs[20]["wear"] = ["nozzle height", "spread of the bed's touches"]
    runs[15]["cleaned"] = runs[16]["cleaned"] = "the touches do not agree"
    texts, root = drawn(runs)
    wanted = [
        ", nozzle: it sticks",
        ", told: nozzle height drifts; told: spread of the bed's touches",
        ", switch_offset was 0.440 and is 0.500",
    ]
    for number, text in enumerate(wanted):
        day = report.day(runs[10 * (number + 1)])
        assert any(t.startswith(f"{number + 1}: {day}{text}") for t in texts), (
            text
        )
    # In each of the six plots
    dashed = [p for p in paths(root, "soft") if p.get("stroke-dasharray")]
    assert len(dashed) == 3 * 6
    (triangles,) = paths(root, "watch", "f")
    assert triangles.get("d").count("M") == 2


def test_changes_are_marked_where_they_were():
    runs = make_runs(40)
    told = {"what": "probe - switch", "by": 0.12, "runs": 6}
    runs[29]["changed"] = [told, {**told, "what": "x", "told": False}]
    texts, root = drawn(runs)
    text = f"1: {report.day(runs[24])}, probe - switch changed by 0.120 mm"
    assert text in texts
    (flag,) = [e for e in root.iter(f"{SVG}text") if e.text == "1"]
    assert float(flag.get("x")) == pytest.approx(
        points(next(root.iter(f"{SVG}polyline")))[24][0]
    )


def test_each_plate_has_its_curve():
    plates = ["smooth", "textured", "", "one more"] * 10
    runs = [{**r, "plate": p} for r, p in zip(make_runs(40), plates)]
    texts, root = drawn(runs)
    lines = [len(points(e)) for e in root.iter(f"{SVG}polyline")]
    assert lines == [10] * 3 + [40] * 2 + [10] * 3 + [40] * 5
    assert [texts.count(t) for t in ("no plate", "one more", "smooth")] == [
        2
    ] * 3
    assert_texts_apart(root)


def test_runs_with_another_tool_are_not_drawn():
    runs = make_runs(6, extruder="extruder")
    texts, _ = drawn([*make_runs(9, 2, extruder="extruder1"), *runs])
    assert any("6 runs" in text and "with extruder" in text for text in texts)
    # Nobody with one tool is told its name
    texts, _ = drawn([*make_runs(3), *runs])
    assert any("9 runs" in text for text in texts)
    assert not any("with extruder" in text for text in texts)


def test_only_the_latest_marks_are_drawn():
    runs = make_runs(40, warnings=[STICKS])
    _, root = drawn(runs)
    dashed = [p for p in paths(root, "soft") if p.get("stroke-dasharray")]
    assert len(dashed) == report.MARKS * 6


def test_samples_of_the_last_accuracy_run():
    cycles = [{name: [z, z + 0.002] for name, z in HEIGHTS.items()}] * 5
    run = make_run(random.Random(1), cycles=cycles, verdict="All is well.")
    older = {**run, "cycles": cycles[:2]}
    texts, root = drawn([*make_runs(3), older, run])
    assert "All is well." in texts
    assert any("5 cycles" in text for text in texts)
    dots = [c for c in root.iter(f"{SVG}circle") if c.get("r") == "2.2"]
    assert len(dots) == 5 * 2 * 3 + 3 * 9
    # What was last is first
    place = [i for i, t in enumerate(texts) if t.startswith("Accuracy run of")]
    assert place[0] < texts.index("Offset (mm)")
    assert "Accuracy run: All is well." in texts
    texts, _ = drawn([older, run, *make_runs(3)])
    place = [i for i, t in enumerate(texts) if t.startswith("Accuracy run of")]
    assert place[0] > texts.index("Offset (mm)")
    assert "Nothing to do. The offset is known to +-0.006 mm (95 %)." in texts
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
        make_runs(3, warnings=3, wear=[[]], cleaned=5, revision=3, printer=""),
        make_runs(3, changed=["x", {"by": "x", "runs": []}, {}]),
        [*make_runs(2, plate=5), *make_runs(2, plate=[])],
        make_runs(2, bed_spread=1e11),
        [spread_out([(1.0, 2.0)], [3.0, 4.0])],
        [spread_out([(5, 5)] * 2, [0.0, 0.0], spread=None)],
        make_runs(2, offset=1e11),
        make_runs(2, offset=-1e-12),
    ],
)
def test_anything_in_the_file_is_drawn(records):
    lines = [json.dumps(record).encode() for record in records]
    # What is none of its records is left out
    texts, _ = drawn(list(filter(None, map(history.parse, lines))))
    assert texts


def width_of(element):
    """At most, in the picture's units; bold ones are wider."""
    size = float(element.get("font-size", plots.SIZE))
    letter = 0.6 if element.get("font-weight") else 0.56
    return len(element.text or "") * letter * size


def test_no_text_is_outside_or_upon_another():
    cycles = [{name: [z] * 10 for name, z in HEIGHTS.items()}] * 200
    text = "a verdict of many words " * 9
    reason = "bed: no trigger, after all these words; check that " * 6
    words = "switch - nozzle is not what it was, so clean it " * 3
    warning = {"about": "switch - nozzle", "text": words}
    runs = make_runs(200) + [refused(reason)] * 9
    runs += make_runs(3, warnings=[warning] * 5, cleaned="it had to be")
    many = make_run(random.Random(1), cycles=cycles, verdict=text)
    for records in (runs, [*runs, many], [many, *runs[:205]], runs[:1]):
        assert_texts_apart(drawn(records)[1])


def assert_texts_apart(root):
    _, _, width, height = map(float, root.get("viewBox").split())
    for dot in root.iter(f"{SVG}circle"):
        assert plots.LEFT <= float(dot.get("cx")) <= width - plots.RIGHT
    boxes = []
    for element in root.iter(f"{SVG}text"):
        x, y = float(element.get("x")), float(element.get("y"))
        long = width_of(element)
        x -= {"end": long, "middle": long / 2}.get(
            element.get("text-anchor"), 0
        )
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


def test_so_are_many_runs_with_much_to_tell():
    runs = make_runs(1000, warnings=[STICKS], cleaned="x")
    for number, run in enumerate(runs):
        run["plate"] = "ab"[number % 2]
    runs[900]["changed"] = [
        {"what": name, "by": 0.1, "runs": 5} for name in verdict.CHANGES
    ]
    runs[990]["wear"] = list(verdict.VALUES)
    much = Stretches()
    much.count(report.svg, runs, much.pause)
    assert max(much.lines) < 2 * AT_A_STRETCH


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
    # Of before printers had the whole path for a name
    whole = [{**r, "printer": "/a/printer.cfg", "format": 2} for r in runs[4:]]
    other = {**runs[0], "format": 2}
    lines = "".join(json.dumps(run) + "\n" for run in [*runs, other, *whole])
    path.write_text(lines)
    run_program(path)
    assert "6 runs" in (tmp_path / "report.svg").read_text()
    done = run_program()
    assert (
        done.returncode == 2 and "z_touch.history.report history" in done.stderr
    )
