"""What ends a measurement; the command that it belongs to shows it to the user.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import Iterator, Optional, Type


class CalibrationError(Exception):
    """A condition that ends the run.

    It is made of what happened; what lets it pass may add what it is about, what was
    expected, and what to do.  It is put into words here only.
    """

    def __init__(self, what: object):
        super().__init__(what)
        # What a macro raises ends with an empty line
        self.what = str(what).rstrip()
        # The place or the series in which it happened
        self.subject = ""
        # Toolhead Z (mm) at which a trigger was expected; None: that was not known
        self.expected_z: Optional[float] = None
        # Why the touch ended where it did
        self.floor_reason = ""
        self.remedy = ""
        # What is not as it should be since, after cleaning up
        self.afterwards = ""
        # Whether what had to be done after it went well
        self.is_cleaned_up = True

    def __str__(self) -> str:
        text = f"{self.subject}: {self.what}" if self.subject else self.what
        if self.expected_z is not None:
            text += f", expected a trigger at z={self.expected_z:.3f}"
        if self.floor_reason:
            text += f", the lowest point of this touch: {self.floor_reason}"
        more = [part for part in (self.remedy, self.afterwards) if part]
        return "; ".join([text, *more])

    def advised(
        self,
        remedy: str,
        expected_z: Optional[float] = None,
        floor_reason: str = "",
    ) -> CalibrationError:
        """Return this error with what to do and what was expected.

        What was nearer to the cause has known better: the first advice stays.
        """
        if not self.remedy:
            self.remedy = remedy
            self.expected_z = expected_z
            self.floor_reason = floor_reason
        return self

    def left(self, afterwards: str) -> None:
        """Say what is not as it should be after cleaning up; empty: nothing."""
        self.afterwards = afterwards

    def not_cleaned_up(self) -> None:
        """Note that what had to be done after it went wrong, too."""
        self.is_cleaned_up = False

    def happened_in(self, subject: str) -> None:
        """Say what the error is about, unless that is said already."""
        self.subject = self.subject or subject


class TouchedWrong(CalibrationError):
    """What was touched cannot be right, and set-up and sensors seem to be.

    Measuring once more may help: the probe is seated anew, the nozzle is cleaned.
    """


class NoTrigger(TouchedWrong):
    """A touch that went down to its floor without a trigger."""


class SamplesDiffer(TouchedWrong):
    """No series of samples agreed."""


@contextlib.contextmanager
def about(
    subject: str, only: Type[CalibrationError] = CalibrationError
) -> Iterator[None]:
    """Say of errors (of one kind only) what they are about."""
    try:
        yield
    except only as e:
        e.happened_in(subject)
        raise
