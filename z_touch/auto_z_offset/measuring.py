# One measurement over a point of the bed: the nozzle on the bed until the sensor
# below it triggers, then the probe above the same point.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import functools

from .. import attached as carrying
from .. import command as running
from .. import errors, templates
from .. import pin as z_pin
from .. import touch as touching
from ..sampling import collect, summarize
from ..texture import spread_site, spread_tolerance
from . import heights, motors

# Above this distance (mm) a way down is quick, but ready to stop.
FAR = 5.0

# Lift (mm) before the nozzle moves on over a textured plate
CLEAR_OF_PLATE = 1.0

# A sensor that still reads triggered after lifting is asked again then (s).
SECOND_LOOK = 0.3

# What to do about samples that differ
DIFFER = (
    "clean the nozzle and check that nothing shakes the bed and that the sensor"
    " triggers in time (prepare_gcode, probe_accel)"
)

# What to do about a head that is below the floor of a touch
TOO_LOW = (
    "check probe_z_min, and that prepare_gcode leaves the head above the bed"
)


######################################################################
# The bed sensor
######################################################################


# The sensor below the bed, which stops the Z motors.
class BedSensor:
    def __init__(self, config, host, pin):
        self.host = host
        self.pin = pin
        remedy = "give the pin of the bed sensor, as in 'pin: U_1:PC1'"
        self.endstop = host.endstops.make(config, "pin", remedy)
        # The pin that Z is homed on, where no bed is
        self.z_pin = z_pin.read_pin(config, host.axes.z_axis)
        # Whose current is low while the nozzle goes down; from connect() on
        self.motors = None

    def connect(self):
        self.motors = motors.Motors(self.host)

    # Raises CalibrationError where the sensor reads triggered at a print time,
    # and a moment later still.
    def check_open(self, print_time):
        if not self.endstop.query_endstop(print_time):
            return
        self.host.toolhead.dwell(SECOND_LOOK)
        if self.endstop.query_endstop(self.host.after_moves()):
            raise errors.CalibrationError(
                "reads triggered at z=%.3f, where nothing should press it;"
                " check prepare_gcode, and 'pin: %s' with QUERY_ENDSTOPS (a '!'"
                " in front of it turns the meaning)"
                % (self.host.motion.z(), self.pin)
            )


# Where the nozzle touches: at one site or, with a radius (mm), each time at another
# point around it.
class Points:
    def __init__(self, site, radius=0.0):
        self.site = site
        self.radius = radius
        self.taken = 0
        # The lowest trigger (mm) so far, or None
        self.lowest_z = None

    # The lowest trigger is this one now (mm)
    def met(self, z):
        self.lowest_z = z

    # Of the next touch
    def next(self):
        return spread_site(self.site, self.radius, self.taken)

    # Where the last one was, in words; empty: where all are
    def told(self):
        x, y = self.next()[1:3]
        self.taken += 1
        return " at %.2f, %.2f" % (x, y) if self.radius else ""


