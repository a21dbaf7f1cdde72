"""z_touch/report: what the picture shows, from any history, and the program."""

from __future__ import annotations

import json
import os
import random
import re
import resource
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from tools.kit.runs import HEIGHTS, as_kept, make_run, make_runs, read
from z_touch.report import days, picture
from z_touch.report import svg as plots
from z_touch.z_calibration import runs as kept

ROOT = Path(__file__).resolve().parents[2]
STICKS = {"about": "nozzle", "text": "nozzle: it sticks"}
SVG = "{http://www.w3.org/2000/svg}"
# A site as whoever edits the file may leave it
SILENT = {"z": 1.0, "sd": 0.0, "n": 0, "samples": []}


def refused(reason, **changes):
    run = make_run(random.Random(1), ok=False, **changes)
    del run["sites"]["bed"]
    return {**run, "reason": reason}


def waited(heights):
    """The line of a wait that has met the pin there."""
    return make_run(
        random.Random(1), ok=False, sites={}, waited=[*map(list, heights)]
    )


def drawn(records):
    """The texts, the elements by tag, and the root."""
    root = ET.fromstring(picture.svg(read(records)))
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
    root = ET.fromstring(picture.svg(read(runs), name="mine/printer.jsonl"))
    texts = [element.text or "" for element in root.iter(f"{SVG}text")]
    titles = [
        "Z calibration",
        "mine/printer.jsonl",
        "26 runs, 2023-11-14 to 2023-12-10; z_calibration 0.9.1",
        "Good",
        "Nothing to do.",
        "Last run, 2023-12-10 ",
        "Nozzle on the pin",
        "Probe's body on the pin",
        "Probe on the bed",
        "Offset (mm)",
        "2023-11-1",
        "Where the nozzle meets the pin (mm)",
        "How far the probe hangs below the nozzle (mm)",
        "How high the probe finds the bed (mm)",
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
    band = picture.usual_body(read(runs))
    assert [pair is None for pair in band] == [True] * 10 + [False] * 10
    low, high = band[-1]
    assert high - low == pytest.approx(2 * 0.02)
    assert low < read(runs)[-1].body() < high


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
    assert (
        f"at {bed['z']:.3f} mm, spread {1000 * bed['sd']:.1f} \u00b5m" in texts
    )
    circles = list(root.iter(f"{SVG}circle"))
    assert sum(c.get("r") == "4.0" for c in circles) == 9
    assert sum(c.get("r") == "4" for c in circles) == 3
    assert picture.counted([1, 2, 3, 2], [3, 2]) == [False, False, True, True]


def spread_out(points, offs, spread=3.0):
    """A run whose bed was touched there, so many um off its height."""
    run = make_run(random.Random(1), bed_spread=spread)
    touches = [7.0 + off / 1000.0 for off in offs]
    run["sites"]["bed"] = {
        **as_kept(kept.site_run(touches, 7.0, points=points)),
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
        picture.usual_spread(read([*rough, *smooth]), "bed", spread)
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
    runs = make_runs(40, noise=0.0, homing=0.0)
    for run in runs[30:]:
        run["switch_offset"] = 0.5
    runs[10]["warnings"] = [STICKS]
    for run in runs[20:]:
        run["sites"]["bed"]["z"] += 0.1
    runs[15]["cleaned"] = runs[16]["cleaned"] = "the touches do not agree"
    texts, root = drawn(runs)
    wanted = [
        ", nozzle: it sticks",
        ", the probe finds the bed 0.100 mm higher from then on",
        ", switch_offset was 0.440 and is 0.500",
    ]
    for number, text in enumerate(wanted):
        day = days.day(read(runs)[10 * (number + 1)])
        assert any(t.startswith(f"{number + 1}: {day}{text}") for t in texts), (
            text
        )
    # In each of the six plots
    dashed = [p for p in paths(root, "soft") if p.get("stroke-dasharray")]
    assert len(dashed) == 3 * 6
    (triangles,) = paths(root, "watch", "f")
    assert triangles.get("d").count("M") == 2


def test_changes_are_marked_where_they_were():
    runs = make_runs(40, noise=0.0, homing=0.0)
    for run in runs[24:]:
        run["sites"]["bed"]["z"] += 0.12
    texts, root = drawn(runs)
    text = f"1: {days.day(read(runs)[24])}, the probe finds the bed 0.120 mm higher"
    assert f"{text} from then on" in texts
    (flag,) = [e for e in root.iter(f"{SVG}text") if e.text == "1"]
    assert float(flag.get("x")) == pytest.approx(
        points(next(root.iter(f"{SVG}polyline")))[24][0]
    )


OTHER_PLATE = make_runs(20) + make_runs(9, 2, moved={"bed": 0.12})
IN_ORDER = [
    "Last run",
    "Offset",
    "Where the nozzle meets",
    "How far the probe hangs",
    "How high the probe finds",
    "Spread of touches",
    "Temperatures",
]


@pytest.mark.parametrize(
    ("records", "first"),
    [
        (make_runs(30), []),
        (OTHER_PLATE, ["How high the probe finds"]),
        ([*make_runs(9), refused("bed: no trigger")], ["Offset"]),
        (make_runs(9, warnings=[STICKS]), ["Last run"]),
        (
            make_runs(20, touches=4)
            + make_runs(20, 3, touches=4, worn={"bed": 0.009}),
            ["Spread of touches"],
        ),
    ],
)
def test_what_has_caused_the_verdict_is_first_and_tinted(records, first):
    texts, root = drawn(records)
    places = {}
    for element in root.iter(f"{SVG}text"):
        for title in IN_ORDER:
            if (element.text or "").startswith(title):
                places.setdefault(title, float(element.get("y")))
    rest = [title for title in IN_ORDER if title not in first]
    assert sorted(places, key=places.get) == [*first, *rest]
    tints = [
        (float(e.get("y")), float(e.get("y")) + float(e.get("height")))
        for e in root.iter(f"{SVG}rect")
        if e.get("fill-opacity") == "0.1"
    ]
    # The first one is that of the verdict itself
    within = [
        title
        for title in IN_ORDER
        if any(top < places[title] < end for top, end in tints[1:])
    ]
    assert within == first


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
    assert len(dashed) == picture.MARKS * 6


def test_samples_of_the_last_accuracy_run():
    cycle = {name: [z, z + 0.002] for name, z in HEIGHTS.items()}
    cycles = [{**cycle, "time": 20.0 * n} for n in range(6)]
    run = make_run(random.Random(1), cycles=cycles, step=0.0025)
    older = {**run, "cycles": cycles[:2]}
    texts, root = drawn([*make_runs(3), older, run])
    words = (
        "nothing stands out, the switch varies most (0.0014 mm); nothing to do"
    )
    assert words in texts
    assert any("6 cycles" in text for text in texts)
    dots = [c for c in root.iter(f"{SVG}circle") if c.get("r") == "2.2"]
    assert len(dots) == 6 * 2 * 3 + 3 * 9
    # What was last is first
    place = [i for i, t in enumerate(texts) if t.startswith("Accuracy run of")]
    assert place[0] < texts.index("Offset (mm)")
    assert f"Accuracy run: {words}." in texts
    texts, _ = drawn([older, run, *make_runs(3)])
    place = [i for i, t in enumerate(texts) if t.startswith("Accuracy run of")]
    assert place[0] > texts.index("Offset (mm)")
    assert "Nothing to do. The offset is known to +-0.006 mm (95 %)." in texts
    texts, root = drawn([run])
    assert words in texts


def test_how_far_the_pin_moved_in_the_last_wait():
    older = waited([(0.0, 1.0), (1.0, 1.0)])
    wait = waited([(0.0, 1.95), (1.0, 1.93), (2.0, 1.92), (2.9, 1.9)])
    runs = make_runs(3)
    texts, root = drawn([*runs, older, wait, *make_runs(2, 2)])
    (title,) = [t for t in texts if t.startswith("Waiting of")]
    assert title.endswith(": 3 minutes, then it still moved")
    assert texts.index(title) > texts.index("Offset (mm)")
    # 50, 30, 20 and 0 um above the last one, from left to right
    (line,) = [p for p in root.iter(f"{SVG}polyline") if len(points(p)) == 4]
    ys = [y for _, y in points(line)]
    falls = [b - a for a, b in zip(ys, ys[1:])]
    assert falls[1] > 5.0
    assert falls == pytest.approx(
        [2 * falls[1], falls[1], 2 * falls[1]], abs=0.3
    )
    assert texts.count("3 min") == 1
    # Runs are what they are without it
    assert any(t.startswith("5 runs") for t in texts)
    texts, _ = drawn([{**wait, "ok": True}])
    assert any(t.endswith("then it stood still") for t in texts)
    assert_texts_apart(drawn([*runs, wait])[1])


@pytest.mark.parametrize(
    "records",
    [
        [],
        [waited([(0.0, 1.0)])],
        make_runs(1),
        [refused("")],
        [refused("x" * 400 + " <&> \x00\x1f\u00e9\ud800\U0001f600")],
        make_runs(3, uncertainty=None, temperatures={}),
        make_runs(2, cycles=[]),
        make_runs(3, time=9e11),
        make_runs(2, bed_spread=1e11),
        [spread_out([(1.0, 2.0)], [3.0, 4.0])],
        [spread_out([(5, 5)] * 2, [0.0, 0.0])],
        make_runs(2, offset=1e11),
        make_runs(2, offset=-1e-12),
        [make_run(random.Random(1), sites={s: SILENT for s in HEIGHTS})],
    ],
)
def test_anything_in_the_file_is_drawn(records):
    texts, _ = drawn(records)
    assert texts


def width_of(element):
    """At most, in the picture's units; bold ones are wider."""
    size = float(element.get("font-size", plots.SIZE))
    letter = 0.6 if element.get("font-weight") else 0.56
    return len(element.text or "") * letter * size


def test_no_text_is_outside_or_upon_another():
    cycle = {name: [z] * 10 for name, z in HEIGHTS.items()}
    cycles = [{**cycle, "time": 20.0 * n} for n in range(200)]
    reason = "bed: no trigger, after all these words; check that " * 6
    words = "switch - nozzle is not what it was, so clean it " * 3
    warning = {"about": "switch - nozzle", "text": words}
    runs = make_runs(200) + [refused(reason)] * 9
    runs += make_runs(3, warnings=[warning] * 5, cleaned="it had to be")
    many = make_run(random.Random(1), cycles=cycles)
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


def test_a_thousand_runs_are_no_large_picture():
    assert len(picture.svg(read(make_runs(1000)))) < 300_000


def test_nothing_but_itself_is_needed():
    text = picture.svg(read(make_runs(20)))
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


# The program


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


def test_verdict_is_that_of_an_accuracy_run_that_was_last(tmp_path):
    path = tmp_path / "printer.jsonl"
    cycle = {name: [z] * 3 for name, z in HEIGHTS.items()}
    cycles = [{**cycle, "time": 20.0 * n} for n in range(6)]
    accuracy = make_run(random.Random(1), cycles=cycles, step=0.0025)
    write_runs(path, [*make_runs(2), accuracy])
    *_, last = run_program(path).stdout.splitlines()
    assert last == (
        "verdict of CALIBRATE_Z_ACCURACY: nothing stands out, the nozzle varies"
        " most (0.0000 mm); nothing to do"
    )
    write_runs(path, [accuracy, *make_runs(2)])
    assert "CALIBRATE_Z_ACCURACY" not in run_program(path).stdout


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
    write_runs(path, [*make_runs(12), waited([(0.0, 1.9)])])
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
