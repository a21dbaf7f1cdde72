"""z_touch/options.py: margins, and what a limit excludes.

How the rows of tables are read, hosts show in tests/modules/test_wrong_values.py and
in the tests of options of each module.
"""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from z_touch import options

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
    return options.read_margins(Config(*values), "offset_margins", (-3.0, 4.0))


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
    """By it tests on hosts are made, which without it would try too little."""
    row = options.option("a", options.NUMBER, None, "mm", "Any.", **limits)
    assert outside in options.nonsense(row)
    assert set(options.NUMBER.nonsense) < set(options.nonsense(row))
