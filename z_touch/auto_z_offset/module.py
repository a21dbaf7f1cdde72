# The object behind [auto_z_offset], its settings, measurements and commands.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import functools
import logging
import math

from .. import __version__
from ..core import (
    endstops,
    errors,
    frame,
    host,
    options,
    running,
    sampling,
    templates,
    touching,
)
from . import motors

######################################################################
# Constants
######################################################################

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
LIMITS = {"minval": -LARGEST_OFFSET, "maxval": LARGEST_OFFSET}

# XY speed (mm/s) between the places, unless configured.
TRAVEL_SPEED = 100.0

# Above this distance (mm) a way down is quick, but ready to stop.
FAR = 5.0

# A sensor that still reads triggered after lifting is asked again then (s).
SECOND_LOOK = 0.3

# Corrections of one AUTO_Z_CALIBRATE that differ more (mm) are no noise.
CYCLES_TOLERANCE = 0.2

# What is saved is rounded to that (mm).
SAVED_DIGIT = 0.000001


######################################################################
# Records and maths
######################################################################

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
    " current_factor travel_speed cycles_tolerance prepare_gcode lost_gcode",
)


# What to do about samples that differ
DIFFER = (
    "clean the nozzle, check that nothing shakes the bed, and see"
    " prepare_gcode and probe_accel; a sensor that triggers late does this, too"
)

OUT_OF_REACH = (
    "set bed_xy_position in section 'auto_z_offset' to a point that nozzle and"
    " probe can reach"
)

TOO_LOW = (
    "check probe_z_min, and that prepare_gcode leaves the head above the bed"
)


def correction(sensor, probe, probe_z_offset, z_offset):
    return sensor - (probe - probe_z_offset) + z_offset


def check_correction(z):
    if abs(z) > LARGEST_OFFSET:
        raise errors.CalibrationError(
            "a correction of %.3f mm is none, %g mm is the limit; check"
            " z_offset, and home Z again (G28)" % (z, LARGEST_OFFSET)
        )


NOTHING_EXPECTED = Expected(None, float("-inf"), float("inf"))


