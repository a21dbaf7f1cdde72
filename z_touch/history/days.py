# When runs were: dates in words, and an axis of days for their plots.
# Its texts are no messages: they are drawn.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections
import time

# Outside of this (s since 1970, 2020 to 2100) a clock was not set yet
EARLIEST, LATEST = 1577836800.0, 4102444800.0

# Runs that are no farther apart (s) are counted, not dated
A_MOMENT = 60.0

HOUR, DAY = 3600.0, 86400.0
MOST_MARKS = 5
HOURS = (1, 3, 6, 12)
DAYS = (1, 2, 7, 14, 28, 91, 182, 365, 730, 1825, 3650, 7300)

# 'xs': where each run is, 0 to 1; 'marks': pairs of such a place and a text
Axis = collections.namedtuple("Axis", "xs marks")


# None where nobody knows: the clock of a printer without a battery
def time_of(run):
    seconds = run.get("time")
    return seconds if seconds and EARLIEST < seconds < LATEST else None


def day(run):
    seconds = time_of(run)
    if seconds is None:
        return "some day"
    return time.strftime("%Y-%m-%d", time.localtime(seconds))


def minute(run):
    seconds = time_of(run)
    if seconds is None:
        return "some day"
    return time.strftime("%Y-%m-%d %H:%M", time.localtime(seconds))


# In the order of the runs, whatever the clock did; None where it was never set
def times_of(runs):
    times = [time_of(run) for run in runs]
    dated = [t for t in times if t is not None]
    if not dated:
        return None
    later = dated[-1]
    for i in reversed(range(len(times))):
        if times[i] is not None:
            later = min(later, times[i])
        times[i] = later
    return times


def axis_of(runs):
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


def by_number(runs):
    most = len(runs) - 1
    if not most:
        return Axis([0.5], [(0.5, minute(runs[0]))])
    xs = [i / float(most) for i in range(len(runs))]
    return Axis(xs, [(0.0, "run 1"), (1.0, "run %d" % (len(runs),))])


# Midnights, or full hours where there are no two midnights: pairs of time and text
def marks_of(first, last):
    if last - first < 2 * DAY:
        step = step_of((last - first) / HOUR, HOURS)
        form, unit = "%m-%d %H:%M", 3
    else:
        step = step_of((last - first) / DAY, DAYS)
        form, unit = "%Y-%m-%d", 2
    fields = list(time.localtime(first))[: unit + 1] + [0] * (5 - unit)
    fields[unit] += 1
    marks = []
    for _ in range(MOST_MARKS + 1):
        # mktime() makes days of summer time and ends of months what they are
        t = time.mktime(tuple(fields + [0, 0, -1]))
        marks.append((t, time.strftime(form, time.localtime(t))))
        fields[unit] += step
    return marks


def step_of(count, steps):
    fit = [step for step in steps if count / step <= MOST_MARKS]
    return fit[0] if fit else steps[-1]
