# What many runs say of a printer: pure functions on its records (file.py).
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# switch - nozzle depends on neither homing nor bed: it is the fingerprint of
# nozzle and probe.  Wear is a trend over the last runs, found by the test of
# Mann and Kendall, which asks for each two runs which one was higher: it wants
# no certain distribution, and single runs that are far off do not decide.
from __future__ import absolute_import, division

import collections
import math

from ..core.sampling import summarize
from ..uncertainty.estimate import MAD_FACTOR

# mm; None where there are too few runs
Fingerprint = collections.namedtuple("Fingerprint", "middle sigma runs")
NO_FINGERPRINT = Fingerprint(None, 0.0, 0)


# What is known of switch - nozzle: the fingerprint, from which good run on nozzle
# and probe are the same, and the last value (mm)
Summary = collections.namedtuple("Summary", "fingerprint since last")


# Runs that make a fingerprint, and the latest that count for it
LEAST_RUNS = 5
LATEST_RUNS = 50

# A run is off the fingerprint from both on: standard deviations, mm
FAR_SIGMA = 5.0
FAR = 0.05

# Among runs that were as hot less is no chance (mm): 38 um of residue on the nozzle
FAR_AS_HOT = 0.02

# Runs for a trend: at least, and the latest that count
TREND_LEAST = 20
TREND_RUNS = 100

# A trend is one from so many standard deviations of its statistic on: a chance
# of 7e-6 at each look
TREND_SIGMA = 4.5

# A trend is told from so large a shift of heights (mm) on, or growth of a spread (mm
# and times)
SHIFT = 0.006
GROWTH = 0.001
GROWTH_TIMES = 1.5

# Only runs are compared that were as hot (K)
AS_HOT = 10.0


# Functions of a run: the height of a site, switch - nozzle, and how the touches of
# a site vary (mm)


def height(site):
    return lambda run: run["sites"][site]["z"]


def body(run):
    return height("switch")(run) - height("nozzle")(run)


def spread(site):
    return lambda run: run["sites"][site]["sd"]


# Of a trend: name, value of a run, what to do
HEIGHTS = (
    (
        "nozzle height",
        height("nozzle"),
        "check the switch that the nozzle presses, and what homes Z",
    ),
    ("switch - nozzle", body, "check nozzle, probe and their seat for wear"),
    (
        "probe - switch",
        lambda run: height("bed")(run) - height("switch")(run),
        "check the bed and the probe's switch for wear",
    ),
)
SPREADS = (
    (
        "spread of the nozzle's touches",
        spread("nozzle"),
        "clean the nozzle, then check the switch under it",
    ),
    (
        "spread of the switch's touches",
        spread("switch"),
        "check how the probe is seated, and the switch under it",
    ),
    (
        "spread of the bed's touches",
        spread("bed"),
        "check how the probe is seated; its switch may be worn",
    ),
)


def no_pause():
    pass


def fingerprint_of(values):
    if len(values) < LEAST_RUNS:
        return NO_FINGERPRINT._replace(runs=len(values))
    values = values[-LATEST_RUNS:]
    middle = summarize(values, "median")
    far = summarize([abs(v - middle) for v in values], "median")
    return Fingerprint(middle, MAD_FACTOR * far, len(values))


def departs(value, fingerprint, far=FAR):
    if fingerprint.middle is None:
        return False
    limit = max(FAR_SIGMA * fingerprint.sigma, far)
    return abs(value - fingerprint.middle) > limit


# What a new run is compared with: the last values of switch - nozzle (mm) among good
# runs that were as hot, the latest last.  'run': has its temperatures
def bodies_as_hot(runs, summary, run):
    good = [other for other in runs if other["ok"]][summary.since :]
    return [body(o) for o in good[-LATEST_RUNS:] if is_as_hot(o, run)]


# By how much (mm) switch - nozzle of a new run departs from all of them, the last
# included; 0: not by more than chance.
def departure(value, bodies):
    known = fingerprint_of(bodies)
    if not departs(value, known, FAR_AS_HOT):
        return 0.0
    if abs(value - bodies[-1]) <= FAR_AS_HOT:
        return 0.0
    return value - known.middle


# The Summary of runs.  Two in a row that depart from all before, and agree with each other, are
# the first ones of another nozzle or probe.
def summarize_runs(runs, pause=no_pause):
    values, since, off = [], 0, None
    good = [run for run in runs if run["ok"]]
    for number, run in enumerate(good):
        if number % 5 == 0:
            pause()
        value = body(run)
        if not departs(value, fingerprint_of(values)):
            values, off = values + [value], None
        elif off is not None and abs(value - off) <= FAR:
            values, off, since = [off, value], None, number - 1
        else:
            off = value
    last = body(good[-1]) if good else None
    return Summary(fingerprint_of(values), since, last)


# The statistic of Mann and Kendall in its standard deviations, ties included
def kendall(values, pause=no_pause):
    n, total = len(values), 0
    for i in range(1, n):
        if i % 10 == 0:
            pause()
        v = values[i]
        row = values[:i]
        total += sum(w < v for w in row) - sum(w > v for w in row)
    ties = collections.Counter(values).values()
    variance = n * (n - 1) * (2 * n + 5)
    variance -= sum(t * (t - 1) * (2 * t + 5) for t in ties)
    return total / math.sqrt(variance / 18.0) if variance > 0 else 0.0


# From the first third of the values to the last
def thirds(values):
    third = len(values) // 3
    ends = values[:third], values[-third:]
    return [summarize(part, "median") for part in ends]


def is_as_hot(run, other):
    pair = [r.get("temperatures", {}) for r in (run, other)]
    for name in ("extruder", "heater_bed"):
        values = [p.get(name) for p in pair]
        if None not in values and abs(values[0] - values[1]) > AS_HOT:
            return False
    return True


# The latest ones that are comparable with the last, and were not told of yet
def comparable(good, pause):
    latest = []
    for number, run in enumerate(reversed(good)):
        if number % 20 == 0:
            pause()
        if is_as_hot(run, good[-1]):
            latest.append(run)
        if len(latest) == TREND_RUNS:
            break
    return latest[::-1]


def since_told(name, runs):
    for number in reversed(range(len(runs))):
        if name in runs[number].get("wear", ()):
            return runs[number + 1 :]
    return runs


# What is significant since it was told last: pairs of name and text
def wear(runs, pause=no_pause):
    good = [run for run in runs if run["ok"]]
    since = summarize_runs(good, pause).since
    like, told = comparable(good[since:], pause), []
    for name, value, remedy in HEIGHTS + SPREADS:
        values = [value(run) for run in since_told(name, like)]
        pause()
        if len(values) < TREND_LEAST:
            continue
        is_height = name in [entry[0] for entry in HEIGHTS]
        text = (shifted if is_height else grown)(name, values, pause)
        if text:
            told.append((name, "%s: %s" % (text, remedy)))
    return told


def shifted(name, values, pause):
    first, last = thirds(values)
    # A line shifts by half as much again as its thirds do
    shift = (last - first) * 1.5
    if abs(shift) < SHIFT or abs(kendall(values, pause)) < TREND_SIGMA:
        return ""
    text = "%s has drifted by %.3f mm in the last %d runs"
    return text % (name, shift, len(values))


def grown(name, values, pause):
    first, last = thirds(values)
    if last < max(first + GROWTH, first * GROWTH_TIMES):
        return ""
    if kendall(values, pause) < TREND_SIGMA:
        return ""
    text = "%s has grown from %.4f to %.4f mm in the last %d runs"
    return text % (name, first, last, len(values))
