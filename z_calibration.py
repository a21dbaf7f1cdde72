# Z offset calibration with a nozzle endstop and a detachable switch probe
#
# Copyright (C) 2026  the Z calibration developers
#
# This file may be distributed under the terms of the GNU GPLv3 license.
#
# CALIBRATE_Z measures three heights, in this order:
#
#   nozzle   the nozzle tip touches the pin of the Z endstop
#   switch   the body of the probe's switch touches the same pin
#   bed      the probe triggers on the print surface
#
# and applies, as the G-code Z offset:
#
#   Z offset = probe - (switch - nozzle + switch_offset)
#
#      nozzle           switch           bed
#
#       \_/              \_/              \_/          tip of the nozzle
#        I  [s]              [s]              [s]      body of the switch
#        I                    I                :       its plunger, pressed
#     ===I======       =======I===      ===========    bed; I is the pin
#
# Every height is a toolhead Z: the position, in mm and in the frame that the
# last homing defined, at which a touch triggered.  G-code offset, bed mesh
# and skew play no part in it.  Up is positive; a touch reached lower down
# has the smaller height.
#
#   switch - nozzle   how far the switch body hangs below the nozzle  (> 0)
#   switch_offset     from the body to the trigger point above it     (>= 0)
#   offset            toolhead Z where the nozzle meets the bed; a larger
#                     switch_offset moves the nozzle closer to the bed
#
# The head goes down in two parts: quickly, but ready to stop, to where the
# last samples began or should begin, then slowly until the trigger.  Neither
# goes lower than a usable result can lie: see the *_floor() functions.  A
# lost probe or a dead switch then ends with the nozzle in the air.
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
NAME = "z_calibration"

# Results outside these limits (mm) are refused: the homing is outdated or
# something was touched that should not have been.
OFFSET_MARGINS = (-1.0, 1.0)

# How far (mm) below the expected height a touch may still look.
TRAVEL_MARGIN = 1.0

# The switch body hangs at least this far (mm) below the nozzle tip: a probe
# with less could not reach the bed before the nozzle does.
BODY_BELOW_NOZZLE = 1.0

# A smaller z_offset (mm) of the probe cannot have been measured on a switch.
SMALLEST_Z_OFFSET = 2.0

# What a probe that was never measured may hang below the nozzle (mm), where
# its z_offset is no better.  Common ones hang 5 to 9 mm; long ones need a
# z_offset or a safe_z_height that is right.
UNMEASURED_PROBE = 10.0

# The free plunger hangs this much (mm) lower than the point at which it
# triggers; no micro switch has a longer pretravel.
FREE_PLUNGER = 1.0

# Travel height (mm) where twice the probe's z_offset is no real height.
SMALLEST_SAFE_Z = 3.0
FALLBACK_SAFE_Z = 20.0

# Lift (mm) between two touches where homing_retract_dist is 0, which is
# right for homing only: without a lift the next touch starts on a pressed
# switch.  2 mm is more than the hysteresis of any common micro switch.
FALLBACK_RETRACT = 2.0

# XY speed (mm/s) between the sites.
TRAVEL_SPEED = 50.0

# A distance (mm) between nozzle and switch that no print head has: the
# option holds a position instead of an offset.
LARGEST_SWITCH_DISTANCE = 100.0

# Nearer (mm) to where its body is on the Z endstop the probe cannot touch the
# bed: half the length of a usual micro switch.
SWITCH_NEAR = 7.0

# Within this distance (mm) of its zero a bed mesh is as good as zero.
MESH_ZERO_NEAR = 1.0

# From here on (mm) a difference is not noise or heat: of the nozzle against
# the height Z was homed at, or of switch minus nozzle against the last run.
STALE_Z = 0.5
GEOMETRY_JUMP = 0.5

# An offset of more than this (mm) is worth correcting in position_endstop.
LARGE_OFFSET = 0.2

# Every probing move may shift the frame by a part of a microstep; what adds
# up to less than this (mm) is neither homing nor levelling.
DATUM_NOISE = 0.02

# A trigger this close (mm) to the start is none: the sensor was pressed.
# Less than any microstep is long, more than rounding.
NO_TRAVEL = 0.0001

# Commands that cannot attach a probe.
PLAIN = re.compile(
    r"(G0|G1|G4|G90|G91|G92|M117|M118|M204|M400)(?![0-9.]).*", re.IGNORECASE
)


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


# Something to touch (mm): where the head stands for it, and the word used in
# messages.  'origin' is where the user has said so.
Site = collections.namedtuple("Site", "name x y origin")

# The places of one run.
Sites = collections.namedtuple("Sites", "nozzle switch bed")

# --- shared: sampling ---
# How heights are sampled: count, mm, count, "median" or "average", mm/s, mm,
# mm/s.
Sampling = collections.namedtuple(
    "Sampling", "samples tolerance retries result speed retract_dist lift_speed"
)
# --- end ---

# The parts and the outcome of one calibration (mm); see the header.
Result = collections.namedtuple(
    "Result", "probe switch nozzle switch_offset offset"
)

# Where a touch should trigger (toolhead Z in mm, None: no idea).  'sure' when
# it was measured with the same nozzle and probe since Z was homed.
Expected = collections.namedtuple("Expected", "z sure")

