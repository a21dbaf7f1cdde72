"""The picture of docs/auto_z_offset.md: two touches and Z=0, drawn to scale.

    python -m tests.docs.auto_z_offset_picture

writes it anew. Its numbers are those of the console example in the document.
"""

from __future__ import annotations

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
)

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "auto_z_offset.svg"

# All lengths below are pixels, y down, unless their name says otherwise
WIDTH = 1120
COLUMNS = (120, 390, 696, 1080)
# Within a column: the probe, the second height, and how far the bed reaches
PROBE_X, SECOND_X, BED_X = 172, 240, (62, 212)
PROBE_ABOVE_TIP = 42  # how far its face is above the tip


class Touches(NamedTuple):
    """What a cycle has measured and was given, mm; z is toolhead Z."""

    sensor: float
    probe: float
    probe_z_offset: float
    z_offset: float
    # How far the nozzle presses the bed down until the sensor triggers: known
    # for the simulated printer, and to nobody else
    press_depth: float

    @property
    def bed_by_probe(self) -> float:
        """Where the probe says that the bed is."""
        return self.probe - self.probe_z_offset

    @property
    def correction(self) -> float:
        """Toolhead Z of G-code Z=0."""
        return self.sensor - self.bed_by_probe + self.z_offset

    @property
    def bed(self) -> float:
        """Where the bed is while nothing presses it."""
        return self.sensor + self.press_depth

    @property
    def gap(self) -> float:
        """What is left between nozzle and bed at G-code Z=0."""
        return self.z_offset - self.press_depth


EXAMPLE = Touches(
    sensor=-0.32,
    probe=1.0,
    probe_z_offset=1.0,
    z_offset=0.2,
    press_depth=0.05,
)


def draw(touches: Touches) -> str:
    """The picture as the text of an SVG file."""
    title = "What AUTO_Z_CALIBRATE measures"
    heading = f"{title}: two toolhead heights, in mm, to scale"
    words = Words(title, heading, describe(touches))
    levels = (0.0, touches.sensor, touches.probe, touches.correction)
    page = Page(words, WIDTH, scale_for(levels), COLUMNS)
    draw_sensor(page, touches)
    draw_probe(page, touches)
    draw_result(page, touches)
    draw_formula(page, touches)
    return page.text_of()


def describe(touches: Touches) -> str:
    """The picture in one sentence."""
    return (
        "The nozzle presses the bed, the probe triggers above the same point,"
        " the nozzle at Z=0. Toolhead Z, up is positive:"
        f" sensor {mm(touches.sensor)}, probe {mm(touches.probe)},"
        f" probe z_offset {mm(touches.probe_z_offset)},"
        f" z_offset {mm(touches.z_offset)},"
        f" correction {mm(touches.correction)} mm; true gap {mm(touches.gap)}"
    )


def draw_bed(
    page: Page, column: float, touches: Touches, pressed: bool = False
) -> None:
    """The bed with its sensor; pressed where the nozzle stands."""
    left, right = column + BED_X[0], column + BED_X[1]
    top, tip = page.scale.y(touches.bed), column + TIP_X
    lowest = page.scale.y(touches.sensor) if pressed else top
    surface = f"M{left:.2f} {top:.2f}L{tip - 6:.2f} {lowest:.2f}"
    surface += f"L{tip + 6:.2f} {lowest:.2f}L{right:.2f} {top:.2f}"
    page.add("path", class_="f-bed", d=f"{surface}V{GROUND}H{left:.2f}z")
    page.add("path", class_="s-ink", stroke_width=1.4, d=surface)
    role = "nozzle" if pressed else "muted"
    page.box(role, (tip - 22, GROUND - 2, tip + 22, GROUND + 8), 3)
    page.caption(tip, "bed and its sensor")


