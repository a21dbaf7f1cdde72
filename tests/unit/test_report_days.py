"""z_touch/report/days.py: where runs are on an axis of days."""

from __future__ import annotations

import os
import time

import pytest

from z_touch.report import days
from z_touch.z_calibration.runs import Run

# A Saturday evening before summer time begins in Europe
BEGIN = 1774720800.0


@pytest.fixture(autouse=True, params=["UTC", "Europe/Berlin"])
def zone(request):
    before = os.environ.get("TZ")
    os.environ["TZ"] = request.param
    time.tzset()
    yield request.param
    os.environ.pop("TZ")
    if before is not None:
        os.environ["TZ"] = before
    time.tzset()


def runs_at(*seconds):
    return [Run(False, s, {}) for s in seconds]


def texts(runs):
    return [text for _, text in days.axis_of(runs).marks]


def test_marks_are_midnights():
    axis = days.axis_of(runs_at(*(BEGIN + 86400.0 * i for i in range(15))))
    assert axis.xs[0] == 0.0 and axis.xs[-1] == 1.0
    assert len(axis.marks) == 2
    for part, text in axis.marks:
        local = time.localtime(BEGIN + part * 14 * 86400.0)
        assert (local.tm_hour, local.tm_min) == (0, 0)
        assert text == time.strftime("%Y-%m-%d", local)


@pytest.mark.parametrize("count", [3, 10, 100, 1000, 10000])
def test_there_are_some_marks_and_not_too_many(count):
    found = texts(runs_at(BEGIN, BEGIN + 86400.0 * count))
    assert 1 <= len(found) <= days.MOST_MARKS + 1


def test_hours_of_one_day():
    found = texts(runs_at(BEGIN, BEGIN + 5 * 3600.0))
    assert 4 <= len(found) <= 6
    assert all(text.endswith(":00") for text in found)


@pytest.mark.parametrize(
    "times", [(BEGIN,) * 3, (0.0, 5.0, 9e11), (BEGIN, 0.0, 0.0)]
)
def test_without_days_they_are_counted(times):
    axis = days.axis_of(runs_at(*times))
    assert axis.xs == [0.0, 0.5, 1.0]
    assert [text for _, text in axis.marks] == ["run 1", "run 3"]


def test_a_single_run_is_in_the_middle():
    axis = days.axis_of(runs_at(BEGIN))
    assert axis.xs == [0.5]
    assert axis.marks[0][1].startswith("2026-03-28 ")
    assert days.axis_of(runs_at(0.0)).marks == [(0.5, "some day")]


def test_a_clock_that_was_wrong_moves_nothing_else():
    """Set late at power-on, once far ahead, once not known."""
    right = [BEGIN + 86400.0 * i for i in range(10)]
    wrong = [right[0], 100.0, *right[2:5], 3e9, 0.0, *right[7:]]
    xs = days.axis_of(runs_at(*wrong)).xs
    assert xs == sorted(xs)
    for i in (0, 2, 3, 4, 7, 8, 9):
        assert xs[i] == pytest.approx(i / 9)
