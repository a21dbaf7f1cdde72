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
from typing import Iterable, Iterator, NamedTuple, Optional

PROBE_SITES = ("body_pin", "probe_bed")


class _Kind(NamedTuple):
    """What a fault of one name may be given."""

    subject: Optional[str] = None
    subject_needed: bool = False
    arguments: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    counted: bool = True
    persistent: bool = False

    def known(self) -> tuple[str, ...]:
        """Names of all arguments."""
        subject = () if self.subject is None else (self.subject,)
        return subject + self.arguments


_KINDS = {
    "stuck_open": _Kind("signal", True, ("t",), persistent=True),
    "stuck_closed": _Kind("signal", True, ("t",), persistent=True),
    "trigger_early": _Kind("signal", True, ("mm",), ("mm",)),
    "trigger_late": _Kind("signal", True, ("mm",), ("mm",)),
    "trigger_never": _Kind("signal", True),
    "probe_falls": _Kind("site", False, ("when",)),
    "attach_fails": _Kind(),
    "dock_fails": _Kind(),
    "mcu_silent": _Kind("board", False, ("t",), ("t",), False, True),
    "tmc_read_error": _Kind("driver"),
    "tmc_write_error": _Kind("driver"),
    "tmc_change_lost": _Kind("driver"),
}


def _kind(name: str) -> _Kind:
    if name not in _KINDS:
        raise ValueError(f"unknown fault {name!r}, know {sorted(_KINDS)}")
    return _KINDS[name]


class Fault:
    """One fault; immutable, so one scene may serve several runs.

    t: seconds from which it applies, None if it is counted instead
    mm: distance of trigger_early and trigger_late, 0 for others
    when: probe_falls' moment
    """

    __slots__ = ("mm", "n", "name", "persistent", "subject", "t", "when")

    name: str
    n: int
    persistent: bool
    subject: Optional[str]
    t: Optional[float]
    mm: float
    when: str

    def __init__(
        self,
        name: str,
        n: int = 1,
        persistent: Optional[bool] = None,
        **args: object,
    ) -> None:
        kind = _kind(name)
        _check_names(name, kind, args)
        subject = None if kind.subject is None else args.get(kind.subject)
        if subject is not None and not (isinstance(subject, str) and subject):
            raise ValueError(f"{name}: {kind.subject} {subject!r} is no name")
        if kind.subject == "site" and subject not in (None, *PROBE_SITES):
            raise ValueError(f"{name}: site {subject!r} not in {PROBE_SITES}")
        t = _number(name, "t", args["t"]) if "t" in args else None
        if type(n) is not int or n < 1:
            raise ValueError(f"{name}: n {n!r} is not an integer above 0")
        if t is not None and (n != 1 or persistent is False):
            raise ValueError(f"{name}: from time t on, n and persistent clash")
        when = args.get("when", "lift")
        if when not in ("touch", "lift"):
            raise ValueError(f"{name}: when {when!r} is not touch or lift")
        mm = _number(name, "mm", args.get("mm", 0.0))
        if "mm" in args and mm <= 0.0:
            raise ValueError(f"{name}: mm {mm!r} is not above zero")
        staying = kind.persistent if persistent is None else persistent
        values = (mm, n, name, staying, subject, t, when)
        for slot, value in zip(Fault.__slots__, values):
            object.__setattr__(self, slot, value)

    def __setattr__(self, name: str, value: object) -> None:
        raise AttributeError(f"Fault is immutable, cannot set {name}")

    def matches(self, name: str, subject: Optional[str]) -> bool:
        """Whether an operation of that kind on that subject is meant."""
        return self.name == name and self.subject in (None, subject)

    def __repr__(self) -> str:
        where = "" if self.subject is None else f" of {self.subject}"
        moment = f"n={self.n}" if self.t is None else f"t={self.t}"
        return f"<Fault {self.name}{where} at {moment}>"


def _check_names(name: str, kind: _Kind, args: dict[str, object]) -> None:
    known = kind.known()
    unknown = sorted(set(args) - set(known))
    if unknown:
        raise ValueError(f"{name}: unknown {unknown}, know {list(known)}")
    needed = set(kind.needed)
    if kind.subject_needed and kind.subject is not None:
        needed.add(kind.subject)
    missing = sorted(needed - set(args))
    if missing:
        raise ValueError(f"{name}: missing {missing}")


def _number(name: str, what: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ValueError(f"{name}: {what} {value!r} is not a number")
    if not (math.isfinite(value) and value >= 0.0):
        raise ValueError(f"{name}: {what} {value!r} is negative or endless")
    return float(value)


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
        if not _kind(name).counted:
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
