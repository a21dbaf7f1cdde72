# What a measured offset is worth: pure functions; mm, and mm^2 for variances.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# 95 % of all offsets are no further from the truth than t / 1.96 * q, with t of
# Student's distribution, and q of a normal one about half a step, see reach(), that
# varies by u:
#
#   u^2 = sum over the sites of (s^2 / n + m + r^2)
#
# Where u is large, that is t times the root of u^2 + (step / 2)^2.
#
#   s      spread of one touch: of all touches of this run at the site, rejected
#          ones, too, pooled with that of its earlier runs, see recent.py
#   n      touches that count.  Their average is as exact as that, also where they
#          are the series that kept a tolerance: average and spread of normal
#          samples do not depend on each other
#   m      what the median of these is less exact, see median_excess()
#          Of a median s is that of the middle of the touches, see tails.py
#   r      what rounding to whole steps leaves, see rounding(); a median of an odd
#          number is as rounded as a touch.  It is known, and costs t nothing
#   step   of the Z motors: a touch ends on the step after the one at which it
#          triggered, half a step too low on average.  That of the switch cancels
#          that of the nozzle, that of the bed stays: the offset is half a step too
#          low.  Nobody corrects it, so that it is what the heights say.  Its sign is
#          known: as a variance it would make quiet printers look worse than they are
#
# The sum, the pooling and the degrees of freedom of t are those of the Guide to
# the Expression of Uncertainty in Measurement (JCGM 100:2008): 5.1.2, H.3.6
# and G.4.1 (Welch and Satterthwaite), these with the half step in the sum.

import collections
import math

from ..core.sampling import summarize

# Of one site: height (mm), its variance, the part of that which is of rounding,
# degrees of freedom (dof), the samples that count, how z comes of them, and the
# Spread of this run's touches
Estimate = collections.namedtuple(
    "Estimate", "z variance rounded dof kept method spread"
)


# Of a single touch: its variance, in how many degrees of freedom that is known, and,
# of one run, its standard deviation by absolute deviations (mm, None: nobody knows)
class Spread(collections.namedtuple("Spread", "variance dof absolute")):
    __slots__ = ()

    def __new__(cls, variance, dof, absolute=None):
        return super().__new__(cls, variance, dof, absolute)


UNKNOWN = Spread(0.0, 0)

# Student's t for 95 % on both sides, by degrees of freedom
T_95 = (
    (1, 12.706),
    (2, 4.303),
    (3, 3.182),
    (4, 2.776),
    (5, 2.571),
    (6, 2.447),
    (8, 2.306),
    (10, 2.228),
    (15, 2.131),
    (30, 2.042),
    (float("inf"), 1.960),
)

# Variance of the median of n normal samples, times n: Teichroew, Annals of
# Mathematical Statistics 27 (1956); its limit for many is pi / 2
MEDIAN_OF_10 = (1, 1, 1.346, 1.193, 1.434, 1.288, 1.473, 1.346, 1.495, 1.383)

# The usual noise (mm) of a switch, for whoever knows nothing better
USUAL_NOISE = 0.004

# Of a length of two standard deviations, so that a millionth of that is left
REACH_HALVINGS = 20

# Median of the absolute deviations from the median -> standard deviation, of
# many, and how much more for n = 1, 2 ... 10: Croux and Rousseeuw, Computational
# Statistics 1 (1992)
MAD_FACTOR = 1.4826
MAD_OF_10 = (1.0, 1.196, 1.495, 1.363, 1.206, 1.2, 1.14, 1.129, 1.107, 1.087)

# From so many standard deviations on a touch is an outlier: one in 2000 of
# normal ones is
OUTLIER = 3.5

# The spread of this run may be so many times the variance of its history, by
# its degrees of freedom, before that counts no more: 1 % of F with 20 below
F_99 = (8.1, 5.85, 4.94, 4.43, 4.1, 3.87, 3.7, 3.56, 3.46)


