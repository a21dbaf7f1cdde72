"""The animated picture: small, harmless, and true to the run it shows."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

from simprinter import SCENES
from simprinter.hosts.hosts import main_host
from tests.docs.pictures import mm
from tools.demo.__main__ import ShownPrinter, recorded, rehearse
from tools.demo.animation import LONGEST, Stage, draw
from tools.demo.recording import SITES, probe_offset, thin

PICTURE = Path(__file__).resolve().parents[3] / "docs" / "demo.svg"
SVG = "{http://www.w3.org/2000/svg}"
FRAME = re.compile(r"([\d.]+)%\{transform:translate\(([-\d.]+)px,([-\d.]+)px")
# Of half a picture element, and of what is left of a height's digits
NEAR = 0.75
STILL = "@media (prefers-reduced-motion:no-preference){"


@pytest.fixture(scope="module", params=["voron", "cartesian"])
def run(request):
    """What one calibration was; the cartesian attaches its probe halfway.

    On any host: it is the machine that is looked at.
    """
    with ShownPrinter(main_host(), request.param) as printer:
        printer.session.require_ready()
        return recorded(printer, rehearse(printer))


def styles(text):
    """(what holds without motion, what moves)."""
    style = ET.fromstring(text).findall(f"{SVG}style")[-1].text
    still, _, moving = style.partition(STILL)
    return still, moving


def keyframes(moving, name):
    """(seconds, x, y) of a group that moves."""
    body = re.search(rf"@keyframes {name}\{{(.*?)\}}\}}", moving)[1]
    lasts = float(re.search(rf"animation:{name} ([\d.]+)s", moving)[1])
    found = [tuple(map(float, frame)) for frame in FRAME.findall(body + "}")]
    return [(share * lasts / 100, x, y) for share, x, y in found]


def place(frames, t):
    """Where a group is at a time, as a browser finds it."""
    for (begin, x, y), (end, next_x, next_y) in zip(frames, frames[1:]):
        if begin <= t <= end:
            share = (t - begin) / (end - begin)
            return x + share * (next_x - x), y + share * (next_y - y)
    raise AssertionError(f"{t} is not shown")


def is_harmless(text):
    """Nothing but shapes and styles: no script, nothing from elsewhere."""
    for element in ET.fromstring(text).iter():
        assert element.tag.startswith(SVG)
        assert element.tag[len(SVG) :] not in {"script", "image", "use", "a"}
        assert not any(
            name.startswith("on") or name.endswith("href")
            for name in element.keys()  # noqa: SIM118
        )
    assert "url(" not in text and "@import" not in text
    assert len(text.encode()) <= 300_000


def test_picture_moves_as_the_machine_did(run):
    text = draw(run, "one run")
    is_harmless(text)
    still, moving = styles(text)
    frames = keyframes(moving, "head")
    stage, faster = Stage(run), max(1.0, run.moments[-1].t / LONGEST)
    for moment in run.moments[::7]:
        x, y = place(frames, moment.t / faster)
        assert x == pytest.approx(stage.x(moment.along), abs=NEAR)
        assert y == pytest.approx(stage.y(moment.z), abs=NEAR)
    # Heights are to scale: so many pixels for a mm, wherever
    high, low = stage.y(run.zero + 9.0), stage.y(run.zero + 1.0)
    assert low - high == pytest.approx(8 * stage.scale.per_mm)
    assert "animation" not in still


def test_touches_are_marked_where_and_when_they_happen(run):
    """At its moment, what touches is drawn where the ring is."""
    text = draw(run, "one run")
    frames = keyframes(styles(text)[1], "head")
    stage, faster = Stage(run), max(1.0, run.moments[-1].t / LONGEST)
    probe = run.scene.world.mag_probe
    below = {
        "nozzle_pin": 0.0,
        "body_pin": probe.body_drop,
        "probe_bed": probe.body_drop + probe.switch_offset,
    }
    rings = [
        element
        for element in ET.fromstring(text).iter(f"{SVG}circle")
        if element.get("class").startswith("s-")
    ]
    assert len(rings) == len(run.marks)
    for ring, mark in zip(rings, run.marks):
        assert float(ring.get("cx")) == pytest.approx(stage.x(mark.along), 1e-3)
        assert float(ring.get("cy")) == pytest.approx(stage.y(mark.z), 1e-3)
        x, y = place(frames, mark.t / faster)
        beside = 0.0
        if mark.site != "nozzle_pin":
            beside = stage.x(probe_offset(run.scene)) - stage.x(0.0)
        assert x + beside == pytest.approx(float(ring.get("cx")), abs=NEAR)
        touching = y + below[mark.site] * stage.scale.per_mm
        # A head goes on a little until the host's motors stand
        assert touching == pytest.approx(float(ring.get("cy")), abs=3)
        # And the pin gives way below what presses it
        if mark.site != "probe_bed":
            top = place(keyframes(styles(text)[1], "pin"), mark.t / faster)[1]
            assert top == pytest.approx(touching, abs=1)


def test_all_touches_and_the_result_are_seen_where_nothing_moves(run):
    text = draw(run, "one run")
    still, _ = styles(text)
    root = ET.fromstring(text)
    for site in SITES:
        dots = [
            element.get("class").split()
            for element in root.iter(f"{SVG}circle")
            if f" {site} " in element.get("class")
        ]
        assert len(dots) == sum(mark.site == site for mark in run.marks) > 0
        assert all(f".{words[-1]}{{opacity:1}}" in still for words in dots)
    words = " ".join("".join(root.itertext()).split())
    for value in (*run.result, run.result.offset, *run.gaps):
        assert mm(value) in words
    result = next(
        element
        for element in root.iter(f"{SVG}g")
        if element.get("class").startswith("result")
    )
    assert f".{result.get('class').split()[-1]}{{opacity:1}}" in still
    for ring in re.findall(r'class="s-\w+ (a\d+)"', text):
        assert f".{ring}{{opacity:0}}" in still


def test_probe_is_seen_while_it_is_attached(run):
    text = draw(run, "one run")
    head = next(
        element
        for element in ET.fromstring(text).iter(f"{SVG}g")
        if element.get("class") == "head"
    )
    name = head.find(f"{SVG}g").get("class")
    body = re.search(rf"@keyframes {name}\{{(.*?)\}}\}}", styles(text)[1])[1]
    seen = re.findall(r"opacity:(\d)", body)
    attached = [moment.attached for moment in run.moments]
    assert seen[0] == str(int(attached[0]))
    assert ("0" in seen and "1" in seen) == (len(set(attached)) == 2)
    assert seen[-1] == str(int(attached[-1]))


def test_picture_of_readme_is_of_this_kind(run):
    text = PICTURE.read_text(encoding="utf-8")
    is_harmless(text)
    assert STILL in text
    words = "".join(ET.fromstring(text).itertext())
    if run.scene is SCENES["voron"]:
        for value in (*run.result, run.result.offset, *run.gaps):
            assert mm(value) in words


def test_thinned_path_is_nowhere_far_off():
    path = [(t / 10, abs(t - 50) / 7.0, 3.0) for t in range(101)]
    kept = thin(path, 0.05)
    assert len(kept) == 3
    assert kept[0] == path[0] and kept[-1] == path[-1]
    assert thin(path, 1e3) == [path[0], path[-1]]
