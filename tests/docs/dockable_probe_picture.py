"""The picture of docs/dockable_probe.md: a dock seen from above.

    python -m tests.docs.dockable_probe_picture

writes it anew. The way around is the module's own.
"""

from __future__ import annotations

import importlib
from pathlib import Path

from tests.docs.pictures import Drawing

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "dockable_probe.svg"
ways = importlib.import_module("z_touch.ways")

WIDTH, HEIGHT = 760, 470
PANEL = (16, 60, WIDTH - 16, HEIGHT - 16)
# Millimetres of the example gantry.cfg
DOCK, APPROACH, DETACH = (50.0, 305.0), (50.0, 265.0), (90.0, 305.0)
HEAD = (5.0, 290.0)
GOAL = (150.0, 290.0)
LIMITS = ((-10.0, 200.0), (230.0, 310.0))
RADIUS = 40.0


def at(point: tuple[float, float]) -> tuple[float, float]:
    """Where a place (mm) is on the page."""
    return 90.0 + 3.4 * (point[0] + 10.0), 90.0 + 3.6 * (322.0 - point[1])


def path(drawing: Drawing, role: str, points, width: float = 2.5) -> None:
    """A polyline with a point at its end."""
    for a, b in zip(points, points[1:]):
        drawing.line(role, (*at(a), *at(b)), width)
    x, y = at(points[-1])
    drawing.add("circle", class_=f"f-{role}", cx=x, cy=y, r=5)


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
    lanes = [ways.direction(DOCK, place) for place in (APPROACH, DETACH)]
    zone = ways.Zone(*DOCK, RADIUS, lanes)
    x, y = at(DOCK)
    drawing.add(
        "ellipse",
        class_="s-muted",
        cx=x,
        cy=y,
        rx=3.4 * RADIUS,
        ry=3.6 * RADIUS,
        fill="none",
        stroke_dasharray="5 5",
    )
    drawing.box("metal", (x - 26, y - 22, x + 26, y - 8), 3)
    path(
        drawing,
        "muted",
        [HEAD, *ways.way_around(HEAD, GOAL, zone, LIMITS)],
    )
    path(drawing, "nozzle", [APPROACH, DOCK])
    path(drawing, "probe", [DOCK, DETACH])
    x, y = at(APPROACH)
    drawing.add("circle", class_="f-nozzle", cx=x, cy=y, r=5)
    bold = {"font_weight": 600}
    drawing.text("nozzle", (x + 12, y + 18), "approach_position", **bold)
    drawing.text("muted", (x + 12, y + 36), "extract_, insert_position")
    x, y = at(DOCK)
    drawing.text("ink", (x - 40, y - 32), "dock_position", **bold)
    x, y = at(DETACH)
    drawing.text("probe", (x + 14, y - 8), "detach_position", **bold)
    x, y = at(GOAL)
    drawing.text("muted", (x - 60, y + 26), "around the dock")
    x, y = at((-6.0, 266.0))
    drawing.text("muted", (x - 20, y + 60), "safe_dock_distance")
    return drawing.text_of()


if __name__ == "__main__":
    PICTURE.write_text(draw(), encoding="utf-8", newline="\n")
