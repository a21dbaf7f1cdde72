# Correction of an inductive probe with a piezo sensor below the bed
#
# Copyright (C) 2026  the Z calibration developers
#
# This file may be distributed under the terms of the GNU GPLv3 license.
#
# AUTO_Z_CALIBRATE measures two heights over the same point of the bed:
#
#   sensor   the nozzle presses the bed until the sensor below it triggers
#   probe    the inductive probe triggers, at a distance from the bed
#
# and takes from them by how much the probe is wrong:
#
#   correction = sensor - (probe - probe z_offset) + z_offset
#
#      sensor           probe           Z=0 with the correction
#
#       \_/  [p]         \_/  [p]         \_/  [p]     nozzle, probe
#     ===v============         :                :  } z_offset, the air gap
#                      =================  ===============  bed
#
# Both heights are toolhead Z: the position, in mm and in the frame of the last
# homing, at which the touch triggered.  G-code offset, bed mesh and skew play
# no part in it.  Up is positive.
#
#   probe - probe z_offset   where the probe believes the bed to be; about 0,
#                            as Z is homed with this probe
#   sensor                   where the bed is: the nozzle stands on it and has
#                            pressed it down as far as the sensor needs
#   z_offset                 air gap above that point which Z=0 shall mean;
#                            below 0 the nozzle is inside the bed there
#   correction               applied as the G-code Z offset: toolhead Z of
#                            G-code Z=0, where the probe says that the bed is 0
#
# The correction belongs to the probe, not to the homing: the next G28 with
# this probe makes it right again.
from __future__ import division

import collections
import contextlib
import difflib
import functools
import logging
import math
import re

######################################################################
# Constants
######################################################################

__version__ = "0.2.0"

# Of the section, and in front of every line the user is shown
NAME = "auto_z_offset"

# No touch goes lower (mm), whatever is configured.
LOWEST_FLOOR = -10.0

# How far (mm) below the expected height a touch may still look, and how far
# above it a trigger is believed.  Expected from a saved correction, or from a
# touch anywhere since Z was homed; and, beyond samples_tolerance, from the
# touch before at the same place: a sensor that is later than this is dead.
KNOWN_MARGIN = 1.0
TOUCH_MARGIN = 0.3

# A sensor is later the faster it is touched; so none is touched braking, also
# when it triggers this much (mm) lower than expected.
BRAKING_RESERVE = 0.1

# From here on (mm) the probe does not see the bed where Z was homed with it:
# the nozzle would be wrong by as much until the next homing.
STALE_Z = 0.1

# A trigger of the bed sensor this far (mm) above the probe's is not the bed.
ABOVE_PROBE = 0.5

# A smaller hop (mm) leaves an inductive probe triggered.
SMALLEST_HOP = 4.0

# An air gap or a correction beyond this (mm) is none.
LARGEST_OFFSET = 10.0

# XY speed (mm/s) between the places.
TRAVEL_SPEED = 50.0

# Standstill (s) that a TMC driver needs to settle on another current: 130 ms
# in its data sheet.
SETTLE_TIME = 0.2

# A driver that does not answer may do so the next time.
RESTORE_ATTEMPTS = 2

# Every probing move may shift the frame by a part of a microstep; what adds
# up to less than this (mm) is neither homing nor levelling.
DATUM_NOISE = 0.02

# What is saved is rounded to that (mm).
SAVED_DIGIT = 0.000001

# A trigger this close (mm) to the start is none: the sensor was pressed.
# Less than any microstep is long, more than rounding.
NO_TRAVEL = 0.0001


######################################################################
# Records and maths
######################################################################


# --- shared: errors ---
# A condition that ends the run; section 5 shows it to the user.
class CalibrationError(Exception):
    pass


# A touch that went down to its floor without a trigger.
class NoTrigger(CalibrationError):
    pass


# No series of samples agreed.
class SamplesDiffer(CalibrationError):
    pass


# --- end ---


# --- shared: sampling ---
# How heights are sampled: count, mm, count, "median" or "average", mm/s, mm,
# mm/s.
Sampling = collections.namedtuple(
    "Sampling", "samples tolerance retries result speed retract_dist lift_speed"
)
# --- end ---

# A place of the head (mm), and where the user has said so.
Site = collections.namedtuple("Site", "x y origin")

# The parts and the outcome of one measurement (mm); see the header.
Result = collections.namedtuple(
    "Result", "sensor probe probe_z_offset z_offset correction"
)

# Where the sensor should trigger: toolhead Z (mm, None: no idea), and between
# which heights a trigger is believed.
Expected = collections.namedtuple("Expected", "z low high")

IF_CHANGED = "ACCEPT_CHANGE=1 if nozzle, probe or bed was changed"

# Lowest toolhead Z (mm) of a touch, and who says so.
Floor = collections.namedtuple("Floor", "z why")

# What the user configured: mm, mm/s and mm/s^2.  'bed' is None for the middle
# of the axes.
Settings = collections.namedtuple(
    "Settings",
    "bed z_offset probe_hop probe_accel floor offset_samples sampling"
    " current_factor",
)


# Parsers: text of an option or a parameter to its value.


# --- shared: parsers ---
# No length, speed or acceleration of a printer is larger (mm, mm/s, mm/s^2),
# and nobody waits for more touches.  What is, would fail in a print.
LARGEST_NUMBER = 100000.0
LARGEST_COUNT = 1000


def parse_number(text):
    try:
        value = float(text)
    except ValueError:
        raise CalibrationError("'%s' is not a number" % (text,))
    if math.isnan(value) or math.isinf(value):
        raise CalibrationError("'%s' is not a finite number" % (text,))
    # Python 3 takes 1_0 and the digits of all scripts
    if not re.match(r"[-+.eE0-9\s]+$", text):
        raise CalibrationError("'%s' is not a number" % (text,))
    if abs(value) > LARGEST_NUMBER:
        raise CalibrationError(
            "'%s' is larger than %g" % (text, LARGEST_NUMBER)
        )
    return value


def parse_not_negative(text):
    value = parse_number(text)
    if value < 0.0:
        raise CalibrationError("'%s' is negative" % (text,))
    return value


def parse_positive(text):
    value = parse_number(text)
    if value <= 0.0:
        raise CalibrationError("'%s' is not above zero" % (text,))
    return value


def parse_count(text, smallest):
    if not re.match(r"\s*[-+]?[0-9]+\s*$", text):
        raise CalibrationError("'%s' is not a whole number" % (text,))
    value = int(text)
    if value < smallest:
        raise CalibrationError("'%s' is less than %d" % (text, smallest))
    if value > LARGEST_COUNT:
        raise CalibrationError("'%s' is more than %d" % (text, LARGEST_COUNT))
    return value


# "x, y" -> (x, y)
def parse_pair(text):
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise CalibrationError("'%s' is not a pair of numbers" % (text,))
    return parse_number(parts[0]), parse_number(parts[1])


def parse_result(text):
    if text not in ("median", "average"):
        raise CalibrationError("'%s' is not known" % (text,))
    return text


def parse_switch(text):
    words = {"true": True, "yes": True, "on": True, "1": True}
    words.update({"false": False, "no": False, "off": False, "0": False})
    if text.lower() not in words:
        raise CalibrationError("'%s' is neither true nor false" % (text,))
    return words[text.lower()]


# --- end ---


def parse_between(text, low, high):
    value = parse_number(text)
    if not low <= value <= high:
        raise CalibrationError("'%s' is not from %g to %g" % (text, low, high))
    return value


def parse_hop(text):
    value = parse_number(text)
    if value < SMALLEST_HOP:
        raise CalibrationError("'%s' is less than %g" % (text, SMALLEST_HOP))
    return value


def parse_result_word(text):
    return parse_result(text.lower())


# Sampling


# --- shared: summary ---
def summarize(samples, method):
    ordered = sorted(samples)
    middle = len(ordered) // 2
    if method == "average":
        return math.fsum(ordered) / len(ordered)
    if len(ordered) % 2:
        return ordered[middle]
    return (ordered[middle - 1] + ordered[middle]) / 2.0


# --- end ---


# What to do about samples that differ
DIFFER = (
    "clean the nozzle, check that nothing shakes the bed, and see"
    " prepare_gcode and probe_accel; a sensor that triggers late does this, too"
)


# --- shared: collecting ---
# Call touch(), which returns a height, until the wanted number of samples
# agrees.  A sample that does not agree starts the series again.
def collect(touch, sampling, say):
    retries_left = sampling.retries
    samples = []
    while len(samples) < sampling.samples:
        samples.append(touch())
        spread = max(samples) - min(samples)
        if spread <= sampling.tolerance:
            continue
        text = "samples differ by %.4f mm, samples_tolerance is %.4f mm; %s"
        if not retries_left:
            raise SamplesDiffer(text % (spread, sampling.tolerance, DIFFER))
        say(text % (spread, sampling.tolerance, "trying again"))
        retries_left -= 1
        samples = []
    return samples


