"""z_touch/report/picture.py, svg.py: what the picture shows, from any history.

That the pictures of the documents are drawn of their records to the letter is in
tests/docs/test_report_doc.py, that they need nothing but themselves in test_pictures.py.
"""

from __future__ import annotations

import random
import re
import xml.etree.ElementTree as ET

import pytest

from tools.kit.runs import HEIGHTS, as_kept, make_run, make_runs, read
from z_touch.report import picture
from z_touch.report import svg as plots
from z_touch.z_calibration import runs as kept

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
    """The texts of a picture, and its root."""
    root = ET.fromstring(picture.svg(read(records)))
    texts = [element.text or "" for element in root.iter(f"{SVG}text")]
    return texts, root


def points(line):
    corners = line.get("points").split()
    return [tuple(map(float, corner.split(","))) for corner in corners]


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
    run = spread_out(points, [8.0, -8.0, 0.5, 0.0])
    texts, root = drawn([*make_runs(5), run])
    assert "the largest circle: by 8.0 \u00b5m" in texts
    ends = ["X 149.0", "X 154.0", "Y 124.5", "Y 129.5"]
    assert [t for t in texts if re.match(r"[XY] \d", t)] == ends
    high, low = (
        [c for c in root.iter(f"{SVG}circle") if c.get("class") == name]
        for name in ("f-c", "s-c")
    )
    radii = [float(c.get("r")) for c in high], [float(c.get("r")) for c in low]
    assert radii == ([8.0, 2.0], [8.0, 0.0])
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


def test_runs_with_another_tool_are_not_drawn():
    runs = make_runs(6, extruder="extruder")
    texts, _ = drawn([*make_runs(9, 2, extruder="extruder1"), *runs])
    assert any("6 runs" in text and "with extruder" in text for text in texts)
    # Nobody with one tool is told its name
    texts, _ = drawn([*make_runs(3), *runs])
    assert any("9 runs" in text for text in texts)
    assert not any("with extruder" in text for text in texts)


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
    for box in root.iter(f"{SVG}rect"):
        assert float(box.get("width")) + float(box.get("x", "0")) <= width
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


def test_ends_of_a_plot_are_as_far_apart_as_they_have_to_be():
    for low, high, ends in ((1.0, 3.0, (0.0, 4.0)), (0.0, 5.0, (0.0, 5.0))):
        room = 0.08 * (ends[1] - ends[0])
        wanted = (ends[0] - room, ends[1] + room)
        assert plots.spanned(low, high, 4.0) == pytest.approx(wanted)


def test_colours_need_no_style_sheet():
    """What has none of its own is black on transparent in some viewers."""
    text = picture.svg(read(make_runs(20)))
    assert "var(" not in text
    root = ET.fromstring(text)
    parents = {child: parent for parent in root.iter() for child in parent}
    shapes = ("text", "path", "rect", "circle", "polyline", "polygon")
    drawn = [e for e in root.iter() if e.tag[len(SVG) :] in shapes]
    assert len(drawn) > 100
    for element in drawn:
        holder = element if element.get("class") else parents[element]
        kind, _, name = holder.get("class").partition("-")
        attribute = {"f": "fill", "s": "stroke"}[kind]
        assert holder.get(attribute) == plots.LIGHT[name]
        # An open path is filled with black otherwise
        assert kind == "f" or holder.get("fill") == "none"
        assert f".{kind}-{name}{{{attribute}:#" in text
