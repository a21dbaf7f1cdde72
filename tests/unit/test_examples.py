"""What a look at all examples shows; each is used by tests/modules/*_examples.py."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from tests.modules.example_owners import OWNERS

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
# A section of ours in which SAVE_CONFIG writes what a command has found
SAVED = (
    r"(?m)^switch_xy_position:|^\[(?:auto_z_offset|dockable_probe)\]"
    r"|^\[extra_probe \w+\]"
)
FILES = {
    str(path.relative_to(EXAMPLES)): path.read_text(encoding="utf-8")
    for path in sorted(EXAMPLES.glob("*/*.cfg"))
}
TO_SAVE = [name for name, text in FILES.items() if re.search(SAVED, text)]
# With the pin and the probe of another example
SAME_MACHINE = {"with_z_calibration": "voron24_klicky"}
TOUCHING = [name for name, text in FILES.items() if "\nswitch_xy_" in text]


@pytest.mark.parametrize("name", TO_SAVE)
def test_what_is_saved_to_is_pasted(name):
    """SAVE_CONFIG does not write into an included file."""
    head = re.match(r"(?:#.*\n)+", FILES[name])
    assert head, "it begins with what to do"
    words = " ".join(head[0].replace("#", " ").split())
    assert re.search(
        "Paste this into printer.cfg"
        "|SAVE_CONFIG does not write into an included file",
        words,
    )


def test_they_are_found():
    assert len(TO_SAVE) >= 18
    assert len(TOUCHING) >= 7


def point(text: str, option: str) -> tuple[float, float]:
    """The value of an option, mm."""
    found = re.search(rf"(?m)^{option}: *([\d.]+), *([\d.]+)", text)
    assert found, option
    return float(found[1]), float(found[2])


@pytest.mark.parametrize("name", TOUCHING)
def test_body_is_over_the_pin_and_not_the_plunger(name):
    """The plunger stands beside the pin, along the body, which is 6 mm wide."""
    stem = Path(name).stem
    world = OWNERS[SAME_MACHINE.get(stem, stem)].scene.world
    probe, pin = world.mag_probe, world.pin
    assert probe is not None
    assert pin is not None
    head = point(FILES[name], "switch_xy_position")
    plunger = head[0] + probe.x_offset, head[1] + probe.y_offset
    assert 3.0 <= math.dist(plunger, (pin.x, pin.y)) <= 5.0