# The nozzle on the bed, over the first of the Points.
class SensorMeasurement:
    # 'watch' is told of every touch; 'expected' is what is known of the bed.
    def __init__(self, sensor, settings, watch, points, expected):
        self.host = sensor.host
        self.sensor = sensor
        self.settings = settings
        self.points = points
        sampling = settings.sampling
        tolerance = spread_tolerance(sampling.tolerance, points.radius)
        self.sampling = sampling._replace(tolerance=tolerance)
        self.watch = watch
        self.expected = expected
        self.head = touching.Head(self.host, settings.sampling, TOO_LOW)

    # Returns the height: toolhead Z in mm.  From 'top' on the way down is slow
    # where nothing is known of the bed.
    def measure(self, top):
        sampling = self.sampling
        # Each time: prepare_gcode may have fetched it, and a probe that is docked
        # with a delay is there again
        carrying.of(self.host.printer).free_nozzle(self.host)
        with errors.about("bed sensor"):
            self.come_down(top)
            samples = collect(self.sample, sampling, self.report, DIFFER)
        return summarize(samples, sampling.result)

    # How far (mm) above a trigger the nozzle is at least, where it does not touch: one
    # point of a textured plate is higher than another
    def least_lift(self):
        lift = self.sampling.retract_dist
        return max(lift, CLEAR_OF_PLATE) if self.points.radius else lift

    # Up to where the next touch begins, and over its point
    def retract(self):
        pressed_z, radius = self.head.pressed_z, self.points.radius
        if not radius or pressed_z is None:
            self.head.retract()
            return
        self.head.lift(pressed_z + self.least_lift())
        site, speed = self.points.next(), self.settings.travel_speed
        carrying.of(self.host.printer).go_to(self.host, site.x, site.y, speed)

    # A trigger far above the bed is none: shaking makes them.
    def sample(self):
        sampling = self.sampling
        retries_left = sampling.retries
        while True:
            self.retract()
            z = self.touch()
            try:
                heights.check_expected(z, self.expected)
                break
            except errors.CalibrationError as e:
                if not retries_left:
                    # Stuck, it says more than where it was that
                    self.head.retract()
                    self.sensor.check_open(self.host.after_moves())
                    raise
                self.report("%s" % (e,))
                self.report("trying again")
                retries_left -= 1
        self.expected = heights.expect_again(z, self.points.lowest_z, sampling)
        self.points.met(self.expected.z)
        self.watch.touched()
        self.report("triggered at z=%.6f%s" % (z, self.points.told()))
        return z

    # Down to where a touch begins: at full current, and not blindly where
    # nothing was touched yet
    def come_down(self, top):
        sampling = self.settings.sampling
        if self.points.lowest_z is not None:
            speed, accel = self.speed_and_accel()
            above = heights.approach(speed, accel)
            top = self.points.lowest_z + min(self.least_lift(), above)
            self.head.move_down(top, sampling.lift_speed)
        elif self.host.motion.z() > top + FAR:
            self.sensor.check_open(self.host.after_moves())
            accel = motors.braking_accel(self.host, 0.0)
            speed = heights.fastest_touch(sampling.lift_speed, accel)
            self.head.come_down(self.sensor.endstop, top, speed)

    # Of a touch, mm/s and mm/s^2
    def speed_and_accel(self):
        accel = motors.braking_accel(self.host, self.settings.probe_accel)
        return heights.fastest_touch(self.settings.sampling.speed, accel), accel

    # The current is low only while the nozzle goes down: a motor that loses
    # a step on the way up would take Z along.
    def touch(self):
        sensor, settings = self.sensor, self.settings
        speed, accel = self.speed_and_accel()
        lowest = heights.above_pin(
            settings.floor, z_pin.floor(self.host, sensor.z_pin)
        )
        floor = heights.sensor_floor(lowest, self.expected, speed, accel)
        less_accel = motors.limited_accel(self.host, settings.probe_accel)
        less_current = sensor.motors.reduced(settings.z_current_factor)
        start_z = self.host.motion.z()
        try:
            with less_accel, less_current:
                # When the moves have ended: the motors settle meanwhile
                sensor.check_open(self.host.after_moves())
                return self.head.touch(sensor.endstop, floor.z, speed)
        except errors.NoTrigger as e:
            raise e.advised(
                "check that prepare_gcode turns the sensor on, that 'pin: %s'"
                " is the sensor's (QUERY_ENDSTOPS while you press the bed), and"
                " that the bed is no lower%s"
                % (sensor.pin, floor.remedy and ", or " + floor.remedy),
                floor_reason=floor.why,
            )
        except errors.CalibrationError:
            if touching.is_at(self.host, start_z):
                sensor.check_open(self.host.after_moves())
            raise

    def report(self, text):
        self.watch.say("bed sensor: %s" % (text,))


######################################################################
# The probe
######################################################################


