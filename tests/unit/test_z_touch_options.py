"""z_touch/options.py: margins, numbers and text for the user's G-code."""

from __future__ import annotations

import math
import shlex

import pytest
from hypothesis import given
from hypothesis import strategies as st

from z_touch.errors import CalibrationError
from z_touch.options import (
    REQUIRED,
    TEXT,
    Kind,
    Same,
    option,
    read,
    read_margins,
)
from z_touch.templates import as_param

numbers = st.integers(-640, 640).map(lambda steps: steps / 64)


class Config:
    """As much of a host's section as margins() reads."""

    error = ValueError

    def __init__(self, *values):
        self.values = values or None

    def get_name(self):
        return "mine"

    def getfloatlist(self, _name, _default):
        return self.values


def margins_of(*values):
    return read_margins(Config(*values), "offset_margins", (-3.0, 4.0))


def test_margins_have_a_default():
    assert margins_of() == (-3.0, 4.0)


@given(numbers, numbers)
def test_margins_take_the_lower_one_first(low, high):
    if low < high:
        assert margins_of(low, high) == (low, high)
    else:
        with pytest.raises(ValueError, match="leaves no room between"):
            margins_of(low, high)


@given(numbers.filter(bool))
def test_one_margin_counts_in_both_directions(size):
    assert margins_of(size) == (-abs(size), abs(size))


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ((0.0,), "leaves no room between -0 and 0"),
        ((-1.0, 0.0, 1.0), "must be 'low, high' in mm"),
        ((math.nan,), "must be 'low, high' in mm"),
        ((math.nan, 1.0), "must be 'low, high' in mm"),
        ((-1.0, math.inf), "must be 'low, high' in mm"),
    ],
)
def test_margins_that_are_none(values, words):
    with pytest.raises(ValueError) as caught:
        margins_of(*values)
    assert str(caught.value).startswith(
        f"Option 'offset_margins' in section 'mine' {words}"
    )


class Section:
    """As much of a host's section as read() and TEXT need."""

    error = ValueError

    def __init__(self, **values):
        self.values = values

    def get_prefix_options(self, prefix):
        return [name for name in self.values if name.startswith(prefix)]

    def get(self, name, *default):
        if name not in self.values and not default:
            raise ValueError(f"Option '{name}' must be specified")
        return self.values.get(name, *default)


TABLE = (
    option("first", TEXT, "one", "", "", old=("formerly",)),
    option("second", TEXT, Same("first"), "", ""),
    option("third", TEXT, REQUIRED, "", ""),
)


@pytest.mark.parametrize(
    ("given", "values"),
    [
        ({"third": "3"}, ("one", "one", "3")),
        ({"first": "1", "third": "3"}, ("1", "1", "3")),
        ({"formerly": "0", "third": "3"}, ("0", "0", "3")),
        ({"second": "2", "third": "3"}, ("one", "2", "3")),
    ],
)
def test_default_may_be_the_value_of_a_row_above(given, values):
    assert tuple(read(Section(**given), TABLE).values()) == values


def test_required_option_is_asked_of_the_host_unless_it_has_a_default():
    with pytest.raises(ValueError, match="Option 'third' must be specified"):
        read(Section(), TABLE)
    assert read(Section(), TABLE, third="three")["third"] == "three"


def test_kind_is_told_that_an_option_is_required():
    seen = Kind("anything", lambda config, name, row: row.default, ())
    table = (option("some", seen, REQUIRED, "", ""),)
    assert read(Section(some=""), table) == {"some": REQUIRED}


@pytest.mark.parametrize(
    ("value", "text"),
    [
        ("", ""),
        ("  two\n lines\t ", "two lines"),
        ('Unknown command:"X"', "Unknown command:'X'"),
        ("first; second", "first, second"),
        ("extruder #1", "extruder 1"),
        ("it's 5.5 mm (100%)", "it's 5.5 mm (100%)"),
        (CalibrationError("no probe; look"), "no probe, look"),
        (0.25, "0.25"),
    ],
)
def test_text_for_a_macro(value, text):
    assert as_param(value) == text


@given(
    st.lists(
        st.characters(codec="ascii", exclude_categories=["Cc"])
        | st.sampled_from(";#\"'\\\n\r\t ")
    ).map("".join)
)
def test_text_for_a_macro_can_stand_in_a_quoted_string(value):
    # As hosts take a line apart: a comment, then the parameters
    text = as_param(value)
    lexer = shlex.shlex(f'MSG="{text}"'.split(";")[0], posix=True)
    lexer.whitespace_split = True
    lexer.commenters = "#;"
    assert list(lexer) == [f"MSG={text}"]
    assert not set("\n\r") & set(text)
