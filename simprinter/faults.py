"""Faults that strike at what they meet.

A fault of a sensor names a site (see world/truth.py) and which of its touches
is wrong:

    Fault("trigger_never", site="nozzle_pin", touch=2, command="CALIBRATE_Z")

is the second touch of the nozzle on the pin since CALIBRATE_Z began. A touch is
a contact that a move is looking for with the signal of the site, or what a
fault reports as one: moves that look and meet nothing, looks at a signal that
stands still, and contacts while the signal is not looked at do not count.

name             arguments              what is counted
stuck_open       site, touch            touches; as a move begins to look for
stuck_closed     site, touch            this one, the signal is stuck: never, or
                                        always asserted
trigger_never    site, touch            touches; this one is not reported
trigger_early    site, touch, mm        touches; it triggers mm before contact
trigger_late     site, touch, mm        touches; it triggers mm deeper
probe_falls      site, touch, when      contacts at body_pin or probe_bed (site
                                        left out: at both), looked for or not;
                                        when: "touch" or "lift" (the default)
attach_fails     n                      attempts to attach the probe
dock_fails       n                      attempts to dock it
mcu_silent       t, board               nothing: from time t on (every board if
                                        left out)
tmc_read_error   driver, n              reads of the driver (all if left out)
tmc_write_error  driver, n              writes to the driver
tmc_change_lost  driver, n              writes other than the one before; each
                                        repeat of a lost one is lost, too

touch and n are 1 if left out. Where nothing may be met, stuck_* and trigger_*
take a signal instead of a site: they strike at the next move that looks with
it. stuck_* take a signal and t, too: stuck from that time on.

With a command, only what happens in it counts: from the moment that the session
sends a script which begins with it until that has ended, and anew with each
such script until the fault has struck. Without one, all from Faults.add() on.

"Open" and "closed" speak of the signal, not of the contact: a normally closed
probe with a broken wire reads asserted and is therefore stuck_closed.  What is
stuck stays stuck (persistent unless told otherwise); with persistent=False,
and for trigger_*, the fault lasts until a move looks with the signal again.
persistent=True is from then on, whatever runs.

strikes: "must" (the default), "never", or "may". Whoever leaves a machine with
a fault that has not struck, or was never to strike and has, gets a FaultError:
a test of what did not happen proves nothing. "may" is for those who look
themselves, or break things at random.

A busy host may send a datagram twice, so a count of writes from one run need
not fit the next: count from Faults.add() on, and changes, not writes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Iterable, Iterator, NamedTuple, Optional

PROBE_SITES = ("body_pin", "probe_bed")
_STRIKES = ("must", "never", "may")


class FaultError(AssertionError):
    """A fault has not struck, or one has that must not."""


class _Kind(NamedTuple):
    """What a fault of one name may be given, and whether it stays.

    counted: by what name it is told which one of those that are counted
    subjects: of what it is a fault, by one of these names
    """

    counted: str
    subjects: tuple[str, ...] = ()
    needed: tuple[str, ...] = ()
    optional: tuple[str, ...] = ()
    stays: bool = False


_SENSOR = ("signal", "site")
_KINDS = {
    "stuck_open": _Kind("touch", _SENSOR, (), ("t",), True),
    "stuck_closed": _Kind("touch", _SENSOR, (), ("t",), True),
    "trigger_early": _Kind("touch", _SENSOR, ("mm",)),
    "trigger_late": _Kind("touch", _SENSOR, ("mm",)),
    "trigger_never": _Kind("touch", _SENSOR),
    "probe_falls": _Kind("touch", ("site",), (), ("when",)),
    "attach_fails": _Kind("n"),
    "dock_fails": _Kind("n"),
    "mcu_silent": _Kind("", ("board",), ("t",), (), True),
    "tmc_read_error": _Kind("n", ("driver",)),
    "tmc_write_error": _Kind("n", ("driver",)),
    "tmc_change_lost": _Kind("n", ("driver",)),
}


def _kind(name: str) -> _Kind:
    if name not in _KINDS:
        raise ValueError(f"unknown fault {name!r}, know {sorted(_KINDS)}")
    return _KINDS[name]


@dataclass(frozen=True, repr=False)
class _Fault:
    name: str
    what: str
    subject: Optional[str]
    n: int
    command: Optional[str]
    persistent: bool
    t: Optional[float]
    mm: float
    when: str
    strikes: str


class Fault(_Fault):
    """One fault; immutable, so one scene may serve several runs.

    what, subject: "signal", "site", "board" or "driver", and its name; None
        for any
    n: which one of what is counted
    t: seconds from which it applies, None if it is counted instead
    mm: distance of trigger_early and trigger_late, 0 for others
    when: probe_falls' moment
    """

    def __init__(
        self,
        name: str,
        *,
        command: Optional[str] = None,
        persistent: Optional[bool] = None,
        strikes: str = "must",
        **args: Any,
    ) -> None:
        kind = _kind(name)

        def require(good: bool, text: str) -> None:
            if not good:
                raise ValueError(f"{name}: {text}")

        counted = (kind.counted,) if kind.counted else ()
        known = kind.subjects + kind.needed + kind.optional + counted
        unknown = sorted(set(args) - set(known))
        require(not unknown, f"unknown {unknown}, know {list(known)}")
        missing = sorted(set(kind.needed) - set(args))
        require(not missing, f"missing {missing}")
        given = [one for one in kind.subjects if one in args]
        good = len(given) == 1 or (not given and kind.subjects != _SENSOR)
        require(good, "give a site or a signal")
        what = given[0] if given else ""
        subject, t = args.get(what), args.get("t")
        mm, when = args.get("mm", 0.0), args.get("when", "lift")
        good = subject is None or (isinstance(subject, str) and subject)
        require(good, f"{what} {subject!r} is no name")
        if name == "probe_falls":
            good = subject in (None, *PROBE_SITES)
            require(good, f"site {subject!r} not in {PROBE_SITES}")
        for value in (mm, 0.0 if t is None else t):
            good = isinstance(value, (int, float)) and 0.0 <= value < math.inf
            require(good, f"{value!r} is not a number of zero or more")
        require("mm" not in args or mm > 0.0, f"mm {mm!r} is not above zero")
        n = args.get(kind.counted, 1)
        good = type(n) is int and n >= 1
        require(good, f"{kind.counted} {n!r} is not an integer above 0")
        good = what != "signal" or "touch" not in args
        require(good, "touches are those of a site, not of a signal")
        good = t is None or (what != "site" and command is None)
        require(good, "from time t on, nothing is counted")
        good = t is None or persistent is not False
        require(good, "from time t on, it stays")
        require(
            when in ("touch", "lift"), f"when {when!r} is not touch or lift"
        )
        require(strikes in _STRIKES, f"strikes {strikes!r} not in {_STRIKES}")
        super().__init__(
            name=name,
            what=what,
            subject=subject,
            n=n,
            command=None if command is None else command.upper(),
            persistent=kind.stays if persistent is None else persistent,
            t=t,
            mm=mm,
            when=when,
            strikes=strikes,
        )

    def __repr__(self) -> str:
        """As it is written."""
        kind = _kind(self.name)
        about = {self.what: self.subject}
        if self.t is None and self.what != "signal":
            about[kind.counted] = self.n
        about.update(t=self.t, command=self.command, mm=self.mm or None)
        told = [
            f"{key}={value!r}"
            for key, value in about.items()
            if key and value is not None
        ]
        return f"Fault({', '.join([repr(self.name), *told])})"

    @property
    def at_site(self) -> bool:
        """Whether the touches of a sensor at a site are counted."""
        return self.what == "site" and _kind(self.name).subjects == _SENSOR

    def matches(self, name: str, subject: Optional[str]) -> bool:
        """Whether an operation of that kind on that subject is meant."""
        return (
            self.name == name
            and not self.at_site
            and self.subject in (None, subject)
        )


@dataclass
class _Kept:
    """A fault of one run: how much was counted, and whether it has struck."""

    fault: Fault
    count: int = 0
    fired: bool = False

    def complaint(self) -> Optional[str]:
        """What is wrong with how it ends, if anything."""
        if self.fault.strikes == "must" and not self.fired:
            return f"has not struck: {self.fault!r}"
        if self.fault.strikes == "never" and self.fired:
            return f"was never to strike, and has: {self.fault!r}"
        return None


class Faults:
    """The faults of one run, their counters, and which have struck."""

    __slots__ = ("_complaints", "_kept", "_running")

    def __init__(self, faults: Iterable[Fault] = ()) -> None:
        self._kept: list[_Kept] = []
        # Of those that were taken away
        self._complaints: list[str] = []
        # Scripts that have not ended, by what each begins with
        self._running: list[str] = []
        for fault in faults:
            self.add(fault)

    def add(self, fault: Fault) -> None:
        """Add one; what it is about is counted from now on."""
        self._kept.append(_Kept(fault))

    def clear(self) -> None:
        """Take all away."""
        self._complaints = self._all_complaints()
        self._kept.clear()

    def __iter__(self) -> Iterator[Fault]:
        return iter([kept.fault for kept in self._kept])

    # Commands, as the session tells

    def script_begins(self, script: str) -> None:
        """A script is sent to the host: count anew what is about its command.

        Raises ValueError where a fault is about a later one of its commands:
        only the host would know when that begins.
        """
        first, *others = _commands(script) or [""]
        for kept in self._kept:
            fault = kept.fault
            if kept.fired or fault.command is None:
                continue
            if fault.command in others and fault.command != first:
                raise ValueError(
                    f"{fault!r}: when {fault.command} begins is known of a"
                    f" script that begins with it, not of {script!r}"
                )
            if fault.command == first:
                kept.count = 0
        self._running.append(first)

    def script_ends(self, script: str) -> None:
        """That script has ended."""
        first = (_commands(script) or [""])[0]
        if first in self._running:
            self._running.remove(first)

    def _counts(self, kept: _Kept) -> bool:
        """Whether what happens now is of the command that is meant."""
        command = kept.fault.command
        return command is None or command in self._running

    # What happens

    def fires(
        self, name: str, subject: Optional[str] = None
    ) -> Optional[Fault]:
        """Count one operation; return the fault that strikes it, if any.

        Ask exactly once per operation.
        """
        if "t" in _kind(name).needed:
            raise ValueError(f"{name} goes by time: ask due()")
        striking: Optional[Fault] = None
        for kept in self._kept:
            fault = kept.fault
            if fault.t is not None or not fault.matches(name, subject):
                continue
            strikes = kept.fired and fault.persistent
            if self._counts(kept):
                kept.count += 1
                strikes = strikes or kept.count == fault.n
            if strikes:
                kept.fired = True
                striking = striking or fault
        return striking

    def at_next_touch(self, name: str, site: str) -> Optional[Fault]:
        """The fault of that name that the next touch of a site meets."""
        for kept in self._kept:
            fault = kept.fault
            if not fault.at_site or (fault.name, fault.subject) != (name, site):
                continue
            if kept.fired and fault.persistent:
                return fault
            if self._counts(kept) and kept.count + 1 == fault.n:
                return fault
        return None

    def touched(self, site: str) -> None:
        """Count one touch of a site."""
        for kept in self._kept:
            fault = kept.fault
            if not fault.at_site or fault.subject != site:
                continue
            if self._counts(kept):
                kept.count += 1

    def strikes(self, fault: Fault) -> None:
        """One that at_next_touch() has told has struck."""
        for kept in self._kept:
            kept.fired = kept.fired or kept.fault is fault

    def begins(self, name: str, subject: Optional[str] = None) -> float:
        """Seconds from which a fault by time applies; infinity if none."""
        _kind(name)
        times = [
            fault.t
            for fault in self
            if fault.t is not None and fault.matches(name, subject)
        ]
        return min(times, default=math.inf)

    def due(self, name: str, t: float, subject: Optional[str] = None) -> bool:
        """Whether a fault by time applies at t; it then counts as fired."""
        _kind(name)
        due = False
        for kept in self._kept:
            fault = kept.fault
            if fault.t is None or t < fault.t:
                continue
            if fault.matches(name, subject):
                kept.fired = due = True
        return due

    # What came of it

    def unfired(self) -> list[Fault]:
        """Faults that have not struck so far."""
        return [kept.fault for kept in self._kept if not kept.fired]

    def require_struck(self) -> None:
        """Raise FaultError if one has not struck, or has that must not."""
        complaints = self._all_complaints()
        if complaints:
            raise FaultError("\n  ".join(("a fault", *complaints)))

    def _all_complaints(self) -> list[str]:
        found = [kept.complaint() for kept in self._kept]
        return [*self._complaints, *filter(None, found)]


def _commands(script: str) -> list[str]:
    """The commands of G-code, one of each line."""
    lines = [line.partition(";")[0].split() for line in script.splitlines()]
    return [words[0].upper() for words in lines if words]
