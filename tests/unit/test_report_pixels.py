"""A report as programs show it: pixels, on light and on dark pages."""

from __future__ import annotations

import shutil
import struct
import subprocess
import xml.etree.ElementTree as ET
import zlib
from pathlib import Path
from typing import NamedTuple

import pytest

from tools.kit.runs import make_runs, read
from z_touch.report import picture as drawing
from z_touch.report import svg

SVG = "{http://www.w3.org/2000/svg}"
# Verdict, last run and offset are within so many lines of the picture
HEIGHT = 620


class Picture(NamedTuple):
    """What a program has drawn: rows of bytes, so many for a pixel."""

    rows: list[bytes]
    size: int

    def at(self, x, y):
        begin = round(x) * self.size
        return tuple(self.rows[round(y)][begin : begin + 3])

    def count(self, colour, box):
        """Pixels of a colour between two corners."""
        left, top, right, bottom = box
        return sum(
            is_like(self.at(x, y), colour)
            for y in range(top, bottom)
            for x in range(left, right)
        )


def paeth(left, up, corner):
    guess = left + up - corner
    apart = [abs(guess - value) for value in (left, up, corner)]
    return (left, up, corner)[apart.index(min(apart))]


def unfiltered(kind, row, above, size):
    """A row of pixels as it was before the filter of PNG's chapter 9."""
    for i, value in enumerate(row):
        left = row[i - size] if i >= size else 0
        corner = above[i - size] if i >= size else 0
        up = above[i]
        by = (0, left, up, (left + up) // 2)
        add = paeth(left, up, corner) if kind == 4 else by[kind]
        row[i] = (value + add) & 255
    return row


def read_png(data):
    """8 bits for each colour, not interlaced; its first rows."""
    assert data[:8] == b"\x89PNG\r\n\x1a\n"
    width, height, depth, kind, *_, interlaced = struct.unpack(
        ">IIBBBBB", data[16:29]
    )
    assert (depth, interlaced) == (8, 0)
    size, place, packed = {2: 3, 6: 4}[kind], 8, b""
    while place < len(data):
        (length,) = struct.unpack(">I", data[place : place + 4])
        if data[place + 4 : place + 8] == b"IDAT":
            packed += data[place + 8 : place + 8 + length]
        place += length + 12
    raw, rows = zlib.decompress(packed), []
    above, long = bytes(width * size), width * size + 1
    for number in range(min(HEIGHT, height)):
        kind, *row = raw[number * long : (number + 1) * long]
        above = bytes(unfiltered(kind, row, above, size))
        rows.append(above)
    return Picture(rows, size)


def rgb(colour):
    return tuple(bytes.fromhex(colour[1:]))


def is_like(pixel, colour):
    return all(abs(a - b) <= 24 for a, b in zip(pixel, rgb(colour)))


def rsvg(path, program, is_dark):
    return [program, path, "-o", path.with_suffix(".png")]


def chromium(path, program, is_dark):
    scheme = 0 if is_dark else 1
    return [
        program,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        f"--user-data-dir={path.parent / 'profile'}",
        f"--blink-settings=preferredColorScheme={scheme}",
        f"--window-size={svg.WIDTH},{HEIGHT}",
        f"--screenshot={path.with_suffix('.png')}",
        path.as_uri(),
    ]


@pytest.mark.parametrize(
    ("command", "name", "is_dark"),
    [
        pytest.param(rsvg, "rsvg-convert", False, id="rsvg-convert"),
        pytest.param(chromium, "chromium", False, id="chromium-light"),
        pytest.param(chromium, "chromium", True, id="chromium-dark"),
    ],
)
def test_report_is_seen(tmp_path, command, name, is_dark):
    program = shutil.which(name)
    if program is None:
        pytest.skip(f"there is no {name}")
    path = tmp_path / "report.svg"
    runs = make_runs(20)
    for number, run in enumerate(runs):
        run["offset"] += 0.001 * (number % 5)
    text = drawing.svg(read(runs))
    path.write_text(text)
    words = list(map(str, command(path, program, is_dark)))
    subprocess.run(words, check=True, capture_output=True, timeout=100)
    picture = read_png(Path(path.with_suffix(".png")).read_bytes())
    colours = {name: pair[is_dark] for name, *pair in svg.COLOURS}
    assert len(picture.rows) == HEIGHT
    # Page, headline, the word and the bar of the verdict
    for place in ((2, 2), (svg.WIDTH - 3, 2), (2, HEIGHT - 3)):
        assert is_like(picture.at(*place), colours["page"])
    assert picture.count(colours["ink"], (svg.EDGE, 5, 300, 30)) > 100
    assert picture.count(colours["good"], (svg.EDGE, 50, 100, 100)) > 300
    curve_is_there(picture, colours["a"], text)


def curve_is_there(picture, colour, text):
    lines = ET.fromstring(text).iter(f"{SVG}polyline")
    corners = [
        tuple(map(float, corner.split(",")))
        for corner in next(lines).get("points").split()
    ]
    assert len(corners) == 20
    for x, y in corners:
        assert is_like(picture.at(x - 0.5, y - 0.5), colour), (x, y)
    # Between two dots there is the line, which is thinner
    for (x, y), (next_x, next_y) in zip(corners, corners[1:]):
        x, y = (x + next_x) / 2, (y + next_y) / 2
        near = [picture.at(x, y + off) for off in (-1, 0, 1)]
        page = picture.at(x, y - 12)
        assert any(pixel != page for pixel in near)


def test_colours_need_no_style_sheet():
    """What has none of its own is black on transparent in some viewers."""
    text = drawing.svg(read(make_runs(20)))
    assert "var(" not in text
    root = ET.fromstring(text)
    parents = {child: parent for parent in root.iter() for child in parent}
    shapes = ("text", "path", "rect", "circle", "polyline", "polygon")
    drawn = [e for e in root.iter() if e.tag[len(SVG) :] in shapes]
    assert len(drawn) > 100
    for element in drawn:
        holder = element if element.get("class") else parents[element]
        kind, _, name = holder.get("class").partition("-")
        attribute = {"f": "fill", "s": "stroke"}[kind]
        assert holder.get(attribute) == svg.LIGHT[name]
        # An open path is filled with black otherwise
        assert kind == "f" or holder.get("fill") == "none"
        assert f".{kind}-{name}{{{attribute}:#" in text
