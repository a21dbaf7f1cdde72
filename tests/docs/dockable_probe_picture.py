"""The picture of docs/dockable_probe.md: a dock seen from above.

    python -m tests.docs.dockable_probe_picture

writes it anew. The detour is the module's own.
"""

from __future__ import annotations

import importlib
import math
from pathlib import Path

from tests.docs.pictures import Drawing

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "dockable_probe.svg"
detour = importlib.import_module("z_touch.dockable_probe.detour")

WIDTH, HEIGHT = 760, 470
PANEL = (16, 60, WIDTH - 16, HEIGHT - 16)
# Millimetres of the example gantry.cfg
DOCK, APPROACH, DETACH = (50.0, 305.0), (50.0, 265.0), (90.0, 305.0)
HEAD = (5.0, 290.0)
GOAL = (150.0, 290.0)
LIMITS = ((-10.0, 200.0), (230.0, 310.0))
RADIUS = 40.0
# Pixels of a mm, and where the dock is on the page
SCALE = 4.0
MIDDLE = (236.0, 244.0)
# Ways in and out of the dock lie beside each other, so many pixels apart
ASIDE = 6.0


def at(point: tuple[float, float]) -> tuple[float, float]:
    """Where a place (mm) is on the page."""
    x, y = point[0] - DOCK[0], DOCK[1] - point[1]
    return MIDDLE[0] + SCALE * x, MIDDLE[1] + SCALE * y


def arrow(
    drawing: Drawing, role: str, line: tuple[float, float, float, float]
) -> None:
    """A line on the page with the head of an arrow in its middle."""
    drawing.line(role, line, 2.5)
    ax, ay, bx, by = line
    length = math.hypot(bx - ax, by - ay)
    ux, uy = (bx - ax) / length, (by - ay) / length
    x, y = (ax + bx) / 2.0, (ay + by) / 2.0
    corners = (
        (x + 8.0 * ux, y + 8.0 * uy),
        (x - 6.0 * ux - 6.0 * uy, y - 6.0 * uy + 6.0 * ux),
        (x - 6.0 * ux + 6.0 * uy, y - 6.0 * uy - 6.0 * ux),
    )
    points = " ".join(f"{cx:g},{cy:g}" for cx, cy in corners)
    drawing.add("polygon", class_=f"f-{role}", points=points)


def dot(
    drawing: Drawing, role: str, place: tuple[float, float], r: float = 5.0
) -> tuple[float, float]:
    """A place (mm); where it is on the page."""
    x, y = at(place)
    drawing.add("circle", class_=f"f-{role}", cx=x, cy=y, r=r)
    return x, y


def label(drawing: Drawing, x: float, y: float) -> None:
    """The words; the dock is at x, y."""
    bold, end = {"font_weight": 600}, {"text_anchor": "end"}
    drawing.text("ink", (x - 54, y - 38), "dock_position", **bold)
    drawing.text("nozzle", (x - 20, y + 66), "in", **end)
    drawing.text("probe", (x + 20, y + 66), "out, with the probe")
    drawing.text("switch", (x + 30, y + 22), "out, without it")
    left, low = at(APPROACH)
    drawing.text("nozzle", (left + 12, low + 22), "approach_position", **bold)
    drawing.text("muted", (left + 12, low + 40), "extract_, insert_position")
    right, top = at(DETACH)
    drawing.text("switch", (right + 14, top + 5), "detach_position", **bold)
    corner = SCALE * RADIUS * math.sqrt(0.5) + 10.0
    drawing.text("muted", (x + corner, y - corner), "safe_dock_distance")
    right, low = at(GOAL)
    drawing.text("muted", (right + 8, low + 54), "around the dock", **end)


def draw() -> str:
    """The picture as a text."""
    drawing = Drawing(
        "dockable_probe",
        "From the approach position into the dock, out again with the probe,"
        " or to the detach position without it; around the dock otherwise.",
        WIDTH,
        HEIGHT,
    )
    drawing.box("page", (0, 0, WIDTH, HEIGHT), 14)
    title = "The way to the dock and out of it, from above"
    drawing.text("ink", (20, 40), title, font_size=20, font_weight=700)
    drawing.box("panel", PANEL, 12)
    lanes = [detour.direction(DOCK, place) for place in (APPROACH, DETACH)]
    zone = detour.Zone(*DOCK, RADIUS, lanes)
    x, y = at(DOCK)
    drawing.add(
        "circle",
        class_="s-muted",
        cx=x,
        cy=y,
        r=SCALE * RADIUS,
        fill="none",
        stroke_dasharray="5 5",
    )
    drawing.box("metal", (x - 30, y - 26, x + 30, y - 10), 3)
    points = [HEAD, *detour.around(HEAD, GOAL, zone, LIMITS)]
    for a, b in zip(points, points[1:]):
        drawing.line("muted", (*at(a), *at(b)), 2.5)
    dot(drawing, "muted", HEAD)
    dot(drawing, "muted", GOAL)
    low = at(APPROACH)[1]
    arrow(drawing, "nozzle", (x - ASIDE, low, x - ASIDE, y))
    arrow(drawing, "probe", (x + ASIDE, y, x + ASIDE, low))
    arrow(drawing, "switch", (x, y, *at(DETACH)))
    for role, place in (
        ("ink", DOCK),
        ("nozzle", APPROACH),
        ("switch", DETACH),
    ):
        dot(drawing, role, place, 6.0)
    label(drawing, x, y)
    return drawing.text_of()


if __name__ == "__main__":
    PICTURE.write_text(draw(), encoding="utf-8", newline="\n")