# --- end ---


# Correction


def correction(sensor, probe, probe_z_offset, z_offset):
    return sensor - (probe - probe_z_offset) + z_offset


def check_correction(z):
    if abs(z) > LARGEST_OFFSET:
        raise CalibrationError(
            "a correction of %.3f mm is none, %g mm is the limit; check"
            " z_offset, and home Z again (G28)" % (z, LARGEST_OFFSET)
        )


NOTHING_EXPECTED = Expected(None, float("-inf"), float("inf"))


def expect_near(z, margin):
    return Expected(z, z - margin, z + margin)


# The sensor's trigger that a correction stands for, where Z was homed with
# the probe.
def expect_corrected(correction, z_offset, bed_z):
    return expect_near(bed_z + correction - z_offset, KNOWN_MARGIN)


# All that is known without one: the probe triggers above the bed.
def expect_below_probe(probe_z):
    return NOTHING_EXPECTED._replace(high=probe_z + ABOVE_PROBE)


# The same after a touch at z; of several the lowest counts: what triggers
# higher up was shaken.
def expect_again(z, before, sampling):
    if before is not None:
        z = min(z, before)
    return expect_near(z, TOUCH_MARGIN + sampling.tolerance)


# The speed (mm/s) from which the head can stop within KNOWN_MARGIN: a touch
# must not need more room below the bed than that.
def fastest_touch(speed, accel):
    room = KNOWN_MARGIN - BRAKING_RESERVE
    return min(speed, math.sqrt(2.0 * accel * room))


# The head needs room (mm) to stop at the floor: where the trigger is expected
# it has its full speed still, as in every other touch.
def sensor_floor(floor, expected, speed, accel):
    if expected.z is None:
        return floor
    braking = speed * speed / (2.0 * accel)
    low = min(expected.low, expected.z - braking - BRAKING_RESERVE)
    if low <= floor.z:
        return floor
    why = "%.3f mm below the expected trigger at z=%.3f"
    return Floor(low, why % (expected.z - low, expected.z))


def check_expected(z, expected):
    if z <= expected.high:
        return
    where = "which is above z=%.3f, the highest that the probe leaves for it"
    where %= (expected.high,)
    if expected.z is not None:
        where = "%.3f mm above the expected z=%.3f"
        where %= (z - expected.z, expected.z)
    raise CalibrationError(
        "triggered at z=%.3f, %s; clean the nozzle and the bed, see"
        " prepare_gcode and probe_accel, or add %s" % (z, where, IF_CHANGED)
    )


# Travel height (mm) before the bed was touched: where the probe does not
# trigger, wherever it says that the bed is.
def travel_height(probe_z, probe_hop):
    return max(probe_z, 0.0) + probe_hop


# What a z_offset below zero means, in plain words; empty: it is not.
def inside_bed(z_offset):
    if z_offset >= 0.0:
        return ""
    return (
        "z_offset %.3f: at Z=0 the nozzle is %.3f mm inside the bed, below"
        " where the bed sensor triggers; for an air gap write it without the"
        " minus sign" % (z_offset, -z_offset)
    )


# The same where the trigger itself became z_offset (AUTO_Z_HOME_Z)
def inside_bed_after_homing(z_offset):
    if z_offset <= 0.0:
        return ""
    return (
        "Z is %.3f where the bed sensor triggers: at Z=0 the nozzle is %.3f mm"
        " inside the bed; home with G28 and use AUTO_Z_LOAD_OFFSET to print"
        % (z_offset, z_offset)
    )


######################################################################
# Host
######################################################################

# The section that configures the Z axis, and its options that matter here.
ZAxis = collections.namedtuple(
    "ZAxis", "section endstop_pin position_min position_endstop max_accel"
)


# --- shared: z section ---
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


# --- end ---


# Read with the defaults that every host documents; note_valid=False leaves
# it to the host to claim these options.
def read_z_axis(config):
    section = find_z_section(config)
    if section is None:
        printer = config.getsection("printer")
        raise config.error(
            "Option 'kinematics: %s' in section 'printer' has no Z axis of its"
            " own; auto_z_offset cannot be used on this machine, remove"
            " section 'auto_z_offset'"
            % (printer.get("kinematics", "none", note_valid=False),)
        )
    axis = ZAxis(
        section=section.get_name(),
        endstop_pin=section.get("endstop_pin", "", note_valid=False),
        position_min=section.getfloat("position_min", 0.0, note_valid=False),
        position_endstop=section.getfloat(
            "position_endstop", None, note_valid=False
        ),
        max_accel=config.getsection("printer").getfloat(
            "max_z_accel", float("inf"), note_valid=False
        ),
    )
    if chip_of(axis.endstop_pin) == NAME:
        raise config.error(
            "Option 'endstop_pin: %s' in section '%s': auto_z_offset is no"
            " endstop any more; set it to probe:z_virtual_endstop"
            % (axis.endstop_pin, axis.section)
        )
    return axis


# --- shared: endstops ---
# What probing_move() and a state query need from an endstop object.
ENDSTOP_METHODS = ("get_steppers", "home_start", "home_wait", "query_endstop")


def is_endstop(candidate):
    methods = [getattr(candidate, name, None) for name in ENDSTOP_METHODS]
    return all(callable(m) for m in methods) and bool(candidate.get_steppers())


def bare_pin(pin):
    pin = pin.replace(" ", "").lstrip("^~!")
    return pin[len("mcu:") :] if pin.startswith("mcu:") else pin


# --- end ---


def chip_of(pin):
    return pin.strip("^~! ").split(":")[0].strip() if ":" in pin else "mcu"


# Sections that make the object 'probe', and their option for the pin
PROBE_PINS = (
    ("probe", "pin"),
    ("smart_effector", "pin"),
    ("bltouch", "sensor_pin"),
)


