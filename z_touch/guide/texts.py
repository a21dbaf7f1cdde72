# What the dialogs of Z_CALIBRATION_SETUP ask.
# Its texts are no messages: they ask.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from ..core.dialogs import JOGS, STOP

# 'number' counts what a person has to press; steps that follow by themselves share
# one.  'text' has a sentence a line, filled in from facts; the last one says what the
# first button does, and is all that KlipperScreen shows.  'answers' are (label, word,
# colour), the first one without a word; 'back' is the step that BACK leads to,
# 'places' the steps that buttons of their own lead back to; 'axes' are those with
# buttons to jog.  At the foot of a dialog, "secondary" looks switched off.
Step = collections.namedtuple(
    "Step", "name number title text answers back sites axes"
)


# 'given': what a step has besides, by the words of Step; 'more' answers
def step(name, number, title, text, go_on, **given):
    answers = ((go_on, "", "primary"),) + tuple(given.get("more", ()))
    back, sites = given.get("back"), given.get("sites", ())
    if back is not None:
        answers += (("Back", "BACK", "warning"),)
    axes = given.get("axes", "")
    return Step(name, number, title, text, answers, back, sites, axes)


TOUCH_ENDS = "Where nothing is met, a touch ends at Z=%(floor).2f."

# How low the buttons lead: over a pin that is known, with something that hangs below
# the nozzle, or over one of which nobody knows how high it is
LOWEST = (
    "Lower it with the buttons to %g mm above the pin: it stops by itself at"
    " Z=%.1f."
)
LOWEST_OF_PROBE = (
    "Lower it with the buttons as far as it goes: it stops by itself at Z=%.1f,"
    " before what hangs there meets the pin."
)
LOWEST_OF_ANY = (
    "Nobody knows yet how high the pin is: lower the head with care, and stop 1 mm"
    " above the pin; it stops by itself at Z=%.1f only."
)
AT_PLUNGER = (
    "Now the plunger is about over the pin: move some 4 mm along the body.\n"
)
TOO_HIGH = "Still too high: lower it with the buttons."
NEAR_SHEET = "Lower it with the buttons until it just holds the sheet."

# Who puts the probe on the head and takes it off: the owner's G-code, or a dock, or
# his hands where there is neither
BY_GCODE = {
    "attach_it": "",
    "after_here": "fetches the probe by your own G-code unless it is there",
    "attaching": "runs your own G-code that fetches the probe, unless it is there",
    "around": "; your own G-code puts the probe away before, fetches it and puts"
    " it away again",
    "before_switch": " fetches the probe by your own G-code,",
    "after_bed": "; then your own G-code puts it away",
}
BY_HAND = {
    "attach_it": "Attach the probe by hand first, unless it is on the head.",
    "after_here": "asks for the probe unless it is there",
    "attaching": "looks whether it is there",
    "around": "",
    "before_switch": "",
    "after_bed": "",
}

# What is looked at over each place
LOOKED_AT = {
    "nozzle": "is the nozzle over the pin?",
    "switch": "is the body of the switch over the pin?",
    "bed": "is the probe over the point of the bed?",
}

