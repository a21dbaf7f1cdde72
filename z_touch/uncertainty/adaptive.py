# How many touches a site gets: a fixed count, or as many as the result needs.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# With samples: auto the target is what the offset may be off by (mm at 95 %).
# Its square is shared among the sites, after what nobody can average away:
#
#   target^2 - (t * step / 2)^2  >=  sum over the sites of t^2 * variance,   t = 1.96
#
# A site is touched until its part is no more than its share, see share(), the last
# one until the whole is what was wanted: only then all is known.

import functools
import math

from ..core.errors import SamplesDiffer
from ..core.sampling import AUTO, collect
from ..core.spread import ROUGH, TEXTURE
from .estimate import (
    UNKNOWN,
    USUAL_NOISE,
    estimate,
    expand,
    expanded,
    is_usual,
    pool,
    robust_estimate,
    rounding,
    spread_of,
    t_factor,
    weighed,
)
from .recent import current_spreads, pool_usual

DOUBT = "the touches do not agree"

# A first touch is higher than the next ones from so many standard deviations on
STICKS = 3.0

# So many touches, each lower than the one before: with a history, without one
FALLING = 3
FALLING_AT_FIRST = 4

# Touches of one site: with a history, without one, and at most.  Without one
# fewer agree by chance too often for the uncertainty to hold.
LEAST = 2
LEAST_AT_FIRST = 4
MOST = 10

# The part of the whole that the sites before the last one leave: how noisy a run was
# is known at its end only, and nobody goes back
RESERVE = 0.03

# So many touches behind it (degrees of freedom) make a history
HISTORY = 8

# Variances of sites that differ by less may well be the same: 1 % of F with 20
# degrees of freedom on both sides
ALIKE = 2.94

# More (mm) is no noise, as a standard deviation, or as the distance of so many
# touches from all others: something moves.  Ten touches of a switch as bad as
# 10 um stay well below.
SOMETHING_MOVES = 0.05
FAR_ONES = 3

# An outlier wants three that speak against it
AGAINST_ONE = 3

# The part of the degrees of freedom that a run without a history has left, as which
# sites are alike is chosen by what their touches say; the same where these say, too,
# how many there are and which of them count
ALIKE_CHOSEN = 0.7
CHOSEN = 0.35

# Of a run
SITES = ("nozzle", "switch", "bed")

# Touches of each site in a cycle, where their number is not given
CYCLE_SAMPLES = 3


######################################################################
# As many as are needed
######################################################################

# 'earlier': the Spread of one touch at a site in earlier runs, or by site.


# The part of the variance at 95 % (mm^2) that a site may have: no less than its
# third, more where the sites before it have left some, by its noise as far as
# that is known.  'target': mm at 95 %; 'measured': Estimates of the sites that
# come before.
def share(site, target, step, earlier, measured):
    # Half a step is not to be averaged away
    half = t_factor(float("inf")) * step / 2.0
    whole = max(target**2 - half**2, 0.0)
    left = whole - math.fsum(cost(estimate) for estimate in measured.values())
    todo = [name for name in earlier if name not in measured]
    noises = [math.sqrt(earlier[name].variance) for name in todo]
    if len(todo) > 1:
        left -= RESERVE * whole
    part = 1.0 / len(todo)
    if all(is_known(earlier[name]) for name in todo) and sum(noises):
        part = math.sqrt(earlier[site].variance) / math.fsum(noises)
    return max(left * part, (1.0 - RESERVE) * whole / len(earlier))


# Sites that vary alike, as far as one can tell, are known better together: the
# number of touches follows chance less then.
def together(earlier):
    variances = [spread.variance for spread in earlier.values()]
    if not variances or not all(map(is_known, earlier.values())):
        return earlier
    if max(variances) > ALIKE * min(variances):
        return earlier
    return dict.fromkeys(earlier, pool(earlier.values()))


# Whether there are enough touches behind a Spread
def is_known(earlier):
    return earlier.dof >= HISTORY


