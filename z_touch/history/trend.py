# What many runs say of a printer: pure functions on its records (file.py).
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# switch - nozzle depends on neither homing nor bed: it is the fingerprint of
# nozzle and probe.  Wear is a trend over the last runs, found by the test of
# Mann and Kendall, which asks for each two runs which one was higher: it wants
# no certain distribution, and single runs that are far off do not decide.  What
# hangs together from run to run, such as plates in turn, counts as fewer runs.
#
# What one step between two runs explains better than a line is a change: told once,
# and a new stretch begins, in which older runs have no say.  Two plates in turn are one
# step, too, until the first of them is back: only time tells which it is.
#
# With the run that has shown it the history keeps, by the names of HEIGHTS and
# SPREADS:
#
#   'wear'      names of what was told as worn; their stretch begins with the next run
#   'changed'   dicts: 'what', a name; 'by' (mm); 'runs', how many there were since
#               then, this one and refused ones included; 'told': False where it
#               went back to where it had been before, which is told to nobody

import collections
import math
import time

from ..core.sampling import summarize
from ..uncertainty.estimate import MAD_FACTOR, Spread
from ..uncertainty.recent import f_limit, pool_usual
from .steps import (
    FAR_SIGMA,
    GROWTH_RUNS,
    LINE_ODDS,
    SHIFT,
    STEP_RUNS,
    best_split,
    find_step,
    has_held,
    no_pause,
    odds_of_step,
    off_line,
    size_of_step,
    square_of,
    together,
    without_single_ones,
)

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
FAR = 0.05

# Among runs that were as hot less is enough: 38 um of residue on the nozzle are seen
# where switch - nozzle varies by 6
FAR_SIGMA_AS_HOT = 4.25
FAR_AS_HOT = 0.02

# Runs for a trend of a height: at least, and the latest that count
TREND_LEAST = 20
TREND_RUNS = 100

# A trend is one from so many standard deviations of its statistic on: a chance
# of 7e-6 at each look
TREND_SIGMA = 4.5

# A trend of a spread is told from so large a growth on (mm and times); a shift of heights
# as steps.SHIFT says
GROWTH = 0.001
GROWTH_TIMES = 1.5

# The height that another plate changes; unless runs name their plates, a step of less
# than plates usually differ by (mm) is told once it has held
OF_PLATES = "probe - switch"
PLATES_DIFFER = 0.06

# Part of a change by which one may miss where it was before, and is back there
BACK = 0.2

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


# What a record has of a site, as a Spread: how far it scatters, and how well that is
# known.
def spread_in(record):
    dof = max(int(record["n"]) - 1, 0)
    return Spread(max(record["sd"], 0.0) ** 2, dof, record.get("absolute"))


def touches(site):
    return lambda run: spread_in(run["sites"][site])


# Of a trend: name, value of a run, what to do about wear, what else changes it at once
HEIGHTS = (
    (
        "nozzle height",
        height("nozzle"),
        "check the switch that the nozzle presses, and what homes Z",
        "a new position_endstop does that, another nozzle, or what homes Z",
    ),
    (
        "switch - nozzle",
        body,
        "check nozzle, probe and their seat for wear",
        "another nozzle does that, another probe, or how it is seated",
    ),
    (
        OF_PLATES,
        lambda run: height("bed")(run) - height("switch")(run),
        "check the bed and the probe's switch for wear",
        "another plate does that (with CALIBRATE_Z PLATE=name each counts for"
        " itself), or another probe",
    ),
)
SPREADS = (
    (
        "spread of the nozzle's touches",
        touches("nozzle"),
        "clean the nozzle, then check the switch under it",
    ),
    (
        "spread of the switch's touches",
        touches("switch"),
        "check how the probe is seated, and the switch under it",
    ),
    (
        "spread of the bed's touches",
        touches("bed"),
        "check how the probe is seated, and its switch for wear",
    ),
)


def fingerprint_of(values):
    if len(values) < LEAST_RUNS:
        return NO_FINGERPRINT._replace(runs=len(values))
    values = values[-LATEST_RUNS:]
    middle = summarize(values, "median")
    far = summarize([abs(v - middle) for v in values], "median")
    return Fingerprint(middle, MAD_FACTOR * far, len(values))


def departs(value, fingerprint):
    if fingerprint.middle is None:
        return False
    limit = max(FAR_SIGMA * fingerprint.sigma, FAR)
    return abs(value - fingerprint.middle) > limit


