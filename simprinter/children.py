"""Processes that klippy starts: they live in real time, on no virtual clock."""

from __future__ import annotations

import os
import select
import signal
from contextlib import suppress

from .clock import VirtualClock


class Children:
    """Those of one process on a virtual clock, known by their start's number.

    A process number may come again, that of a start never.
    """

    def __init__(self, clock: VirtualClock):
        self._clock = clock
        self._seen = 0
        # A pidfd each, as long as they live
        self._living: dict[int, int] = {}

    def look(self) -> bool:
        """Whether one lives, now that all of klippy is asleep.

        When one has ended, klippy's threads look at what it has left in pipes,
        so that the clock cannot move on before they have.
        """
        started = self._clock.started()
        if started == self._seen and not self._living:
            return False
        has_ended = False
        for number, pid in self._clock.children():
            if number <= self._seen:
                continue
            started = max(started, number)
            try:
                self._living[number] = os.pidfd_open(pid)
            except ProcessLookupError:
                has_ended = True
        self._seen = started
        for number, fd in list(self._living.items()):
            if _is_readable(fd):
                os.close(self._living.pop(number))
                has_ended = True
        if has_ended:
            self._clock.look_again()
        return bool(self._living)

    def filenos(self) -> list[int]:
        """Each is readable when one that lived at the last look has ended."""
        return list(self._living.values())

    def end(self) -> None:
        """End those that still live; klippy must have ended."""
        self.look()
        for number, fd in list(self._living.items()):
            with suppress(ProcessLookupError):
                signal.pidfd_send_signal(fd, signal.SIGKILL)
            os.close(self._living.pop(number))


def _is_readable(fd: int) -> bool:
    poller = select.poll()
    poller.register(fd, select.POLLIN)
    return bool(poller.poll(0))
