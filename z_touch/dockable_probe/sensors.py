"""Where the probe is: asked of the pins, never assumed.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List, NamedTuple, Sequence, Tuple

from ..attached import ATTACHED, DOCKED, UNKNOWN

if TYPE_CHECKING:
    from ..host.klippy import Config, Endstop
    from ..host.printer import Host
    from .known import Known
    from .settings import Settings


class Sense(NamedTuple):
    """A pin: its option, and whether it reads TRIGGERED with the probe attached."""

    name: str
    endstop: Endstop
    when_attached: bool


def level(is_triggered: bool) -> str:
    """Return what a pin reads, for people."""
    return "TRIGGERED" if is_triggered else "open"


class Sensors:
    """What tells where the probe is.  What looks may pause."""

    def __init__(
        self, config: Config, host: Host, settings: Settings, known: Known
    ):
        self.host = host
        self.known = known

        def sense(name: str, when_attached: bool) -> Sense:
            """Return the pin of an option, and what it reads with the probe attached."""
            endstop = host.endstops.make_plain(config, name)
            return Sense(name, endstop, when_attached)

        # The switch of the probe, which is pressed in a touch
        self.pin = sense("pin", False)
        # Pins that tell by themselves, whether the probe is pressed or not
        self.senses: List[Sense] = []
        if settings.probe_sense_pin is not None:
            self.senses.append(sense("probe_sense_pin", True))
        if settings.dock_sense_pin is not None:
            self.senses.append(sense("dock_sense_pin", False))
        # Whether 'pin', too, tells where the probe is: alone it decides.  Beside others it
        # has a veto: TRIGGERED it is not attached, or pressed.  Open says nothing there, as
        # a switch that is normally open reads so anywhere.
        self.is_pin_asked = settings.check_open_attach
        # Whether 'pin' read TRIGGERED when the probe was last fetched: a wire that is
        # broken never does
        self.is_switch_seen = False
        # What somebody who looked has seen last
        self.last_state = UNKNOWN

    def _state(self, print_time: float) -> str:
        state = self._agreed(print_time, self.senses or [self.pin])
        has_veto = state == ATTACHED and self.senses and self.is_pin_asked
        if has_veto and self._is_triggered(self.pin, print_time):
            state = UNKNOWN
        self.last_state = state
        self.known.look_has(state)
        return state

    def _agreed(self, print_time: float, senses: Sequence[Sense]) -> str:
        """Return what all of these pins say, UNKNOWN where they contradict each other."""
        attached = [
            self._is_triggered(sense, print_time) == sense.when_attached
            for sense in senses
        ]
        if all(attached):
            return ATTACHED
        return UNKNOWN if any(attached) else DOCKED

    def _is_triggered(self, sense: Sense, print_time: float) -> bool:
        return bool(sense.endstop.query_endstop(print_time))

    def look(self) -> str:
        """Return the state after all moves so far."""
        return self._state(self.host.after_moves())

    def look_at(self, print_time: float) -> str:
        """Return the state at a print time (s); moves may be queued for later."""
        return self._state(print_time)

    def confirm(self) -> str:
        """Return the state, at once where the pins read what is proven.

        So the toolhead need not stop for it; otherwise after all moves.
        """
        state = self._state(self.host.print_time())
        if state == self.known.proven != UNKNOWN:
            return state
        return self.look()

    def is_proven(self, state: str) -> bool:
        """Return whether the pins read that now, and a trip was seen to lead to it."""
        return self.confirm() == self.known.proven == state

    def is_doubtful(self) -> bool:
        """Return whether a DOCKED proves nothing.

        Two pins of their own that agree are believed.
        """
        return self.known.may_be_on and len(self.senses) < 2

    def when_joined(self) -> List[Tuple[Sense, bool]]:
        """Return the pins that tell where the probe is, and what they have to read.

        That is whether each is TRIGGERED with the probe on the toolhead and in the dock at
        once.
        """
        asked = [(sense, True) for sense in self.senses]
        if self.is_pin_asked or not asked:
            asked.append((self.pin, False))
        return asked

    def is_joined(self) -> bool:
        """Return whether they read so after all moves."""
        print_time = self.host.after_moves()
        return all(
            self._is_triggered(sense, print_time) == wanted
            for sense, wanted in self.when_joined()
        )

    def look_at_switch(self) -> None:
        """Note what 'pin' reads while the probe is in the dock."""
        print_time = self.host.print_time()
        self.is_switch_seen = self._is_triggered(self.pin, print_time)

    def is_sensed(self) -> bool:
        """Return whether the pins that tell by themselves read attached, or there are none."""
        if not self.senses:
            return True
        self.last_state = self._agreed(self.host.print_time(), self.senses)
        return self.last_state == ATTACHED

    def describe(self) -> str:
        """Return what the pins read after all moves, for people."""
        print_time = self.host.after_moves()
        return ", ".join(
            f"{sense.name} reads {level(self._is_triggered(sense, print_time))}"
            for sense in (self.pin, *self.senses)
        )
