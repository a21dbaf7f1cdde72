"""z_touch/z_pin.py: where the pin is, by the sections that tell of it."""

from __future__ import annotations

from types import SimpleNamespace

import pytest

from z_touch import pin as z_pin
from z_touch.z_calibration import settings

Z_AXIS = SimpleNamespace(endstop_pin="PG10", position_endstop=1.6)
HOME = {"safe_z_home": {"home_xy_position": "7, 8"}}


class Section:
    """As much of a host's section as is read here, as one of somebody else."""

    error = ValueError

    def __init__(self, name, given):
        self.name = name
        self.given = given

    def get_name(self):
        return self.name

    def get_prefix_options(self, prefix):
        return [name for name in self.given if name.startswith(prefix)]

    def get(self, name, default=None, note_valid=True):
        assert not note_valid, "what is wrong there would not be told"
        return self.given.get(name, default)

    def getfloat(self, name, default=None, note_valid=True):
        value = self.get(name, default, note_valid)
        return float(value) if name in self.given else value

    def getfloatlist(self, name, default=None, count=None, note_valid=True):
        value = self.get(name, default, note_valid)
        if name not in self.given:
            return value
        values = tuple(map(float, value.split(",")))
        assert len(values) == count
        return values


class Config:
    """All sections of a printer."""

    def __init__(self, sections):
        self.sections = sections

    def has_section(self, name):
        return name in self.sections

    def getsection(self, name):
        return Section(name, self.sections[name])


def pin_of(given, **more):
    sections = {"z_calibration": given, **HOME, **more}
    return z_pin.read_pin(Config(sections), Z_AXIS)


@pytest.mark.parametrize(
    ("given", "point"),
    [
        ({"nozzle_xy_position": "1, 2"}, (1.0, 2.0)),
        ({"probe_nozzle_x": "3", "probe_nozzle_y": "4"}, (3.0, 4.0)),
        ({}, (7.0, 8.0)),
    ],
)
def test_the_pin_is_where_z_calibration_has_it(given, point):
    assert pin_of(given) == (*point, 1.6)


@pytest.mark.parametrize("name", ["endstop_pin", "calibration_endstop_pin"])
def test_another_pin_is_not_the_one_that_z_is_homed_on(name):
    """Nobody knows yet how high it is."""
    assert pin_of({"nozzle_xy_position": "1, 2", name: "^PG11"}) is None
    assert pin_of({"nozzle_xy_position": "1, 2", name: " "}) is not None


def test_half_a_point_is_refused():
    with pytest.raises(ValueError, match="only one of 'probe_nozzle_x'"):
        pin_of({"probe_nozzle_x": "3"})


def test_the_rows_are_those_of_the_section():
    """Another one under the same name would be read in another way."""
    for row in (z_pin.NOZZLE_POSITION, z_pin.ENDSTOP_PIN):
        assert [r for r in settings.OPTIONS if r.name == row.name] == [row]
