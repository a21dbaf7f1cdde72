# What the dialogs of DOCKABLE_PROBE_SETUP ask.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import collections

# 'text' is filled in from facts; 'answers' are (label, word, colour), the first
# one without a word; 'back' is the step that BACK leads to, None: none.  With
# 'jogs' there are buttons that move the head.
Step = collections.namedtuple("Step", "headline text answers back jogs")

BY_HAND = "Move the head with the buttons, or as you like, until it stands %s. "


def step(headline, text, go_on, more=(), back=None, jogs=False):
    answers = ((go_on, "", "primary"),) + tuple(more)
    if back is not None:
        answers += (("Back", "BACK", "warning"),)
    return Step(headline, text, answers, back, jogs)


STEPS = collections.OrderedDict(
    (
        (
            "on",
            step(
                "Put the probe on the head",
                "Put the probe on the head by hand. 'Next' looks whether the pins"
                " say so (%(pins)s now), and whether the axes are homed that lead"
                " to the dock: %(axes)s. Nothing moves. Abort ends this at any"
                " step, nothing is saved then.",
                "Next",
            ),
        ),
        (
            "dock",
            step(
                "Push the probe into its dock",
                BY_HAND
                % "where the probe on it sits in the dock as it should, with the"
                " magnets of both in place"
                + "'Here' takes that as dock_position.",
                "Here",
                back="on",
                jogs=True,
            ),
        ),
        (
            "out",
            step(
                "Leave without the probe",
                BY_HAND
                % "some 40 mm out of the dock, along a straight way on which the"
                " dock holds the probe back"
                + "'Here' looks whether it was left there, and takes that as"
                " detach_position.",
                "Here",
                back="dock",
                jogs=True,
            ),
        ),
        (
            "approach",
            step(
                "Go before the dock",
                BY_HAND
                % "some 40 mm before the dock, where it goes straight in to meet"
                " the probe, and comes out with it. Go around the dock"
                + "'Here' takes that as approach_position.",
                "Here",
                back="out",
                jogs=True,
            ),
        ),
        (
            "insert",
            step(
                "The way in with the probe",
                "To put the probe back most docks are entered the same way:"
                " 'Same'. For another one move the head to where that begins, then"
                " 'Here', which takes it as insert_position.",
                "Same",
                (("Here", "HERE", "secondary"),),
                back="approach",
                jogs=True,
            ),
        ),
        (
            "fetch",
            step(
                "Fetch the probe, slowly",
                "dock %(dock)s, out to %(detach)s, before it %(approach)s, with the"
                " probe from %(insert)s. 'Fetch' goes there, into the dock and out"
                " again, at %(slow)g mm/s. Keep a hand on the emergency stop.",
                "Fetch",
                back="approach",
            ),
        ),
        (
            "store",
            step(
                "Dock the probe, slowly",
                "The probe came along. 'Dock' goes into the dock with it and out to"
                " %(detach)s, at %(slow)g mm/s. Keep a hand on the emergency stop.",
                "Dock",
                back="insert",
            ),
        ),
        (
            "save",
            step(
                "Save",
                "It was fetched and docked. 'Save' writes %(values)s, and restarts"
                " the printer. Then home, and measure z_offset over the bed with"
                " PROBE_CALIBRATE.%(not_saved)s",
                "Save",
            ),
        ),
    )
)
ORDER = list(STEPS)
