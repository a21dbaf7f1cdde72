"""What a picture is made of: text, plots and their curves, as SVG.

Colours stand in the elements themselves, as many viewers know no style sheets, or no
variables in them. The style sheet only changes them on dark pages.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

# Its texts are no messages: they are drawn.

from __future__ import annotations

import math
from typing import Iterable, List, NamedTuple, Optional, Sequence, Tuple

# Of the picture and of its plots, in its own units
WIDTH = 720
LEFT, RIGHT = 66, 18
EDGE = 18
PLOT = 104
TITLE, BELOW, GAP = 24, 18, 20
LINE = 18
SIZE = 13

# Letters in a line of text: none is wider than 7.2 on an average
LETTERS = 94

# By name: on a light and on a dark page
COLOURS = (
    ("page", "#ffffff", "#0d1117"),
    ("ink", "#1f2328", "#e6edf3"),
    ("soft", "#59636e", "#9198a1"),
    ("grid", "#d8dee4", "#30363d"),
    ("a", "#0969da", "#58a6ff"),
    ("b", "#bc4c00", "#f0883e"),
    ("c", "#8250df", "#bc8cff"),
    ("good", "#1a7f37", "#3fb950"),
    ("watch", "#9a6700", "#d29922"),
    ("act", "#cf222e", "#ff7b72"),
)
LIGHT = {name: light for name, light, _ in COLOURS}

BOLD = 'font-weight="600"'
SMALL = f'font-size="11" {BOLD}'
END = 'text-anchor="end"'
MIDDLE = 'text-anchor="middle"'

# Runs of which each has a dot on its curve, at most
DOTS = 120

XY = Tuple[float, float]


class Curve(NamedTuple):
    """One curve: a value of each run or None; band: pairs of low and high."""

    name: str
    colour: str
    values: Sequence[Optional[float]]
    band: Optional[Sequence[Optional[XY]]] = None


def style() -> str:
    """Return the style sheet: other colours on dark pages."""
    rules = "".join(
        f".f-{name}{{fill:{dark}}}.s-{name}{{stroke:{dark}}}"
        for name, _, dark in COLOURS
    )
    return (
        "svg{max-width:100%;height:auto;display:block;margin:auto}"
        f"@media(prefers-color-scheme:dark){{svg{{background:#0d1117}}{rules}}}"
    )


def fill(colour: str) -> str:
    """Return the attributes of an element that is filled."""
    return f'class="f-{colour}" fill="{LIGHT[colour]}"'


def stroke(colour: str, width: float = 1.0, dashes: str = "") -> str:
    """Return the attributes of a line."""
    text = f'class="s-{colour}" stroke="{LIGHT[colour]}" fill="none"'
    if width != 1.0:
        text += f' stroke-width="{width:g}"'
    if dashes:
        text += f' stroke-dasharray="{dashes}"'
    return text


def escaped(text: str) -> str:
    """Return a text as XML has it, without what that cannot hold."""
    letters = []
    for letter in text:
        code = ord(letter)
        if letter in '&<>"' or 0xA0 <= code < 0xD800:
            letters.append(f"&#{code};")
        else:
            letters.append(letter if 0x20 <= code < 0x7F else "?")
    return "".join(letters)


def wrapped(text: str, most: int, letters: int = LETTERS) -> List[str]:
    """Return lines of whole words; of more than 'most' the last one is cut."""
    lines = [""]
    for word in text.split():
        word = word[: letters - 1]
        if len(lines[-1]) + len(word) >= letters:
            lines.append("")
        lines[-1] += (" " if lines[-1] else "") + word
    if len(lines) > most:
        lines = lines[:most]
        lines[-1] = lines[-1][: letters - 3] + "..."
    return lines


def ticks(low: float, high: float) -> List[Tuple[float, int]]:
    """Return three or four round numbers between, each with its digits."""
    rough = (high - low) / 3.0
    power = 10.0 ** math.floor(math.log10(rough))
    step = min((f * power for f in (1, 2, 5, 10)), key=lambda s: abs(s - rough))
    first = math.ceil(low / step - 1e-9)
    count = int(math.floor(high / step + 1e-9) - first)
    digits = max(0, -int(math.floor(math.log10(step) + 1e-9)))
    return [((first + i) * step, digits) for i in range(count + 1)]


def spanned(low: float, high: float, least: float) -> XY:
    """Return the ends of a plot: 'least' apart at least, with room around."""
    lack = max(0.0, least - (high - low)) / 2.0
    low, high = low - lack, high + lack
    room = max((high - low) * 0.08, 1e-6 * abs(high))
    return low - room, high + room


def from_zero(high: float, least: float) -> XY:
    """Return the ends of a plot from 0 to 'least' at least, with room above."""
    return 0.0, max(high, least) * 1.08


class Page:
    """A drawing that grows downwards; y: where the next part begins."""

    def __init__(self) -> None:
        """Begin an empty one."""
        self.parts: List[str] = []
        self.y = 0.0

    def add(self, element: str) -> None:
        """Add an element."""
        self.parts.append(element)

    def text(
        self, x: float, y: float, text: str, colour: str = "ink", more: str = ""
    ) -> None:
        """Add one line of text; more: attributes."""
        more = f" {more}" if more else ""
        self.add(
            f'<text x="{x:.1f}" y="{y:.1f}" {fill(colour)}{more}>'
            f"{escaped(text)}</text>"
        )

    def line(
        self,
        text: str,
        colour: str = "ink",
        more: str = "",
        *,
        most: int = 1,
        x: float = EDGE,
    ) -> None:
        """Add text of several lines, 'most' of them, below the last one."""
        letters = LETTERS - int((x - EDGE) / 7.0)
        for line in wrapped(text, most, letters):
            self.y += LINE
            self.text(x, self.y, line, colour, more)

    def title(self, text: str) -> None:
        """Add a title."""
        self.line(text, more=BOLD)

    def circles(
        self, points: Sequence[XY], radii: Sequence[float], attributes: str
    ) -> None:
        """Add circles around points."""
        for (x, y), radius in zip(points, radii):
            self.add(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}" {attributes}/>'
            )

    def done(self) -> str:
        """Return the picture."""
        size = f"{WIDTH} {self.y + GAP:.0f}"
        width, height = size.split()
        head = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}"'
            f' width="{width}" height="{height}" font-family="system-ui,'
            "-apple-system,Segoe UI,Roboto,DejaVu Sans,sans-serif"
            f'" font-size="{SIZE}"><style>{style()}</style><rect width="{width}"'
            f' height="{height}" {fill("page")}/>\n'
        )
        return head + "\n".join(self.parts) + "</svg>\n"


class Plot:
    """One plot on a page."""

    def __init__(
        self,
        page: Page,
        xs: Sequence[float],
        ends: XY,
        box: XY = (LEFT, WIDTH - RIGHT),
    ) -> None:
        """Begin it where the page ends.

        xs: where each run is, from 0 to 1; ends: lowest and highest value; box: its
        left and right end.
        """
        self.page = page
        self.xs = xs
        self.low, self.high = ends
        self.left, self.right = box
        self.top = page.y + TITLE
        self.bottom = self.top + PLOT

    def x(self, number: int) -> float:
        """Return where a run is."""
        return self.at(self.xs[number])

    def at(self, part: float) -> float:
        """Return where a part of the width is, so that points stay inside."""
        return self.left + 7 + part * (self.right - self.left - 14)

    def y(self, value: float) -> float:
        """Return where a value is."""
        part = (value - self.low) / (self.high - self.low)
        return self.top + PLOT * (1.0 - part)

    def frame(self, title: str, words: str = "") -> None:
        """Draw the title, softer words beside it, and lines with their values."""
        page = self.page
        x = EDGE if self.left == LEFT else self.left
        page.text(x, page.y + 12, title, more=BOLD)
        if words:
            page.text(x + 7.7 * len(title) + 10, page.y + 12, words, "soft")
        lines = []
        for value, digits in ticks(self.low, self.high):
            y, text = self.y(value), f"{value + 0.0:.{digits}f}"
            lines.append(f"M{self.left:.1f} {y:.1f}H{self.right:.1f}")
            page.text(self.left - 6, y + 4, text, "soft", END)
        page.add(f'<path d="{"".join(lines)}" {stroke("grid")}/>')

    def scale(self, marks: Iterable[Tuple[float, str]]) -> None:
        """Draw marks below it: a place from 0 to 1, and a text."""
        page = self.page
        for part, text in marks:
            x, more = self.at(part), MIDDLE
            page.add(
                f'<path d="M{x:.1f} {self.bottom:.1f}v4" {stroke("soft")}/>'
            )
            if x - 3.6 * len(text) < self.left:
                x, more = self.left, ""
            elif x + 3.6 * len(text) > self.right:
                x, more = self.right, END
            page.text(x, self.bottom + 16, text, "soft", more)

    def below(self, text: str) -> None:
        """Draw a text below it."""
        x = (self.left + self.right) / 2.0
        self.page.text(x, self.bottom + 16, text, "soft", MIDDLE)

    def strip(self, low: float, high: float, colour: str) -> None:
        """Fill all of it between two values."""
        top, height = self.y(high), self.y(low) - self.y(high)
        self.page.add(
            f'<rect x="{self.left:.1f}" y="{top:.1f}"'
            f' width="{self.right - self.left:.1f}" height="{height:.1f}"'
            f' {fill(colour)} fill-opacity="0.15"/>'
        )

    def legend(self, curves: Sequence[Curve]) -> None:
        """Draw the names of the curves, from the right."""
        x = self.right
        for curve in reversed(curves):
            y, more = self.top - TITLE + 12, f"{BOLD} {END}"
            self.page.text(x, y, curve.name, curve.colour, more)
            x -= 8.0 * len(curve.name) + 14

    def curve(self, curve: Curve) -> None:
        """Draw a curve, through all runs that have a value."""
        points = [
            (self.x(i), self.y(value))
            for i, value in enumerate(curve.values)
            if value is not None
        ]
        if curve.band:
            self._band(curve.band, curve.colour)
        self.page.add(
            f'<polyline points="{path(points)}" {stroke(curve.colour, 1.6)}/>'
        )
        if len(self.xs) <= DOTS:
            self.dots(points, curve.colour)

    def _band(self, band: Sequence[Optional[XY]], colour: str) -> None:
        there = [(self.x(i), ends) for i, ends in enumerate(band) if ends]
        points = [(x, self.y(low)) for x, (low, _) in there]
        points += [(x, self.y(high)) for x, (_, high) in reversed(there)]
        self.page.add(
            f'<polygon points="{path(points)}" {fill(colour)} fill-opacity="0.2"/>'
        )

    def dots(
        self, points: Sequence[XY], colour: str, radius: float = 2.2
    ) -> None:
        """Draw dots at places of the page."""
        circles = "".join(
            f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:.1f}"/>'
            for x, y in points
        )
        self.page.add(f"<g {fill(colour)}>{circles}</g>")

    def rings(self, points: Sequence[XY], colour: str) -> None:
        """Draw hollow dots, of what does not count."""
        for x, y in points:
            self.page.add(
                f'<circle cx="{x:.1f}" cy="{y:.1f}" r="4" {stroke(colour, 1.5)}/>'
            )

    def mark(self, number: int, colour: str) -> None:
        """Draw a dashed line through it, at one run."""
        self.page.add(
            f'<path d="M{self.x(number):.1f} {self.top:.1f}V{self.bottom:.1f}"'
            f" {stroke(colour, dashes='4 3')}/>"
        )

    def flag(self, number: int, text: str, colour: str) -> None:
        """Draw a flag with a text at the top of such a line."""
        x, wide = self.x(number), 7.4 * len(text) + 6
        self.page.add(
            f'<rect x="{x - wide / 2.0:.1f}" y="{self.top - 7:.1f}"'
            f' width="{wide:.1f}" height="14" rx="3" {fill(colour)}/>'
        )
        self.page.text(x, self.top + 4, text, "page", f"{MIDDLE} {SMALL}")

    def crosses(self, numbers: Sequence[int], colour: str) -> None:
        """Draw an X for each of these runs, at the bottom."""
        self._signs(numbers, "l7 7m0 -7l-7 7", stroke(colour, 1.6))

    def triangles(self, numbers: Sequence[int], colour: str) -> None:
        """Draw a triangle for each of these runs, at the bottom."""
        self._signs(numbers, "h7l-3.5 7z", fill(colour))

    def _signs(
        self, numbers: Sequence[int], form: str, attributes: str
    ) -> None:
        if not numbers:
            return
        y = self.bottom - 8.5
        paths = "".join(
            f"M{self.x(i) - 3.5:.1f} {y:.1f}{form}" for i in numbers
        )
        self.page.add(f'<path d="{paths}" {attributes}/>')


def path(points: Sequence[XY]) -> str:
    """Return the corners of a line."""
    return " ".join(f"{x:.1f},{y:.1f}" for x, y in points)


class Plan:
    """A plan of the bed from above, as high as it is wide."""

    def __init__(self, page: Page, points: Sequence[XY], box: XY) -> None:
        """Begin it where the page ends.

        points: X and Y (mm) that have to be on it; box: its left and right end.
        """
        self.page = page
        self.left, self.right = box
        self.top, self.side = page.y, box[1] - box[0]
        ends = [(min(part), max(part)) for part in zip(*points)]
        self.middle = [(low + high) / 2.0 for low, high in ends]
        self.span = max([high - low for low, high in ends] + [1.0]) * 1.25

    def place(self, point: XY) -> XY:
        """Return where X and Y are on the page; Y of the bed goes up."""
        x, y = (
            (xy - middle) / self.span + 0.5
            for xy, middle in zip(point, self.middle)
        )
        return self.left + x * self.side, self.top + (1.0 - y) * self.side

    def frame(self) -> None:
        """Draw its edge, with the ends of X and Y."""
        page, half, bottom = self.page, self.span / 2.0, self.top + self.side
        x, y = self.middle
        page.add(
            f'<rect x="{self.left:.1f}" y="{self.top:.1f}"'
            f' width="{self.side:.1f}" height="{self.side:.1f}" {stroke("grid")}/>'
        )
        for end, value, more in (
            (self.left, x - half, ""),
            (self.right, x + half, END),
        ):
            page.text(end, bottom + 16, f"X {value:.1f}", "soft", more)
        for end, value in ((bottom, y - half), (self.top + 12, y + half)):
            page.text(self.left - 6, end, f"Y {value:.1f}", "soft", END)

    def circles(
        self, points: Sequence[XY], radii: Sequence[float], attributes: str
    ) -> None:
        """Draw circles around points of the bed."""
        self.page.circles(list(map(self.place, points)), radii, attributes)
