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
# No touch made here travels lower than a usable result can lie: see the
# *_floor() functions.  A lost probe or a dead switch then ends with the nozzle
# in the air.  Only the probe's own samples on the bed have no such floor.
from __future__ import division

import collections
import contextlib
import functools
import logging
import math

######################################################################
# Constants
######################################################################

__version__ = "0.1.0"

# Results outside these limits (mm) are refused: the homing is outdated or
# something was touched that should not have been.
OFFSET_MARGINS = (-1.0, 1.0)

# How far (mm) below the expected height a touch may still look.
TRAVEL_MARGIN = 1.0

# The switch body hangs at least this far (mm) below the nozzle tip: a probe
# with less could not reach the bed before the nozzle does.
BODY_BELOW_NOZZLE = 1.0

# Travel height (mm) where twice the probe's z_offset is no real height.
SMALLEST_SAFE_Z = 3.0
FALLBACK_SAFE_Z = 20.0

# Lift (mm) between two touches where homing_retract_dist is 0, which is
# right for homing only: without a lift the next touch starts on a pressed
# switch.  2 mm is more than the hysteresis of any common micro switch.
FALLBACK_RETRACT = 2.0

# XY speed (mm/s) between the sites.
TRAVEL_SPEED = 50.0


######################################################################
# Records and maths
######################################################################


# A condition that ends the run; section 5 shows it to the user.
class CalibrationError(Exception):
    pass


# Where something is touched (mm); 'name' is the word used in messages and in
# the option <name>_xy_position.
Site = collections.namedtuple("Site", "name x y")

# One measured height: 'z' is the toolhead Z at the trigger, summarized from
# 'samples' (mm).
Touch = collections.namedtuple("Touch", "z samples")

# The parts and the outcome of one calibration (mm); see the header.
Result = collections.namedtuple(
    "Result", "probe switch nozzle switch_offset offset"
)

# Everything a run depends on: mm and mm/s.  None stands for "as the probe
# has it" until complete() has filled it in.
Settings = collections.namedtuple(
    "Settings",
    "nozzle switch bed switch_offset attach_after_nozzle"
    " offset_margins travel_margin position_endstop position_min"
    " safe_z_height speed lift_speed"
    " probing_second_speed probing_retract_dist bed_speed"
    " samples samples_tolerance samples_tolerance_retries samples_result",
)


def parse_number(text):
    try:
        value = float(text)
    except ValueError:
        raise CalibrationError("'%s' is not a number" % (text,))
    if math.isnan(value) or math.isinf(value):
        raise CalibrationError("'%s' is not a finite number" % (text,))
    return value


# "x, y" -> (x, y)
def parse_pair(text):
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2:
        raise CalibrationError("'%s' is not a pair of numbers" % (text,))
    return parse_number(parts[0]), parse_number(parts[1])


def parse_not_negative(text):
    value = parse_number(text)
    if value < 0.0:
        raise CalibrationError("'%s' is negative" % (text,))
    return value


def summarize(samples, method):
    ordered = sorted(samples)
    middle = len(ordered) // 2
    if method == "average":
        return math.fsum(ordered) / len(ordered)
    if len(ordered) % 2:
        return ordered[middle]
    return (ordered[middle - 1] + ordered[middle]) / 2.0


# Call touch(), which returns a height, until the wanted number of samples
# agrees.  A sample that does not agree starts the series again.
def collect(touch, settings, say):
    tolerance = settings.samples_tolerance
    retries_left = settings.samples_tolerance_retries
    samples = []
    while len(samples) < settings.samples:
        samples.append(touch())
        spread = max(samples) - min(samples)
        if spread <= tolerance:
            continue
        text = "samples differ by %.4f mm, samples_tolerance is %.4f mm; %s"
        if not retries_left:
            remedy = "clean the nozzle and check the switch for play"
            raise CalibrationError(text % (spread, tolerance, remedy))
        say(text % (spread, tolerance, "trying again"))
        retries_left -= 1
        samples = []
    return Touch(summarize(samples, settings.samples_result), tuple(samples))


