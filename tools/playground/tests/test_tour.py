"""The tour of docs/playground.md, typed and pressed word for word.

What is slanted there is pressed, or chosen, or opened; what is code is typed:
`option: value` and bare options into printer.cfg, all else into the console. What has to come of each step is below.
"""

from __future__ import annotations

import re
import time
from typing import NamedTuple

import pytest

from simplay.commands import COMMANDS
from simplay.tests.browser import LIMIT
from tools.playground import tour
from tools.playground.playground import SHOWN
from tools.playground.tests.test_page import (
    gap,
    has_card,
    looking,
    port,
    set_speed,
)

__all__ = ["port"]

# What is only spoken of
SPOKEN_OF = {
    "Home": ["position_endstop"],
    "Calibrate": ["switch_offset", "CALIBRATE_Z"],
    "Break a wire": ["CRASH"],
    "Look at the report": ["break", "short", "late"],
}
# In the guide, which begins with the word before it
GUIDED = "From here on"
WHILE = "while it touches with the body"
# Buttons that are always there; all others are those of dialogs
SHORTCUTS = ("Home", "Calibrate", "Set up", "Report", "Save config")
# What a command says last
ENDS = r"!! |\+-\d"


# What hands do before a step's first button is pressed, and what is told then; what
# they do after it
BEFORE = {
    "OFF": ("off", "off the toolhead"),
    "PROBE": ("attach", "on the toolhead"),
    "GAP": ("off", "off the toolhead"),
}
AFTER = {"PIN": "press z_endstop", "PROBE": "press probe"}


def guide(page):
    """The buttons of its dialogs, and hands, until it saves."""
    for _ in range(60):
        gcode = page.until(lambda: first_button(page), "a dialog")
        step = re.search(r"STEP=(\w+)", gcode)[1]
        if step in BEFORE:
            hand, words = BEFORE[step]
            page.do(hand)
            page.until(lambda w=words: w in page.text("#told"), hand)
        if step == "SWITCH" and has_button(page, "X+1 mm"):
            check_pad(page)
            # The plunger is over the pin: along the body
            before = pin_in_lens(page)
            for _ in range(4):
                jog(page, "X+1 mm")
            page.until(lambda b=before: pin_in_lens(page) < b - 5, "it moves")
        elif step == "PAPER":
            lower(page)
        label = page.until(lambda: first_button(page, "textContent"), "asked")
        if step in AFTER:
            # It waits for 20 s of the printer, of which a slow browser takes much
            set_speed(page, 1)
        page.press("#dialog", label)
        if step in AFTER:
            page.until(
                lambda: "press it now" in page.text("#dialog"), "it watches"
            )
            page.do(AFTER[step])
            set_speed(page, 4)
        if label == "Save":
            return
        until_asked(page, gcode)
    raise AssertionError("the guide does not end")


def until_asked(page, before):
    """What follows; while a switch is watched, there is nothing but Abort."""

    def is_asked():
        gcode = first_button(page) or ""
        return gcode not in ("", before) and "STEP=ABORT" not in gcode

    page.until(is_asked, f"what follows {before}")


def first_button(page, what="dataset.runs"):
    """Its G-code, or what it says; None while there is no dialog."""
    button = "document.querySelector('#dialog .footer button')"
    return page.value(f"{button}?.{what}")


def lower(page):
    """By the buttons, until a sheet of paper would be held."""
    for step in (1.0, 0.1, 0.01):
        if has_button(page, f"{step:g} mm") and not is_step(page, step):
            jog(page, f"{step:g} mm")
        while height(page) > 0.1 + step and has_button(page, f"Z-{step:g} mm"):
            jog(page, f"Z-{step:g} mm")


def is_step(page, mm):
    """Whether a button moves by so much already."""
    pressed = "#dialog .steps [aria-pressed=true]"
    return page.text(pressed) == f"{mm:g} mm"


def check_pad(page):
    """A cross with a chooser of the step; the view is turned to X."""
    boxes = page.value(
        "Object.fromEntries([...document.querySelectorAll('#dialog .jog')]"
        ".map(b => [b.textContent, b.getBoundingClientRect()])"
        ".map(([name, { x, y }]) => [name.slice(0, 2), [x, y]]))"
    )
    left, right = boxes["X-"], boxes["X+"]
    far, near = boxes["Y+"], boxes["Y-"]
    assert left[0] < far[0] == near[0] < right[0]
    assert far[1] < left[1] == right[1] < near[1]
    assert boxes["Z+"][0] == boxes["Z-"][0] > right[0]
    assert boxes["Z+"][1] < boxes["Z-"][1]
    assert is_step(page, 1)
    page.until(lambda: "seen along Y" in page.text("#side"), "the view turns")


