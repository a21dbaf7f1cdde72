"""The demo's picture: one calibration, drawn to scale from its numbers."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

# Role -> colour in a light and in a dark viewer
COLOURS = {
    "page": ("#f8fafc", "#0f172a"),
    "panel": ("#ffffff", "#172033"),
    "grid": ("#e2e8f0", "#2a3750"),
    "ink": ("#0f172a", "#f1f5f9"),
    "muted": ("#56657a", "#9fb0c6"),
    "metal": ("#b6c2d2", "#5d6d86"),
    "body": ("#475569", "#9fb0c6"),
    "bed": ("#dbe2ec", "#2c3a54"),
    "nozzle": ("#b45309", "#fbbf24"),
    "switch": ("#1d4ed8", "#7cb0ff"),
    "probe": ("#047857", "#34d399"),
    "switch_offset": ("#7c3aed", "#c4a5ff"),
    "offset": ("#be123c", "#fb8098"),
    "gap": ("#0e7490", "#38d3ee"),
}
FONT = "system-ui, 'Segoe UI', Roboto, 'DejaVu Sans', sans-serif"

# All lengths below are pixels, y down, unless their name says otherwise
WIDTH, HEIGHT = 1340, 846
PANEL_TOP, PANEL_BOTTOM = 92, 712
# Between these lie the highest and the lowest level of a panel
LEVELS_TOP, LEVELS_BOTTOM = PANEL_TOP + 168, PANEL_BOTTOM - 84
GROUND = PANEL_BOTTOM - 28  # where bed and endstop end
MAIN_LEFT, MAIN_RIGHT = 24, 940
COLUMNS = (80, 300, 548)
ZOOM_LEFT, ZOOM_RIGHT = 956, 1316
HEAD_HEIGHT = 64  # from the nozzle's tip to the carriage
TIP_X, BODY_X, CHAIN_X = 100, 165, 224  # within a column
SMALLEST_SPAN = 0.02  # mm; a magnified view shows no less


@dataclass(frozen=True)
class Heights:
    """What a calibration has measured and left, mm.

    nozzle, switch, probe and offset are toolhead Z; the gaps are true
    nozzle-to-bed gaps at G-code Z=0, predicted is what the formula leaves.
    """

    title: str
    subtitle: str
    nozzle: float
    switch: float
    probe: float
    switch_offset: float
    offset: float
    gap_before: float
    gap_after: float
    predicted: float

    @property
    def bed(self) -> float:
        """Toolhead Z at which the nozzle truly meets the bed."""
        return self.offset - self.gap_after

    @property
    def body(self) -> float:
        """How far the switch body hangs below the nozzle."""
        return self.switch - self.nozzle


class Scale(NamedTuple):
    """Heights in mm to pixels."""

    lowest: float
    per_mm: float

    def y(self, z: float) -> float:
        """Where a height is drawn."""
        return LEVELS_BOTTOM - (z - self.lowest) * self.per_mm

    def z(self, y: float) -> float:
        """Which height is drawn there."""
        return self.lowest + (LEVELS_BOTTOM - y) / self.per_mm


class Label(NamedTuple):
    """Lines of text that belong to a height; y is that height's."""

    y: float
    role: str
    lines: Sequence[str]


def scale_for(levels: Sequence[float]) -> Scale:
    """A scale that shows all levels."""
    span = max(max(levels) - min(levels), SMALLEST_SPAN)
    return Scale(min(levels), (LEVELS_BOTTOM - LEVELS_TOP) / span)


def tick_step(per_mm: float, closest: float = 34.0) -> float:
    """The smallest round step (mm) whose ticks are not too close."""
    power = 10.0 ** math.floor(math.log10(closest / per_mm))
    return next(
        power * factor
        for factor in (1, 2, 5, 10, 20)
        if power * factor * per_mm >= closest
    )