# Everything the module wants from the printer.  The only place that knows in
# which respects hosts differ; the difference is always asked of the object,
# never of a version number.
class Host(object):
    def __init__(self, config):
        self.printer = config.get_printer()
        self.gcode = self.printer.lookup_object("gcode")
        self.query_endstops = self.printer.load_object(config, "query_endstops")
        self.z_axis = read_z_axis(config)
        # A host that homes Z with the probe believes what the probe says
        self.homes_with_probe = chip_of(self.z_axis.endstop_pin) == "probe"
        self.pin = self._read_pin(config)
        self.sensor = self._make_sensor()
        # The others exist from klippy:connect on.
        self.toolhead = self.probe = None
        self.motors = []
        # Z motors whose current stays
        self.left_alone = []

    def connect(self):
        self.toolhead = self.printer.lookup_object("toolhead")
        self.probe = self._find_probe()
        self.motors = self._find_motors()
        reduced = [name for name, unused in self.motors]
        self.left_alone = [
            s.get_name()
            for s in self._z_steppers(self.toolhead)
            if s.get_name().split()[-1] not in reduced
        ]

    # Bed sensor
    def _read_pin(self, config):
        pin = config.get("pin", None)
        remedy = "give the pin of the bed sensor, as in 'pin: U_1:PC1'"
        if pin is None:
            raise config.error(
                "Option 'pin' in section '%s' is missing; %s"
                % (config.get_name(), remedy)
            )
        if not pin.strip("^~! ") or chip_of(pin) in ("probe", NAME):
            raise config.error(
                "Option 'pin: %s' in section '%s' is no pin; %s"
                % (pin, config.get_name(), remedy)
            )
        for section, option in PROBE_PINS:
            if not config.has_section(section):
                continue
            options = config.getsection(section)
            other = options.get(option, "", note_valid=False)
            if bare_pin(other) == bare_pin(pin):
                raise config.error(
                    "Option 'pin: %s' in section '%s' is the pin of section"
                    " '%s'; %s" % (pin, config.get_name(), section, remedy)
                )
        return pin

    def _make_sensor(self):
        pins = self.printer.lookup_object("pins")
        try:
            sensor = pins.setup_pin("endstop", self.pin)
        except pins.error as e:
            raise self.printer.config_error(
                "Option 'pin: %s' in section 'auto_z_offset': %s"
                % (self.pin, e)
            )
        self.query_endstops.register_endstop(sensor, NAME)
        self.printer.register_event_handler(
            "klippy:mcu_identify", self._add_z_steppers
        )
        return sensor

    def _add_z_steppers(self):
        # Steppers exist since the toolhead was loaded, just before this event
        toolhead = self.printer.lookup_object("toolhead")
        for stepper in self._z_steppers(toolhead):
            self.sensor.add_stepper(stepper)

    # --- shared: z steppers ---
    def _z_steppers(self, toolhead):
        steppers = toolhead.get_kinematics().get_steppers()
        return [s for s in steppers if s.is_active_axis("z")]

    # --- end ---

    def sensor_triggered(self, print_time):
        return bool(self.sensor.query_endstop(print_time))

    # Probe
    def _find_probe(self):
        probe = self.printer.lookup_object("probe", None)
        if probe is None:
            raise self.printer.config_error(
                "Section 'probe' is missing: auto_z_offset corrects the"
                " inductive probe that Z is homed with"
            )
        self.probe = probe
        if not self._can_be_limited() and not self._is_plain_switch():
            raise self.printer.config_error(
                "Section 'probe' (%s): this probe cannot be told how far down"
                " to look, a missing trigger would drive the nozzle into the"
                " bed; auto_z_offset needs a [probe], [smart_effector] or"
                " [bltouch], or remove section 'auto_z_offset'"
                % (probe.__class__.__name__,)
            )
        return probe

    def _can_be_limited(self):
        floors = self._probe_floors()
        return any(hasattr(owner, name) for owner, name in floors)

    # One that may be touched without the host's own procedure
    def _is_plain_switch(self):
        lookup = functools.partial(self.printer.lookup_object, default=None)
        special = [lookup(name) for name in ("bltouch", "smart_effector")]
        return special == [None, None] and self.probe_endstop() is not None

    # --- shared: probe endstop ---
    def _endstop_of(self, probe):
        # 'mcu_probe' is an endstop itself (moving it runs activate_gcode)
        # until 2026-05-25 (43baf9b83); since then the endstop is inside it.
        # Looked up at each use: QIDI's hosts exchange its methods at run time.
        outer = getattr(probe, "mcu_probe", None)
        for candidate in (outer, getattr(outer, "mcu_endstop", None)):
            if is_endstop(candidate):
                return candidate
        return None

    def probe_endstop(self):
        return self._endstop_of(self.probe)

    def probe_offsets(self):
        return self.probe.get_offsets()

    # --- end ---

    # --- shared: probing ---
    # Gives a function that probes once, with the probe's own activation, and
    # returns the toolhead Z of the trigger.  'params' as PROBE takes them.
    @contextlib.contextmanager
    def probe_session(self, **params):
        # One by one: what is wanted of several is looked at between them
        params["SAMPLES"] = "1"
        gcmd = self.gcode.create_gcode_command("", "", params)
        if hasattr(self.probe, "start_probe_session"):
            # Since 2024-06-10 (bec47e049)
            session = self.probe.start_probe_session(gcmd)
            end = session.end_probe_session
        else:
            session = self.probe
            session.multi_probe_begin()
            end = session.multi_probe_end
        # An error inside activate_gcode makes the host end the session by
        # itself; ending it again is then an error that must not be shown.
        with self.always(end, "ending the probe session"):
            yield functools.partial(self._probe_once, session, gcmd)

    def _probe_once(self, session, gcmd):
        start_z = self.z()
        try:
            self._require_running()
            result = session.run_probe(gcmd)
            if hasattr(session, "pull_probed_results"):
                # Since 2024-06-14 (1591a51f7)
                result = session.pull_probed_results()[-1]
        except self.printer.command_error as e:
            self._pass_on_shutdown(e)
            text = "%s (stopped at z=%.3f); check with QUERY_PROBE and PROBE"
            raise CalibrationError(text % (e, self.z()))
        # QIDI's hosts answer a probe that is pressed already with a result
        self._check_travel(start_z, self.z())
        if hasattr(result, "bed_z"):
            # A record since 2026-01-21 (2a1027ce4).  Not its test_z: the
            # position of earlier hosts has twist compensation in it, too.
            return result.bed_z + self.probe.get_offsets()[2]
        return result[2]

    # While this lasts the host's own probing ends at 'floor', not at the
    # position_min it has read from the configuration.  Yields whether this
    # host could be told.
    @contextlib.contextmanager
    def probe_floor(self, floor):
        for owner, name in self._probe_floors():
            if not hasattr(owner, name):
                continue
            before = getattr(owner, name)
            setattr(owner, name, floor)
            try:
                yield True
            finally:
                setattr(owner, name, before)
            return
        yield False

    # Public attributes, but nobody offers a method: where each host keeps
    # the lower end of its probing move.
    def _probe_floors(self):
        probe = self.probe
        session = getattr(probe, "probe_session", None)
        device = getattr(probe, "mcu_probe", None)
        inner = getattr(device, "probe_wrapper", None)
        return (
            # Since 2026-05-25 (43baf9b83); 'inner' of a smart_effector
            (getattr(device, "homing_helper", None), "z_min_position"),
            (getattr(inner, "homing_helper", None), "z_min_position"),
            # Since 2025-04-18 (1f5783a25; its parent f3a1c914a)
            (getattr(probe, "homing_helper", None), "z_min_position"),
            (getattr(session, "homing_helper", None), "z_min_position"),
            # Since 2024-06-10 (6ea5b94d1)
            (session, "z_position"),
            # Before, Kalico, QIDI
            (probe, "z_position"),
        )

    # --- end ---

    # Z motors: those that move nothing else and whose TMC driver tells its
    # current, as (name for SET_TMC_CURRENT, driver).
    def _find_motors(self):
        pure = [
            s.get_name()
            for s in self._z_steppers(self.toolhead)
            if not any(s.is_active_axis(axis) for axis in "xy")
        ]
        return [
            (name.split()[-1], driver)
            for name, driver in self.printer.lookup_objects()
            if name.startswith("tmc")
            and name.partition(" ")[2] in pure
            and self._may_be_reduced(name.split()[-1], driver)
        ]

    def _may_be_reduced(self, name, driver):
        key, handlers = self.gcode.mux_commands.get("SET_TMC_CURRENT", ("", ()))
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
        return "run_current" in driver.get_status(self._eventtime())

    def _eventtime(self):
        return self.printer.get_reactor().monotonic()

    # Less current while a touch lasts; afterwards what it was before.
    @contextlib.contextmanager
    def reduced_current(self, factor):
        motors = self.motors if factor < 1.0 else []
        found = [
            (name, driver.get_status(self._eventtime())["run_current"])
            for name, driver in motors
        ]
        changes = [(name, now, now * factor) for name, now in found]
        restore = functools.partial(self._restore_currents, changes)
        with self.always(restore, "restoring the motor current"):
            for name, _, reduced in changes:
                self._set_current(name, reduced)
            self._settle(changes)
            yield

    def _restore_currents(self, changes):
        errors = [self._restore_current(*change) for change in changes]
        errors = [error for error in errors if error is not None]
        if errors:
            raise errors[0]
        self._settle(changes)

    # Returns the error that stayed
    def _restore_current(self, name, current, reduced):
        try:
            self._set_current(name, current)
            return None
        except self.printer.command_error as e:
            error = e
        for _ in range(RESTORE_ATTEMPTS):
            try:
                # Hosts write only what differs from what they wrote last,
                # and count a write that failed as done
                self._set_current(name, reduced)
            except self.printer.command_error:
                logging.info("%s: current of %s: trying again", NAME, name)
            try:
                self._set_current(name, current)
                return None
            except self.printer.command_error as e:
                error = e
        # Said here, as an earlier error comes before this one
        text = (
            "%s: the current of %s could not be set back: %s; run"
            " SET_TMC_CURRENT STEPPER=%s CURRENT=%.3f or FIRMWARE_RESTART"
            % (NAME, name, error, name, current)
        )
        self.gcode.respond_info(text)
        return self.printer.command_error(text)

    def _settle(self, changed):
        if changed:
            self.toolhead.dwell(SETTLE_TIME)

    # The handler of SET_TMC_CURRENT, called without its line on the console:
    # four of them for every touch would hide the results.
    def _set_current(self, name, current):
        command = "SET_TMC_CURRENT"
        key, handlers = self.gcode.mux_commands[command]
        params = {key: name, "CURRENT": "%.6f" % (current,)}
        line = "%s %s=%s CURRENT=%s" % (command, key, name, params["CURRENT"])
        gcmd = self.gcode.create_gcode_command(command, line, params)
        gcmd.respond_info = lambda *unused, **unused_too: None
        handlers[name](gcmd)

    # With what (mm/s^2) the head brakes in Z if 'accel' limits it, too
    def braking_accel(self, accel):
        limits = [self.toolhead_status()["max_accel"], self.z_axis.max_accel]
        if accel:
            limits.append(accel)
        return min(limits)

    # Somebody else measures; its next step starts where it left the head
    def check_manual_probe(self):
        manual = self.printer.lookup_object("manual_probe", None)
        if manual is not None and manual.get_status(None)["is_active"]:
            raise CalibrationError(
                "a manual probe is under way; end it with ACCEPT or ABORT first"
            )

    # Where the probe sees the bed once Z was homed with it: at 0, except where
    # position_endstop counts.  Until 2024-07-04 (34732f857) and on Kalico Z is
    # homed to that with a smart_effector; elsewhere hosts do not accept it.
    def homed_bed_z(self):
        homed_z = self.z_axis.position_endstop
        if homed_z is None or not self.homes_with_probe:
            return 0.0
        return homed_z - self.probe_offsets()[2]

    # and where it triggers
    def homed_probe_z(self):
        return self.homed_bed_z() + self.probe_offsets()[2]

    # The same for max_accel (mm/s^2); 0: as it is
    @contextlib.contextmanager
    def limited_accel(self, accel):
        found = self.toolhead_status()["max_accel"]
        if not 0.0 < accel < found:
            yield
            return
        restore = functools.partial(self._set_accel, found)
        with self.always(restore, "restoring the acceleration"):
            self._set_accel(accel)
            yield

    def _set_accel(self, accel):
        script = "SET_VELOCITY_LIMIT ACCEL=%.6f" % (accel,)
        self.gcode.run_script_from_command(script)

    # --- shared: waiting ---
    # The end of the last queued move
    def after_moves(self):
        eventtime = self.printer.get_reactor().monotonic()
        print_time, now, is_empty = self.toolhead.check_busy(eventtime)
        if is_empty and print_time <= now:
            return now
        return self.toolhead.get_last_move_time()

    # --- end ---

    # --- shared: state ---
    # Where the motors of Z stand, apart from where the host believes Z is:
    # the difference (mm) changes only when Z is homed, set or levelled.
    # Empty where X or Y share these motors.
    def z_datum(self):
        steppers = self._z_steppers(self.toolhead)
        if any(s.is_active_axis(axis) for s in steppers for axis in "xy"):
            return []
        return [
            s.get_mcu_position() * s.get_step_dist()
            - s.get_commanded_position()
            for s in steppers
        ]

    # State and motion
    def toolhead_status(self):
        return self.toolhead.get_status(self.printer.get_reactor().monotonic())

    def axis_limits(self):
        status = self.toolhead_status()
        return list(zip(status["axis_minimum"], status["axis_maximum"]))[:3]

    def is_homed(self, axis):
        return axis in self.toolhead_status()["homed_axes"]

    def check_homed(self):
        missing = [axis.upper() for axis in "xyz" if not self.is_homed(axis)]
        if missing:
            raise CalibrationError(
                "not homed: %s; home all axes (G28) first"
                % (", ".join(missing),)
            )

    # The G-code Z offset (mm)
    def gcode_offset(self):
        eventtime = self.printer.get_reactor().monotonic()
        gcode_move = self.printer.lookup_object("gcode_move")
        return gcode_move.get_status(eventtime)["homing_origin"][2]

    # --- end ---

    # --- shared: offset ---
    # Absolute, so that it replaces any earlier offset.  The command's own
    # method: a macro of that name may add to it, store it or move.
    def set_gcode_offset(self, z_offset):
        params = {"Z": "%.6f" % (z_offset,), "MOVE": "0"}
        line = "SET_GCODE_OFFSET Z=%s MOVE=0" % (params["Z"],)
        gcmd = self.gcode.create_gcode_command("SET_GCODE_OFFSET", line, params)
        self.printer.lookup_object("gcode_move").cmd_SET_GCODE_OFFSET(gcmd)

    # --- end ---

    # As a user would: a macro of that name takes part
    def apply_offset(self, z_offset):
        script = "SET_GCODE_OFFSET Z=%.6f MOVE=0" % (z_offset,)
        self.gcode.run_script_from_command(script)

    # G90 or G91 of the user's G-code
    def is_absolute(self):
        gcode_move = self.printer.lookup_object("gcode_move")
        return gcode_move.get_status(self._eventtime())["absolute_coordinates"]

    def set_absolute(self, absolute):
        if self.is_absolute() != absolute:
            self.gcode.run_script_from_command("G90" if absolute else "G91")

    def save_option(self, option, value):
        config = self.printer.lookup_object("configfile")
        config.set(NAME, option, "%.6f" % (value,))

    # Z was homed before, so no axis has to be named, which hosts differ in
    def set_z(self, z):
        position = self.toolhead.get_position()
        position[2] = z
        self.toolhead.set_position(position)

    # --- shared: moving ---
    def z(self):
        return self.toolhead.get_position()[2]

    def raise_to(self, z, speed):
        if self.z() < z:
            self.toolhead.manual_move([None, None, z], speed)

    def move_xy(self, x, y, speed):
        if tuple(self.toolhead.get_position()[:2]) != (x, y):
            self.toolhead.manual_move([x, y], speed)

    # The end of the printer is nothing that a hint of ours would mend
    def _pass_on_shutdown(self, error):
        if self.printer.is_shutdown():
            raise error

    # A probing move first waits for the moves before it, and hosts may wait for
    # ever for its trigger where the printer was shut down meanwhile; whoever
    # sends FIRMWARE_RESTART then waits with them.  So wait here, and look.
    def _require_running(self):
        self.toolhead.flush_step_generation()
        if self.printer.is_shutdown():
            raise self.printer.command_error(
                "Touch not begun due to printer shutdown"
            )

    def _probing_move(self, endstop, z, speed):
        self._require_running()
        target = self.toolhead.get_position()
        target[2] = z
        # A method of the host since 2021-03-29 (862d3f963)
        homing = self.printer.lookup_object("homing")
        return homing.probing_move(endstop, target, speed)[2]

    # --- end ---

    # --- shared: touching ---
    # Move down until the endstop triggers; returns the toolhead Z of the
    # trigger.  The head stops a little lower and stays there.
    def touch(self, endstop, floor, speed):
        self.check_above(floor)
        start_z = self.z()
        try:
            trigger_z = self._probing_move(endstop, floor, speed)
        except self.printer.command_error as e:
            self._pass_on_shutdown(e)
            kind = NoTrigger if self.is_at(floor) else CalibrationError
            raise kind("%s (stopped at z=%.3f)" % (e, self.z()))
        self._check_travel(start_z, trigger_z)
        return trigger_z

    # --- end ---

    # A touch goes down, whatever it is told
    def check_above(self, floor):
        if self.z() <= floor:
            raise CalibrationError(
                "the head is at z=%.3f, this touch ends at z=%.3f already;"
                " check probe_z_min, and that prepare_gcode leaves the head"
                " above the bed" % (self.z(), floor)
            )

    # --- shared: after touching ---
    # Motors stop on whole steps, so not exactly there
    def is_at(self, z):
        steppers = self._z_steppers(self.toolhead)
        return abs(self.z() - z) <= 2.0 * max(
            s.get_step_dist() for s in steppers
        )

    def _check_travel(self, start_z, trigger_z):
        if start_z - trigger_z <= NO_TRAVEL:
            raise CalibrationError(
                "triggered at z=%.3f before the head moved: the sensor was"
                " pressed or is not attached" % (start_z,)
            )

    # Run 'action' when the block is left, on every path.  Its own error
    # counts only if there is no earlier one.
    @contextlib.contextmanager
    def always(self, action, what):
        failed = True
        try:
            yield
            failed = False
        finally:
            try:
                if not self.printer.is_shutdown():
                    action()
            except self.printer.command_error:
                if not failed:
                    raise
                logging.exception("%s: %s failed, too", NAME, what)
            except Exception as e:
                # Of the host, such as moving after a board was lost: the
                # printer has to end, but the first error is what is told
                if not failed:
                    raise
                logging.exception("%s: %s failed, too", NAME, what)
                text = "%s: %s failed after another error: %s"
                self.printer.invoke_shutdown(text % (NAME, what, e))

    # --- end ---


