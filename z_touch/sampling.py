"""How heights are sampled, and what becomes of the samples: pure functions.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import Any, Callable, List, NamedTuple, Sequence, TypeVar

from .errors import SamplesDiffer

# In place of a count: as many as are needed
AUTO = "auto"


class Sampling(NamedTuple):
    """How one place is touched; a field that is None is as the probe has it.

    samples and retries are counts, tolerance and retract_dist mm, result "median" or
    "average", speed and lift_speed mm/s.
    """

    samples: Any
    tolerance: Any
    retries: Any
    result: Any
    speed: Any
    retract_dist: Any
    lift_speed: Any


R = TypeVar("R", bound=Any)


def filled(record: R, other: R) -> R:
    """Return a record with the values of another one where it has None."""
    pairs = zip(record, other)
    made: R = record._make(b if a is None else a for a, b in pairs)
    return made


def summarize(samples: Sequence[float], method: str) -> float:
    """Return the average or the median of samples."""
    ordered = sorted(samples)
    middle = len(ordered) // 2
    if method == "average":
        return math.fsum(ordered) / len(ordered)
    if len(ordered) % 2:
        return ordered[middle]
    return (ordered[middle - 1] + ordered[middle]) / 2.0


class Accuracy(NamedTuple):
    """What PROBE_ACCURACY says of samples (mm); the deviation is that of all of them."""

    maximum: float
    minimum: float
    range: float
    average: float
    median: float
    deviation: float


def accuracy(samples: Sequence[float]) -> Accuracy:
    """Return the figures of PROBE_ACCURACY."""
    low, high = min(samples), max(samples)
    average = summarize(samples, "average")
    squares = [(z - average) ** 2 for z in samples]
    deviation = math.sqrt(math.fsum(squares) / len(samples))
    median = summarize(samples, "median")
    return Accuracy(high, low, high - low, average, median, deviation)


def why_differ(
    samples: Sequence[float],
    tolerance: float,
    option: str = "samples_tolerance",
) -> str:
    """Return why samples (mm) do not agree, up to what to do; empty: they do.

    'option' is the one that the tolerance (mm) comes from.
    """
    spread = max(samples) - min(samples)
    if spread <= tolerance:
        return ""
    return (
        f"samples differ by {spread:.4f} mm, {option} is {tolerance:.4f} mm; "
    )


class Series:
    """The touches of a place, begun again where they do not agree.

    'option' is the one that the tolerance comes from, 'remedy' what to do about touches that
    never agree.
    """

    def __init__(
        self,
        sampling: Sampling,
        remedy: str,
        option: str = "samples_tolerance",
    ):
        self.sampling = sampling
        self.remedy = remedy
        self.option = option
        self.retries_left: int = sampling.retries
        # Those since it has begun, or begun again (mm)
        self.samples: List[float] = []

    def is_complete(self) -> bool:
        """Return whether there are as many samples as wanted."""
        return bool(len(self.samples) >= self.sampling.samples)

    def add(self, z: float) -> str:
        """Add a height (mm); return why the series begins again, empty: it goes on.

        Raises SamplesDiffer, with the remedy, when no retry is left.
        """
        self.samples.append(z)
        text = why_differ(self.samples, self.sampling.tolerance, self.option)
        if not text:
            return ""
        if not self.retries_left:
            raise SamplesDiffer(text + self.remedy)
        self.retries_left -= 1
        self.samples = []
        return text + "trying again"

    def result(self) -> float:
        """Return the height that is taken (mm)."""
        return summarize(self.samples, self.sampling.result)


def collect(
    touch: Callable[[], float],
    sampling: Sampling,
    say: Callable[[str], None],
    remedy: str,
    option: str = "samples_tolerance",
) -> List[float]:
    """Call touch(), which returns a height, until the wanted number of samples agrees.

    A sample that does not agree starts the series again; 'say' is told.  Raises
    SamplesDiffer, with the remedy, when no retry is left.  'option' is the one that the
    tolerance comes from.
    """
    series = Series(sampling, remedy, option)
    while not series.is_complete():
        why_again = series.add(touch())
        if why_again:
            say(why_again)
    return series.samples
