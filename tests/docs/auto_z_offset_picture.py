"""The picture of docs/auto_z_offset.md: two touches and Z=0, drawn to scale.

    python -m tests.docs.auto_z_offset_picture

writes it anew. Its numbers are those of the console example in the document.
"""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from tests.demo.picture import Drawing, Scale, mm
from tests.docs.pictures import (
    MINUS,
    begin,
    direction,
    formula,
    heading,
    level,
    nozzle,
)

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "auto_z_offset.svg"

# All lengths below are pixels, y down, unless their name says otherwise
WIDTH, HEIGHT = 1120, 850
SCALE = Scale(-0.32, 280.0)
ZERO = SCALE.y(0.0)
GROUND = SCALE.y(-0.52)  # where the bed ends
PANEL = (16, 60, WIDTH - 16, GROUND + 54)
COLUMNS = (120, 390, 696)
COLUMNS_END = 1080
# Within a column: the measured height, the tip, the probe, the second height,
# and how far the bed reaches
HEIGHT_X, TIP_X, PROBE_X, SECOND_X, BED_X = 30, 106, 176, 240, (66, 216)
HEAD_HEIGHT = 64  # from the nozzle's tip to the carriage
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
    drawing = begin(
        (title, f"{title}: two toolhead heights, in mm, to scale"),
        describe(touches),
        (WIDTH, HEIGHT),
        PANEL,
    )
    draw_axis(drawing)
    draw_sensor(drawing, touches)
    draw_probe(drawing, touches)
    draw_result(drawing, touches)
    draw_formula(drawing, touches)
    return drawing.text_of()


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


def draw_axis(drawing: Drawing) -> None:
    """Millimetres of toolhead Z, its zero and its sign."""
    for number in range(-2, 7):
        z = number / 5
        ends = (COLUMNS[0], COLUMNS_END)
        label = f"{z:.1f}".replace("-", MINUS) if number else "0"
        level(drawing, ends, SCALE.y(z), label, number == 0)
    drawing.text(
        "ink", (COLUMNS[0] + 156, ZERO - 7), "Z=0 as homed", font_weight=600
    )
    arrow = SCALE.y(1.1), SCALE.y(0.8)
    direction(drawing, PANEL[0] + 12, arrow, SCALE.y(0.45))


def draw_heading(drawing: Drawing, number: int, role: str, words: str) -> None:
    """Above a column: what touches what."""
    name = ("sensor", "probe", "result")[number - 1]
    at = COLUMNS[number - 1], PANEL[1] + 32
    heading(drawing, at, number, role, (name, words))


def draw_bed(
    drawing: Drawing, column: float, touches: Touches, pressed: bool
) -> None:
    """The bed with its sensor; pressed where the nozzle stands."""
    left, right = column + BED_X[0], column + BED_X[1]
    top, tip = SCALE.y(touches.bed), column + TIP_X
    lowest = SCALE.y(touches.sensor) if pressed else top
    surface = f"L{tip - 6:.2f} {lowest:.2f}L{tip + 6:.2f} {lowest:.2f}"
    drawing.add(
        "path",
        class_="f-bed",
        d=f"M{left:.2f} {top:.2f}{surface}L{right:.2f} {top:.2f}"
        f"V{GROUND:.2f}H{left:.2f}z",
    )
    drawing.add(
        "path",
        class_="s-ink",
        stroke_width=1.4,
        d=f"M{left:.2f} {top:.2f}{surface}L{right:.2f} {top:.2f}",
    )
    role = "nozzle" if pressed else "muted"
    drawing.box(role, (tip - 22, GROUND - 2, tip + 22, GROUND + 8), 3)
    drawing.text(
        "muted",
        (tip, GROUND + 26),
        "bed and its sensor",
        text_anchor="middle",
        font_size=12,
    )


def draw_head(drawing: Drawing, column: float, z: float, role: str) -> None:
    """Nozzle and probe on one carriage, the tip at a toolhead Z."""
    tip = SCALE.y(z)
    top, x = tip - HEAD_HEIGHT, column + PROBE_X
    face = tip - PROBE_ABOVE_TIP
    drawing.box("metal", (column + TIP_X - 34, top - 14, x + 26, top + 6), 5)
    drawing.box("body", (x - 18, top - 2, x + 18, face), 4)
    nozzle(drawing, column + TIP_X, tip, role)


