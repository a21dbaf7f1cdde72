# What the dialogs of DOCKABLE_PROBE_SETUP ask.
# Its texts are no messages: they ask.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from ..core.dialogs import JOGS, STOP

# 'text' has a sentence a line, filled in from facts; the last one says what the first
# button does, and is all that KlipperScreen shows.  'answers' are (label, word,
# colour), the first one without a word; 'back' is the step that BACK leads to, None:
# none.  With 'jogs' there are buttons that move the head.
Step = collections.namedtuple("Step", "title text answers back jogs")


def step(title, text, go_on, more=(), back=None, jogs=False):
    answers = ((go_on, "", "primary"),) + tuple(more)
    if back is not None:
        answers += (("Back", "BACK", "warning"),)
    return Step(title, text, answers, back, jogs)


STEPS = collections.OrderedDict(
    (
        (
            "on",
            step(
                "put the probe on",
                (
                    "Put the probe on the head by hand.",
                    "Abort ends this at any step, nothing is saved then.",
                    "'Next' looks whether the pins say so (%(pins)s now), and"
                    " whether the axes are homed that lead to the dock:"
                    " %(axes)s; nothing moves.",
                ),
                "Next",
            ),
        ),
        (
            "dock",
            step(
                "push it into its dock",
                (
                    JOGS,
                    "'Here' when the probe on the head sits in the dock as it"
                    " should, with the magnets of both in place.",
                ),
                "Here",
                back="on",
                jogs=True,
            ),
        ),
        (
            "out",
            step(
                "leave without the probe",
                (
                    JOGS,
                    "Leave along a straight way on which the dock holds the"
                    " probe back.",
                    "'Here' some 40 mm out of the dock; it looks whether the"
                    " probe was left there.",
                ),
                "Here",
                back="dock",
                jogs=True,
            ),
        ),
        (
            "approach",
            step(
                "go before the dock",
                (
                    JOGS,
                    "Go around the dock.",
                    "'Here' some 40 mm before the dock, where the head goes"
                    " straight in to meet the probe, and comes out with it.",
                ),
                "Here",
                back="out",
                jogs=True,
            ),
        ),
        (
            "insert",
            step(
                "the way in with the probe",
                (
                    JOGS,
                    "For another way in move the head to where that begins,"
                    " then 'Here'.",
                    "'Same': to put the probe back the dock is entered the same"
                    " way, as most docks are.",
                ),
                "Same",
                (("Here", "HERE", "secondary"),),
                back="approach",
                jogs=True,
            ),
        ),
        (
            "fetch",
            step(
                "fetch the probe",
                (
                    "dock %(dock)s, out to %(detach)s, before it %(approach)s,"
                    " with the probe from %(insert)s.",
                    STOP,
                    "'Fetch' goes there, into the dock and out again, at"
                    " %(slow)g mm/s.",
                ),
                "Fetch",
                back="approach",
            ),
        ),
        (
            "store",
            step(
                "dock the probe",
                (
                    "The probe came along.",
                    STOP,
                    "'Dock' goes into the dock with it and out to %(detach)s, at"
                    " %(slow)g mm/s.",
                ),
                "Dock",
                back="insert",
            ),
        ),
        (
            "save",
            step(
                "save",
                (
                    "It was fetched and docked.",
                    "%(values)s",
                    "%(not_saved)s",
                    "Then home, and measure how low the probe hangs over the bed"
                    " with PROBE_CALIBRATE.",
                    "%(saving)s",
                ),
                "Save",
            ),
        ),
    )
)
ORDER = list(STEPS)