# --- shared: frame ---
HOMED_OR_SET = "Z was homed again or set"
LEVELLED = "the Z motors were levelled"


# What moved the frame that heights are measured in, since a mark was set.
class Frame(object):
    def __init__(self, host):
        self.host = host
        self.count = 0
        self.latest = ""
        # Of the last time Z was set
        self.datum = []
        register = host.printer.register_event_handler
        register("toolhead:set_position", self._set)
        register("homing:home_rails_end", self._homed)
        register("stepper_enable:motor_off", self._off)

    def mark(self):
        return self.count, self.host.z_datum()

    # Empty: nothing did
    def moved_since(self, mark):
        count, datum = mark
        motors = self._motors(datum)
        if count == self.count or motors == LEVELLED:
            return motors
        return self.latest

    # Homing sets Z somewhere else at first, on every host; it may come back
    # to where it was.
    def _set(self):
        if self.host.toolhead is None:
            return
        before, self.datum = self.datum, self.host.z_datum()
        if self._motors(before) == HOMED_OR_SET:
            self._note(HOMED_OR_SET)

    # Not sent where Z is homed with the probe since 2026-05-25 (5cbebdc3c)
    def _homed(self, homing_state, rails):
        if 2 in homing_state.get_axes():
            self._note("Z was homed again")

    # With a print time until 2026; nobody needs it
    def _off(self, *unused):
        self._note("the motors were turned off")

    def _note(self, what):
        self.count += 1
        self.latest = what

    def _motors(self, datum):
        shifts = [a - b for a, b in zip(self.host.z_datum(), datum)]
        if not shifts or max(map(abs, shifts)) <= DATUM_NOISE:
            return ""
        if max(shifts) - min(shifts) > DATUM_NOISE:
            return LEVELLED
        return HOMED_OR_SET