def offset(probe, switch, nozzle, switch_offset):
    return probe - (switch - nozzle + switch_offset)


# Lowest useful toolhead Z of each touch.  The nozzle meets the pin where Z
# was homed, give or take what the margins allow.
def nozzle_floor(settings):
    reach = max(settings.travel_margin, -settings.offset_margins[0])
    return max(settings.position_min, settings.position_endstop - reach)


# The probe's z_offset would be tighter, but many configurations hold a value
# there that was never measured.
def switch_floor(settings, nozzle_z):
    return max(settings.position_min, nozzle_z + BODY_BELOW_NOZZLE)


# Below this the offset would be less than the lower margin.
def bed_floor(settings, nozzle_z, switch_z):
    gap = switch_z - nozzle_z + settings.switch_offset
    return max(settings.position_min, gap + settings.offset_margins[0])


def check_offset(result, margins):
    low, high = margins
    if low <= result.offset <= high:
        return
    raise CalibrationError(
        "offset %.3f is outside the allowed %.3f to %.3f"
        " (probe=%.3f switch=%.3f nozzle=%.3f); home Z again after any"
        " levelling, then check the three positions and position_endstop"
        % ((result.offset, low, high) + result[:3])
    )


def default_safe_z(probe_z_offset):
    safe_z = 2.0 * probe_z_offset
    return safe_z if safe_z >= SMALLEST_SAFE_Z else FALLBACK_SAFE_Z


# Let the probe decide what the user left open.
def complete(settings, probe_params, probe_z_offset):
    defaults = dict(probe_params)
    defaults["bed_speed"] = probe_params["probe_speed"]
    # Also over a pin that stands high the probe has to pass
    clear_of_pin = settings.position_endstop + probe_z_offset
    defaults["safe_z_height"] = max(
        default_safe_z(probe_z_offset), clear_of_pin + settings.travel_margin
    )
    left_open = [n for n in settings._fields if getattr(settings, n) is None]
    return settings._replace(**{name: defaults[name] for name in left_open})


######################################################################
# Host
######################################################################

# The section that configures the Z axis, and its options that matter here.
ZAxis = collections.namedtuple(
    "ZAxis",
    "section endstop_pin position_endstop position_min"
    " second_homing_speed homing_retract_dist",
)


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
        second_homing_speed=number("second_homing_speed", homing_speed / 2.0),
        homing_retract_dist=number("homing_retract_dist", 5.0),
    )


# What probing_move() and a state query need from an endstop object.
ENDSTOP_METHODS = ("get_steppers", "home_start", "home_wait", "query_endstop")


def is_endstop(candidate):
    methods = [getattr(candidate, name, None) for name in ENDSTOP_METHODS]
    return all(callable(m) for m in methods) and bool(candidate.get_steppers())


