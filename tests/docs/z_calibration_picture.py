"""The picture of docs/z_calibration.md: three touches, drawn to scale.

    python -m tests.docs.z_calibration_picture

writes it anew. Its numbers are those of the console example in the document.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tests.demo.picture import Drawing, Scale, mm, spread
from tests.docs.pictures import (
    MINUS,
    begin,
    direction,
    formula,
    heading,
    level,
    nozzle,
)

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "z_calibration.svg"

# All lengths below are pixels, y down, unless their name says otherwise
WIDTH, HEIGHT = 1040, 800
SCALE = Scale(0.0, 50.0)
ZERO = SCALE.y(0.0)
GROUND = ZERO + 36  # where bed and endstop end
PANEL = (16, 60, WIDTH - 16, GROUND + 32)
COLUMNS = (96, 344, 628)
COLUMNS_END = 872
# Within a column: the measured height, the tip, the switch body, the pin under
# the body, and how far the body hangs down
HEIGHT_X, TIP_X, BODY_X, PIN_X, BELOW_X = 30, 98, 164, 148, 224
HEAD_HEIGHT = 64  # from the nozzle's tip to the carriage


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


def draw(touches: Touches) -> str:
    """The picture as the text of an SVG file."""
    drawing = begin(
        (
            "What CALIBRATE_Z measures",
            "What CALIBRATE_Z measures: three toolhead heights, in mm, to scale",
        ),
        describe(touches),
        (WIDTH, HEIGHT),
        PANEL,
    )
    draw_axis(drawing)
    draw_nozzle_touch(drawing, touches)
    draw_switch_touch(drawing, touches)
    draw_bed_touch(drawing, touches)
    draw_chain(drawing, touches)
    draw_formula(drawing, touches)
    return drawing.text_of()


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


def draw_axis(drawing: Drawing) -> None:
    """Millimetres of toolhead Z, its zero and its sign."""
    for z in range(10):
        ends = (COLUMNS[0], COLUMNS_END)
        level(drawing, ends, SCALE.y(float(z)), str(z), z == 0)
    drawing.text(
        "ink", (COLUMNS[0] + 132, ZERO - 7), "Z=0 as homed", font_weight=600
    )
    arrow = SCALE.y(8.6), SCALE.y(6.6)
    direction(drawing, PANEL[0] + 18, arrow, SCALE.y(3.0))


def draw_heading(drawing: Drawing, number: int, role: str, words: str) -> None:
    """Above a column: what touches what."""
    name = ("nozzle", "switch", "probe")[number - 1]
    at = COLUMNS[number - 1], PANEL[1] + 32
    heading(drawing, at, number, role, (name, words))


def draw_head(
    drawing: Drawing, column: float, tip: float, bottom: float, role: str
) -> None:
    """Nozzle and probe on one carriage; bottom is that of the switch body."""
    top, x = tip - HEAD_HEIGHT, column + BODY_X
    drawing.box("metal", (x - 7, top, x + 7, bottom - 42))
    drawing.box("body", (x - 32, bottom - 42, x + 32, bottom), 4)
    drawing.text(
        "panel",
        (x, bottom - 16.6),
        "switch",
        text_anchor="middle",
        font_size=12,
        font_weight=600,
    )
    drawing.box("metal", (column + TIP_X - 34, top - 14, x + 32, top + 6), 5)
    nozzle(drawing, column + TIP_X, tip, role)


def draw_pin(drawing: Drawing, x: float, y: float) -> None:
    """The pin of the Z endstop, pressed down to y."""
    drawing.box("ink", (x - 6, y, x + 6, GROUND - 30), 2)
    drawing.box("body", (x - 21, GROUND - 34, x + 21, GROUND), 4)
    drawing.text(
        "muted",
        (x, GROUND + 18),
        "pin of the Z endstop",
        text_anchor="middle",
        font_size=12,
    )


def draw_plunger(
    drawing: Drawing, column: float, top: float, bottom: float
) -> None:
    """What sticks out of the switch body, beside where the pin presses."""
    x = column + BODY_X + 17
    drawing.box("ink", (x - 4, top, x + 4, bottom), 1)


def draw_height(drawing: Drawing, column: float, z: float, role: str) -> None:
    """A measured height: from homed zero to the nozzle's tip."""
    x, y = column + HEIGHT_X, SCALE.y(z)
    drawing.line(role, (x - 12, y, column + TIP_X - 8, y), 1.4, "5 4")
    drawing.dimension(role, x, (ZERO, y), mm(z), role)


