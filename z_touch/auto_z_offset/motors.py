# How gently the Z motors move while something is touched: acceleration and
# current.  It knows how hosts differ in their motor drivers, and asks the object.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import contextlib
import functools

from ..command import always

# Standstill (s) that a TMC driver needs to settle on another current: 130 ms
# in its data sheet.
SETTLE_TIME = 0.15

# A driver that does not answer may do so the next time.
RESTORE_ATTEMPTS = 2


######################################################################
# Acceleration
######################################################################


# With what (mm/s^2) the head brakes in Z if 'accel' limits it, too; 0: it does
# not
def braking_accel(host, accel):
    limits = [host.toolhead_status()["max_accel"], host.axes.z_axis.max_accel]
    return min(limits + [accel] if accel else limits)


# The head is accelerated by 'accel' (mm/s^2) at most for a while; 0: as it is
@contextlib.contextmanager
def limited_accel(host, accel):
    max_accel = host.toolhead_status()["max_accel"]
    if not 0.0 < accel < max_accel:
        yield
        return
    command = "SET_VELOCITY_LIMIT ACCEL=%.6f"
    run_script = host.gcode.run_script_from_command
    restore = functools.partial(run_script, command % (max_accel,))
    with always(host, restore, "restoring the acceleration"):
        run_script(command % (accel,))
        yield


######################################################################
# Current
######################################################################


# Z motors whose current may be changed, as (name for SET_TMC_CURRENT, driver):
# those that move nothing else and whose TMC driver tells its current.
class Motors:
    def __init__(self, host):
        self.host = host
        self.gcode = host.gcode
        drivers = host.printer.lookup_objects()
        steppers = host.axes.z_steppers()
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

    # Less current while a touch lasts; afterwards what it was before.  The
    # motors have settled when a touch begins whose caller has waited for the
    # end of the moves: hosts let the next one begin 0.25 s later.
    @contextlib.contextmanager
    def reduced(self, factor):
        drivers = self.drivers if factor < 1.0 else []
        eventtime = self.host.eventtime()
        amps = {
            name: driver.get_status(eventtime)["run_current"]
            for name, driver in drivers
        }
        reduced = {name: current * factor for name, current in amps.items()}
        restore = functools.partial(self._restore, amps, reduced)
        with always(self.host, restore, "restoring the motor current"):
            for error in self._set_all(reduced).values():
                raise error
            yield

    # Back to 'amps', from 'reduced', both by the names of the motors
    def _restore(self, amps, reduced):
        written = self.host.toolhead.get_last_move_time()
        failed = self._set_all(amps)
        for _ in range(RESTORE_ATTEMPTS):
            # Hosts write only what differs from what they wrote last, and
            # count a write that failed as done
            self._set_all({name: reduced[name] for name in failed})
            failed = self._set_all({name: amps[name] for name in failed})
        texts = [
            "%s: the current of %s could not be set back: %s; run"
            " SET_TMC_CURRENT STEPPER=%s CURRENT=%.3f or FIRMWARE_RESTART"
            % (self.host.section, name, error, name, amps[name])
            for name, error in sorted(failed.items())
        ]
        for text in texts:
            # Said here, as an earlier error comes before this one
            self.gcode.respond_info(text)
        if texts:
            raise self.host.printer.command_error(texts[0])
        begun = self.host.toolhead.get_last_move_time()
        if amps and begun < written + SETTLE_TIME:
            self.host.toolhead.dwell(written + SETTLE_TIME - begun)

    # At the same time, as each waits for the end of the moves and a quarter of
    # a second more.  Returns the errors by the names of the motors.
    def _set_all(self, amps):
        register = self.host.printer.get_reactor().register_callback
        done = {
            name: register(functools.partial(self._set, name, amps[name]))
            for name in amps
        }
        failed = {name: completion.wait() for name, completion in done.items()}
        return {name: error for name, error in failed.items() if error}

    # The handler of SET_TMC_CURRENT, called without its line on the console:
    # four of them for every touch would hide the results.  Without its limits,
    # too: what a driver reports may be a step of its scale above them.
    def _set(self, name, amps, eventtime):
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
        try:
            handlers[name](gcmd)
        except Exception as e:  # noqa: BLE001
            # Raised by whoever waits: here it would end klippy
            return e
        return None