ALL = (
    step(
        "pin",
        1,
        "press the pin",
        (
            "Abort ends this at any step: the head is lifted, a probe that was"
            " fetched is put away, nothing is saved.",
            "If the printer is homed, 'Watch' lifts the head to"
            " Z=%(travel_z).1f before; nothing else moves.",
            "'Watch', then press the metal pin down by hand and let go, within"
            " %(patience)d seconds.",
        ),
        "Watch",
    ),
    step(
        "off",
        2,
        "take the probe off",
        (
            "Take the probe off the head.",
            "'Skip' where it cannot be taken off.",
            "'Next' looks whether it is off; nothing moves.",
        ),
        "Next",
        more=[("Skip", "SKIP", "warning")],
    ),
    step(
        "probe",
        3,
        "press the probe",
        (
            "Attach the probe.",
            "'Watch', then press its plunger by hand and let go, within"
            " %(patience)d seconds.",
        ),
        "Watch",
        back="off",
    ),
    step(
        "home",
        4,
        "home the printer",
        (
            "Put the probe where it belongs before a print, and clear the bed.",
            "A printer that levels its bed or gantry should have done so, and"
            " have homed Z again.",
            "'Home' runs G28 if an axis is not homed, and then %(goal)s.",
        ),
        "Home",
        back="probe",
    ),
    step(
        "nozzle",
        5,
        "nozzle over the pin",
        (
            "Move the nozzle right over the middle of the pin.",
            JOGS,
            "%(lowest)s",
            "'Here' keeps the place, lifts the head to Z=%(travel_z).1f,"
            " %(after_here)s, and then %(goal)s.",
        ),
        "Here",
        axes="XYZ",
    ),
    step(
        "attach",
        5,
        "fetch the probe",
        (
            "The place of the nozzle is kept.",
            "%(attach_it)s",
            "'Attach' %(attaching)s, and then %(goal)s.",
        ),
        "Attach",
        back="nozzle",
    ),
    step(
        "switch",
        6,
        "switch over the pin",
        (
            "%(plunger)sMove the head until the flat BODY of the switch is over"
            " the pin, and its plunger beside it.",
            JOGS,
            "%(lowest)s",
            "'Here' keeps the place; then %(goal)s, with the probe over the bed.",
        ),
        "Here",
        back="nozzle",
        axes="XYZ",
    ),
    step(
        "bed",
        7,
        "probe over the bed",
        (
            "Move the head until the probe is over the point of the bed to"
            " measure.",
            JOGS,
            "'Here' keeps the place; then %(goal)s: watch there.",
        ),
        "Here",
        back="switch",
        axes="XYZ",
    ),
    step(
        "look",
        8,
        "all places right?",
        (
            "The nozzle was over the pin, then the body of the switch, then the"
            " probe over the bed?",
            "'Again': %(look_goal)s.",
            "The buttons with a name lift the head to Z=%(travel_z).1f and go"
            " back to that place.",
            "'Yes' goes on; nothing moves.",
        ),
        "Yes",
        more=[("Again", "AGAIN", "warning")],
        sites=("nozzle", "switch", "bed"),
    ),
    step(
        "touch_nozzle",
        9,
        "touch all places",
        (
            "Clean the nozzle.",
            "%(attach_it)s",
            STOP,
            "Where no pin is met, the nozzle stops at Z=%(floor).2f; the console"
            " says that of the other places.",
            "'Touch' lifts the head to Z=%(travel_z).1f and touches pin, switch"
            " and bed slowly, %(touches)d times each%(around)s.",
        ),
        "Touch",
        back="nozzle",
    ),
    step(
        "touch_switch",
        9,
        "touch switch and bed",
        (
            "%(repeats)s",
            "%(attach_it)s",
            STOP,
            TOUCH_ENDS,
            "'Touch' lifts the head to Z=%(travel_z).1f,%(before_switch)s goes"
            " over the pin (over the bed before if nobody knows how long the"
            " probe is) and lowers it slowly, %(touches)d times; then the bed.",
        ),
        "Touch",
        back="switch",
    ),
    step(
        "touch_bed",
        9,
        "touch the bed",
        (
            "%(repeats)s",
            STOP,
            TOUCH_ENDS,
            "'Touch' lifts the head to Z=%(travel_z).1f, goes over the bed and"
            " lowers the probe slowly, %(touches)d times%(after_bed)s.",
        ),
        "Touch",
        back="bed",
    ),
    step(
        "gap",
        10,
        "how far the switch moves",
        (
            "%(repeats)s",
            "Last comes how far the switch moves until it triggers: 'Paper'"
            " measures that, and is best.",
            "Without paper take the button of the switch in the probe.",
            "It is the least of any healthy one, so Z=0 is too high on purpose:"
            " %(come_down)s.",
            "Another value goes in on the console: Z_CALIBRATION_SETUP STEP=GAP"
            " VALUE=mm.",
            "'Paper' lifts the head to Z=%(travel_z).1f and goes with the nozzle"
            " over the bed, down to Z=%(paper_z).2f, about 2 to 3 mm above it.",
        ),
        "Paper",
    ),
    step(
        "paper",
        11,
        "nozzle to the sheet",
        (
            "Lay a sheet of paper on the bed.",
            "%(sheet)s",
            "'Here' when the nozzle just holds the sheet; 'Here' and 'Back' lift"
            " the head to Z=%(travel_z).1f.",
        ),
        "Here",
        back="gap",
        axes="Z",
    ),
    step(
        "save",
        12,
        "save",
        (
            "%(repeats)s",
            "%(values)s",
            "%(not_saved)s",
            "After this: G28, level and G28 Z if the printer levels, CALIBRATE_Z.",
            "%(of_a_list)s",
            "%(too_small)s",
            "%(saving)s",
        ),
        "Save",
        back="gap",
    ),
)
STEPS = collections.OrderedDict((step.name, step) for step in ALL)
LAST = max(step.number for step in ALL)