# --- end ---


######################################################################
# Measuring
######################################################################


# The nozzle on the bed, where the head is.  'watch' is told of every touch.
class SensorMeasurement(object):
    def __init__(self, host, settings, watch, expected, touched_z):
        self.host = host
        self.settings = settings
        self.watch = watch
        # What is known of the bed; the lowest trigger at this place, or None
        self.expected = expected
        self.touched_z = touched_z
        # Where the last touch triggered; None: the head was lifted since
        self.pressed_z = None

    # Returns the height: toolhead Z in mm
    def measure(self):
        sampling = self.settings.sampling
        try:
            samples = collect(self.sample, sampling, self.report)
        except CalibrationError as e:
            raise CalibrationError("bed sensor: %s" % (e,))
        return summarize(samples, sampling.result)

    # Up again.  A sensor that stays triggered has not seen the bed.
    def leave(self, travel_z):
        self.pressed_z = None
        self.host.raise_to(travel_z, self.settings.sampling.lift_speed)
        try:
            self.check_open()
        except CalibrationError as e:
            raise CalibrationError("bed sensor: %s" % (e,))

    # A trigger far above the bed is none: shaking makes them.
    def sample(self):
        retries_left = self.settings.sampling.retries
        while True:
            z = self.pressed_z = self.touch_again()
            try:
                check_expected(z, self.expected)
                break
            except CalibrationError as e:
                if not retries_left:
                    raise
                self.report("%s; trying again" % (e,))
                retries_left -= 1
        self.expected = expect_again(z, self.touched_z, self.settings.sampling)
        self.touched_z = self.expected.z
        self.watch.touched()
        self.report("triggered at z=%.6f" % (z,))
        return z

    def touch_again(self):
        self.retract()
        self.check_open()
        return self.touch()

    def retract(self):
        if self.pressed_z is None:
            return
        sampling = self.settings.sampling
        top = self.pressed_z + sampling.retract_dist
        self.host.raise_to(top, sampling.lift_speed)
        self.pressed_z = None

    # The current is low only while the nozzle goes down: a motor that loses
    # a step on the way up would take Z along.
    def touch(self):
        host, settings = self.host, self.settings
        accel = host.braking_accel(settings.probe_accel)
        speed = fastest_touch(settings.sampling.speed, accel)
        floor = sensor_floor(settings.floor, self.expected, speed, accel)
        less_accel = host.limited_accel(settings.probe_accel)
        start_z = host.z()
        try:
            with less_accel, host.reduced_current(settings.current_factor):
                return host.touch(host.sensor, floor.z, speed)
        except NoTrigger as e:
            raise NoTrigger(
                "%s; check that prepare_gcode turns the sensor on, that 'pin:"
                " %s' is the sensor's (QUERY_ENDSTOPS while you press the bed),"
                " and that the bed is not below the floor of this touch, which"
                " is %s" % (e, host.pin, self.reason(floor))
            )
        except CalibrationError:
            if host.is_at(start_z):
                self.check_open()
            raise

    def reason(self, floor):
        if floor == self.settings.floor:
            return floor.why
        return "%s; add %s" % (floor.why, IF_CHANGED)

    def check_open(self):
        if self.host.sensor_triggered(self.host.after_moves()):
            raise CalibrationError(
                "reads triggered at z=%.3f, where nothing should press it;"
                " check prepare_gcode, and 'pin: %s' with QUERY_ENDSTOPS (a '!'"
                " in front of it turns the meaning)"
                % (self.host.z(), self.host.pin)
            )

    def report(self, msg):
        self.watch.say("bed sensor: %s" % (msg,))


# The inductive probe over the same point of the bed, through the host's own
# probing, told where to end.
class ProbeMeasurement(object):
    def __init__(self, host, settings, watch, site):
        self.host = host
        self.settings = settings
        self.watch = watch
        self.site = site
        self.pressed_z = None

    # 'floor' is the height at which the nozzle meets the bed: an inductive
    # probe triggers above it.  Returns toolhead Z in mm.
    def measure(self, floor):
        sampling = self.settings.sampling
        try:
            samples = self.collect(floor)
        except CalibrationError as e:
            raise CalibrationError("probe: %s" % (e,))
        return summarize(samples, sampling.result)

    # One that goes down to the bed is dead, or that was not the bed
    def touch(self, touch, floor):
        try:
            return touch()
        except CalibrationError as e:
            if not self.host.is_at(floor):
                raise
            raise NoTrigger(
                "%s; it ends where the bed sensor triggered, z=%.3f: that was"
                " not the bed, or the probe does not see it" % (e, floor)
            )

    def collect(self, floor):
        host, sampling = self.host, self.settings.sampling
        host.move_xy(self.site.x, self.site.y, TRAVEL_SPEED)
        top = host.z()
        session = host.probe_session(PROBE_SPEED="%.6f" % (sampling.speed,))
        limit = host.probe_floor(floor)
        # Up before the session ends: the host may stow the probe then
        lift = host.always(
            functools.partial(host.raise_to, top, sampling.lift_speed),
            "lifting",
        )
        with session as probe_once, limit as limited, lift:
            touch = probe_once if limited else self.own_touch(floor)
            sample = functools.partial(self.sample, touch, floor)
            return collect(sample, sampling, self.report)

    # A host unknown to us: its probing would go on to position_min
    def own_touch(self, floor):
        host, speed = self.host, self.settings.sampling.speed
        return functools.partial(host.touch, host.probe_endstop(), floor, speed)

    def sample(self, touch, floor):
        if self.pressed_z is not None:
            sampling = self.settings.sampling
            top = self.pressed_z + sampling.retract_dist
            self.host.raise_to(top, sampling.lift_speed)
        self.host.check_above(floor)
        self.pressed_z = self.touch(touch, floor)
        self.watch.touched()
        self.report("triggered at z=%.6f" % (self.pressed_z,))
        return self.pressed_z

    def report(self, msg):
        self.watch.say("probe: %s" % (msg,))


# One command: goes to the bed, prepares the sensor, measures, lifts.
# 'prepare' runs the user's G-code; 'expect' says what is known of the bed then.
class Run(object):
    def __init__(self, host, settings, watch, prepare, expect):
        self.host = host
        self.settings = settings
        self.watch = watch
        self.run_prepare = prepare
        self.expect = expect
        # They follow what the run learns, as the height the head is lifted to:
        # what is known of the bed, its lowest trigger, its last height
        self.expected = NOTHING_EXPECTED
        self.touched_z = self.sensor_z = None
        probe_z = host.homed_probe_z()
        self.travel_z = travel_height(probe_z, settings.probe_hop)

    def lift(self):
        if self.host.is_homed("z"):
            lift_speed = self.settings.sampling.lift_speed
            self.host.raise_to(self.travel_z, lift_speed)

    def go_to(self, site):
        self.lift()
        self.host.move_xy(site.x, site.y, TRAVEL_SPEED)

    # The user's G-code may have moved the head.
    def prepare(self, site):
        self.go_to(site)
        self.watch.enter("prepare_gcode")
        self.run_prepare()
        self.host.check_homed()
        # It may have homed, too
        self.expected = self.expect()
        self.go_to(site)

    # Toolhead Z (mm) of the bed sensor's trigger, where the head is.  The
    # head has left the bed then.
    def measure_sensor(self):
        self.watch.enter("bed sensor")
        sensor = SensorMeasurement(
            self.host,
            self.settings,
            self.watch,
            self.expected,
            self.touched_z,
        )
        z = self.sensor_z = sensor.measure()
        self.expected, self.touched_z = sensor.expected, sensor.touched_z
        self.travel_z = z + self.settings.probe_hop
        sensor.leave(self.travel_z)
        return z

    # Both sensors over one point
    def measure(self, bed, probe_site):
        settings = self.settings
        self.go_to(bed)
        sensor_z = self.measure_sensor()
        self.watch.enter("probe")
        probe = ProbeMeasurement(self.host, settings, self.watch, probe_site)
        probe_z = probe.measure(sensor_z)
        self.lift()
        probe_z_offset = self.host.probe_offsets()[2]
        parts = (sensor_z, probe_z, probe_z_offset, settings.z_offset)
        return Result(*parts + (correction(*parts),))


