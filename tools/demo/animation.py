"""A calibration as an animated picture: from the side, heights to scale.

CSS moves it, no script. Whoever wants no motion, and whatever knows none, sees
the end: all touches and the result. Lengths are pixels, y down, unless their
name says otherwise.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from simprinter import Scene
from tests.docs.pictures import MINUS, Drawing, Scale, mm, tick_step
from tests.docs.z_calibration_picture import Touches
from tools.demo.recording import (
    SITES,
    Mark,
    Moment,
    axis_of,
    probe_offset,
    thin,
)

WIDTH, HEIGHT = 960, 560
# The side view, and the list beside it
VIEW = (16, 54, 652, 430)
LIST = (664, 54, 944, 430)
AXIS_X = 72.0
GROUND = 414.0
HEAD_HEIGHT = 70.0
MARGIN = 48.0
# Seconds that the run takes at most, and that its end is shown
LONGEST, HOLD = 20.0, 6.0
FLASH = 0.35
# How far a thing may be drawn off where it was
TOLERANCE = 0.2

ROLES = {"nozzle_pin": "nozzle", "body_pin": "switch", "probe_bed": "probe"}
_WHEN = ("before", "now")
WORDS = {
    "nozzle_pin": "nozzle on the pin",
    "body_pin": "switch body on the pin",
    "probe_bed": "probe on the bed",
}


class Run(NamedTuple):
    """One calibration. mm; heights in the world's frame.

    zero: of the nozzle's tip at Z=0 as homed. surface: of the bed where its
    two ends on the axis that is shown are. gaps: true ones at Z=0 before,
    after, and as predicted.
    """

    scene: Scene
    moments: Sequence[Moment]
    marks: Sequence[Mark]
    result: Touches
    zero: float
    surface: Sequence[tuple[float, float]]
    gaps: tuple[float, float, float]


class Movie(Drawing):
    """A drawing of which parts move.

    All times are seconds of the recording that is shown.
    """

    def __init__(self, title: str, description: str, seconds: float):
        super().__init__(title, description, WIDTH, HEIGHT)
        self._seconds = seconds
        self._still: list[str] = []
        self._moving: list[str] = []
        self._names = 0

    def text_of(self) -> str:
        style = ET.SubElement(self.root, "style")
        style.text = (
            "".join(self._still)
            + "@media (prefers-reduced-motion:no-preference){"
            + "".join(self._moving)
            + "}"
        )
        return super().text_of()

    @contextmanager
    def group(self, **attributes: object) -> Iterator[None]:
        """What is drawn meanwhile belongs together."""
        outer = self.root
        self.root = self.add("g", **attributes)
        try:
            yield
        finally:
            self.root = outer

    def moves(self, name: str, path: Sequence[Sequence[float]]) -> None:
        """Say where a group is: (t, x, y), in order of time."""
        frames = [(t, f"transform:{_there(x, y)}") for t, x, y in path]
        self._animate(name, frames, f"transform:{_there(*path[-1][1:])}")

    def shown(self, spans: Sequence[tuple[float, float]], last: bool) -> str:
        """The class of what is seen from one time to another, and at the end.

        last: whether it is seen where nothing moves.
        """
        self._names += 1
        name = f"a{self._names}"
        frames = [(0.0, "opacity:0")]
        for begin, end in spans:
            if begin <= 0.0:
                frames = [(0.0, "opacity:1")]
            else:
                frames += [(begin, "opacity:0"), (begin, "opacity:1")]
            if end < self._seconds:
                frames += [(end, "opacity:1"), (end, "opacity:0")]
        self._animate(name, frames, f"opacity:{int(last)}")
        return name

    def _animate(
        self, name: str, frames: Sequence[tuple[float, str]], still: str
    ) -> None:
        # Two of one time follow each other
        shares = [100.0 * t / self._seconds for t, _ in frames]
        for index in range(1, len(shares)):
            shares[index] = max(shares[index], shares[index - 1] + 0.001)
        texts = [
            f"{share:.3f}%{{{look}}}"
            for share, (_, look) in zip(shares, frames)
        ]
        texts.append(f"100%{{{frames[-1][1]}}}")
        self._still.append(f".{name}{{{still}}}")
        self._moving.append(
            f"@keyframes {name}{{{''.join(texts)}}}"
            f".{name}{{animation:{name} {self._seconds:.2f}s linear infinite}}"
        )


def _there(x: float, y: float) -> str:
    return f"translate({x:.1f}px,{y:.1f}px)"


class Stage:
    """Where things are on the picture."""

    def __init__(self, run: Run):
        heights = [moment.z - run.zero for moment in run.moments]
        probe = run.scene.world.mag_probe
        assert probe is not None
        hangs = probe.body_drop + probe.switch_offset + probe.pretravel
        # Beside the bed the probe hangs below it
        low = min(
            moment.z - run.zero - (hangs if moment.attached else 0.0)
            for moment in run.moments
        )
        beside = probe_offset(run.scene)
        tips = [moment.along for moment in run.moments]
        places = [*tips, *(along + beside for along in tips)]
        top = VIEW[1] + HEAD_HEIGHT + 12.0
        # Heights first: lengths along the axis have a scale of their own
        per_mm = (GROUND - top) / (max(heights) - low)
        self.scale = Scale(low, per_mm)
        self._zero = run.zero
        self._left = AXIS_X + MARGIN
        room = VIEW[2] - MARGIN - self._left
        self._first = min(places)
        self._along = room / (max(places) - self._first)

    def x(self, along: float) -> float:
        """Where a place along the axis is drawn, mm."""
        return self._left + (along - self._first) * self._along

    def y(self, z: float) -> float:
        """Where a height in the world's frame is drawn, mm."""
        low, per_mm = self.scale
        return GROUND - (z - self._zero - low) * per_mm


