# What ends a measurement; the command that it belongs to tells the user.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import contextlib


# A condition that ends the run
class CalibrationError(Exception):
    # This error with more about it, and with what to look at
    def advised(self, hint, more=""):
        return self.__class__("%s%s; %s" % (self, more, hint))


# A touch that went down to its floor without a trigger
class NoTrigger(CalibrationError):
    pass


# A touch that a late message has ended: nothing about the sensor or its place
class MessageLost(CalibrationError):
    def advised(self, hint, more=""):
        return self


# No series of samples agreed
class SamplesDiffer(CalibrationError):
    pass


# Says in front of an error what it is about, or only of errors of that kind.
# Samples that differ are none of a series around this.
@contextlib.contextmanager
def about(name, only=CalibrationError):
    try:
        yield
    except only as e:
        kind = NoTrigger if isinstance(e, NoTrigger) else CalibrationError
        raise kind("%s: %s" % (name, e))