# The part of the variance at 95 % (mm^2) that a site has.  t is of the whole, and the
# other sites will be known as well: with a history all three; without one they may
# turn out noisier, so only one of the others is counted.
def cost(estimate):
    is_alone = estimate.dof <= estimate.spread.dof
    dof = (2 if is_alone else 3) * estimate.dof
    return t_factor(dof) ** 2 * estimate.variance


# Whether the samples are enough for a share, and their Estimate; 'unknown' (mm): what a
# touch varies by where 'earlier' says nothing
def judge(samples, earlier, step, share, unknown=USUAL_NOISE):
    earlier = earlier if is_known(earlier) else UNKNOWN
    result = robust_estimate(samples, earlier, step, unknown)
    usual = is_known(earlier) and is_usual(result.spread, earlier, step)
    least = LEAST if usual else LEAST_AT_FIRST
    outliers = len(samples) - len(result.kept)
    if outliers:
        least = max(least, AGAINST_ONE * outliers)
    enough = len(result.kept) >= least and cost(result) <= share
    return enough, result


# Raises SamplesDiffer where the samples differ by more than noise, or, at points of a
# textured plate ('is_rough'), by more than that lies to either side of its middle
def check(remedy, is_rough, samples, result):
    limit = SOMETHING_MOVES + (TEXTURE / 2.0 if is_rough else 0.0)
    far = [z for z in samples if abs(z - result.z) > limit]
    noise = math.sqrt(result.spread.variance)
    if noise > limit or len(far) >= FAR_ONES:
        raise SamplesDiffer(
            "something moves: %d touches lie up to %.4f mm apart, which is no"
            " noise; %s" % (len(samples), max(samples) - min(samples), remedy)
        )


# How often a site may be touched: nobody goes back, so the last one may have what
# those before it have left.
def most_touches(site, plan):
    others = [name for name in plan.earlier_runs if name != site]
    if not others or any(name not in plan.estimates for name in others):
        return MOST
    used = sum(len(plan.touches[name]) for name in others)
    return MOST * len(plan.earlier_runs) - used


# What an offset is worth at best (mm, 95 %), with MOST touches of each site: with
# little noise all of them end on the same step, with much they vary.  Some noise in
# between is best.
def least_uncertainty(step):
    best = min(
        variance / MOST + rounding(variance, step)
        for variance in ((step * part / 50.0) ** 2 for part in range(100))
    )
    return expand(t_factor(float("inf")), len(SITES) * best, step)


# Call touch(), which returns a height (mm), until the site has its share, and
# is_done(Estimate).  Returns all samples and the Estimate, with which it has called
# 'check' before.  'judged': judge() of the samples
def collect_enough(touch, judged, check, is_done=None, most=MOST):
    samples = []
    while True:
        samples.append(touch())
        enough, result = judged(samples)
        enough = enough and (is_done is None or is_done(result))
        if enough or len(samples) >= most:
            check(samples, result)
            return samples, result


# What sticks to a nozzle is pressed flat by its first touch: by how much (mm)
# that was higher than the next ones, 0 where it is no more than noise.
def first_excess(samples, earlier, step):
    rest = samples[1:]
    if not rest:
        return 0.0
    noise = math.sqrt(pool((spread_of(rest), earlier)).variance)
    noise = max(noise, step / 2.0 if is_known(earlier) else USUAL_NOISE)
    mean = math.fsum(rest) / len(rest)
    limit = STICKS * noise * math.sqrt(1.0 + 1.0 / len(rest))
    return samples[0] - mean if samples[0] - mean > limit else 0.0


# What is soft is pressed flatter by each touch: from the first to the last by how
# much (mm), 0 where that is no more than noise.  Few touches fall by chance, so
# without a history it takes more of them.
def steady_fall(samples, earlier, step):
    least = FALLING if is_known(earlier) else FALLING_AT_FIRST
    falls = [a - b for a, b in zip(samples, samples[1:])]
    if len(samples) < least or min(falls) <= 0.0:
        return 0.0
    usual = math.sqrt(earlier.variance) if is_known(earlier) else USUAL_NOISE
    limit = STICKS * math.sqrt(2.0) * max(usual, step / 2.0)
    whole = samples[0] - samples[-1]
    return whole if whole > limit else 0.0


