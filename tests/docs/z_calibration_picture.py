"""The picture of docs/z_calibration.md: three touches, drawn to scale.

    python -m tests.docs.z_calibration_picture

writes it anew. Its numbers are those of the console example in the document.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from tests.docs.pictures import (
    GROUND,
    HEAD_HEIGHT,
    MINUS,
    TIP_X,
    Page,
    Words,
    mm,
    scale_for,
    spread,
)

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "z_calibration.svg"

# All lengths below are pixels, y down, unless their name says otherwise
WIDTH = 1040
COLUMNS = (96, 344, 628, 872)
# Within a column: the switch body, the pin under it, how far it hangs down
BODY_X, PIN_X, BELOW_X = 166, 150, 226

MEANING = (
    "nozzle, switch and probe: where the head stands when the touch triggers."
    " offset: where it stands when the nozzle meets the bed.",
    "switch_offset: how far the pressed plunger still sticks out of the body"
    " when the switch triggers.",
)


class Touches(NamedTuple):
    """What a run has measured, toolhead Z in mm, and the switch_offset."""

    nozzle: float
    switch: float
    probe: float
    switch_offset: float

    @property
    def body(self) -> float:
        """How far the switch body hangs below the nozzle."""
        return self.switch - self.nozzle

    @property
    def offset(self) -> float:
        """Toolhead Z at which the nozzle meets the bed."""
        return self.probe - (self.body + self.switch_offset)


EXAMPLE = Touches(nozzle=1.9, switch=8.315, probe=7.315, switch_offset=0.44)


def draw(
    touches: Touches,
    title: str = "What CALIBRATE_Z measures",
    heading: str = "What CALIBRATE_Z measures: three toolhead heights, in mm,"
    " to scale",
    lines: Sequence[str] = MEANING,
) -> str:
    """The picture as the text of an SVG file; lines: below the formula."""
    levels = (0.0, touches.offset, *touches[:3])
    words = Words(title, heading, describe(touches))
    page = Page(words, WIDTH, scale_for(levels), COLUMNS)
    draw_nozzle_touch(page, touches)
    draw_switch_touch(page, touches)
    draw_bed_touch(page, touches)
    draw_chain(page, touches)
    draw_formula(page, touches, lines)
    return page.text_of()


def describe(touches: Touches) -> str:
    """The picture in one sentence."""
    return (
        "Nozzle on the endstop pin, switch body on the same pin, probe on the"
        " bed. Toolhead Z, up is positive:"
        f" nozzle {mm(touches.nozzle)}, switch {mm(touches.switch)},"
        f" probe {mm(touches.probe)} mm;"
        f" switch {MINUS} nozzle {mm(touches.body)},"
        f" switch_offset {mm(touches.switch_offset)},"
        f" offset {mm(touches.offset)} mm"
    )


def draw_head(
    page: Page, column: float, z: float, body: float, role: str
) -> None:
    """Nozzle and probe on one carriage; body: how far it hangs below (mm)."""
    top = page.scale.y(z) - HEAD_HEIGHT
    x, bottom = column + BODY_X, page.scale.y(z - body)
    page.box("metal", (x - 7, top, x + 7, bottom - 42))
    page.box("body", (x - 32, bottom - 42, x + 32, bottom), 4)
    look = {"text_anchor": "middle", "font_size": 12, "font_weight": 600}
    page.text("panel", (x, bottom - 16.6), "switch", **look)
    page.box("metal", (column + TIP_X - 34, top - 14, x + 32, top + 6), 5)
    page.nozzle(column, z, role)


def draw_pin(page: Page, x: float, z: float) -> None:
    """The pin of the Z endstop, pressed down to a toolhead Z."""
    page.box("ink", (x - 6, page.scale.y(z), x + 6, GROUND - 30), 2)
    page.box("body", (x - 21, GROUND - 34, x + 21, GROUND), 4)
    page.caption(x, "pin of the Z endstop")


def draw_plunger(page: Page, column: float, top: float, bottom: float) -> None:
    """What sticks out of the switch body, beside where the pin presses."""
    x = column + BODY_X + 17
    page.box("ink", (x - 4, top, x + 4, bottom), 1)


def draw_nozzle_touch(page: Page, touches: Touches) -> None:
    """The first column."""
    column = page.heading(1, "nozzle", "nozzle", "the tip presses the pin")
    draw_pin(page, column + TIP_X, touches.nozzle)
    page.nozzle(column, touches.nozzle, "nozzle")
    page.height(column, touches.nozzle, "nozzle", "nozzle")


def draw_switch_touch(page: Page, touches: Touches) -> None:
    """The second column."""
    words = "the switch body presses the same pin"
    column = page.heading(2, "switch", "switch", words)
    tip, pin = page.scale.y(touches.switch), page.scale.y(touches.nozzle)
    draw_pin(page, column + PIN_X, touches.nozzle)
    # Free, so a little longer than when it triggers
    length = touches.switch_offset * page.scale.per_mm + 7
    draw_plunger(page, column, pin, pin + length)
    draw_head(page, column, touches.switch, touches.body, "switch")
    x = column + BELOW_X
    page.line("muted", (column + TIP_X + 8, tip, x + 10, tip))
    page.line("muted", (column + BODY_X + 34, pin, x + 10, pin))
    name = f"switch {MINUS} nozzle"
    page.dimension("body", x, (tip, pin), mm(touches.body), name)
    page.height(column, touches.switch, "switch", "switch")


def draw_bed_touch(page: Page, touches: Touches) -> None:
    """The third column."""
    words = "the probe triggers on the bed"
    column = page.heading(3, "probe", "probe", words)
    tip, bed = page.scale.y(touches.probe), page.scale.y(touches.offset)
    body = page.scale.y(touches.probe - touches.body)
    right = column + BELOW_X - 14
    page.box("bed", (column + 60, bed, right, GROUND), 3)
    page.line("ink", (column + 60, bed, right, bed), 1.4)
    page.caption(column + TIP_X, "bed")
    draw_plunger(page, column, body, bed)
    draw_head(page, column, touches.probe, touches.body, "probe")
    x = column + BELOW_X + 10
    page.line("muted", (column + TIP_X + 8, tip, x, tip))
    page.line("muted", (column + BODY_X + 34, body, x, body))
    page.line("muted", (right, bed, x, bed))
    page.height(column, touches.probe, "probe", "probe")


def draw_chain(page: Page, touches: Touches) -> None:
    """From the probe's height down to Z=0, term by term."""
    x, scale = COLUMNS[2] + BELOW_X, page.scale
    body = touches.probe - touches.body
    terms = (
        ("body", touches.probe, body, f"switch {MINUS} nozzle"),
        ("switch_offset", body, touches.offset, "switch_offset"),
        ("offset", touches.offset, 0.0, "offset"),
    )
    middles = [scale.y((high + low) / 2) for _, high, low, _ in terms]
    for term, middle, y in zip(terms, middles, spread(middles, 44)):
        role, high, low, words = term
        page.arrow(role, x, scale.y(high), scale.y(low))
        page.line(role, (x + 5, middle, x + 22, y))
        page.text(role, (x + 27, y - 4), words, font_weight=600)
        page.text(role, (x + 27, y + 13), mm(high - low), font_weight=600)


def draw_formula(page: Page, touches: Touches, lines: Sequence[str]) -> None:
    """The formula with the numbers above, and what they mean."""
    parts = (
        ("offset", "offset"),
        ("ink", " = "),
        ("probe", f"probe {mm(touches.probe)}"),
        ("ink", f" {MINUS} ("),
        ("switch", f"switch {mm(touches.switch)}"),
        ("ink", f" {MINUS} "),
        ("nozzle", f"nozzle {mm(touches.nozzle)}"),
        ("ink", " + "),
        ("switch_offset", f"switch_offset {mm(touches.switch_offset)}"),
        ("ink", ") = "),
        ("offset", f"{mm(touches.offset)} mm"),
    )
    page.formula(parts, lines)


if __name__ == "__main__":
    PICTURE.write_text(draw(EXAMPLE), encoding="utf-8", newline="\n")