# Everything the module wants from the printer.  The only place that knows in
# which respects hosts differ; the difference is always asked of the object,
# never of a version number.
class Host(object):
    def __init__(self, config):
        self.printer = config.get_printer()
        self.gcode = self.printer.lookup_object("gcode")
        self.query_endstops = self.printer.load_object(config, "query_endstops")
        self.z_axis = read_z_axis(config)
        # The others exist from klippy:connect on.
        self.toolhead = self.probe = self.z_endstop = None

    def connect(self):
        self.toolhead = self.printer.lookup_object("toolhead")
        self.z_endstop = self._find_z_endstop()
        self.probe = self._find_probe()

    # Z endstop
    def _find_z_endstop(self):
        # Registered as "z" until 2025-05-06 (cc6736c3e) and on Kalico, since
        # then under the name of the section.
        axis = self.z_axis
        names = (axis.section, axis.section.split()[-1].replace("stepper_", ""))
        where = "Option 'endstop_pin: %s' in section '%s'" % (
            axis.endstop_pin,
            axis.section,
        )
        for endstop, name in self.query_endstops.endstops:
            if name in names:
                self._check_z_endstop(endstop, where)
                return endstop
        raise self.printer.config_error(
            "%s: the printer knows no endstop of the name %s; the Z axis needs"
            " a switch that the nozzle can press" % (where, " or ".join(names))
        )

    def _check_z_endstop(self, endstop, where):
        # Hosts themselves tell a virtual endstop by this method.
        if hasattr(endstop, "get_position_endstop"):
            raise self.printer.config_error(
                "%s is the probe: z_calibration needs a Z endstop that the"
                " nozzle can press; set it to the pin of that switch" % (where,)
            )
        # An endstop stops only its own motors.  With none at all, hosts since
        # 2025-05-06 (cc6736c3e) make the whole move without any endstop.
        stopped = [s.get_name() for s in endstop.get_steppers()]
        steppers = self.toolhead.get_kinematics().get_steppers()
        moving = [s.get_name() for s in steppers if s.is_active_axis("z")]
        missing = [name for name in moving if name not in stopped]
        if missing or not stopped:
            raise self.printer.config_error(
                "%s does not stop these Z motors: %s; remove the endstop_pin"
                " of their own" % (where, ", ".join(missing) or "all")
            )

    def z_endstop_triggered(self):
        return self._is_triggered(self.z_endstop)

    def _is_triggered(self, endstop):
        # The print time of the last queued move: the state after it.
        return bool(endstop.query_endstop(self.toolhead.get_last_move_time()))

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

    # True: pressed, or a normally closed probe that is not attached
    def probe_triggered(self):
        return self._is_triggered(self.probe_endstop())

    def probe_offsets(self):
        return self.probe.get_offsets()

    def probe_params(self):
        probe = self.probe
        if hasattr(probe, "get_probe_params"):
            return probe.get_probe_params()
        # Until 2024-06-10 (6ea5b94d1), Kalico, QIDI
        return {
            "probe_speed": probe.speed,
            "lift_speed": probe.lift_speed,
            "samples": probe.sample_count,
            "samples_tolerance": probe.samples_tolerance,
            "samples_tolerance_retries": probe.samples_retries,
            "samples_result": probe.samples_result,
        }

    # Gives a function that probes once with the probe's own settings and
    # returns the toolhead Z of the trigger.
    @contextlib.contextmanager
    def probe_session(self):
        gcmd = self.gcode.create_gcode_command("", "", {})
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
        try:
            result = session.run_probe(gcmd)
            if hasattr(session, "pull_probed_results"):
                # Since 2024-06-14 (1591a51f7)
                result = session.pull_probed_results()[-1]
        except self.printer.command_error as e:
            text = "%s (stopped at z=%.3f); check with QUERY_PROBE and PROBE"
            raise CalibrationError(text % (e, self.z()))
        if hasattr(result, "bed_z"):
            # A record since 2026-01-21 (2a1027ce4).  Not its test_z: the
            # position of earlier hosts has twist compensation in it, too.
            return result.bed_z + self.probe.get_offsets()[2]
        return result[2]

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

    def z(self):
        return self.toolhead.get_position()[2]

    def raise_to(self, z, speed):
        if self.z() < z:
            self.toolhead.manual_move([None, None, z], speed)

    def lower_to(self, z, speed):
        if self.z() > z:
            self.toolhead.manual_move([None, None, z], speed)

    def move_xy(self, x, y, speed):
        self.toolhead.manual_move([x, y], speed)

    # Move down until the endstop triggers; returns the toolhead Z of the
    # trigger.  The head stops a little lower and stays there.
    def touch(self, endstop, floor, speed):
        target = self.toolhead.get_position()
        if target[2] <= floor:
            raise CalibrationError(
                "the head is at z=%.3f, this touch ends at z=%.3f already; set"
                " z_offset in section 'probe' to the real distance between"
                " nozzle and probe, the travel height follows from it"
                % (target[2], floor)
            )
        target[2] = floor
        homing = self.printer.lookup_object("homing")
        try:
            # A method of the host since 2021-03-29 (862d3f963)
            return homing.probing_move(endstop, target, speed)[2]
        except self.printer.command_error as e:
            text = "%s (stopped at z=%.3f, expected to trigger above z=%.3f)"
            raise CalibrationError(text % (e, self.z(), floor))

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
            except (self.printer.command_error, CalibrationError):
                if not failed:
                    raise
                logging.exception("z_calibration: %s failed, too", what)


