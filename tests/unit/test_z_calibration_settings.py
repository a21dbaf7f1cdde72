"""The table of options, and what the probe and the axes decide of the settings."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from tests.unit.calibrated import make_sampling, make_settings
from z_touch.core.sampling import AUTO, Sampling
from z_touch.uncertainty import adaptive
from z_touch.z_calibration import accuracy
from z_touch.z_calibration.heights import travel_height
from z_touch.z_calibration.settings import (
    OPTIONS,
    SAMPLING,
    Settings,
    complete,
)

TESTS = Path(__file__).resolve().parents[1] / "modules"


@pytest.mark.parametrize("row", OPTIONS, ids=lambda row: row.name)
def test_option_has_a_test_of_its_own(row):
    """On a real host, where it can be ignored."""
    tests = TESTS.glob("test_z_calibration_*.py")
    name = re.compile(rf"\b{row.name}\b")
    assert any(name.search(path.read_text("utf-8")) for path in tests), (
        f"{row.name} is in none of tests/modules/test_z_calibration_*.py"
    )


@pytest.mark.parametrize("row", OPTIONS, ids=lambda row: row.name)
def test_option_is_a_field_of_the_settings_or_of_a_sampling(row):
    assert (row.name in Settings._fields) != (row.name in SAMPLING)
    assert row.text.endswith(".")


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
        open_ends = settings._replace(
            probe=left_open, z_offset=None, position_max=None
        )
        return complete(open_ends, PROBE, z_offset, 250.0)

    def test_what_is_set_stays(self):
        chosen = make_settings(safe_z_height=4.0)
        assert self.complete(chosen) == chosen._replace(
            probe=PROBE, z_offset=6.5, position_max=250.0
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
        settings = make_settings(pin=make_sampling(**{name: None}))
        filled = make_sampling(**{name: getattr(PROBE, name)})
        assert self.complete(settings).pin == filled

    def test_the_bed_keeps_what_the_section_says(self):
        given = Sampling(*[None] * 7)._replace(samples=4)
        settings = make_settings()._replace(probe=given)
        found = complete(settings, PROBE, 6.5, 250.0).probe
        assert found == PROBE._replace(samples=4)

    def test_the_probe_may_fill_everything(self):
        nothing = Sampling(*[None] * len(Sampling._fields))
        assert self.complete(make_settings(pin=nothing)).pin == PROBE

    @pytest.mark.parametrize("name", ["tolerance", "retries"])
    def test_zero_is_a_setting(self, name):
        pin = make_sampling(**{name: 0})
        assert self.complete(make_settings(pin=pin)).pin == pin

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


@pytest.mark.parametrize(("samples", "taken"), [(AUTO, 3), (1, 3), (4, 4)])
def test_touches_of_a_cycle_are_enough_to_vary(samples, taken):
    settings = make_settings(counting=adaptive.choose(samples, 0.008))
    # With samples: auto the count of [probe] is nobody's
    count = settings.counting.count or 7
    settings = settings._replace(
        pin=make_sampling(samples=count), probe=make_sampling(samples=count)
    )
    found = accuracy.for_cycles(settings)
    assert (
        found.pin
        == found.probe
        == settings.pin._replace(
            samples=taken, tolerance=math.inf, result="average"
        )
    )
    assert found.counting.for_spread(found.pin) == taken
