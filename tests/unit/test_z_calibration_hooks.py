"""What is seen in the text of the user's G-code."""

from __future__ import annotations

import pytest

from z_touch.z_calibration import hooks
from z_touch.z_calibration.hooks import attaches_probe

MACROS = ["ATTACH_PROBE", "_G0"]


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


class TestAttachesProbe:
    @pytest.mark.parametrize(
        "before",
        [
            "ATTACH_PROBE",
            "attach_probe",
            "\n  G90\n  Attach_Probe;now\n  M400",
            "{% if x %} ATTACH_PROBE X=1 {% endif %}",
            "_g0",
            "SET_SERVO SERVO=arm ANGLE=90",
            "set_pin PIN=magnet VALUE=1",
        ],
    )
    def test_macros_servos_and_pins_do(self, before):
        for start in ("", "G28", "G28\n" + before):
            assert attaches_probe(before, start, MACROS) is True
        # What has been done already
        start = "\n " + before.lower().replace(" ", "  ") + "\n"
        assert attaches_probe(before, start, MACROS) is False

    @pytest.mark.parametrize(
        "before",
        [
            *("", " \n \n", "G0 X1", "G90\n  G1 Z20 F900\n  M400"),
            *("M117 ATTACH_PROBE", "; ATTACH_PROBE", "G1 X1 ; ATTACH_PROBE"),
            "{% set m = 'ATTACH_PROBE' %}\n{% if m %} G28 Z {% endif %}",
        ],
    )
    def test_nothing_else_does(self, before):
        assert attaches_probe(before, "", MACROS) is False

    def test_kalico_has_a_command_for_it(self):
        assert attaches_probe("ATTACH_PROBE", "", []) is True
