"""What a command is doing, and what the user is told of the set-up when klippy starts.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Callable, Dict, List

if TYPE_CHECKING:
    from .host.printer import Host

# How often (s) it is looked whether somebody has begun to listen to the console, and
# for how long after klippy is ready: Moonraker does so 0.8 s later, where both
# are started at once much later.
LISTEN_INTERVAL = 2.0
LISTEN_TIME = 600.0


class Progress:
    """What a run is doing, for get_status() and the console."""

    def __init__(self, name: str, respond_info: Callable[[str], None]):
        self.name = name
        self.is_verbose = False
        self.begin(respond_info, "idle", 0)

    def begin(
        self, respond_info: Callable[[str], None], phase: str, wanted: int
    ) -> None:
        """Begin a command of so many touches; its lines go to 'respond_info'."""
        self.respond_info = respond_info
        self.phase = phase
        self.done = 0
        self.wanted = wanted

    def enter(self, phase: str) -> None:
        """Go on with another part of it."""
        self.phase = phase

    def begin_again(self) -> None:
        """Count the touches anew: what was touched so far counts for nothing."""
        self.done = 0

    def be_verbose(self, is_verbose: bool) -> None:
        """Say whether single touches are shown, too."""
        self.is_verbose = is_verbose

    def expect(self, wanted: int) -> None:
        """Say how many touches there will be, where that is known later."""
        self.wanted = wanted

    def touched(self) -> None:
        """Count a touch; samples that are taken again do not count twice."""
        self.done = min(self.done + 1, self.wanted)

    def say(self, text: str) -> None:
        """Show a line on the console."""
        self.respond_info(f"{self.name}: {text}")

    def detail(self, text: str) -> None:
        """Write a line into klippy.log, and show it with VERBOSE=1."""
        if self.is_verbose:
            # The console is logged
            self.say(text)
        else:
            logging.info("%s: %s", self.name, text)

    def status(self) -> Dict[str, Any]:
        """Return the fields of get_status()."""
        progress = self.done / self.wanted if self.wanted else 0.0
        return {"phase": self.phase, "progress": progress}


class Notes:
    """What the user is told of the set-up of one section.

    It is shown on the console when klippy is ready, and once more as soon as somebody has
    begun to listen; as warnings of the configuration where the host has these; and in the
    status.  read() returns the texts when klippy is ready; empty ones are none.
    """

    def __init__(self, host: Host, read: Callable[[], List[str]]):
        self.host = host
        self.read = read
        self.texts: List[str] = []
        self.is_looking = False
        # Who has heard them, and when to give up (eventtime)
        self.heard: List[Any] = []
        self.end = 0.0
        host.printer.register_event_handler("klippy:ready", self.begin)

    def begin(self) -> None:
        """Show what is known when klippy is ready."""
        self.add([text for text in self.read() if text])

    def add(self, texts: List[str]) -> None:
        """Show more of them, as some may be known later."""
        if not texts:
            return
        self.texts = self.texts + texts
        for text in texts:
            self.host.say(text)
            self.host.warn(text)
        reactor = self.host.printer.get_reactor()
        eventtime = self.host.eventtime()
        self.end = eventtime + LISTEN_TIME
        if not self.is_looking:
            self.is_looking, self.heard = True, self.host.listeners()
            reactor.register_timer(self.look, eventtime + LISTEN_INTERVAL)

    def say(self) -> None:
        """Show all of them on the console."""
        for text in self.texts:
            self.host.say(text)

    def look(self, eventtime: float) -> float:
        """Show them again where somebody listens now; a timer of the reactor."""
        is_new = any(c not in self.heard for c in self.host.listeners())
        if is_new:
            self.say()
        if is_new or eventtime > self.end:
            self.is_looking = False
            return self.host.printer.get_reactor().NEVER
        return eventtime + LISTEN_INTERVAL
