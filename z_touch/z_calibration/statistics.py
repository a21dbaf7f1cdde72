"""How often each place is touched, and how far the offset may be off: pure functions.

The offset is made of the heights of three places: bed - (switch - nozzle +
switch_offset).  Each height is the average, or the median, of n touches, which vary from
touch to touch by a standard deviation s.  In 95 of 100 runs the true offset is no farther
away than its uncertainty

    t / 1.96 * q    with    u^2 = sum over the places of (s^2 / n + r^2)

  s   of one touch at that place: of all touches of this run, those of rejected series,
      too, pooled with those of the last runs.  Outliers of a run, and runs that are an
      accident, are left out.  Where this run is clearly noisier than the ones before,
      it counts alone
  r   what rounding to whole steps leaves, see left_of_rounding()
  q   95 of 100 values are no farther from 0 than that, of a normal distribution with
      mean step / 2 and standard deviation u: a touch ends on the step after the one at
      which the switch has triggered, half a step too low.  In the offset the half steps
      of nozzle and switch cancel, that of the bed stays
  t   Student's, as s is known by few touches (degrees of freedom, dof)

Sums, pooling and degrees of freedom are those of the Guide to the Expression of
Uncertainty in Measurement (JCGM 100:2008): 5.1.2, H.3.6 and G.4.1 (Welch and
Satterthwaite).  Heights (toolhead Z, upwards), steps and standard deviations are in mm,
variances in mm^2.

With `samples: auto` a place is touched until the uncertainty would be no more than
target_uncertainty if the places to come turned out as this one.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from ..errors import SamplesDiffer
from ..sampling import Sampling, summarize
from ..texture import ROUGH, TEXTURE

# Touches of one place with `samples: auto`: where earlier runs say how they vary, where
# they do not (fewer agree by chance too often), and at most
LEAST = 2
LEAST_AT_FIRST = 5
MOST = 10

# So many degrees of freedom in earlier runs say how touches of a place vary
HISTORY = 8

# The standard deviation (mm) of a usual switch, where earlier runs say nothing
USUAL_NOISE = 0.004

# A touch is an outlier from so many standard deviations on: one in 2000 of normal ones
# is.  Three others have to speak against it.
OUTLIER = 3.5
AGAINST_ONE = 3

# A run is an accident where its touches vary so many times more than is usual among runs
ACCIDENT = 5.0

# A run is noisier than the ones before where the sum of its squares is so many standard
# deviations above what is expected
NOISIER = 3.0

# More (mm) is no noise, as a standard deviation, or as the distance of so many touches
# from all others: something moves.  A switch of 10 um stays well below.
SOMETHING_MOVES = 0.05
FAR_ONES = 3

# Something soft sticks to a nozzle where its first touch is so many standard deviations
# higher than the next ones, or where so many touches are each lower than the one before:
# with a history, without one
STICKS = 3.0
FALLING = 3
FALLING_AT_FIRST = 4

# With `samples: auto` the touches themselves decide how many there are, and those that
# look quiet by chance end the series: so much of their degrees of freedom is left
CHOSEN = 0.4

DOUBT = "the touches do not agree"

# Of a normal distribution: 95 % are within so many standard deviations on both sides, or
# on one; and the median of the absolute deviations is one standard deviation by this
BOTH_SIDES = 1.960
ONE_SIDE = 1.645
MAD_FACTOR = 1.4826

# Variance of the median of n normal samples, times n: Teichroew, Annals of Mathematical
# Statistics 27 (1956); of many it is pi / 2
MEDIAN_OF_10 = (1, 1, 1.346, 1.193, 1.434, 1.288, 1.473, 1.346, 1.495, 1.383)


@dataclass(frozen=True)
class Spread:
    """How one touch of a place varies: variance (mm^2), known by dof degrees of freedom.

    Of no degrees nothing is known.
    """

    variance: float
    dof: float


UNKNOWN = Spread(0.0, 0)


@dataclass(frozen=True)
class Estimate:
    """The height z (toolhead Z, mm) of a place, and the samples and the Spread behind it.

    method says how z comes of the samples: "average" or "median".
    """

    z: float
    samples: Sequence[float]
    method: str
    spread: Spread


######################################################################
# Spreads
######################################################################


def spread_of(samples: Sequence[float]) -> Spread:
    """Return the Spread of the samples (mm) of one place in one run."""
    dof = len(samples) - 1
    if dof < 1:
        return UNKNOWN
    mean = math.fsum(samples) / len(samples)
    return Spread(math.fsum((z - mean) ** 2 for z in samples) / dof, dof)


def pool(spreads: Sequence[Spread]) -> Spread:
    """Return what several runs say together: each counts by its degrees of freedom."""
    dof = sum(spread.dof for spread in spreads)
    if not dof:
        return UNKNOWN
    squares = math.fsum(s.variance * s.dof for s in spreads)
    return Spread(squares / dof, dof)


def pool_usual(spreads: Sequence[Spread], step: float) -> Spread:
    """Return pool() of runs, without those that are far noisier than most: accidents."""
    known = [spread for spread in spreads if spread.dof]
    if not known:
        return UNKNOWN
    noises = [math.sqrt(spread.variance) for spread in known]
    middle, deviation = middle_of(noises)
    limit = middle + ACCIDENT * max(deviation, step / 2.0)
    return pool([s for s, noise in zip(known, noises) if noise <= limit])


def middle_of(values: Sequence[float]) -> Tuple[float, float]:
    """Return the median of two or more values, and their standard deviation by MAD.

    That is by the median of the absolute deviations, which single values far off do not
    change; by Student's t it is the larger the fewer values there are.
    """
    middle = summarize(values, "median")
    deviation = summarize([abs(v - middle) for v in values], "median")
    few = t_factor(len(values) - 1) / BOTH_SIDES
    return middle, few * MAD_FACTOR * deviation


def without_outliers(samples: Sequence[float], usual: float) -> List[float]:
    """Return the samples that are not far from all others, in their order.

    usual: the standard deviation (mm) that they have at least; a few agree by chance.
    """
    if len(samples) < 3:
        return list(samples)
    middle, deviation = middle_of(samples)
    limit = OUTLIER * max(deviation, usual)
    return [z for z in samples if abs(z - middle) <= limit]


######################################################################
# Uncertainty
######################################################################


def t_factor(dof: float) -> float:
    """Return Student's t for 95 % on both sides, within 2 % from one degree on.

    Abramowitz and Stegun, 26.7.5, but for the last coefficient, which makes it right at 1.
    """
    part = 1.0 / max(dof, 1.0)
    rest = 2.372 + part * (2.822 + part * (2.556 + part * 2.996))
    return BOTH_SIDES + part * rest


def left_of_rounding(variance: float, step: float) -> float:
    """Return the variance that rounding to whole steps leaves in an average (mm^2).

    Of touches on one step it is that of a whole step, the more they vary (variance) the
    less: Widrow and Kollar, Quantization Noise (2008), chapter 4, have it as a sum of
    which this is no less, and at both ends the same.
    """
    noise = max(variance - step**2 / 12.0, 0.0)
    exponent = noise * (2.0 * math.pi / step) ** 2
    return step**2 / 12.0 * math.exp(-min(exponent, 700.0))


def variances_of(estimate: Estimate, step: float) -> Tuple[float, float]:
    """Return the variance of z by its spread, and that of rounding (mm^2).

    The second one is known: it costs no degrees of freedom.
    """
    n, variance = len(estimate.samples), estimate.spread.variance
    if estimate.method == "average" or n <= 2:
        return variance / n, left_of_rounding(variance, step)
    # One of the touches, as rounded as any.  By how much it is off their average depends
    # on how far apart these are, which samples_tolerance limits.
    rounded = step**2 / 12.0
    own = min(variance, spread_of(estimate.samples).variance)
    factor = MEDIAN_OF_10[n - 1] if n <= len(MEDIAN_OF_10) else math.pi / 2.0
    varied = max(variance - rounded, 0.0)
    varied += (factor - 1.0) * max(own - rounded, 0.0)
    return varied / n, rounded


def reach(mean: float, sigma: float) -> float:
    """Return how far from 0 (mm) 95 % of a normal distribution are, within 1 %.

    With a mean that is large beside sigma only the far side counts; else mean and sigma
    add up as variances.
    """
    if mean > 0.6 * sigma:
        return mean + ONE_SIDE * sigma
    return BOTH_SIDES * math.hypot(mean, sigma)


def uncertainty_of(
    estimates: Sequence[Estimate], step: float
) -> Optional[float]:
    """Return what the offset of all places may be off by (mm, 95 %).

    None where nothing is known of the spread of one.
    """
    below, whole = 0.0, 0.0
    for estimate in estimates:
        if not estimate.spread.dof:
            return None
        varied, rounded = variances_of(estimate, step)
        below += varied**2 / estimate.spread.dof
        whole += varied + rounded
    dof = (whole + step**2 / 4.0) ** 2 / below if below else math.inf
    return t_factor(dof) / BOTH_SIDES * reach(step / 2.0, math.sqrt(whole))


def least_uncertainty(step: float) -> float:
    """Return the best uncertainty (mm, 95 %), with MOST touches of each of three places.

    With little noise all of them end on the same step, with much they vary.
    """
    variances = [(step * part / 50.0) ** 2 for part in range(100)]
    best = min(v / MOST + left_of_rounding(v, step) for v in variances)
    return reach(step / 2.0, math.sqrt(3.0 * best))


def impossible(target: Optional[float], step: float) -> str:
    """Return why no run can keep a target_uncertainty (mm), in words; empty: it may.

    target is None with a fixed number of touches; step is that of the motors of Z (mm).
    """
    least = least_uncertainty(step)
    if target is None or target >= least:
        return ""
    return (
        f"target_uncertainty {target:g} is less than what steps of {step:g} mm of Z"
        f" allow: each run ends at about {least:.4f}, at best; set it to that, or raise"
        " microsteps"
    )


######################################################################
# What is pressed flat
######################################################################


def first_excess(touches: Sequence[float], noise: float) -> float:
    """Return by how much (mm) the first touch was higher than the next ones.

    noise: standard deviation of a touch (mm); 0 where it is no more than that.
    """
    rest = touches[1:]
    if not rest:
        return 0.0
    excess = touches[0] - math.fsum(rest) / len(rest)
    limit = STICKS * noise * math.sqrt(1.0 + 1.0 / len(rest))
    return excess if excess > limit else 0.0


def steady_fall(touches: Sequence[float], least: int, noise: float) -> float:
    """Return by how much (mm) touches fell, from the first to the last.

    0 unless each of them, and they are at least so many, was lower than the one before,
    by more than noise in all: their standard deviation (mm).
    """
    falls = [a - b for a, b in zip(touches, touches[1:])]
    if len(touches) < least or min(falls) <= 0.0:
        return 0.0
    fall = touches[0] - touches[-1]
    return fall if fall > STICKS * math.sqrt(2.0) * noise else 0.0


######################################################################
# One run
######################################################################


class RunStatistics:
    """The touches of one run, by place, and what they say.

    step: of the motors of Z (mm).  earlier_runs: by place, in the order in which they are
    touched, the Spreads of a touch in its last runs.  target: target_uncertainty (mm,
    95 %) with `samples: auto`; None: a fixed number of touches.  rough: places that are
    touched at several points of a textured plate.  turn: counts the runs that were, see
    spread_site().

    touches has all touches of a place, samples those of the series that counts, estimates
    its Estimate, points X and Y (mm) of each touch of the bed, with bed_spread.
    """

    def __init__(
        self,
        step: float,
        earlier_runs: Mapping[str, Sequence[Spread]],
        target: Optional[float] = None,
        rough: Sequence[str] = (),
        turn: int = 0,
    ) -> None:
        self.step = step
        self.turn = turn
        self.target = target
        self.rough = rough
        self.earlier: Dict[str, Spread] = {
            place: pool_usual(spreads, step)
            for place, spreads in earlier_runs.items()
        }
        self.touches: Dict[str, List[float]] = {}
        self.samples: Dict[str, List[float]] = {}
        self.estimates: Dict[str, Estimate] = {}
        self.points: List[Tuple[float, float]] = []
        self.differed = False

    def begin(self, place: str, sampling: Sampling) -> Series:
        """Return the Series of a place, which is touched from the beginning."""
        self.estimates.pop(place, None)
        series = Series(self, place, sampling)
        self.touches[place] = series.touches
        return series

    def expected_touches(self, sampling: Sampling) -> int:
        """Return how often a place will be touched at least, if all is well."""
        if self.target is None:
            return int(sampling.samples)
        is_known = all(map(self.is_known, self.earlier))
        return LEAST if is_known else LEAST_AT_FIRST

    def most_touches(self, place: str) -> int:
        """Return how often a place may be touched, with `samples: auto`.

        The last one has what the places before it have left: they are not touched again.
        """
        others = [name for name in self.earlier if name != place]
        if any(name not in self.estimates for name in others):
            return MOST
        used = sum(len(self.touches[name]) for name in others)
        return MOST * len(self.earlier) - used

    def keep(
        self, place: str, estimate: Estimate, samples: List[float]
    ) -> None:
        """End the Series of a place with its Estimate."""
        self.samples[place] = samples
        self.estimates[place] = estimate

    def error(self, text: str) -> SamplesDiffer:
        """Return the error of a Series that does not agree."""
        self.differed = True
        return SamplesDiffer(text)

    def uncertainty(self) -> Optional[float]:
        """Return what the offset may be off by (mm, 95 %).

        None where a place was not measured, or nothing is known of its spread.
        """
        if len(self.estimates) < len(self.earlier):
            return None
        return self.uncertainty_with(self.estimates)

    def uncertainty_with(
        self, estimates: Mapping[str, Estimate]
    ) -> Optional[float]:
        """Return uncertainty(), if places to come turn out as the last Estimate."""
        is_alone = self.is_noisier(estimates)
        found = []
        for place, estimate in estimates.items():
            spread = estimate.spread
            is_rejected = len(estimate.samples) < len(self.touches[place])
            if self.target is not None or is_rejected:
                spread = replace(spread, dof=CHOSEN * spread.dof)
            if not is_alone:
                spread = pool((spread, self.earlier[place]))
            found.append(replace(estimate, spread=spread))
        to_come = len(self.earlier) - len(found)
        return uncertainty_of(found + found[-1:] * to_come, self.step)

    def is_known(self, place: str) -> bool:
        """Return whether earlier runs say how touches of a place vary."""
        return self.earlier[place].dof >= HISTORY

    def is_noisier(self, estimates: Mapping[str, Estimate]) -> bool:
        """Return whether this run is clearly noisier than the ones before.

        The squares of all its touches, in their usual variance, add up to chi^2, which
        has a mean of dof and a variance of 2 dof.
        """
        squares, dof = 0.0, 0.0
        for place, estimate in estimates.items():
            if self.is_known(place):
                spread, usual = estimate.spread, self.usual_noise(place)
                squares += spread.dof * spread.variance / usual**2
                dof += spread.dof
        return squares > dof + NOISIER * math.sqrt(2.0 * dof)

    def usual_noise(self, place: str) -> float:
        """Return the usual standard deviation (mm) of a touch of a place.

        No less than half a step: touches that always end on the same step may end on the
        next one.
        """
        noise = ROUGH if place in self.rough else USUAL_NOISE
        if self.is_known(place):
            noise = math.sqrt(self.earlier[place].variance)
        return max(noise, self.step / 2.0)

    def estimate(
        self, place: str, samples: Sequence[float], method: str
    ) -> Estimate:
        """Return the Estimate of samples, with the Spread of all touches of the place."""
        kept = without_outliers(self.touches[place], self.usual_noise(place))
        return Estimate(
            summarize(samples, method), samples, method, spread_of(kept)
        )

    def flattened(self, place: str) -> str:
        """Return what speaks for something soft at a place, in words; empty: nothing."""
        touches, noise = self.touches.get(place, []), self.usual_noise(place)
        least = FALLING if self.is_known(place) else FALLING_AT_FIRST
        fall = steady_fall(touches, least, noise)
        if fall:
            return (
                "each touch was lower than the one before, by"
                f" {fall:.4f} mm in all"
            )
        both = spread_of(touches[1:]), self.earlier[place]
        noise = max(noise, math.sqrt(pool(both).variance))
        excess = first_excess(touches, noise)
        if excess:
            return (
                f"the first touch was {excess:.4f} mm higher than the next ones"
            )
        return ""

    def doubt(self, place: str) -> str:
        """Return why a place may want cleaning, in words; empty: it does not."""
        flattened = self.flattened(place)
        if flattened:
            return flattened
        estimate = self.estimates.get(place)
        if estimate is None:
            return DOUBT if self.differed else ""
        has_left_out = len(estimate.samples) < len(self.touches[place])
        is_noisier = self.is_noisier({place: estimate})
        return DOUBT if has_left_out or is_noisier else ""


class Series:
    """The touches of one place in one run: add() them until it is_complete().

    touches are all of them, samples those since it has begun, or begun again.
    """

    def __init__(
        self, run: RunStatistics, place: str, sampling: Sampling
    ) -> None:
        self.run = run
        self.place = place
        self.sampling = sampling
        self.retries_left: int = sampling.retries
        self.touches: List[float] = []
        self.samples: List[float] = []

    def is_complete(self) -> bool:
        """Return whether the place has its Estimate, and needs no more touches."""
        return self.place in self.run.estimates

    def add(self, z: float) -> str:
        """Add the height of a touch (toolhead Z, mm).

        Returns why the series begins again, in words; empty: it does not.  Raises
        SamplesDiffer, with the remedy.
        """
        self.touches.append(z)
        self.samples.append(z)
        if self.run.target is None:
            return self.check_tolerance()
        self.check_target(self.run.target)
        return ""

    def check_tolerance(self) -> str:
        """End the series with the wanted number of samples.

        Returns and raises as add().
        """
        apart = max(self.samples) - min(self.samples)
        limit = self.sampling.tolerance
        if apart > limit:
            text = (
                f"samples differ by {apart:.4f} mm, samples_tolerance is"
                f" {limit:.4f} mm"
            )
            if not self.retries_left:
                raise self.run.error(text)
            self.retries_left -= 1
            self.samples = []
            return f"{text}; trying again"
        if len(self.samples) == self.sampling.samples:
            method = self.sampling.result
            estimate = self.run.estimate(self.place, self.samples, method)
            self.run.keep(self.place, estimate, self.samples)
        return ""

    def check_target(self, target: float) -> None:
        """End the series where it is enough for a target (mm), or may be no longer.

        Raises SamplesDiffer where something moves.
        """
        run, place = self.run, self.place
        kept = without_outliers(self.touches, run.usual_noise(place))
        estimate = run.estimate(place, kept, "average")
        is_usual = run.is_known(place) and not run.is_noisier({place: estimate})
        least = LEAST if is_usual else LEAST_AT_FIRST
        outliers = len(self.touches) - len(kept)
        is_enough = len(kept) >= max(least, AGAINST_ONE * outliers)
        if is_enough:
            estimates = {**run.estimates, place: estimate}
            uncertainty = run.uncertainty_with(estimates)
            is_enough = uncertainty is not None and uncertainty <= target
        if is_enough or len(self.touches) >= run.most_touches(place):
            self.check_nothing_moves(estimate)
            run.keep(place, estimate, self.samples)

    def check_nothing_moves(self, estimate: Estimate) -> None:
        """Raise SamplesDiffer where touches differ by more than noise and texture do."""
        limit = SOMETHING_MOVES
        if self.place in self.run.rough:
            limit += TEXTURE / 2.0
        far = [z for z in self.touches if abs(z - estimate.z) > limit]
        if math.sqrt(estimate.spread.variance) > limit or len(far) >= FAR_ONES:
            apart = max(self.touches) - min(self.touches)
            raise self.run.error(
                f"something moves: {len(self.touches)} touches lie up to"
                f" {apart:.4f} mm apart, which is no noise"
            )