def pin_in_lens(page):
    """Where the pin is in the close-up, which may be drawn anew just now."""
    script = (
        "(pin => pin && [Number(pin.getAttribute('x'))])"
        "(document.querySelector('#lens .pin'))"
    )
    (x,) = page.until(lambda: page.value(script), "a pin in the close-up")
    return x


def jog(page, label):
    """By a button, until the dialog names the new height.

    The toolhead is seen to move before; the buttons may be others then.
    """
    before = page.text("#dialog")
    page.press("#dialog", label)
    page.until(lambda: page.text("#dialog") not in ("", before), "asked again")


def has_button(page, label):
    return page.value(
        "[...document.querySelectorAll('#dialog button')]"
        ".some(b => b.textContent === arguments[0])",
        label,
    )


def height(page):
    """Of the nozzle above the bed, as the close-up tells it, mm."""
    pattern = r"nozzle and bed: ([\d.]+) mm apart"
    found = page.until(
        lambda: re.match(pattern, page.text("#lens-words")), "it is near"
    )
    return float(found[1])


class Step(NamedTuple):
    """title, and what is to be done: (kind, word), kind * or `."""

    title: str
    text: str
    words: list[tuple[str, str]]


def words_of(text):
    """What is slanted or code in it."""
    found = re.findall(r"(?<!\*)(\*)([^*]+)\*(?!\*)|(`)([^`]+)`", text)
    return [(a or c, b or d) for a, b, c, d in found]


def steps():
    """Of the document, in their order."""
    found = []
    for title, text in tour.steps():
        words = words_of(text)
        for word in SPOKEN_OF.get(title, ()):
            words.remove(("`", word))
        if GUIDED in text:
            ours = text.partition(GUIDED)[0]
            # Behind the button that ends it
            end = words[words.index(("*", "Save")) + 1 :]
            words = [*words[: len(words_of(ours))], ("guide", ""), *end]
        found.append(Step(title, text, words))
    return found


class Visitor:
    """Does what the tour says, on the page."""

    def __init__(self, shown, page):
        self.shown = shown
        self.page = page
        # Of the console before G-code was typed last
        self.lines = 0

    def do(self, step):
        for kind, word in step.words:
            if kind == "guide":
                with self.page.restarts():
                    guide(self.page)
            elif kind == "*":
                self.press(word)
            elif word.split()[0] in COMMANDS:
                self.hand(word)
            elif re.fullmatch(r"\w+: .*", word) or word.islower():
                self.edit(word)
            else:
                self.run(word, None if WHILE in step.text else ENDS)
                if WHILE in step.text:
                    self.until_said("switch at z=")
            if word == "drop":
                self.until_said("!! ")

    def press(self, label):
        page = self.page
        if label == "printer.cfg":
            page.until(self.opened, "its text")
        elif label in SHOWN:
            self.choose(label)
        elif label == "Save and restart":
            with page.restarts():
                page.press("#config", label)
        elif label in SHORTCUTS:
            self.shortcut(label)
        else:
            self.answer(label)

    def answer(self, label):
        """Until something else is asked, nothing, or the switch is watched."""
        page = self.page
        page.until(lambda: label in page.buttons("#dialog"), label)
        before = page.text("#dialog")
        page.press("#dialog", label)
        page.until(lambda: page.text("#dialog") != before, f"after {label}")
        if label == "Watch":
            # A toolhead that is homed is lifted at first
            page.until(
                lambda: "press it now" in page.text("#dialog"), "it watches"
            )

    def opened(self):
        details = self.page.find("#config")
        if details.get_attribute("open") is None:
            details.find_element("css selector", "summary").click()
        return self.text()

    def text(self):
        return self.page.value("document.getElementById('config-text').value")

    def edit(self, word):
        """Another line for an option, or none."""
        option, _, value = word.partition(": ")
        line = f"{option}: {value}\n" if value else ""
        pattern = re.compile(rf"^{option}:.*\n", re.M)
        before = self.text()
        assert len(pattern.findall(before)) == 1, word
        self.page.value(
            "document.getElementById('config-text').value = arguments[0]",
            pattern.sub(line, before),
        )

    def choose(self, name):
        output = len(self.shown.output)
        with self.page.restarts():
            self.page.value(
                "(s => { s.value = arguments[0];"
                " s.dispatchEvent(new Event('change')); })"
                "(document.getElementById('scene'))".replace(
                    "arguments[0]", repr(name)
                )
            )
            self.shown.until(rf"^Printer +{name}, as at home", output)
        # Nothing of the one before is left, and its own file is there
        assert not has_card(self.page)
        assert not self.page.find("#report-picture").is_displayed()
        assert "CALIBRATE_Z" not in self.page.console()
        self.page.until(
            lambda: f"[{name}" in self.text(), "its own printer.cfg"
        )

    def hand(self, line):
        if line == "take":
            # Not while the toolhead goes down on it
            self.page.until(
                lambda: "switch away" in self.page.text("#dialog"),
                "it asks for it",
            )
        before = len(self.shown.output)
        self.page.send(line)
        self.shown.until(r"\S", before)
        if line.startswith("press"):
            # Until the finger lets go; speed 1 is the slowest
            time.sleep(2.5)

    def run(self, script, end):
        """Type it; end: what the console says last, if that is waited for."""
        self.lines = len(self.page.console())
        self.page.send(script)
        if end is not None:
            self.until_said(end)

    def until_said(self, pattern):
        """Since G-code was typed last."""
        self.page.until(
            lambda: re.search(pattern, self.page.console()[self.lines :]),
            pattern,
        )

    def shortcut(self, label):
        page = self.page
        script = page.value(
            "[...document.querySelectorAll('#shortcuts button')]"
            ".find(b => b.textContent === arguments[0]).dataset.runs",
            label,
        )
        if label == "Save config":
            with page.restarts():
                page.press("#shortcuts", label)
            return
        before = page.console().count("+-")
        page.press("#shortcuts", label)
        if label == "Home":
            page.until(lambda: gap(page) is not None, "homed")
        elif script == "CALIBRATE_Z":
            page.until(lambda: page.console().count("+-") > before, "a result")
        else:
            page.until(
                lambda: page.buttons("#dialog") or label == "Report", "a dialog"
            )


