"""Faults that strike at the n-th operation of their kind.

A fault counts the operations it is about and applies at the n-th, once, or
with `persistent` at every one from then on.  Some go by printer time instead.

name             arguments              the operation that is counted
stuck_open       signal, n or t         armings of the signal; never asserted
stuck_closed     signal, n or t         armings of the signal; always asserted
trigger_early    signal, mm             armings; triggers mm before contact
trigger_late     signal, mm             armings; triggers mm deeper than contact
trigger_never    signal                 armings; contact is not reported
probe_falls      site, when             touches of body_pin or probe_bed (site
                                        left out: of both); when: "touch" or
                                        "lift" (the default)
attach_fails                            attempts to attach the probe
dock_fails                              attempts to dock it
mcu_silent       t, board               none: from time t on (every board if
                                        left out)
tmc_read_error   driver                 reads of the driver (all if left out)
tmc_write_error  driver                 writes to the driver
tmc_change_lost  driver                 writes other than the one before; each
                                        repeat of a lost one is lost, too

"Open" and "closed" speak of the signal, not of the contact: a normally closed
probe with a broken wire reads asserted and is therefore stuck_closed.  What is
stuck stays stuck (persistent unless told otherwise); with persistent=False,
and for trigger_*, the fault lasts until the signal is armed again.

A busy host may send a datagram twice, so a count of writes from one run need
not fit the next: count from Faults.add() on, and changes, not writes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Iterable, Iterator, NamedTuple, Optional

PROBE_SITES = ("body_pin", "probe_bed")


class _Kind(NamedTuple):
    """What a fault of one name may be given, and whether it stays."""

    subject: str = ""
    needed: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    stays: bool = False


_KINDS = {
    "stuck_open": _Kind("signal", ("signal",), ("t",), True),
    "stuck_closed": _Kind("signal", ("signal",), ("t",), True),
    "trigger_early": _Kind("signal", ("signal", "mm")),
    "trigger_late": _Kind("signal", ("signal", "mm")),
    "trigger_never": _Kind("signal", ("signal",)),
    "probe_falls": _Kind("site", (), ("site", "when")),
    "attach_fails": _Kind(),
    "dock_fails": _Kind(),
    "mcu_silent": _Kind("board", ("t",), ("board",), True),
    "tmc_read_error": _Kind("driver", (), ("driver",)),
    "tmc_write_error": _Kind("driver", (), ("driver",)),
    "tmc_change_lost": _Kind("driver", (), ("driver",)),
}


def _kind(name: str) -> _Kind:
    if name not in _KINDS:
        raise ValueError(f"unknown fault {name!r}, know {sorted(_KINDS)}")
    return _KINDS[name]


@dataclass(frozen=True)
class _Fault:
    name: str
    n: int
    persistent: bool
    subject: Optional[str]
    t: Optional[float]
    mm: float
    when: str


class Fault(_Fault):
    """One fault; immutable, so one scene may serve several runs.

    t: seconds from which it applies, None if it is counted instead
    mm: distance of trigger_early and trigger_late, 0 for others
    when: probe_falls' moment
    """

    def __init__(
        self,
        name: str,
        n: int = 1,
        persistent: Optional[bool] = None,
        **args: Any,
    ) -> None:
        kind = _kind(name)

        def require(good: bool, text: str) -> None:
            if not good:
                raise ValueError(f"{name}: {text}")

        known = kind.needed + kind.optional
        unknown = sorted(set(args) - set(known))
        require(not unknown, f"unknown {unknown}, know {list(known)}")
        missing = sorted(set(kind.needed) - set(args))
        require(not missing, f"missing {missing}")
        subject, t = args.get(kind.subject), args.get("t")
        mm, when = args.get("mm", 0.0), args.get("when", "lift")
        good = subject is None or (isinstance(subject, str) and subject)
        require(good, f"{kind.subject} {subject!r} is no name")
        good = kind.subject != "site" or subject in (None, *PROBE_SITES)
        require(good, f"site {subject!r} not in {PROBE_SITES}")
        for value in (mm, 0.0 if t is None else t):
            good = isinstance(value, (int, float)) and 0.0 <= value < math.inf
            require(good, f"{value!r} is not a number of zero or more")
        require("mm" not in args or mm > 0.0, f"mm {mm!r} is not above zero")
        good = type(n) is int and n >= 1
        require(good, f"n {n!r} is not an integer above 0")
        good = t is None or (n == 1 and persistent is not False)
        require(good, "from time t on, n and persistent clash")
        require(
            when in ("touch", "lift"), f"when {when!r} is not touch or lift"
        )
        staying = kind.stays if persistent is None else persistent
        super().__init__(name, n, staying, subject, t, mm, when)

    def matches(self, name: str, subject: Optional[str]) -> bool:
        """Whether an operation of that kind on that subject is meant."""
        return self.name == name and self.subject in (None, subject)


class Faults:
    """The faults of one run, their counters, and which have struck."""

    __slots__ = ("_counts", "_faults", "_fired")

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._faults: list[Fault] = []
        self._counts: list[int] = []
        self._fired: list[bool] = []
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> None:
        """Add one; its operations are counted from now on."""
        self._counts.append(0)
        self._fired.append(False)
        self._faults.append(fault)

    def clear(self) -> None:
        """Take all away."""
        for kept in (self._faults, self._counts, self._fired):
            kept.clear()

    def __iter__(self) -> Iterator[Fault]:
        return iter(tuple(self._faults))

    def fires(
        self, name: str, subject: Optional[str] = None
    ) -> Optional[Fault]:
        """Count one operation; return the fault that strikes it, if any.

        Ask exactly once per operation.
        """
        if "t" in _kind(name).needed:
            raise ValueError(f"{name} goes by time: ask due()")
        striking: Optional[Fault] = None
        for index, fault in enumerate(self._faults):
            if fault.t is not None or not fault.matches(name, subject):
                continue
            self._counts[index] += 1
            count = self._counts[index]
            if count == fault.n or (fault.persistent and count > fault.n):
                self._fired[index] = True
                striking = striking or fault
        return striking

    def begins(self, name: str, subject: Optional[str] = None) -> float:
        """Seconds from which a fault by time applies; infinity if none."""
        _kind(name)
        times = [
            fault.t
            for fault in self._faults
            if fault.t is not None and fault.matches(name, subject)
        ]
        return min(times, default=math.inf)

    def due(self, name: str, t: float, subject: Optional[str] = None) -> bool:
        """Whether a fault by time applies at t; it then counts as fired."""
        _kind(name)
        due = False
        for index, fault in enumerate(self._faults):
            if fault.t is None or t < fault.t:
                continue
            if fault.matches(name, subject):
                self._fired[index] = due = True
        return due

    def unfired(self) -> list[Fault]:
        """Faults that have not struck; a test of a fault wants none."""
        pairs = zip(self._faults, self._fired)
        return [fault for fault, fired in pairs if not fired]
