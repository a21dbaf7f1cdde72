"""Pictures: nothing in them covers anything else, whatever was measured."""

from __future__ import annotations

import xml.etree.ElementTree as ET

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.docs import auto_z_offset_picture, z_calibration_picture
from tests.docs.pictures import scale_for, spread, tick_step
from tests.docs.records import MODULES
from tests.docs.z_calibration_picture import Touches

SVG = "{http://www.w3.org/2000/svg}"
PICTURES = {
    "z_calibration": z_calibration_picture.EXAMPLE,
    "auto_z_offset": auto_z_offset_picture.EXAMPLE,
    "voron": Touches(1.6, 8.015, 7.015, 0.44),
    "cartesian": Touches(0.5, 1.78, 1.99, 0.65),
    "negative offset": Touches(0.0, 6.4, 6.1, 0.5),
    "nothing to do": Touches(-0.5, 3.4, 4.3, 0.4),
}


@pytest.mark.parametrize("module", MODULES, ids=lambda module: module.name)
def test_picture_is_what_the_script_draws(module):
    draw, example = module.picture.draw, module.picture.EXAMPLE
    assert module.picture.PICTURE.read_text(encoding="utf-8") == draw(example)
    assert draw(example) != draw(example._replace(probe=example.probe + 0.1))
    assert "prefers-color-scheme:dark" in draw(example)


def text_boxes(root: ET.Element) -> list[tuple[str, tuple[float, ...]]]:
    """Each text with the room it takes, a little generously."""
    boxes = []
    for element in root.iter(f"{SVG}text"):
        if "transform" in element.attrib:
            continue  # beside the axis is a strip of its own
        words = "".join(element.itertext())
        size = float(element.get("font-size", "0"))
        width = 0.6 * size * len(words)
        shift = {"middle": 0.5, "end": 1.0}.get(element.get("text-anchor"), 0)
        left = float(element.get("x")) - shift * width
        y = float(element.get("y"))
        boxes.append((words, (left, y - 0.75 * size, left + width, y)))
    return boxes


@pytest.mark.parametrize("name", PICTURES)
def test_no_text_covers_another_or_leaves_the_picture(name):
    is_auto = name == "auto_z_offset"
    module = auto_z_offset_picture if is_auto else z_calibration_picture
    root = ET.fromstring(module.draw(PICTURES[name]))
    boxes = text_boxes(root)
    for index, (words, (left, top, right, bottom)) in enumerate(boxes):
        assert left >= 0 and right <= float(root.get("width")), words
        assert top >= 0 and bottom <= float(root.get("height")), words
        for other, (left_2, top_2, right_2, bottom_2) in boxes[index + 1 :]:
            beside = right <= left_2 or right_2 <= left
            assert beside or bottom <= top_2 or bottom_2 <= top, (words, other)


def test_scale_keeps_all_levels_on_the_page():
    scale = scale_for((0.0, -0.3, 8.0))
    assert scale.y(-0.3) > scale.y(0.0) > scale.y(8.0)
    assert scale.z(scale.y(1.25)) == pytest.approx(1.25)


@given(st.floats(0.5, 1e5))
def test_ticks_are_round_and_not_too_close(per_mm):
    step = tick_step(per_mm, 34.0)
    assert 34.0 <= step * per_mm * (1 + 1e-9) <= 34.0 * 2.6
    assert f"{step:.0e}"[0] in "125"


@given(st.lists(st.floats(-500, 500), min_size=1, max_size=4))
def test_places_are_spread_in_their_order(places):
    found = spread(places, 20.0)
    order = sorted(range(len(places)), key=lambda index: places[index])
    for first, second in zip(order, order[1:]):
        assert found[second] - found[first] >= 20.0 - 1e-6
    roomy = [place * 20.0 for place in range(len(places))]
    assert spread(roomy, 20.0) == roomy
