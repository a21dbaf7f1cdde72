"""z_touch/z_calibration/settings.py: whether the owner's G-code homes."""

from __future__ import annotations

import pytest

from z_touch.z_calibration.settings import homes


@pytest.mark.parametrize(
    ("gcode", "macros", "expected"),
    [
        ("\n  g28 Z", {}, True),
        ("START", {"START": "{% if x %} G28 {% endif %}"}, True),
        ("START", {"START": "MORE", "MORE": "G28 X"}, True),
        # One that calls itself
        ("START", {"START": "MORE", "MORE": "START"}, False),
        ("ATTACH", {"ATTACH": "G0 X1", "OTHER": "G28"}, False),
        ("", {}, False),
    ],
)
def test_g28_is_found_also_in_macros(gcode, macros, expected):
    assert homes(gcode, macros) is expected
