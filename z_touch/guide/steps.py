# The steps of Z_CALIBRATION_SETUP: what each asks, and what follows.  Pure.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import math

from ..core import dialogs, jogging
from ..core.errors import CalibrationError
from ..core.sampling import accuracy
from ..z_calibration.switches import COME_DOWN, SWITCHES
from .state import SITES
from .texts import LAST, STEPS

COMMAND = "Z_CALIBRATION_SETUP"

# Seconds to press something by hand
HAND_PATIENCE = 20.0

# A sheet of paper is so thick (mm)
PAPER = 0.1

# From the body to the trigger point (mm): more than any switch has, and less than any
# healthy one
LARGEST_SWITCH_OFFSET = 1.5
SMALLEST_SWITCH_OFFSET = 0.1

# By how much (mm) the buttons move the head over a sheet of paper, and by how much
# as long as it is that far above the highest bed there may be
FINE_JOGS = (0.1, 0.05, 0.01)
ROOMY_JOGS = (1.0, 0.5)

# What the offset should vary by at most (mm, 95 %), and the touches that a site
# has at least and at most
WANTED_UNCERTAINTY = 0.01
FEWEST_SAMPLES = 3
MOST_SAMPLES = 10

ORDER = list(STEPS)

# Done without another question after the step before; asked where that has failed
CHAINED = ("attach", "touch_switch", "touch_bed")

######################################################################
# The order
######################################################################


# The step that comes next in the order; the last one stays.
def after(name):
    return (ORDER + ORDER[-1:])[ORDER.index(name) + 1]


# The step after an answer
def follow(name, answer):
    step = STEPS[name]
    sites = [site.upper() for site in step.sites]
    dialogs.check_answer(name, answer, step.answers, sites)
    if answer == "BACK":
        return step.back
    if answer == "AGAIN":
        return name
    return answer.lower() if answer.lower() in SITES else after(name)


# The step after those that follow by themselves
def next_asked(name):
    following = after(name)
    while following in CHAINED:
        following = after(following)
    return following


def command(name, answer="", **params):
    words = [COMMAND, "STEP=" + name.upper()]
    if answer:
        words.append("ANSWER=" + answer)
    words += ["%s=%s" % item for item in sorted(params.items())]
    return " ".join(words)


ABORT = COMMAND + " STEP=ABORT"


######################################################################
# Dialogs
######################################################################


# Rows of buttons that move the head.  'room': as in facts
def jog_groups(name, room):
    axes = STEPS[name].axes

    def by(**move):
        return command(name, **move)

    if axes != "Z":
        return [row for axis in axes for row in jogging.rows(axis, by)]
    distances = [d for d in ROOMY_JOGS if d <= room] + list(FINE_JOGS)
    return [
        [jogging.button("Z", sign * distance, by) for sign in (-1, 1)]
        for distance in distances
    ]


# Rows of buttons that lead back to a place, or tell the switch
def other_groups(name):
    sites = [
        (site.capitalize(), command(name, site.upper()), "secondary")
        for site in STEPS[name].sites
    ]
    types = [
        ("%s %.1f mm" % (kind, value), command(name, TYPE=kind), "secondary")
        for kind, value in (SWITCHES.items() if name == "gap" else ())
    ]
    return [group for group in (sites, types) if group]


# The answers as (label, G-code, colour)
def buttons(name):
    answers = [
        (label, command(name, word), colour)
        for label, word, colour in STEPS[name].answers
    ]
    return answers + [("Abort", ABORT, "error")]


# 'title': of what goes on in it, if that is more than the step's own
def headline(name, title=""):
    step = STEPS[name]
    return "Step %d of %d: %s" % (step.number, LAST, title or step.title)


# The sentences of a step, the one of the first button last.  'late': what the head
# has yet to do before the step can be answered.
def sentences(name, facts, problem, late):
    step = STEPS[name]
    texts = [line for text in step.text for line in (text % facts).split("\n")]
    texts = [line for line in texts if line]
    if late:
        text = "'%s': %s, then this is asked again."
        texts = [
            "The head is not there yet.",
            text % (step.answers[0][0], late),
        ]
    if facts["back_goal"]:
        texts.insert(-1, "'Back': %s." % (facts["back_goal"],))
    if facts["here"]:
        texts.insert(-1, facts["here"])
    if problem:
        texts.insert(0, "Not done: %s." % (problem.rstrip("."),))
    return texts


