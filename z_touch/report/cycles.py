"""What varies in a CALIBRATE_Z_ACCURACY: pure functions; mm, s.

Touches of one site in one cycle vary by the noise of a touch. What varies more from
cycle to cycle comes from what is done between them: the probe is attached anew,
something grows, Z is homed. The heights tell which:

  the nozzle's first touch higher than the next ones    something sticks to it
  a straight line in time                               it grows
  switch and bed together, not the nozzle               the seat of the probe
  one of them only                                      what holds it
  touches of nozzle and switch, not of the bed          the switch of the pin
  touches of the bed only                               the probe's switch
  touches of all three                                  play of Z
  all three together, from cycle to cycle               homing, or lost steps

Differences of two sites come first: they are free of homing, which may hide that one of
the sites shifts.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from statistics import fmean
from typing import List, NamedTuple, Optional, Sequence, Tuple

from ..z_calibration.runs import SITES, Cycle, Run, offsets, uncertainty
from ..z_calibration.statistics import pool, spread_of, t_factor
from .noise import f_limit

Values = Sequence[float]
Cycles = Sequence[Cycle]


class Verdict(NamedTuple):
    """The cause that dominates, in a word, and a sentence."""

    cause: str
    text: str


# Less (mm) is no matter
GOOD_TOUCH = 0.007
GOOD_SHIFT = 0.008

# What an owner knows switch - nozzle as
DISTANCE = "distance of nozzle and probe"

# The cause of a printer that is as it should be
NO_CAUSE = "none"

# So many times the others a site is the one that varies
DOMINATES = 2.5

# Cycles that can tell a cause from chance
LEAST_CYCLES = 6

# From so many standard errors on something is there
SURE = 5.0

# A cause that acts from cycle to cycle makes them vary so many times more than
# touches do
MORE_THAN_TOUCHES = 3.0

# Less (mm, 95 %) of one calibration is nothing to do
WHOLE = 0.01

# A shift is more than what touches make of it from so many standard deviations of
# chance on
NO_CHANCE = 3.1

# By the correlation with both of them together one of two sites is the one that
# shifts: one in two hundred of ten cycles
CORRELATED = 0.8

# A second cause that is so much of the largest one is another one
SECOND = 0.5

# A first touch that is pressed flat loses within a cycle at least this part of
# what changes from one to the next; heat, which has more time for that, less
FLATTENED = 0.3

CAUSES = {
    "nozzle": "the nozzle's first touches are %.4f mm higher than its next"
    " ones: something sticks to it; clean the nozzle",
    "heat": "the %s drifts by %.4f mm per minute: something still grows; let it"
    " warm up",
    "seat": "switch and bed shift together by %.4f mm from cycle to cycle: the"
    " probe sits elsewhere each time; seat the probe",
    "either": "the nozzle shifts against switch and bed by %.4f mm from cycle"
    " to cycle, and homing hides which; clean the nozzle and seat the probe,"
    " then again",
    "alone": "only the %s shifts, by %.4f mm from cycle to cycle; check what"
    " holds it, and that it is clean",
    "pin": "touches of the pin vary by %.4f mm, those of the bed do not; exchange"
    " the switch of the pin",
    "probe": "touches of the bed vary by %.4f mm, those of the pin do not;"
    " exchange the probe's switch",
    "play": "touches of all three vary alike, by %.4f mm; check the Z axis for"
    " play",
    "homing": "all heights shift together by %.4f mm from cycle to cycle, which"
    " leaves the gap as it is; home again after levelling",
    "tip": "only the nozzle's touches vary, by %.4f mm; clean the nozzle",
    "body": "only touches with the probe's body vary, by %.4f mm; seat the probe",
    "most": "the %s shifts most, by %.4f mm from cycle to cycle; check what"
    " holds it, and that it is clean",
    "noise": "nothing shifts from cycle to cycle, and touches of the %s vary"
    " most, by %.4f mm; take more samples, or samples: auto",
    "several": "more than one thing varies: %s; begin with the first",
    "few": "%d cycles are too few for one; take %d or more",
    NO_CAUSE: "nothing stands out, the %s varies most (%.4f mm); nothing to do",
}

# Of "several"
PARTS = {
    "most": "the %s by %.4f mm",
    "homing": "homing by %.4f mm",
    "noise": "touches of the %s by %.4f mm",
}


######################################################################
# Figures
######################################################################


def heights(cycles: Cycles, site: str) -> List[float]:
    """Return the height of a site in each cycle."""
    return [fmean(cycle.touches(site)) for cycle in cycles]


def touch_noise(cycles: Cycles, site: str) -> float:
    """Return the standard deviation of one touch within a cycle."""
    spreads = [spread_of(cycle.touches(site)) for cycle in cycles]
    return math.sqrt(pool(spreads).variance)


def deviation(values: Values) -> float:
    """Return the standard deviation."""
    return math.sqrt(spread_of(values).variance)


def line(times: Values, values: Values) -> Tuple[float, float, float]:
    """Return the slope (mm/s), its standard error, and what is left (mm, sd)."""
    middle, mean = fmean(times), fmean(values)
    square = math.fsum((t - middle) ** 2 for t in times)
    if not square:
        return 0.0, math.inf, deviation(values)
    slope = (
        math.fsum((t - middle) * (v - mean) for t, v in zip(times, values))
        / square
    )
    rest = [v - slope * (t - middle) for t, v in zip(times, values)]
    sd = deviation(rest)
    return slope, sd / math.sqrt(square), sd


def excesses(cycles: Cycles, site: str) -> List[float]:
    """Return how much higher each first touch of a site is than the next ones."""
    values = []
    for cycle in cycles:
        first, *rest = cycle.touches(site)
        if rest:
            values.append(first - fmean(rest))
    return values


######################################################################
# The verdict
######################################################################


def judge_run(run: Run) -> Verdict:
    """Judge a CALIBRATE_Z_ACCURACY as it was kept."""
    return judge(run.cycles, run.step)


def judge(cycles: Cycles, step: float = 0.0) -> Verdict:
    """Look for one cause after the other, those that disturb the others first.

    Where none of them dominates, and the whole is too much, for the largest one. step:
    of the Z motors, mm.
    """
    if len(cycles) < LEAST_CYCLES:
        return Verdict("few", CAUSES["few"] % (len(cycles), LEAST_CYCLES))
    for find in (sticks, grows, shifts, homes, touches):
        verdict = find(cycles)
        if verdict is not None:
            return verdict
    if uncertainty(offsets(cycles), step) > WHOLE:
        return largest(cycles)
    return Verdict(NO_CAUSE, CAUSES[NO_CAUSE] % noisiest(cycles))


def noisiest(cycles: Cycles) -> Tuple[str, float]:
    """Return the site whose touches vary most, and by how much."""
    pairs = ((site, touch_noise(cycles, site)) for site in SITES)
    return max(pairs, key=lambda pair: pair[1])


def sticks(cycles: Cycles) -> Optional[Verdict]:
    """Look whether something sticks to the nozzle: its first touches are higher.

    Most of it may be pressed flat in the first cycles.
    """
    values = excesses(cycles, "nozzle")
    if not values:
        return None
    mean = fmean(values)
    noise = max(touch_noise(cycles, "switch"), touch_noise(cycles, "bed"))
    error = noise * math.sqrt(1.5 / len(values))
    z = heights(cycles, "nozzle")
    change = abs(z[-1] - z[0]) / (len(z) - 1)
    others = max(
        abs(fmean(excesses(cycles, site))) for site in ("switch", "bed")
    )
    if mean < max(SURE * error, GOOD_TOUCH / 2.0, FLATTENED * change):
        return None
    if mean < DOMINATES * others:
        return None
    return Verdict("nozzle", CAUSES["nozzle"] % (mean,))


def grows(cycles: Cycles) -> Optional[Verdict]:
    """Look whether something grows: a straight line in time.

    Few cycles lie on one by chance, one of the five series at least.
    """
    sure = SURE * (t_factor(len(cycles) - 2) / t_factor(math.inf)) ** 3
    times, drifts = [cycle.time for cycle in cycles], []
    z = {site: heights(cycles, site) for site in SITES}
    bodies = [s - n for s, n in zip(z["switch"], z["nozzle"])]
    named = [(site, z[site]) for site in SITES]
    named += [(DISTANCE, bodies), ("offset", offsets(cycles))]
    for name, values in named:
        slope, error, rest = line(times, values)
        shift = abs(slope) * (times[-1] - times[0])
        is_sure = abs(slope) > sure * error
        if is_sure and shift > max(GOOD_SHIFT, MORE_THAN_TOUCHES * rest):
            drifts.append((shift, name, 60.0 * slope))
    if not drifts:
        return None
    shift, name, drift = max(drifts)
    return Verdict("heat", CAUSES["heat"] % (name, drift))


def others_of(site: str) -> List[str]:
    """Return the other two sites."""
    return [other for other in SITES if other != site]


def apart(cycles: Cycles, one: str, other: str) -> Tuple[float, float]:
    """Return how the difference of two sites varies, and what touches make of that."""
    pairs = zip(heights(cycles, one), heights(cycles, other))
    squares = [touch_noise(cycles, site) ** 2 for site in (one, other)]
    noise = math.sqrt(math.fsum(squares) / len(cycles[0].nozzle))
    return deviation([a - b for a, b in pairs]), noise


def shift_alone(cycles: Cycles, site: str) -> float:
    """Return how much a site shifts against the other two.

    These do so less against each other.
    """
    a, b = others_of(site)
    squares = [
        apart(cycles, *p)[0] ** 2 for p in ((site, a), (site, b), (a, b))
    ]
    return math.sqrt(max(0.0, (squares[0] + squares[1] - squares[2]) / 2.0))


def shifts(cycles: Cycles) -> Optional[Verdict]:
    """Look whether one site shifts from cycle to cycle against the other two.

    The nozzle does where switch and bed shift together, with the seat of the probe:
    which of them it was the heights themselves tell.
    """
    for site in SITES:
        a, b = others_of(site)
        pairs = [apart(cycles, site, other) for other in (a, b)]
        limits = [max(GOOD_SHIFT, MORE_THAN_TOUCHES * p[1]) for p in pairs]
        rest, least = apart(cycles, a, b)[0], min(p[0] for p in pairs)
        is_sure = all(p[0] > limit for p, limit in zip(pairs, limits))
        if not is_sure or least < DOMINATES * rest:
            continue
        shift = shift_alone(cycles, site)
        if site != "nozzle":
            return Verdict("alone", CAUSES["alone"] % (site, shift))
        return nozzle_or_seat(cycles, shift)
    return None


def nozzle_or_seat(cycles: Cycles, shift: float) -> Verdict:
    """Tell which of them shifts, as far as homing does not hide it."""
    pairs = zip(heights(cycles, "switch"), heights(cycles, "nozzle"))
    correlated = correlation([(s - n, s + n) for s, n in pairs])
    if correlated > CORRELATED:
        return Verdict("seat", CAUSES["seat"] % (shift,))
    if correlated < -CORRELATED:
        return Verdict("alone", CAUSES["alone"] % ("nozzle", shift))
    return Verdict("either", CAUSES["either"] % (shift,))


def correlation(pairs: Sequence[Tuple[float, float]]) -> float:
    """Return the correlation of pairs of values."""
    a, b = ([v - fmean(values) for v in values] for values in zip(*pairs))
    squares = [math.fsum(v**2 for v in values) for values in (a, b)]
    if not all(squares):
        return 0.0
    product = math.fsum(v * w for v, w in zip(a, b))
    return product / math.sqrt(squares[0] * squares[1])


def common_shift(cycles: Cycles) -> Tuple[float, float]:
    """Return how much all sites shift together, and what touches make of that."""
    z = [heights(cycles, site) for site in SITES]
    squares = [touch_noise(cycles, site) ** 2 for site in SITES]
    noise = math.sqrt(math.fsum(squares) / len(cycles[0].nozzle)) / 3.0
    return deviation([math.fsum(h) / 3.0 for h in zip(*z)]), noise


def homes(cycles: Cycles) -> Optional[Verdict]:
    """Look whether all three shift together, with the homing of Z."""
    shift, _ = common_shift(cycles)
    most = noisiest(cycles)[1] / math.sqrt(len(cycles[0].nozzle))
    between = [
        apart(cycles, *pair)[0]
        for pair in (("switch", "nozzle"), ("bed", "switch"))
    ]
    limits = GOOD_SHIFT, MORE_THAN_TOUCHES * most, DOMINATES * max(between)
    if shift > max(limits):
        return Verdict("homing", CAUSES["homing"] % (shift,))
    return None


def is_no_chance(cycles: Cycles, shift: float, noise: float) -> bool:
    """Tell whether a deviation is more than what touches make of it."""
    dof = len(cycles) - 1
    # Of two sites at least
    below = 2 * len(cycles) * (len(cycles[0].nozzle) - 1)
    if not below:
        return False
    return shift**2 > f_limit(dof, below, NO_CHANCE) * noise**2


def largest(cycles: Cycles) -> Verdict:
    """Return what varies most, where nothing dominates."""
    causes: List[Tuple[float, str, str]] = []
    for site in SITES:
        pairs = [apart(cycles, site, other) for other in others_of(site)]
        if all(is_no_chance(cycles, *pair) for pair in pairs):
            causes.append((shift_alone(cycles, site), "most", site))
    shift, noise = common_shift(cycles)
    if is_no_chance(cycles, shift, noise) and not causes:
        causes.append((shift, "homing", ""))
    site, most = noisiest(cycles)
    causes.append((most / math.sqrt(len(cycles[0].nozzle)), "noise", site))
    causes.sort(reverse=True)
    if causes[1:] and causes[1][0] > SECOND * causes[0][0]:
        parts = [
            PARTS[kind] % ((site, size) if site else size)
            for size, kind, site in causes
            if size > SECOND * causes[0][0]
        ]
        return Verdict("several", CAUSES["several"] % (", ".join(parts),))
    size, kind, site = causes[0]
    if kind == "homing":
        return Verdict(kind, CAUSES[kind] % (size,))
    return Verdict(
        kind, CAUSES[kind] % (site, most if kind == "noise" else size)
    )


def touches(cycles: Cycles) -> Optional[Verdict]:
    """Look whether the touches within a cycle vary: a switch, or play."""
    nozzle, switch, bed = (touch_noise(cycles, site) for site in SITES)
    most, least = max(nozzle, switch, bed), min(nozzle, switch, bed)
    if most < GOOD_TOUCH:
        return None
    pin = min(nozzle, switch)
    for cause, is_it in (
        ("probe", bed > DOMINATES * max(nozzle, switch)),
        ("pin", pin > max(GOOD_TOUCH, DOMINATES * bed)),
        ("tip", nozzle > DOMINATES * max(switch, bed)),
        ("body", switch > DOMINATES * max(nozzle, bed)),
        ("play", least > GOOD_TOUCH and most < DOMINATES * least),
    ):
        if is_it:
            return Verdict(cause, CAUSES[cause] % (most,))
    return None