# What the user configured: mm and mm/s.  None stands for "as the probe has
# it" until complete() has filled it in, and for a place or a switch_offset
# that is to come with the command; position_endstop is None where the pin is
# not what Z is homed on.
Settings = collections.namedtuple(
    "Settings",
    "nozzle switch switch_xy_offsets bed wiggle switch_offset"
    " attach_after_nozzle first_fast"
    " offset_margins travel_margin position_endstop position_min position_max"
    " safe_z_height speed probing_speed z_offset pin probe",
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


# "low, high", or one value for both directions
def parse_margins(text):
    if "," not in text:
        size = parse_positive(text)
        return -size, size
    low, high = parse_pair(text)
    if not low <= 0.0 <= high or low == high:
        raise CalibrationError("'%s' leaves no room around 0" % (text,))
    return low, high


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


# Population standard deviation, as PROBE_ACCURACY has it
def deviation(samples):
    average = summarize(samples, "average")
    squares = [(z - average) ** 2 for z in samples]
    return math.sqrt(math.fsum(squares) / len(samples))


# What to do about samples that differ
DIFFER = "clean the nozzle and check the switch for play"


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


def offset(probe, switch, nozzle, switch_offset):
    return probe - (switch - nozzle + switch_offset)


def check_offset(result, margins):
    low, high = margins
    if low <= result.offset <= high:
        return
    raise CalibrationError(
        "offset %.3f is outside offset_margins %.3f to %.3f"
        " (probe=%.3f switch=%.3f nozzle=%.3f); home Z again (G28 Z) after any"
        " levelling, then check the three positions and position_endstop"
        % ((result.offset, low, high) + result[:3])
    )


# The height Z=0 of the nozzle was moved to by the user is the offset that is
# right; the difference belongs to switch_offset.
def corrected_switch_offset(switch_offset, z, z_offset):
    return switch_offset - (z - z_offset)


# Expected heights (toolhead Z, mm): 'last' is the last good Result or None,
# 'sure' whether nozzle, probe and frame are still those of that run.


def expect_nozzle(settings, last, sure):
    if last is None or not (sure or settings.position_endstop is None):
        return Expected(settings.position_endstop, False)
    return Expected(last.nozzle, sure)


def expect_switch(settings, nozzle_z, last, sure):
    if last is not None:
        return Expected(nozzle_z + last.switch - last.nozzle, sure)
    if settings.z_offset < SMALLEST_Z_OFFSET:
        return Expected(None, False)
    body = settings.z_offset - settings.switch_offset
    return Expected(nozzle_z + body, False)


def expect_bed(settings, nozzle_z, switch_z, last):
    gap = switch_z - nozzle_z + settings.switch_offset
    return Expected(gap + (last.offset if last is not None else 0.0), False)


# Lowest useful toolhead Z of each touch.  The nozzle meets the pin where Z
# was homed, give or take what the margins allow.
def nozzle_floor(settings, expected):
    reach = max(settings.travel_margin, -settings.offset_margins[0])
    homed_z = settings.position_endstop
    if homed_z is None:
        # A separate pin: nobody knows how high it is until it was touched
        homed_z = expected.z
    if homed_z is None:
        return settings.position_min
    return max(settings.position_min, homed_z - reach)


# The body hangs below the nozzle, in any case
def switch_floor(settings, nozzle_z, expected):
    floor = max(settings.position_min, nozzle_z + BODY_BELOW_NOZZLE)
    if expected.z is None:
        return floor
    return max(floor, expected.z - settings.travel_margin)


# Below this the offset would be less than the lower margin.
def bed_floor(settings, nozzle_z, switch_z):
    gap = switch_z - nozzle_z + settings.switch_offset
    return max(settings.position_min, gap + settings.offset_margins[0])


# Where the bed may be looked for with a probe of unknown length: the nozzle
# meets it below the upper margin.
def unmeasured_bed_floor(settings, nozzle_z):
    floor = settings.offset_margins[1] + BODY_BELOW_NOZZLE
    if settings.position_endstop is not None:
        # Higher where levelling has lifted the bed, and the pin with it
        floor += max(0.0, nozzle_z - settings.position_endstop)
    return max(settings.position_min, floor)


# The lowest height of the body on the pin if the probe triggered on the bed
# at bed_z: the offset can be no larger than the upper margin.
def lowest_switch(settings, nozzle_z, bed_z):
    gap = bed_z - settings.offset_margins[1]
    return nozzle_z + gap - settings.switch_offset


# Travel heights (mm)


def default_safe_z(probe_z_offset):
    safe_z = 2.0 * probe_z_offset
    return safe_z if safe_z >= SMALLEST_SAFE_Z else FALLBACK_SAFE_Z


# Over a pin at pin_z, and the bed, with a probe whose body hangs 'body' below
# the nozzle.
def travel_height(settings, pin_z, body):
    hangs = max(settings.z_offset, UNMEASURED_PROBE)
    if body is not None:
        hangs = body + settings.switch_offset + FREE_PLUNGER
    # The bed lies at about 0
    clear = max(pin_z or 0.0, 0.0) + hangs + settings.travel_margin
    return min(max(settings.safe_z_height, clear), settings.position_max)


# Over the pin and the bed, which may lie as high as the upper margin lets it.
def travel_height_to_bed(settings, nozzle_z, switch_z):
    gap = switch_z - nozzle_z + settings.switch_offset
    highest = max(nozzle_z, settings.offset_margins[1])
    clear = highest + gap + FREE_PLUNGER + settings.travel_margin
    return min(max(settings.safe_z_height, clear), settings.position_max)


# Let the probe and the axis decide what the user left open.
def complete(settings, probe, z_offset, position_max):
    own = settings.pin._asdict()
    left_open = [name for name in own if own[name] is None]
    pin = settings.pin._replace(**{n: getattr(probe, n) for n in left_open})
    settings = settings._replace(
        pin=pin, probe=probe, z_offset=z_offset, position_max=position_max
    )
    if settings.safe_z_height is None:
        safe_z = default_safe_z(z_offset)
        settings = settings._replace(safe_z_height=safe_z)
    return settings


# Not so: nothing at all, plain moves, or what start_gcode has done already.
def attaches_probe(before_switch_gcode, start_gcode):
    code = re.sub(r"(?s)\{%.*?%\}", "", before_switch_gcode)
    lines = [line.split(";")[0] for line in code.splitlines()]
    lines = [line.strip() for line in lines if line.strip()]
    if all(PLAIN.match(line) for line in lines):
        return False
    return before_switch_gcode.strip() != start_gcode.strip()


######################################################################
# Host
######################################################################

# The section that configures the Z axis, and its options that matter here.
ZAxis = collections.namedtuple(
    "ZAxis",
    "section endstop_pin position_endstop position_min"
    " homing_speed second_homing_speed homing_retract_dist",
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
            "Option 'kinematics: %s' in section 'printer' has no Z axis with"
            " an endstop of its own; z_calibration cannot be used on this"
            " machine, remove section 'z_calibration'"
            % (printer.get("kinematics", "none", note_valid=False),)
        )
    number = functools.partial(section.getfloat, note_valid=False)
    homing_speed = number("homing_speed", 5.0)
    return ZAxis(
        section=section.get_name(),
        endstop_pin=section.get("endstop_pin", "", note_valid=False),
        position_endstop=number("position_endstop", 0.0),
        position_min=number("position_min", 0.0),
        homing_speed=homing_speed,
        second_homing_speed=number("second_homing_speed", homing_speed / 2.0),
        homing_retract_dist=number("homing_retract_dist", 5.0),
    )


# How every host since 2021-08-17 (1dc2ab048) begins this error.
NO_TRIGGER = "No trigger"

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


# Such as probe:z_virtual_endstop
def is_of_probe(pin):
    return pin.split(":")[0].strip("^~! ") == "probe"


# Everything the module wants from the printer.  The only place that knows in
# which respects hosts differ; the difference is always asked of the object,
# never of a version number.
class Host(object):
    def __init__(self, config):
        self.printer = config.get_printer()
        self.gcode = self.printer.lookup_object("gcode")
        self.query_endstops = self.printer.load_object(config, "query_endstops")
        self.z_axis = read_z_axis(config)
        # What nozzle and body press: the Z endstop, or a pin of its own
        self.endstop_pin = config.get("endstop_pin", None)
        self.pin_endstop = None
        if self.endstop_pin is not None:
            self.pin_endstop = self._make_pin_endstop(config)
        # The others exist from klippy:connect on.
        self.toolhead = self.probe = self.mcu = None

    def connect(self):
        self.mcu = self.printer.lookup_object("mcu")
        self.toolhead = self.printer.lookup_object("toolhead")
        if self.endstop_pin is None:
            self.pin_endstop = self._find_z_endstop()
        where = "Option 'endstop_pin: %s' in section '%s'"
        if self.endstop_pin is None:
            where %= (self.z_axis.endstop_pin, self.z_axis.section)
        else:
            where %= (self.endstop_pin, "z_calibration")
        self._check_pin_endstop(where)
        self.probe = self._find_probe()

    # The pin that nozzle and body press
    def _make_pin_endstop(self, config):
        pin = self.endstop_pin
        if not pin.strip("^~! ") or is_of_probe(pin):
            raise config.error(
                "Option 'endstop_pin: %s' in section 'z_calibration' is no pin"
                " that the nozzle can press; give the pin of that switch, or"
                " leave the option out to use the Z endstop" % (pin,)
            )
        probe_pin = ""
        if config.has_section("probe"):
            section = config.getsection("probe")
            probe_pin = section.get("pin", "", note_valid=False)
        if bare_pin(pin) == bare_pin(probe_pin):
            raise config.error(
                "Option 'endstop_pin: %s' in section 'z_calibration' is the pin"
                " of section 'probe'; give the pin of the switch that the"
                " nozzle presses" % (pin,)
            )
        pins = self.printer.lookup_object("pins")
        try:
            # QUERY_ENDSTOPS and macros may know this pin by another section
            pins.allow_multi_use_pin(bare_pin(pin))
            endstop = pins.setup_pin("endstop", pin)
        except pins.error as e:
            raise config.error(
                "Option 'endstop_pin: %s' in section 'z_calibration': %s"
                % (pin, e)
            )
        self.query_endstops.register_endstop(endstop, "z_calibration")
        self.printer.register_event_handler(
            "klippy:mcu_identify", self._add_z_steppers
        )
        return endstop

    def _add_z_steppers(self):
        # Steppers exist since the toolhead was loaded, just before this event
        toolhead = self.printer.lookup_object("toolhead")
        for stepper in self._z_steppers(toolhead):
            self.pin_endstop.add_stepper(stepper)

    # --- shared: z steppers ---
    def _z_steppers(self, toolhead):
        steppers = toolhead.get_kinematics().get_steppers()
        return [s for s in steppers if s.is_active_axis("z")]

    # --- end ---

    def _find_z_endstop(self):
        # Registered as "z" until 2025-05-06 (cc6736c3e) and on Kalico, since
        # then under the name of the section.
        axis = self.z_axis
        names = (axis.section, axis.section.split()[-1].replace("stepper_", ""))
        for endstop, name in self.query_endstops.endstops:
            if name in names:
                return endstop
        raise self.printer.config_error(
            "Option 'endstop_pin: %s' in section '%s': the printer knows no"
            " endstop of the name %s; the Z axis needs a switch that the"
            " nozzle can press"
            % (axis.endstop_pin, axis.section, " or ".join(names))
        )

    def _check_pin_endstop(self, where):
        # Hosts themselves tell a virtual endstop by this method.
        if hasattr(self.pin_endstop, "get_position_endstop"):
            raise self.printer.config_error(
                "%s is the probe: z_calibration needs a Z endstop that the"
                " nozzle can press; set it to the pin of that switch, or give"
                " the pin as endstop_pin in section 'z_calibration'" % (where,)
            )
        # An endstop stops only its own motors.  With none at all, hosts since
        # 2025-05-06 (cc6736c3e) make the whole move without any endstop.
        stopped = [s.get_name() for s in self.pin_endstop.get_steppers()]
        moving = [s.get_name() for s in self._z_steppers(self.toolhead)]
        missing = [name for name in moving if name not in stopped]
        if missing:
            raise self.printer.config_error(
                "%s does not stop these Z motors: %s; remove the endstop_pin"
                " of their own" % (where, ", ".join(missing))
            )

    # Probe
    def _find_probe(self):
        probe = self.printer.lookup_object("probe", None)
        if probe is None:
            raise self.printer.config_error(
                "Section 'probe' is missing: z_calibration needs a [probe]"
                " with a switch that can press the Z endstop"
            )
        for name in ("bltouch", "smart_effector"):
            # Neither has a switch body, and on a touch without the host's own
            # procedure the pin of a bltouch would be retracted.
            if self.printer.lookup_object(name, None) is not None:
                raise self.printer.config_error(
                    "Section '%s': this probe has no switch body to press the"
                    " Z endstop with; z_calibration needs a switch as [probe]"
                    % (name,)
                )
        if self._endstop_of(probe) is None:
            raise self.printer.config_error(
                "Section 'probe' (%s) is not a switch on an endstop pin that"
                " stops the Z motors; z_calibration needs one"
                % (probe.__class__.__name__,)
            )
        return probe

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

    # Kalico's dockable_probe may fetch and dock it by itself, at any session
    def check_probe_stays(self):
        dockable = self.printer.lookup_object("dockable_probe", None)
        if getattr(dockable, "auto_attach_detach", False):
            raise CalibrationError(
                "auto_attach_detach of section 'dockable_probe' docks the probe"
                " between the touches; set it to False and attach the probe in"
                " start_gcode or before_switch_gcode"
            )

    # The probe's own settings
    def probe_sampling(self):
        probe = self.probe
        if hasattr(probe, "get_probe_params"):
            params = probe.get_probe_params()
            return Sampling(
                samples=params["samples"],
                tolerance=params["samples_tolerance"],
                retries=params["samples_tolerance_retries"],
                result=params["samples_result"],
                speed=params["probe_speed"],
                retract_dist=params["sample_retract_dist"],
                lift_speed=params["lift_speed"],
            )
        # Until 2024-06-10 (6ea5b94d1), Kalico, QIDI
        return Sampling(
            samples=probe.sample_count,
            tolerance=probe.samples_tolerance,
            retries=probe.samples_retries,
            result=probe.samples_result,
            speed=probe.speed,
            retract_dist=probe.sample_retract_dist,
            lift_speed=probe.lift_speed,
        )

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

    def pin_name(self):
        if self.endstop_pin is None:
            return "the Z endstop"
        return "endstop_pin (%s)" % (self.endstop_pin,)

    # Sensors: True is pressed, or a normally closed probe that is absent.
    # 'print_time' says when; both of one moment cost one wait.
    def pin_triggered(self, print_time):
        return bool(self.pin_endstop.query_endstop(print_time))

    def probe_triggered(self, print_time):
        return bool(self.probe_endstop().query_endstop(print_time))

    # --- shared: waiting ---
    # The end of the last queued move
    def after_moves(self):
        eventtime = self.printer.get_reactor().monotonic()
        print_time, now, is_empty = self.toolhead.check_busy(eventtime)
        if is_empty and print_time <= now:
            return now
        return self.toolhead.get_last_move_time()

    # --- end ---

    # Right after a touch, when nothing moves: spares the wait
    def now(self):
        eventtime = self.printer.get_reactor().monotonic()
        return self.mcu.estimated_print_time(eventtime)

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

    # The point of the bed mesh that is its zero, or None
    def mesh_zero(self):
        mesh = self.printer.lookup_object("bed_mesh", None)
        calibrate = getattr(mesh, "bmc", None)
        # A part of its own since 2024-06-19 (f2df011c6)
        for owner in (getattr(calibrate, "probe_mgr", None), calibrate):
            if getattr(owner, "zero_ref_pos", None) is not None:
                return tuple(owner.zero_ref_pos)[:2]
        # Until 2024-02-15 (c92732e4f)
        index = getattr(calibrate, "relative_reference_index", None)
        if index is not None and index < len(calibrate.points):
            return tuple(calibrate.points[index])[:2]
        return None

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

    # Down to z where nothing should be yet.  None, or the toolhead Z where
    # the endstop triggered nevertheless.
    def come_down(self, endstop, z, speed):
        start_z = self.z()
        if start_z <= z:
            return None
        try:
            trigger_z = self._probing_move(endstop, z, speed)
        except self.printer.command_error as e:
            self._pass_on_shutdown(e)
            if self.is_at(z) and NO_TRIGGER in str(e):
                return None
            raise CalibrationError("%s (stopped at z=%.3f)" % (e, self.z()))
        self._check_travel(start_z, trigger_z)
        return trigger_z

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
                "the head is at z=%.3f, this touch ends at z=%.3f already:"
                " correct switch_offset, which is larger than any switch has"
                " it, or position_max of the Z axis" % (self.z(), floor)
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


# One site: approach it, touch it, come back up.  'watch' is told of every
# touch.
class Measurement(object):
    def __init__(self, host, settings, site, sampling, watch):
        self.host = host
        self.settings = settings
        self.site = site
        self.sampling = sampling
        self.watch = watch
        self.expected_z = None
        self.taken = 0
        # Where the last touch triggered; None: the head was lifted since
        self.pressed_z = None

    # Returns the samples: toolhead Z in mm
    def measure(self, travel_z, expected_z, floor):
        self.expected_z = expected_z
        try:
            return self.run(travel_z, expected_z, floor)
        except CalibrationError as e:
            raise e.__class__("%s: %s" % (self.site.name, e))

    def run(self, travel_z, expected_z, floor):
        self.go_there(travel_z)
        self.come_down(travel_z, expected_z, floor)
        return self.collect(floor)

    # What is to be pressed at this site
    def endstop(self):
        return self.host.pin_endstop

    # The other sensor of the two, which is not armed: before the first touch
    def check_arrived(self):
        pass

    # and while the head still presses.  The armed one is looked at by the
    # host, see Host.touch().
    def check_pressed(self):
        pass

    # Raises what is known of a touch that failed
    def explain(self):
        self.check_pin_open(self.host.after_moves())

    # Up first, so that nothing is hit on the way; never down to get there.
    def go_there(self, travel_z):
        settings = self.settings
        self.host.raise_to(travel_z, self.sampling.lift_speed)
        self.host.move_xy(self.site.x, self.site.y, settings.speed)
        self.check_arrived()

    # Down to where every sample begins.  'expected_z' None: slowly from the
    # travel height on, then.
    def come_down(self, travel_z, expected_z, floor):
        speed = self.settings.probing_speed
        if self.settings.first_fast:
            self.first_touch(floor)
            return
        top = travel_z
        if expected_z is not None:
            top = max(expected_z, floor) + self.sampling.retract_dist
        self.pressed_z = self.touching(
            self.host.come_down, self.endstop(), top, speed
        )

    # The first touch gets the head down; it is no sample
    def first_touch(self, floor):
        speed = self.settings.probing_speed
        self.pressed_z = self.touching(
            self.host.touch, self.endstop(), floor, speed
        )

    def collect(self, floor):
        take = functools.partial(self.sample, floor)
        return collect(take, self.sampling, self.report)

    def sample(self, floor):
        self.retract()
        self.pressed_z = self.touching(self.touch_once, floor)
        self.check_pressed()
        self.taken += 1
        self.watch.touched()
        self.report("touched at z=%.6f" % (self.pressed_z,))
        return self.pressed_z

    def touch_once(self, floor):
        return self.host.touch(self.endstop(), floor, self.sampling.speed)

    def touching(self, touch, *args):
        start_z = self.host.z()
        try:
            return touch(*args)
        except CalibrationError as e:
            if isinstance(e, NoTrigger) or self.host.is_at(start_z):
                self.explain()
            wanted = ""
            if self.expected_z is not None:
                wanted = ", expected a trigger at z=%.3f" % (self.expected_z,)
            raise e.__class__("%s%s; %s" % (e, wanted, self.remedy))

    # Up to where the next touch begins
    def retract(self):
        if self.pressed_z is None:
            return
        top = self.pressed_z + self.sampling.retract_dist
        self.host.raise_to(top, self.sampling.lift_speed)
        self.pressed_z = None

    def report(self, msg):
        self.watch.say("%s: %s" % (self.site.name, msg))

    def check_pin_open(self, print_time):
        if self.host.pin_triggered(print_time):
            raise CalibrationError(
                "%s reads triggered where nothing should press it; check it"
                " with QUERY_ENDSTOPS" % (self.host.pin_name(),)
            )

    def check_probe_attached(self, print_time):
        if self.host.probe_triggered(print_time):
            raise CalibrationError(
                "the probe reads triggered: it is not attached, or not wired"
                " as normally closed; attach it in start_gcode or"
                " before_switch_gcode, check it with QUERY_PROBE"
            )


AFTER_EXCHANGE = "home Z again (G28 Z) or add ACCEPT_CHANGE=1"


# The nozzle tip on the pin
class NozzleMeasurement(Measurement):
    remedy = (
        "home Z again (G28 Z) after any levelling; check nozzle_xy_position"
        " and the switch there; add ACCEPT_CHANGE=1 if the nozzle was exchanged"
    )

    def run(self, travel_z, expected_z, floor):
        samples = Measurement.run(self, travel_z, expected_z, floor)
        if self.settings.wiggle is not None:
            self.retract()
        return samples

    # A pin that sticks to the nozzle is shaken off before it is pulled up
    def retract(self):
        pressed = self.pressed_z is not None
        Measurement.retract(self)
        if pressed and self.settings.wiggle is not None:
            x, y = self.settings.wiggle
            speed = self.settings.speed
            self.host.move_xy(self.site.x + x, self.site.y + y, speed)
            self.host.move_xy(self.site.x, self.site.y, speed)

    def check_arrived(self):
        if self.settings.attach_after_nozzle:
            self.check_probe_absent(self.host.after_moves())

    def check_pressed(self):
        if self.settings.attach_after_nozzle:
            self.check_probe_absent(self.host.now())

    def check_probe_absent(self, print_time):
        if not self.host.probe_triggered(print_time):
            raise CalibrationError(
                "the probe is attached already, although before_switch_gcode"
                " is there to attach it, or it is not wired as normally"
                " closed; detach it in start_gcode, check it with QUERY_PROBE"
            )


# The body of the probe's switch on the same pin
class SwitchMeasurement(Measurement):
    remedy = (
        "check switch_xy_position, how the probe is seated, and that z_offset"
        " in section 'probe' is about the distance of nozzle and probe"
    )

    def check_arrived(self):
        self.check_probe_attached(self.host.after_moves())

    def explain(self):
        if self.host.probe_triggered(self.host.after_moves()):
            top = self.host.z() + self.sampling.retract_dist
            self.host.raise_to(top, self.sampling.lift_speed)
            self.check_probe_attached(self.host.after_moves())
            raise CalibrationError(
                "the plunger of the probe was pressed where only its body"
                " should meet the pin; check switch_xy_position"
            )
        Measurement.explain(self)

    # Where the pin presses the plunger, too, it looks lost until lifted
    def check_pressed(self):
        if self.host.probe_triggered(self.host.now()):
            z = self.pressed_z
            self.retract()
            self.check_probe_attached(self.host.after_moves())
            self.pressed_z = z


# The probe on the print surface, through the host's own probing, told where
# to end.
class BedMeasurement(Measurement):
    remedy = "check bed_xy_position, switch_offset and the probe"

    def __init__(self, host, settings, site, sampling, watch):
        Measurement.__init__(self, host, settings, site, sampling, watch)
        # The host's own probing while a session lasts, and whether it ends
        # at the floor
        self.probe_once = None
        self.limited = False

    def run(self, travel_z, expected_z, floor):
        self.go_there(travel_z)
        # Before the session: some hosts run deactivate_gcode after this, too,
        # and an error in it would end the session unseen
        self.come_down(travel_z, expected_z, floor)
        session = self.host.probe_session()
        limit = self.host.probe_floor(floor)
        # Up before the session ends: the host may deactivate or dock then
        lift_speed = self.sampling.lift_speed
        lift = self.host.always(
            functools.partial(self.host.raise_to, travel_z, lift_speed),
            "lifting",
        )
        with session as self.probe_once, limit as self.limited, lift:
            samples = self.collect(floor)
        self.leave(travel_z)
        return samples

    # One touch, without a session: how long is this probe?
    def look(self, travel_z, floor):
        try:
            self.go_there(travel_z)
            self.check_probe_attached(self.host.after_moves())
            self.first_touch(floor)
            z = self.pressed_z
            self.leave(travel_z)
            return z
        except CalibrationError as e:
            raise e.__class__("%s: %s" % (self.site.name, e))

    def leave(self, travel_z):
        self.host.raise_to(travel_z, self.sampling.lift_speed)
        self.pressed_z = None
        print_time = self.host.after_moves()
        self.check_pin_open(print_time)
        self.check_probe_attached(print_time)

    def endstop(self):
        return self.host.probe_endstop()

    def touch_once(self, floor):
        self.host.check_above(floor)
        if self.limited:
            return self.probe_once()
        # A host unknown to us: its probing would go on to position_min
        return Measurement.touch_once(self, floor)

    def explain(self):
        self.check_probe_attached(self.host.after_moves())


# One run: nozzle, switch, bed.
class Calibration(object):
    def __init__(self, host, settings, sites, watch):
        self.host = host
        self.settings = settings
        self.sites = sites
        self.watch = watch
        # The last good Result or None, and whether nozzle, probe and frame
        # are still those of that run
        self.last = None
        self.sure = False
        self.know(None, False)

    def know(self, last, sure):
        self.last = last
        self.sure = sure
        # Follows what the run learns; the head is lifted to it
        pin_z = expect_nozzle(self.settings, last, sure).z
        self.travel_z = travel_height(self.settings, pin_z, self.body())

    # switch - nozzle (mm) of the probe that was there last, or None
    def body(self):
        return self.last.switch - self.last.nozzle if self.sure else None

    def measure(self, attach_probe):
        settings = self.settings
        self.host.check_probe_stays()
        if not settings.attach_after_nozzle:
            # Nobody will attach it later: say so before anything is touched
            self.check_probe_attached()
        self.watch.enter("nozzle")
        nozzle_z = self.measure_nozzle()
        self.travel_z = travel_height(settings, nozzle_z, self.body())
        self.lift()
        self.watch.enter("before_switch_gcode")
        attach_probe()
        self.watch.enter("switch")
        switch_z = self.measure_switch(nozzle_z)
        self.check_geometry(switch_z - nozzle_z)
        self.watch.enter("bed")
        probe_z = self.measure_bed(nozzle_z, switch_z)
        parts = (probe_z, switch_z, nozzle_z, settings.switch_offset)
        return Result(*parts + (offset(*parts),))

    def check_probe_attached(self):
        if self.host.probe_triggered(self.host.after_moves()):
            # A PROBE leaves it pressed on the bed
            self.lift()
            switch = self.site_of_switch()
            switch.check_probe_attached(self.host.after_moves())

    def lift(self):
        if self.host.is_homed("z"):
            self.host.raise_to(self.travel_z, self.settings.pin.lift_speed)

    def measure_nozzle(self):
        samples = self.sample_nozzle()
        z = summarize(samples, self.settings.pin.result)
        homed_z = self.settings.position_endstop
        if homed_z is not None and abs(z - homed_z) > STALE_Z:
            self.watch.say(
                "nozzle: z=%.3f is far from position_endstop %.3f, at which Z"
                " was homed; home Z again (G28 Z) after any levelling"
                % (z, homed_z)
            )
        return z

    def sample_nozzle(self):
        settings = self.settings
        nozzle = NozzleMeasurement(
            self.host, settings, self.sites.nozzle, settings.pin, self.watch
        )
        expected = expect_nozzle(settings, self.last, self.sure)
        floor = nozzle_floor(settings, expected)
        return nozzle.measure(self.travel_z, expected.z, floor)

    def site_of_switch(self):
        return SwitchMeasurement(
            self.host,
            self.settings,
            self.sites.switch,
            self.settings.pin,
            self.watch,
        )

    def site_of_bed(self):
        return BedMeasurement(
            self.host,
            self.settings,
            self.sites.bed,
            self.settings.probe,
            self.watch,
        )

    def measure_switch(self, nozzle_z):
        settings, switch = self.settings, self.site_of_switch()
        expected = expect_switch(settings, nozzle_z, self.last, self.sure)
        floor = switch_floor(settings, nozzle_z, expected)
        if expected.z is None:
            floor = self.floor_from_bed(nozzle_z, floor)
        try:
            samples = switch.measure(self.travel_z, expected.z, floor)
        except NoTrigger as e:
            if expected.sure:
                exchanged = "%s; if nozzle or probe was exchanged: %s"
                raise NoTrigger(exchanged % (e, AFTER_EXCHANGE))
            if expected.z is None or switch.taken:
                raise
            floor = self.find_lower_floor(nozzle_z, floor, e)
            samples = switch.measure(self.travel_z, None, floor)
        return summarize(samples, settings.pin.result)

    # Nothing down to a floor that came from z_offset or from a probe that may
    # have been exchanged: the bed tells whether that was wrong, or the switch
    # is dead.
    def find_lower_floor(self, nozzle_z, floor, error):
        self.watch.say("%s; looking at the bed how long the probe is" % error)
        hard = switch_floor(self.settings, nozzle_z, Expected(None, False))
        try:
            lowest = self.lowest_switch(nozzle_z)
        except CalibrationError as e:
            self.watch.say("%s" % (e,))
            raise error
        if max(lowest, hard) >= floor:
            raise error
        return max(lowest, hard)

    # Nothing known of the probe: the bed tells how long it is before its body
    # goes down where it may meet something else than the pin.
    def floor_from_bed(self, nozzle_z, hard):
        try:
            return max(hard, self.lowest_switch(nozzle_z))
        except NoTrigger as e:
            text = "%s; searching for the switch down to z=%.3f"
            self.watch.say(text % (e, hard))
            return hard

    def lowest_switch(self, nozzle_z):
        settings = self.settings
        floor = unmeasured_bed_floor(settings, nozzle_z)
        if floor >= self.travel_z:
            raise NoTrigger(
                "bed: with offset_margins this wide the nozzle may meet it"
                " first, below z=%.3f" % (floor,)
            )
        bed_z = self.site_of_bed().look(self.travel_z, floor)
        return lowest_switch(settings, nozzle_z, bed_z)

    # Only against a run with nothing exchanged and Z homed no more
    def check_geometry(self, body):
        if not self.sure or abs(body - self.body()) <= GEOMETRY_JUMP:
            return
        raise CalibrationError(
            "switch - nozzle is %.3f mm and was %.3f mm in the last good run;"
            " check how the probe is seated and that the nozzle is tight; if"
            " one was exchanged: %s" % (body, self.body(), AFTER_EXCHANGE)
        )

    def measure_bed(self, nozzle_z, switch_z):
        settings = self.settings
        expected = expect_bed(settings, nozzle_z, switch_z, self.last)
        self.travel_z = travel_height_to_bed(settings, nozzle_z, switch_z)
        floor = bed_floor(settings, nozzle_z, switch_z)
        samples = self.site_of_bed().measure(self.travel_z, expected.z, floor)
        return summarize(samples, settings.probe.result)


######################################################################
# Commands
######################################################################

MM = "write a distance in mm"
MM_S = "write a speed in mm/s"
X_Y = "write X and Y in mm, such as 100,100"
X_Y_OFFSETS = "write the distances in X and Y in mm, such as -2,-24.5"


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
    "nozzle_xy_position",
    "switch_xy_position",
    "switch_xy_offsets",
    "bed_xy_position",
    "wiggle_xy_offsets",
    "switch_offset",
    "offset_margins",
    "travel_margin",
    "samples",
    "samples_tolerance",
    "samples_tolerance_retries",
    "samples_result",
    "safe_z_height",
    "position_min",
    "speed",
    "lift_speed",
    "probing_speed",
    "probing_second_speed",
    "probing_retract_dist",
    "probing_first_fast",
    "start_gcode",
    "before_switch_gcode",
    "end_gcode",
    "offset_gcode",
    "error_gcode",
    "endstop_pin",
    "probe_nozzle_x",
    "probe_nozzle_y",
    "probe_switch_x",
    "probe_switch_y",
    "probe_bed_x",
    "probe_bed_y",
    "max_deviation",
    "clearance",
)