def spread(places: Sequence[float], apart: float) -> list[float]:
    """The places moved as little as needed to be that far apart.

    Their order is kept; places that coincide stay in the order given.
    """
    order = sorted(range(len(places)), key=lambda index: places[index])
    # Groups of neighbours that share their room: [centre, members]
    groups: list[list] = []
    for index in order:
        groups.append([places[index], [index]])
        while len(groups) > 1:
            (low, first), (high, second) = groups[-2:]
            room = apart * (len(first) + len(second)) / 2
            if high - low >= room:
                break
            members = first + second
            shifts = [
                places[i] - apart * number for number, i in enumerate(members)
            ]
            centre = sum(shifts) / len(shifts) + apart * (len(members) - 1) / 2
            groups[-2:] = [[centre, members]]
    found = [0.0] * len(places)
    for centre, members in groups:
        for number, index in enumerate(members):
            found[index] = centre + apart * (number - (len(members) - 1) / 2)
    return found


def mm(value: float) -> str:
    """A length as the picture shows it."""
    text = f"{value:.3f}"
    return (
        "0.000" if float(text) == 0.0 else text.replace("-", "\N{MINUS SIGN}")
    )


class Drawing:
    """Shapes by role: the style gives a role its colour."""

    def __init__(self, title: str, description: str):
        self.root = ET.Element(
            "svg",
            {
                "xmlns": "http://www.w3.org/2000/svg",
                "viewBox": f"0 0 {WIDTH} {HEIGHT}",
                "width": str(WIDTH),
                "height": str(HEIGHT),
                "role": "img",
                "font-family": FONT,
            },
        )
        ET.SubElement(self.root, "title").text = title
        ET.SubElement(self.root, "desc").text = description
        ET.SubElement(self.root, "style").text = _style()

    def text_of(self) -> str:
        """The whole file."""
        self.root.text = "\n"
        for element in self.root:
            element.tail = "\n"  # inside a text it would be a space
        return ET.tostring(self.root, encoding="unicode") + "\n"

    def add(self, tag: str, **attributes: object) -> ET.Element:
        """Any element; class_ is its class, _ in names stands for -."""
        return ET.SubElement(
            self.root,
            tag,
            {
                name.rstrip("_").replace("_", "-"): (
                    f"{value:.2f}" if isinstance(value, float) else str(value)
                )
                for name, value in attributes.items()
            },
        )

    def box(self, role: str, corners: Sequence[float], rx: float = 0) -> None:
        """A filled rectangle: left, top, right, bottom."""
        left, top, right, bottom = corners
        self.add(
            "rect",
            class_=f"f-{role}",
            x=float(left),
            y=float(top),
            width=float(right - left),
            height=float(max(0.0, bottom - top)),
            rx=rx,
        )

    def line(
        self, role: str, ends: Sequence[float], width: float = 1, dash: str = ""
    ) -> None:
        """A line through points: x, y, x, y ..."""
        points = " ".join(f"{value:.2f}" for value in ends)
        extra = {"stroke_dasharray": dash} if dash else {}
        self.add(
            "polyline",
            class_=f"s-{role}",
            points=points,
            stroke_width=width,
            **extra,
        )

    def text(
        self, role: str, at: tuple[float, float], words: str, **extra: object
    ) -> None:
        """A line of text at its baseline, 13 px unless told."""
        look = {"font_size": 13, **extra}
        look["class_"] = f"f-{role} {look.pop('class_', '')}".strip()
        element = self.add("text", x=float(at[0]), y=float(at[1]), **look)
        element.text = words

    def arrow(self, role: str, x: float, start: float, end: float) -> None:
        """A vertical dimension with a head at both ends, where room is."""
        self.line(role, (x, start, x, end), 2)
        head = min(8.0, abs(end - start) / 2)
        down = math.copysign(head, end - start)
        for tip, base in ((start, start + down), (end, end - down)):
            self.add(
                "polygon",
                class_=f"f-{role}",
                points=f"{x:.2f},{tip:.2f} {x - 4:.2f},{base:.2f}"
                f" {x + 4:.2f},{base:.2f}",
            )

    def pill(
        self, role: str, x: float, y: float, value: str, name: str = ""
    ) -> None:
        """A value on a patch of its colour, centred, its name above it."""
        half = 4.2 * len(value) + 7
        self.box(role, (x - half, y - 11, x + half, y + 11), 11)
        middle = {"text_anchor": "middle"}
        self.text("panel", (x, y + 4.6), value, font_weight=600, **middle)
        if name:
            look = {"font_size": 12, "class_": "halo", **middle}
            self.text(role, (x, y - 17), name, **look)

    def dimension(
        self,
        role: str,
        x: float,
        levels: tuple[float, float],
        value: str,
        name: str = "",
    ) -> None:
        """An arrow between two levels with its value on it or above it."""
        start, end = levels
        self.arrow(role, x, start, end)
        fits = abs(end - start) >= 42
        middle = (start + end) / 2 if fits else min(start, end) - 16
        self.pill(role, x, middle, value, name)


