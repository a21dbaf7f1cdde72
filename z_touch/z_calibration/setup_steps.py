"""What the dialogs of Z_CALIBRATION_SETUP ask, in order.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""
# Its texts are no messages: they ask.

from __future__ import annotations

from ..wizard import STOP, Answer, Step
from .switches import SWITCHES

TOUCH_ENDS = "Without a trigger a touch ends at Z={floor:.2f}."

# How low the buttons lead: over a pin that is known, with a probe that reaches below
# the nozzle, or over one whose height is not known
LOWEST = (
    "Lower it with the buttons to {clear:g} mm above the pin: it stops by itself at"
    " Z={floor:.1f}."
)
LOWEST_OF_PROBE = (
    "Lower it with the buttons as far as it goes: it stops by itself at"
    " Z={floor:.1f}, before the probe meets the pin."
)
LOWEST_OF_ANY = (
    "The height of the pin is not known yet: lower the toolhead with care, and stop 1 mm"
    " above the pin; it stops by itself at Z={floor:.1f} only."
)
AT_PLUNGER = (
    "Now the plunger is about over the pin: move some 4 mm along the body.\n"
)
TOO_HIGH = "Still too high: lower it with the buttons."
NEAR_SHEET = "Lower it with the buttons until it just holds the sheet."

# What attaches the probe and puts it away: the user's G-code, or a dock, or the user's
# hands where there is neither
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
    "attach_it": "Attach the probe by hand first, unless it is on the toolhead.",
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

# While something is pressed by hand
PRESS = (
    "What comes next is shown by itself.",
    "Press {switch} by hand now and let go, within {patience:.0f} seconds.",
)

# At the foot of a dialog a "secondary" button looks switched off.
STEPS = (
    Step(
        "pin",
        1,
        "press the pin",
        (
            "Abort ends this at any step: the toolhead is lifted, a probe that was"
            " fetched is put away, nothing is saved.",
            "If the printer is homed, 'Watch' lifts the toolhead to"
            " Z={travel_z:.1f} before; nothing else moves.",
            "'Watch', then press the metal pin down by hand and let go, within"
            " {patience:.0f} seconds.",
        ),
        "Watch",
    ),
    Step(
        "off",
        2,
        "take the probe off",
        (
            "Take the probe off the toolhead.",
            "'Skip' where it cannot be taken off.",
            "'Next' looks whether it is off; nothing moves.",
        ),
        "Next",
        more=(Answer("Skip", "SKIP", "warning"),),
        back="pin",
    ),
    Step(
        "probe",
        3,
        "press the probe",
        (
            "Attach the probe.",
            "'Watch', then press its plunger by hand and let go, within"
            " {patience:.0f} seconds.",
        ),
        "Watch",
        back="off",
    ),
    Step(
        "home",
        4,
        "home the printer",
        (
            "Put the probe where it belongs before a print, and clear the bed.",
            "A printer that levels its bed or gantry should have done so, and"
            " have homed Z again.",
            "'Home' runs G28 if an axis is not homed, and then {goal}.",
        ),
        "Home",
        back="probe",
    ),
    Step(
        "nozzle",
        5,
        "nozzle over the pin",
        (
            "Move the nozzle right over the middle of the pin.",
            "{lowest}",
            "'Here' keeps the place, lifts the toolhead to Z={travel_z:.1f},"
            " {after_here}, and then {goal}.",
        ),
        "Here",
        back="home",
        axes="XYZ",
    ),
    # Follows by itself, and is asked only where that has failed
    Step(
        "attach",
        5,
        "fetch the probe",
        (
            "The place of the nozzle is kept.",
            "{attach_it}",
            "'Attach' {attaching}, and then {goal}.",
        ),
        "Attach",
        back="nozzle",
    ),
    Step(
        "switch",
        6,
        "switch over the pin",
        (
            "{plunger}Move the toolhead until the flat BODY of the switch is over"
            " the pin, and its plunger beside it.",
            "{lowest}",
            "'Here' keeps the place; then {goal}, with the probe over the bed.",
        ),
        "Here",
        back="nozzle",
        axes="XYZ",
        width=1.0,
    ),
    Step(
        "bed",
        7,
        "probe over the bed",
        (
            "Move the toolhead until the probe is over the point of the bed to"
            " measure.",
            "'Here' keeps the place; then {goal}: watch there.",
        ),
        "Here",
        back="switch",
        axes="XY",
    ),
    Step(
        "look",
        8,
        "all places right?",
        (
            "The nozzle was over the pin, then the body of the switch, then the"
            " probe over the bed?",
            "'Again': {goal}.",
            "The buttons with a name lift the toolhead to Z={travel_z:.1f} and go"
            " back to that place.",
            "'Yes' goes on; nothing moves.",
        ),
        "Yes",
        more=(Answer("Again", "AGAIN", "warning"),),
        choices=(
            Answer("Nozzle", "NOZZLE", "secondary"),
            Answer("Switch", "SWITCH", "secondary"),
            Answer("Bed", "BED", "secondary"),
        ),
        back="bed",
    ),
    Step(
        "touch_nozzle",
        9,
        "touch all places",
        (
            "Clean the nozzle.",
            "{attach_it}",
            STOP,
            "Without a trigger the nozzle stops at Z={floor:.2f}; the console says"
            " where it stops at the other places.",
            "'Touch' lifts the toolhead to Z={travel_z:.1f} and touches pin, switch"
            " and bed slowly, {touches} times each{around}.",
        ),
        "Touch",
        back="nozzle",
    ),
    # This and the next one follow by themselves, too
    Step(
        "touch_switch",
        9,
        "touch switch and bed",
        (
            "{repeats}",
            "{attach_it}",
            STOP,
            TOUCH_ENDS,
            "'Touch' lifts the toolhead to Z={travel_z:.1f},{before_switch} goes"
            " over the pin (over the bed before if it is not known how long the"
            " probe is) and lowers it slowly, {touches} times; then the bed.",
        ),
        "Touch",
        back="switch",
    ),
    Step(
        "touch_bed",
        9,
        "touch the bed",
        (
            "{repeats}",
            STOP,
            TOUCH_ENDS,
            "'Touch' lifts the toolhead to Z={travel_z:.1f}, goes over the bed and"
            " lowers the probe slowly, {touches} times{after_bed}.",
        ),
        "Touch",
        back="bed",
    ),
    Step(
        "gap",
        10,
        "how far the switch moves",
        (
            "{repeats}",
            "Last comes how far the switch moves until it triggers: 'Paper'"
            " measures that, and is best.",
            "Without paper take the button of the switch in the probe.",
            "It is the least of any healthy one, so Z=0 is too high on purpose:"
            " {come_down}.",
            "Another value goes in on the console: Z_CALIBRATION_SETUP STEP=GAP"
            " VALUE=mm.",
            "'Paper' lifts the toolhead to Z={travel_z:.1f} and goes with the nozzle"
            " over the bed, down to Z={paper_z:.2f}, about 2 to 3 mm above it.",
        ),
        "Paper",
        choices=tuple(
            Answer(f"{kind} {value:.1f} mm", kind, "secondary", "TYPE")
            for kind, value in SWITCHES.items()
        ),
        back="touch_nozzle",
    ),
    Step(
        "paper",
        11,
        "nozzle to the sheet",
        (
            "Lay a sheet of paper on the bed.",
            "{sheet}",
            "'Here' when the nozzle just holds the sheet; 'Here' and 'Back' lift"
            " the toolhead to Z={travel_z:.1f}.",
        ),
        "Here",
        back="gap",
        axes="Z",
        widths=(1.0, 0.1, 0.01),
        width=1.0,
    ),
    Step(
        "save",
        12,
        "save",
        (
            "{repeats}",
            "{values}",
            "{by_hand}",
            "After this: G28, level and G28 Z if the printer levels, CALIBRATE_Z.",
            "{of_a_list}",
            "{too_small}",
            "{saving}",
        ),
        "Save",
        back="gap",
    ),
)