# What other plugins and sections call it.
ELSEWHERE = (
    ("calibration_endstop_pin", "endstop_pin"),
    ("homing_speed", "probing_speed"),
    ("second_homing_speed", "probing_second_speed"),
    ("homing_retract_dist", "probing_retract_dist"),
)


# The host would refuse it, too, but without a way out.
def check_options(config):
    for option in config.get_prefix_options(""):
        if option in OPTIONS:
            continue
        similar = difflib.get_close_matches(option, OPTIONS, 1, 0.8)
        meant = dict(ELSEWHERE).get(option, "".join(similar))
        remedy = "is '%s' meant?" % (meant,) if meant else "remove it"
        raise config.error(
            "Option '%s' in section '%s' is not known; %s"
            % (option, config.get_name(), remedy)
        )


# Options of older releases; 'lines' collects what the user is told.
class OldNames(object):
    def __init__(self, config):
        self.config = config
        self.lines = []

    # The text under the old name for an option that is not given, or None
    def text_of(self, old, new):
        text = self.config.get(old, None)
        if text is None:
            return None
        if self.config.get(new, None) is not None:
            self.tell("'%s' is ignored, '%s' is given" % (old, new))
            return None
        self.tell("'%s' is now called '%s'" % (old, new))
        return text

    # probe_<name>_x and _y
    def site(self, name):
        olds = ["probe_%s_%s" % (name, axis) for axis in "xy"]
        new = name + "_xy_position"
        texts = [self.config.get(old, None) for old in olds]
        if texts == [None, None]:
            return None
        if None in texts:
            raise self.config.error(
                "Option '%s' in section '%s': only one of '%s' and '%s' is"
                " given; write both, better as '%s: X,Y'"
                % ((new, self.config.get_name()) + tuple(olds) + (new,))
            )
        if self.config.get(new, None) is not None:
            self.tell(
                "'%s' and '%s' are ignored, '%s' is given"
                % (olds[0], olds[1], new),
                "options",
            )
            return None
        xy = [read_number(self.config, old, parse_number, MM) for old in olds]
        self.tell(
            "'%s' and '%s' are now '%s: %g,%g'"
            % (olds[0], olds[1], new, xy[0], xy[1]),
            "options",
        )
        return option_site(self.config, name, " and ".join(olds), xy)

    def tell(self, text, options="option"):
        self.lines.append("z_calibration: %s %s" % (options, text))