# How far (mm) a run may be off the fingerprint of those that were as hot
def limit_as_hot(fingerprint):
    return max(FAR_SIGMA_AS_HOT * fingerprint.sigma, FAR_AS_HOT)


# What a new run is compared with: the last values of switch - nozzle (mm) among good
# runs that were as hot, the latest last.  'run': has its temperatures
def bodies_as_hot(runs, summary, run):
    good = [other for other in runs if other["ok"]][summary.since :]
    return [body(o) for o in good[-LATEST_RUNS:] if is_as_hot(o, run)]


# By how much (mm) switch - nozzle of a new run departs from all of them, the last
# included; 0: not by more than chance.
def departure(value, bodies):
    fingerprint = fingerprint_of(bodies)
    if fingerprint.middle is None:
        return 0.0
    if abs(value - fingerprint.middle) <= limit_as_hot(fingerprint):
        return 0.0
    if abs(value - bodies[-1]) <= FAR_AS_HOT:
        return 0.0
    return value - fingerprint.middle


# The name of the extruder whose nozzle it was; empty: nobody knows, as there was no
# such field
def tool(run):
    return run.get("extruder") or ""


# The runs with the nozzle of an extruder: that of another one, which is longer, is
# neither dirt nor another nozzle
def of_tool(runs, name, pause=no_pause):
    own = []
    for number, run in enumerate(runs):
        if number % 100 == 0:
            pause()
        if tool(run) in ("", name):
            own.append(run)
    return own


# The Summary of the runs with each extruder, by its name
def summarize_tools(runs, pause=no_pause):
    summaries = {}
    for number, run in enumerate(runs):
        if number % 100 == 0:
            pause()
        name = tool(run)
        if name not in summaries:
            own = of_tool(runs, name, pause)
            summaries[name] = summarize_runs(own, pause)
    return summaries


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


# Within how far (mm) of its point the bed was touched; before there was such an
# option it was touched there
def bed_spread(run):
    return run.get("bed_spread") or 0.0


# One point of a textured plate is another height than many, and another spread
def is_like(run, other):
    if bed_spread(run) != bed_spread(other):
        return False
    plates = [r.get("plate") or "" for r in (run, other)]
    return plates[0] == plates[1] and is_as_hot(run, other)


######################################################################
# Stretches
######################################################################


# Good runs from a number on that are comparable with the last one, as pairs of their
# number and the run
def comparable(runs, begin, pause):
    runs_alike = []
    for number in range(begin, len(runs)):
        if number % 20 == 0:
            pause()
        if runs[number]["ok"] and is_like(runs[number], runs[-1]):
            runs_alike.append((number, runs[number]))
    return runs_alike


# What 'value' says of each of them
def values_of(value, runs_alike, pause):
    values = []
    for _, run in runs_alike:
        if len(values) % 20 == 0:
            pause()
        values.append(value(run))
    return values


# Numbers of the runs with which the stretches of a name begin, but for the first
def begins_of(name, runs):
    numbers = []
    for number, run in enumerate(runs):
        for change in run.get("changed", ()):
            if change.get("what") == name:
                numbers.append(max(0, number + 1 - int(change["runs"])))
        if name in run.get("wear", ()):
            numbers.append(number + 1)
    return numbers


######################################################################
# What is told
######################################################################

# With a run: 'wear' and 'changed' as it is kept, and the texts for the user
Told = collections.namedtuple("Told", "wear changed texts")


# Of all runs, of which the last one has just ended
def find(runs, pause=no_pause):
    worn, changed, texts = wear(runs, pause), [], []
    exchanged = exchanged_with(runs, pause)
    for name, value, _, cause in HEIGHTS:
        begin = max([exchanged] + begins_of(name, runs))
        change = find_change(name, value, runs, begin, pause)
        if change is None:
            continue
        changed.append(change)
        if change["told"]:
            day = date_of(runs[-int(change["runs"])])
            text = "%s has changed by %.3f mm%s, between two runs: %s"
            texts.append(text % (name, change["by"], day, cause))
    texts += [text for _, text in worn]
    return Told([name for name, _ in worn], changed, texts)


def date_of(run):
    try:
        day = time.strftime("%Y-%m-%d", time.localtime(run["time"]))
    except (OverflowError, ValueError, OSError):
        return ""
    return " on " + day if run["time"] else ""