######################################################################
# Measuring
######################################################################


# One site: approach it, touch it, come back up.  measure() returns a Touch.
class Measurement(object):
    def __init__(self, host, settings, site, say):
        self.host = host
        self.settings = settings
        self.site = site
        self.say = say

    def measure(self, floor):
        try:
            return self.run(floor)
        except CalibrationError as e:
            raise CalibrationError("%s: %s" % (self.site.name, e))

    def run(self, floor):
        raise NotImplementedError

    # Raises CalibrationError when the site must not be touched (any more)
    def check_ready(self):
        raise NotImplementedError

    # Up first, so that nothing is hit on the way; never down to get there.
    def approach(self):
        settings = self.settings
        self.host.raise_to(settings.safe_z_height, settings.lift_speed)
        self.host.move_xy(self.site.x, self.site.y, settings.speed)

    # A touch between two checks: what was there before it must still be
    # there afterwards.
    def touch(self, endstop, floor, speed):
        self.check_ready()
        try:
            z = self.host.touch(endstop, floor, speed)
        except CalibrationError as e:
            remedy = "check %s_xy_position, the switch and its wiring"
            raise CalibrationError("%s; %s" % (e, remedy % (self.site.name,)))
        self.retract(z)
        self.report("touched at z=%.6f" % (z,))
        return z

    def retract(self, z):
        settings = self.settings
        top = z + settings.probing_retract_dist
        self.host.raise_to(top, settings.lift_speed)
        self.check_ready()

    def sample_z_endstop(self, floor):
        speed = self.settings.probing_second_speed
        touch_pin = functools.partial(
            self.touch, self.host.z_endstop, floor, speed
        )
        return collect(touch_pin, self.settings, self.report)

    def report(self, msg):
        self.say("z_calibration: %s: %s" % (self.site.name, msg))

    def check_z_endstop_open(self):
        if self.host.z_endstop_triggered():
            raise CalibrationError(
                "the Z endstop reads triggered where nothing should press it;"
                " check it with QUERY_ENDSTOPS"
            )

    def check_probe_attached(self):
        if self.host.probe_triggered():
            raise CalibrationError(
                "the probe reads triggered: it is not attached, or not wired"
                " as normally closed; attach it in start_gcode or"
                " before_switch_gcode, check it with QUERY_PROBE"
            )


# The nozzle tip on the pin of the Z endstop
class NozzleMeasurement(Measurement):
    def run(self, floor):
        settings = self.settings
        self.approach()
        # Blind only above the travel height, which is above the pin.
        self.host.lower_to(settings.safe_z_height, settings.lift_speed)
        return self.sample_z_endstop(floor)

    def check_ready(self):
        self.check_z_endstop_open()
        if not self.settings.attach_after_nozzle:
            return
        if not self.host.probe_triggered():
            raise CalibrationError(
                "the probe is attached already, although before_switch_gcode"
                " is there to attach it; detach it in start_gcode"
            )


# The body of the probe's switch on the same pin
class SwitchMeasurement(Measurement):
    def run(self, floor):
        self.approach()
        return self.sample_z_endstop(floor)

    def check_ready(self):
        self.check_z_endstop_open()
        self.check_probe_attached()


# The probe on the print surface.  The host's own probing goes down to
# position_min when the probe does not trigger, so a touch of ours, which
# ends at the floor, first shows that it does.
class BedMeasurement(Measurement):
    def run(self, floor):
        with self.host.probe_session() as probe_bed:
            self.approach()
            endstop = self.host.probe_endstop()
            self.touch(endstop, floor, self.settings.bed_speed)
            z = probe_bed()
            self.retract(z)
        return Touch(z, (z,))

    def check_ready(self):
        self.check_probe_attached()


######################################################################
# Commands
######################################################################