def option_site(config, name, option, pair):
    origin = "Option '%s: %g,%g' in section '%s'"
    origin %= (option, pair[0], pair[1], config.get_name())
    return Site(name, pair[0], pair[1], origin)


def read_site(config, name, old_names):
    option = name + "_xy_position"
    pair = read_option(config, option, parse_pair, X_Y)
    old = old_names.site(name)
    if pair is None:
        return old
    return option_site(config, name, option, pair)


# Where Z is homed on the pin itself, [safe_z_home] has its place.
def read_nozzle_site(config, host, old_names):
    site = read_site(config, "nozzle", old_names)
    if site is not None or host.endstop_pin is not None:
        return site
    if not config.has_section("safe_z_home"):
        return None
    home = config.getsection("safe_z_home")
    text = home.get("home_xy_position", None, note_valid=False)
    if text is None:
        return None
    try:
        pair = parse_pair(text)
    except CalibrationError:
        # The host complains of it in its own words
        return None
    return option_site(home, "nozzle", "home_xy_position", pair)


def read_margins(config, old_names):
    remedy = "write 'low,high' in mm, such as -1.0,1.0, or one value for both"
    option = "offset_margins"
    margins = read_option(config, option, parse_margins, remedy)
    old = read_option(config, "max_deviation", parse_margins, remedy)
    if old_names.text_of("max_deviation", option) is not None:
        return old
    return OFFSET_MARGINS if margins is None else margins


