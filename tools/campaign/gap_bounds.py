"""How wrong a true gap may be at most: from what was drawn, nothing else.

    steps      a trigger is seen at a whole step, up to one too low; and every
               touch that begins between two steps moves the host's frame by
               the rest, half a step at most
    noise      five standard deviations of the heights' summaries, and an
               outlier that came where the samples cannot tell it
    latency    a touch may be slower than it should be at its trigger
    drift      what has grown since the frame was made

What cannot be told from the touches is no error but the expected gap: the
switch_offset that differs from the file's, the depth of a pressed bed, a
sensor that is always as late.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby

from simprinter.world import DriftSpec, NoiseSpec, Touch
from tools.campaign.drawn_machines import Gantry, Sampling

# Farther than that a draw is not expected to be from its mean
SIGMAS = 5.0
# and more seldom than that nothing is expected to happen
_SELDOM = 1e-5
# A median's variance is at most that of an average times this
MEDIAN = math.pi / 2.0

# What a number on the console is rounded to, mm
DIGIT = 1e-6


@dataclass(frozen=True)
class Interval:
    """Gaps (mm) that are right: low to high, and an error of bound beyond."""

    low: float
    high: float
    bound: float

    def error(self, gap: float) -> float:
        """How far (mm) a gap is outside; negative is too small."""
        return min(0.0, gap - self.low) + max(0.0, gap - self.high)


def rest(distance: float, step: float) -> float:
    """How far (mm) a distance is from a whole number of steps."""
    return abs(distance - round(distance / step) * step)


def seen_bound(gantry: Gantry) -> float:
    """Mm that a result may be off as triggers are seen at whole steps.

    Of three heights two have one sign and one the other.
    """
    return 2.0 * gantry.step


def frame_bound(
    gantry: Gantry, touches: Sequence[Touch], retracts: Mapping[str, float]
) -> float:
    """Mm by which these touches may have moved the frame.

    retracts: between two touches of a group. All other ways begin anywhere: to
    each group, to one that was sought in vain, to the look at the gap.
    """
    sites = [touch.site for touch in touches]
    groups = [(name, len(list(group))) for name, group in groupby(sites)]
    again = sum(
        (count - 1) * rest(retracts[name], gantry.step)
        for name, count in groups
    )
    return 0.5 * gantry.step * (len(groups) + 2) + again


def variance(noise: NoiseSpec, samples: int) -> float:
    """Of a height that is the summary of samples, mm^2."""
    factor = MEDIAN if samples > 2 else 1.0
    return factor * noise.sigma**2 / samples


def has_outlier(
    touches: Sequence[Touch],
    noise: NoiseSpec,
    nominal: Callable[[Touch], float],
) -> bool:
    """Whether one of them may have triggered that far from its nominal Z."""
    far = abs(noise.outlier_size) / 2.0
    away = [abs(touch.trigger_z - nominal(touch)) for touch in touches]
    return bool(noise.outlier_chance) and max(away, default=0.0) >= far


def hidden_outlier(
    noise: NoiseSpec, sampling: Sampling, samples: int, step: float
) -> float:
    """Mm by which an outlier may shift a height unseen."""
    size = abs(noise.outlier_size)
    spread = 2.0 * SIGMAS * noise.sigma + step
    told = size - spread > sampling.tolerance
    if told and noise.outlier_chance**samples < _SELDOM:
        return 0.0
    return size if noise.outlier_chance else 0.0


def drift_bound(drift: DriftSpec, seconds: float) -> float:
    """Mm that have grown in this time."""
    rates = (drift.nozzle, drift.pin, drift.bed, drift.body)
    return sum(map(abs, rates)) * seconds


def may_differ(
    noise: NoiseSpec, sampling: Sampling, step: float, late: float = 0.0
) -> bool:
    """Whether healthy samples may be farther apart than their tolerance.

    late: mm by which the speed at the trigger makes a difference.
    """
    spread = 2.0 * SIGMAS * noise.sigma + step + late
    if noise.outlier_chance:
        spread += abs(noise.outlier_size)
    return spread + 2.0 * step > sampling.tolerance