######################################################################
# Commands
######################################################################

MM = "write a distance in mm"
MM_S = "write a speed in mm/s"
X_Y = "write X and Y in mm, such as 100,100"
SAVE_HINT = (
    "The SAVE_CONFIG command will update the printer config file\nwith the"
    " above and restart the printer."
)


# --- shared: reading options ---
# Runs a parser of section 2 on an option; its complaint becomes a config
# error that names section, option and remedy.
def read_option(config, name, parse, remedy, default=None):
    text = config.get(name, None)
    if text is None:
        return default
    try:
        return parse(text.strip())
    except CalibrationError as e:
        text = "Option '%s' in section '%s': %s; %s"
        raise config.error(text % (name, config.get_name(), e, remedy))


def read_number(config, name, parse, remedy, default=None):
    value = read_option(config, name, parse, remedy, default)
    if config.get(name, None) is not None:
        # As a number for those who look at printer.configfile.settings
        config.getfloat(name)
    return value


def read_count(config, name, smallest, default=None):
    parse = functools.partial(parse_count, smallest=smallest)
    remedy = "write a whole number of %d or more" % (smallest,)
    return read_option(config, name, parse, remedy, default)


# --- end ---


# In any order; what else is in the section was meant for something else.
OPTIONS = (
    "pin",
    "prepare_gcode",
    "z_offset",
    "speed",
    "lift_speed",
    "probe_hop",
    "probe_accel",
    "probe_z_min",
    "offset_samples",
    "samples",
    "sample_retract_dist",
    "samples_result",
    "samples_tolerance",
    "samples_tolerance_retries",
    "z_current_factor",
    "probe_z_correction",
    "corrected_probe_z_offset",
    "bed_xy_position",
)

# Of the original module: why each is not used.
OLD_OPTIONS = (
    (
        "calibrated_z_offset",
        "is not applied: it contains the whole z_offset of the probe; run"
        " AUTO_Z_CALIBRATE again, then SAVE_CONFIG",
    ),
    ("x_offset", "is ignored: the nozzle itself presses the bed"),
    ("y_offset", "is ignored: the nozzle itself presses the bed"),
    ("activate_gcode", "is not run: move it into prepare_gcode"),
    (
        "deactivate_gcode",
        "is not run: move it into a macro that runs after AUTO_Z_CALIBRATE",
    ),
    ("deactivate_on_each_sample", "is ignored"),
    ("stow_on_each_sample", "is ignored"),
    ("recovery_time", "is ignored: end prepare_gcode with G4 instead"),
)


# The host would refuse it, too, but without a way out.
def check_options(config):
    known = OPTIONS + tuple(name for name, unused in OLD_OPTIONS)
    for option in config.get_prefix_options(""):
        if option in known:
            continue
        similar = "".join(difflib.get_close_matches(option, known, 1, 0.8))
        remedy = "is '%s' meant?" % (similar,)
        if similar not in OPTIONS:
            remedy = "remove it"
        raise config.error(
            "Option '%s' in section '%s' is not known; %s"
            % (option, config.get_name(), remedy)
        )


# Returns what the user is told of old options
def read_old_options(config):
    told = []
    for name, why in OLD_OPTIONS:
        if config.get(name, None) is not None:
            told.append("option '%s' %s" % (name, why))
    return told


# Sensors that the original module powered here would stay off.
def read_lost_gcode(config):
    return config.get("activate_gcode", "").strip() != ""


def read_bed(config):
    pair = read_option(config, "bed_xy_position", parse_pair, X_Y)
    if pair is None:
        return None
    origin = "Option 'bed_xy_position: %g,%g' in section '%s'"
    return Site(pair[0], pair[1], origin % (pair + (config.get_name(),)))


# 'notes' collects what the user is told
def read_floor(config, z_axis, notes):
    lowest = max(z_axis.position_min, LOWEST_FLOOR)
    of_axis = Floor(lowest, "position_min of section '%s'" % (z_axis.section,))
    if lowest != z_axis.position_min:
        of_axis = Floor(lowest, "the limit of auto_z_offset")
    own = read_number(config, "probe_z_min", parse_number, MM)
    if own is None:
        return of_axis
    if own < lowest:
        notes.append(
            "'probe_z_min: %g' is ignored, %s is %g"
            % (own, of_axis.why, of_axis.z)
        )
        return of_axis
    return Floor(own, "probe_z_min")


def read_sampling(config):
    result = "write average or median"
    number = functools.partial(read_number, config)
    return Sampling(
        samples=read_count(config, "samples", 1, 1),
        tolerance=number("samples_tolerance", parse_not_negative, MM, 0.1),
        retries=read_count(config, "samples_tolerance_retries", 0, 0),
        result=read_option(
            config, "samples_result", parse_result_word, result, "average"
        ),
        speed=number("speed", parse_positive, MM_S, 5.0),
        retract_dist=number("sample_retract_dist", parse_positive, MM, 3.0),
        lift_speed=number("lift_speed", parse_positive, MM_S, 20.0),
    )


def within_offset():
    return functools.partial(
        parse_between, low=-LARGEST_OFFSET, high=LARGEST_OFFSET
    )


def read_settings(config, host, notes):
    number = functools.partial(read_number, config)
    settings = Settings(
        bed=read_bed(config),
        z_offset=number("z_offset", within_offset(), "write mm", 0.2),
        probe_hop=number("probe_hop", parse_hop, MM, SMALLEST_HOP),
        probe_accel=number(
            "probe_accel", parse_not_negative, "write mm/s^2, or 0", 0.0
        ),
        floor=read_floor(config, host.z_axis, notes),
        offset_samples=read_count(config, "offset_samples", 1, 3),
        sampling=read_sampling(config),
        current_factor=number(
            "z_current_factor",
            functools.partial(parse_between, low=0.1, high=1.0),
            "write a factor",
            0.33,
        ),
    )
    note = inside_bed(settings.z_offset)
    if note:
        notes.append(note)
    return settings


def load_prepare_gcode(config):
    name = "prepare_gcode"
    if config.get(name, None) is None:
        raise config.error(
            "Option '%s' in section '%s' is missing; write the G-code that"
            " turns the bed sensor on, or nothing behind the colon if none is"
            " needed" % (name, config.get_name())
        )
    printer = config.get_printer()
    gcode_macro = printer.load_object(config, "gcode_macro")
    try:
        return gcode_macro.load_template(config, name)
    except printer.command_error as e:
        # What newer hosts raise would come out as an internal error.
        text = "Option '%s' in section '%s': %s"
        raise config.error(text % (name, config.get_name(), e))


# --- shared: watch ---
# What a run is doing, for get_status() and the console.
class Watch(object):
    def __init__(self, respond_info):
        self.respond_info = respond_info
        self.phase = "idle"
        self.done = self.wanted = 0

    def begin(self, respond_info, wanted):
        self.respond_info = respond_info
        self.done = 0
        self.wanted = wanted

    def enter(self, phase):
        self.phase = phase

    def end(self):
        self.phase = "idle"
        self.done = self.wanted = 0

    # Samples that are taken again do not count twice
    def touched(self):
        self.done = min(self.done + 1, self.wanted)

    def say(self, msg):
        self.respond_info("%s: %s" % (NAME, msg))

    def status(self):
        progress = self.done / self.wanted if self.wanted else 0.0
        return {"phase": self.phase, "progress": progress}


# --- end ---


