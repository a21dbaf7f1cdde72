"""What to do by a history, in words; and what happened in it, when.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

# Its texts are no messages: they are drawn.

from __future__ import annotations

import re
from typing import Dict, Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..z_calibration.runs import BODY, LEAST_RUNS, SITES, Run
from . import cycles, trend
from .days import day, month

GOOD, WATCH, ACT = "good", "watch", "act"
LEVELS = (GOOD, WATCH, ACT)

# An offset is good to (mm); from the second on a first layer shows it
GOOD_WORTH, POOR_WORTH = 0.01, 0.02
# With bed_spread it is good to this, as the texture of the plate is part of it
ROUGH_WORTH = 0.015

# Latest runs that are looked at, and how many of these are often
LATEST = 10
OFTEN = 3

# Good runs for which a change stays in the verdict
CHANGE_STAYS = 10

# What is less (mm) is the same switch_offset
SAME = 1e-6

# What a warning is about whose touches were wrong
OF_TOUCHES = (*SITES, BODY)

UNKNOWN = "no reason is kept"


# How the console names a height, and how an owner knows it
_BODY = re.compile(rf"\b{BODY} is (\S+) mm and was (\S+) mm")

# Plots of the picture besides those of trend.HEIGHTS: what a sentence is seen in
LAST_RUN, OFFSET, SPREAD, ACCURACY = "last run", "offset", "spread", "accuracy"


class Verdict(NamedTuple):
    """GOOD, WATCH or ACT; on what, with what to do; and in which plots that is seen.

    plots: names with their levels, those of the first text first.
    """

    level: str
    texts: List[str]
    plots: Dict[str, str]


class Mark(NamedTuple):
    """Something that happened at one run: its number among the runs, and a text."""

    number: int
    text: str


class Advice(NamedTuple):
    """One sentence of a verdict; plot: where that is seen, empty: nowhere."""

    level: str
    text: str
    plot: str = ""


class Words(NamedTuple):
    """How an owner is told of one of trend.HEIGHTS.

    remedy: what to do where it drifts. cause: what may have changed it at once. moved:
    what it does, and how that is called where it rises and where it falls.
    """

    remedy: str
    cause: str
    moved: str
    up: str
    down: str

    def by(self, distance: float) -> str:
        """Return what it has done, by so much (mm)."""
        return f"{self.moved} {abs(distance):.3f} mm {self.up if distance > 0 else self.down}"


WORDS = {
    "nozzle height": Words(
        "Check the switch that the nozzle presses, and what homes Z",
        "changed position_endstop, the nozzle or what homes Z",
        "the nozzle meets the pin",
        "higher",
        "lower",
    ),
    "switch - nozzle": Words(
        "Tighten the nozzle, and what holds the probe",
        "exchanged the nozzle or the probe",
        "the probe hangs",
        "further below the nozzle",
        "less far below the nozzle",
    ),
    "probe - switch": Words(
        "Replace the probe's switch soon, unless the bed is what moves",
        "laid another plate or exchanged the probe",
        "the probe finds the bed",
        "higher",
        "lower",
    ),
}

CLEAN = "Clean the nozzle, then check the switch of the pin"

# By what touches vary ever more: what to do, and whose they are
PIN = "pin"
WORN = {
    PIN: (
        "Replace the switch of the pin soon",
        "touches of the nozzle and of the probe's body on it",
    ),
    "nozzle": (CLEAN, "touches of the nozzle"),
    "switch": (
        "Seat the probe firmly, then check the switch of the pin",
        "touches of the probe's body",
    ),
    "bed": ("Replace the probe's switch soon", "its touches"),
}

# What to do where the touches of a site vary much
STEADIER = {
    "nozzle": CLEAN,
    "switch": "Check how the probe is seated, then the switch of the pin",
    "bed": "Check how the probe is seated, then its switch for wear",
}
# What touches there
TOUCHING = {
    "nozzle": "the nozzle on the pin",
    "switch": "the probe's body on the pin",
    "bed": "the probe on the bed",
}

# A ratio between these is said as "twice"; from MANY on tenths do not count
TWICE = (1.75, 2.25)
MANY = 3.0


######################################################################
# What to do
######################################################################


def judge(runs: Sequence[Run], accuracy: Optional[Run] = None) -> Verdict:
    """Judge runs, the oldest first.

    accuracy: the CALIBRATE_Z_ACCURACY that was the last thing, if it was.
    """
    advices: List[Advice] = []
    if accuracy is not None:
        advices.append(of_cycles(accuracy))
    if not (runs or advices):
        return Verdict(WATCH, ["There are no runs yet; run CALIBRATE_Z."], {})
    if runs:
        for rule in (refusals, warnings, wear, worth, changes, cleanings):
            advices += rule(runs)
    # sorted() keeps the order of those of one level
    advices = sorted(advices, key=lambda entry: -LEVELS.index(entry.level))
    if advices:
        plots: Dict[str, str] = {}
        for advice in advices:
            if advice.plot and advice.level != GOOD:
                plots.setdefault(advice.plot, advice.level)
        texts = [advice.text for advice in advices]
        return Verdict(advices[0].level, texts, plots)
    texts = [nothing_to_do(runs[-1])]
    lack = LEAST_RUNS - sum(run.ok for run in runs)
    if lack > 0:
        ones = "one" if lack == 1 else "ones"
        texts.append(
            f"New runs are compared with these after {lack} more good {ones}."
        )
    return Verdict(GOOD, texts, {})


def of_cycles(accuracy: Run) -> Advice:
    """Return the verdict of CALIBRATE_Z_ACCURACY.

    What repeats within minutes is all that it sees: dirt that is hard, and a part that
    has moved, are seen by the runs before it.
    """
    found = cycles.judge_run(accuracy)
    level = GOOD if found.cause == cycles.NO_CAUSE else WATCH
    return Advice(level, sentence(f"Accuracy run: {found.text}"), ACCURACY)


def nothing_to_do(last: Run) -> str:
    """Return what is said of a good printer."""
    if last.uncertainty is None:
        return "Nothing to do."
    return f"Nothing to do. The offset is known to +-{last.uncertainty:.3f} mm (95 %)."


def refusals(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield that the last run was refused, or that many were."""
    last, refused = runs[-1], [run for run in runs[-LATEST:] if not run.ok]
    if not last.ok:
        why = last.reason or UNKNOWN
        yield Advice(ACT, sentence(f"The last run was refused: {why}"), OFFSET)
    elif len(refused) >= OFTEN:
        count, why = min(LATEST, len(runs)), refused[-1].reason or UNKNOWN
        yield Advice(
            WATCH,
            sentence(
                f"{len(refused)} of the last {count} runs were refused, the last one on"
                f" {day(refused[-1])}: {why}"
            ),
            OFFSET,
        )