# The inductive probe over the same point of the bed, through the host's own
# probing, told where to end.
class ProbeMeasurement:
    def __init__(self, host, settings, watch):
        self.host = host
        self.settings = settings
        self.watch = watch
        self.head = touching.Head(host, settings.sampling, TOO_LOW)

    # 'sensor_z' is the height at which the nozzle meets the bed: a probe triggers
    # above it.  'expected_z' is where it does so, None: nobody knows.  Returns
    # toolhead Z in mm.
    def measure(self, sensor_z, expected_z):
        z_offset = self.host.probing.offsets()[2]
        floor = heights.probe_floor(sensor_z, z_offset)
        with errors.about("probe"):
            samples = self.collect(floor, expected_z)
        return summarize(samples, self.settings.sampling.result)

    def collect(self, floor, expected_z):
        sampling = self.settings.sampling
        top = self.host.motion.z()
        speed = "%.6f" % (sampling.speed,)
        session = touching.probing(self.head, floor.z, top, PROBE_SPEED=speed)
        with session as probe_once:
            self.come_down(floor.z, expected_z)
            sample = functools.partial(self.sample, probe_once, floor)
            return collect(sample, sampling, self.report, DIFFER)

    # Quickly to where a touch begins, through air: the nozzle has just met the
    # bed lower down.
    def come_down(self, floor, expected_z):
        if expected_z is not None:
            sampling = self.settings.sampling
            accel = motors.braking_accel(self.host, 0.0)
            above = heights.approach(sampling.speed, accel)
            top = max(floor, expected_z) + above
            self.head.move_down(top, sampling.lift_speed)

    def sample(self, probe_once, floor):
        self.head.retract()
        self.head.check_above(floor.z)
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
            return self.head.touch(self.host.probing.endstop(), floor.z, speed)
        except errors.CalibrationError as e:
            if not touching.is_at(self.host, floor.z):
                raise e.advised(touching.CHECK_PROBE)
            text = "%s %s: that was not the bed, or the probe does not see it"
            error = errors.NoTrigger(text % (e, floor.why))
            raise error.advised(touching.CHECK_PROBE)

    # As G28, from which the correction is counted, or else the mesh sees it
    def homed_z(self, probed):
        probing = self.host.probing
        if self.host.axes.homes_with_probe() and not probing.homes_with_twist():
            return probed.z
        return probed.z + probed.twist

    def report(self, text):
        self.watch.say("probe: %s" % (text,))


######################################################################
# One run
######################################################################


# What is known of the bed: toolhead Z (mm), None where nobody knows; it follows what the
# run learns.
class BedHeights:
    def __init__(self):
        # Where the sensor should trigger
        self.expected = heights.NOTHING_EXPECTED
        # Where it has triggered, and where the probe does
        self.sensor_z = self.probe_z = None

    # By what is known from before the run
    def expect(self, expectations):
        self.expected = expectations.expected()
        self.probe_z = expectations.probe_z()

    # By the nozzle; 'expected' is for its next touch.
    def touched(self, z, expected):
        self.sensor_z, self.expected = z, expected

    def probed(self, z):
        self.probe_z = z

    # Z was set: the sensor triggers there now.
    def is_set(self, z):
        self.sensor_z = z


# The head above the bed, from place to place
class Travel:
    def __init__(self, host, settings):
        self.host = host
        self.settings = settings
        # Toolhead Z (mm) that the head is lifted to; it follows what the run learns.
        probe_z = host.probing.homed_probe_z()
        self.z = heights.travel_height(probe_z, settings.probe_hop)
        # The print time at which the head had left the bed
        self.left_at = 0.0

    def lift(self):
        speed = self.settings.sampling.lift_speed
        touching.raise_to(self.host, self.z, speed)

    # From now on over a bed that the nozzle meets at that toolhead Z (mm)
    def rise_over(self, bed_z):
        self.z = bed_z + self.settings.probe_hop

    # Off the bed
    def leave(self):
        self.lift()
        self.left_at = self.host.after_moves()

    def go_to(self, site):
        self.lift()
        self.move(site)

    def move(self, site):
        speed = self.settings.travel_speed
        everything = carrying.of(self.host.printer)
        everything.go_to(self.host, site.x, site.y, speed)


