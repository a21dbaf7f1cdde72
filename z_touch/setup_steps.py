# The steps of Z_CALIBRATION_SETUP: what each asks, and what follows.  Pure.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import division

import collections
import math

from .dialogs import lines
from .errors import CalibrationError
from .sampling import accuracy

COMMAND = "Z_CALIBRATION_SETUP"

# Seconds to press something by hand
PATIENCE = 20.0

# A sheet of paper (mm)
PAPER = 0.1

# From the body to the trigger point (mm): common switches, and what none has
SWITCHES = collections.OrderedDict((("D2F", 0.5), ("SSG", 0.7)))
LARGEST_SWITCH_OFFSET = 1.5

# Steps (mm) of the buttons that move the head
JOGS = (10.0, 1.0, 0.1)
LARGEST_JOG = 10.0
FINE_JOGS = (0.1, 0.05, 0.01)

# What the offset should vary by at most (mm, 95 %), and the touches that a site
# has at least and at most
WANTED = 0.01
FEWEST, MOST = 3, 10

# 'text' is filled in from facts; 'answers' are (label, word, colour), the first
# one without a word; 'back' is the step that BACK leads to; 'axes' are those
# with buttons to jog.
Step = collections.namedtuple("Step", "name headline text answers back axes")


def step(name, headline, text, go_on, more=(), back=None, axes=""):
    answers = ((go_on, "", "primary"),) + tuple(more)
    if back is not None:
        answers += (("Back", "BACK", "secondary"),)
    return Step(name, headline, text, answers, back, axes)


HERE = "Move the head with the buttons, or as you like, until %s. "
TOUCH = (
    "'Touch' lifts the head to Z=%%(travel_z).1f, %s, and lowers it slowly,"
    " %%(touches)d times. Where nothing is met, a touch ends at Z=%%(floor).2f."
    " Keep a hand on the emergency stop."
)

