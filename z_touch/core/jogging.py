# Moving the head by the buttons of a dialog.  Pure.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .errors import CalibrationError

# By how much (mm) the buttons move the head; more than the largest is refused.
JOGS = (10.0, 1.0, 0.1)
LARGEST_JOG = 10.0


# For a dialog: (label, G-code, colour).  'command' makes the G-code of its axis and
# text.
def button(axis, distance, command):
    text = "%+g" % (distance,)
    label = "%s%s mm" % (axis, text)
    return label, command(**{axis: text}), "secondary"


# All of an axis: three of them fit into a row of a dialog.
def rows(axis, command):
    downwards = [-distance for distance in JOGS]
    for moves in (downwards, reversed(JOGS)):
        yield [button(axis, move, command) for move in moves]


# What a jog leads to (mm), refused where it would go beyond (low, high).  One that
# 'stops' ends at low, as long as there is any way to it.
def jogged(axis, start, distance, low, high, stops=False):
    if abs(distance) > LARGEST_JOG:
        text = "%s=%g: the head is moved by %g mm at most; take smaller steps"
        raise CalibrationError(text % (axis, distance, LARGEST_JOG))
    # Back from beyond a limit is allowed, too
    end = start + distance
    if stops and start > low + 1e-6:
        end = max(end, low)
    low, high = min(low, start), max(high, start)
    if not low - 1e-6 <= end <= high + 1e-6:
        text = "%s=%g would lead to %.3f, outside %.3f to %.3f; move it by less"
        raise CalibrationError(text % (axis, distance, end, low, high))
    return end