def is_about(page, wanted, within):
    page.until(
        lambda: gap(page) is not None and abs(gap(page) - wanted) < within,
        f"a gap of {wanted}",
    )


# What has to be so after each step
def after_home(page):
    is_about(page, -0.1, 0.06)


def after_wires(page):
    assert "the probe reads triggered" in page.console()
    assert re.search(r"expected a trigger at z=1\.(59|60)", page.console())
    assert page.console().count("!! ") == 2
    bad = page.value(
        "[...document.querySelectorAll('#lines .bad')].map(e => e.textContent)"
    )
    assert any("CRASH: nozzle on the pin" in line for line in bad)


def after_loss(page):
    page.until(lambda: page.console().count("!! ") == 3, "it has ended")


def after_nozzle(page):
    assert "something that sticks to it is pressed flat" in page.console()


def after_set_up(page):
    is_about(page, 0.0, 0.03)
    # Told where it is measured, which the set-up has proposed
    x, y = page.until(
        lambda: re.search(
            r"bed_xy_position = ([\d.]+), ([\d.]+)",
            page.value("document.getElementById('config-text').value"),
        ),
        "the place that was saved",
    ).groups()
    assert page.text("#point") == f"at X{float(x):g} Y{float(y):g}"


def after_dialogs(page):
    is_about(page, 0.0, 0.03)
    # Where the membrane was laid
    assert page.text("#point") == "at X30 Y20"


def after_report(page):
    page.until(
        lambda: page.value(
            "document.getElementById('report-picture').naturalWidth"
        ),
        "the picture",
    )


RESULTS = {
    "Home": after_home,
    "Calibrate": lambda page: is_about(page, 0.06, 0.02),
    "Break a wire": after_wires,
    "Lose the probe": after_loss,
    "Another nozzle": after_nozzle,
    "Edit the configuration": lambda page: is_about(page, 0.0, 0.02),
    "Set up from nothing": after_set_up,
    "Look at the report": after_report,
    "Answer dialogs": after_dialogs,
}


def test_every_step_is_known():
    assert [step.title for step in steps()] == list(RESULTS)


def test_words_of_the_guide_are_what_is_done():
    """guide() does them by itself: in this order, and nothing else."""
    (text,) = [step.text for step in steps() if GUIDED in step.text]
    said = text.partition("*Set up*. ")[2]
    words = [word for _, word in words_of(said)]
    before = ["speed 1", "Watch", AFTER["PIN"], BEFORE["OFF"][0], "Next"]
    before += [BEFORE["PROBE"][0], "Watch", AFTER["PROBE"], "speed 4"]
    guided = ["X+1 mm", "Paper", BEFORE["GAP"][0], "Save"]
    assert words[: len(before) + len(guided)] == before + guided
    assert "with *X+1 mm*, four times" in said
    assert "until the close-up says 0.1 mm" in said


@pytest.mark.slow
@pytest.mark.timeout(20 * LIMIT)
def test_tour(port):
    with looking(port, "--speed", "4") as (shown, page):
        visitor = Visitor(shown, page)
        for step in steps():
            visitor.do(step)
            RESULTS[step.title](page)
