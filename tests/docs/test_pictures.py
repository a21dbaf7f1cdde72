"""The pictures of the documents: for light and dark pages, and harmless."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest

from tests.docs.pictures import DOCS, MINUS, PICTURES, SVG, numbers

each_picture = pytest.mark.parametrize("path", PICTURES, ids=lambda p: p.stem)


@each_picture
def test_picture_is_for_light_and_dark_pages_and_harmless(path):
    text = path.read_text(encoding="utf-8")
    assert re.search(r"@media ?\(prefers-color-scheme: ?dark\)", text)
    for element in ET.fromstring(text).iter():
        assert element.tag != f"{SVG}script"
        assert not any(name.startswith("on") for name in element.keys())  # noqa: SIM118
    assert re.findall("@import|href|url|src", text) == []
    assert set(re.findall(r"https?:[^\s\"']+", text)) == {SVG[1:-1]}


@pytest.mark.parametrize("name", ["z_calibration", "auto_z_offset"])
def test_numbers_of_the_description_are_those_drawn(name):
    drawn = {
        "".join(element.itertext())
        for element in ET.parse(DOCS / f"{name}.svg").iter(f"{SVG}text")
    }
    found = numbers(name)
    assert len(found) >= 5
    for value in found.values():
        assert f"{value:.3f}".replace("-", MINUS) in drawn