def read_safe_z(config, old_names):
    safe_z = read_number(config, "safe_z_height", parse_positive, MM)
    # 0 was "as the probe has it"
    old = read_number(config, "clearance", parse_not_negative, MM)
    if old_names.text_of("clearance", "safe_z_height") is not None:
        return old or None
    return safe_z


def read_pin_sampling(config, z_axis):
    result = "write median or average"
    speed = z_axis.second_homing_speed
    retract = z_axis.homing_retract_dist or FALLBACK_RETRACT
    number = functools.partial(read_number, config)
    return Sampling(
        samples=read_count(config, "samples", 1),
        tolerance=number("samples_tolerance", parse_not_negative, MM),
        retries=read_count(config, "samples_tolerance_retries", 0),
        result=read_option(config, "samples_result", parse_result, result),
        speed=number("probing_second_speed", parse_positive, MM_S, speed),
        retract_dist=number(
            "probing_retract_dist", parse_positive, MM, retract
        ),
        lift_speed=number("lift_speed", parse_positive, MM_S),
    )


def read_position_min(config, host, old_names):
    axis = host.z_axis
    own = read_number(config, "position_min", parse_number, MM)
    if own is None:
        return axis.position_min
    # Where the probe homes Z there is no such height; that is refused later
    homed_by_pin = host.endstop_pin is None and not is_of_probe(
        axis.endstop_pin
    )
    if homed_by_pin and own > axis.position_endstop:
        raise config.error(
            "Option 'position_min' in section 'z_calibration': %.3f is above"
            " position_endstop (%.3f) of section '%s', no touch could reach"
            " the pin; remove it or write a smaller value"
            % (own, axis.position_endstop, axis.section)
        )
    if own < axis.position_min:
        old_names.tell(
            "'position_min: %g' is ignored, section '%s' ends at %g"
            % (own, axis.section, axis.position_min)
        )
    return max(own, axis.position_min)