def warnings(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield what the last run has warned of."""
    for warned in runs[-1].warnings:
        level = ACT if warned.about in OF_TOUCHES else WATCH
        plot = LAST_RUN if warned.about in SITES else ""
        plot = BODY if warned.about == BODY else plot
        yield Advice(level, sentence(plain(warned.text)), plot)


def plain(text: str) -> str:
    """Return a warning of the console with the name that the picture has for a height."""
    return _BODY.sub(
        r"the probe hangs \1 mm below the nozzle and hung \2 mm", text
    )


def sentence(text: str) -> str:
    """Return words as a sentence."""
    return text[:1].upper() + text[1:].rstrip(".") + "."


def worth(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield that the last offset is vague, and which site makes it so."""
    last = runs[-1]
    good = ROUGH_WORTH if last.bed_spread else GOOD_WORTH
    if not last.ok or last.uncertainty is None or last.uncertainty <= good:
        return
    # What a run warns of is part of its uncertainty
    if last.warnings:
        return
    site = max(SITES, key=lambda name: variance(last, name))
    level = ACT if last.uncertainty > POOR_WORTH else WATCH
    if level == WATCH and site in {grown.site for grown in trend.growths(runs)}:
        # wear() says what is behind it
        return
    yield Advice(
        level,
        f"{STEADIER[site]}, or set samples: auto: the offset is known to"
        f" +-{last.uncertainty:.3f} mm only, mostly as touches of {TOUCHING[site]} vary"
        f" by {last.sites[site].sd:.4f} mm.",
        LAST_RUN,
    )


def variance(run: Run, site: str) -> float:
    """Return the variance of the height of a site (mm^2)."""
    kept = run.sites[site]
    return kept.sd**2 / max(1, len(kept.samples))


def wear(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield what varies ever more, and what drifts."""
    alike = [run for _, run in trend.like_last(runs)]
    for worn, grown in grown_of(trend.growths(runs)):
        remedy, whose = WORN[worn]
        yield Advice(
            WATCH,
            f"{remedy}: {whose} spread {times(grown.after / grown.before)} as far as"
            f" {then(alike, grown.runs)} ({grown.after:.4f} mm instead of"
            f" {grown.before:.4f}).",
            SPREAD,
        )
    for drift in trend.drifts(runs):
        words = WORDS[drift.height]
        yield Advice(
            WATCH,
            f"{words.remedy}: {words.by(drift.by)} than {then(alike, drift.runs)}.",
            drift.height,
        )


def grown_of(
    growths: Sequence[trend.Growth],
) -> Iterator[Tuple[str, trend.Growth]]:
    """Yield what is worn, a key of WORN, with how much the touches have grown.

    What nozzle and probe's body have in common is the switch of the pin.
    """
    by_site = {grown.site: grown for grown in growths}
    if {"nozzle", "switch"} <= by_site.keys():
        yield (
            PIN,
            max(
                by_site.pop("nozzle"),
                by_site.pop("switch"),
                key=lambda g: g.after,
            ),
        )
    yield from by_site.items()


def times(ratio: float) -> str:
    """Return a ratio as one says it."""
    low, high = TWICE
    if low <= ratio < high:
        return "twice"
    return f"{ratio:.0f} times" if ratio >= MANY else f"{ratio:.1f} times"


def then(alike: Sequence[Run], count: int) -> str:
    """Return when the first of the latest of these runs was, so many, as one says it."""
    first, last = alike[-count], alike[-1]
    if month(first) and month(first) != month(last):
        return f"in {month(first)}"
    return f"{count} runs ago"


def changes(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield what has changed at once, as long as it is news."""
    good = [number for number, run in enumerate(runs) if run.ok]
    news = good[-CHANGE_STAYS:]
    for change in trend.changes(runs):
        if news and change.number >= news[0]:
            words, when = WORDS[change.height], day(runs[change.number])
            yield Advice(
                WATCH,
                f"Look for what is loose, unless you {words.cause} before the run of"
                f" {when}: since then {words.by(change.by)}.",
                change.height,
            )


def cleanings(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield that the nozzle had to be cleaned often."""
    latest = runs[-LATEST:]
    count = sum(bool(run.cleaned) for run in latest)
    if count >= OFTEN:
        yield Advice(
            WATCH,
            "Clean the nozzle before CALIBRATE_Z, at a temperature at which it does not"
            f" drip: it had to be cleaned in {count} of the last {len(latest)} runs.",
            OFFSET,
        )


######################################################################
# What happened
######################################################################


def marks_of(runs: Sequence[Run]) -> List[Mark]:
    """Return what happened, in the order of the runs."""
    marks = [
        Mark(
            change.number, f"{WORDS[change.height].by(change.by)} from then on"
        )
        for change in trend.changes(runs)
    ]
    last: Optional[Run] = None
    for number, run in enumerate(runs):
        marks += [Mark(number, plain(warned.text)) for warned in run.warnings]
        if not run.ok:
            continue
        if last and abs(run.switch_offset - last.switch_offset) > SAME:
            marks.append(
                Mark(
                    number,
                    f"switch_offset was {last.switch_offset:.3f} and is"
                    f" {run.switch_offset:.3f}",
                )
            )
        last = run
    return sorted(marks, key=lambda mark: mark.number)
