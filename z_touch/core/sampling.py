# How heights are sampled, and what becomes of the samples: pure functions.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections
import math

from .errors import SamplesDiffer

# In place of a count: as many as are needed, see adaptive.py
AUTO = "auto"

# Count, mm, count, "median" or "average", mm/s, mm, mm/s
Sampling = collections.namedtuple(
    "Sampling", "samples tolerance retries result speed retract_dist lift_speed"
)


# A record with the values of another one where it has none
def filled(record, other):
    pairs = zip(record, other)
    return record._make(b if a is None else a for a, b in pairs)


def summarize(samples, method):
    ordered = sorted(samples)
    middle = len(ordered) // 2
    if method == "average":
        return math.fsum(ordered) / len(ordered)
    if len(ordered) % 2:
        return ordered[middle]
    return (ordered[middle - 1] + ordered[middle]) / 2.0


# Maximum, minimum, range, average, median and population standard deviation,
# as PROBE_ACCURACY has them
def accuracy(samples):
    low, high, average = (
        min(samples),
        max(samples),
        summarize(samples, "average"),
    )
    squares = [(z - average) ** 2 for z in samples]
    deviation = math.sqrt(math.fsum(squares) / len(samples))
    median = summarize(samples, "median")
    return high, low, high - low, average, median, deviation


# Call touch(), which returns a height, until the wanted number of samples
# agrees.  A sample that does not agree starts the series again; 'say' is told.
# Raises SamplesDiffer, with the remedy, when no retry is left.  'option' is the
# one that the tolerance comes from.
def collect(touch, sampling, say, remedy, option="samples_tolerance"):
    retries_left = sampling.retries
    samples = []
    while len(samples) < sampling.samples:
        samples.append(touch())
        spread = max(samples) - min(samples)
        if spread <= sampling.tolerance:
            continue
        text = "samples differ by %.4f mm, %s is %.4f mm; %s"
        values = spread, option, sampling.tolerance
        if not retries_left:
            raise SamplesDiffer(text % (values + (remedy,)))
        say(text % (values + ("trying again",)))
        retries_left -= 1
        samples = []
    return samples
