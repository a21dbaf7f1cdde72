# What the dialogs of Z_CALIBRATION_SETUP ask.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import collections

# 'text' is filled in from facts; 'answers' are (label, word, colour), the first
# one without a word; 'back' is the step that BACK leads to; 'axes' are those
# with buttons to jog.  At the foot of a dialog, "secondary" looks switched off.
Step = collections.namedtuple("Step", "name headline text answers back axes")


def step(name, headline, text, go_on, more=(), back=None, axes=""):
    answers = ((go_on, "", "primary"),) + tuple(more)
    if back is not None:
        answers += (("Back", "BACK", "warning"),)
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
        "'Watch', then press the metal pin down by hand and let go, within"
        " %(patience)d seconds. If the printer is homed, 'Watch' lifts the head"
        " to Z=%(travel_z).1f before; nothing else moves. Abort ends"
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
        [("Skip", "SKIP", "warning")],
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
        "%(repeats)s "
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
        "%(repeats)s "
        + TOUCH % ("goes over the bed",)
        + " After that end_gcode puts the probe away.",
        "Touch",
        back="bed",
    ),
    step(
        "gap",
        "Measure the gap with paper",
        "%(repeats)s Last comes how far the switch moves until it triggers."
        " 'Paper' measures that, and is best: it lifts the head to"
        " Z=%(travel_z).1f and goes with the nozzle over the bed, down to"
        " Z=%(paper_z).2f, about 2 to 3 mm above it. Without paper take the"
        " button of the switch in the probe: %(switches)s, the least of any"
        " healthy one, so Z=0 is too high on purpose; %(come_down)s. Another"
        " value goes in on the console: Z_CALIBRATION_SETUP STEP=GAP VALUE=mm.",
        "Paper",
    ),
    step(
        "paper",
        "Nozzle to the sheet",
        "Lay a sheet of paper on the bed. Lower the nozzle with the"
        " buttons until it just holds the sheet. 'Here' keeps that."
        " 'Here' and 'Back' lift the head to Z=%(travel_z).1f.",
        "Here",
        back="gap",
        axes="Z",
    ),
    step(
        "save",
        "Save",
        "%(repeats)s After this, home (G28) and run CALIBRATE_Z.%(of_a_list)s"
        " 'Save' hands this to SAVE_CONFIG, which writes printer.cfg and"
        " restarts Klipper: %(values)s.%(not_saved)s",
        "Save",
        back="gap",
    ),
)
STEPS = collections.OrderedDict((step.name, step) for step in ALL)