def _style() -> str:
    def rules(index: int) -> str:
        return (
            "".join(
                f".f-{role}{{fill:{pair[index]}}}"
                f".s-{role}{{stroke:{pair[index]};fill:none}}"
                for role, pair in COLOURS.items()
            )
            + f".halo{{stroke:{COLOURS['panel'][index]}}}"
        )

    return (
        f"{rules(0)}"
        "text{font-variant-numeric:tabular-nums}"
        ".halo{stroke-width:4;stroke-linejoin:round;paint-order:stroke}"
        f"@media (prefers-color-scheme:dark){{{rules(1)}}}"
    )


def draw(heights: Heights) -> str:
    """The picture as the text of an SVG file."""
    drawing = Drawing(heights.title, _description(heights))
    drawing.box("page", (0, 0, WIDTH, HEIGHT), 14)
    drawing.text(
        "ink", (MAIN_LEFT, 44), heights.title, font_size=22, font_weight=700
    )
    drawing.text("muted", (MAIN_LEFT, 70), heights.subtitle, font_size=14)
    drawing.box("panel", (MAIN_LEFT, PANEL_TOP, MAIN_RIGHT, PANEL_BOTTOM), 12)
    drawing.box("panel", (ZOOM_LEFT, PANEL_TOP, ZOOM_RIGHT, PANEL_BOTTOM), 12)
    levels = (0.0, heights.bed, heights.offset)
    measured = (heights.nozzle, heights.switch, heights.probe)
    main = scale_for((*levels, *measured))
    zoom = scale_for(levels)
    _axis(drawing, main)
    _nozzle_column(drawing, main, heights)
    _switch_column(drawing, main, heights)
    _probe_column(drawing, main, heights)
    _zoom_frame(drawing, main, zoom)
    _chain(drawing, main, heights)
    _result(drawing, zoom, heights)
    factor = zoom.per_mm / main.per_mm
    _heading(drawing, ZOOM_LEFT + 16, 4, "Result", "ink")
    drawing.text(
        "muted",
        (ZOOM_LEFT + 16, PANEL_TOP + 58),
        f"the nozzle at G-code Z=0, {factor:.0f} times larger",
    )
    _formula(drawing, heights)
    return drawing.text_of()


def _description(heights: Heights) -> str:
    return (
        f"nozzle {mm(heights.nozzle)}, switch {mm(heights.switch)},"
        f" probe {mm(heights.probe)},"
        f" switch_offset {mm(heights.switch_offset)},"
        f" offset {mm(heights.offset)} mm; true gap at G-code Z=0"
        f" {mm(heights.gap_before)} mm before and"
        f" {mm(heights.gap_after)} mm after, predicted"
        f" {mm(heights.predicted)} mm"
    )


def _heading(
    drawing: Drawing, x: float, number: int, word: str, role: str
) -> None:
    y = PANEL_TOP + 32
    drawing.add("circle", class_=f"f-{role}", cx=x + 10, cy=y - 5, r=11)
    drawing.text(
        "panel",
        (x + 10, y - 0.4),
        str(number),
        text_anchor="middle",
        font_weight=700,
    )
    drawing.text(role, (x + 28, y), word, font_size=17, font_weight=700)


