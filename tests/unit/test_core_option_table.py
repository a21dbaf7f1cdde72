"""z_touch/options.py: rows of a table, and what is read by them."""

from __future__ import annotations

import pytest

from z_touch import options
from z_touch.options import option
from z_touch.sampling import filled


class Config:
    """As much of a host's section as a table reads."""

    error = ValueError

    def __init__(self, **given):
        self.given = given

    def get_name(self):
        return "mine"

    def get_prefix_options(self, prefix):
        return [name for name in self.given if name.startswith(prefix)]

    def get(self, name, *default):
        if name in self.given:
            return self.given[name]
        if not default:
            raise ValueError(f"Option '{name}' in section 'mine' must be given")
        return default[0]

    def getint(self, name, *default, minval=None, maxval=None):
        value = self.get(name, *default)
        if name in self.given and minval is not None and int(value) < minval:
            raise ValueError(f"Option '{name}' must have minimum of {minval}")
        return int(value) if name in self.given else value

    def getfloat(self, name, *default, minval=None, above=None):
        value = self.get(name, *default)
        return float(value) if name in self.given else value

    def getboolean(self, name, *default):
        return self.get(name, *default)

    def getchoice(self, name, choices, *default):
        return choices[self.get(name, *default)]


ROWS = (
    option("touches", options.COUNT, 3, "", "How many.", minval=1),
    option("height", options.NUMBER, None, "mm", "How high.", old=("z",)),
    option("word", options.choice({"one": 1, "two": 2}), "two", "", "Which."),
)


def test_what_is_left_out_is_the_default():
    assert options.read(Config(), ROWS) == {
        "touches": 3,
        "height": None,
        "word": 2,
    }


def test_defaults_of_another_section():
    assert options.read(Config(), ROWS, touches=7)["touches"] == 7
    assert options.read(Config(touches="4"), ROWS, touches=7)["touches"] == 4


def test_old_name_is_read_and_told():
    config = Config(z="1.5")
    old_names = options.OldNames(config)
    assert options.read(config, ROWS, old_names)["height"] == 1.5
    assert old_names.notes == ["option 'z' is now called 'height'"]


def test_limits_of_a_row_are_the_hosts():
    with pytest.raises(ValueError, match="minimum of 1"):
        options.read(Config(touches="0"), ROWS)


def test_unused_options_are_told_where_they_are_given():
    rows = (
        options.unused("old", "is ignored"),
        options.unused("older", "is not run"),
        options.unused("oldest", "is forgotten"),
    )
    given = options.read(Config(older="M117", oldest=""), rows)
    assert options.unused_notes(given, rows) == ["option 'older' is not run"]


def test_options_that_are_wrong_here_are_refused():
    rows = (options.refused("wrong", "is not needed; remove it"),)
    assert options.read(Config(), rows) == {"wrong": None}
    text = "^Option 'wrong' in section 'mine' is not needed; remove it$"
    with pytest.raises(ValueError, match=text):
        options.read(Config(wrong="0"), rows)


@pytest.mark.parametrize(("touches", "height"), [("0", 1.5), ("2", 2.5)])
def test_a_default_may_come_of_an_option_above(touches, height):
    default = options.Given("touches", 2.5, 1.5)
    rows = (
        option("touches", options.COUNT, 0, "", "How many."),
        option("height", options.NUMBER, default, "mm", "How high."),
    )
    given = Config(touches=touches)
    assert options.read(given, rows)["height"] == height
    given = Config(touches=touches, height="7")
    assert options.read(given, rows)["height"] == 7.0


def test_record_has_the_options_by_their_names():
    made = options.record("Settings", ROWS, also="bed floor")
    assert made._fields == ("touches", "height", "word", "bed", "floor")


def test_sampling_of_a_table():
    values = options.read(Config(speed="4"), options.PROBE_OPTIONS)
    sampling = options.sampling_of(values)
    # As fast up as down, where nothing else is given
    assert (sampling.speed, sampling.lift_speed) == (4.0, 4.0)
    assert (sampling.samples, sampling.tolerance) == (1, 0.1)
    # What is left open is as in another one
    left = sampling._replace(speed=None, samples=None, retries=2)
    assert filled(left, sampling) == sampling._replace(retries=2)


@pytest.mark.parametrize(
    ("limits", "outside"),
    [
        ({"minval": 1}, "0"),
        ({"above": 0.0}, "0"),
        ({"maxval": 2.5}, "3.5"),
        ({"below": 4}, "4"),
    ],
)
def test_nonsense_is_outside_the_limits(limits, outside):
    row = option("a", options.NUMBER, None, "mm", "Any.", **limits)
    assert outside in options.nonsense(row)
    assert set(options.NUMBER.nonsense) < set(options.nonsense(row))