######################################################################
# Who decides
######################################################################

# One of two objects, chosen once by the option samples.  'sampling' is
# sampling.Sampling of the site.


# As many touches as the user, or [probe], has set.
class FixedCount:
    # Options that count for nothing then; they do with, or without, 'samples: auto'
    idle = ("target_uncertainty",)
    idle_how = "without"
    chosen = ALIKE_CHOSEN
    # Whether the module decides on what its owner leaves open, too
    is_free = False

    # 'count': of the section; None: as [probe] has it
    def __init__(self, count=None):
        self.count = count

    # What a target makes impossible; there is none
    def impossible(self, step):
        return ""

    # How many touches there will be, if all is well
    def expected(self, plan, sampling):
        return sampling.samples

    # Where their spread is what is asked for
    def for_spread(self, sampling):
        return sampling.samples

    # In each of several cycles; a single touch has no spread
    def for_cycles(self, sampling):
        return sampling.samples if sampling.samples > 1 else CYCLE_SAMPLES

    # Whether so many are more than all of the sites get
    def is_exceeded(self, count, samplings):
        return min(sampling.samples for sampling in samplings) < count

    # Samples of a site, and their Estimate.  Raises SamplesDiffer.
    def collect(self, plan, site, touch, sampling, say, remedy):
        samples = collect(touch, sampling, say, remedy)
        earlier, touches = plan.earlier_at(site), plan.touches[site]
        method, unknown = sampling.result, plan.unknown_at(site)
        return samples, estimate(
            samples, earlier, plan.step, method, touches, unknown
        )


# As many touches as the result needs (samples: auto); how far those of [probe]
# may be apart, and what becomes of them, plays no part.
class Automatic:
    idle = ("samples_tolerance", "samples_tolerance_retries", "samples_result")
    idle_how = "with"
    count = None
    chosen = CHOSEN
    is_free = True

    # 'target': mm at 95 %
    def __init__(self, target):
        self.target = target

    def expected(self, plan, sampling):
        have_history = all(map(is_known, plan.earlier.values()))
        return LEAST if have_history else LEAST_AT_FIRST

    def for_spread(self, sampling):
        return MOST

    def for_cycles(self, sampling):
        return CYCLE_SAMPLES

    def is_exceeded(self, count, samplings):
        return False

    def collect(self, plan, site, touch, sampling, say, remedy):
        step, measured = plan.step, plan.estimates
        part = share(site, self.target, step, plan.earlier, measured)

        def is_done(result):
            worth = plan.uncertainty_with(site, result)
            if worth is None:
                return plan.cost_with(site, result) <= part
            return worth <= self.target

        earlier, most = plan.earlier_at(site), most_touches(site, plan)
        agree = functools.partial(check, remedy, site in plan.rough)
        judged = functools.partial(
            judge,
            earlier=earlier,
            step=step,
            share=part,
            unknown=plan.unknown_at(site),
        )
        return collect_enough(touch, judged, agree, is_done, most)

    # Why no run can keep the target, in words; empty: it may.  'step': of the motors of
    # Z, in mm
    def impossible(self, step):
        least = least_uncertainty(step)
        if self.target >= least:
            return ""
        text = (
            "target_uncertainty %g is less than what steps of %g mm of Z allow:"
            " each run ends at about %.4f, at best; set it to that, or raise"
            " microsteps"
        )
        return text % (self.target, step, least)


# By the options samples and target_uncertainty
def choose(samples, target):
    return Automatic(target) if samples == AUTO else FixedCount(samples)


######################################################################
# One run
######################################################################


