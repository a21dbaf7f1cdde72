# How gently the Z motors move while something is touched.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import contextlib
import functools
import logging

from .running import always

# Standstill (s) that a TMC driver needs to settle on another current: 130 ms
# in its data sheet.
SETTLE_TIME = 0.2

# A driver that does not answer may do so the next time.
RESTORE_ATTEMPTS = 2


# With what (mm/s^2) the head brakes in Z if 'accel' limits it, too; 0: not
def braking_accel(host, accel):
    limits = [host.toolhead_status()["max_accel"], host.z_axis.max_accel]
    return min(limits + [accel] if accel else limits)


# max_accel (mm/s^2) for a while; 0: as it is
@contextlib.contextmanager
def limited_accel(host, accel):
    found = host.toolhead_status()["max_accel"]
    if not 0.0 < accel < found:
        yield
        return
    text = "SET_VELOCITY_LIMIT ACCEL=%.6f"
    script = host.gcode.run_script_from_command
    restore = functools.partial(script, text % (found,))
    with always(host, restore, "restoring the acceleration"):
        script(text % (accel,))
        yield


# Z motors whose current may be changed, as (name for SET_TMC_CURRENT, driver):
# those that move nothing else and whose TMC driver tells its current.
class Motors(object):
    def __init__(self, host):
        self.host = host
        self.gcode = host.gcode
        drivers = host.printer.lookup_objects()
        steppers = host.z_steppers()
        pure = [
            s.get_name()
            for s in steppers
            if not any(s.is_active_axis(axis) for axis in "xy")
        ]
        self.drivers = [
            (name.split()[-1], driver)
            for name, driver in drivers
            if name.startswith("tmc")
            and name.partition(" ")[2] in pure
            and self._may_be_reduced(name.split()[-1], driver)
        ]
        reduced = [name for name, unused in self.drivers]
        # Z motors whose current stays
        self.left_alone = [
            s.get_name()
            for s in steppers
            if s.get_name().split()[-1] not in reduced
        ]

    def _may_be_reduced(self, name, driver):
        unused, handlers = self._handlers()
        if name not in handlers:
            return False
        # Kalico's drivers have a current of their own for homing.  Where they
        # scale it globally as well (TMC5160, TMC2240) a small one shuts the
        # printer down there, and writing it back makes it smaller.
        owner = getattr(driver.get_status, "__self__", None)
        helper = getattr(owner, "current_helper", None)
        fields = getattr(driver, "fields", None)
        if (
            hasattr(helper, "req_home_current")
            and fields is not None
            and fields.lookup_register("globalscaler") is not None
        ):
            return False
        # Since 2021-10-11 (64e464987)
        return "run_current" in driver.get_status(self.host.eventtime())

    def _handlers(self):
        return self.gcode.mux_commands.get("SET_TMC_CURRENT", ("", {}))

    # Less current while a touch lasts; afterwards what it was before.
    @contextlib.contextmanager
    def reduced(self, factor):
        drivers = self.drivers if factor < 1.0 else []
        now = self.host.eventtime()
        found = [(n, d.get_status(now)["run_current"]) for n, d in drivers]
        changes = [(name, amps, amps * factor) for name, amps in found]
        restore = functools.partial(self._restore_all, changes)
        with always(self.host, restore, "restoring the motor current"):
            for name, _, less in changes:
                self._set(name, less)
            self._settle(changes)
            yield

    def _restore_all(self, changes):
        failed = [self._restore(*change) for change in changes]
        failed = [error for error in failed if error is not None]
        if failed:
            raise failed[0]
        self._settle(changes)

    # Returns the error that stayed
    def _restore(self, name, amps, reduced):
        for attempt in range(1 + RESTORE_ATTEMPTS):
            try:
                if attempt:
                    # Hosts write only what differs from what they wrote last,
                    # and count a write that failed as done
                    self._set(name, reduced)
            except self.host.printer.command_error:
                logging.info(
                    "%s: current of %s: trying again", self.host.name, name
                )
            try:
                self._set(name, amps)
                return None
            except self.host.printer.command_error as e:
                error = e
        # Said here, as an earlier error comes before this one
        text = (
            "%s: the current of %s could not be set back: %s; run"
            " SET_TMC_CURRENT STEPPER=%s CURRENT=%.3f or FIRMWARE_RESTART"
            % (self.host.name, name, error, name, amps)
        )
        self.gcode.respond_info(text)
        return self.host.printer.command_error(text)

    def _settle(self, changed):
        if changed:
            self.host.toolhead.dwell(SETTLE_TIME)

    # The handler of SET_TMC_CURRENT, called without its line on the console:
    # four of them for every touch would hide the results.  Without its limits,
    # too: what a driver reports may be a step of its scale above them.
    def _set(self, name, amps):
        command = "SET_TMC_CURRENT"
        key, handlers = self._handlers()
        params = {key: name, "CURRENT": "%.6f" % (amps,)}
        line = "%s %s=%s CURRENT=%s" % (command, key, name, params["CURRENT"])
        gcmd = self.gcode.create_gcode_command(command, line, params)
        gcmd.respond_info = lambda *unused, **unused_too: None
        read = gcmd.get_float
        gcmd.get_float = lambda option, *default, **limits: (
            amps if option == "CURRENT" else read(option, *default, **limits)
        )
        handlers[name](gcmd)