def _column_heading(
    drawing: Drawing, number: int, role: str, caption: str
) -> None:
    x = COLUMNS[number - 1] + 16
    _heading(drawing, x, number, role.capitalize(), role)
    drawing.text("muted", (x, PANEL_TOP + 58), caption)


def _axis(drawing: Drawing, scale: Scale) -> None:
    step = tick_step(scale.per_mm)
    first = math.ceil(scale.z(GROUND) / step)
    last = math.floor(scale.z(PANEL_TOP + 84) / step)
    decimals = max(0, -math.floor(math.log10(step)))
    for number in range(first, last + 1):
        y = scale.y(number * step)
        role, width = ("muted", 1.2) if number == 0 else ("grid", 1)
        drawing.line(role, (COLUMNS[0], y, MAIN_RIGHT - 116, y), width)
        words = f"{number * step:.{decimals}f}".replace("-", "\N{MINUS SIGN}")
        drawing.text(
            "ink" if number == 0 else "muted",
            (COLUMNS[0] - 8, y + 4.4),
            words,
            text_anchor="end",
            font_weight=700 if number == 0 else 400,
        )
    middle = (LEVELS_TOP + LEVELS_BOTTOM) / 2
    drawing.text(
        "muted",
        (0, 0),
        "toolhead Z, mm (0 as homed)",
        text_anchor="middle",
        transform=f"translate({MAIN_LEFT + 14} {middle:.0f}) rotate(-90)",
    )


def _nozzle(drawing: Drawing, x: float, y: float, role: str) -> None:
    """A nozzle with its heater block, tip at x, y."""
    drawing.add(
        "path",
        class_="f-metal",
        d=f"M{x - 5:.2f} {y:.2f}h10l10 -18h3v-16h-36v16h3z",
    )
    drawing.box(role, (x - 30, y - 60, x + 30, y - 34), 4)
    drawing.line(role, (x - 5, y, x + 5, y), 2.5)


def _ghost_nozzle(drawing: Drawing, x: float, y: float) -> None:
    drawing.add(
        "path",
        class_="s-muted",
        stroke_width=1.6,
        stroke_dasharray="4 3",
        d=f"M{x - 5:.2f} {y:.2f}h10l10 -18h3v-16h12v-26h-60v26h12v16h3z",
    )


def _switch(drawing: Drawing, x: float, top: float, bottom: float) -> float:
    """The probe's holder and switch body; x of its plunger."""
    height = min(42.0, (bottom - top) * 0.6)
    drawing.box("metal", (x - 7, top, x + 7, bottom - height))
    drawing.box("body", (x - 32, bottom - height, x + 32, bottom), 4)
    drawing.text(
        "panel",
        (x, bottom - height / 2 + 4.4),
        "switch",
        text_anchor="middle",
        font_size=12,
        font_weight=600,
    )
    return x + 17


def _head(
    drawing: Drawing, column: float, tip: float, bottom: float, role: str
) -> float:
    """Nozzle and switch on one carriage; x of the plunger."""
    x = column + TIP_X
    top = tip - HEAD_HEIGHT
    plunger_x = _switch(drawing, column + BODY_X, top, bottom)
    drawing.box("metal", (x - 34, top - 14, column + BODY_X + 32, top + 6), 5)
    _nozzle(drawing, x, tip, role)
    return plunger_x


def _endstop(drawing: Drawing, x: float, y: float) -> None:
    """The pin of the Z endstop, pressed down to y."""
    drawing.box("ink", (x - 6, y, x + 6, y + 40), 2)
    drawing.box("body", (x - 21, y + 34, x + 21, GROUND), 4)
    drawing.text(
        "muted",
        (x, GROUND + 18),
        "Z endstop",
        text_anchor="middle",
        font_size=12,
    )


def _measured(
    drawing: Drawing, scale: Scale, column: float, z: float, role: str
) -> None:
    """A measured height: from homed zero to the nozzle's tip."""
    x = column + 34
    drawing.line(
        role,
        (x - 10, scale.y(z), column + TIP_X - 8, scale.y(z)),
        1.4,
        "5 4",
    )
    drawing.dimension(role, x, (scale.y(0.0), scale.y(z)), mm(z))