# Runs a parser of section 2 on an option; its complaint becomes a config
# error that names section, option and remedy.
def read_option(config, name, parse, remedy):
    try:
        return parse(config.get(name))
    except CalibrationError as e:
        text = "Option '%s' in section '%s': %s; %s"
        raise config.error(text % (name, config.get_name(), e, remedy))


def read_site(config, name):
    remedy = "write X and Y in mm, such as 100,100"
    x, y = read_option(config, name + "_xy_position", parse_pair, remedy)
    return Site(name, x, y)


def read_switch_offset(config):
    remedy = (
        "write the distance from switch body to trigger point, 0 mm or more"
    )
    read_option(config, "switch_offset", parse_not_negative, remedy)
    # As a number for those who look at printer.configfile.settings
    return config.getfloat("switch_offset")


# Options that are not there yet have their documented default here.
def read_settings(config, z_axis):
    return Settings(
        nozzle=read_site(config, "nozzle"),
        switch=read_site(config, "switch"),
        bed=read_site(config, "bed"),
        switch_offset=read_switch_offset(config),
        attach_after_nozzle=config.get("before_switch_gcode", "").strip() != "",
        offset_margins=OFFSET_MARGINS,
        travel_margin=TRAVEL_MARGIN,
        position_endstop=z_axis.position_endstop,
        position_min=z_axis.position_min,
        safe_z_height=None,
        speed=TRAVEL_SPEED,
        lift_speed=None,
        probing_second_speed=z_axis.second_homing_speed,
        probing_retract_dist=z_axis.homing_retract_dist or FALLBACK_RETRACT,
        bed_speed=None,
        samples=None,
        samples_tolerance=None,
        samples_tolerance_retries=None,
        samples_result=None,
    )


def load_template(config, name):
    printer = config.get_printer()
    gcode_macro = printer.load_object(config, "gcode_macro")
    try:
        return gcode_macro.load_template(config, name, "")
    except printer.command_error as e:
        # What newer hosts raise would come out as an internal error.
        text = "Option '%s' in section '%s': %s"
        raise config.error(text % (name, config.get_name(), e))


