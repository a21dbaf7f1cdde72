"""A finger that presses the switch once, before the nozzle comes down on it.

It is watched by a timer, not by a command: the buttons of a dialog wait until a command has
ended, and with them the one that ends the calibration.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, List, Optional

if TYPE_CHECKING:
    from ..host.printer import Host
    from .switches import Switch

# How often (s) the switch is looked at
LOOK_INTERVAL = 0.1

# What a switch reads in turn that a finger presses once
PRESSED_ONCE = [False, True, False]


def triggered_early(switch: Switch) -> str:
    """Return what to do about a switch that reads triggered too early."""
    return (
        "the switch reads triggered before it is touched; check it with"
        f" {switch.query}, and whether pin needs a '!'"
    )


class Finger:
    """Watches the switch while a question is open."""

    def __init__(self, host: Host, switch: Switch):
        self.host = host
        self.switch = switch
        # What it has read, each change once; None: nothing is asked for
        self.readings: Optional[List[bool]] = None
        reactor = host.printer.get_reactor()
        self.timer = reactor.register_timer(self._look, reactor.NEVER)

    def watch(self) -> None:
        """Ask for a finger from now on; what was pressed before does not count."""
        self.readings = []
        reactor = self.host.printer.get_reactor()
        reactor.update_timer(self.timer, reactor.NOW)

    def end(self) -> None:
        """Ask for none (any more)."""
        self.readings = None
        reactor = self.host.printer.get_reactor()
        reactor.update_timer(self.timer, reactor.NEVER)

    def why_missing(self) -> str:
        """Return what to do until the switch was pressed; empty: it was, or need not be."""
        if self.readings is None or self._was_pressed():
            return ""
        if self.readings[:1] == [True]:
            return triggered_early(self.switch)
        return (
            "the switch was not pressed yet; press it once with a finger, then"
            f" Continue, or look with {self.switch.query} if that changes nothing"
        )

    def _was_pressed(self) -> bool:
        return (self.readings or [])[-len(PRESSED_ONCE) :] == PRESSED_ONCE

    def _look(self, eventtime: float) -> float:
        """Look between two commands until it was pressed; a timer.  May pause."""
        try:
            endstop = self.switch.endstop()
            reading = self.host.endstops.read_between_commands(endstop)
        except Exception:
            # From here it would end klippy; the calibration can begin again
            logging.exception("%s: looking at the switch", self.host.section)
            return self.host.printer.get_reactor().NEVER
        if reading is not None and self.readings is not None:
            self._note(reading)
        if self.readings is None or self._was_pressed():
            return self.host.printer.get_reactor().NEVER
        return self.host.eventtime() + LOOK_INTERVAL

    def _note(self, reading: bool) -> None:
        """Keep a reading that is another one than before, and say that it was pressed."""
        assert self.readings is not None
        if self.readings[-1:] != [reading]:
            self.readings.append(reading)
        if self._was_pressed():
            self.host.say(
                "the switch was pressed, and works; take the hand away"
            )
