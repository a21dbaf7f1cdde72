# The axes of the printer: what drives them, how far they reach, where Z is homed.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections
import functools

from .endstops import chip_of, is_virtual

# The section that configures the Z axis, and its options that matter (mm,
# mm/s, mm/s^2); where the probe homes Z, position_endstop may be left over from a
# switch, see Axes.probe_homes_to().
ZAxis = collections.namedtuple(
    "ZAxis",
    "section endstop_pin position_endstop position_min homing_speed"
    " second_homing_speed homing_retract_dist max_speed max_accel",
)

# Of an axis that is homed on a switch: where that triggers
ENDSTOP_OPTION = "position_endstop"

# Sections that level the Z motors; the last one is Kalico's
LEVELLING = ("quad_gantry_level", "z_tilt", "z_tilt_ng")

# What they turn the motors with
ADJUST = "adjust_steppers"

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
    return ZAxis(
        section=section.get_name(),
        endstop_pin=section.get("endstop_pin", "", note_valid=False),
        position_endstop=number("position_endstop", None),
        position_min=number("position_min", 0.0),
        homing_speed=homing_speed,
        second_homing_speed=number("second_homing_speed", homing_speed / 2.0),
        homing_retract_dist=number("homing_retract_dist", 5.0),
        max_speed=printer("max_z_velocity", None),
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


# The axes as the kinematics of the host drive them; but for z_axis they can be asked
# from klippy:connect on.
class Axes:
    # 'host': host.Host, which is connected later
    def __init__(self, config, host):
        self.host = host
        # None: there is none of its own
        self.z_axis = read_z_axis(config)

    def _kinematics(self):
        return self.host.toolhead.get_kinematics()

    # (low, high) of X, Y and Z (mm)
    def limits(self):
        status = self.host.toolhead_status()
        return list(zip(status["axis_minimum"], status["axis_maximum"]))[:3]

    ##################################################################
    # X and Y
    ##################################################################

    # The axis (0: X, 1: Y) that a homing move of these rails goes along.  None:
    # another axis, or a machine that moves in another way, such as a delta.
    def homed_axis(self, rails):
        kinematics = self._kinematics()
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

    # Where homing X (0) and Y (1) ends (mm), by the axis; empty on machines that
    # home in another way, and where there are two heads
    def xy_ends(self):
        found = {}
        if self.has_two_heads():
            return found
        kinematics = self._kinematics()
        rails = list(getattr(kinematics, "rails", []))
        for carriage in getattr(kinematics, "carriages", {}).values():
            rails.append(carriage.get_rail())
        for rail in rails:
            axis = self.homed_axis([rail])
            if axis is not None:
                found[axis] = rail.get_homing_info().position_endstop
        return found

    # Where the motors say that the head is in X and Y (mm), whatever the host
    # believes: only differences mean something.
    def motors_xy(self):
        self.host.toolhead.flush_step_generation()
        kinematics = self._kinematics()
        return kinematics.calc_position(
            {
                stepper.get_name(): stepper.get_mcu_position()
                * stepper.get_step_dist()
                for stepper in kinematics.get_steppers()
            }
        )[:2]

    # Whether there are two heads: what hangs where after homing is not told.
    def has_two_heads(self):
        lookup = self.host.printer.lookup_object
        return lookup("dual_carriage", None) is not None

    ##################################################################
    # Z
    ##################################################################

    def z_steppers(self):
        steppers = self._kinematics().get_steppers()
        return [s for s in steppers if s.is_active_axis("z")]

    # switched(print_time, is_on) is called when one of them is turned on or off
    def watch_z_enabling(self, switched):
        enabling = self.host.printer.lookup_object("stepper_enable")
        for stepper in self.z_steppers():
            line = enabling.lookup_enable(stepper.get_name())
            line.register_state_callback(switched)

    # around(adjust, *args) comes in the place of adjust(*args), which turns the motors
    # of Z one after another, and sets Z for each.  The command may have ended long
    # before: with METHOD=manual that is at the last ACCEPT.
    def wrap_levelling(self, around):
        for name in LEVELLING:
            section = self.host.printer.lookup_object(name, None)
            helper = getattr(section, "z_helper", None)
            adjust = getattr(helper, ADJUST, None)
            if adjust is not None:
                setattr(helper, ADJUST, functools.partial(around, adjust))

    # The largest step (mm) of the motors of Z
    def z_step(self):
        return max(s.get_step_dist() for s in self.z_steppers())

    # How far the motors of Z have turned (mm): only differences mean something.
    # Empty where X or Y share these motors.
    def z_motors(self):
        steppers = self.z_steppers()
        if any(s.is_active_axis(axis) for s in steppers for axis in "xy"):
            return []
        return [s.get_mcu_position() * s.get_step_dist() for s in steppers]

    # Where the motors of Z stand, apart from where the host believes Z is: the
    # difference (mm) changes only when Z is homed, set or levelled.
    def z_datum(self):
        return [
            z - stepper.get_commanded_position()
            for z, stepper in zip(self.z_motors(), self.z_steppers())
        ]

    # What the Z axis can do: mm/s, mm/s^2.  None: its owner has not said, and the host
    # would take what X and Y can do.
    def z_limits(self):
        axis, status = self.z_axis, self.host.toolhead_status()
        speed = axis.max_speed
        return (
            None if speed is None else min(speed, status["max_velocity"]),
            min(axis.max_accel, status["max_accel"]),
        )

    # As fast as its user moves Z elsewhere (mm/s), with 'lift_speed' of the probe, and
    # the acceleration of Z (mm/s^2)
    def z_pace(self, lift_speed):
        limit, accel = self.z_limits()
        speed = max(lift_speed, self.z_axis.homing_speed)
        return (speed if limit is None else min(speed, limit)), accel

    # Such a host believes what the probe says: after G28 the bed is where the
    # probe sees it.
    def homes_with_probe(self):
        axis = self.z_axis
        return axis is not None and chip_of(axis.endstop_pin) == "probe"

    # Toolhead Z (mm) that G28 sets where the probe triggers, in place of its z_offset,
    # which moves no Z=0 then.  Hosts take position_endstop where the endstop of a probe
    # says no height, as that of a smart_effector until 2024-07-04 (34732f857) and on
    # Kalico.  Otherwise they pass over it, also where SAVE_CONFIG had written one for a
    # switch.  None: it is the z_offset.
    def probe_homes_to(self):
        if not self.homes_with_probe():
            return None
        endstop = self.host.endstops.find_z()
        is_told = endstop is None or is_virtual(endstop)
        return None if is_told else self.z_axis.position_endstop

    # None: nobody knows
    def z_zero(self):
        axis, probing = self.z_axis, self.host.probing
        zero = ZZero(axis.section, ENDSTOP_OPTION, axis.position_endstop)
        if self.homes_with_probe() and self.probe_homes_to() is None:
            zero = ZZero(probing.section, "z_offset", probing.z_offset())
        return None if None in zero else zero