# The object behind [auto_z_offset]
class AutoZOffset(object):
    def __init__(self, config):
        logging.info("auto_z_offset %s", __version__)
        check_options(config)
        self.printer = config.get_printer()
        self.gcode = self.printer.lookup_object("gcode")
        self.host = Host(config)
        self.frame = Frame(self.host)
        self.notes = read_old_options(config)
        self.lost_gcode = read_lost_gcode(config)
        self.settings = read_settings(config, self.host, self.notes)
        # None: never measured.  The documented default means that, too.
        self.correction = read_number(
            config, "probe_z_correction", within_offset(), "write mm"
        )
        # z_offset of the probe that it was measured with; None: not known
        self.corrected_z_offset = read_number(
            config, "corrected_probe_z_offset", parse_number, MM
        )
        if self.corrected_z_offset is None:
            self.correction = self.correction or None
        self.prepare_gcode = load_prepare_gcode(config)
        self.watch = Watch(self.gcode.respond_info)
        # Toolhead Z of the last trigger, and the frame it was seen in
        self.sensor_z = self.mark = None
        # The frame that AUTO_Z_HOME_Z has made
        self.home_mark = None
        # Of the last command that measured both heights
        self.results = ()
        self._register()

    def _register(self):
        register = self.printer.register_event_handler
        register("klippy:connect", self.connect)
        register("klippy:ready", self.tell_notes)
        for name in (
            "AUTO_Z_PROBE",
            "AUTO_Z_HOME_Z",
            "AUTO_Z_MEASURE_OFFSET",
            "AUTO_Z_CALIBRATE",
            "AUTO_Z_LOAD_OFFSET",
            "AUTO_Z_SAVE_GCODE_OFFSET",
        ):
            handler = getattr(self, "cmd_" + name)
            text = getattr(self, "cmd_%s_help" % (name,))
            self.gcode.register_command(name, handler, desc=text)

    # Set-up
    def connect(self):
        self.host.connect()
        self.follow_probe()
        try:
            self.check_heights()
            self.check_reach(self.bed_site())
            self.check_reach(self.probe_site(self.bed_site()))
        except CalibrationError as e:
            raise self.printer.config_error(str(e))
        if self.settings.current_factor < 1.0 and self.host.left_alone:
            self.notes.append(
                "z_current_factor has no effect on %s: no TMC driver of its own"
                " whose current may be changed"
                % (", ".join(self.host.left_alone),)
            )
        self.note_speed()
        if not self.host.homes_with_probe:
            self.notes.append(
                "Z is not homed with the probe, so the correction holds with a"
                " bed mesh of this probe only"
            )

    # Z_OFFSET_APPLY_PROBE and PROBE_CALIBRATE move the probe's Z=0, and the
    # correction is counted from there.
    def follow_probe(self):
        if self.correction is None or self.corrected_z_offset is None:
            return
        z_offset = self.host.probe_offsets()[2]
        moved = z_offset - self.corrected_z_offset
        if abs(moved) < SAVED_DIGIT:
            return
        before = self.correction
        self.correction = before + moved
        self.notes.append(
            "the probe's z_offset is %.3f and was %.3f when the correction was"
            " saved: probe_z_correction %.6f is taken as %.6f"
            % (z_offset, self.corrected_z_offset, before, before + moved)
        )

    def note_speed(self):
        settings = self.settings
        accel = self.host.braking_accel(settings.probe_accel)
        speed = fastest_touch(settings.sampling.speed, accel)
        if speed < settings.sampling.speed:
            self.notes.append(
                "speed %g is limited to %.2f mm/s on the bed sensor: with %g"
                " mm/s^2 the head could not stop soon enough below the bed"
                % (settings.sampling.speed, speed, accel)
            )

    def tell_notes(self):
        for note in self.notes:
            self.gcode.respond_info("%s: %s" % (NAME, note))

    def check_heights(self):
        low, high = self.host.axis_limits()[2]
        settings, section = self.settings, self.host.z_axis.section
        top = travel_height(self.host.homed_probe_z(), settings.probe_hop)
        if top > high:
            raise CalibrationError(
                "Option 'probe_hop' in section '%s': the head would travel at"
                " z=%.3f, above position_max (%.3f) of section '%s'; write a"
                " smaller value, or correct z_offset of the probe"
                % (NAME, top, high, section)
            )
        if settings.floor.z >= top - settings.probe_hop:
            raise CalibrationError(
                "Option 'probe_z_min' in section '%s': no touch could reach"
                " the bed from there, z=%.3f is the lowest; write a value"
                " below 0, and position_min of section '%s', too"
                % (NAME, settings.floor.z, section)
            )

    def check_reach(self, site):
        limits = self.host.axis_limits()
        for axis, xy, (low, high) in zip("XY", site[:2], limits):
            if not low <= xy <= high:
                raise CalibrationError(
                    "%s needs the head at %s=%.3f, outside its %.3f to %.3f;"
                    " set bed_xy_position in section '%s' to a point that"
                    " nozzle and probe can reach"
                    % (site.origin, axis, xy, low, high, NAME)
                )

    # Places of the head (mm): nozzle, then probe over the same point
    def bed_site(self):
        if self.settings.bed is not None:
            return self.settings.bed
        (x_min, x_max), (y_min, y_max) = self.host.axis_limits()[:2]
        middle = (x_min + x_max) / 2.0, (y_min + y_max) / 2.0
        return Site(middle[0], middle[1], "The middle of the axes")

    def probe_site(self, bed):
        x_offset, y_offset = self.host.probe_offsets()[:2]
        origin = "%s, with the probe above it," % (bed.origin,)
        return Site(bed.x - x_offset, bed.y - y_offset, origin)

    # Status
    def get_status(self, eventtime):
        corrections = [result.correction for result in self.results]
        last = self.results[-1]._asdict() if self.results else {}
        spread = max(corrections) - min(corrections) if corrections else 0.0
        status = {
            "probe_z_correction": self.correction or 0.0,
            "last_z": self.sensor_z,
            "last_result": dict(last),
            "corrections": corrections,
            "spread": spread,
        }
        status.update(self.watch.status())
        return status

    # From a template of its own it would never end
    def check_idle(self, gcmd):
        if self.watch.phase != "idle":
            raise gcmd.error(
                "%s: a measurement is under way (%s); start another one when"
                " it has ended" % (NAME, self.watch.phase)
            )

    def accepts_change(self, gcmd):
        text = gcmd.get("ACCEPT_CHANGE", "0")
        try:
            return parse_switch(text.strip())
        except CalibrationError as e:
            raise CalibrationError("ACCEPT_CHANGE: %s; write 1 or 0" % (e,))

    # What is known of the bed: a touch since Z was set, or what the probe
    # said when Z was homed with it
    def expected(self):
        if self.holds(self.mark):
            return expect_near(self.sensor_z, KNOWN_MARGIN)
        if self.is_sensor_frame() or not self.host.homes_with_probe:
            return NOTHING_EXPECTED
        if self.correction is not None:
            z_offset, bed_z = self.settings.z_offset, self.host.homed_bed_z()
            return expect_corrected(self.correction, z_offset, bed_z)
        return expect_below_probe(self.host.homed_probe_z())

    # Whether Z is still what it was when the frame was marked.  Where the
    # motors do not tell (empty datum), nobody knows.
    def holds(self, mark):
        known = mark is not None and bool(mark[1])
        return known and not self.frame.moved_since(mark)

    # Whether Z is the bed sensor's.  Levelling does not change that: only what
    # sets Z does.
    def is_sensor_frame(self):
        mark = self.home_mark
        return mark is not None and mark[0] == self.frame.count

    # The correction of the probe means nothing there.
    def check_frame(self):
        if self.is_sensor_frame():
            raise CalibrationError(
                "Z was set by AUTO_Z_HOME_Z, a correction of the probe does not"
                " hold there; home Z with the probe (G28) first"
            )

    def check_probe_frame(self, gcmd):
        try:
            self.check_frame()
        except CalibrationError as e:
            raise gcmd.error("%s: %s" % (NAME, e))

    # Runs what a command does with the machine: 'work' gets a Run and returns
    # what the command stores or says.  On any failure the head is lifted, and
    # nothing has changed.
    def measuring(self, gcmd, touches, work):
        self.check_idle(gcmd)
        offset = self.host.gcode_offset()
        self.watch.begin(gcmd.respond_info, touches)
        self.watch.enter("prepare_gcode")
        try:
            return self.run(gcmd, work)
        except CalibrationError as e:
            self.failed(offset)
            raise gcmd.error("%s: %s" % (NAME, e))
        except self.printer.command_error:
            self.failed(offset)
            raise
        finally:
            self.watch.end()

    def run(self, gcmd, work):
        accepted = self.accepts_change(gcmd)
        if self.lost_gcode:
            raise CalibrationError(
                "activate_gcode is not run, the bed sensor may be off; move it"
                " into prepare_gcode"
            )
        self.host.check_manual_probe()
        self.host.check_homed()
        expect = self.expected if not accepted else lambda: NOTHING_EXPECTED
        run = Run(self.host, self.settings, self.watch, self.prepare, expect)
        with self.host.always(run.lift, "lifting"):
            value = work(run)
        self.sensor_z = run.sensor_z
        self.mark = self.frame.mark()
        return value

    # Relative moves must not outlive the template, also when it fails.
    def prepare(self):
        absolute = self.host.is_absolute()
        back = functools.partial(self.host.set_absolute, absolute)
        with self.host.always(back, "setting G90 or G91 back"):
            self.prepare_gcode.run_gcode_from_command()

    def failed(self, offset):
        if self.printer.is_shutdown():
            return
        if self.host.gcode_offset() != offset:
            self.host.set_gcode_offset(offset)

    # AUTO_Z_PROBE
    cmd_AUTO_Z_PROBE_help = "Touch the bed with the nozzle where the head is"

    def cmd_AUTO_Z_PROBE(self, gcmd):
        x, y, z = self.measuring(
            gcmd, self.settings.sampling.samples, self.probe_here
        )
        gcmd.respond_info(
            "AUTO_Z_PROBE: at X:%.3f Y:%.3f the bed sensor triggered at"
            " z=%.6f" % (x, y, z)
        )

    def probe_here(self, run):
        x, y = self.host.toolhead.get_position()[:2]
        run.prepare(Site(x, y, ""))
        return x, y, run.measure_sensor()

    # AUTO_Z_HOME_Z
    cmd_AUTO_Z_HOME_Z_help = "Set Z to z_offset where the bed sensor triggers"

    def cmd_AUTO_Z_HOME_Z(self, gcmd):
        touches = self.settings.sampling.samples
        z = self.measuring(gcmd, touches, self.home_z)
        self.home_mark = self.mark
        z_offset = self.settings.z_offset
        gcmd.respond_info(
            "AUTO_Z_HOME_Z: the bed sensor triggered at z=%.6f, which is"
            " z=%.6f now" % (z, z_offset)
        )
        self.tell(inside_bed_after_homing(z_offset))
        offset = self.host.gcode_offset()
        if offset:
            text = "the G-code Z offset of %.3f stays, on top of this"
            self.tell(text % (offset,))

    # One that was meant for the probe's Z, a correction above all
    def check_offset(self):
        offset, z_offset = self.host.gcode_offset(), self.settings.z_offset
        if offset < 0.0 < z_offset - offset:
            raise CalibrationError(
                "with the G-code Z offset of %.3f in force the nozzle would be"
                " %.3f mm inside the bed at Z=0; run SET_GCODE_OFFSET Z=0 first"
                % (offset, z_offset - offset)
            )

    def home_z(self, run):
        if not self.host.z_datum():
            raise CalibrationError(
                "the motors of Z move X or Y, too: on such a machine nobody"
                " would know later what Z was set to; home it with G28"
            )
        run.prepare(self.bed_site())
        self.check_offset()
        z = run.measure_sensor()
        z_offset = self.settings.z_offset
        # Last, so that nothing can fail in a frame that is another one
        self.host.set_z(self.host.z() - z + z_offset)
        run.sensor_z = z_offset
        run.travel_z = z_offset + self.settings.probe_hop
        return z

    # AUTO_Z_MEASURE_OFFSET
    cmd_AUTO_Z_MEASURE_OFFSET_help = "Measure by how much the probe is wrong"

    def cmd_AUTO_Z_MEASURE_OFFSET(self, gcmd):
        touches = 2 * self.settings.sampling.samples
        result = self.measuring(gcmd, touches, self.measure_once)
        self.results = (result,)
        gcmd.respond_info(self.formula("AUTO_Z_MEASURE_OFFSET", result))
        self.tell(inside_bed(result.z_offset))

    def measure_once(self, run):
        bed = self.bed_site()
        run.prepare(bed)
        result = run.measure(bed, self.probe_site(bed))
        if self.stale(result):
            self.watch.say(self.stale(result))
        return result

    # The correction is the G-code offset only where the probe sees the bed
    # at about 0.
    def stale(self, result):
        bed_z = result.probe - result.probe_z_offset
        homed_bed_z = self.host.homed_bed_z()
        if abs(bed_z - homed_bed_z) <= STALE_Z:
            return ""
        text = "the probe sees the bed at z=%.3f instead of %.3f; %s"
        remedy = "home Z again (G28) after any levelling, over this point"
        if not self.host.homes_with_probe:
            remedy = "the correction holds with a bed mesh of this probe only"
        return text % (bed_z, homed_bed_z, remedy)

    def formula(self, name, result):
        return (
            "%s: sensor=%.3f - (probe=%.3f - probe z_offset=%.3f)"
            " + z_offset=%.3f --> correction=%.6f" % ((name,) + tuple(result))
        )

    # AUTO_Z_CALIBRATE
    cmd_AUTO_Z_CALIBRATE_help = "Measure, apply and save the probe's correction"

    def cmd_AUTO_Z_CALIBRATE(self, gcmd):
        settings = self.settings
        touches = 2 * settings.sampling.samples * settings.offset_samples
        results, z_offset = self.measuring(gcmd, touches, self.calibrate)
        self.results = results
        self.save(z_offset)
        corrections = [result.correction for result in results]
        gcmd.respond_info(
            "AUTO_Z_CALIBRATE: %s of %d, range %.6f: probe_z_correction:"
            " %.6f\n%s"
            % (
                settings.sampling.result,
                len(corrections),
                max(corrections) - min(corrections),
                z_offset,
                SAVE_HINT,
            )
        )
        self.tell(inside_bed(settings.z_offset))

    def calibrate(self, run):
        bed = self.bed_site()
        run.prepare(bed)
        self.check_frame()
        sampling = self.settings.sampling
        results = []

        def cycle():
            result = run.measure(bed, self.probe_site(bed))
            if self.stale(result):
                if self.host.homes_with_probe:
                    raise CalibrationError(self.stale(result))
                self.watch.say(self.stale(result))
            results.append(result)
            self.watch.say(self.formula("cycle", result))
            return result.correction

        cycles = sampling._replace(samples=self.settings.offset_samples)
        try:
            corrections = collect(cycle, cycles, self.say_of_cycles)
        except SamplesDiffer as e:
            raise CalibrationError("cycles: %s" % (e,))
        run.lift()
        z_offset = summarize(corrections, sampling.result)
        check_correction(z_offset)
        self.host.apply_offset(z_offset + self.host.homed_bed_z())
        return tuple(results[-len(corrections) :]), z_offset

    def say_of_cycles(self, msg):
        self.watch.say("cycles: %s" % (msg,))

    def save(self, z_offset):
        self.correction = z_offset
        self.host.save_option("probe_z_correction", z_offset)
        probe_z_offset = self.host.probe_offsets()[2]
        self.host.save_option("corrected_probe_z_offset", probe_z_offset)

    # AUTO_Z_LOAD_OFFSET
    cmd_AUTO_Z_LOAD_OFFSET_help = "Apply the probe's correction"

    def cmd_AUTO_Z_LOAD_OFFSET(self, gcmd):
        self.check_probe_frame(gcmd)
        z_offset = self.correction or 0.0
        bed_z = self.host.homed_bed_z()
        self.host.apply_offset(z_offset + bed_z)
        gcmd.respond_info(
            "AUTO_Z_LOAD_OFFSET: probe_z_correction: %.6f, the G-code Z offset"
            " is %.6f now" % (z_offset, z_offset + bed_z)
        )
        if bed_z:
            self.tell(
                "%.6f more, as position_endstop of section '%s' and the"
                " probe's z_offset differ" % (bed_z, self.host.z_axis.section)
            )
        if self.correction is None:
            gcmd.respond_info(
                "%s: there is no probe_z_correction yet; run AUTO_Z_CALIBRATE,"
                " then SAVE_CONFIG" % (NAME,)
            )

    # AUTO_Z_SAVE_GCODE_OFFSET
    cmd_AUTO_Z_SAVE_GCODE_OFFSET_help = "Save the G-code Z offset in force"

    def cmd_AUTO_Z_SAVE_GCODE_OFFSET(self, gcmd):
        self.check_probe_frame(gcmd)
        before = self.correction or 0.0
        z_offset = self.host.gcode_offset() - self.host.homed_bed_z()
        if abs(z_offset) > LARGEST_OFFSET:
            raise gcmd.error(
                "%s: a G-code Z offset of %.3f is no correction of a probe; up"
                " to %g mm can be saved" % (NAME, z_offset, LARGEST_OFFSET)
            )
        self.save(z_offset)
        gcmd.respond_info(
            "AUTO_Z_SAVE_GCODE_OFFSET: probe_z_correction: %.6f (was %.6f)\n%s"
            % (z_offset, before, SAVE_HINT)
        )
        if abs(z_offset - before) > KNOWN_MARGIN:
            gcmd.respond_info(
                "%s: that is %.3f mm away from before; was AUTO_Z_LOAD_OFFSET"
                " run, and Z homed with the probe?"
                % (NAME, abs(z_offset - before))
            )

    def tell(self, text):
        if text:
            self.gcode.respond_info("%s: %s" % (NAME, text))


def load_config(config):
    return AutoZOffset(config)