# The touches of one run, and what they say.
class Plan:
    # 'step': of the Z motors (mm); 'earlier_runs': of each site the Spreads of the last
    # runs, see recent.py; 'counting': FixedCount or Automatic; 'rough': the sites
    # that are touched at points of a textured plate
    def __init__(self, step, earlier_runs, counting, rough=()):
        self.step = step
        self.rough = rough
        self.earlier_runs = earlier_runs
        self.earlier = together(
            dict(
                (site, pool_usual(earlier_runs[site], step))
                for site in earlier_runs
            )
        )
        self.counting = counting
        # By site: its touches, those of the series that counts, its Estimate
        self.touches = {}
        self.samples = {}
        self.estimates = {}
        # X and Y (mm) of each touch of the bed, with bed_spread
        self.points = []
        self.differed = False

    # Spread of one touch at a site in earlier runs
    def earlier_at(self, site):
        return self.earlier.get(site, UNKNOWN)

    # The standard deviation (mm) of one touch at a site that nobody knows yet
    def unknown_at(self, site):
        return ROUGH if site in self.rough else USUAL_NOISE

    def expected(self, sampling):
        return self.counting.expected(self, sampling)

    # The samples of a site, from touch(), which returns a height (mm); more by
    # 'touches', 'samples' and 'estimates'.  Raises SamplesDiffer, with the
    # remedy.
    def collect(self, site, touch, sampling, say, remedy):
        touches = self.touches[site] = []
        self.estimates.pop(site, None)

        def take():
            touches.append(touch())
            return touches[-1]

        try:
            self.samples[site], self.estimates[site] = self.counting.collect(
                self, site, take, sampling, say, remedy
            )
        except SamplesDiffer:
            self.differed = True
            raise
        return self.samples[site]

    # What speaks for something that its touches press flat, in words; empty: nothing
    def flattened(self, site):
        touches, earlier = self.touches.get(site, []), self.earlier_at(site)
        fall = steady_fall(touches, earlier, self.step)
        if fall:
            return (
                "each touch was lower than the one before, by %.4f mm in all"
                % (fall,)
            )
        excess = first_excess(touches, earlier, self.step)
        text = "the first touch was %.4f mm higher than the next ones"
        return text % (excess,) if excess else ""

    # Why a site may want cleaning; empty: it does not
    def doubt(self, site):
        touches, result = self.touches.get(site, []), self.estimates.get(site)
        flattened = self.flattened(site)
        if flattened:
            return flattened
        earlier = self.earlier_at(site)
        if result is None:
            return DOUBT if self.differed else ""
        all_count = len(result.kept) == len(touches)
        usual = all_count and is_usual(result.spread, earlier, self.step)
        return "" if usual else DOUBT

    # Of the offset (mm at 95 %); None where a site was not measured, or nothing
    # is known of its spread.
    def uncertainty(self):
        return self.worth_of(self.estimates)

    # Of the offset (mm at 95 %), if a site had this Estimate
    def uncertainty_with(self, site, result):
        return self.worth_of(dict(self.estimates, **{site: result}))

    # The part of the variance at 95 % (mm^2) that a site has with an Estimate: where
    # this run is noisier than those before, as far as it has come, these say nothing
    def cost_with(self, site, result):
        estimates = dict(self.estimates, **{site: result})
        current = dict((name, e.spread) for name, e in estimates.items())
        earlier_runs = dict((name, self.earlier_runs[name]) for name in current)
        estimated = current_spreads(
            earlier_runs, current, self.step, self.counting.chosen
        )
        spread = estimated.spreads[site]
        return cost(weighed(result, spread, self.step, estimated.middle))

    def worth_of(self, estimates):
        if any(site not in estimates for site in self.earlier_runs):
            return None
        current = dict(
            (site, estimates[site].spread) for site in self.earlier_runs
        )
        estimated = current_spreads(
            self.earlier_runs, current, self.step, self.counting.chosen
        )
        parts = [
            weighed(estimates[site], spread, self.step, estimated.middle)
            for site, spread in estimated.spreads.items()
        ]
        return expanded(parts, self.step, estimated.is_shared)