def _nozzle_column(drawing: Drawing, scale: Scale, heights: Heights) -> None:
    column = COLUMNS[0]
    _column_heading(drawing, 1, "nozzle", "the tip presses the pin")
    tip = scale.y(heights.nozzle)
    _endstop(drawing, column + TIP_X, tip)
    _nozzle(drawing, column + TIP_X, tip, "nozzle")
    _measured(drawing, scale, column, heights.nozzle, "nozzle")


def _switch_column(drawing: Drawing, scale: Scale, heights: Heights) -> None:
    column = COLUMNS[1]
    _column_heading(drawing, 2, "switch", "its body presses the same pin")
    tip, pin = scale.y(heights.switch), scale.y(heights.nozzle)
    _endstop(drawing, column + BODY_X - 16, pin)
    x = _head(drawing, column, tip, pin, "switch")
    # Not pressed: a little longer than when it triggers
    free = heights.switch_offset * scale.per_mm + 7
    drawing.box("ink", (x - 4, pin, x + 4, pin + free), 1)
    drawing.line("muted", (column + BODY_X + 34, pin, column + 234, pin), 1)
    drawing.line("muted", (column + TIP_X + 8, tip, column + 234, tip), 1)
    drawing.dimension("body", column + CHAIN_X, (tip, pin), mm(heights.body))
    _measured(drawing, scale, column, heights.switch, "switch")


def _probe_column(drawing: Drawing, scale: Scale, heights: Heights) -> None:
    column = COLUMNS[2]
    _column_heading(drawing, 3, "probe", "its switch triggers on the bed")
    tip = scale.y(heights.probe)
    body = scale.y(heights.probe - heights.body)
    bed = scale.y(heights.bed)
    drawing.box("bed", (column + 8, bed, column + CHAIN_X - 12, GROUND), 3)
    drawing.text(
        "muted",
        (column + TIP_X - 40, GROUND - 10),
        "bed",
        text_anchor="middle",
        font_weight=600,
    )
    drawing.line("ink", (column + 8, bed, column + CHAIN_X - 12, bed), 1.4)
    x = _head(drawing, column, tip, body, "probe")
    drawing.box("ink", (x - 4, body, x + 4, bed), 1)
    drawing.line("muted", (column + BODY_X + 34, body, column + 234, body), 1)
    drawing.line("muted", (column + TIP_X + 8, tip, column + 234, tip), 1)
    _measured(drawing, scale, column, heights.probe, "probe")


def _zoom_frame(drawing: Drawing, main: Scale, zoom: Scale) -> None:
    """What of the main scale the magnified panel shows."""
    left, right = COLUMNS[2] + CHAIN_X - 30, COLUMNS[2] + CHAIN_X + 26
    top = main.y(zoom.z(PANEL_TOP + 84))
    bottom = main.y(zoom.z(GROUND))
    drawing.line(
        "muted",
        (left, top, right, top, right, bottom, left, bottom, left, top),
        1,
        "3 3",
    )
    for y, edge in ((top, PANEL_TOP + 84), (bottom, GROUND)):
        drawing.line("grid", (right, y, ZOOM_LEFT, edge), 1.4)


def _chain(drawing: Drawing, scale: Scale, heights: Heights) -> None:
    """From the probe's height down to the offset, term by term."""
    x = COLUMNS[2] + CHAIN_X
    body = heights.probe - heights.body
    terms = (
        ("body", x, heights.probe, body, "switch \N{MINUS SIGN} nozzle"),
        ("switch_offset", x, body, heights.offset, "switch_offset"),
        ("offset", x + 12, heights.offset, 0.0, "offset"),
    )
    labels = []
    for role, at, start, end, word in terms:
        drawing.arrow(role, at, scale.y(start), scale.y(end))
        value = mm(abs(start - end) if role != "offset" else heights.offset)
        middle = scale.y((start + end) / 2)
        labels.append(Label(middle, role, (word, value)))
    places = spread([label.y for label in labels], 40)
    for label, term, y in zip(labels, terms, places):
        drawing.line(label.role, (term[1] + 4, label.y, x + 36, y), 1)
        for number, words in enumerate(label.lines):
            drawing.text(
                label.role,
                (x + 40, y - 3 + 16 * number),
                words,
                font_weight=600,
                class_="halo",
            )


