"""What the pictures of the documents have in common.

All lengths are pixels, y down, unless their name says otherwise.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from tests.demo.picture import Drawing

MINUS = "\N{MINUS SIGN}"


def begin(
    titles: tuple[str, str],
    description: str,
    size: tuple[int, int],
    panel: Sequence[float],
) -> Drawing:
    """An empty page with a panel; titles: of the file, above the panel."""
    width, height = size
    drawing = Drawing(titles[0], description)
    drawing.root.set("viewBox", f"0 0 {width} {height}")
    drawing.root.set("width", str(width))
    drawing.root.set("height", str(height))
    drawing.box("page", (0, 0, width, height), 14)
    drawing.text(
        "ink", (panel[0] + 4, 40), titles[1], font_size=20, font_weight=700
    )
    drawing.box("panel", panel, 12)
    return drawing


def level(
    drawing: Drawing,
    ends: tuple[float, float],
    y: float,
    label: str,
    zero: bool,
) -> None:
    """A line of the axis with its number to the left."""
    role, width = ("muted", 1.4) if zero else ("grid", 1)
    drawing.line(role, (ends[0] - 12, y, ends[1], y), width)
    drawing.text(
        "ink" if zero else "muted",
        (ends[0] - 18, y + 4.6),
        label,
        text_anchor="end",
        font_weight=700 if zero else 400,
    )


def direction(
    drawing: Drawing, x: float, arrow: tuple[float, float], middle: float
) -> None:
    """Says beside the axis what it counts and which way is up.

    arrow: its top and its bottom.
    """
    top, bottom = arrow
    drawing.line("ink", (x, bottom, x, top + 8), 2)
    drawing.add(
        "polygon",
        class_="f-ink",
        points=f"{x},{top:.2f} {x - 5},{top + 10:.2f} {x + 5},{top + 10:.2f}",
    )
    upward = {"text_anchor": "end", "font_weight": 600}
    turn = f"translate({x + 22} {top:.0f}) rotate(-90)"
    drawing.text("ink", (0, 0), "up is positive", transform=turn, **upward)
    drawing.text(
        "muted",
        (0, 0),
        "toolhead Z, mm",
        text_anchor="middle",
        transform=f"translate({x + 4} {middle:.0f}) rotate(-90)",
    )


def heading(
    drawing: Drawing,
    at: tuple[float, float],
    number: int,
    role: str,
    words: tuple[str, str],
) -> None:
    """Above a column: its number, its name, and what happens there."""
    x, y = at
    drawing.add("circle", class_=f"f-{role}", cx=x + 10, cy=y - 5, r=11)
    drawing.text(
        "panel",
        (x + 10, y - 0.4),
        str(number),
        text_anchor="middle",
        font_weight=700,
    )
    drawing.text(role, (x + 28, y), words[0], font_size=17, font_weight=700)
    drawing.text("muted", (x, y + 24), words[1])


def nozzle(drawing: Drawing, x: float, y: float, role: str) -> None:
    """A nozzle with its heater block, tip at x, y."""
    drawing.add(
        "path",
        class_="f-metal",
        d=f"M{x - 5:.2f} {y:.2f}h10l10 -18h3v-16h-36v16h3z",
    )
    drawing.box(role, (x - 30, y - 60, x + 30, y - 34), 4)
    drawing.line(role, (x - 5, y, x + 5, y), 2.5)


def formula(
    drawing: Drawing,
    at: tuple[float, float],
    parts: Sequence[tuple[str, str]],
    lines: Sequence[str],
) -> None:
    """Words in the colours of their roles, and what they mean below."""
    x, y = at
    line = drawing.add("text", x=x, y=y, font_size=19, font_weight=600)
    line.set("{http://www.w3.org/XML/1998/namespace}space", "preserve")
    for role, words in parts:
        ET.SubElement(line, "tspan", {"class": f"f-{role}"}).text = words
    for number, words in enumerate(lines):
        drawing.text("muted", (x, y + 28 + 22 * number), words)
