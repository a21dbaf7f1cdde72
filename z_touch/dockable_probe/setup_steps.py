"""What the dialogs of DOCKABLE_PROBE_SETUP ask, in order.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""
# Its texts are no messages: they ask.

from __future__ import annotations

from ..wizard import STOP, Answer, Step

KEEPS = "'Here' keeps the place; nothing moves."

STEPS = (
    Step(
        "on",
        1,
        "put the probe on",
        (
            "Put the probe on the toolhead by hand.",
            "Abort ends this at any step, nothing is saved then.",
            "'Next' looks whether the pins say so ({pins} now), and whether the"
            " axes are homed that lead to the dock: {axes}; nothing moves.",
        ),
        "Next",
    ),
    Step(
        "dock",
        2,
        "push it into its dock",
        (
            "Push the probe on the toolhead into its dock, until it sits there as it"
            " should, with the magnets of both in place.",
            KEEPS,
        ),
        "Here",
        back="on",
        axes="XYZ",
    ),
    Step(
        "out",
        3,
        "leave without the probe",
        (
            "Leave the dock along a straight way on which it holds the probe back,"
            " by some 40 mm.",
            "'Here' looks whether the probe was left in the dock, and keeps the"
            " place; nothing moves.",
        ),
        "Here",
        back="dock",
        axes="XYZ",
    ),
    Step(
        "approach",
        4,
        "go before the dock",
        (
            "Go around the dock, to some 40 mm before it: where the toolhead goes"
            " straight in to meet the probe, and comes out with it.",
            KEEPS,
        ),
        "Here",
        back="out",
        axes="XYZ",
    ),
    Step(
        "insert",
        5,
        "the way in with the probe",
        (
            "For another way in move the toolhead to where that begins, then 'Here'.",
            "'Same': to put the probe back the dock is entered the same way, as"
            " most docks are.",
        ),
        "Same",
        more=(Answer("Here", "HERE", "warning"),),
        back="approach",
        axes="XYZ",
    ),
    Step(
        "fetch",
        6,
        "fetch the probe",
        (
            "dock {dock}, out to {detach}, before it {approach}, with the probe"
            " from {insert}.",
            STOP,
            "'Fetch' goes there, into the dock and out again, at {slow:g} mm/s.",
        ),
        "Fetch",
        back="approach",
    ),
    Step(
        "store",
        7,
        "dock the probe",
        (
            "The probe came along.",
            STOP,
            "'Dock' goes into the dock with it and out to {detach}, at {slow:g}"
            " mm/s.",
        ),
        "Dock",
        back="insert",
    ),
    Step(
        "save",
        8,
        "save",
        (
            "It was fetched and docked.",
            "{values}",
            "{by_hand}",
            "Then home, and measure how low the probe hangs over the bed with"
            " PROBE_CALIBRATE.",
            "{saving}",
        ),
        "Save",
        back="fetch",
    ),
)
