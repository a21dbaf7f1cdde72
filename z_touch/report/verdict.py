"""What to do by a history, in words; and what happened in it, when.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

# Its texts are no messages: they are drawn.

from __future__ import annotations

from typing import Iterator, List, NamedTuple, Optional, Sequence, Tuple

from ..z_calibration.runs import BODY, LEAST_RUNS, SITES, Run
from . import cycles, trend
from .days import day

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


class Verdict(NamedTuple):
    """GOOD, WATCH or ACT; and on what, with what to do."""

    level: str
    texts: List[str]


class Mark(NamedTuple):
    """Something that happened at one run: its number among the runs, and a text."""

    number: int
    text: str


Advice = Tuple[str, str]

# What to do where a height drifts, and what changes it at once, by trend.HEIGHTS
REMEDIES = {
    "nozzle height": "check the switch that the nozzle presses, and what homes Z",
    "switch - nozzle": "check nozzle, probe and their seat for wear",
    "probe - switch": "check the bed and the probe's switch for wear",
}
CAUSES = {
    "nozzle height": "a new position_endstop does that, another nozzle, or what homes Z",
    "switch - nozzle": "another nozzle does that, another probe, or how it is seated",
    "probe - switch": "another plate does that, or another probe",
}

# What to do where the touches of a site vary much, or ever more
STEADIER = {
    "nozzle": "clean the nozzle, then check the switch under it",
    "switch": "check how the probe is seated, and the switch under it",
    "bed": "check how the probe is seated, and its switch for wear",
}


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
        return Verdict(WATCH, ["There are no runs yet; run CALIBRATE_Z."])
    if runs:
        for rule in (refusals, warnings, worth, wear, changes, cleanings):
            advices += rule(runs)
    # sorted() keeps the order of those of one level
    advices = sorted(advices, key=lambda entry: -LEVELS.index(entry[0]))
    if advices:
        return Verdict(advices[0][0], [text for _, text in advices])
    texts = [nothing_to_do(runs[-1])]
    lack = LEAST_RUNS - sum(run.ok for run in runs)
    if lack > 0:
        texts.append(
            f"New runs are compared with these after {lack} more good ones."
        )
    return Verdict(GOOD, texts)


def of_cycles(accuracy: Run) -> Advice:
    """Return the verdict of CALIBRATE_Z_ACCURACY.

    What repeats within minutes is all that it sees: dirt that is hard, and a part that
    has moved, are seen by the runs before it.
    """
    found = cycles.judge_run(accuracy)
    level = GOOD if found.cause == cycles.NO_CAUSE else WATCH
    return level, sentence(f"Accuracy run: {found.text}")


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
        yield ACT, sentence(f"The last run was refused: {why}")
    elif len(refused) >= OFTEN:
        count, why = min(LATEST, len(runs)), refused[-1].reason or UNKNOWN
        yield (
            WATCH,
            sentence(
                f"{len(refused)} of the last {count} runs were refused, the last one on"
                f" {day(refused[-1])}: {why}"
            ),
        )


def warnings(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield what the last run has warned of."""
    for warned in runs[-1].warnings:
        is_of_touches = warned.about in OF_TOUCHES
        yield ACT if is_of_touches else WATCH, sentence(warned.text)


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
    yield (
        ACT if last.uncertainty > POOR_WORTH else WATCH,
        f"The offset is known to +-{last.uncertainty:.3f} mm only; most of it are the"
        f" {site}'s touches, which vary by {last.sites[site].sd:.4f} mm;"
        f" {STEADIER[site]}, or set samples: auto, which takes as many touches as"
        " it needs.",
    )


def variance(run: Run, site: str) -> float:
    """Return the variance of the height of a site (mm^2)."""
    kept = run.sites[site]
    return kept.sd**2 / max(1, len(kept.samples))


def wear(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield what drifts, and what varies ever more."""
    for drift in trend.drifts(runs):
        yield (
            WATCH,
            sentence(
                f"{drift.height} has drifted by {drift.by:.3f} mm in the last"
                f" {drift.runs} runs; {REMEDIES[drift.height]}"
            ),
        )
    for grown in trend.growths(runs):
        yield (
            WATCH,
            sentence(
                f"spread of the {grown.site}'s touches has grown from"
                f" {grown.before:.4f} to {grown.after:.4f} mm in the last {grown.runs}"
                f" runs; {STEADIER[grown.site]}"
            ),
        )


def changes(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield what has changed at once, as long as it is news."""
    good = [number for number, run in enumerate(runs) if run.ok]
    news = good[-CHANGE_STAYS:]
    for change in trend.changes(runs):
        if news and change.number >= news[0]:
            yield (
                WATCH,
                sentence(
                    f"{change.height} changed by {change.by:.3f} mm on"
                    f" {day(runs[change.number])}, between two runs:"
                    f" {CAUSES[change.height]}; otherwise look for what is loose"
                ),
            )


def cleanings(runs: Sequence[Run]) -> Iterator[Advice]:
    """Yield that the nozzle had to be cleaned often."""
    latest = runs[-LATEST:]
    count = sum(bool(run.cleaned) for run in latest)
    if count >= OFTEN:
        yield (
            WATCH,
            f"The nozzle had to be cleaned in {count} of the last {len(latest)} runs;"
            " clean it before CALIBRATE_Z, at a temperature at which it does not drip.",
        )


######################################################################
# What happened
######################################################################


def marks_of(runs: Sequence[Run]) -> List[Mark]:
    """Return what happened, in the order of the runs."""
    marks = [
        Mark(
            change.number,
            f"{change.height} changed by {change.by:.3f} mm",
        )
        for change in trend.changes(runs)
    ]
    last: Optional[Run] = None
    for number, run in enumerate(runs):
        marks += [Mark(number, warned.text) for warned in run.warnings]
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