def draw_height(drawing: Drawing, column: float, z: float, role: str) -> None:
    """A measured height: from homed zero to the nozzle's tip."""
    x, y = column + HEIGHT_X, SCALE.y(z)
    drawing.line(role, (x - 12, y, column + TIP_X - 8, y), 1.4, "5 4")
    drawing.dimension(role, x, (ZERO, y), mm(z), role_name(role))


def role_name(role: str) -> str:
    """What a colour stands for in this picture."""
    return {"nozzle": "sensor", "offset": "correction"}.get(role, role)


def draw_sensor(drawing: Drawing, touches: Touches) -> None:
    """The first column."""
    column = COLUMNS[0]
    draw_heading(drawing, 1, "nozzle", "the nozzle presses the bed")
    draw_bed(drawing, column, touches, pressed=True)
    draw_head(drawing, column, touches.sensor, "nozzle")
    draw_height(drawing, column, touches.sensor, "nozzle")


def draw_probe(drawing: Drawing, touches: Touches) -> None:
    """The second column."""
    column = COLUMNS[1]
    draw_heading(drawing, 2, "probe", "the probe triggers over the same point")
    draw_bed(drawing, column, touches, pressed=False)
    draw_head(drawing, column, touches.probe, "probe")
    tip, x = SCALE.y(touches.probe), column + PROBE_X
    face, bed = tip - PROBE_ABOVE_TIP, SCALE.y(touches.bed)
    for shift in (-12, 0, 12):
        drawing.line("probe", (x + shift, face, x + shift, bed), 1.2, "2 6")
    x, seen = column + SECOND_X, SCALE.y(touches.bed_by_probe)
    drawing.line("muted", (column + TIP_X + 8, tip, x + 12, tip))
    drawing.line("switch", (column + BED_X[0], seen, x + 12, seen), 1.4, "5 4")
    drawing.dimension(
        "switch", x, (tip, seen), mm(touches.probe_z_offset), "probe z_offset"
    )
    drawing.text(
        "switch",
        (column + BED_X[0] - 2, seen + 18),
        "the bed, says the probe",
        font_size=12,
        class_="halo",
    )
    draw_height(drawing, column, touches.probe, "probe")


def draw_result(drawing: Drawing, touches: Touches) -> None:
    """The third column."""
    column = COLUMNS[2]
    draw_heading(drawing, 3, "offset", "G-code Z=0 with the correction")
    draw_bed(drawing, column, touches, pressed=False)
    draw_head(drawing, column, touches.correction, "offset")
    tip, trigger = SCALE.y(touches.correction), SCALE.y(touches.sensor)
    first, second = column + SECOND_X + 20, column + SECOND_X + 104
    drawing.line("muted", (column + TIP_X + 8, tip, second + 12, tip))
    drawing.line(
        "nozzle", (column + BED_X[0], trigger, first + 12, trigger), 1.4, "5 4"
    )
    drawing.dimension(
        "switch_offset",
        first,
        (tip, trigger),
        mm(touches.z_offset),
        "z_offset",
    )
    bed = SCALE.y(touches.bed)
    drawing.line("muted", (column + BED_X[1], bed, second + 12, bed))
    drawing.dimension("gap", second, (tip, bed), mm(touches.gap), "true gap")
    draw_height(drawing, column, touches.correction, "offset")


def draw_formula(drawing: Drawing, touches: Touches) -> None:
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
    formula(
        drawing,
        (float(PANEL[0] + 4), float(PANEL[3] + 36)),
        parts,
        (
            "sensor and probe: where the head stands when the touch triggers."
            " correction: where it stands at G-code Z=0.",
            "The true gap is smaller than z_offset: the sensor triggers only"
            " after the nozzle has pressed the bed down a little.",
        ),
    )


if __name__ == "__main__":
    PICTURE.write_text(draw(EXAMPLE), encoding="utf-8", newline="\n")
