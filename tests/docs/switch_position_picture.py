"""The second picture of docs/z_calibration.md: the switch seen from below.

    python -m tests.docs.switch_position_picture

writes it anew. The switch is a D2F, 12.8 by 5.8 mm, the pin 3 mm wide.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tests.docs.pictures import Drawing

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "switch_position.svg"

WIDTH, HEIGHT = 900, 330
PANEL = (16, 60, WIDTH - 16, HEIGHT - 16)
# Pixels of a mm, and the places of the body's middle
SCALE = 16.0
MIDDLES = ((162.0, 180.0), (450.0, 180.0), (738.0, 180.0))
# Millimetres from the body's middle: half its size, its plunger, the pin
HALF = (6.4, 2.9)
PLUNGER, PLUNGER_RADIUS, PIN_RADIUS = 1.6, 0.7, 1.5


class Case(NamedTuple):
    """Where the pin is (mm from the body's middle), and whether that is right."""

    pin: float
    is_right: bool
    words: tuple[str, str]


CASES = (
    Case(-2.4, True, ("Right: beside the plunger,", "whole on the body")),
    Case(PLUNGER, False, ("Wrong: on the plunger,", "the height is worthless")),
    Case(-6.4, False, ("Wrong: over the edge,", "the body may tilt")),
)


def disc(
    drawing: Drawing, role: str, at: tuple[float, float], radius: float
) -> None:
    """A filled circle; its radius in mm."""
    x, y = at
    drawing.add("circle", class_=f"f-{role}", cx=x, cy=y, r=SCALE * radius)


def draw_case(
    drawing: Drawing, middle: tuple[float, float], case: Case
) -> None:
    """The body with its plunger, the pin on it, and what that means."""
    x, y = middle
    wide, high = SCALE * HALF[0], SCALE * HALF[1]
    drawing.box("body", (x - wide, y - high, x + wide, y + high), 6)
    disc(drawing, "panel", (x + SCALE * PLUNGER, y), PLUNGER_RADIUS)
    role = "probe" if case.is_right else "offset"
    pin = x + SCALE * case.pin
    disc(drawing, role, (pin, y), PIN_RADIUS)
    if case.pin == PLUNGER:
        disc(drawing, "panel", (pin, y), PLUNGER_RADIUS)
    look = {"text_anchor": "middle", "font_weight": 600}
    for number, words in enumerate(case.words):
        at = x, y + high + 38 + 20 * number
        drawing.text(role, at, words, **look)
    for words, place in (("pin", pin), ("plunger", x + SCALE * PLUNGER)):
        if words == "plunger" and not case.is_right:
            continue
        drawing.line("ink", (place, y - high - 8, place, y - 12), 1.2)
        drawing.text("ink", (place, y - high - 14), words, text_anchor="middle")


def draw() -> str:
    """The picture as a text."""
    drawing = Drawing(
        "switch_xy_position",
        "The body of the probe's switch, seen from below. The metal pin has to"
        " meet it beside the plunger: not on it, and not over the edge.",
        WIDTH,
        HEIGHT,
    )
    drawing.box("page", (0, 0, WIDTH, HEIGHT), 14)
    title = "Where the pin has to meet the switch, seen from below"
    drawing.text("ink", (20, 40), title, font_size=20, font_weight=700)
    drawing.box("panel", PANEL, 12)
    for middle, case in zip(MIDDLES, CASES):
        draw_case(drawing, middle, case)
    return drawing.text_of()


if __name__ == "__main__":
    PICTURE.write_text(draw(), encoding="utf-8", newline="\n")
