"""Pictures: nothing in them covers anything else, whatever was measured."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.docs import (
    auto_z_offset_picture,
    extra_probe_picture,
    report_pictures,
    switch_position_picture,
    z_calibration_picture,
)
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


@pytest.mark.parametrize(
    "path", report_pictures.PICTURES, ids=lambda path: path.stem
)
def test_report_is_what_the_module_draws(path):
    draw = report_pictures.PICTURES[path]
    assert path.read_text(encoding="utf-8") == draw()


def text_boxes(
    elements: Iterable[ET.Element],
) -> list[tuple[str, tuple[float, ...]]]:
    """Each text with the room it takes, a little generously."""
    boxes = []
    for element in elements:
        # Beside the axis is a strip of its own
        if element.tag != f"{SVG}text" or "transform" in element.attrib:
            continue
        words = "".join(element.itertext())
        size = float(element.get("font-size", "0"))
        width = 0.6 * size * len(words)
        shift = {"middle": 0.5, "end": 1.0}.get(element.get("text-anchor"), 0)
        left = float(element.get("x")) - shift * width
        y = float(element.get("y"))
        boxes.append((words, (left, y - 0.75 * size, left + width, y)))
    return boxes


def covers(box: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Whether two boxes (left, top, right, bottom) have something in common."""
    beside = box[2] <= other[0] or other[2] <= box[0]
    return not (beside or box[3] <= other[1] or other[3] <= box[1])


def assert_readable(root: ET.Element) -> None:
    """Each text is on the page; no text and nothing drawn later is on it."""
    boxes = text_boxes(root)
    for index, (words, box) in enumerate(boxes):
        assert box[0] >= 0 and box[2] <= float(root.get("width")), words
        assert box[1] >= 0 and box[3] <= float(root.get("height")), words
        for other, other_box in boxes[index + 1 :]:
            assert not covers(box, other_box), (words, other)
    drawn = list(root)
    for index, element in enumerate(drawn):
        if element.tag != f"{SVG}text" or "transform" in element.attrib:
            continue
        for later in drawn[index + 1 :]:
            if later.tag == f"{SVG}rect":
                left, top, width, height = (
                    float(later.get(name))
                    for name in ("x", "y", "width", "height")
                )
                rectangle = left, top, left + width, top + height
                ((words, box),) = text_boxes([element])
                assert not covers(box, rectangle), words


@pytest.mark.parametrize("name", PICTURES)
def test_no_text_is_covered_or_leaves_the_picture(name):
    is_auto = name == "auto_z_offset"
    module = auto_z_offset_picture if is_auto else z_calibration_picture
    assert_readable(ET.fromstring(module.draw(PICTURES[name])))


@pytest.mark.parametrize("trigger", [0.7, -0.3, 0.25, 2.0])
@pytest.mark.parametrize("z_offset", [0.25, 1.0])
def test_no_text_about_a_membrane_is_covered(trigger, z_offset):
    touch = extra_probe_picture.Touch(trigger, z_offset)
    assert_readable(ET.fromstring(extra_probe_picture.draw(touch)))


def test_picture_of_the_membrane_is_what_the_script_draws():
    draw, example = extra_probe_picture.draw, extra_probe_picture.EXAMPLE
    picture = extra_probe_picture.PICTURE.read_text(encoding="utf-8")
    assert picture == draw(example)
    assert draw(example) != draw(example._replace(z_offset=0.3))


def test_picture_of_the_switch_is_what_the_script_draws():
    text = switch_position_picture.draw()
    picture = switch_position_picture.PICTURE.read_text(encoding="utf-8")
    assert picture == text
    assert_readable(ET.fromstring(text))


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
