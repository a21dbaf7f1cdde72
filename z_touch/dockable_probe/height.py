"""How high the toolhead is, as far as that is known, and lifting it.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Optional, Sequence

from .. import touch

if TYPE_CHECKING:
    from ..host.printer import Host
    from .settings import Settings


class Height:
    """What the Z motors and the touches tell, beyond what the host says of Z."""

    def __init__(self, host: Host):
        self.host = host
        # Where Z is not homed: how far (mm) the toolhead was lifted for the dock, and
        # where the Z motors were then, see motors_z()
        self.lifted = 0.0
        self.lifted_to: Optional[float] = None
        # Where the Z motors were when the probe touched the bed in homing; None: unknown
        self.homed_z: Optional[float] = None
        # Toolhead Z (mm) clear of what the probe has touched since Z was homed: a z_offset
        # that is too small is no height to travel at
        self.clear_z = 0.0
        register = host.printer.register_event_handler
        register("stepper_enable:motor_off", self.forget)
        register("homing:home_rails_begin", self._homes)

    def watch_motors(self) -> None:
        """Forget when a motor of Z goes off, which nothing but its enable line tells."""
        self.host.axes.watch_z_enabling(self._switched)

    def _switched(self, _print_time: float, is_on: bool) -> None:
        if not is_on:
            self.forget()

    def forget(self, *_unused: Any) -> None:
        """Forget all: with motors that are off the toolhead may be moved, or sink."""
        self.lifted, self.homed_z = 0.0, None

    def _homes(self, homing_state: Any, _rails: Sequence[Any]) -> None:
        # Not sent everywhere where Z is homed with the probe
        if 2 in homing_state.get_axes():
            self.clear_z = 0.0

    def motors_z(self) -> Optional[float]:
        """Return how far (mm) the Z motors have moved, up is positive, the mean of all.

        Whatever Z was set to.  None: they move X or Y, too.
        """
        steppers, datum = self.host.axes.z_steppers(), self.host.axes.z_datum()
        moved = [
            stepper.get_commanded_position() + shift
            for stepper, shift in zip(steppers, datum)
        ]
        return sum(moved) / len(moved) if moved else None

    def _motors_z_now(self) -> Optional[float]:
        # The motors count their steps only when those were made
        self.host.toolhead.flush_step_generation()
        return self.motors_z()

    def note_bed(self) -> None:
        """Note that the probe has touched the bed in homing, where the Z motors are now."""
        self.homed_z = self.motors_z()

    def note_clear(self, z: float) -> None:
        """Note a toolhead Z (mm) clear of what was touched."""
        self.clear_z = max(self.clear_z, z)

    def lowest(self, settings: Settings) -> float:
        """Return the lowest toolhead Z (mm) with the probe attached, but to touch."""
        return max(settings.travel_z, self.clear_z)

    def lift(self, z: float, speed: float) -> None:
        """Lift to z (mm) where the toolhead is lower, never down.

        Where Z is not homed, so much up in all, less what it went down since, until the
        motors are off.
        """
        if self.host.is_homed("z"):
            self.lifted = 0.0
            touch.raise_to(self.host, z, speed)
            return
        more = z - self._lifted_now()
        if more > 0.0:
            self.host.motion.lift_unhomed(more, speed)
            self.lifted, self.lifted_to = z, self._motors_z_now()

    def _lifted_now(self) -> float:
        """Return what is left of the last lift (mm).

        It is counted by the motors, as Z may have been homed and forgotten again, and
        FORCE_MOVE is told nowhere.
        """
        here = self._motors_z_now()
        if not self.lifted or here is None or self.lifted_to is None:
            return self.lifted
        return self.lifted + (here - self.lifted_to)
