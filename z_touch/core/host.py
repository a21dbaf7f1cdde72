# The printer as the sections want it: objects, clocks, axes, offset and moves.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import functools

from .endstops import Endstops, chip_of, find_probe_section
from .features import Features
from .probing import Probing

# The section that configures the Z axis, and its options that matter (mm,
# mm/s, mm/s^2); position_endstop is None where the probe homes Z.
ZAxis = collections.namedtuple(
    "ZAxis",
    "section endstop_pin position_endstop position_min homing_speed"
    " second_homing_speed homing_retract_dist max_speed max_accel",
)


# How every host since 2021-08-17 (1dc2ab048) begins the error of a probing move
# that has reached its end
NO_TRIGGER = "No trigger"
# How the error begins where boards did not hear of each other in time, or one is gone
NOT_HEARD = ("Communication timeout during", "Unable to obtain")


def has_no_trigger(error):
    return NO_TRIGGER in str(error)


def was_not_heard(error):
    return any(words in str(error) for words in NOT_HEARD)


# Of an axis that is homed on a switch: where that triggers
ENDSTOP_OPTION = "position_endstop"

# Where Z gets its zero: section and option, and the value in force (mm)
ZZero = collections.namedtuple("ZZero", "section option z")


# [stepper_z], or with "kinematics: generic_cartesian" (since 2025-05-06,
# cc6736c3e) the [carriage ...] whose axis is z.  None: there is no Z axis
# of its own, as on a delta.
def find_z_section(config):
    if config.has_section("stepper_z"):
        return config.getsection("stepper_z")
    for carriage in config.get_prefix_sections("carriage "):
        name = carriage.get_name().split()[-1]
        if carriage.get("axis", name, note_valid=False) == "z":
            return carriage
    return None


# Whether "**" in the pattern of an include means folders in folders, and whether
# SAVE_CONFIG writes into what "*" finds
Includes = collections.namedtuple("Includes", "is_deep is_written")


# Read with the defaults that every host documents; note_valid=False leaves
# it to the host to claim these options.
def read_z_axis(config):
    section = find_z_section(config)
    if section is None:
        return None
    number = functools.partial(section.getfloat, note_valid=False)
    homing_speed = number("homing_speed", 5.0)
    printer = functools.partial(
        config.getsection("printer").getfloat, note_valid=False
    )
    fastest = printer("max_velocity", float("inf"))
    return ZAxis(
        section=section.get_name(),
        endstop_pin=section.get("endstop_pin", "", note_valid=False),
        position_endstop=number("position_endstop", None),
        position_min=number("position_min", 0.0),
        homing_speed=homing_speed,
        second_homing_speed=number("second_homing_speed", homing_speed / 2.0),
        homing_retract_dist=number("homing_retract_dist", 5.0),
        max_speed=printer("max_z_velocity", fastest),
        max_accel=printer("max_z_accel", float("inf")),
    )


def check_z_axis(config, z_axis):
    if z_axis is None:
        printer = config.getsection("printer")
        kinematics = printer.get("kinematics", "none", note_valid=False)
        raise config.error(
            "Option 'kinematics: %s' in section 'printer' has no Z axis with an"
            " endstop of its own, and %s cannot be used on this machine; remove"
            " section '%s'" % (kinematics, config.get_name(), config.get_name())
        )


# Axes have letters since 2025-01-21 (4aa550837), numbers before; for eleven days a
# host that can forget a homed axis counted them still.  Those that count ask
# whether theirs is in it, those with letters go through it.
class _AxisZ(str):
    def __contains__(self, axis):
        return axis in (2, "z")