ALL = (
    step(
        "pin",
        "Press the pin",
        "Nothing moves yet. 'Watch', then press the metal pin down by"
        " hand and let go, within %(patience)d seconds. Abort ends"
        " this at any step: the head is lifted, end_gcode puts away a"
        " probe that was fetched, nothing is saved.",
        "Watch",
    ),
    step(
        "off",
        "Take the probe off",
        "Take the probe off the head, then 'Next'. 'Skip' where it"
        " cannot be taken off.",
        "Next",
        [("Skip", "SKIP", "secondary")],
    ),
    step(
        "probe",
        "Press the probe",
        "Attach the probe. 'Watch', then press its plunger by hand and"
        " let go, within %(patience)d seconds.",
        "Watch",
        back="off",
    ),
    step(
        "home",
        "Home the printer",
        "Put the probe where it belongs before a print, and clear the"
        " bed. 'Home' runs G28 if an axis is not homed, and then"
        " %(goal)s. A printer that levels its bed or gantry should have"
        " done so, and have homed Z again.",
        "Home",
        back="probe",
    ),
    step(
        "nozzle",
        "Nozzle over the pin",
        HERE
        % "the nozzle is right over the middle of the pin"
        + "'Here' keeps that place and lifts the head to"
        " Z=%(travel_z).1f.",
        "Here",
        axes="XYZ",
    ),
    step(
        "attach",
        "Fetch the probe",
        "'Attach' runs start_gcode and before_switch_gcode, unless the"
        " probe is attached. Then %(goal)s, where the body of its"
        " switch should be over the pin.",
        "Attach",
        back="nozzle",
    ),
    step(
        "switch",
        "Switch over the pin",
        HERE % "the BODY of the probe's switch is over the pin, and its"
        " plunger beside it" + "'Here' keeps that place; then %(goal)s,"
        " with the probe over the bed.",
        "Here",
        back="nozzle",
        axes="XYZ",
    ),
    step(
        "bed",
        "Probe over the bed",
        HERE
        % "the probe is over the point of the bed to measure"
        + "'Here' keeps that place; then %(goal)s, to look at all"
        " places once more.",
        "Here",
        back="switch",
        axes="XYZ",
    ),
    step(
        "look_nozzle",
        "Nozzle: looks right?",
        "Is the nozzle over the pin? 'Yes': %(goal)s.",
        "Yes",
        back="nozzle",
    ),
    step(
        "look_switch",
        "Switch: looks right?",
        "Is the body of the switch over the pin? 'Yes': %(goal)s.",
        "Yes",
        back="switch",
    ),
    step(
        "look_bed",
        "Bed: looks right?",
        "Is the probe over the bed? 'Yes' goes on; nothing moves.",
        "Yes",
        back="bed",
    ),
    step(
        "touch_nozzle",
        "First touches of the nozzle",
        "Clean the nozzle. "
        + TOUCH
        % (
            "runs end_gcode if the probe was fetched, runs start_gcode, goes"
            " over the pin"
        ),
        "Touch",
        back="nozzle",
    ),
    step(
        "touch_switch",
        "First touches of the switch",
        "%(found)s "
        + TOUCH
        % (
            "runs before_switch_gcode, goes over the pin (over the bed before"
            " if z_offset of the probe does not say how long it is)"
        ),
        "Touch",
        back="switch",
    ),
    step(
        "touch_bed",
        "First touches of the bed",
        "%(found)s "
        + TOUCH % ("goes over the bed",)
        + " After that end_gcode puts the probe away.",
        "Touch",
        back="bed",
    ),
    step(
        "gap",
        "Which switch has the probe?",
        "%(found)s Which switch is in the probe? Take its button, or on"
        " the console TYPE=D2F, TYPE=SSG or VALUE=mm. 'Paper' lifts the"
        " head to Z=%(travel_z).1f and goes with the nozzle over the"
        " bed, down to Z=%(paper_z).2f, about 2 to 3 mm above it.",
        "Paper",
    ),
    step(
        "paper",
        "Nozzle to the sheet",
        "Lay a sheet of paper on the bed. Lower the nozzle with the"
        " buttons until it just holds the sheet. 'Here' keeps that"
        " and lifts the head to Z=%(travel_z).1f.",
        "Here",
        back="gap",
        axes="Z",
    ),
    step(
        "save",
        "Save",
        "%(found)s 'Save' hands this to SAVE_CONFIG, which writes"
        " printer.cfg and restarts Klipper: %(values)s.%(not_saved)s",
        "Save",
        back="gap",
    ),
)
STEPS = collections.OrderedDict((step.name, step) for step in ALL)
ORDER = list(STEPS)


# In the order; the last one stays
def after(name):
    return (ORDER + ORDER[-1:])[ORDER.index(name) + 1]


# The step after an answer
def follow(name, answer):
    words = [word for label, word, colour in STEPS[name].answers]
    if answer not in words:
        raise CalibrationError(
            "ANSWER=%s is none of STEP=%s: %s"
            % (answer, name, ", ".join(word or "none" for word in words))
        )
    if answer == "BACK":
        return STEPS[name].back
    return after(name)


def command(name, answer="", **params):
    words = [COMMAND, "STEP=" + name.upper()]
    if answer:
        words.append("ANSWER=" + answer)
    words += ["%s=%s" % item for item in sorted(params.items())]
    return " ".join(words)


ABORT = COMMAND + " STEP=ABORT"


def jog_button(name, axis, distance):
    text = "%+g" % (distance,)
    return axis + text, command(name, **{axis: text}), "secondary"


# Rows of buttons that move the head: four fit
def jog_groups(name):
    axes, groups = STEPS[name].axes, []
    for distance in JOGS if "X" in axes else ():
        groups.append(
            [
                jog_button(name, axis, sign * distance)
                for axis in "XY"
                for sign in (-1, 1)
            ]
        )
    steps = JOGS if "X" in axes else FINE_JOGS
    for pair in (steps[:2], steps[2:]) if axes else ():
        groups.append(
            [jog_button(name, "Z", s * d) for d in pair for s in (-1, 1)]
        )
    return groups


