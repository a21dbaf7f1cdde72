# What ends a measurement; the command that it belongs to tells the user.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import contextlib


# A condition that ends the run: what happened.  Whoever lets it pass may add what it
# is about, and what to do; it is put into words here only.
class CalibrationError(Exception):
    def __init__(self, what):
        Exception.__init__(self, what)
        self.what = what
        # The site or the series in which it happened
        self.subject = ""
        # Toolhead Z (mm) at which a trigger was expected; None: nobody knew one
        self.expected_z = None
        # Why the touch ended where it did
        self.floor_reason = ""
        self.remedy = ""

    def __str__(self):
        text = self.what
        if self.subject:
            text = "%s: %s" % (self.subject, text)
        if self.expected_z is not None:
            text += ", expected a trigger at z=%.3f" % (self.expected_z,)
        if self.floor_reason:
            text += ", the lowest point of this touch: %s" % (
                self.floor_reason,
            )
        return "%s; %s" % (text, self.remedy) if self.remedy else text

    # This error with what to do and what was expected.  Whoever was nearer to it
    # has known better.
    def advised(self, remedy, expected_z=None, floor_reason=""):
        if not self.remedy:
            self.remedy = remedy
            self.expected_z = expected_z
            self.floor_reason = floor_reason
        return self

    # What is around that is none of its business
    def happened_in(self, subject):
        self.subject = self.subject or subject


# A touch that went down to its floor without a trigger
class NoTrigger(CalibrationError):
    pass


# No series of samples agreed
class SamplesDiffer(CalibrationError):
    pass


# Says of an error what it is about, or only of errors of that kind, unless it is
# about something within that already
@contextlib.contextmanager
def about(subject, only=CalibrationError):
    try:
        yield
    except only as e:
        e.happened_in(subject)
        raise
