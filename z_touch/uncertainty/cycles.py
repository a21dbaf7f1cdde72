# What several whole cycles of a calibration say: pure functions; mm, s.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Touches of one site in one cycle vary by the noise of a touch.  What varies
# more from cycle to cycle comes from what is done between them: the probe is
# attached anew, something grows, Z is homed.  The heights tell which:
#
#   the nozzle's first touch higher than the next ones    something sticks to it
#   a straight line in time                               it grows
#   switch and bed together, not the nozzle               the seat of the probe
#   one of them only                                      what holds it
#   touches of nozzle and switch, not of the bed          the switch of the pin
#   touches of the bed only                               the probe's switch
#   touches of all three                                  play of Z
#   all three together, from cycle to cycle               homing, or lost steps
#
# Differences of two sites come first: they are free of homing, which may hide that
# one of the sites shifts.

import collections
import math

from ..core.sampling import summarize
from .estimate import pool, spread_of, t_factor
from .recent import f_limit

# One cycle: when it ended (s), the samples of each site, toolhead Z (mm), and the
# switch_offset that was reckoned with (mm)
Cycle = collections.namedtuple("Cycle", "time nozzle switch bed switch_offset")

# Of a series of heights: 'drift' in mm per minute, 'consecutive' is the
# standard deviation by the differences of neighbours, which a drift leaves
# nearly as it is, 'touch' that of one touch (None: of no site)
Series = collections.namedtuple(
    "Series", "name mean sd range drift consecutive touch"
)

# The cause that dominates, in a word, and the sentence that the user is told
Verdict = collections.namedtuple("Verdict", "cause text")

# Less (mm) is no matter
GOOD_TOUCH = 0.007
GOOD_SHIFT = 0.008

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
    " probe hangs elsewhere each time; seat the probe",
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

SITES = ("nozzle", "switch", "bed")


######################################################################
# Figures
######################################################################


# The height of a site in each cycle (mm)
def heights(cycles, site):
    return [summarize(getattr(cycle, site), "average") for cycle in cycles]


# The offset of each cycle (mm)
def offsets(cycles):
    parts = zip(*[heights(cycles, site) for site in SITES])
    return [
        bed - (switch - nozzle + cycle.switch_offset)
        for (nozzle, switch, bed), cycle in zip(parts, cycles)
    ]


# Standard deviation (mm) of one touch within a cycle
def touch_noise(cycles, site):
    spreads = [spread_of(getattr(cycle, site)) for cycle in cycles]
    return math.sqrt(pool(spreads).variance)


# Standard deviation
def deviation(values):
    return math.sqrt(spread_of(values).variance)


# Standard deviation by the differences of neighbours: von Neumann, Annals of
# Mathematical Statistics 12 (1941)
def consecutive(values):
    squares = [(b - a) ** 2 for a, b in zip(values, values[1:])]
    return math.sqrt(math.fsum(squares) / (2.0 * len(squares)))


# Slope (mm/s), its standard error, and what a straight line leaves (mm, sd)
def line(times, values):
    middle = math.fsum(times) / len(times)
    mean = math.fsum(values) / len(values)
    square = math.fsum((t - middle) ** 2 for t in times)
    if not square:
        return 0.0, float("inf"), deviation(values)
    slope = (
        math.fsum((t - middle) * (v - mean) for t, v in zip(times, values))
        / square
    )
    rest = [v - slope * (t - middle) for t, v in zip(times, values)]
    sd = deviation(rest)
    return slope, sd / math.sqrt(square), sd


# The Series of each site and of the offset
def series(cycles):
    times, figures = [cycle.time for cycle in cycles], []
    for name in SITES + ("offset",):
        is_site = name != "offset"
        values = heights(cycles, name) if is_site else offsets(cycles)
        figures.append(
            Series(
                name,
                math.fsum(values) / len(values),
                deviation(values),
                max(values) - min(values),
                60.0 * line(times, values)[0],
                consecutive(values),
                touch_noise(cycles, name) if is_site else None,
            )
        )
    return figures


# What a single calibration may be off by (mm at 95 %), as its cycles vary
def uncertainty(cycles, step):
    values = offsets(cycles)
    u = math.sqrt(spread_of(values).variance + step**2 / 4.0)
    return t_factor(len(values) - 1) * u


# How much higher (mm) each first touch of a site is than the next ones
def excesses(cycles, site):
    values = []
    for cycle in cycles:
        first, rest = getattr(cycle, site)[0], getattr(cycle, site)[1:]
        if rest:
            values.append(first - math.fsum(rest) / len(rest))
    return values


######################################################################
# The verdict
######################################################################


# Looks for one cause after the other, those that disturb the others first; where
# none of them dominates, and the whole is too much, for the largest one.  'step': of
# the Z motors.  Returns the Verdict.
def judge(cycles, step=0.0):
    if len(cycles) < LEAST_CYCLES:
        return Verdict("few", CAUSES["few"] % (len(cycles), LEAST_CYCLES))
    for find in (sticks, grows, shifts, homes, touches):
        verdict = find(cycles)
        if verdict is not None:
            return verdict
    if uncertainty(cycles, step) > WHOLE:
        return largest(cycles)
    return Verdict(NO_CAUSE, CAUSES[NO_CAUSE] % noisiest(cycles))


