"""What is seen in the text of the user's G-code."""

from __future__ import annotations

import pytest

from z_touch.z_calibration import hooks


class TestHoming:
    @pytest.mark.parametrize(
        ("gcode", "macros", "homes"),
        [
            ("G28", {}, True),
            ("\n  g28 Z", {}, True),
            ("START", {"START": "{% if x %} G28 {% endif %}"}, True),
            ("START", {"START": "MORE", "MORE": "G28 X"}, True),
            ("START", {"START": "MORE", "MORE": "START"}, False),
            ("ATTACH", {"ATTACH": "G0 X1", "OTHER": "G28"}, False),
            ("", {}, False),
        ],
    )
    def test_g28_is_found_also_in_macros(self, gcode, macros, homes):
        assert hooks.homes(gcode, macros) is homes