# The answers as (label, G-code, colour)
def buttons(name):
    found = [
        (label, command(name, word), colour)
        for label, word, colour in STEPS[name].answers
    ]
    return found + [("Abort", ABORT, "error")]


# The dialog of a step, and the same for the console.  'late': what the head has
# yet to do before the step can be answered.
def ask(name, facts, problem="", late=""):
    groups = jog_groups(name)
    if name == "gap":
        groups.append(
            [(t, command(name, TYPE=t), "secondary") for t in SWITCHES]
        )
    text = STEPS[name].text % facts
    if late:
        text = "The head is not there yet. '%s': %s, then this is asked again."
        text %= (STEPS[name].answers[0][0], late)
    if facts["back_goal"]:
        text += " 'Back': %s." % (facts["back_goal"],)
    if problem:
        text = "Not done: %s. %s" % (problem.rstrip("."), text)
    shown = list(lines(STEPS[name].headline, text, buttons(name), groups))
    said = ["%s: %s" % (STEPS[name].headline, text)]
    said += ["%s: %s" % (label, gcode) for label, gcode, _ in buttons(name)]
    if STEPS[name].axes:
        said.append("move the head: %s" % (command(name, Z="+0.1"),))
    return shown, "\n".join(said)


# What a hand has done to a switch, from pairs: whether it and another one read
# triggered, the first before anything was pressed.
def judge(readings):
    (own_before, other_before), readings = readings[0], readings[1:]
    if own_before:
        return "pressed already"
    own = [own for own, other in readings]
    other = any(other != other_before for own, other in readings)
    if True not in own:
        return "other" if other else "nothing"
    if other:
        return "both"
    return "good" if not own[-1] else "not released"


# The option's text with the other polarity
def inverted(pin):
    pin = pin.strip()
    if "!" in pin:
        return pin.replace("!", "", 1)
    marks = len(pin) - len(pin.lstrip("^~ "))
    return pin[:marks] + "!" + pin[marks:]


# What a jog leads to (mm), refused where it would go beyond (low, high).
def jogged(axis, start, distance, low, high):
    if abs(distance) > LARGEST_JOG:
        text = "%s=%g: the head is moved by at most %g mm at once"
        raise CalibrationError(text % (axis, distance, LARGEST_JOG))
    # Out of a place beyond the limit, too
    end = start + distance
    low, high = min(low, start), max(high, start)
    if not low - 1e-6 <= end <= high + 1e-6:
        text = "%s=%+g would lead to %.3f, outside %.3f to %.3f; nothing moves"
        raise CalibrationError(text % (axis, distance, end, low, high))
    return end


# How well touches repeat, in a word, and how many a site should have
def repeatability(samples):
    worst = max(accuracy(z)[5] for z in samples if z)
    # Three sites, and each is averaged
    needed = 3.0 * (2.0 * worst / WANTED) ** 2
    count = max(FEWEST, min(MOST, int(math.ceil(needed))))
    word = "good" if needed <= FEWEST else "fair"
    if needed > MOST:
        word = "poor: clean the nozzle, look for play"
    return word, count


# switch_offset (mm) with the nozzle at z where it holds the sheet: 'contact' is
# the toolhead Z of the bed with a switch_offset of 0.
def from_paper(contact, z):
    found = contact - (z - PAPER)
    if not 0.0 <= found <= LARGEST_SWITCH_OFFSET:
        raise CalibrationError(
            "a switch_offset of %.3f is that of no switch (0 to %g mm); does"
            " the nozzle hold the sheet, and the pin press the body?"
            % (found, LARGEST_SWITCH_OFFSET)
        )
    return round(found, 3)


# The lowest z (mm) of a jog with the sheet: above all beds in small steps only
def paper_floor(contact, z, distance):
    if distance < -FINE_JOGS[0] - 1e-6 and z + distance < contact + PAPER:
        return min(z, contact + PAPER)
    return contact - LARGEST_SWITCH_OFFSET


def as_pair(site):
    return "%.3f, %.3f" % (site.x, site.y)
