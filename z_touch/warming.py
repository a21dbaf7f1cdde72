"""A printer that warms up: the same place is touched each minute, until it stands still.

Frame, pin, plate and nozzle grow for a while after the heaters have got there.  What is
measured before is right for that moment only.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, List, Optional, Tuple

from . import options

if TYPE_CHECKING:
    from .host.klippy import GCodeCommand
    from .host.printer import Host
    from .progress import Progress
    from .sampling import Sampling

# A touch begins so long (s) after the last one
TOUCH_EVERY = 60.0

# A place that moves by less (mm a minute) stands still: the median of three touches varies
# by some 0.001 mm
STILL = 0.003

# A touch may begin so much (s) later, and times (s) that differ by less are the same
LATE = 2.0
SAME_TIME = 0.001

# So often in a row it has to: one movement may be small by chance
IN_A_ROW = 2

# So long (minutes) a command waits by default, at least and at most
MINUTES = 20.0
FEWEST_MINUTES = 2.0
MOST_MINUTES = 120.0

# Touches each time, of which the median counts; a single one may be a bad one
LEAST_SAMPLES = 3


@dataclass(frozen=True)
class Wanted:
    """When it is enough: 'limit' is mm a minute; no longer than so many minutes."""

    limit: float = STILL
    minutes: float = MINUTES

    def touches(self, sampling: Sampling) -> int:
        """Return how often the place may be touched, each time as 'sampling' has it."""
        times = 1 + int(self.minutes * 60.0 / TOUCH_EVERY)
        return times * int(sampling.samples)


def wanted_of(gcmd: GCodeCommand) -> Wanted:
    """Read LIMIT and MAX; raises the command's error."""
    param = options.param_number
    return Wanted(
        param(gcmd, "LIMIT", STILL, above=0.0),
        param(gcmd, "MAX", MINUTES, minval=FEWEST_MINUTES, maxval=MOST_MINUTES),
    )


def sampling_of(sampling: Sampling, tolerance: float) -> Sampling:
    """Return how the place is touched each time; touches may differ by 'tolerance' (mm)."""
    return sampling._replace(
        samples=max(sampling.samples, LEAST_SAMPLES),
        tolerance=tolerance,
        result="median",
    )


class Warming:
    """How far one place has moved since it is watched: touch it and add(), until is_over()."""

    def __init__(self, host: Host, progress: Progress, wanted: Wanted):
        self.host = host
        self.progress = progress
        self.wanted = wanted
        # When the first touch has begun, the last one, and has ended (eventtime)
        self.began = self.begun = self.touched_at = host.eventtime()
        # Minutes since the beginning, and height (mm), of each touch
        self.heights: List[Tuple[float, float]] = []
        # Height of the last touch (mm), None: there was none
        self.last: Optional[float] = None
        # The last movement (mm a minute, up is positive), None: not known yet
        self.movement: Optional[float] = None
        # So many in a row were small
        self.quiet = 0

    @property
    def minutes(self) -> float:
        """Minutes from the beginning to the last touch."""
        return (self.touched_at - self.began) / 60.0

    @property
    def is_still(self) -> bool:
        """Whether the place stands still."""
        return self.quiet >= IN_A_ROW

    def is_over(self) -> bool:
        """Return whether the place stands still, or has been watched long enough."""
        if self.last is None:
            return False
        seconds = self.begun + TOUCH_EVERY - self.began
        return self.is_still or seconds > 60.0 * self.wanted.minutes + SAME_TIME

    def wait(self) -> None:
        """Wait until the next touch is due: not for the first one.  May pause.

        Raises the host's error where the printer is shut down.
        """
        if self.last is None:
            return
        self.progress.enter("waiting")
        due = self.begun + TOUCH_EVERY
        self.host.wait_until(due)
        # What is a little late puts no later ones off
        self.begun = max(due, self.host.eventtime() - LATE)

    def add(self, z: float) -> None:
        """Take the height (mm) of a touch that has just ended, and show how far it moved."""
        now = self.host.eventtime()
        text = f"z={z:.4f}"
        if self.last is not None:
            minutes = (now - self.touched_at) / 60.0
            self.movement = (z - self.last) / minutes
            is_small = abs(self.movement) < self.wanted.limit
            self.quiet = self.quiet + 1 if is_small else 0
            text += f", moved by {self.movement:+.4f} mm a minute"
        self.last, self.touched_at = z, now
        self.heights.append((self.minutes, z))
        self.progress.say(f"{self.minutes:.0f} min: {text}")

    def result(self) -> str:
        """Return how long it took, and how fast the place still moves, in words."""
        assert self.movement is not None
        speed, limit = abs(self.movement), self.wanted.limit
        if self.is_still:
            return (
                f"it stands still after {self.minutes:.0f} minutes: it moves by"
                f" {speed:.4f} mm a minute, less than {limit:g} twice in a row"
            )
        return (
            f"after {self.minutes:.0f} minutes (MAX) it still moves, by {speed:.4f} mm a"
            f" minute where LIMIT is {limit:g}: what is measured now may be wrong by the"
            " first layer; wait longer (MAX), or heat bed and chamber earlier"
        )
