"""Whether Z=0 is still where it was: homed, set, levelled, or a motor turned off since.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import (
    TYPE_CHECKING,
    Any,
    List,
    NamedTuple,
    Optional,
    Sequence,
    Tuple,
)

if TYPE_CHECKING:
    from .host.klippy import GCodeCommand, Handler
    from .host.printer import Host

HOMED_OR_SET = "Z was homed again or set"
HOMED_AGAIN = "Z was homed again"
LEVELLED = "the Z motors were levelled"
MOTORS_OFF = "the motors were turned off"
NOT_HOMED = "Z is not homed"

# Every probing move may shift Z by a part of a microstep; what adds up to less than this
# (mm) is neither homing nor levelling.
DATUM_NOISE = 0.02


class Mark(NamedTuple):
    """Where Z=0 is: how much had happened by then, and where the motors stood (mm)."""

    events: int
    motors: List[float]


def is_uneven(shifts: Sequence[float]) -> bool:
    """Return whether some motors are elsewhere by more than others (mm)."""
    return bool(shifts) and max(shifts) - min(shifts) > DATUM_NOISE


class Datum:
    """What happened to Z=0 since a mark was made."""

    def __init__(self, host: Host):
        self.host = host
        # What happened, in words
        self.noted: List[str] = []
        # The motors (mm) when Z was set last, and when it was set last for all of them
        self.motors: List[float] = []
        self.even_motors: List[float] = []
        # Where the toolhead was then (X and Y, mm); None: it was not set
        self.set_at: Optional[Tuple[float, float]] = None
        # Some of them have moved without the others
        self.is_levelling = False
        register = host.printer.register_event_handler
        register("toolhead:set_position", self._set)
        register("homing:home_rails_end", self._homed)
        register("stepper_enable:motor_off", self._off)
        register("klippy:ready", self._watch_motors)

    def mark(self) -> Mark:
        """Return where Z=0 is now."""
        return Mark(len(self.noted), self.host.axes.z_datum())

    def is_homed(self) -> bool:
        """Return whether Z is homed; SET_KINEMATIC_POSITION forgets it without an event."""
        return self.host.is_homed("z")

    def moved_since(self, mark: Mark, besides: Optional[str] = None) -> str:
        """Return why heights of before do not hold; empty: they do.

        'besides' is one of the words above, and counts as nothing.
        """
        if besides != MOTORS_OFF and not self.is_homed():
            return self._last(mark.events) or NOT_HOMED
        shifts = self._shifts(mark.motors)
        if is_uneven(shifts):
            return LEVELLED
        noted = self._last(mark.events, besides)
        if noted:
            return noted
        is_elsewhere = max(map(abs, shifts), default=0.0) > DATUM_NOISE
        return HOMED_OR_SET if is_elsewhere else ""

    def was_set_since(self, mark: Mark) -> bool:
        """Return whether Z was homed or set; a motor that was off has set nothing."""
        return any(what != MOTORS_OFF for what in self.noted[mark.events :])

    def moved_by(self, mark: Mark) -> float:
        """Return by how much (mm) the motor that has moved most is elsewhere now."""
        return max(map(abs, self._shifts(mark.motors)), default=0.0)

    def _last(self, count: int, besides: Optional[str] = None) -> str:
        noted = [what for what in self.noted[count:] if what != besides]
        return noted[-1] if noted else ""

    def _shifts(self, motors: Sequence[float]) -> List[float]:
        """Return by how much (mm) each motor is elsewhere since."""
        return [a - b for a, b in zip(self.host.axes.z_datum(), motors)]

    ##################################################################
    # Events
    ##################################################################

    def _set(self) -> None:
        """Note that Z was set.

        Homing sets Z somewhere else at first, on every host; it may come back to where it
        was.  [z_tilt] and [quad_gantry_level] move some of the motors and set Z after each,
        also where one had not to turn, then once more for all: z_tilt so that the bed is at
        0, while with the gantry the middle stays as high.
        """
        if not hasattr(self.host, "toolhead"):
            return
        shifts = self._shifts(self.motors)
        self.motors = self.host.axes.z_datum()
        is_still = max(map(abs, shifts), default=0.0) <= DATUM_NOISE
        if is_uneven(shifts) or (self.is_levelling and is_still):
            self.is_levelling = True
            return
        self.is_levelling = False
        shifts, self.even_motors = self._shifts(self.even_motors), self.motors
        if shifts and abs(sum(shifts)) > DATUM_NOISE * len(shifts):
            self.noted.append(HOMED_OR_SET)
            x, y = self.host.toolhead.get_position()[:2]
            self.set_at = x, y

    def _homed(self, homing_state: Any, _rails: Any) -> None:
        # Not sent where Z is homed with the probe since 2026-05-25 (5cbebdc3c)
        if 2 in homing_state.get_axes():
            self.noted.append(HOMED_AGAIN)

    def _off(self, *_unused: Any) -> None:
        # With a print time until 2026, which is not needed
        self.noted.append(MOTORS_OFF)

    def _watch_motors(self) -> None:
        """Have SET_STEPPER_ENABLE seen, which turns a motor off without an event."""
        self.host.axes.watch_z_enabling(self._switched)

    def _switched(self, _print_time: float, is_on: bool) -> None:
        if not is_on:
            self.noted.append(MOTORS_OFF)


class HomedDatum:
    """The Z=0 that G28 has left: only there a height says where Z is to be homed.

    A G28 may level in the end, in a [homing_override] or a macro, so it is looked at when
    the command has ended, which no event tells: the command is wrapped.
    """

    def __init__(self, datum: Datum):
        self.host = datum.host
        self.datum = datum
        # None: Z was not homed with G28
        self.mark: Optional[Mark] = None
        # Where the toolhead was then (X and Y, mm); None: that is not known
        self.at: Optional[Tuple[float, float]] = None
        # How many of these commands have begun: one may have others in it
        self.begun = 0
        # All sections have registered their commands then, and no macro has taken the
        # place of one.
        register = self.host.printer.register_event_handler
        register("klippy:mcu_identify", self._watch)

    def _watch(self) -> None:
        self.host.wrap_command("G28", self._around_homing)

    def _around_homing(self, command: Handler, gcmd: GCodeCommand) -> None:
        # In a [homing_override] anything may follow, which is no homing.
        self.begun += 1
        own, noted = self.begun, len(self.datum.noted)
        command(gcmd)
        if self.begun == own and len(self.datum.noted) > noted:
            self.mark = self.datum.mark()
            self.at = self.datum.set_at

    def moved_since(self, mark: Mark) -> str:
        """Return what has moved Z=0 since a mark, or since a G28 that came after it.

        For what any G28 makes right again.  In words; empty: nothing.
        """
        if self.mark is not None and self.mark.events > mark.events:
            mark = self.mark
        return self.datum.moved_since(mark)

    def moved(self) -> str:
        """Return what has moved Z=0 since G28, in words.

        Empty: nothing has, or the motors do not tell.
        """
        if self.moved_by() <= DATUM_NOISE:
            return ""
        if self.mark is None:
            return "Z was not homed with G28"
        return f"{self.datum.moved_since(self.mark)} since G28"

    def moved_by(self) -> float:
        """Return by how much (mm); infinite where that is not known."""
        if not self.host.axes.z_datum():
            return 0.0
        if self.mark is None:
            return float("inf")
        if MOTORS_OFF in self.datum.noted[self.mark.events :]:
            return float("inf")
        return self.datum.moved_by(self.mark)