# Student's t, linear in 1 / dof between the entries, within 1 %
def t_factor(dof):
    if dof <= T_95[0][0]:
        return T_95[0][1]
    for (low, t_low), (high, t_high) in zip(T_95, T_95[1:]):
        if dof <= high:
            part = (1.0 / low - 1.0 / dof) / (1.0 / low - 1.0 / high)
            return t_low + part * (t_high - t_low)
    return T_95[-1][1]


# Variance of an average or median of n, in variances of one touch
def reduction(n, method):
    if method == "average":
        return 1.0 / n
    return (
        MEDIAN_OF_10[n - 1] if n <= len(MEDIAN_OF_10) else math.pi / 2.0
    ) / n


# The variance that rounding to whole steps leaves in an average of many: noise
# of more than a step takes it away, without noise it is step^2 / 12.  The
# Fourier series of the rounding error under normal noise: Widrow and Kollar,
# Quantization Noise (2008), chapter 4.
def rounding(variance, step):
    noise = max(0.0, variance - step**2 / 12.0)
    left = 0.0
    for k in range(1, 6):
        exponent = -noise * (2.0 * math.pi * k / step) ** 2
        left += math.exp(max(exponent, -700.0)) / k**2
    return left * step**2 / (2.0 * math.pi**2)


# Of the samples of one site in one run
def spread_of(samples):
    dof = len(samples) - 1
    if dof < 1:
        return UNKNOWN
    mean = math.fsum(samples) / len(samples)
    squares = math.fsum((z - mean) ** 2 for z in samples)
    far = math.fsum(abs(z - mean) for z in samples)
    usual = math.sqrt(2.0 / math.pi * len(samples) * dof)
    return Spread(squares / dof, dof, far / usual)


# A Spread of touches that were chosen to count, as they were close together: the choice
# costs a degree of freedom.
def after_choice(spread):
    if spread.dof < 2:
        return spread
    squares, dof = spread.variance * spread.dof, spread.dof - 1
    return spread._replace(variance=squares / dof, dof=dof)


# How many times as far apart samples may be where nobody but these few says how they
# vary: what is cut off of a noisy site by chance makes it look quiet.
def unsure(samples):
    return t_factor(len(samples) - 1) / t_factor(float("inf"))


# Of several runs together
def pool(spreads):
    spreads = [s for s in spreads if s.dof > 0]
    dof = sum(s.dof for s in spreads)
    if not dof:
        return UNKNOWN
    return Spread(math.fsum(s.variance * s.dof for s in spreads) / dof, dof)


# Whether this run is no noisier than its history.  Touches that always end on
# the same step have a variance of 0, and may end on the next one.
def is_usual(spread, earlier, step):
    if not (spread.dof and earlier.dof):
        return True
    limit = F_99[min(spread.dof, len(F_99)) - 1]
    return spread.variance <= limit * max(earlier.variance, step**2 / 4.0)


# The samples without those that are far from all others, in their order: first
# by their median, then, as that is a poor measure for few, by what is left.
# 'earlier': Spread of one touch in earlier runs; 'unknown': its standard deviation (mm)
# where these say nothing.
def without_outliers(samples, earlier, step, unknown=USUAL_NOISE):
    if len(samples) < 3:
        return list(samples)
    middle = summarize(samples, "median")
    distances = [abs(z - middle) for z in samples]
    usual = math.sqrt(earlier.variance) if earlier.dof else unknown
    usual = max(usual, step / 2.0)
    few = MAD_OF_10[min(len(samples), len(MAD_OF_10)) - 1]
    noise = few * MAD_FACTOR * summarize(distances, "median")
    if not earlier.dof:
        noise *= unsure(samples)
    kept = within(samples, middle, max(usual, noise))
    noise = math.sqrt(spread_of(kept).variance)
    if not earlier.dof:
        noise *= unsure(kept)
    return within(samples, summarize(kept, "average"), max(usual, noise))


