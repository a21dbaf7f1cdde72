# How many touches a site needs.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import math

from ..core.errors import SamplesDiffer
from ..core.sampling import AUTO
from ..core.sampling import collect as collect_some
from .estimate import (
    UNKNOWN,
    USUAL_NOISE,
    estimate,
    expanded,
    is_usual,
    pool,
    robust_estimate,
    spread_of,
    t_factor,
)

DOUBT = "the touches do not agree"

# A first touch is higher than the next ones from so many standard deviations on
STICKS = 3.0

# Touches of one site: with a history, without one, and at most.  Without one
# fewer agree by chance too often for the uncertainty to hold.
LEAST = 2
LEAST_AT_FIRST = 5
MOST = 10

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


# The part of the variance at 95 % (mm^2) that a site may have: no less than its
# third, more where the sites before it have left some, by its noise as far as
# that is known.  'target': mm at 95 %; 'pasts': Spread by site; 'found': the
# other sites' Estimate.
def share(site, target, step, pasts, found):
    # Half a step is not to be averaged away
    whole = max(target**2 - (step / 2.0) ** 2, 0.0)
    left = whole - math.fsum(cost(estimate) for estimate in found.values())
    todo = [name for name in pasts if name not in found]
    noises = [math.sqrt(pasts[name].variance) for name in todo]
    part = 1.0 / len(todo)
    if all(is_known(pasts[name]) for name in todo) and sum(noises):
        part = math.sqrt(pasts[site].variance) / math.fsum(noises)
    return max(left * part, whole / len(pasts))


# Sites that vary alike, as far as one can tell, are known better together: the
# number of touches follows chance less then.  'pasts': Spread by site
def together(pasts):
    variances = [past.variance for past in pasts.values()]
    if not variances or not all(map(is_known, pasts.values())):
        return pasts
    if max(variances) > ALIKE * min(variances):
        return pasts
    return dict.fromkeys(pasts, pool(pasts.values()))


def is_known(past):
    return past.dof >= HISTORY


# With a history the other sites are known as well: t is of all three
def cost(estimate):
    own = estimate.dof <= estimate.own.dof
    dof = estimate.dof if own else 3 * estimate.dof
    return t_factor(dof) ** 2 * estimate.variance


# Whether the samples are enough for a share, and what they say: Estimate
def judge(samples, past, step, share):
    past = past if is_known(past) else UNKNOWN
    found = robust_estimate(samples, past, step)
    known = is_known(past) and is_usual(found.own, past, step)
    least = LEAST if known else LEAST_AT_FIRST
    outliers = len(samples) - len(found.kept)
    if outliers:
        least = max(least, AGAINST_ONE * outliers)
    enough = len(found.kept) >= least and cost(found) <= share
    return enough, found


def check(samples, found, remedy):
    far = [z for z in samples if abs(z - found.z) > SOMETHING_MOVES]
    noise = math.sqrt(found.own.variance)
    if noise > SOMETHING_MOVES or len(far) >= FAR_ONES:
        raise SamplesDiffer(
            "something moves: %d touches lie up to %.4f mm apart, which is no"
            " noise; %s" % (len(samples), max(samples) - min(samples), remedy)
        )


# Call touch(), which returns a height, until the site has its share.  Returns
# all samples and the Estimate.  Raises SamplesDiffer, with the remedy.
def collect(touch, past, step, share, remedy):
    samples = []
    while True:
        samples.append(touch())
        enough, found = judge(samples, past, step, share)
        if enough or len(samples) >= MOST:
            check(samples, found, remedy)
            return samples, found


# What sticks to a nozzle is pressed flat by its first touch: by how much (mm)
# that was higher than the next ones, 0 where it is no more than noise.
def first_excess(samples, past, step):
    rest = samples[1:]
    if not rest:
        return 0.0
    noise = math.sqrt(pool((spread_of(rest), past)).variance)
    noise = max(noise, step / 2.0 if is_known(past) else USUAL_NOISE)
    mean = math.fsum(rest) / len(rest)
    limit = STICKS * noise * math.sqrt(1.0 + 1.0 / len(rest))
    return samples[0] - mean if samples[0] - mean > limit else 0.0


# The touches of one run, and what they say.
class Plan(object):
    # 'pasts': Spread by site; 'target': mm at 95 %, for samples: auto
    def __init__(self, step, pasts, target):
        self.step = step
        self.pasts = together(pasts)
        self.target = target
        # By site: its touches, those of the series that counts, its Estimate
        self.touches = {}
        self.samples = {}
        self.estimates = {}
        self.differed = False

    # How many touches there will be, if all is well
    def expected(self, sampling):
        if sampling.samples != AUTO:
            return sampling.samples
        known = all(is_known(past) for past in self.pasts.values())
        return LEAST if known else LEAST_AT_FIRST

    # The samples of a site; more by 'touches', 'samples' and 'found'
    def collect(self, site, touch, sampling, say, remedy):
        touches = self.touches[site] = []
        past = self.pasts.get(site, UNKNOWN)
        self.estimates.pop(site, None)

        def take():
            touches.append(touch())
            return touches[-1]

        try:
            if sampling.samples != AUTO:
                samples = collect_some(take, sampling, say, remedy)
                found = estimate(samples, past, self.step, sampling.result)
            else:
                step, pasts = self.step, self.pasts
                part = share(site, self.target, step, pasts, self.estimates)
                samples, found = collect(take, past, step, part, remedy)
        except SamplesDiffer:
            self.differed = True
            raise
        self.samples[site], self.estimates[site] = samples, found
        return samples

    # Why a site may want cleaning; empty: it does not
    def doubt(self, site):
        touches, found = self.touches.get(site, []), self.estimates.get(site)
        past = self.pasts.get(site, UNKNOWN)
        excess = first_excess(touches, past, self.step)
        if excess:
            text = "the first touch was %.4f mm higher than the next ones"
            return text % (excess,)
        if found is None:
            return DOUBT if self.differed else ""
        is_one = len(found.kept) == len(touches)
        usual = is_one and is_usual(found.own, past, self.step)
        return "" if usual else DOUBT

    # Of the offset (mm at 95 %), or None
    def uncertainty(self):
        if any(site not in self.estimates for site in self.pasts):
            return None
        return expanded([self.estimates[s] for s in self.pasts], self.step)