# The site whose touches vary most, and by how much (mm)
def noisiest(cycles):
    pairs = ((site, touch_noise(cycles, site)) for site in SITES)
    return max(pairs, key=lambda pair: pair[1])


# Something sticks to the nozzle: its first touch is higher than the next ones.
# Most of it may be pressed flat in the first cycles.
def sticks(cycles):
    values = excesses(cycles, "nozzle")
    if not values:
        return None
    mean = math.fsum(values) / len(values)
    noise = max(touch_noise(cycles, "switch"), touch_noise(cycles, "bed"))
    error = noise * math.sqrt(1.5 / len(values))
    z = heights(cycles, "nozzle")
    change = abs(z[-1] - z[0]) / (len(z) - 1)
    others = max(
        abs(math.fsum(e) / len(e))
        for e in (excesses(cycles, "switch"), excesses(cycles, "bed"))
    )
    if mean < max(SURE * error, GOOD_TOUCH / 2.0, FLATTENED * change):
        return None
    if mean < DOMINATES * others:
        return None
    return Verdict("nozzle", CAUSES["nozzle"] % (mean,))


# Something grows: a straight line in time.  Few cycles lie on one by chance, one of
# the five series at least.
def grows(cycles):
    sure = SURE * (t_factor(len(cycles) - 2) / t_factor(float("inf"))) ** 3
    times, drifts = [cycle.time for cycle in cycles], []
    z = dict((site, heights(cycles, site)) for site in SITES)
    bodies = [s - n for s, n in zip(z["switch"], z["nozzle"])]
    named = [(site, z[site]) for site in SITES]
    named += [("switch - nozzle", bodies), ("offset", offsets(cycles))]
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


# The other two sites
def others_of(site):
    return [other for other in SITES if other != site]


# Standard deviation (mm) of the difference of two sites, and what touches make of it
def apart(cycles, one, other):
    pairs = zip(heights(cycles, one), heights(cycles, other))
    squares = [touch_noise(cycles, site) ** 2 for site in (one, other)]
    noise = math.sqrt(math.fsum(squares) / len(cycles[0].nozzle))
    return deviation([a - b for a, b in pairs]), noise


# How much a site shifts (mm) against the other two, which do so less against each
# other
def shift_alone(cycles, site):
    a, b = others_of(site)
    squares = [
        apart(cycles, *p)[0] ** 2 for p in ((site, a), (site, b), (a, b))
    ]
    return math.sqrt(max(0.0, (squares[0] + squares[1] - squares[2]) / 2.0))


# One site shifts from cycle to cycle against the other two.  The nozzle does where
# switch and bed shift together, with the seat of the probe: which of them it was the
# heights themselves tell.
def shifts(cycles):
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


def nozzle_or_seat(cycles, shift):
    pairs = zip(heights(cycles, "switch"), heights(cycles, "nozzle"))
    correlated = correlation([(s - n, s + n) for s, n in pairs])
    if correlated > CORRELATED:
        return Verdict("seat", CAUSES["seat"] % (shift,))
    if correlated < -CORRELATED:
        return Verdict("alone", CAUSES["alone"] % ("nozzle", shift))
    return Verdict("either", CAUSES["either"] % (shift,))


def correlation(pairs):
    a, b = [
        [v - math.fsum(values) / len(values) for v in values]
        for values in zip(*pairs)
    ]
    squares = [math.fsum(v**2 for v in values) for values in (a, b)]
    if not all(squares):
        return 0.0
    product = math.fsum(v * w for v, w in zip(a, b))
    return product / math.sqrt(squares[0] * squares[1])


# How much all sites shift together (mm), and what touches make of that
def common_shift(cycles):
    z = [heights(cycles, site) for site in SITES]
    squares = [touch_noise(cycles, site) ** 2 for site in SITES]
    noise = math.sqrt(math.fsum(squares) / len(cycles[0].nozzle)) / 3.0
    return deviation([math.fsum(h) / 3.0 for h in zip(*z)]), noise


# All three shift together with the homing of Z
def homes(cycles):
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


# Whether a deviation (mm) is more than what touches make of it
def is_no_chance(cycles, shift, noise):
    dof = len(cycles) - 1
    # Of two sites at least
    below = 2 * len(cycles) * (len(cycles[0].nozzle) - 1)
    return below and shift**2 > f_limit(dof, below, NO_CHANCE) * noise**2


# What varies most, where nothing dominates
def largest(cycles):
    causes = []
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


# The touches within a cycle vary: a switch, or play.
def touches(cycles):
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


######################################################################
# In words
######################################################################


# Lines for the console.  'seconds': how long one cycle took
def tell(cycles, step, seconds):
    for one in series(cycles):
        text = (
            "%s: mean %.6f, standard deviation %.6f, range %.6f, drift %.6f"
            " per minute, consecutive difference %.6f"
        ) % one[:-1]
        if one.touch is not None:
            text += ", of a touch %.6f" % (one.touch,)
        yield text
    yield "one CALIBRATE_Z: +-%.4f mm, %.1f s" % (
        uncertainty(cycles, step),
        seconds,
    )
    yield "verdict: %s" % (judge(cycles, step).text,)