# The dialog of a step, and the same for the console
def ask(name, facts, problem="", late=""):
    others = other_groups(name)
    answers, groups = buttons(name), jog_groups(name, facts["room"]) + others
    texts = sentences(name, facts, problem, late)
    shown = list(dialogs.lines(headline(name), texts, answers, groups))
    answers[1:1] = sum(others, [])
    said = [headline(name)] + texts
    said += ["%s: %s" % (label, gcode) for label, gcode, _ in answers]
    if STEPS[name].axes:
        said.append("move the head: %s" % (command(name, Z="+0.1"),))
    return shown, "\n".join(said)


# The dialog of a step until something is pressed by hand; all that it can answer
# waits.  'switch': in words
def while_watching(name, switch):
    texts = (
        "What comes next is shown by itself.",
        "Press %s by hand now and let go, within %d seconds."
        % (switch, HAND_PATIENCE),
    )
    shown = headline(name, "press it now")
    return dialogs.lines(shown, texts, [("Abort", ABORT, "error")])


######################################################################
# What is judged
######################################################################


# What a hand has done to a switch, in a word.  'readings' are pairs: whether it and
# the other one read triggered; the first pair is of before anything was pressed.
def judge(readings):
    (this_before, other_before), readings = readings[0], readings[1:]
    if this_before:
        return "early"
    pressed = [this for this, other in readings]
    other = any(other != other_before for this, other in readings)
    if True not in pressed:
        return "other" if other else "nothing"
    if other:
        return "both"
    return "good" if not pressed[-1] else "held"


# The option's text with the other polarity
def inverted(pin):
    pin = pin.strip()
    if "!" in pin:
        return pin.replace("!", "", 1)
    marks = len(pin) - len(pin.lstrip("^~ "))
    return pin[:marks] + "!" + pin[marks:]


# How well touches repeat, in words, and how many a site should have
def repeatability(samples):
    worst = max(accuracy(z)[5] for z in samples if z)
    # Three sites, and each is averaged
    needed = 3.0 * (2.0 * worst / WANTED_UNCERTAINTY) ** 2
    count = max(FEWEST_SAMPLES, min(MOST_SAMPLES, int(math.ceil(needed))))
    if needed > MOST_SAMPLES:
        return "poor, so clean the nozzle and look for play", count
    word = "good" if needed <= FEWEST_SAMPLES else "fair"
    return "%s; %d touches of each place are enough" % (word, count), count


# switch_offset (mm) if the nozzle at z holds the sheet: 'contact' is the toolhead Z
# of the bed with a switch_offset of 0.
def held_at(contact, z):
    return round(contact - (z - PAPER), 3) + 0.0


# Whether nothing can be held there: every switch moves before it triggers
def is_too_high(contact, z):
    return held_at(contact, z) <= 0.0


# switch_offset (mm) with the nozzle at z where it holds the sheet; raises
# CalibrationError where it cannot
def from_paper(contact, z):
    switch_offset = held_at(contact, z)
    if is_too_high(contact, z):
        raise CalibrationError(
            "still too high, by %.3f mm at least: the nozzle cannot hold the"
            " sheet yet; lower it" % (abs(switch_offset),)
        )
    if switch_offset > LARGEST_SWITCH_OFFSET:
        raise CalibrationError(
            "the switch would move by %.3f mm, and none by more than %g mm;"
            " check that the nozzle holds the sheet and that the pin presses"
            " the body" % (switch_offset, LARGEST_SWITCH_OFFSET)
        )
    return switch_offset


# By how much (mm) the nozzle at z is above where it may hold the sheet
def paper_room(contact, z):
    return z - (contact + PAPER)


# The lowest z (mm) of a jog with the sheet: above all beds in small steps only
def paper_floor(contact, z, distance):
    if distance < -FINE_JOGS[0] - 1e-6 and z + distance < contact + PAPER:
        return min(z, contact + PAPER)
    return contact - LARGEST_SWITCH_OFFSET


# Of a switch_offset (mm) that no healthy switch has, for the last step; else empty
def too_small(switch_offset):
    if switch_offset >= SMALLEST_SWITCH_OFFSET:
        return ""
    text = (
        "%.3f mm is less than any healthy switch moves: did the nozzle hold the"
        " sheet? If not, Z=0 is too high; 'Back', then 'Paper'."
    )
    return text % (switch_offset,)


# What a switch from the list means for Z=0, for the last step; empty: it was measured
def of_a_list(kind):
    if not kind:
        return ""
    text = "With the %.1f mm of any %s Z=0 is too high on purpose: %s."
    return text % (SWITCHES[kind], kind, COME_DOWN)


def as_pair(site):
    return "%.3f, %.3f" % (site.x, site.y)