def _result(drawing: Drawing, scale: Scale, heights: Heights) -> None:
    """Nozzle and bed at G-code Z=0, before and after."""
    left, right = ZOOM_LEFT + 70, ZOOM_RIGHT - 10
    before, after, between = ZOOM_LEFT + 160, ZOOM_LEFT + 266, ZOOM_LEFT + 212
    bed = scale.y(heights.bed)
    drawing.box("bed", (left, bed, right, GROUND), 3)
    drawing.text(
        "muted",
        (between, GROUND - 10),
        "bed",
        text_anchor="middle",
        font_weight=600,
    )
    levels = (
        Label(scale.y(0.0), "muted", (mm(0.0),)),
        Label(bed, "ink", (mm(heights.bed),)),
        Label(scale.y(heights.offset), "offset", (mm(heights.offset),)),
    )
    places = spread([label.y for label in levels], 18)
    for label, y in zip(levels, places):
        drawing.line(
            label.role, (left - 12, y, left - 2, label.y, right, label.y), 1
        )
        drawing.text(
            label.role,
            (left - 15, y + 4.6),
            label.lines[0],
            text_anchor="end",
            font_weight=600,
        )
    zero, now = scale.y(0.0), scale.y(heights.offset)
    _ghost_nozzle(drawing, before, zero)
    _nozzle(drawing, after, now, "offset")
    for x, tip, word in ((before, zero, "before"), (after, now, "after")):
        drawing.text(
            "ink", (x, tip - 72), word, text_anchor="middle", font_weight=700
        )
    drawing.dimension(
        "offset", between, (zero, now), mm(heights.offset), "offset"
    )
    # Beside the nozzles, so that nothing is hidden in a bed they stand in
    for tip, gap, at, value_at in (
        (zero, heights.gap_before, before - 64, before - 64),
        (now, heights.gap_after, after, after + 54),
    ):
        drawing.arrow("gap", at, tip, bed)
        drawing.pill("gap", value_at, (tip + bed) / 2, mm(gap), "true gap")


def _formula(drawing: Drawing, heights: Heights) -> None:
    minus = "\N{MINUS SIGN}"
    parts = (
        ("offset", "offset"),
        ("ink", " = "),
        ("probe", f"probe {mm(heights.probe)}"),
        ("ink", f" {minus} ("),
        ("switch", f"switch {mm(heights.switch)}"),
        ("ink", f" {minus} "),
        ("nozzle", f"nozzle {mm(heights.nozzle)}"),
        ("ink", " + "),
        ("switch_offset", f"switch_offset {mm(heights.switch_offset)}"),
        ("ink", ") = "),
        ("offset", f"{mm(heights.offset)} mm"),
    )
    line = drawing.add(
        "text",
        x=float(MAIN_LEFT),
        y=float(PANEL_BOTTOM + 44),
        font_size=20,
        font_weight=600,
    )
    line.set("{http://www.w3.org/XML/1998/namespace}space", "preserve")
    for role, words in parts:
        ET.SubElement(line, "tspan", {"class": f"f-{role}"}).text = words
    real = heights.switch_offset + heights.predicted
    for number, words in enumerate(
        (
            "True nozzle-to-bed gap at G-code Z=0, over the measured point:"
            f" {mm(heights.gap_before)} mm before,"
            f" {mm(heights.gap_after)} mm after;"
            f" {mm(heights.predicted)} mm predicted.",
            f"This switch really triggers with its plunger {mm(real)} mm out"
            f" of the body, switch_offset is {mm(heights.switch_offset)} mm:"
            " the difference stays as gap.",
        )
    ):
        drawing.text(
            "ink" if number == 0 else "muted",
            (MAIN_LEFT, PANEL_BOTTOM + 78 + 24 * number),
            words,
            font_size=15,
        )
