"""The table of options, and what the probe and the axes decide of the settings."""

from __future__ import annotations

import math

import pytest

from tests.unit.calibrated import make_sampling, make_settings
from z_touch.sampling import AUTO, Sampling
from z_touch.z_calibration import accuracy
from z_touch.z_calibration.heights import travel_height
from z_touch.z_calibration.settings import (
    complete,
    homes,
)

# No two values alike, none as the pin has it
PROBE = Sampling(
    samples=5,
    tolerance=0.1,
    retries=2,
    result="average",
    speed=7.0,
    retract_dist=8.0,
    lift_speed=9.0,
)


class TestComplete:
    def complete(self, settings, z_offset=6.5):
        left_open = Sampling(*[None] * 7)
        open_ends = settings.replace(
            on_bed=left_open, z_offset=None, position_max=None
        )
        return complete(open_ends, PROBE, z_offset, 250.0)

    def test_what_is_set_stays(self):
        chosen = make_settings(safe_z_height=4.0)
        assert self.complete(chosen) == chosen.replace(
            on_bed=PROBE, z_offset=6.5, position_max=250.0
        )

    @pytest.mark.parametrize(
        ("changes", "pin", "height"),
        [
            ({}, 10.0, 21.0),
            ({"safe_z_height": 15.0}, 0.0, 15.0),
            ({"position_endstop": 0.5}, 0.0, 13.0),
        ],
    )
    def test_a_pin_that_nobody_has_measured(self, changes, pin, height):
        left_open = {"safe_z_height": None, "position_endstop": None}
        settings = make_settings(**{**left_open, **changes})
        found = self.complete(settings)
        assert found.unmeasured_pin == pin
        assert travel_height(found, None, None) == height
        # Once it is known
        assert travel_height(found, 0.5, None) == max(height - pin, 13.0)

    @pytest.mark.parametrize("name", Sampling._fields)
    def test_the_probe_fills_what_is_open_and_only_that(self, name):
        settings = make_settings(on_pin=make_sampling(**{name: None}))
        filled = make_sampling(**{name: getattr(PROBE, name)})
        assert self.complete(settings).on_pin == filled

    def test_the_bed_keeps_what_the_section_says(self):
        given = Sampling(*[None] * 7)._replace(samples=4)
        settings = make_settings().replace(on_bed=given)
        found = complete(settings, PROBE, 6.5, 250.0).on_bed
        assert found == PROBE._replace(samples=4)

    def test_the_probe_may_fill_everything(self):
        nothing = Sampling(*[None] * len(Sampling._fields))
        assert self.complete(make_settings(on_pin=nothing)).on_pin == PROBE

    @pytest.mark.parametrize("name", ["tolerance", "retries"])
    def test_zero_is_a_setting(self, name):
        pin = make_sampling(**{name: 0})
        assert self.complete(make_settings(on_pin=pin)).on_pin == pin

    @pytest.mark.parametrize(
        ("safe_z", "z_offset", "completed"),
        [
            (None, 6.5, 13.0),
            (None, 1.0, 20.0),
            (0.5, 6.5, 0.5),
            (4.0, 9.0, 4.0),
        ],
    )
    def test_the_travel_height(self, safe_z, z_offset, completed):
        settings = make_settings(safe_z_height=safe_z)
        found = self.complete(settings, z_offset)
        assert (found.safe_z_height, found.z_offset) == (completed, z_offset)


@pytest.mark.parametrize(
    ("samples", "count", "taken"), [(AUTO, 7, 3), (1, 1, 3), (None, 4, 4)]
)
def test_touches_of_a_cycle_are_enough_to_vary(samples, count, taken):
    sampling = make_sampling(samples=count)
    settings = make_settings(samples=samples, on_pin=sampling, on_bed=sampling)
    found = accuracy.of_cycles(settings)
    assert not found.is_auto
    assert (
        found.on_pin
        == found.on_bed
        == sampling._replace(
            samples=taken, tolerance=math.inf, result="average"
        )
    )


@pytest.mark.parametrize(
    ("gcode", "macros", "expected"),
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
def test_g28_is_found_also_in_macros(gcode, macros, expected):
    assert homes(gcode, macros) is expected