def expect_near(z, margin):
    return Expected(z, z - margin, z + margin)


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
    raise errors.CalibrationError(
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
# Bed sensor
######################################################################


# The sensor below the bed, which stops the Z motors.
class BedSensor(object):
    def __init__(self, config, machine):
        self.host = machine
        self.pin = config.get("pin")
        remedy = "give the pin of the bed sensor, as in 'pin: U_1:PC1'"
        self.endstop = machine.endstops.make(config, "pin", remedy)
        # Exist when klippy connects
        self.motors = None

    def check_open(self, print_time):
        if not self.endstop.query_endstop(print_time):
            return
        self.host.toolhead.dwell(SECOND_LOOK)
        if self.endstop.query_endstop(self.host.after_moves()):
            raise errors.CalibrationError(
                "reads triggered at z=%.3f, where nothing should press it;"
                " check prepare_gcode, and 'pin: %s' with QUERY_ENDSTOPS (a '!'"
                " in front of it turns the meaning)" % (self.host.z(), self.pin)
            )


######################################################################
# Measuring
######################################################################


# The nozzle on the bed, where the head is.
class SensorMeasurement(object):
    def __init__(self, run):
        self.host = run.host
        self.sensor = run.sensor
        self.settings = run.settings
        self.watch = run.watch
        # What is known of the bed; the lowest trigger at this place, or None
        self.expected = run.expected
        self.touched_z = run.touched_z
        self.head = touching.Head(run.host, run.settings.sampling, TOO_LOW)

    # From 'top' on, where nothing is known of the bed.  Returns the height:
    # toolhead Z in mm.
    def measure(self, top):
        how = self.settings.sampling
        with errors.about("bed sensor"):
            self.come_down(top)
            samples = sampling.collect(self.sample, how, self.report, DIFFER)
        return sampling.summarize(samples, how.result)

    # A trigger far above the bed is none: shaking makes them.
    def sample(self):
        samples = self.settings.sampling
        retries_left = samples.retries
        while True:
            self.head.retract()
            z = self.touch()
            try:
                check_expected(z, self.expected)
                break
            except errors.CalibrationError as e:
                if not retries_left:
                    raise
                self.report("%s; trying again" % (e,))
                retries_left -= 1
        self.expected = expect_again(z, self.touched_z, samples)
        self.touched_z = self.expected.z
        self.watch.touched()
        self.report("triggered at z=%.6f" % (z,))
        return z

    # Down to where a touch begins: at full current, and not blindly where
    # nothing was touched yet
    def come_down(self, top):
        settings = self.settings
        if self.touched_z is not None:
            top = self.touched_z + settings.sampling.retract_dist
            self.head.move_down(top, settings.sampling.lift_speed)
        elif self.host.z() > top + FAR:
            self.sensor.check_open(self.host.after_moves())
            accel = motors.braking_accel(self.host, 0.0)
            speed = fastest_touch(settings.sampling.lift_speed, accel)
            self.head.come_down(self.sensor.endstop, top, speed)

    # The current is low only while the nozzle goes down: a motor that loses
    # a step on the way up would take Z along.
    def touch(self):
        sensor, settings = self.sensor, self.settings
        accel = motors.braking_accel(self.host, settings.probe_accel)
        speed = fastest_touch(settings.sampling.speed, accel)
        floor = sensor_floor(settings.floor, self.expected, speed, accel)
        less_accel = motors.limited_accel(self.host, settings.probe_accel)
        less_current = sensor.motors.reduced(settings.current_factor)
        start_z = self.host.z()
        try:
            with less_accel, less_current:
                # When the moves have ended: the motors settle meanwhile
                sensor.check_open(self.host.after_moves())
                return self.head.touch(sensor.endstop, floor.z, speed)
        except errors.NoTrigger as e:
            raise errors.NoTrigger(
                "%s; check that prepare_gcode turns the sensor on, that 'pin:"
                " %s' is the sensor's (QUERY_ENDSTOPS while you press the bed),"
                " and that the bed is not below the lowest point of this touch,"
                " which is %s" % (e, sensor.pin, self.reason(floor))
            )
        except errors.CalibrationError:
            if touching.is_at(self.host, start_z):
                sensor.check_open(self.host.after_moves())
            raise

    def reason(self, floor):
        if floor == self.settings.floor:
            return floor.why
        return "%s; add %s" % (floor.why, IF_CHANGED)

    def report(self, msg):
        self.watch.say("bed sensor: %s" % (msg,))


# The inductive probe over the same point of the bed, through the host's own
# probing, told where to end.
class ProbeMeasurement(object):
    def __init__(self, run):
        self.host = run.host
        self.settings = run.settings
        self.watch = run.watch
        self.known = run.known
        self.head = touching.Head(run.host, run.settings.sampling, TOO_LOW)

    # 'floor' is the height at which the nozzle meets the bed: an inductive
    # probe triggers above it.  Returns toolhead Z in mm.
    def measure(self, floor):
        with errors.about("probe"):
            samples = self.collect(floor)
        return sampling.summarize(samples, self.settings.sampling.result)

    def collect(self, floor):
        samples = self.settings.sampling
        top = self.host.z()
        speed = "%.6f" % (samples.speed,)
        probing = touching.probing(self.head, floor, top, PROBE_SPEED=speed)
        with probing as probe_once:
            sample = functools.partial(self.sample, probe_once, floor)
            return sampling.collect(sample, samples, self.report, DIFFER)

    def sample(self, probe_once, floor):
        self.head.retract()
        self.head.check_above(floor)
        z = self.touch(probe_once, floor)
        self.watch.touched()
        self.report("triggered at z=%.6f" % (z,))
        return z

    # One that goes down to the bed is dead, or that was not the bed
    def touch(self, probe_once, floor):
        try:
            if probe_once is not None:
                return self.homed_z(self.head.probe(probe_once))
            # A host unknown to us: its probing would go on to position_min
            speed = self.settings.sampling.speed
            return self.head.touch(self.host.probing.endstop(), floor, speed)
        except errors.CalibrationError as e:
            if not touching.is_at(self.host, floor):
                raise
            raise errors.NoTrigger(
                "%s; it ends where the bed sensor triggered, z=%.3f: that was"
                " not the bed, or the probe does not see it" % (e, floor)
            )

    # As G28, from which the correction is counted, or else the mesh sees it
    def homed_z(self, probed):
        if (
            self.known.homes_with_probe
            and not self.host.probing.homes_with_twist()
        ):
            return probed.z
        return probed.z + probed.twist

    def report(self, msg):
        self.watch.say("probe: %s" % (msg,))


# One command: goes to the bed, prepares the sensor, measures, lifts.
class Run(object):
    def __init__(self, module, accepted):
        self.host = module.host
        self.sensor = module.sensor
        self.settings = module.settings
        self.known = module.known
        self.watch = module.runner.watch
        # Whatever was changed since: nothing is expected
        self.accepted = accepted
        # They follow what the run learns, as the height the head is lifted to:
        # what is known of the bed, its lowest trigger, its last height
        self.expected = NOTHING_EXPECTED
        self.touched_z = self.sensor_z = None
        # The print time at which the head had left the bed
        self.lifted_at = 0.0
        probe_z, hop = self.known.homed_probe_z(), self.settings.probe_hop
        self.travel_z = travel_height(probe_z, hop)
        self.speed = self.settings.travel_speed

    def lift(self):
        speed = self.settings.sampling.lift_speed
        touching.raise_to(self.host, self.travel_z, speed)

    def go_to(self, site):
        self.lift()
        touching.move_xy(self.host, site.x, site.y, self.speed)

    # The user's G-code may have moved the head.
    def prepare(self, site):
        self.go_to(site)
        self.watch.enter("prepare_gcode")
        self.run_prepare_gcode()
        running.check_homed(self.host)
        # It may have homed, too
        if not self.accepted:
            self.expected = self.known.expected()
        self.go_to(site)

    # Relative moves must not outlive the template, also when it fails.
    def run_prepare_gcode(self):
        back = functools.partial(self.set_absolute, self.is_absolute())
        with running.always(self.host, back, "setting G90 or G91 back"):
            template = self.settings.prepare_gcode
            templates.run_template(self.host, "prepare_gcode", template)

    def is_absolute(self):
        gcode_move = self.host.printer.lookup_object("gcode_move")
        status = gcode_move.get_status(self.host.eventtime())
        return status["absolute_coordinates"]

    def set_absolute(self, absolute):
        if self.is_absolute() != absolute:
            script = "G90" if absolute else "G91"
            self.host.gcode.run_script_from_command(script)

    # Toolhead Z (mm) of its trigger; the head goes up then, see check_left().
    def measure_sensor(self):
        self.watch.enter("bed sensor")
        sensor = SensorMeasurement(self)
        z = self.sensor_z = sensor.measure(self.travel_z)
        self.expected, self.touched_z = sensor.expected, sensor.touched_z
        self.travel_z = z + self.settings.probe_hop
        self.lift()
        self.lifted_at = self.host.after_moves()
        return z

    # A sensor that stays triggered has not seen the bed.  The head may be under
    # way already: whoever looks only when it stands waits longer.
    def check_left(self):
        with errors.about("bed sensor"):
            self.sensor.check_open(self.lifted_at)

    def measure_sensor_alone(self):
        z = self.measure_sensor()
        self.check_left()
        return z

    # Both sensors over one point
    def measure(self, bed, probe_site):
        self.go_to(bed)
        sensor_z = self.measure_sensor()
        self.watch.enter("probe")
        touching.move_xy(self.host, probe_site.x, probe_site.y, self.speed)
        self.check_left()
        probe_z = ProbeMeasurement(self).measure(sensor_z)
        self.lift()
        probe_z_offset = self.host.probing.offsets()[2]
        parts = (sensor_z, probe_z, probe_z_offset, self.settings.z_offset)
        return Result(*parts + (correction(*parts),))


# What is known of the bed: from touches, from the saved correction and from
# how Z was homed.
class Known(object):
    def __init__(self, config, machine, settings):
        self.host = machine
        self.settings = settings
        self.frame = frame.Frame(machine)
        # A host that homes Z with the probe believes what the probe says
        pin = machine.z_axis.endstop_pin
        self.homes_with_probe = endstops.chip_of(pin) == "probe"
        # None: never measured; and the z_offset of the probe that it was
        # measured with, None: not known.  The documented default of 0 means
        # that, too.
        name = "corrected_probe_z_offset"
        self.corrected_z_offset = options.number(config, name)
        self.correction = options.number(config, "probe_z_correction", **LIMITS)
        if self.corrected_z_offset is None:
            self.correction = self.correction or None
        # Toolhead Z of the last trigger, and the frame it was seen in
        self.sensor_z = self.mark = None
        # The frame that AUTO_Z_HOME_Z has made
        self.home_mark = None

    # Z_OFFSET_APPLY_PROBE and PROBE_CALIBRATE move the probe's Z=0, and the
    # correction is counted from there.  Returns what the user is told.
    def follow_probe(self):
        if self.correction is None or self.corrected_z_offset is None:
            return ""
        z_offset = self.host.probing.offsets()[2]
        moved = z_offset - self.corrected_z_offset
        if abs(moved) < SAVED_DIGIT:
            return ""
        before = self.correction
        self.correction = before + moved
        return (
            "the probe's z_offset is %.3f and was %.3f when the correction was"
            " saved: probe_z_correction %.6f is taken as %.6f"
            % (z_offset, self.corrected_z_offset, before, before + moved)
        )

    # Where the probe sees the bed once Z was homed with it: at 0, except where
    # position_endstop counts.  Until 2024-07-04 (34732f857) and on Kalico Z is
    # homed to that with a smart_effector; elsewhere hosts do not accept it.
    def homed_bed_z(self):
        homed_z = self.host.z_axis.position_endstop
        if homed_z is None or not self.homes_with_probe:
            return 0.0
        return homed_z - self.host.probing.offsets()[2]

    # and where it triggers
    def homed_probe_z(self):
        return self.homed_bed_z() + self.host.probing.offsets()[2]

    def touched(self, sensor_z):
        self.sensor_z = sensor_z
        self.mark = self.frame.mark()

    # A touch since Z was set, or what the probe said when Z was homed with it
    def expected(self):
        if self.holds(self.mark):
            return expect_near(self.sensor_z, KNOWN_MARGIN)
        if self.is_sensor_frame() or not self.homes_with_probe:
            return NOTHING_EXPECTED
        if self.correction is not None:
            z = self.homed_bed_z() + self.correction - self.settings.z_offset
            return expect_near(z, KNOWN_MARGIN)
        return expect_below_probe(self.homed_probe_z())

    # Whether Z is still what it was when the frame was marked.  Where the
    # motors do not tell (empty datum), nobody knows.
    def holds(self, mark):
        known = mark is not None and bool(mark[1])
        return known and not self.frame.moved_since(mark)

    # Whether Z is the bed sensor's.  Levelling does not change that: only what
    # sets Z does.
    def is_sensor_frame(self):
        mark = self.home_mark
        return mark is not None and mark[0] == len(self.frame.noted)

    # The correction of the probe means nothing there.
    def check_frame(self):
        if self.is_sensor_frame():
            raise errors.CalibrationError(
                "Z was set by AUTO_Z_HOME_Z, a correction of the probe does not"
                " hold there; home Z with the probe (G28) first"
            )

    # The correction is the offset only where the probe sees the bed at about 0.
    def stale(self, result):
        bed_z, wanted = result.probe - result.probe_z_offset, self.homed_bed_z()
        if abs(bed_z - wanted) <= STALE_Z:
            return ""
        text = "the probe sees the bed at z=%.3f instead of %.3f; %s"
        remedy = (
            "check the probe with QUERY_PROBE, and home Z again (G28) after any"
            " levelling, over this point"
        )
        if not self.homes_with_probe:
            remedy = "the correction holds with a bed mesh of this probe only"
        return text % (bed_z, wanted, remedy)


######################################################################
# Options
######################################################################

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


# Returns what the user is told of old options
def read_old_options(config):
    given = [name for name, why in OLD_OPTIONS if config.get(name, None)]
    notes = dict(OLD_OPTIONS)
    return ["option '%s' %s" % (name, notes[name]) for name in given]


# 'notes' collects what the user is told
def read_floor(config, z_axis, notes):
    why = "position_min of section '%s'" % (z_axis.section,)
    floor = max(
        Floor(z_axis.position_min, why),
        Floor(LOWEST_FLOOR, "the limit of auto_z_offset"),
    )
    own = options.number(config, "probe_z_min")
    if own is None:
        return floor
    if own < floor.z:
        text = "'probe_z_min: %g' is ignored, %s is %g"
        notes.append(text % (own, floor.why, floor.z))
    return max(floor, Floor(own, "probe_z_min"))


def read_sampling(config):
    number = functools.partial(options.number, config)
    result = config.get("samples_result", "average").lower()
    if result not in options.RESULTS:
        text = "must be average or median"
        raise options.config_error(config, "samples_result", text)
    return sampling.Sampling(
        samples=config.getint("samples", 1, minval=1),
        tolerance=number("samples_tolerance", 0.1, minval=0.0),
        retries=config.getint("samples_tolerance_retries", 0, minval=0),
        result=result,
        speed=number("speed", 5.0, above=0.0),
        retract_dist=number("sample_retract_dist", 3.0, above=0.0),
        lift_speed=number("lift_speed", 20.0, above=0.0),
    )


def read_settings(config, z_axis, notes):
    number = functools.partial(options.number, config)
    bed = options.pair(config, "bed_xy_position")
    settings = Settings(
        bed=bed and touching.option_site(config, "bed", "bed_xy_position", bed),
        z_offset=number("z_offset", 0.2, **LIMITS),
        probe_hop=number("probe_hop", SMALLEST_HOP, minval=SMALLEST_HOP),
        probe_accel=number("probe_accel", 0.0, minval=0.0),
        floor=read_floor(config, z_axis, notes),
        offset_samples=config.getint("offset_samples", 3, minval=1),
        sampling=read_sampling(config),
        current_factor=number("z_current_factor", 0.33, minval=0.1, maxval=1.0),
        travel_speed=number("travel_speed", TRAVEL_SPEED, above=0.0),
        cycles_tolerance=number(
            "cycles_tolerance", CYCLES_TOLERANCE, minval=0.0
        ),
        prepare_gcode=templates.load_template(config, "prepare_gcode"),
        # Sensors that the original module powered here would stay off
        lost_gcode=bool(config.get("activate_gcode", "").strip()),
    )
    notes.append(inside_bed(settings.z_offset))
    return settings


######################################################################
# Commands
######################################################################


# The object behind [auto_z_offset]
class AutoZOffset(object):
    def __init__(self, config):
        logging.info("auto_z_offset %s", __version__)
        self.printer = config.get_printer()
        self.host = host.Host(config)
        host.check_z_axis(config, self.host.z_axis)
        # What the user is told when klippy is ready
        self.notes = read_old_options(config)
        self.sensor = BedSensor(config, self.host)
        self.settings = read_settings(config, self.host.z_axis, self.notes)
        self.known = Known(config, self.host, self.settings)
        self.runner = running.Runner(self.host)
        # Of the last command that measured both heights
        self.results = ()
        register = self.printer.register_event_handler
        register("klippy:connect", self.connect)
        register("klippy:ready", self.tell_notes)
        running.register_commands(self.host, self)

    # Set-up
    def connect(self):
        self.host.connect()
        self.check_probe()
        self.sensor.motors = motors.Motors(self.host)
        try:
            self.check_heights()
            self.check_reach(self.bed_site())
            self.check_reach(self.probe_site(self.bed_site()))
        except errors.CalibrationError as e:
            raise self.printer.config_error(str(e))
        self.notes.append(self.known.follow_probe())
        left_alone = self.sensor.motors.left_alone
        if self.settings.current_factor < 1.0 and left_alone:
            self.notes.append(
                "z_current_factor has no effect on %s: no TMC driver of its own"
                " whose current may be changed" % (", ".join(left_alone),)
            )
        self.note_speed()
        if not self.known.homes_with_probe:
            self.notes.append(
                "Z is not homed with the probe, so the correction holds with a"
                " bed mesh of this probe only"
            )

    def check_probe(self):
        machine = self.host
        if machine.probing.probe is None:
            raise self.printer.config_error(
                "Section 'probe' is missing: auto_z_offset corrects the"
                " inductive probe that Z is homed with"
            )
        lookup = functools.partial(self.printer.lookup_object, default=None)
        special = [lookup(name) for name in ("bltouch", "smart_effector")]
        # One that may be touched without the host's own procedure
        is_plain = special == [None, None] and machine.probing.endstop()
        if machine.probing.limit()[0] is None and not is_plain:
            raise self.printer.config_error(
                "Section 'probe' (%s): this probe cannot be told how far down"
                " to look, a missing trigger would drive the nozzle into the"
                " bed; auto_z_offset needs a [probe], [smart_effector] or"
                " [bltouch], or remove section 'auto_z_offset'"
                % (machine.probing.probe.__class__.__name__,)
            )

    def note_speed(self):
        settings = self.settings
        accel = motors.braking_accel(self.host, settings.probe_accel)
        speed = fastest_touch(settings.sampling.speed, accel)
        if speed < settings.sampling.speed:
            self.notes.append(
                "speed %g is limited to %.2f mm/s on the bed sensor: with %g"
                " mm/s^2 the head could not stop soon enough below the bed"
                % (settings.sampling.speed, speed, accel)
            )

    def tell_notes(self):
        for note in self.notes:
            self.tell(note)

    def check_heights(self):
        low, high = self.host.axis_limits()[2]
        settings, section = self.settings, self.host.z_axis.section
        top = travel_height(self.known.homed_probe_z(), settings.probe_hop)
        if top > high:
            raise errors.CalibrationError(
                "Option 'probe_hop' in section '%s': the head would travel at"
                " z=%.3f, above position_max (%.3f) of section '%s'; write a"
                " smaller value, or correct z_offset of the probe"
                % (NAME, top, high, section)
            )
        if settings.floor.z >= top - settings.probe_hop:
            raise errors.CalibrationError(
                "Option 'probe_z_min' in section '%s': no touch could reach"
                " the bed from there, z=%.3f is the lowest; write a value"
                " below 0, and position_min of section '%s', too"
                % (NAME, settings.floor.z, section)
            )

    def check_reach(self, site):
        touching.check_reach(self.host, site, OUT_OF_REACH)

    # Places of the head (mm): nozzle, then probe over the same point
    def bed_site(self):
        if self.settings.bed is not None:
            return self.settings.bed
        (x_min, x_max), (y_min, y_max) = self.host.axis_limits()[:2]
        middle = (x_min + x_max) / 2.0, (y_min + y_max) / 2.0
        origin = "The middle of the axes"
        return touching.Site("bed", middle[0], middle[1], origin)

    def probe_site(self, bed):
        x_offset, y_offset = self.host.probing.offsets()[:2]
        origin = "%s, with the probe above it," % (bed.origin,)
        x, y = bed.x - x_offset, bed.y - y_offset
        return touching.Site("probe", x, y, origin)

    # Status
    def get_status(self, eventtime):
        corrections = [result.correction for result in self.results]
        last = self.results[-1]._asdict() if self.results else {}
        spread = max(corrections) - min(corrections) if corrections else 0.0
        status = {
            "probe_z_correction": self.known.correction or 0.0,
            "last_z": self.known.sensor_z,
            "last_result": dict(last),
            "corrections": corrections,
            "spread": spread,
        }
        status.update(self.runner.watch.status())
        return status

    # Runs what a command does with the machine: 'work' gets a Run and returns
    # what the command stores or says.  On any failure the head is lifted, and
    # nothing has changed.
    def measuring(self, gcmd, touches, work):
        run = functools.partial(self.run, gcmd, work)
        return self.runner.run(gcmd, run, "prepare_gcode", touches)

    def run(self, gcmd, work):
        accepted = options.param_int(
            gcmd, "ACCEPT_CHANGE", 0, minval=0, maxval=1
        )
        if self.settings.lost_gcode:
            raise errors.CalibrationError(
                "activate_gcode is not run, the bed sensor may be off; move it"
                " into prepare_gcode"
            )
        if self.host.probing.is_manual_probing():
            raise errors.CalibrationError(
                "a manual probe is under way; end it with ACCEPT or ABORT first"
            )
        running.check_homed(self.host)
        run = Run(self, accepted)
        with running.always(self.host, run.lift, "lifting"):
            value = work(run)
        self.known.touched(run.sensor_z)
        return value

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
        run.prepare(touching.Site("bed", x, y, ""))
        return x, y, run.measure_sensor_alone()

    # AUTO_Z_HOME_Z
    cmd_AUTO_Z_HOME_Z_help = "Set Z to z_offset where the bed sensor triggers"

    def cmd_AUTO_Z_HOME_Z(self, gcmd):
        z = self.measuring(gcmd, self.settings.sampling.samples, self.home_z)
        self.known.home_mark = self.known.mark
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
            raise errors.CalibrationError(
                "with the G-code Z offset of %.3f in force the nozzle would be"
                " %.3f mm inside the bed at Z=0; run SET_GCODE_OFFSET Z=0 first"
                % (offset, z_offset - offset)
            )

    def home_z(self, run):
        if not self.host.z_datum():
            raise errors.CalibrationError(
                "the motors of Z move X or Y, too: on such a machine nobody"
                " would know later what Z was set to; home it with G28"
            )
        run.prepare(self.bed_site())
        self.check_offset()
        z = run.measure_sensor_alone()
        z_offset = self.settings.z_offset
        # Last, so that nothing can fail in a frame that is another one
        position = self.host.toolhead.get_position()
        position[2] += z_offset - z
        self.host.toolhead.set_position(position)
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
        self.tell(self.known.stale(result))
        return result

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
        self.results, z_offset = self.measuring(gcmd, touches, self.calibrate)
        self.save(z_offset)
        corrections = [result.correction for result in self.results]
        gcmd.respond_info(
            "AUTO_Z_CALIBRATE: %s of %d, range %.6f: probe_z_correction:"
            " %.6f\n%s"
            % (
                settings.sampling.result,
                len(corrections),
                max(corrections) - min(corrections),
                z_offset,
                options.SAVE_HINT,
            )
        )
        self.tell(inside_bed(settings.z_offset))

    def calibrate(self, run):
        bed, results = self.bed_site(), []
        run.prepare(bed)
        self.known.check_frame()
        take = functools.partial(self.take_cycle, run, bed, results)
        corrections = self.collect_cycles(take)
        touches = self.settings.sampling
        middle = sampling.summarize(corrections, "median")
        near = [c for c in corrections if abs(c - middle) <= touches.tolerance]
        z_offset = sampling.summarize(near or corrections, touches.result)
        check_correction(z_offset)
        # So that "move Z to 0, try a sheet of paper" is at this point
        run.go_to(bed)
        self.apply_offset(z_offset + self.known.homed_bed_z())
        return tuple(results[-len(corrections) :]), z_offset

    def take_cycle(self, run, bed, results):
        result = run.measure(bed, self.probe_site(bed))
        stale = self.known.stale(result)
        if stale and self.known.homes_with_probe:
            raise errors.CalibrationError(stale)
        self.tell(stale)
        results.append(result)
        self.runner.watch.say(self.formula("cycle", result))
        return result.correction

    def collect_cycles(self, take):
        def say(msg):
            msg = msg.replace("samples_tolerance is", "cycles_tolerance is")
            self.runner.watch.say("cycles: %s" % (msg,))

        settings, touches = self.settings, self.settings.sampling
        cycles = touches._replace(
            samples=settings.offset_samples, tolerance=settings.cycles_tolerance
        )
        try:
            corrections = sampling.collect(take, cycles, say, DIFFER)
        except errors.SamplesDiffer as e:
            msg = str(e).replace("samples_tolerance", "cycles_tolerance")
            raise errors.CalibrationError("cycles: %s" % (msg,))
        spread = max(corrections) - min(corrections)
        if spread > touches.tolerance:
            text = (
                "they differ by %.4f mm, the touches of one by %.4f at most,"
                " what is farther from the median is left out; %s"
            )
            say(text % (spread, touches.tolerance, DIFFER))
        return corrections

    # As a user would: a macro of that name takes part
    def apply_offset(self, z_offset):
        script = "SET_GCODE_OFFSET Z=%.6f MOVE=0" % (z_offset,)
        self.host.gcode.run_script_from_command(script)

    def save(self, z_offset):
        self.known.correction = z_offset
        for option, value in (
            ("probe_z_correction", z_offset),
            ("corrected_probe_z_offset", self.host.probing.offsets()[2]),
        ):
            options.save(self.printer, NAME, option, "%.6f" % (value,))

    # AUTO_Z_LOAD_OFFSET
    cmd_AUTO_Z_LOAD_OFFSET_help = "Apply the probe's correction"

    def cmd_AUTO_Z_LOAD_OFFSET(self, gcmd):
        self.check_probe_frame(gcmd)
        z_offset = self.known.correction or 0.0
        bed_z = self.known.homed_bed_z()
        self.apply_offset(z_offset + bed_z)
        gcmd.respond_info(
            "AUTO_Z_LOAD_OFFSET: probe_z_correction: %.6f, the G-code Z offset"
            " is %.6f now" % (z_offset, z_offset + bed_z)
        )
        if bed_z:
            self.tell(
                "%.6f more, as position_endstop of section '%s' and the"
                " probe's z_offset differ" % (bed_z, self.host.z_axis.section)
            )
        if self.known.correction is None:
            self.tell(
                "there is no probe_z_correction yet; run AUTO_Z_CALIBRATE, then"
                " SAVE_CONFIG"
            )

    # AUTO_Z_SAVE_GCODE_OFFSET
    cmd_AUTO_Z_SAVE_GCODE_OFFSET_help = "Save the G-code Z offset in force"

    def cmd_AUTO_Z_SAVE_GCODE_OFFSET(self, gcmd):
        self.check_probe_frame(gcmd)
        before = self.known.correction or 0.0
        z_offset = self.host.gcode_offset() - self.known.homed_bed_z()
        if abs(z_offset) > LARGEST_OFFSET:
            raise gcmd.error(
                "%s: a G-code Z offset of %.3f is no correction of a probe; up"
                " to %g mm can be saved" % (NAME, z_offset, LARGEST_OFFSET)
            )
        self.save(z_offset)
        gcmd.respond_info(
            "AUTO_Z_SAVE_GCODE_OFFSET: probe_z_correction: %.6f (was %.6f)\n%s"
            % (z_offset, before, options.SAVE_HINT)
        )
        if abs(z_offset - before) > KNOWN_MARGIN:
            self.tell(
                "that is %.3f mm away from before; was AUTO_Z_LOAD_OFFSET run,"
                " and Z homed with the probe?" % (abs(z_offset - before),)
            )

    def tell(self, text):
        if text:
            self.host.gcode.respond_info("%s: %s" % (NAME, text))

    def check_probe_frame(self, gcmd):
        try:
            self.known.check_frame()
        except errors.CalibrationError as e:
            raise gcmd.error("%s: %s" % (NAME, e))
