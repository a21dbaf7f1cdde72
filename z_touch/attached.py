"""Which probe is on the toolhead now, of all sections that can put one there.

What lowers the nozzle on its own account asks here first: a probe below it would meet the
bed before it does.  What asks a person into the printer says so here, that nothing drives
off by itself meanwhile.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Dict, List, Optional, Protocol, Tuple

from . import touch
from .errors import CalibrationError
from .host import dock

if TYPE_CHECKING:
    from .host.klippy import Printer
    from .host.printer import Host
    from .progress import Progress

# Where the probe may be, as commands and status have it; UNKNOWN also where the
# pins contradict each other, so that it may be on the toolhead
ATTACHED, DOCKED, UNKNOWN = "ATTACHED", "DOCKED", "UNKNOWN"

# Among the printer's objects; a RESTART makes new ones.
NAME = "z_touch_attached"


class Carrier(Protocol):
    """What can attach a probe to the toolhead and dock it: a [dockable_probe]."""

    @property
    def auto(self) -> bool:
        """Whether it goes to the dock by itself."""

    def state(self) -> str:
        """Return ATTACHED, DOCKED or UNKNOWN, the toolhead standing.  May pause."""

    def reads(self) -> str:
        """Return what that follows from, in words."""

    def dock_and_come_back(self) -> None:
        """Dock the probe, the toolhead then just where it was; or raise.  May pause."""

    def dock_pending(self) -> None:
        """Dock now, where that was to happen in a while.  May pause."""

    def mark(self) -> object:
        """Return what is_put_on() compares with."""

    def is_put_on(self, mark: object, was_docked: bool) -> bool:
        """Return whether the user has attached the probe to stay since a mark was made.

        'was_docked': it was in the dock then.
        """

    def fetch(self) -> None:
        """Attach the probe, to stay; or raise.  May pause."""

    def go_to(self, x: float, y: float, speed: float) -> None:
        """Move around the dock, and to the very place."""


def of(printer: Printer) -> Attached:
    """Return the one Attached of a printer."""
    attached: Optional[Attached] = printer.lookup_object(NAME, None)
    if attached is None:
        attached = Attached()
        printer.add_object(NAME, attached)
    return attached


class Attached:
    """One for a printer: each section tells it, and asks it, what is on the toolhead."""

    def __init__(self) -> None:
        # Of our [dockable_probe]; None: there is none
        self.joined: Optional[Carrier] = None
        # The commands that answer a question, by the section that has asked it
        self.questions: Dict[str, Tuple[str, str]] = {}
        # Of each section that measures
        self.watches: List[Progress] = []

    def join(self, carrier: Carrier) -> None:
        """Add our [dockable_probe] while the configuration is read."""
        self.joined = carrier

    def is_measuring(self) -> bool:
        """Return whether a command is under way that knows what is on the toolhead."""
        return any(watch.phase != "idle" for watch in self.watches)

    def carrier(self, host: Host) -> Optional[Carrier]:
        """Return what has the probe, None: macros, if anything.

        A [probe] that macros fetch is not asked: a pin that reads open may be anything.
        """
        return self.joined or dock.find(host)

    ######################################################################
    # Before the nozzle goes down
    ######################################################################

    def free_nozzle(
        self, host: Host, regardless: bool = False, goes_on: bool = False
    ) -> None:
        """Have nothing below the nozzle, and the toolhead where it was.  May pause.

        Otherwise raises CalibrationError, or the host's error.  'host' is that of the section
        that asks.  A dock is left alone where the user wants no automatic docking, unless
        'regardless'.  'goes_on': the section moves to its own place next.
        """
        self.check_questions(host)
        carrier = self.carrier(host)
        if carrier is None:
            return
        state = carrier.state()
        if state == DOCKED:
            return
        if not (carrier.auto or regardless):
            raise CalibrationError(
                f"the probe is {state} ({carrier.reads()}), and would meet the bed before"
                " the nozzle does; auto_attach_detach is off, so it is not docked by"
                " itself; run DETACH_PROBE"
            )
        x, y = host.toolhead.get_position()[:2]
        carrier.dock_and_come_back()
        here = host.toolhead.get_position()[:2]
        moved = max(abs(here[0] - x), abs(here[1] - y))
        if moved > touch.NO_TRAVEL and not goes_on:
            raise CalibrationError(
                "the probe was docked, and the toolhead did not come back from"
                f" X={here[0]:.3f} Y={here[1]:.3f} to X={x:.3f} Y={y:.3f}; move it to"
                " where it is to touch, and begin again"
            )

    def check_docked(self, host: Host, option: str) -> None:
        """Raise CalibrationError where the G-code of an option has attached a probe.

        So it looks as well where a switch breaks meanwhile.  May pause.
        """
        carrier = self.carrier(host)
        if carrier is not None and carrier.state() != DOCKED:
            raise CalibrationError(
                f"after {option} the probe is {carrier.state()} ({carrier.reads()}),"
                " and would meet the bed before the nozzle does; take what fetches it"
                f" out of {option}, or look at its switch and wire where nothing does"
            )

    def check_questions(self, host: Host, own: bool = False) -> None:
        """Raise CalibrationError while a section waits for an answer of a person.

        What lies on the bed, or whose hand is there, only that person knows.  'own': also
        where the section that asks now is the one that waits.
        """
        if host.print_state():
            # The user has cleared the bed to print: an answer comes no more.
            self.questions.clear()
        for section, (go_on, abort) in self.questions.items():
            if own or section != host.section:
                raise CalibrationError(
                    f"section '{section}' waits for an answer, and somebody's hand may"
                    f" be near; answer with {go_on}, or {abort}"
                )

    ######################################################################
    # A person is asked
    ######################################################################

    def asking(self, section: str, answers: Tuple[str, str]) -> None:
        """Note that a section waits for one of two commands."""
        self.questions[section] = answers

    def answered(self, section: str) -> None:
        """Note that it does not wait any more."""
        self.questions.pop(section, None)

    def is_asking(self, host: Host) -> bool:
        """Return whether a hand may be near the toolhead."""
        return bool(self.questions) or host.probing.is_manual_probing()

    def settle(self, host: Host) -> None:
        """Do now what would happen in a while, before a person is asked.  May pause."""
        carrier = self.carrier(host)
        if carrier is not None:
            carrier.dock_pending()

    ######################################################################
    # From place to place
    ######################################################################

    def go_to(
        self,
        host: Host,
        x: float,
        y: float,
        speed: float,
        x_first: bool = False,
    ) -> None:
        """Move to X and Y (mm), as high as the toolhead is.  May pause.

        Around the dock where there is one that is known; otherwise, with 'x_first', along X
        and then along Y.
        """
        carrier = self.carrier(host)
        if carrier is not None:
            carrier.go_to(x, y, speed)
            return
        if x_first:
            touch.move_xy(host, x, host.toolhead.get_position()[1], speed)
        touch.move_xy(host, x, y, speed)
