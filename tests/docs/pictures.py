"""Pictures of touches: shapes by role, a page with an axis and columns.

All lengths are pixels, y down, unless their name says otherwise.
"""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple

MINUS = "\N{MINUS SIGN}"
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

HEIGHT = 836
PANEL_TOP, PANEL_BOTTOM = 60, 722
# Between these lie all heights; endstop and bed end at the ground
LEVELS_TOP, LEVELS_BOTTOM, GROUND = 212, 628, 680
HEAD_HEIGHT = 64  # from the nozzle's tip to the carriage
# Within a column: the measured height, and the tip
HEIGHT_X, TIP_X = 30, 102
ZERO_X = 140
SMALLEST_SPAN = 0.02  # mm; a picture shows no less


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


def scale_for(levels: Sequence[float]) -> Scale:
    """A scale that shows all levels, mm."""
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
    """The places in their order, moved until they are that far apart."""
    order = sorted(range(len(places)), key=lambda index: places[index])
    found = list(places)
    # Neighbours that are too close go apart by the same way
    for _ in range(100 * len(places)):
        for low, high in zip(order, order[1:]):
            short = apart - (found[high] - found[low])
            if short > 0.0:
                found[low] -= short / 2.0
                found[high] += short / 2.0
    return found


def mm(value: float) -> str:
    """A length as a picture shows it."""
    text = f"{value:.3f}"
    return "0.000" if float(text) == 0.0 else text.replace("-", MINUS)


class Drawing:
    """Shapes by role: the style gives a role its colour."""

    def __init__(self, title: str, description: str, width: int, height: int):
        self.root = ET.Element(
            "svg",
            {
                "xmlns": "http://www.w3.org/2000/svg",
                "viewBox": f"0 0 {width} {height}",
                "width": str(width),
                "height": str(height),
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

    def dimension(
        self,
        role: str,
        x: float,
        levels: tuple[float, float],
        value: str,
        name: str,
    ) -> None:
        """An arrow between two levels with its value on it or above it."""
        start, end = levels
        self.arrow(role, x, start, end)
        fits = abs(end - start) >= 42
        y = (start + end) / 2 if fits else min(start, end) - 16
        half = 4.2 * len(value) + 7
        self.box(role, (x - half, y - 11, x + half, y + 11), 11)
        middle = {"text_anchor": "middle"}
        self.text("panel", (x, y + 4.6), value, font_weight=600, **middle)
        look = {"font_size": 12, "class_": "halo", **middle}
        self.text(role, (x, y - 17), name, **look)


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


class Words(NamedTuple):
    """What a picture says: title of the file, heading, all in one sentence."""

    title: str
    heading: str
    description: str


class Page(Drawing):
    """A panel with an axis of toolhead Z; its columns show one touch each.

    columns: where they begin, and where the last one ends. zero_x: where the
    words at Z=0 stand that nothing may cover.
    """

    def __init__(
        self,
        words: Words,
        width: int,
        scale: Scale,
        columns: Sequence[int],
        zero_x: int = ZERO_X,
    ):
        super().__init__(words.title, words.description, width, HEIGHT)
        *self.columns, self.end = columns
        self.zero_x = zero_x
        self.scale = scale
        self.box("page", (0, 0, width, HEIGHT), 14)
        look = {"font_size": 20, "font_weight": 700}
        self.text("ink", (20, 40), words.heading, **look)
        self.box("panel", (16, PANEL_TOP, width - 16, PANEL_BOTTOM), 12)
        self._axis()

    def _axis(self) -> None:
        """Millimetres of toolhead Z, its zero and its sign."""
        left, scale = self.columns[0], self.scale
        step = tick_step(scale.per_mm)
        decimals = max(0, -math.floor(math.log10(step)))
        first = math.ceil(scale.z(GROUND - 20) / step)
        for number in range(first, math.floor(scale.z(170) / step) + 1):
            y, is_zero = scale.y(number * step), number == 0
            role, width = ("muted", 1.4) if is_zero else ("grid", 1)
            self.line(role, (left - 12, y, self.end, y), width)
            label = f"{number * step:.{decimals}f}".replace("-", MINUS)
            self.text(
                "ink" if is_zero else "muted",
                (left - 18, y + 4.6),
                "0" if is_zero else label,
                text_anchor="end",
                font_weight=700 if is_zero else 400,
            )
        at = left + self.zero_x, scale.y(0.0) - 7
        self.text("ink", at, "Z=0 as homed", font_weight=600)
        x, top, bottom = 30, 198, 298
        self.line("ink", (x, bottom, x, top + 8), 2)
        points = f"{x},{top} {x - 5},{top + 10} {x + 5},{top + 10}"
        self.add("polygon", class_="f-ink", points=points)
        look = {"text_anchor": "end", "font_weight": 600}
        turn = f"translate({x + 22} {top}) rotate(-90)"
        self.text("ink", (0, 0), "up is positive", transform=turn, **look)
        turn = f"translate({x + 4} 478) rotate(-90)"
        look = {"text_anchor": "middle", "transform": turn}
        self.text("muted", (0, 0), "toolhead Z, mm", **look)

    def heading(self, number: int, role: str, name: str, words: str) -> int:
        """Above a column: its number, its name, what happens; where it is."""
        x, y = self.columns[number - 1], PANEL_TOP + 32
        self.add("circle", class_=f"f-{role}", cx=x + 10, cy=y - 5, r=11)
        look = {"text_anchor": "middle", "font_weight": 700}
        self.text("panel", (x + 10, y - 0.4), str(number), **look)
        self.text(role, (x + 28, y), name, font_size=17, font_weight=700)
        self.text("muted", (x, y + 24), words)
        return x

    def caption(self, x: float, words: str) -> None:
        """Below the ground: what stands there."""
        look = {"text_anchor": "middle", "font_size": 12}
        self.text("muted", (x, GROUND + 24), words, **look)

    def nozzle(self, column: float, z: float, role: str) -> None:
        """A nozzle with its heater block, its tip at a toolhead Z."""
        x, y = column + TIP_X, self.scale.y(z)
        self.add(
            "path",
            class_="f-metal",
            d=f"M{x - 5:.2f} {y:.2f}h10l10 -18h3v-16h-36v16h3z",
        )
        self.box(role, (x - 30, y - 60, x + 30, y - 34), 4)
        self.line(role, (x - 5, y, x + 5, y), 2.5)

    def height(self, column: float, z: float, role: str, name: str) -> None:
        """A measured height: from homed zero to the nozzle's tip."""
        x, y = column + HEIGHT_X, self.scale.y(z)
        self.line(role, (x - 12, y, column + TIP_X - 8, y), 1.4, "5 4")
        self.dimension(role, x, (self.scale.y(0.0), y), mm(z), name)

    def formula(
        self, parts: Sequence[tuple[str, str]], lines: Sequence[str]
    ) -> None:
        """Words in the colours of their roles, and what they mean below."""
        x, y = 20.0, float(PANEL_BOTTOM + 36)
        line = self.add("text", x=x, y=y, font_size=19, font_weight=600)
        line.set("{http://www.w3.org/XML/1998/namespace}space", "preserve")
        for role, words in parts:
            ET.SubElement(line, "tspan", {"class": f"f-{role}"}).text = words
        for number, words in enumerate(lines):
            self.text("muted", (x, y + 28 + 22 * number), words)
