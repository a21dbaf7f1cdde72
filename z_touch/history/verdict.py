# What an owner has to do by his history, in words; and what happened in it, when.
# Its texts are no messages: they are drawn.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from ..uncertainty.cycles import NO_CAUSE
from . import trend
from .days import day
from .file import SITES
from .formats import BODY

# 'level': GOOD, WATCH or ACT; 'texts': on what, and what to do
Verdict = collections.namedtuple("Verdict", "level texts")
GOOD, WATCH, ACT = "good", "watch", "act"
LEVELS = (GOOD, WATCH, ACT)

# Something that was told at one run: its number among the runs, and a text
Mark = collections.namedtuple("Mark", "number text")

# An offset is good to (mm); from the second on a first layer shows it
GOOD_WORTH, POOR_WORTH = 0.01, 0.02
# With bed_spread it is good to this, as the texture of the plate is part of it
ROUGH_WORTH = 0.015

# Latest runs that are looked at, and how many of these are often
LATEST = 10
OFTEN = 3

# Good runs for which a wear, and a change, that was told stays in the verdict
WEAR_STAYS = 30
CHANGE_STAYS = 10

# What is less (mm) is the same switch_offset
SAME = 1e-6

# What a warning is about whose touches were wrong
OF_TOUCHES = SITES + (BODY,)

UNKNOWN = "nobody knows why"

REMEDIES = dict((entry[0], entry[2]) for entry in trend.HEIGHTS + trend.SPREADS)

# Of a run (mm), by the names of what is told as worn
SPREADS = dict(
    (entry[0], trend.spread(site)) for entry, site in zip(trend.SPREADS, SITES)
)
VALUES = dict(SPREADS, **dict((entry[0], entry[1]) for entry in trend.HEIGHTS))

# What else changes a height at once than what is wrong
CHANGES = dict((entry[0], entry[-1]) for entry in trend.HEIGHTS)


######################################################################
# What to do
######################################################################


# The Verdict of runs, the oldest first.  'cycles': an accuracy run after these, or
# None; pause() is called often.
def judge(runs, cycles=None, pause=trend.no_pause):
    advices = [] if cycles is None else [of_cycles(cycles)]
    if not (runs or advices):
        return Verdict(WATCH, ["There are no runs yet; run CALIBRATE_Z."])
    rules = (refusals, warnings, worth, wear, changes, cleanings)
    for rule in rules if runs else ():
        advices += rule(runs, pause) if rule is wear else rule(runs)
    # sorted() keeps the order of those of one level
    advices.sort(key=lambda entry: -LEVELS.index(entry[0]))
    if advices:
        return Verdict(advices[0][0], [text for _, text in advices])
    good = sum(run["ok"] for run in runs)
    texts, lack = [nothing_to_do(runs[-1])], trend.LEAST_RUNS - good
    if lack > 0:
        text = "New runs are compared with these after %d more good ones."
        texts.append(text % (lack,))
    return Verdict(GOOD, texts)


# What one repeats within minutes is all that an accuracy run sees: dirt that is hard,
# and a part that has moved, are seen by the runs before it.
def of_cycles(cycles):
    level = GOOD if cycles.get("cause") == NO_CAUSE else WATCH
    text = "%s" % (cycles.get("verdict") or "",)
    return level, sentence("Accuracy run: %s" % (text,))


def nothing_to_do(last):
    uncertainty = last.get("uncertainty")
    if uncertainty is None:
        return "Nothing to do."
    text = "Nothing to do. The offset is known to +-%.3f mm (95 %%)."
    return text % (uncertainty,)


def good_of(runs):
    return [run for run in runs if run["ok"]]


def refusals(runs):
    last, refused = runs[-1], [r for r in runs[-LATEST:] if not r["ok"]]
    if not last["ok"]:
        text = "The last run was refused: %s"
        yield ACT, sentence(text % (last.get("reason") or UNKNOWN,))
    elif len(refused) >= OFTEN:
        text = "%d of the last %d runs were refused, the last one on %s: %s"
        count = min(LATEST, len(runs))
        why = refused[-1].get("reason") or UNKNOWN
        text %= (len(refused), count, day(refused[-1]), why)
        yield WATCH, sentence(text)


# What the last run has told
def warnings(runs):
    for warning in runs[-1].get("warnings", ()):
        is_of_touches = warning["about"] in OF_TOUCHES
        yield ACT if is_of_touches else WATCH, sentence(warning["text"])


# A list of texts that whoever edits the file may have made anything
def texts_of(run, name):
    texts = run.get(name)
    return ["%s" % (t,) for t in texts] if isinstance(texts, list) else []


def sentence(text):
    return text[:1].upper() + text[1:].rstrip(".") + "."


# What the last offset is worth, and which site makes it so
def worth(runs):
    last = runs[-1]
    uncertainty = last.get("uncertainty")
    good = ROUGH_WORTH if trend.bed_spread(last) else GOOD_WORTH
    if not last["ok"] or uncertainty is None or uncertainty <= good:
        return
    # What is told of the nozzle is part of it
    if last.get("warnings"):
        return
    site = max(SITES, key=lambda name: variance(last, name))
    name = "spread of the %s's touches" % (site,)
    text = (
        "The offset is known to +-%.3f mm only; most of it are the %s's touches,"
        " which vary by %.4f mm; %s, or set samples: auto, which takes as many"
        " touches as it needs."
    )
    level = ACT if uncertainty > POOR_WORTH else WATCH
    sd = last["sites"][site]["sd"]
    yield level, text % (uncertainty, site, sd, REMEDIES.get(name, "clean it"))


