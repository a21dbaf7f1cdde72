"""The picture of docs/extra_probe.md: the membrane and Z=0, drawn to scale.

    python -m tests.docs.extra_probe_picture

writes it anew. Its numbers are those of the console example in the document.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tests.docs.pictures import (
    GROUND,
    MINUS,
    TIP_X,
    Page,
    Words,
    mm,
    scale_for,
)

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "extra_probe.svg"

# All lengths below are pixels, y down, unless their name says otherwise
WIDTH = 1040
COLUMNS = (96, 500, 984)
# Within a column: the bed, the membrane on it, and the arrow beside it
BED_X, SHEET_X, BESIDE_X = (60, 330), (62, 142), 200
# Beside the beds
ZERO_X = 760

MEANING = (
    "trigger: where the head stands when the membrane triggers. offset: where"
    " it stands when the nozzle meets the bed.",
    "z_offset: how thick the membrane is when it triggers, by its data sheet.",
)


class Touch(NamedTuple):
    """Toolhead Z in mm at which the membrane has triggered, its thickness."""

    trigger: float
    z_offset: float

    @property
    def offset(self) -> float:
        """Toolhead Z at which the nozzle meets the bed."""
        return self.trigger - self.z_offset


EXAMPLE = Touch(trigger=0.7, z_offset=0.25)


def draw(touch: Touch) -> str:
    """The picture as the text of an SVG file."""
    heading = "What EXTRA_PROBE_CALIBRATE measures: one toolhead height, in mm"
    words = Words(
        "What EXTRA_PROBE_CALIBRATE measures",
        heading + ", to scale",
        describe(touch),
    )
    scale = scale_for((0.0, touch.offset, touch.trigger))
    page = Page(words, WIDTH, scale, COLUMNS, ZERO_X)
    draw_touch(page, touch)
    draw_zero(page, touch)
    parts = (
        ("offset", "offset"),
        ("ink", " = "),
        ("probe", f"trigger {mm(touch.trigger)}"),
        ("ink", f" {MINUS} "),
        ("switch_offset", f"z_offset {mm(touch.z_offset)}"),
        ("ink", " = "),
        ("offset", f"{mm(touch.offset)} mm"),
    )
    page.formula(parts, MEANING)
    return page.text_of()


def describe(touch: Touch) -> str:
    """The picture in one sentence."""
    return (
        "The nozzle presses a membrane switch on the bed; the nozzle on the"
        f" bed. Toolhead Z, up is positive: trigger {mm(touch.trigger)},"
        f" z_offset {mm(touch.z_offset)}, offset {mm(touch.offset)} mm"
    )


def draw_bed(page: Page, column: float, touch: Touch) -> None:
    """The plate up to its surface."""
    left, right = (column + x for x in BED_X)
    bed = page.scale.y(touch.offset)
    page.box("bed", (left, bed, right, GROUND), 3)
    page.line("ink", (left, bed, right, bed), 1.4)
    page.caption(column + TIP_X, "bed")


def draw_touch(page: Page, touch: Touch) -> None:
    """The first column."""
    words = "the nozzle presses the membrane until it triggers"
    column = page.heading(1, "probe", "trigger", words)
    draw_bed(page, column, touch)
    top, bed = page.scale.y(touch.trigger), page.scale.y(touch.offset)
    left, right = (column + x for x in SHEET_X)
    page.box("switch", (left, top, right, bed), 2)
    look = {"font_size": 12, "font_weight": 600, "text_anchor": "middle"}
    middle = (top + bed) / 2 + 4.6
    page.text("panel", (column + TIP_X, middle), "membrane", **look)
    page.nozzle(column, touch.trigger, "nozzle")
    page.height(column, touch.trigger, "probe", "trigger")
    x = column + BESIDE_X
    page.line("muted", (right, top, x + 10, top))
    size = mm(touch.z_offset)
    page.dimension("switch_offset", x, (top, bed), size, "z_offset")


def draw_zero(page: Page, touch: Touch) -> None:
    """The second column."""
    words = "Z=0 has to go here"
    column = page.heading(2, "offset", "offset", words)
    draw_bed(page, column, touch)
    page.nozzle(column, touch.offset, "nozzle")
    page.height(column, touch.offset, "offset", "offset")


if __name__ == "__main__":
    PICTURE.write_text(draw(EXAMPLE), encoding="utf-8", newline="\n")