# The object behind [z_calibration]
class ZCalibration(object):
    def __init__(self, config):
        logging.info("z_calibration %s", __version__)
        self.printer = config.get_printer()
        self.host = Host(config)
        self.settings = read_settings(config, self.host.z_axis)
        self.start_gcode = load_template(config, "start_gcode")
        self.before_switch_gcode = load_template(config, "before_switch_gcode")
        self.end_gcode = load_template(config, "end_gcode")
        self.last_result = None
        self.printer.register_event_handler("klippy:connect", self.connect)
        self.printer.lookup_object("gcode").register_command(
            "CALIBRATE_Z", self.cmd_CALIBRATE_Z, desc=self.cmd_CALIBRATE_Z_help
        )

    # Set-up
    def connect(self):
        host = self.host
        host.connect()
        params, z_offset = host.probe_params(), host.probe_offsets()[2]
        self.settings = complete(self.settings, params, z_offset)
        try:
            self.check_probe_settings()
            self.check_sites()
        except CalibrationError as e:
            raise self.printer.config_error(str(e))

    def check_probe_settings(self):
        settings, section = self.settings, self.host.z_axis.section
        low, safe_z = settings.position_endstop, settings.safe_z_height
        high = self.host.axis_limits()[2][1]
        if not low < safe_z <= high:
            raise CalibrationError(
                "Option 'z_offset' in section 'probe' makes z=%.3f the travel"
                " height of z_calibration, but it must lie above"
                " position_endstop (%.3f) and within position_max (%.3f) of"
                " section '%s'; set z_offset to the real distance between"
                " nozzle and probe" % (safe_z, low, high, section)
            )
        if settings.samples_result not in ("median", "average"):
            raise CalibrationError(
                "Option 'samples_result: %s' in section 'probe' is not known to"
                " z_calibration; set it to median or average"
                % (settings.samples_result,)
            )

    def check_sites(self):
        settings, limits = self.settings, self.host.axis_limits()
        for site in (settings.nozzle, settings.switch, settings.bed):
            head = self.head_site(site)
            for axis, xy, (low, high) in zip("XY", head[1:], limits):
                if low <= xy <= high:
                    continue
                wanted = "%s_xy_position: %g,%g" % site
                shift = ", the probe's offset included" if head != site else ""
                raise CalibrationError(
                    "Option '%s' in section 'z_calibration' needs the head at"
                    " %s=%.3f%s, outside its %.3f to %.3f; choose a point that"
                    " it can reach" % (wanted, axis, xy, shift, low, high)
                )

    # The bed is named where the probe is to touch it, the other sites where
    # the head is to stand.
    def head_site(self, site):
        if site.name != "bed":
            return site
        x_offset, y_offset = self.host.probe_offsets()[:2]
        return Site(site.name, site.x - x_offset, site.y - y_offset)

    # 'last_query' is empty, and so counts as false, until a run succeeded.
    def get_status(self, eventtime):
        result = self.last_result
        if result is None:
            return {"last_query": {}, "last_z_offset": 0.0}
        parts = dict(zip(result._fields, result))
        return {"last_query": parts, "last_z_offset": result.offset}

    # Calibration
    cmd_CALIBRATE_Z_help = "Measure nozzle, switch and bed, set the Z offset"

    def cmd_CALIBRATE_Z(self, gcmd):
        try:
            result = self.calibrate(gcmd.respond_info)
        except CalibrationError as e:
            raise gcmd.error("z_calibration: %s" % (e,))
        self.apply_offset(result.offset)
        self.last_result = result
        gcmd.respond_info(
            "Z-CALIBRATION: probe=%.3f - (switch=%.3f - nozzle=%.3f"
            " + switch_offset=%.3f) --> new offset=%.6f" % result
        )

    # end_gcode runs before the offset is applied: the way to the dock does
    # not shift with the offset, and a probe that could not be put away
    # leaves everything as it was.
    def calibrate(self, say):
        host = self.host
        dock = self.end_gcode.run_gcode_from_command
        with host.always(dock, "end_gcode"), host.always(self.lift, "lifting"):
            self.run_user_gcode(self.start_gcode)
            result = self.measure(say)
            check_offset(result, self.settings.offset_margins)
        host.check_homed()
        return result

    def measure(self, say):
        host, settings = self.host, self.settings
        nozzle = NozzleMeasurement(host, settings, settings.nozzle, say)
        switch = SwitchMeasurement(host, settings, settings.switch, say)
        if not settings.attach_after_nozzle:
            # Nobody will attach it later: say so before anything is touched,
            # but clear of the bed, on which a PROBE leaves it pressed
            self.lift()
            switch.check_probe_attached()
        nozzle_z = nozzle.measure(nozzle_floor(settings)).z
        if settings.attach_after_nozzle:
            self.lift()
            self.run_user_gcode(self.before_switch_gcode)
        switch_z = switch.measure(switch_floor(settings, nozzle_z)).z
        bed = BedMeasurement(host, settings, self.head_site(settings.bed), say)
        probe_z = bed.measure(bed_floor(settings, nozzle_z, switch_z)).z
        parts = (probe_z, switch_z, nozzle_z, settings.switch_offset)
        return Result(*parts + (offset(*parts),))

    # User G-code may home, move, or turn the motors off.
    def run_user_gcode(self, template):
        template.run_gcode_from_command()
        self.host.check_homed()

    def lift(self):
        settings = self.settings
        if self.host.is_homed("z"):
            self.host.raise_to(settings.safe_z_height, settings.lift_speed)

    # Absolute, so that it replaces any earlier offset.  The command's own
    # method: a macro of that name may add to it, store it or move.
    def apply_offset(self, z_offset):
        params = {"Z": "%.6f" % (z_offset,), "MOVE": "0"}
        line = "SET_GCODE_OFFSET Z=%s MOVE=0" % (params["Z"],)
        gcode = self.printer.lookup_object("gcode")
        gcmd = gcode.create_gcode_command("SET_GCODE_OFFSET", line, params)
        self.printer.lookup_object("gcode_move").cmd_SET_GCODE_OFFSET(gcmd)


def load_config(config):
    return ZCalibration(config)