# Of the height of a site (mm^2)
def variance(run, site):
    record = run["sites"][site]
    return record["sd"] ** 2 / max(1, len(record["samples"]))


# What was told of late, with how much it is by now
def wear(runs, pause=trend.no_pause):
    begin = first_of_stretch(runs, pause) or 0
    pause()
    latest = dict((n, i) for i, run in enumerate(runs) for n in told_worn(run))
    pause()
    changed = changes_of(runs)
    for name, number in sorted(latest.items()):
        pause()
        begins = [i for change, i in changed if change.get("what") == name]
        first = max([begin] + begins)
        if number < first or len(good_of(runs[number:])) > WEAR_STAYS:
            continue
        # Of the same plate, and as hot, as the trend was found with: comparable()
        # goes by the last one
        told = runs[first:] + [runs[number]]
        like = [run for _, run in trend.comparable(told, 0, pause)[:-1]]
        if len(like) >= trend.LEAST_RUNS:
            values = [VALUES[name](run) for run in like]
            yield WATCH, sentence(worn(name, values, day(runs[number])))


def told_worn(run):
    return (
        [n for n in texts_of(run, "wear") if n in VALUES]
        if run.get("wear")
        else ()
    )


# 'values' (mm) of a height or a spread; by the middles of the first and last third of
# those that trend.wear() looks at: most of a long stretch was as good as new
def worn(name, values, told_on):
    count, remedy = len(values), REMEDIES[name]
    if name in SPREADS:
        ends = values[: trend.GROWTH_RUNS] + values[-trend.GROWTH_RUNS :]
        first, last = trend.thirds(ends if count > len(ends) else values)
        text = "%s grows from %.4f to %.4f mm in %d runs, told on %s; %s"
        return text % (name, first, last, count, told_on, remedy)
    values = values[-trend.TREND_RUNS :]
    first, last = trend.thirds(values)
    # A line shifts by half as much again as its thirds do
    shift = (last - first) * 1.5
    text = "%s drifts by %.3f mm in %d runs, told on %s; %s"
    return text % (name, shift, len(values), told_on, remedy)


# What one step has changed, as long as it is news
def changes(runs):
    latest = [number for number, run in enumerate(runs) if run["ok"]]
    begin = latest[-CHANGE_STAYS] if len(latest) > CHANGE_STAYS else 0
    for change, number in told_of(changes_of(runs, begin)):
        text = (
            "%s changed by %.3f mm on %s, between two runs: %s; otherwise look for"
            " what is loose"
        )
        name, date = change.get("what"), day(runs[number])
        cause = CHANGES.get(name, "something was exchanged")
        yield WATCH, sentence(text % (name, change["by"], date, cause))


# Pairs of what has changed, and the number of the first run after it; 'begin': of the
# first run with which it was told
def changes_of(runs, begin=0):
    pairs = []
    for number in range(begin, len(runs)):
        for change in runs[number].get("changed") or ():
            first = number + 1 - int(change["runs"])
            pairs.append((change, max(0, first)))
    return pairs


# Without what went back to where it had been
def told_of(changed):
    return [pair for pair in changed if pair[0].get("told", True)]


def cleanings(runs):
    latest = runs[-LATEST:]
    count = sum(bool(run.get("cleaned")) for run in latest)
    if count >= OFTEN:
        text = (
            "The nozzle had to be cleaned in %d of the last %d runs; clean it"
            " before CALIBRATE_Z, at a temperature at which it does not drip."
        )
        yield WATCH, text % (count, len(latest))


######################################################################
# What happened
######################################################################


# The Marks of runs, in their order
def marks_of(runs, pause):
    marks, last = [], None
    begin, after = first_of_stretch(runs, pause), {}
    for change, number in told_of(changes_of(runs)):
        text = "%s changed by %.3f mm" % (change.get("what"), change["by"])
        after.setdefault(number, []).append(text)
    for number, run in enumerate(runs):
        if number % 100 == 0:
            pause()
        texts = [warning["text"] for warning in run.get("warnings", ())]
        for name in texts_of(run, "wear"):
            text = "told: %s grows" if name in SPREADS else "told: %s drifts"
            texts.append(text % (name,))
        texts += after.get(number, ())
        if number == begin and number not in after:
            texts.append("from here on switch - nozzle is another one")
        if run["ok"]:
            texts += edited(last, run)
            last = run
        marks += [Mark(number, text) for text in texts]
    return marks


# The number of the run from which on nozzle and probe are the ones they are; None:
# they were never others
def first_of_stretch(runs, pause):
    since = trend.summarize_runs(runs, pause).since
    good = [i for i, run in enumerate(runs) if run["ok"]]
    return good[since] if since else None


def edited(before, run):
    if before is None:
        return []
    old, new = before["switch_offset"], run["switch_offset"]
    if abs(new - old) <= SAME:
        return []
    return ["switch_offset was %.3f and is %.3f" % (old, new)]