def within(samples, middle, noise):
    return [z for z in samples if abs(z - middle) <= OUTLIER * noise]


# The variance that the median of samples has more than their average.  Of a
# series that kept a tolerance it is less than the spread of a touch says.
def median_excess(samples, spread, step):
    n, whole = len(samples), step**2 / 12.0
    within = min(spread.variance, spread_of(samples).variance)
    return max(within - whole, 0.0) * (reduction(n, "median") - 1.0 / n)


# The variance of the average or median of samples, by the Spread of a touch, and the
# part of it that is of rounding.  'middle': see tails.py
def variance_of(samples, spread, step, method, middle=1.0):
    n, whole = len(samples), step**2 / 12.0
    if method == "average" or n <= 2:
        rounded = rounding(spread.variance, step)
        return spread.variance / n + rounded, rounded
    # One of the samples is as rounded as any, the mean of two a bit less
    rounded = whole if n % 2 else 0.75 * whole
    part = middle * max(spread.variance - whole, 0.0) / n
    return part + median_excess(samples, spread, step) + rounded, rounded


# The Estimate of a site from the samples that count.  'touches': all of them,
# rejected ones, too; 'unknown' as in without_outliers()
def estimate(samples, earlier, step, method, touches=None, unknown=USUAL_NOISE):
    kept = without_outliers(touches or samples, earlier, step, unknown)
    z = summarize(samples, method)
    spread = spread_of(kept if touches else samples)
    if len(touches or samples) > len(samples):
        spread = after_choice(spread)
    result = Estimate(z, 0.0, 0.0, 0, list(samples), method, spread)
    usual = is_usual(spread, earlier, step)
    return weighed(result, pool((spread, earlier)) if usual else spread, step)


# The Estimate with what the Spread of a touch says about it
def weighed(result, spread, step, middle=1.0):
    if not spread.dof:
        return result._replace(variance=0.0, rounded=0.0, dof=0)
    variance, rounded = variance_of(
        result.kept, spread, step, result.method, middle
    )
    return result._replace(variance=variance, rounded=rounded, dof=spread.dof)


# The Estimate of a site from samples of which some may be outliers, and whose
# number depends on what they say: without a history that costs about two degrees
# of freedom.
def robust_estimate(samples, earlier, step, unknown=USUAL_NOISE):
    kept = without_outliers(samples, earlier, step, unknown)
    result = estimate(kept, earlier, step, "average", unknown=unknown)
    if 2 < result.dof <= result.spread.dof:
        result = result._replace(dof=result.dof - 2)
    return result


# How far from 0 (mm) 95 % of a normal distribution are, about 'bias'.
def reach(bias, sigma):
    low, high, root = bias, bias + 2.0 * sigma, sigma * math.sqrt(2.0)
    for _ in range(REACH_HALVINGS if sigma else 0):
        middle = (low + high) / 2.0
        ends = (middle - bias) / root, (middle + bias) / root
        if sum(map(math.erf, ends)) < 2.0 * 0.95:
            low = middle
        else:
            high = middle
    return high


# Of an offset (mm): half a step too low, with a variance that t says how well is known
def expand(t, variance, step):
    return t / t_factor(float("inf")) * reach(step / 2.0, math.sqrt(variance))


# What the offset may be off by (mm, 95 %), from the Estimates of all sites; None
# where nothing is known of the spread of one.  'is_shared': they were weighed by
# the same Spread.
def expanded(estimates, step, is_shared=False):
    if not all(e.dof for e in estimates):
        return None
    parts = [e.variance - e.rounded for e in estimates]
    below = math.fsum(v**2 / e.dof for v, e in zip(parts, estimates))
    if is_shared:
        below = math.fsum(parts) ** 2 / estimates[0].dof
    variance = math.fsum(e.variance for e in estimates)
    total = variance + step**2 / 4.0
    dof = total**2 / below if below else float("inf")
    return expand(t_factor(dof), variance, step)
