"""z_touch/sampling.py: tables of edges and general properties."""

from __future__ import annotations

import math
import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from z_touch.errors import CalibrationError, NoTrigger, SamplesDiffer
from z_touch.sampling import Sampling, accuracy, collect, summarize

series = st.lists(st.floats(-50.0, 400.0), min_size=1, max_size=9)


def deviation(samples):
    return accuracy(samples)[-1]


def near(value):
    return pytest.approx(value, abs=1e-9)


@given(series)
def test_figures_are_those_of_the_standard_library(samples):
    before = list(samples)
    assert summarize(samples, "median") == statistics.median(samples)
    assert summarize(samples, "average") == near(statistics.fmean(samples))
    low, high = min(samples), max(samples)
    average, median = statistics.fmean(samples), statistics.median(samples)
    figures = (high, low, high - low, average, median)
    assert accuracy(samples)[:-1] == near(figures)
    assert deviation(samples) == near(statistics.pstdev(samples))
    assert samples == before


# Collecting


def taken(values, retries=0, samples=3, tolerance=0.01):
    """Collect from these touches: samples, what was said, touches left."""
    wanted = Sampling(samples, tolerance, retries, "median", 2.0, 4.0, 6.0)
    touches, notes = iter(values), []
    result = collect(lambda: next(touches), wanted, notes.append, "look there")
    return result, notes, list(touches)


# 0.25 and 0.5 are exact in binary: equality really is equality
@pytest.mark.parametrize(
    ("values", "tolerance"),
    [
        ([1.0, 0.75], 0.25),
        ([1.0, 1.25], 0.25),
        ([1.0, 1.0, 1.0], 0.0),
        ([1.0, -50.0, 400.0], math.inf),
    ],
)
def test_spread_up_to_the_tolerance_agrees(values, tolerance):
    found = taken(values, samples=len(values), tolerance=tolerance)
    assert found == (values, [], [])


@pytest.mark.parametrize(
    ("values", "spread"),
    [
        ([1.0, 0.7499999], "0.2500"),
        ([1.0, 1.2500001], "0.2500"),
        # Of all samples, not of two
        ([1.0, 1.25, 1.5], "0.5000"),
    ],
)
def test_larger_spread_does_not(values, spread):
    with pytest.raises(SamplesDiffer) as caught:
        taken(values, tolerance=0.25)
    assert str(caught.value) == (
        f"samples differ by {spread} mm, samples_tolerance is 0.2500 mm;"
        " look there"
    )


def test_retry_starts_the_series_again():
    assert taken([1.0, 2.0, 3.0, 3.0, 3.0], retries=1) == (
        [3.0, 3.0, 3.0],
        [
            "samples differ by 1.0000 mm, samples_tolerance is 0.0100 mm;"
            " trying again"
        ],
        [],
    )


@pytest.mark.parametrize("retries", [0, 1, 2, 5])
def test_retries_end(retries):
    touches = map(float, range(100))
    wanted = Sampling(3, 0.01, retries, "median", 2.0, 4.0, 6.0)
    notes = []
    with pytest.raises(SamplesDiffer, match=r"^samples differ by 1\.0000 mm"):
        collect(lambda: next(touches), wanted, notes.append, "")
    assert next(touches) == 2.0 * (retries + 1)
    assert len(notes) == retries


def test_error_of_a_touch_ends_it_at_once():
    def touch():
        raise NoTrigger("probe lost")

    wanted = Sampling(3, 0.01, 5, "median", 2.0, 4.0, 6.0)
    with pytest.raises(NoTrigger, match="^probe lost$"):
        collect(touch, wanted, pytest.fail, "")


@given(
    st.lists(
        st.integers(0, 64).map(lambda steps: steps / 64),
        min_size=40,
        max_size=40,
    ),
    st.integers(0, 4),
)
def test_what_is_returned_are_the_last_touches_and_they_agree(values, retries):
    try:
        result, notes, unused = taken(values, retries, tolerance=0.5)
    except CalibrationError:
        return
    used = values[: len(values) - len(unused)]
    assert result == used[-3:]
    assert max(result) - min(result) <= 0.5
    assert len(notes) <= retries
    assert bool(notes) == (len(used) > 3)