def draw_nozzle_touch(drawing: Drawing, touches: Touches) -> None:
    """The first column."""
    column, tip = COLUMNS[0], SCALE.y(touches.nozzle)
    draw_heading(drawing, 1, "nozzle", "the nozzle tip presses the pin")
    draw_pin(drawing, column + TIP_X, tip)
    nozzle(drawing, column + TIP_X, tip, "nozzle")
    draw_height(drawing, column, touches.nozzle, "nozzle")


def draw_switch_touch(drawing: Drawing, touches: Touches) -> None:
    """The second column."""
    column = COLUMNS[1]
    tip, pin = SCALE.y(touches.switch), SCALE.y(touches.nozzle)
    draw_heading(drawing, 2, "switch", "the switch body presses the same pin")
    draw_pin(drawing, column + PIN_X, pin)
    # Free, so a little longer than when it triggers
    length = touches.switch_offset * SCALE.per_mm + 7
    draw_plunger(drawing, column, pin, pin + length)
    draw_head(drawing, column, tip, pin, "switch")
    x = column + BELOW_X
    drawing.line("muted", (column + TIP_X + 8, tip, x + 10, tip))
    drawing.line("muted", (column + BODY_X + 34, pin, x + 10, pin))
    drawing.dimension(
        "body", x, (tip, pin), mm(touches.body), f"switch {MINUS} nozzle"
    )
    draw_height(drawing, column, touches.switch, "switch")


def draw_bed_touch(drawing: Drawing, touches: Touches) -> None:
    """The third column."""
    column, tip = COLUMNS[2], SCALE.y(touches.probe)
    body, bed = SCALE.y(touches.probe - touches.body), SCALE.y(touches.offset)
    draw_heading(drawing, 3, "probe", "the probe triggers on the bed")
    right = column + BELOW_X - 14
    drawing.box("bed", (column + 60, bed, right, GROUND), 3)
    drawing.line("ink", (column + 60, bed, right, bed), 1.4)
    drawing.text(
        "muted",
        (column + TIP_X, GROUND + 18),
        "bed",
        text_anchor="middle",
        font_size=12,
    )
    draw_plunger(drawing, column, body, bed)
    draw_head(drawing, column, tip, body, "probe")
    x = column + BELOW_X + 10
    drawing.line("muted", (column + TIP_X + 8, tip, x, tip))
    drawing.line("muted", (column + BODY_X + 34, body, x, body))
    drawing.line("muted", (right, bed, x, bed))
    draw_height(drawing, column, touches.probe, "probe")


def draw_chain(drawing: Drawing, touches: Touches) -> None:
    """From the probe's height down to Z=0, term by term."""
    x = COLUMNS[2] + BELOW_X
    body = touches.probe - touches.body
    terms = (
        ("body", touches.probe, body, f"switch {MINUS} nozzle"),
        ("switch_offset", body, touches.offset, "switch_offset"),
        ("offset", touches.offset, 0.0, "offset"),
    )
    middles = [SCALE.y((high + low) / 2) for _, high, low, _ in terms]
    for term, middle, y in zip(terms, middles, spread(middles, 44)):
        role, high, low, words = term
        drawing.arrow(role, x, SCALE.y(high), SCALE.y(low))
        drawing.line(role, (x + 5, middle, x + 22, y))
        drawing.text(role, (x + 27, y - 4), words, font_weight=600)
        drawing.text(role, (x + 27, y + 13), mm(high - low), font_weight=600)


def draw_formula(drawing: Drawing, touches: Touches) -> None:
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
    formula(
        drawing,
        (float(PANEL[0] + 4), float(PANEL[3] + 36)),
        parts,
        (
            "nozzle, switch and probe: where the head stands when the touch"
            " triggers. offset: where it stands when the nozzle meets the bed.",
            "switch_offset: how far the pressed plunger still sticks out of"
            " the body when the switch triggers.",
        ),
    )


if __name__ == "__main__":
    PICTURE.write_text(draw(EXAMPLE), encoding="utf-8", newline="\n")