def read_settings(config, host, old_names):
    axis = host.z_axis
    number = functools.partial(read_number, config)
    before_switch_gcode = config.get("before_switch_gcode", "")
    return Settings(
        nozzle=read_nozzle_site(config, host, old_names),
        switch=read_site(config, "switch", old_names),
        switch_xy_offsets=read_option(
            config, "switch_xy_offsets", parse_pair, X_Y_OFFSETS
        ),
        bed=read_site(config, "bed", old_names),
        wiggle=read_wiggle(config),
        switch_offset=number(
            "switch_offset",
            parse_not_negative,
            "write the distance from switch body to trigger point, 0 mm or"
            " more",
        ),
        attach_after_nozzle=attaches_probe(
            before_switch_gcode, config.get("start_gcode", "")
        ),
        first_fast=read_first_fast(config),
        offset_margins=read_margins(config, old_names),
        travel_margin=number(
            "travel_margin", parse_positive, MM, TRAVEL_MARGIN
        ),
        position_endstop=(
            axis.position_endstop if host.endstop_pin is None else None
        ),
        position_min=read_position_min(config, host, old_names),
        safe_z_height=read_safe_z(config, old_names),
        speed=number("speed", parse_positive, MM_S, TRAVEL_SPEED),
        probing_speed=number(
            "probing_speed", parse_positive, MM_S, axis.homing_speed
        ),
        pin=read_pin_sampling(config, axis),
        # From the probe and the axes, when klippy connects
        position_max=None,
        z_offset=None,
        probe=None,
    )


def read_wiggle(config):
    pair = read_option(config, "wiggle_xy_offsets", parse_pair, X_Y_OFFSETS)
    return pair if pair and any(pair) else None


def read_first_fast(config):
    remedy = "write true or false"
    value = read_option(
        config, "probing_first_fast", parse_switch, remedy, False
    )
    if config.get("probing_first_fast", None) is not None:
        config.getboolean("probing_first_fast")
    return value


# The user's G-code; 'offset' and 'error' are None where not configured.
Templates = collections.namedtuple(
    "Templates", "start before_switch end offset error"
)


def load_templates(config):
    printer = config.get_printer()
    gcode_macro = printer.load_object(config, "gcode_macro")
    loaded = []
    for part in Templates._fields:
        name = part + "_gcode"
        if part in ("offset", "error") and not config.get(name, "").strip():
            loaded.append(None)
            continue
        try:
            loaded.append(gcode_macro.load_template(config, name, ""))
        except printer.command_error as e:
            # What newer hosts raise would come out as an internal error.
            text = "Option '%s' in section '%s': %s"
            raise config.error(text % (name, config.get_name(), e))
    return Templates(*loaded)


# In a template as '"{params.NAME}"': nothing in the text may end that string
# or begin a comment or a command.
def as_param(value):
    text = " ".join(str(value).split())
    for found, instead in ((";", ","), ("#", ""), ('"', "'"), ("\\", "/")):
        text = text.replace(found, instead)
    return text


# As a macro gets its parameters: params.NAME
def run_with_params(template, **params):
    params = {name: as_param(value) for name, value in params.items()}
    context = template.create_template_context()
    context["params"] = params
    context["rawparams"] = " ".join("%s=%s" % item for item in params.items())
    template.run_gcode_from_command(context)


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


