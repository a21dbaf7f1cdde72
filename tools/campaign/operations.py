"""What a command has the machine do, one operation after the other."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from simprinter import Machine

# Steps that begin later than this (ns) after the last are another move: the
# slowest ramps leave 10 ms between two steps
_PAUSE_NS = 20_000_000
# A touch starts to move this long (ns) after its endstop looks, at most
_TOUCH_NS = 300_000_000


class Operation(NamedTuple):
    """A touch or query (of a signal), a write (to a driver) or a move.

    subject of a move: "xy" or "z". ns: when it begins, on the machine's clock.
    """

    kind: str
    subject: str
    ns: int


class Watch:
    """Tells of every operation of a machine, before it happens.

    The host queues moves ahead, so one is told of some time before it begins.
    The move of a touch is no operation of its own.
    """

    def __init__(self, machine: Machine, listener: Callable[[Operation], None]):
        self._machine = machine
        self._listener = listener
        self._touched_ns = -_TOUCH_NS
        self._ends_ns = {"xy": 0, "z": 0}
        self._known = {
            name: axis.track.last_clock
            for name, axis in machine.rig.axes.items()
        }
        machine.rig.on_operation.append(self._operation)
        machine.rig.on_steps.append(self._steps_queued)

    def _operation(self, kind: str, subject: str, ns: int) -> None:
        if kind == "touch":
            self._touched_ns = ns
        self._listener(Operation(kind, subject, ns))

    def _steps_queued(self, _start_ns: int) -> None:
        for name, axis in self._machine.rig.axes.items():
            track, board = axis.track, axis.board
            if board is None or track.last_clock <= self._known[name]:
                continue
            self._known[name] = track.last_clock
            group = "xy" if name in "xy" else "z"
            begin, end = board.ns(track.newest()), board.ns(track.last_clock)
            paused = begin > self._ends_ns[group] + _PAUSE_NS
            self._ends_ns[group] = max(self._ends_ns[group], end)
            if paused and begin > self._touched_ns + _TOUCH_NS:
                self._listener(Operation("move", group, begin))
