"""When runs were: dates in words, and an axis of days for their plots.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

# Its texts are no messages: they are drawn.

from __future__ import annotations

import time
from typing import Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..z_calibration.runs import Run

# Outside of this (s since 1970, 2020 to 2100) a clock was not set yet
EARLIEST, LATEST = 1577836800.0, 4102444800.0

# Runs that are no farther apart (s) are counted, not dated
A_MOMENT = 60.0

HOUR, DAY = 3600.0, 86400.0
MOST_MARKS = 5
HOURS = (1, 3, 6, 12)
DAYS = (1, 2, 7, 14, 28, 91, 182, 365, 730, 1825, 3650, 7300)

Mark = Tuple[float, str]


class Axis(NamedTuple):
    """Where each run is, 0 to 1, and such places with a text."""

    xs: List[float]
    marks: List[Mark]


def time_of(run: Run) -> Optional[float]:
    """Return when a run was; None: the clock of a printer was not set."""
    return run.time if EARLIEST < run.time < LATEST else None


def in_words(run: Run, form: str) -> str:
    """Return when a run was, as strftime() has it."""
    seconds = time_of(run)
    if seconds is None:
        return "some day"
    return time.strftime(form, time.localtime(seconds))


def day(run: Run) -> str:
    """Return the day of a run."""
    return in_words(run, "%Y-%m-%d")


def month(run: Run) -> str:
    """Return the month of a run, with its year; empty: the clock was not set."""
    return in_words(run, "%B %Y") if time_of(run) is not None else ""


def minute(run: Run) -> str:
    """Return the minute of a run."""
    return in_words(run, "%Y-%m-%d %H:%M")


def times_of(runs: Sequence[Run]) -> Optional[List[float]]:
    """Return when runs were, in their order whatever the clock did.

    None: it was never set.
    """
    known = [time_of(run) for run in runs]
    dated = [t for t in known if t is not None]
    if not dated:
        return None
    later, times = dated[-1], []
    for t in reversed(known):
        if t is not None:
            later = min(later, t)
        times.append(later)
    return times[::-1]


def axis_of(runs: Sequence[Run]) -> Axis:
    """Return the axis of runs: of days, or of their numbers."""
    times = times_of(runs)
    if times is None or times[-1] - times[0] < A_MOMENT:
        return by_number(runs)
    first, span = times[0], times[-1] - times[0]
    marks = [
        ((t - first) / span, text)
        for t, text in marks_of(first, times[-1])
        if 0.0 <= t - first <= span
    ]
    return Axis([(t - first) / span for t in times], marks)


def by_number(runs: Sequence[Run]) -> Axis:
    """Return the axis of runs that have no times."""
    most = len(runs) - 1
    if not most:
        return Axis([0.5], [(0.5, minute(runs[0]))])
    xs = [i / most for i in range(len(runs))]
    return Axis(xs, [(0.0, "run 1"), (1.0, f"run {len(runs)}")])


def marks_of(first: float, last: float) -> Iterator[Tuple[float, str]]:
    """Yield midnights, or full hours where there are no two, as times and texts."""
    if last - first < 2 * DAY:
        step = step_of((last - first) / HOUR, HOURS)
        form, unit = "%m-%d %H:%M", 3
    else:
        step = step_of((last - first) / DAY, DAYS)
        form, unit = "%Y-%m-%d", 2
    fields = [*time.localtime(first)[: unit + 1], *[0] * (5 - unit)]
    fields[unit] += 1
    for _ in range(MOST_MARKS + 1):
        # mktime() makes days of summer time and ends of months what they are
        year, month, date, hour, minutes, seconds = fields
        t = time.mktime((year, month, date, hour, minutes, seconds, 0, 0, -1))
        yield t, time.strftime(form, time.localtime(t))
        fields[unit] += step


def step_of(count: float, steps: Sequence[int]) -> int:
    """Return the smallest step that makes no more than MOST_MARKS of a count."""
    fit = [step for step in steps if count / step <= MOST_MARKS]
    return fit[0] if fit else steps[-1]