# The host, klippy, as one section sees it.  This file, endstops.py, features.py and
# probing.py are where it is known in which respects hosts differ; the difference is always
# asked of the object, never of a version number.
class Host(object):
    def __init__(self, config):
        self.printer = config.get_printer()
        # In front of every line the user is shown
        self.section = config.get_name()
        self.gcode = self.printer.lookup_object("gcode")
        self.z_axis = read_z_axis(config)
        self.probe_section = find_probe_section(config)
        self.endstops = Endstops(config, self)
        self.probing = Probing(self)
        self.features = Features(self)
        # They exist from klippy:connect on
        self.toolhead = self.mcu = None

    def connect(self):
        self.mcu = self.printer.lookup_object("mcu")
        self.toolhead = self.printer.lookup_object("toolhead")
        self.probing.connect()

    def z_steppers(self):
        steppers = self.toolhead.get_kinematics().get_steppers()
        return [s for s in steppers if s.is_active_axis("z")]

    # Such a host believes what the probe says: after G28 the bed is where the
    # probe sees it.
    def homes_with_probe(self):
        axis = self.z_axis
        return axis is not None and chip_of(axis.endstop_pin) == "probe"

    # From klippy:connect on.  None: nobody knows
    def z_zero(self):
        axis = self.z_axis
        zero = ZZero(axis.section, ENDSTOP_OPTION, axis.position_endstop)
        if self.homes_with_probe():
            zero = ZZero(
                self.probe_section, "z_offset", self.probing.z_offset()
            )
        return None if None in zero else zero

    # The axis (0: X, 1: Y) that a homing move of these rails goes along.  None:
    # another axis, or a machine that moves in another way, such as a delta.
    def homed_axis(self, rails):
        kinematics = self.toolhead.get_kinematics()
        all_rails = getattr(kinematics, "rails", [])
        axes = list(zip(all_rails, (0, 1))) if len(all_rails) >= 3 else []
        # generic_cartesian, since 2025-05-06 (cc6736c3e)
        for carriage in getattr(kinematics, "carriages", {}).values():
            axes.append((carriage.get_rail(), carriage.get_axis()))
        if len(rails) != 1 or not self.z_datum():
            return None
        for rail, axis in axes:
            if rail is rails[0] and axis in (0, 1):
                return axis
        return None

    # Where the motors say that the head is in X and Y (mm), whatever the host
    # believes: only differences mean something.
    def motors_xy(self):
        self.toolhead.flush_step_generation()
        kinematics = self.toolhead.get_kinematics()
        return kinematics.calc_position(
            {
                stepper.get_name(): stepper.get_mcu_position()
                * stepper.get_step_dist()
                for stepper in kinematics.get_steppers()
            }
        )[:2]

    # Whether there are two heads: what hangs where after homing is not told.
    def has_two_heads(self):
        return self.printer.lookup_object("dual_carriage", None) is not None

    # State

    def eventtime(self):
        return self.printer.get_reactor().monotonic()

    # The print time of the end of the last queued move
    def after_moves(self):
        queued, passed, is_empty = self.toolhead.check_busy(self.eventtime())
        if is_empty and queued <= passed:
            return passed
        return self.toolhead.get_last_move_time()

    # The print time that is passing: right after a touch, when nothing moves,
    # this spares the wait
    def print_time(self):
        return self.mcu.estimated_print_time(self.eventtime())

    # Where the motors of Z stand, apart from where the host believes Z is:
    # the difference (mm) changes only when Z is homed, set or levelled.
    # Empty where X or Y share these motors.
    def z_datum(self):
        steppers = self.z_steppers()
        if any(s.is_active_axis(axis) for s in steppers for axis in "xy"):
            return []
        return [
            s.get_mcu_position() * s.get_step_dist()
            - s.get_commanded_position()
            for s in steppers
        ]

    # Whether a print has begun and not ended: its state ("printing", "paused"),
    # or empty
    def print_state(self):
        stats = self.printer.lookup_object("print_stats", None)
        status = stats.get_status(self.eventtime()) if stats else {}
        state = status.get("state", "")
        return state if state in ("printing", "paused") else ""

    # What Kalico does with includes: "**" stands for any depth of folders since
    # 2024-04-10 (c906c80a0), but for its SAVE_CONFIG, which writes options that sit
    # in included files since 2024-02-17 (09b9319ca), where it is told to
    def includes(self):
        danger = self.printer.lookup_object("danger_options", None)
        is_written = getattr(danger, "autosave_includes", False)
        return Includes(danger is not None, bool(is_written))

    def toolhead_status(self):
        return self.toolhead.get_status(self.eventtime())

    # The section of the extruder that is active; empty: the printer has none
    def extruder(self):
        return self.toolhead_status().get("extruder") or ""

    # Degrees C that the nozzle has or is to have, whichever is more
    def nozzle_temperature(self):
        name = self.extruder()
        extruder = name and self.printer.lookup_object(name, None)
        status = extruder.get_status(self.eventtime()) if extruder else {}
        return max(status.get("temperature", 0.0), status.get("target", 0.0))

    # (low, high) of X, Y and Z (mm)
    def axis_limits(self):
        status = self.toolhead_status()
        return list(zip(status["axis_minimum"], status["axis_maximum"]))[:3]

    # The G-code Z offset (mm)
    def gcode_offset(self):
        gcode_move = self.printer.lookup_object("gcode_move")
        return gcode_move.get_status(self.eventtime())["homing_origin"][2]

    # Absolute, so that it replaces any earlier offset.  The command's own
    # method: a macro of that name may add to it, store it or move.
    def set_gcode_offset(self, z_offset):
        params = {"Z": "%.6f" % (z_offset,), "MOVE": "0"}
        line = "SET_GCODE_OFFSET Z=%s MOVE=0" % (params["Z"],)
        gcmd = self.gcode.create_gcode_command("SET_GCODE_OFFSET", line, params)
        self.printer.lookup_object("gcode_move").cmd_SET_GCODE_OFFSET(gcmd)

    # Sets the G-code Z offset (mm), unless it is that already
    def replace_gcode_offset(self, z_offset):
        if self.gcode_offset() != z_offset:
            self.set_gcode_offset(z_offset)

    # Words for the user, on the console and as the error of a command

    def say(self, text):
        self.gcode.respond_info("%s: %s" % (self.section, text))

    def error(self, text):
        return self.printer.command_error("%s: %s" % (self.section, text))

    # Puts around(command, gcmd) in the place of a command of the host, which
    # command(gcmd) runs, as a macro with rename_existing does.  A host without that
    # command stays so.
    def wrap_command(self, name, around):
        command = self.gcode.register_command(name, None)
        if command is not None:
            wrapped = functools.partial(around, command)
            self.gcode.register_command(name, wrapped)

    # The clients of the API that listen to the console.  No host says so; each
    # keeps them where its output goes to.
    def listeners(self):
        outputs = [
            getattr(callback, "__self__", None)
            for callback in getattr(self.gcode, "output_callbacks", ())
        ]
        return [c for out in outputs for c in getattr(out, "clients", ())]

    # A warning of the configuration, for whoever asks the host for these: web
    # interfaces show them until the next start.
    def warn(self, text):
        configfile = self.printer.lookup_object("configfile")
        text = "%s: %s" % (self.section, text)
        if hasattr(configfile, "warn"):
            # Kalico, whose runtime_warning() drops what others have told before
            configfile.warn("runtime_warning", text)
        elif hasattr(configfile, "runtime_warning"):
            # Since 2024-03-13 (0291a1554)
            configfile.runtime_warning(text)

    # Motion; toolhead coordinates (mm), mm/s

    def z(self):
        return self.toolhead.get_position()[2]

    # A probing move first waits for the moves before it, and hosts may wait for
    # ever for its trigger where the printer was shut down meanwhile; whoever
    # sends FIRMWARE_RESTART then waits with them.  So wait here, and look.
    def require_running(self):
        self.toolhead.flush_step_generation()
        if self.printer.is_shutdown():
            raise self.printer.command_error(
                "Touch not begun due to printer shutdown"
            )

    # Down to z or to where the endstop triggers; returns the toolhead Z of the
    # trigger.  The head stops a little lower and stays there.
    def probing_move(self, endstop, z, speed):
        self.require_running()
        target = self.toolhead.get_position()
        target[2] = z
        # A method of the host since 2021-03-29 (862d3f963)
        homing = self.printer.lookup_object("homing")
        return homing.probing_move(endstop, target, speed)[2]

    # Z up by a distance (mm) where nobody knows where it is, and still nobody
    # does then.
    def lift_unhomed(self, distance, speed):
        kinematics = self.toolhead.get_kinematics()
        can_clear = hasattr(kinematics, "clear_homing_state")
        position = self.toolhead.get_position()
        position[2] = 0.0
        z_axis = _AxisZ("z") if can_clear else (2,)
        self.toolhead.set_position(position, homing_axes=z_axis)
        try:
            self.toolhead.manual_move([None, None, distance], speed)
        finally:
            if can_clear:
                kinematics.clear_homing_state(z_axis)
            elif hasattr(kinematics, "note_z_not_homed"):
                kinematics.note_z_not_homed()


# The largest step (mm) of the motors of Z
def z_step(host):
    return max(s.get_step_dist() for s in host.z_steppers())


# What the Z axis can do: mm/s, mm/s^2
def z_limits(host):
    axis, status = host.z_axis, host.toolhead_status()
    return (
        min(axis.max_speed, status["max_velocity"]),
        min(axis.max_accel, status["max_accel"]),
    )