# One command: goes to the bed, prepares the sensor, measures, lifts.
class Run:
    # 'expectations' tell where the bed is; None: whatever was changed since, nothing
    # is expected.
    def __init__(self, sensor, settings, watch, expectations):
        self.host = sensor.host
        self.sensor = sensor
        self.settings = settings
        self.watch = watch
        self.expectations = expectations
        # Of the nozzle's touches; see prepare()
        self.points = None
        self.bed = BedHeights()
        self.travel = Travel(self.host, settings)

    # The user's G-code may have moved the head.  'radius' (mm): within that around
    # the site the nozzle touches.
    def prepare(self, site, radius=0.0):
        self.points = Points(site, radius)
        self.travel.go_to(site)
        self.watch.enter("prepare_gcode")
        # It goes down to where the nozzle is free, and a probe on the head is not
        carrying.of(self.host.printer).free_nozzle(self.host)
        self.run_prepare_gcode()
        running.check_homed(self.host)
        # It may have homed, too
        if self.expectations is not None:
            self.bed.expect(self.expectations)
        self.travel.go_to(self.points.next())

    # Relative moves must not outlive the template, also when it fails.
    def run_prepare_gcode(self):
        restore = functools.partial(self.set_absolute, self.is_absolute())
        with running.always(self.host, restore, "setting G90 or G91 back"):
            template = self.settings.prepare_gcode
            templates.run_template(self.host, "prepare_gcode", template)

    # G90 or G91 of the user's G-code
    def is_absolute(self):
        return self.host.gcode_state.modes().absolute

    def set_absolute(self, absolute):
        if self.is_absolute() != absolute:
            script = "G90" if absolute else "G91"
            self.host.gcode.run_script_from_command(script)

    # Toolhead Z (mm) of the bed sensor's trigger, where the head is.  The head
    # is on its way up then, see check_left().
    def measure_sensor(self):
        self.watch.enter("bed sensor")
        measurement = SensorMeasurement(
            self.sensor,
            self.settings,
            self.watch,
            self.points,
            self.bed.expected,
        )
        z = measurement.measure(self.travel.z)
        self.bed.touched(z, measurement.expected)
        self.travel.rise_over(z)
        self.travel.leave()
        return z

    # A sensor that stays triggered has not seen the bed.  The head may be under
    # way already: whoever looks only when it stands waits longer.
    def check_left(self):
        with errors.about("bed sensor"):
            self.sensor.check_open(self.travel.left_at)

    def measure_sensor_alone(self):
        z = self.measure_sensor()
        self.check_left()
        return z

    # Both sensors over one point, the nozzle around it with bed_spread; returns
    # Result.
    def measure(self, probe_site):
        self.travel.go_to(self.points.next())
        sensor_z = self.measure_sensor()
        self.watch.enter("probe")
        self.travel.move(probe_site)
        self.check_left()
        measurement = ProbeMeasurement(self.host, self.settings, self.watch)
        probe_z = measurement.measure(sensor_z, self.bed.probe_z)
        self.bed.probed(probe_z)
        self.travel.lift()
        # It is the nozzle that goes down next, whoever sends it
        carrying.of(self.host.printer).settle(self.host)
        probe_z_offset = self.host.probing.offsets()[2]
        parts = (sensor_z, probe_z, probe_z_offset, self.settings.z_offset)
        return heights.Result(*parts + (heights.correction(*parts),))

    # From here on Z is z_offset where the sensor has triggered, at z.  Last, so
    # that nothing can fail in a frame that is another one.
    def set_z(self, z):
        z_offset = self.settings.z_offset
        position = self.host.toolhead.get_position()
        position[2] += z_offset - z
        self.host.toolhead.set_position(position)
        self.bed.is_set(z_offset)
        self.travel.rise_over(z_offset)
