"""Somebody who sets z_calibration up by the buttons of its dialogs."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable
from typing import Optional

import pytest

from simprinter import Machine
from simprinter.hosts.session import GcodeError
from tools.kit.dialogs import Shown, dialogs_of
from tools.kit.printer import RunningPrinter

SETUP = "Z_CALIBRATION_SETUP"
# As the section is before anything is known
EMPTY = {
    "nozzle_xy_position": None,
    "switch_xy_position": None,
    "bed_xy_position": None,
    "switch_offset": None,
}
# Refuses until its variable says otherwise
SAVE_THAT_FAILS = {
    "gcode_macro SAVE_CONFIG": {
        "rename_existing": "SAVE_CONFIG_BASE",
        "variable_fails": "True",
        "gcode": "\n  {% if fails %}{action_raise_error('disk full')}{% endif %}"
        "\n  SAVE_CONFIG_BASE",
    }
}
JOGS = (10.0, 1.0, 0.1)
# Changes by how much the jog buttons move
WIDTHS = "Steps of "
# Steps that follow by themselves, and fail: at which one the last button is pressed,
# from which words of the console on, and what the probe reads from then on
CHAINED = {
    "ATTACH": ("NOZZLE", "", True),
    "TOUCH_SWITCH": ("TOUCH_NOZZLE", "touching the switch", True),
    "TOUCH_BED": ("TOUCH_NOZZLE", "touching the bed", False),
}
# Where nozzle and body of the switch are over the pin of that scene
CARTESIAN = {"NOZZLE": (226.0, 20.0), "SWITCH": (254.0, 18.0)}


def open_dialog(console: Iterable[str]) -> Optional[Shown]:
    """What an interface shows that has seen these lines."""
    shown = [dialog for dialog in dialogs_of(console) if dialog.is_open]
    assert len(shown) <= 1
    for dialog in shown:
        dialog.assert_stands_alone()
    return shown[0] if shown else None


def is_jog(label: str) -> bool:
    """Whether a button of that name moves the toolhead."""
    return label[1:2] in ("+", "-")


def presses(distance: float, jogs: Iterable[float] = JOGS) -> list[float]:
    """Which buttons lead so far (mm)."""
    found = []
    for jog in jogs:
        count = int(abs(distance) / jog + 1e-6)
        found += [jog if distance > 0 else -jog] * count
        distance -= count * (jog if distance > 0 else -jog)
    return found


class User:
    """Reads dialogs, presses buttons and switches, looks at the nozzle."""

    SETUP = SETUP

    def __init__(self, printer: RunningPrinter, pin: str = "z_endstop"):
        """pin: the signal of what the nozzle presses."""
        self.printer = printer
        self.machine: Machine = printer.machine
        self.pin = pin
        # Buttons that were pressed, but for those that move the toolhead
        self.clicks = 0

    def dialog(self) -> Optional[Shown]:
        """The one that is open."""
        return open_dialog(self.printer.session.console)

    def labels(self) -> list[str]:
        """The buttons of the dialog that is open."""
        shown = self.dialog()
        buttons = [*sum(shown.groups, []), *shown.footer_buttons]
        return [button[0] for button in buttons]

    def has(self, label: str) -> bool:
        """Whether there is a button of that name."""
        return label in self.labels()

    def turn_to(self, label: str) -> None:
        """Have that button shown, as somebody does who looks for it."""
        page = "Move" if is_jog(label) else "Done"
        if not self.has(label) and self.has(page):
            self._send(page)
        if is_jog(label):
            self.set_width(float(label[2:].split()[0]))

    def set_width(self, width: float) -> bool:
        """Have the jog buttons move by that; False: they cannot, and by less."""
        for _ in JOGS:
            widths = [b for b in self.labels() if b.startswith(WIDTHS)]
            if any(b[2:] == f"{width:g} mm" for b in self.labels()):
                return True
            self._send(widths[0])
        return False

    def begin(self) -> None:
        """The command that all begins with."""
        self.printer.run(self.SETUP)

    def come_to(self, step: str) -> None:
        """From the beginning, as far as that."""
        self.begin()
        self.go_to(step)

    def step(self) -> str:
        """The step that is asked, in the word of the console."""
        gcode = self.dialog().footer_buttons[0][1]
        return re.search(r"STEP=(\w+)", gcode)[1]

    def position(self) -> list[float]:
        """Where the toolhead is, in klippy's frame, mm."""
        return self.printer.session.position()

    def hold(self, signal: str, level: Optional[bool]) -> None:
        """Keep a switch pressed or not; None: let go."""
        self.machine.hold(signal, level)

    def press(self, label: str) -> list[str]:
        """Press a button; the console lines."""
        self.clicks += not is_jog(label)
        self.turn_to(label)
        return self._send(label)

    def _send(self, label: str) -> list[str]:
        return self.printer.run(self.dialog().gcode(label))

    def refused(self, label: str) -> str:
        """Press a button that must fail; the error's text."""
        self.turn_to(label)
        return self.printer.fail(self.dialog().gcode(label))

    def first(self) -> tuple[str, str]:
        """The first of the answers, and what it sends."""
        if self.has("Done"):
            self._send("Done")
        return self.dialog().footer_buttons[0][:2]

    def by_hand(
        self,
        signal: str,
        *,
        after: Optional[bool] = None,
        others: Iterable[str] = (),
    ) -> list[str]:
        """Watch, press a switch, and others, and let go; after: as it is then."""
        session = self.printer.session
        self.clicks += 1
        command = session.begin(self.dialog().gcode("Watch"))
        # A toolhead that is homed is lifted at first
        session.run_until(command, lambda: "watching" in session.console[-1])
        assert self.dialog().headline.endswith(": press it now")
        # At once, before anything else is read
        for pressed in (True, after):
            for name in (signal, *others):
                self.hold(name, pressed)
            session.wait(0.3)
        return session.finish(command)

    def jog(self, axis: str, distance: float, jogs: Iterable[float] = JOGS):
        """By the buttons."""
        for step in presses(distance, jogs):
            self.press(f"{axis}{step:+g} mm")

    def jog_to(self, x: float, y: float) -> None:
        """The toolhead there, as near as the buttons lead."""
        here = self.position()
        self.jog("X", round(x - here[0], 1))
        self.jog("Y", round(y - here[1], 1))

    def test_switches(self, is_fixed: bool = False) -> None:
        """Both, and the probe off the toolhead."""
        self.by_hand(self.pin)
        self.test_probe(is_fixed)

    def test_probe(self, is_fixed: bool = False) -> None:
        """Off the toolhead, on it and pressed, and where it belongs again."""
        if is_fixed:
            self.press("Skip")
        else:
            self.hold("probe", True)
            self.press("Next")
            self.hold("probe", False)
        self.by_hand("probe", after=False)
        self.hold("probe", None)

    def set_places(
        self, nozzle: tuple[float, float], switch: tuple[float, float]
    ) -> None:
        """Home, nozzle, switch; the bed as it is proposed; all looks right."""
        self.press("Home")
        self.jog_to(*nozzle)
        self.press("Here")
        self.jog_to(*switch)
        for label in ("Here", "Here", "Yes"):
            self.press(label)

    def go_on(self) -> None:
        """Do what a step asks of one who sets the scene "cartesian" up."""
        step = self.step()
        if step == "PIN":
            self.by_hand(self.pin)
        elif step == "OFF":
            self.hold("probe", True)
            self.press("Next")
        elif step == "PROBE":
            self.hold("probe", False)
            self.by_hand("probe", after=False)
            self.hold("probe", None)
        else:
            self.look_and_jog(step)
            self.press(self.first()[0])

    def look_and_jog(self, step: str) -> None:
        """The toolhead to where it has to be before the step is answered."""
        if step in CARTESIAN:
            self.jog_to(*CARTESIAN[step])
        elif step == "PAPER":
            self.lower_to_the_sheet()

    def go_to(self, step: str) -> None:
        """As far as a step; one that follows by itself is asked as it fails."""
        asked, words, reading = CHAINED.get(step, ("", "", None))
        while self.step() != step:
            if self.step() != asked:
                self.go_on()
                continue
            self.look_and_jog(asked)
            self.fail_after(words, reading)

    def fail_after(self, words: str, reading: Optional[bool]) -> None:
        """Press the first button; from these words on the probe reads so."""
        console = self.printer.session.console
        seen = len(console)
        self._fail(
            lambda: not words or any(words in line for line in console[seen:]),
            reading,
        )

    def fail_at(self, site: str) -> None:
        """Press the first button; from its second touch there the probe is dead."""
        touches = self.machine.truth.touches
        seen = len(touches)
        self._fail(
            lambda: sum(touch.site == site for touch in touches[seen:]) > 1,
            False,
        )

    def _fail(
        self, is_time: Callable[[], bool], reading: Optional[bool]
    ) -> None:
        session = self.printer.session
        self.machine.tolerate("body_bed", 1.02)
        command = session.begin(self.first()[1])
        session.run_until(command, is_time)
        self.hold("probe", reading)
        with pytest.raises(GcodeError):
            session.finish(command)
        self.hold("probe", None)

    def touch(self) -> None:
        """All three."""
        self.press("Touch")

    def gap(self) -> float:
        """True mm from the nozzle to the bed below it."""
        tip = self.machine.tip()
        now = self.machine.rig.seconds(self.machine.simulation.clock.now())
        return self.machine.truth.true_gap(tip.x, tip.y, tip.z, now)

    def lower_to_the_sheet(self, paper: float = 0.1) -> None:
        """Until the sheet is held."""
        for step in (1.0, 0.1, 0.01):
            while self.gap() > paper + step and self.set_width(step):
                self._send(f"Z-{step:g} mm")