# The number of the first run with the nozzle and the probe of now
def exchanged_with(runs, pause):
    good = [number for number, run in enumerate(runs) if run["ok"]]
    since = summarize_runs(runs, pause).since
    return good[since] if since else 0


# What has changed since the stretch of a name has begun, as it is kept; None: nothing
def find_change(name, value, runs, begin, pause):
    if not (runs and runs[-1]["ok"]):
        return None
    like = comparable(runs, begin, pause)
    values = values_of(value, like, pause)
    old = max(0, len(values) - TREND_RUNS)
    split = find_step(values[old:])
    if not split:
        return None
    split += old
    by, first = size_of_step(values, split), like[split][0]
    is_doubtful = may_be_plates(name, by, runs[-1])
    if is_doubtful and not has_held(values, split, pause):
        return None
    after = summarize(values[split:], "median")
    is_back = any(
        abs(after - before) <= max(SHIFT, BACK * abs(by))
        for before in levels_before(name, value, runs, pause)
    )
    return {
        "what": name,
        "by": round(by, 6),
        "runs": len(runs) - first,
        "told": not is_back,
    }


# Whether a step may be the first exchange of plates that are used in turn
def may_be_plates(name, by, run):
    is_of_plates = name == OF_PLATES and not run.get("plate")
    return is_of_plates and abs(by) < PLATES_DIFFER


# Where a height was at the end of each stretch before this one (mm)
def levels_before(name, value, runs, pause):
    begins, levels = sorted(begins_of(name, runs)), []
    for begin, end in zip([0] + begins, begins):
        pause()
        part = runs[begin:end][-2 * GROWTH_RUNS :]
        values = [value(r) for r in part if r["ok"] and is_like(r, runs[-1])]
        if len(values) >= STEP_RUNS:
            levels.append(summarize(values[-GROWTH_RUNS:], "median"))
    return levels


# What is significant since it was told last: pairs of name and text
def wear(runs, pause=no_pause):
    if not (runs and runs[-1]["ok"]):
        return []
    told, exchanged = [], exchanged_with(runs, pause)
    for name, value, remedy, _ in HEIGHTS:
        begin = max([exchanged] + begins_of(name, runs))
        like = comparable(runs, begin, pause)
        values = [value(run) for _, run in like[-TREND_RUNS:]]
        text = shifted(name, values, pause)
        told += [(name, "%s: %s" % (text, remedy))] if text else []
    for name, value, remedy in SPREADS:
        begin = max([exchanged] + begins_of(name, runs))
        like = comparable(runs, begin, pause)
        text = grown(name, value, [run for _, run in like])
        told += [(name, "%s: %s" % (text, remedy))] if text else []
    return told


def shifted(name, values, pause):
    if len(values) < TREND_LEAST:
        return ""
    first, last = thirds(values)
    # A line shifts by half as much again as its thirds do
    shift = (last - first) * 1.5
    if abs(shift) < SHIFT:
        return ""
    straight = without_single_ones(values)
    rest = off_line(straight)
    sigmas = kendall(values, pause) / math.sqrt(together(rest))
    if abs(sigmas) < TREND_SIGMA:
        return ""
    split, line = best_split(straight), square_of(rest)
    odds = odds_of_step(straight, split, line)
    if odds > LINE_ODDS * math.log(len(values)):
        return ""
    text = "%s has drifted by %.3f mm in the last %d runs"
    return text % (name, shift, len(values))


# 'value': the Spread of one touch in a run; 'runs': of a stretch
def grown(name, value, runs):
    if len(runs) < 2 * GROWTH_RUNS:
        return ""
    first, last = [
        pool_usual([value(run) for run in part], GROWTH)
        for part in (runs[:GROWTH_RUNS], runs[-GROWTH_RUNS:])
    ]
    if not (first.dof and last.dof):
        return ""
    before, after = math.sqrt(first.variance), math.sqrt(last.variance)
    if after < max(before + GROWTH, before * GROWTH_TIMES):
        return ""
    limit = f_limit(last.dof, first.dof, TREND_SIGMA)
    if last.variance < limit * max(first.variance, GROWTH**2):
        return ""
    text = "%s has grown from %.4f to %.4f mm in the last %d runs"
    return text % (name, before, after, len(runs))