def draw_head(page: Page, column: float, z: float, role: str) -> None:
    """Nozzle and probe on one carriage, the tip at a toolhead Z."""
    tip, x = page.scale.y(z), column + PROBE_X
    top = tip - HEAD_HEIGHT
    page.box("metal", (column + TIP_X - 34, top - 14, x + 26, top + 6), 5)
    page.box("body", (x - 18, top - 2, x + 18, tip - PROBE_ABOVE_TIP), 4)
    page.nozzle(column, z, role)


def draw_sensor(page: Page, touches: Touches) -> None:
    """The first column."""
    column = page.heading(1, "nozzle", "sensor", "the nozzle presses the bed")
    draw_bed(page, column, touches, pressed=True)
    draw_head(page, column, touches.sensor, "nozzle")
    page.height(column, touches.sensor, "nozzle", "sensor")


def draw_probe(page: Page, touches: Touches) -> None:
    """The second column."""
    words = "the probe triggers over the same point"
    column = page.heading(2, "probe", "probe", words)
    draw_bed(page, column, touches)
    draw_head(page, column, touches.probe, "probe")
    tip, x = page.scale.y(touches.probe), column + PROBE_X
    face, bed = tip - PROBE_ABOVE_TIP, page.scale.y(touches.bed)
    for shift in (-12, 0, 12):
        page.line("probe", (x + shift, face, x + shift, bed), 1.2, "2 6")
    left, x = column + BED_X[0], column + SECOND_X
    seen, z_offset = page.scale.y(touches.bed_by_probe), touches.probe_z_offset
    page.line("muted", (column + TIP_X + 8, tip, x + 12, tip))
    page.line("switch", (left, seen, x + 12, seen), 1.4, "5 4")
    page.dimension("switch", x, (tip, seen), mm(z_offset), "probe z_offset")
    look = {"font_size": 12, "class_": "halo"}
    page.text(
        "switch", (left - 2, seen + 18), "the bed, says the probe", **look
    )
    page.height(column, touches.probe, "probe", "probe")


def draw_result(page: Page, touches: Touches) -> None:
    """The third column."""
    words = "G-code Z=0 with the correction"
    column = page.heading(3, "offset", "result", words)
    draw_bed(page, column, touches)
    draw_head(page, column, touches.correction, "offset")
    levels = (touches.correction, touches.sensor, touches.bed)
    tip, trigger, bed = map(page.scale.y, levels)
    first, second = column + SECOND_X + 20, column + SECOND_X + 104
    left, right = column + BED_X[0], column + BED_X[1]
    page.line("muted", (column + TIP_X + 8, tip, second + 12, tip))
    page.line("nozzle", (left, trigger, first + 12, trigger), 1.4, "5 4")
    z_offset, gap = mm(touches.z_offset), mm(touches.gap)
    page.dimension("switch_offset", first, (tip, trigger), z_offset, "z_offset")
    page.line("muted", (right, bed, second + 12, bed))
    page.dimension("gap", second, (tip, bed), gap, "true gap")
    page.height(column, touches.correction, "offset", "correction")


def draw_formula(page: Page, touches: Touches) -> None:
    """The formula with the numbers above, and what they mean."""
    parts = (
        ("offset", "correction"),
        ("ink", " = "),
        ("nozzle", f"sensor {mm(touches.sensor)}"),
        ("ink", f" {MINUS} ("),
        ("probe", f"probe {mm(touches.probe)}"),
        ("ink", f" {MINUS} "),
        ("switch", f"probe z_offset {mm(touches.probe_z_offset)}"),
        ("ink", ") + "),
        ("switch_offset", f"z_offset {mm(touches.z_offset)}"),
        ("ink", " = "),
        ("offset", f"{mm(touches.correction)} mm"),
    )
    lines = (
        "sensor and probe: where the head stands when the touch triggers."
        " correction: where it stands at G-code Z=0.",
        "The true gap is smaller than z_offset: the sensor triggers only"
        " after the nozzle has pressed the bed down a little.",
    )
    page.formula(parts, lines)


if __name__ == "__main__":
    PICTURE.write_text(draw(EXAMPLE), encoding="utf-8", newline="\n")