# The object behind [z_calibration]
class ZCalibration(object):
    def __init__(self, config):
        logging.info("z_calibration %s", __version__)
        check_options(config)
        self.printer = config.get_printer()
        self.gcode = self.printer.lookup_object("gcode")
        self.host = Host(config)
        self.frame = Frame(self.host)
        self.old_names = OldNames(config)
        self.settings = read_settings(config, self.host, self.old_names)
        self.templates = load_templates(config)
        self.watch = Watch(self.gcode.respond_info)
        # Of the run that is under way; of the last one that was applied
        self.measured = None
        self.last_result = None
        self.mark = None
        register = self.printer.register_event_handler
        register("klippy:connect", self.connect)
        register("klippy:ready", self.tell_old_names)
        register("klippy:ready", self.tell_mesh_zero)
        for name in (
            "CALIBRATE_Z",
            "PROBE_Z_ACCURACY",
            "CALCULATE_SWITCH_OFFSET",
        ):
            handler = getattr(self, "cmd_" + name)
            text = getattr(self, "cmd_%s_help" % (name,))
            self.gcode.register_command(name, handler, desc=text)

    # Set-up
    def connect(self):
        host = self.host
        host.connect()
        self.settings = complete(
            self.settings,
            host.probe_sampling(),
            host.probe_offsets()[2],
            host.axis_limits()[2][1],
        )
        try:
            self.check_probe_settings()
            self.check_heights()
            self.check_sites()
        except CalibrationError as e:
            raise self.printer.config_error(str(e))

    def tell_old_names(self):
        for line in self.old_names.lines:
            self.gcode.respond_info(line)

    # With a mesh loaded, Z=0 is right where the mesh is zero.
    def tell_mesh_zero(self):
        bed, zero = self.settings.bed, self.host.mesh_zero()
        if bed is None or zero is None:
            return
        if math.hypot(bed.x - zero[0], bed.y - zero[1]) > MESH_ZERO_NEAR:
            self.gcode.respond_info(
                "z_calibration: bed_xy_position (%.3f, %.3f) is not where the"
                " bed mesh is zero (%.3f, %.3f): with a mesh loaded, the gap is"
                " wrong by its height there; leave bed_xy_position out, or set"
                " zero_reference_position of section 'bed_mesh' to it"
                % (bed.x, bed.y, zero[0], zero[1])
            )

    def check_probe_settings(self):
        result = self.settings.probe.result
        if result not in ("median", "average"):
            raise CalibrationError(
                "Option 'samples_result: %s' in section 'probe' is not known to"
                " z_calibration; set it to median or average" % (result,)
            )

    # Both must fit, the one the user wants and the one the pin needs.
    def check_heights(self):
        settings, section = self.settings, self.host.z_axis.section
        high, safe_z = settings.position_max, settings.safe_z_height
        text = (
            "The travel height of z_calibration, z=%.3f, must lie within"
            " position_max (%.3f) of section '%s'; %s"
        )
        if safe_z > high:
            remedy = (
                "lower safe_z_height in section 'z_calibration', or set"
                " z_offset in section 'probe' to the real distance between"
                " nozzle and probe"
            )
            raise CalibrationError(text % (safe_z, high, section, remedy))
        pin_z = settings.position_endstop
        free = settings._replace(position_max=float("inf"))
        above_pin = travel_height(free, pin_z, None)
        if above_pin > high:
            remedy = (
                "correct position_endstop there, z_offset in section 'probe' or"
                " travel_margin in section 'z_calibration'"
            )
            raise CalibrationError(text % (above_pin, high, section, remedy))

    # What is configured; what comes with a command is checked there.
    def check_sites(self):
        settings = self.settings
        if settings.nozzle is not None:
            self.check_reach(settings.nozzle, settings.wiggle or (0.0, 0.0))
        switch = self.switch_site(settings.nozzle, settings.switch)
        if switch is not None:
            self.check_reach(switch)
        bed = self.bed_site(settings.bed)
        if bed is not None:
            self.check_reach(bed)
            self.check_apart(switch, bed)

    # The floor of the bed lies below the pin: a body that is still on it
    # would be pressed down to there.
    def check_apart(self, switch, bed):
        if switch is None:
            return
        apart = math.hypot(bed.x - switch.x, bed.y - switch.y)
        if apart < SWITCH_NEAR:
            raise CalibrationError(
                "%s puts the head %.1f mm from where it touches the switch, so"
                " that the probe's body would press the Z endstop again; choose"
                " a point of the bed at least %g mm away"
                % (bed.origin, apart, SWITCH_NEAR)
            )

    def check_reach(self, site, wiggle=(0.0, 0.0)):
        limits = self.host.axis_limits()
        shift = ""
        if site.name == "bed":
            shift = ", the probe's offset included"
        for axis, xy, more, (low, high) in zip("XY", site[1:3], wiggle, limits):
            if not low <= xy <= high:
                raise CalibrationError(
                    "%s needs the head at %s=%.3f%s, outside its %.3f to %.3f;"
                    " choose a point that it can reach"
                    % (site.origin, axis, xy, shift, low, high)
                )
            if not low <= xy + more <= high:
                raise CalibrationError(
                    "Option 'wiggle_xy_offsets' in section 'z_calibration'"
                    " moves the head to %s=%.3f, outside its %.3f to %.3f;"
                    " choose the other direction" % (axis, xy + more, low, high)
                )

    # Places: of the nozzle, from a Site or None
    def switch_site(self, nozzle, switch):
        offsets = self.settings.switch_xy_offsets
        if switch is not None or offsets is None:
            return switch
        for axis, distance in zip("XY", offsets):
            if abs(distance) > LARGEST_SWITCH_DISTANCE:
                raise CalibrationError(
                    "Option 'switch_xy_offsets' in section 'z_calibration': %g"
                    " mm in %s is no distance from the nozzle to the switch;"
                    " if it is a position, write it as switch_xy_position"
                    % (distance, axis)
                )
        if nozzle is None:
            return None
        x, y = nozzle.x + offsets[0], nozzle.y + offsets[1]
        origin = "Option 'switch_xy_offsets: %g,%g' in section 'z_calibration'"
        return Site("switch", x, y, origin % offsets)

    # The bed is named where the probe is to touch it, the other sites where
    # the head is to stand.
    def bed_site(self, bed):
        if bed is None:
            zero = self.host.mesh_zero()
            if zero is None:
                return None
            origin = "The zero reference position of section 'bed_mesh'"
            bed = Site("bed", zero[0], zero[1], origin)
        x_offset, y_offset = self.host.probe_offsets()[:2]
        return bed._replace(x=bed.x - x_offset, y=bed.y - y_offset)

    # Status: 'last_query' and 'last_z_offset' as upstream has them.
    def get_status(self, eventtime):
        result = self.last_result
        reason = self.why_not()
        status = {
            "last_query": result is not None,
            "last_z_offset": 0.0 if result is None else result.offset,
            "last_result": {} if result is None else dict(result._asdict()),
            "valid": not reason,
            "reason": reason,
        }
        status.update(self.watch.status())
        return status

    # Parameters of commands
    def param(self, gcmd, name, parse, remedy, default=None):
        text = gcmd.get(name, None)
        if text is None:
            return default
        try:
            return parse(text.strip())
        except CalibrationError as e:
            raise CalibrationError("%s: %s; %s" % (name, e, remedy))

    def site_param(self, gcmd, name, default):
        param = name.upper() + "_POSITION"
        pair = self.param(gcmd, param, parse_pair, X_Y)
        if pair is None:
            return default
        return Site(name, pair[0], pair[1], "%s=%g,%g" % ((param,) + pair))

    # The places of a run, checked.
    def sites(self, gcmd):
        settings = self.settings
        nozzle = self.nozzle_site(gcmd)
        switch = self.site_param(gcmd, "switch", settings.switch)
        switch = self.switch_site(nozzle, switch)
        bed = self.bed_site(self.site_param(gcmd, "bed", settings.bed))
        if switch is None:
            where = "switch_xy_position or switch_xy_offsets in section"
            raise CalibrationError(
                self.no_place("switch", where + " 'z_calibration'")
            )
        if bed is None:
            where = "bed_xy_position in section 'z_calibration', or"
            where += " zero_reference_position in section 'bed_mesh'"
            raise CalibrationError(self.no_place("bed", where))
        self.check_reach(switch)
        self.check_reach(bed)
        self.check_apart(switch, bed)
        return Sites(nozzle, switch, bed)

    def nozzle_site(self, gcmd):
        nozzle = self.site_param(gcmd, "nozzle", self.settings.nozzle)
        if nozzle is None:
            where = "nozzle_xy_position in section 'z_calibration'"
            raise CalibrationError(self.no_place("nozzle", where))
        self.check_reach(nozzle, self.settings.wiggle or (0.0, 0.0))
        return nozzle

    def no_place(self, name, where):
        return "no place for the %s: set %s, or add %s_POSITION=X,Y" % (
            name,
            where,
            name.upper(),
        )

    def switch_offset(self, gcmd, default):
        value = self.param(
            gcmd, "SWITCH_OFFSET", parse_not_negative, MM, default
        )
        if value is None:
            raise CalibrationError(
                "no switch_offset: set it in section 'z_calibration', or add"
                " SWITCH_OFFSET=mm"
            )
        return value

    # From a template of its own it would never end
    def check_idle(self, gcmd):
        if self.watch.phase != "idle":
            raise gcmd.error(
                "z_calibration: a measurement is under way (%s); start another"
                " one when it has ended" % (self.watch.phase,)
            )

    def begin(self, gcmd):
        settings = self.settings
        wanted = 2 * settings.pin.samples + settings.probe.samples
        self.watch.begin(gcmd.respond_info, wanted)

    # CALIBRATE_Z
    cmd_CALIBRATE_Z_help = "Measure nozzle, switch and bed, set the Z offset"

    def cmd_CALIBRATE_Z(self, gcmd):
        self.check_idle(gcmd)
        before = self.host.gcode_offset()
        self.begin(gcmd)
        self.watch.enter("start_gcode")
        self.measured = None
        try:
            mark = self.calibrate(gcmd)
            self.use_offset(self.measured.offset)
        except CalibrationError as e:
            self.failed(e, before)
            raise gcmd.error("z_calibration: %s" % (e,))
        except self.printer.command_error as e:
            self.failed(e, before)
            raise
        finally:
            self.watch.end()
        self.last_result = self.measured
        self.mark = mark
        self.report(gcmd, self.measured)

    # end_gcode runs before the offset is applied: the way to the dock does
    # not shift with the offset, and a probe that could not be put away
    # leaves everything as it was.
    def calibrate(self, gcmd):
        host = self.host
        settings = self.settings._replace(
            switch_offset=self.switch_offset(gcmd, self.settings.switch_offset)
        )
        accept = self.param(gcmd, "ACCEPT_CHANGE", parse_switch, "write 1")
        sites = self.sites(gcmd)
        run = Calibration(host, settings, sites, self.watch)
        dock = host.always(self.dock, "end_gcode")
        with dock, host.always(run.lift, "lifting"):
            self.run_user_gcode(self.templates.start)
            if not accept:
                run.know(self.last_result, not self.why_not())
            attach = functools.partial(self.attach_probe, self.frame.mark())
            result = run.measure(attach)
            measured_in = self.frame.mark()
            check_offset(result, settings.offset_margins)
            self.measured = result
        host.check_homed()
        if self.frame.moved_since(measured_in) == LEVELLED:
            raise CalibrationError(
                "%s in end_gcode: the offset does not hold then; do it before"
                " CALIBRATE_Z" % (LEVELLED,)
            )
        return measured_in

    def attach_probe(self, mark):
        self.templates.before_switch.run_gcode_from_command()
        moved = self.frame.moved_since(mark)
        if moved:
            raise CalibrationError(
                "%s in before_switch_gcode: nozzle and switch cannot be"
                " compared then; do it before CALIBRATE_Z" % (moved,)
            )
        self.host.check_homed()

    # Why the last result does not hold (any more); empty: it does
    def why_not(self):
        if self.last_result is None:
            return "not calibrated yet"
        return self.frame.moved_since(self.mark)

    def dock(self):
        self.watch.enter("end_gcode")
        self.templates.end.run_gcode_from_command()

    # User G-code may home, move, or turn the motors off.
    def run_user_gcode(self, template):
        template.run_gcode_from_command()
        self.host.check_homed()

    def report(self, gcmd, result):
        if self.why_not():
            self.watch.say(
                "%s after measuring, in end_gcode or offset_gcode: the offset"
                " holds no more" % (self.why_not(),)
            )
        gcmd.respond_info(
            "Z-CALIBRATION: probe=%.3f - (switch=%.3f - nozzle=%.3f"
            " + switch_offset=%.3f) --> new offset=%.6f" % result
        )
        homed_z = self.settings.position_endstop
        if homed_z is not None and abs(result.offset) > LARGE_OFFSET:
            gcmd.respond_info(
                "HINT: z position_endstop=%.3f - offset=%.6f --> possible z"
                " position_endstop=%.3f"
                % (homed_z, result.offset, homed_z - result.offset)
            )

    def use_offset(self, z_offset):
        if self.templates.offset is None:
            self.host.set_gcode_offset(z_offset)
            return
        text = "%.6f" % (z_offset,)
        run_with_params(self.templates.offset, Z=text)

    # Whatever the user's G-code has done to it, the offset is as before.
    def failed(self, error, z_offset):
        if self.printer.is_shutdown():
            return
        if self.measured is not None:
            text = "the measured offset %.6f was not applied"
            self.watch.say(text % (self.measured.offset,))
        if self.host.gcode_offset() != z_offset:
            self.host.set_gcode_offset(z_offset)
        if self.templates.error is not None:
            self.run_error_gcode(error)

    # Its own error must not hide the one it is told of.
    def run_error_gcode(self, error):
        self.watch.enter("error_gcode")
        try:
            run_with_params(self.templates.error, ERROR=error)
        except self.printer.command_error as e:
            logging.exception("z_calibration: error_gcode failed, too")
            self.watch.say("error_gcode failed, too: %s" % (e,))

    # PROBE_Z_ACCURACY
    cmd_PROBE_Z_ACCURACY_help = "Touch the Z endstop with the nozzle repeatedly"

    def cmd_PROBE_Z_ACCURACY(self, gcmd):
        self.check_idle(gcmd)
        self.begin(gcmd)
        self.watch.enter("nozzle")
        try:
            self.measure_accuracy(gcmd)
        except CalibrationError as e:
            raise gcmd.error("z_calibration: %s" % (e,))
        finally:
            self.watch.end()

    def measure_accuracy(self, gcmd):
        pin, host = self.settings.pin, self.host
        count = functools.partial(parse_count, smallest=1)
        number = functools.partial(self.param, gcmd)
        pin = pin._replace(
            samples=number("SAMPLES", count, "write a count", pin.samples),
            speed=number("PROBE_SPEED", parse_positive, MM_S, pin.speed),
            lift_speed=number(
                "LIFT_SPEED", parse_positive, MM_S, pin.lift_speed
            ),
            retract_dist=number(
                "SAMPLE_RETRACT_DIST", parse_positive, MM, pin.retract_dist
            ),
            # The spread is what is asked for
            tolerance=float("inf"),
        )
        nozzle = self.nozzle_site(gcmd)
        host.check_homed()
        settings = self.settings._replace(pin=pin)
        run = Calibration(host, settings, Sites(nozzle, None, None), self.watch)
        run.know(self.last_result, not self.why_not())
        gcmd.respond_info(
            "PROBE_Z_ACCURACY at X:%.3f Y:%.3f (samples=%d retract=%.3f"
            " speed=%.1f lift_speed=%.1f)"
            % (
                nozzle.x,
                nozzle.y,
                pin.samples,
                pin.retract_dist,
                pin.speed,
                pin.lift_speed,
            )
        )
        with host.always(run.lift, "lifting"):
            self.watch.wanted = pin.samples
            samples = run.sample_nozzle()
        gcmd.respond_info(
            "probe z accuracy results: maximum %.6f, minimum %.6f, range"
            " %.6f, average %.6f, median %.6f, standard deviation %.6f"
            % (
                max(samples),
                min(samples),
                max(samples) - min(samples),
                summarize(samples, "average"),
                summarize(samples, "median"),
                deviation(samples),
            )
        )

    # CALCULATE_SWITCH_OFFSET
    cmd_CALCULATE_SWITCH_OFFSET_help = (
        "Calculate switch_offset with the nozzle moved to where Z=0 should be"
    )

    def cmd_CALCULATE_SWITCH_OFFSET(self, gcmd):
        try:
            self.calculate_switch_offset(gcmd)
        except CalibrationError as e:
            raise gcmd.error("z_calibration: %s" % (e,))

    def calculate_switch_offset(self, gcmd):
        result, reason = self.last_result, self.why_not()
        if reason:
            raise CalibrationError(
                "%s; run CALIBRATE_Z first, then move the nozzle to where Z=0"
                " should be" % (reason,)
            )
        old = self.switch_offset(gcmd, result.switch_offset)
        save = self.param(gcmd, "SAVE", parse_switch, "write 1", False)
        z = self.host.z()
        new = corrected_switch_offset(old, z, result.offset)
        text = (
            "switch_offset=%.3f - (current_z=%.3f - z_offset=%.3f)"
            " --> new switch_offset=%.3f" % (old, z, result.offset, new)
        )
        if new < 0.0:
            raise CalibrationError(
                "%s, which cannot be negative; the nozzle is still too far"
                " from the bed, or the pin does not press the switch body"
                % (text,)
            )
        gcmd.respond_info("z_calibration: " + text)
        if save:
            self.save_switch_offset(gcmd, new)

    def save_switch_offset(self, gcmd, switch_offset):
        config = self.printer.lookup_object("configfile")
        config.set("z_calibration", "switch_offset", "%.3f" % (switch_offset,))
        gcmd.respond_info(
            "z_calibration: switch_offset: %.3f\nThe SAVE_CONFIG command will"
            " update the printer config file\nwith the above and restart the"
            " printer." % (switch_offset,)
        )


def load_config(config):
    return ZCalibration(config)