class Film:
    """One run, drawn."""

    def __init__(self, run: Run, heading: str):
        self._run = run
        self._stage = Stage(run)
        length = run.moments[-1].t
        self._faster = max(1.0, length / LONGEST)
        self._end = length / self._faster
        self._page = Movie(heading, _describe(run), self._end + HOLD)
        self._page.box("page", (0, 0, WIDTH, HEIGHT), 14)
        look = {"font_size": 18, "font_weight": 700}
        self._page.text("ink", (20, 36), heading, **look)
        look = {"text_anchor": "end", "font_size": 12}
        rate = f"{self._faster:.1f} times as fast as the printer"
        self._page.text("muted", (WIDTH - 20, 36), rate, **look)
        self._page.box("panel", VIEW, 12)
        self._page.box("panel", LIST, 12)
        self._axis()
        self._pin()
        self._head()
        self._bed()
        self._flashes()
        self._sites()
        self._result()

    def text_of(self) -> str:
        """The file."""
        return self._page.text_of()

    def _time(self, t: float) -> float:
        """When something is seen, of printer seconds."""
        return t / self._faster

    def _axis(self) -> None:
        page, scale = self._page, self._stage.scale
        step = tick_step(scale.per_mm, 28.0)
        top = VIEW[1] + 20.0
        number = int(scale.lowest / step) - 1
        while True:
            y = self._stage.y(self._run.zero + number * step)
            if y < top:
                break
            if y < GROUND:
                role = "grid" if number else "muted"
                page.line(role, (AXIS_X, y, VIEW[2] - 12, y))
                label = f"{number * step:g}".replace("-", MINUS)
                look = {"text_anchor": "end", "font_size": 12}
                page.text("muted", (AXIS_X - 6, y + 4), label, **look)
            number += 1
        turn = f"translate(34 {(VIEW[1] + VIEW[3]) / 2:.0f}) rotate(-90)"
        words = "toolhead Z as homed, mm"
        look = {"text_anchor": "middle", "font_size": 12, "transform": turn}
        page.text("muted", (0, 0), words, **look)
        words = "heights to scale, lengths along the bed smaller"
        at = VIEW[2] - 14, VIEW[1] + 16
        page.text("muted", at, words, text_anchor="end", font_size=12)

    def _pin(self) -> None:
        page, stage, run = self._page, self._stage, self._run
        pin = run.scene.world.pin
        assert pin is not None
        x = stage.x((pin.x, pin.y)[axis_of(run.scene)])
        path = [(self._time(m.t), 0.0, stage.y(m.pin)) for m in run.moments]
        length = GROUND - max(y for _, _, y in path)
        with page.group(class_="pin"):
            page.box("ink", (x - 4, 0, x + 4, length), 2)
        page.moves("pin", thin(path, TOLERANCE))
        page.box("body", (x - 14, GROUND - 12, x + 14, VIEW[3]))

    def _bed(self) -> None:
        """Drawn after the head, so that a pressed plunger is not seen."""
        page, stage = self._page, self._stage
        corners = []
        for along, z in self._run.surface:
            x = min(max(stage.x(along), AXIS_X), VIEW[2] - 12.0)
            corners.append((x, stage.y(z)))
        (left, left_y), (right, right_y) = corners
        bottom = max(left_y, right_y) + 26.0
        points = [*corners, (right, bottom), (left, bottom)]
        text = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
        page.add("polygon", class_="f-bed", points=text)
        page.line("ink", (left, left_y, right, right_y), 1.4)
        look = {"font_size": 12}
        page.text("muted", ((left + right) / 2, bottom - 8), "bed", **look)

    def _head(self) -> None:
        page, stage, run = self._page, self._stage, self._run
        path = [
            (self._time(m.t), stage.x(m.along), stage.y(m.z))
            for m in run.moments
        ]
        with page.group(class_="head"):
            self._carriage()
        page.moves("head", thin(path, TOLERANCE))

    def _carriage(self) -> None:
        """Nozzle and probe; the nozzle's tip is at 0, 0."""
        page, run = self._page, self._run
        probe = run.scene.world.mag_probe
        assert probe is not None
        x = self._stage.x(probe_offset(run.scene)) - self._stage.x(0.0)
        per_mm = self._stage.scale.per_mm
        bottom = probe.body_drop * per_mm
        out = (probe.switch_offset + probe.pretravel) * per_mm
        spans, last = self._attached()
        with page.group(class_=page.shown(spans, last)):
            page.box("ink", (x - 2.5, bottom, x + 2.5, bottom + out), 1)
            page.box("metal", (x - 5, -HEAD_HEIGHT, x + 5, bottom - 26))
            page.box("body", (x - 15, bottom - 30, x + 15, bottom), 3)
        ends = sorted((0.0, x))
        top = -HEAD_HEIGHT - 8
        page.box("metal", (ends[0] - 20, top, ends[1] + 20, top + 22), 5)
        page.box("metal", (-4, top + 16, 4, -40))
        page.box("nozzle", (-20, -42, 20, -20), 4)
        page.add("path", class_="f-metal", d="M-3 0h6l7 -12h3v-10h-26v10h3z")
        page.line("nozzle", (-4, 0, 4, 0), 2)

    def _attached(self) -> tuple[list[tuple[float, float]], bool]:
        """Between which times the head has the probe; whether at last."""
        spans, since = [], None
        for moment in self._run.moments:
            t = self._time(moment.t)
            if moment.attached and since is None:
                since = t
            elif not moment.attached and since is not None:
                spans.append((since, t))
                since = None
        if since is not None:
            spans.append((since, float("inf")))
        return spans, since is not None

    def _flashes(self) -> None:
        """A ring where and when something touches."""
        for mark in self._run.marks:
            t = self._time(mark.t)
            look = self._page.shown([(t, t + FLASH)], False)
            x, y = self._stage.x(mark.along), self._stage.y(mark.z)
            self._page.add(
                "circle",
                class_=f"s-{ROLES[mark.site]} {look}",
                cx=x,
                cy=y,
                r=13,
                stroke_width=4,
            )

    def _sites(self) -> None:
        """The list: a dot per touch, and the height they make."""
        page, run = self._page, self._run
        x, y = LIST[0] + 18, LIST[1] + 34
        heights = dict(zip(SITES, run.result[:3]))
        for number, site in enumerate(SITES, 1):
            role = ROLES[site]
            look = {"font_weight": 700, "font_size": 15}
            page.text(role, (x, y), f"{number}  {WORDS[site]}", **look)
            marks = [mark for mark in run.marks if mark.site == site]
            for index, mark in enumerate(marks):
                seen = page.shown([(self._time(mark.t), float("inf"))], True)
                cx = x + 22 + 18 * index
                look = f"f-{role} dot {site} {seen}"
                page.add("circle", class_=look, cx=cx, cy=y + 20, r=6)
            last = self._time(marks[-1].t)
            seen = page.shown([(last, float("inf"))], True)
            words = f"Z={mm(heights[site])}"
            look = {"class_": seen, "font_weight": 600, "font_size": 16}
            where = (LIST[2] - 18, y + 26)
            page.text(role, where, words, text_anchor="end", **look)
            y += 82

    def _magnified(self) -> None:
        """Nozzles at Z=0, before and after, with the bed below them."""
        page, gaps = self._page, self._run.gaps[:2]
        per_mm = 13.0 / max(0.02, *map(abs, gaps))
        left, right, y = LIST[0] + 18, LIST[2] - 18, LIST[3] - 38.0
        larger = per_mm / self._stage.scale.per_mm
        words = f"The nozzle at Z=0, {larger:.0f} times larger"
        page.text("ink", (left, y - 62), words, font_size=12, font_weight=600)
        for x, gap, when in zip((left + 60, right - 60), gaps, _WHEN):
            tip = y - gap * per_mm
            points = f"{x - 6},{tip:.2f} {x + 6},{tip:.2f}"
            points += f" {x + 22},{tip - 28:.2f} {x - 22},{tip - 28:.2f}"
            page.add("polygon", class_="f-metal", points=points)
            look = {"text_anchor": "middle", "font_size": 12}
            page.text("ink", (x, LIST[3] - 8), f"{when} {mm(gap)}", **look)
        page.box("bed", (left, y, right, LIST[3] - 22))
        page.line("ink", (left, y, right, y), 1.4)
        # Not hidden by the bed
        for x, gap in zip((left + 60, right - 60), gaps):
            tip = y - gap * per_mm
            page.line("nozzle", (x - 6, tip, x + 6, tip), 2)

    def _result(self) -> None:
        """Below: how the offset comes about, and what it is worth."""
        page, run = self._page, self._run
        seen = page.shown([(self._end, float("inf"))], True)
        with page.group(class_=f"result {seen}"):
            self._magnified()
            line = page.add("text", x=20.0, y=468.0, font_size=17)
            line.set("font-weight", "600")
            space = "{http://www.w3.org/XML/1998/namespace}space"
            line.set(space, "preserve")
            for role, words in _formula(run.result):
                part = ET.SubElement(line, "tspan", {"class": f"f-{role}"})
                part.text = words
            before, after, predicted = map(mm, run.gaps)
            inside = ", in the bed" if run.gaps[0] < 0 else ""
            words = (
                "True distance between nozzle and bed at Z=0:"
                f" {before} mm before{inside}; {after} mm now,"
                f" {predicted} mm predicted"
            )
            page.text("ink", (20, 502), words, font_size=15)
            page.text("muted", (20, 530), _meaning(run), font_size=13)


def _formula(result: Touches) -> tuple[tuple[str, str], ...]:
    return (
        ("offset", "offset"),
        ("ink", " = "),
        ("probe", f"probe {mm(result.probe)}"),
        ("ink", f" {MINUS} ("),
        ("switch", f"switch {mm(result.switch)}"),
        ("ink", f" {MINUS} "),
        ("nozzle", f"nozzle {mm(result.nozzle)}"),
        ("ink", " + "),
        ("switch_offset", f"switch_offset {mm(result.switch_offset)}"),
        ("ink", ") = "),
        ("offset", f"{mm(result.offset)} mm"),
    )


def _meaning(run: Run) -> str:
    return (
        "Predicted: this switch triggers"
        f" {mm(run.result.switch_offset + run.gaps[2])} mm below its body, its"
        f" owner has written {mm(run.result.switch_offset)} mm."
    )


def _describe(run: Run) -> str:
    touches = "; ".join(
        f"{WORDS[site]}: {sum(mark.site == site for mark in run.marks)} touches"
        for site in SITES
    )
    return f"A head seen from the side. {touches}. Offset {run.result.offset}"


def draw(run: Run, heading: str) -> str:
    """The picture as the text of an SVG file."""
    return Film(run, heading).text_of()
