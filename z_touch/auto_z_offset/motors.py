"""How gently the Z motors move while the nozzle touches: acceleration and current.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Dict, Iterator, List

from ..command import always

if TYPE_CHECKING:
    from ..host.printer import Host

# Standstill (s) that a TMC driver needs to settle on another current: 130 ms
# in its data sheet.
SETTLE_TIME = 0.15

# A driver that does not answer may do so the next time.
RESTORE_ATTEMPTS = 2

# What a driver reports is a step of its scale, and may be above what the host takes; so much
# less, as a share, is the same step
LESS_THAN_A_STEP = 0.01


######################################################################
# Acceleration
######################################################################


def braking_accel(host: Host, accel: float) -> float:
    """Return with what (mm/s^2) the toolhead brakes in Z if 'accel' limits it, too.

    0: it does not.
    """
    assert host.axes.z_axis is not None
    limits = [host.toolhead_status()["max_accel"], host.axes.z_axis.max_accel]
    slowest: float = min([*limits, accel] if accel else limits)
    return slowest


@contextlib.contextmanager
def limited_accel(host: Host, accel: float) -> Iterator[None]:
    """Have the toolhead accelerate by 'accel' (mm/s^2) at most for a while; 0: as it is."""
    max_accel: float = host.toolhead_status()["max_accel"]
    if not 0.0 < accel < max_accel:
        yield
        return
    run_script = host.gcode.run_script_from_command

    def restore() -> None:
        """Set the acceleration (mm/s^2) that was in force."""
        run_script(f"SET_VELOCITY_LIMIT ACCEL={max_accel:.6f}")

    with always(host, restore, "restoring the acceleration"):
        run_script(f"SET_VELOCITY_LIMIT ACCEL={accel:.6f}")
        yield


######################################################################
# Current
######################################################################


class Motors:
    """The Z motors whose current may be changed.

    They move nothing else, and their TMC driver tells its current.  It is set as a user
    would, by SET_TMC_CURRENT: the object behind that is another one on each host.  All
    methods may pause.
    """

    def __init__(self, host: Host):
        self.host = host
        steppers = host.axes.z_steppers()
        pure = [
            stepper.get_name()
            for stepper in steppers
            if not any(stepper.is_active_axis(axis) for axis in "xy")
        ]
        # By the name for SET_TMC_CURRENT
        self.drivers: Dict[str, Any] = {
            name.split()[-1]: driver
            for name, driver in host.printer.lookup_objects()
            if name.startswith("tmc")
            and name.partition(" ")[2] in pure
            and self._may_be_reduced(driver)
        }
        # Z motors whose current stays
        self.left_alone: List[str] = [
            stepper.get_name()
            for stepper in steppers
            if stepper.get_name().split()[-1] not in self.drivers
        ]

    def _may_be_reduced(self, driver: Any) -> bool:
        """Return whether a driver tells its current, and takes another one.

        Kalico's drivers have a current of their own for homing.  Where they scale it
        globally as well (TMC5160, TMC2240) a small one shuts the printer down there, and
        writing it back makes it smaller.
        """
        has_command = "SET_TMC_CURRENT" in self.host.gcode.ready_gcode_handlers
        if not (has_command and hasattr(driver, "get_status")):
            return False
        owner = getattr(driver.get_status, "__self__", None)
        helper = getattr(owner, "current_helper", None)
        fields = getattr(driver, "fields", None)
        has_own_homing = hasattr(helper, "req_home_current")
        scale = fields and fields.lookup_register("globalscaler")
        if has_own_homing and scale is not None:
            return False
        return "run_current" in driver.get_status(self.host.eventtime())

    @contextlib.contextmanager
    def reduced(self, factor: float) -> Iterator[None]:
        """Have less current while a touch lasts; afterwards it is what it was before.

        The motors have settled when a touch begins whose caller has waited for the end of
        the moves: hosts let the next one begin 0.25 s later.
        """
        if factor >= 1.0 or not self.drivers:
            yield
            return
        eventtime = self.host.eventtime()
        amps: Dict[str, float] = {
            name: driver.get_status(eventtime)["run_current"]
            for name, driver in self.drivers.items()
        }
        less = {name: current * factor for name, current in amps.items()}

        def restore() -> None:
            """Set the currents (A) that were in force."""
            self._restore(amps, less)

        with always(self.host, restore, "restoring the motor current"):
            for error in self._set_all(less).values():
                raise error
            yield

    def _restore(self, amps: Dict[str, float], less: Dict[str, float]) -> None:
        """Set all motors back (A), and wait until they have settled.

        Raises the host's error where one cannot be set back.
        """
        toolhead = self.host.toolhead
        written = toolhead.get_last_move_time()
        failed = self._set_all(amps)
        share = 1.0 - LESS_THAN_A_STEP
        refused = [name for name in failed if "maximum" in str(failed[name])]
        for name in refused:
            del failed[name]
        # Nothing was written then: the step below is the one that it was
        failed.update(
            self._set_all({name: amps[name] * share for name in refused})
        )
        for _ in range(RESTORE_ATTEMPTS):
            # Hosts write only what differs from what they wrote last, and count a
            # write that failed as done
            self._set_all({name: less[name] for name in failed})
            failed = self._set_all({name: amps[name] for name in failed})
        texts = [
            f"{self.host.section}: the current of {name} could not be set back: {error};"
            f" run SET_TMC_CURRENT STEPPER={name} CURRENT={amps[name]:.3f} or"
            " FIRMWARE_RESTART"
            for name, error in sorted(failed.items())
        ]
        for text in texts:
            # Said here, as an earlier error comes before this one
            self.host.gcode.respond_info(text)
        if texts:
            raise self.host.printer.command_error(texts[0])
        begun = toolhead.get_last_move_time()
        if begun < written + SETTLE_TIME:
            toolhead.dwell(written + SETTLE_TIME - begun)

    def _set_all(self, amps: Dict[str, float]) -> Dict[str, Exception]:
        """Set the current of each motor (A); return the errors by their names.

        At the same time, as each waits for the end of the moves and a quarter of a second
        more.
        """
        reactor = self.host.printer.get_reactor()
        failed: Dict[str, Exception] = {}

        def set_one(name: str, current: float) -> None:
            """Set the current (A) of one motor; keep its error for the caller."""
            script = f"SET_TMC_CURRENT STEPPER={name} CURRENT={current:.6f}"
            try:
                self.host.gcode.run_script_from_command(script)
            except Exception as e:  # noqa: BLE001
                # Raised by what waits: in a greenlet it would end klippy
                failed[name] = e

        waiting = []
        for name, current in amps.items():

            def begin(
                _eventtime: float, name: str = name, current: float = current
            ) -> None:
                """Set one of them, in a greenlet of its own."""
                set_one(name, current)

            waiting.append(reactor.register_callback(begin))
        for completion in waiting:
            completion.wait()
        # One after another: a macro of that name cannot run twice at a time.  What the host
        # has tried to write is not tried again: it counts as done there.
        for name in [n for n in failed if "recursively" in str(failed[n])]:
            del failed[name]
            set_one(name, amps[name])
        return failed
