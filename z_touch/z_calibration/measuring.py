# One site of a Z calibration: get there, come down, touch, look, come up.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#                          nozzle           switch           bed
#
#   touches with           the tip          the body         the probe
#   stopped by             the pin          the pin          the probe
#   looked at meanwhile    the probe        the probe        the pin
#
# The sensor that stops a touch is looked at by the host before each move.  The
# other one is not armed, so it is looked at here: when the head has arrived,
# and while it presses.

import functools

from ..core import carrying, errors, motion, touching
from ..core.spread import spread_site, spread_tolerance
from . import checks, pace
from .heights import (
    FREE_PLUNGER,
    HANGS_BELOW,
    HOME_AGAIN,
    below_margins,
    ended_by_position_min,
    may_hang,
    nozzle_floor,
)
from .results import Warned

# What to do about samples that differ
DIFFER = "clean the nozzle and check the switch for play"

# What to do where the head is below the floor of a touch already
TOO_LOW = (
    "correct switch_offset (larger than any switch has it) or"
    " position_max of the Z axis"
)

# So far (mm) above where the nozzle should meet the pin a probe that is left on the
# head has met the bed, if it does so at all
ABOVE_PIN = 0.5

# At least so far (mm) a plunger goes in beyond where it triggers
LOOK_STEP = 0.2

# Lift (mm) before the free plunger is moved over the plate
CLEAR_OF_PLATE = FREE_PLUNGER + 0.5

LOOK_AT_PROBE = "check it with QUERY_PROBE"

# Where an earlier run has limited a touch
IF_CHANGED = (
    ", or, if pin, bed or probe was changed, run CALIBRATE_Z ACCEPT_CHANGE=1"
)

PLUNGER_PRESSED = (
    "switch: the pin presses the plunger of the probe besides its body, which"
    " makes the height wrong; correct %s"
)


# What the touches of one run have in common, and what was seen in it so far
class Run:
    # 'settings': completed; 'pin': what nozzle and body press; 'plan' has the
    # samples; 'watch' is told what happens; 'homed' is the frame.HomedFrame; 'tells':
    # each place is told when it is done.
    def __init__(self, host, settings, pin, plan, watch, homed, tells):
        self.host = host
        self.settings = settings
        self.pin = pin
        self.plan = plan
        self.watch = watch
        self.homed = homed
        self.tells = tells
        self.warnings = []
        # What the host adds to what the probe says there (mm), for a twisted axis
        self.twist = 0.0
        # Whether somebody has seen the probe on the head
        self.was_attached = False

    # Once for all samples.  'about': a site, or formats.BODY
    def warn(self, about, text):
        warned = Warned(about, text)
        if warned not in self.warnings:
            self.warnings.append(warned)
            self.watch.say(text)

    def saw_twist(self, twist):
        self.twist = twist

    def saw_attached(self):
        self.was_attached = True


# One site: approach it, touch it, come back up.
class Measurement:
    # What to look at after a touch that failed; %s is where the site comes from.
    # Each site has its own.
    remedy = None
    # Whether the way there goes along X, then along Y
    x_first = False

    def __init__(self, run, site, sampling):
        self.run = run
        self.host = run.host
        self.settings = run.settings
        self.site = site
        self.sampling = sampling
        self.head = touching.Head(run.host, sampling, TOO_LOW)
        # Of the samples; None: there are none
        self.expected_z = self.floor = None
        # Samples so far
        self.taken = 0
        # What the first touch goes before, in one move (motion.Way), or None
        self.way = None

    # Returns the height: toolhead Z in mm.  'travel_z': where the head moves in
    # X and Y; 'expected_z': where the trigger should be, None: nobody knows;
    # 'floor': no touch goes lower.
    def measure(self, travel_z, expected_z, floor):
        self.take_samples(travel_z, expected_z, floor)
        return self.run.plan.estimates[self.site.name].z

    # The heights of the samples; more of them is in the plan.
    def take_samples(self, travel_z, expected_z, floor):
        self.expected_z, self.floor = expected_z, floor
        with errors.about(self.site.name):
            samples = self.touch_site(travel_z, floor)
        if self.run.tells:
            self.tell(samples)
        return samples

    # Where the place is, by so many touches
    def tell(self, samples):
        name, count = self.site.name, len(samples)
        text = "%s at z=%.3f" % (name, self.run.plan.estimates[name].z)
        if count == 1:
            text += " (1 touch)"
        else:
            apart = max(samples) - min(samples)
            text += " (%d touches, %.3f mm apart)" % (count, apart)
        self.run.watch.say(text)

    # All of it, in the order in which it is done
    def touch_site(self, travel_z, floor):
        self.arrive(travel_z)
        self.come_down(travel_z, floor)
        return self.collect(floor)

    # What is to be pressed at this site
    def endstop(self):
        return self.run.pin.endstop

    # Looks at the sensor that is not armed while the head presses the other one
    def check_pressed(self):
        pass

    # Raises what is known of a touch that failed
    def explain(self):
        self.check_pin_open(self.host.after_moves())

    # A head that is over the site, and high enough for a touch, has arrived.
    def arrive(self, travel_z):
        is_high = self.host.motion.z() >= self.top(travel_z)
        is_there = self.expected_z is not None and is_high
        if not (is_there and touching.is_over(self.host, self.site)):
            self.go_there(travel_z)

    # Up first, so that nothing is hit on the way; never down to get there.
    def go_there(self, travel_z):
        self.head.lift(travel_z)
        site, speed = self.site, self.settings.speed
        everything = carrying.of(self.host.printer)
        everything.go_to(self.host, site.x, site.y, speed, self.x_first)

    # Where the samples begin: toolhead Z (mm)
    def top(self, travel_z):
        if self.expected_z is None:
            return travel_z
        return max(self.expected_z, self.floor) + self.sampling.retract_dist

    # Quickly down to where every sample begins: above the expected trigger.
    # Where nobody knows where that is, slowly from the travel height on.
    def come_down(self, travel_z, floor):
        if self.settings.probing_first_fast:
            self.first_touch(floor)
            return
        top, speed = self.top(travel_z), self.settings.probing_speed
        if not self.can_join_way():
            self.attempt(self.head.come_down, self.endstop(), top, speed)
        elif self.host.motion.z() > top:
            self.way = motion.Way(top, speed)

    # Whether the first touch may be one move with the way down
    def can_join_way(self):
        return self.host.motion.can_join()

    # The first touch gets the head down; it is no sample
    def first_touch(self, floor):
        speed, settings = self.settings.probing_speed, self.settings
        if "probing_speed" not in settings.said:
            # It is a touch, and those are as fast as the user has them
            speed = min(speed, self.host.axes.z_axis.homing_speed)
        self.attempt(self.head.touch, self.endstop(), floor, speed)

    # The heights of the samples, as many as the plan wants
    def collect(self, floor):
        take = functools.partial(self.take_sample, floor)
        name, sampling = self.site.name, self.sampling
        return self.run.plan.collect(name, take, sampling, self.report, DIFFER)

    # One height: toolhead Z in mm
    def take_sample(self, floor):
        if not self.is_touched_after_way(floor):
            before_z = self.head.pressed_z
            self.retract()
            self.attempt(self.touch_again, floor, before_z)
        z = self.head.pressed_z
        self.check_pressed()
        self.taken += 1
        self.run.watch.touched()
        text = "%s: touched at z=%.6f%s"
        told = text % (self.site.name, z, self.point_told())
        self.run.watch.detail(told)
        return z

    # Whether the way down is done in this move, and has ended with a touch
    def is_touched_after_way(self, floor):
        way, self.way = self.way, None
        if way is None:
            return False
        arguments = way, self.endstop(), floor, self.sampling.speed
        return self.attempt(self.head.touch_after, *arguments)

    # Where that was, in words; empty: where all touches are
    def point_told(self):
        return ""

    def touch_once(self, floor):
        self.head.touch(self.endstop(), floor, self.sampling.speed)

    # One touch, begun higher up where the switch is still pressed after a short lift.
    # 'before_z': where it had triggered, None: it was not touched before.
    def touch_again(self, floor, before_z):
        try:
            self.touch_once(floor)
        except errors.CalibrationError:
            if before_z is None or not self.lift_more(before_z):
                raise
            self.touch_once(floor)

    # Up until the switch opens, which is the lift from now on; returns whether it
    # does.
    def lift_more(self, pressed_z):
        endstop, lift = self.endstop(), self.sampling.retract_dist
        if not pace.may_lengthen(self.settings):
            return False
        if not endstop.query_endstop(self.host.print_time()):
            return False
        while lift < pace.LONGEST_LIFT:
            lift = min(2.0 * lift, pace.LONGEST_LIFT)
            self.head.lift(pressed_z + lift)
            if not endstop.query_endstop(self.host.after_moves()):
                self.sampling = self.sampling._replace(retract_dist=lift)
                self.head.use_lift(lift)
                return True
        self.explain()
        return False

    # Up until nothing is pressed any more, whatever is lifted between touches
    def lift_clear(self):
        lift = self.sampling.retract_dist
        if pace.may_lengthen(self.settings):
            lift = max(lift, pace.LONGEST_LIFT)
        highest = self.settings.position_max
        self.head.lift(min(self.host.motion.z() + lift, highest))

    # Returns touch(*args).  Its error says what was expected and what to look at;
    # where nothing triggered, or at once, the sensors may know better.
    def attempt(self, touch, *args):
        start_z = self.host.motion.z()
        try:
            touched = touch(*args)
        except errors.CalibrationError as e:
            at_start = touching.is_at(self.host, start_z)
            if isinstance(e, errors.NoTrigger) or at_start:
                self.explain()
            raise e.advised(self.advice(), self.expected_z, self.floor_reason())
        self.check_height()
        return touched

    # Raises CalibrationError where what was just touched cannot be the right thing
    def check_height(self):
        pass

    # What to look at after a touch that has just failed
    def advice(self):
        return self.remedy % (self.site.place(),)

    # Why it has ended where it did, if that was position_min
    def floor_reason(self):
        if self.floor is None or not touching.is_at(self.host, self.floor):
            return ""
        section = checks.position_min_section(self.host, self.settings)
        return ended_by_position_min(
            self.settings, section, self.floor, self.expected_z
        )

    # Up to where the next touch begins
    def retract(self):
        self.head.retract()

    def report(self, text):
        self.run.watch.say("%s: %s" % (self.site.name, text))

    ##################################################################
    # The two sensors, as they are at a print time
    ##################################################################

    def check_pin_open(self, print_time):
        if self.run.pin.endstop.query_endstop(print_time):
            raise errors.CalibrationError(
                "%s reads triggered where nothing should press it; check it"
                " with QUERY_ENDSTOPS" % (self.run.pin.name,)
            )

    def check_probe_attached(self, print_time):
        if not self.host.probing.endstop().query_endstop(print_time):
            self.run.saw_attached()
            return
        if self.run.was_attached:
            raise errors.CalibrationError(
                "the probe reads triggered, and was attached before: it has come"
                " off, or its wire is broken; look where it is before the head"
                " moves and " + LOOK_AT_PROBE
            )
        # Whoever is led through the set-up may have none yet
        where = (
            " in start_gcode or before_switch_gcode" if self.site.option else ""
        )
        raise errors.CalibrationError(
            (
                "the probe reads triggered: it is not attached, or not wired"
                " as normally closed; attach it%s and " + LOOK_AT_PROBE
            )
            % (where,)
        )


# The nozzle tip on the pin
class NozzleMeasurement(Measurement):
    remedy = HOME_AGAIN + ", then check %s and the switch there"
    # A dock that nobody knows is more often beside the pin than in front of it.
    x_first = True

    def touch_site(self, travel_z, floor):
        is_on = self.may_meet_bed() and self.reads_attached(travel_z)
        if is_on:
            floor = self.look_for_bed(floor)
        samples = self.touch_free_site(travel_z, floor)
        if is_on:
            self.run.pin.places.note(self.site.x, self.site.y)
        return samples

    # Whether what hangs on the head may meet the bed before the nozzle meets the pin:
    # a probe that before_switch_gcode is there for, or one that start_gcode has put
    # on, where nobody knows yet that the pin is here.
    def may_meet_bed(self):
        if self.is_attached_late():
            return True
        if self.run.pin.places.is_met_at(self.site.x, self.site.y):
            return False
        carrier = self.carrier()
        return carrier is None or carrier.state() != carrying.DOCKED

    def is_attached_late(self):
        return self.carrier() is None and self.settings.may_attach_late

    def carrier(self):
        return carrying.of(self.host.printer).carrier(self.host)

    # Over the pin: left on, put on by start_gcode, or it always does, as one that is
    # wired as normally open
    def reads_attached(self, travel_z):
        moved = self.host.after_moves()
        self.arrive(travel_z)
        looked = touching.before_arrival(self.host, moved)
        return not self.host.probing.endstop().query_endstop(looked)

    # Returns the floor of what follows.  In each run that has to be quick: the
    # probe's switch ends the way down where the pin is known to be below.
    def look_for_bed(self, floor):
        is_met = self.run.pin.places.is_met_at(self.site.x, self.site.y)
        if is_met and self.is_pin_known():
            self.look_in_one_move(floor)
            return floor
        met_z = self.look_in_steps(floor)
        if met_z is None:
            return floor
        # A switch may open late, and its height is known from now on
        self.retract()
        self.lift_clear()
        self.expected_z = met_z
        self.floor = max(floor, nozzle_floor(self.settings, met_z))
        return self.floor

    # Whether the pin is as high as expected_z says
    def is_pin_known(self):
        is_homed_on = self.settings.position_endstop is not None
        is_moved = is_homed_on and bool(self.run.homed.moved())
        return self.expected_z is not None and not is_moved

    def look_in_one_move(self, floor):
        low = max(self.expected_z, floor) + ABOVE_PIN
        probe, speed = self.host.probing.endstop(), self.settings.probing_speed
        met_z = self.head.come_down(probe, low, speed)
        if met_z is not None:
            self.refuse_attached(met_z)

    # Only one switch can end a move: otherwise that is the pin, and the probe is
    # looked at after each step.  Returns where the pin was met, None: nowhere.
    def look_in_steps(self, floor):
        probe, speed = self.host.probing.endstop(), self.settings.probing_speed
        z = max(self.hangs(), floor)
        while True:
            met_z = self.head.come_down(self.endstop(), z, speed)
            if met_z is not None:
                self.check_height()
                return met_z
            if probe.query_endstop(self.host.after_moves()):
                self.refuse_attached(self.host.motion.z())
            if z <= floor:
                return None
            z = max(min(z, self.host.motion.z()) - LOOK_STEP, floor)

    # No higher than this (toolhead Z, mm) the probe meets the bed
    def hangs(self):
        settings = self.settings
        return may_hang(settings.z_offset, settings.offset_margins[1])

    def refuse_attached(self, met_z):
        remedy = (
            "check that the pin is at %s, or attach the probe later, in"
            " before_switch_gcode" % (self.site.place(),)
        )
        if self.is_attached_late():
            remedy = (
                "put it away, and attach it after the nozzle only, in"
                " before_switch_gcode"
            )
        raise errors.CalibrationError(
            "the probe is on the head, and has met the bed at z=%.3f, where"
            " nothing should be met before the pin; %s" % (met_z, remedy)
        )

    # Z was homed on this pin, so the nozzle meets it about there.
    def check_height(self):
        homed_z, z = self.settings.position_endstop, self.head.pressed_z
        if None in (homed_z, z) or z <= homed_z + HANGS_BELOW:
            return
        if self.host.is_file_output():
            return
        # A switch that is stuck has met nothing
        self.lift_clear()
        self.check_pin_open(self.host.after_moves())
        text = "triggered at z=%.3f, %.1f mm above position_endstop (%.3f)"
        text %= (z, z - homed_z, homed_z)
        moved = self.run.homed.moved()
        if moved:
            raise errors.CalibrationError(
                "%s, and %s; %s" % (text, moved, HOME_AGAIN)
            )
        raise errors.CalibrationError(
            "%s, at which Z was homed on this pin: something hangs below the"
            " nozzle, such as the probe; take it off, or attach it in"
            " before_switch_gcode" % (text,)
        )

    def touch_free_site(self, travel_z, floor):
        samples = Measurement.touch_site(self, travel_z, floor)
        if self.settings.wiggle_xy_offsets is not None:
            self.retract()
        return samples

    # A pin that sticks to the nozzle is shaken off before it is pulled up
    def retract(self):
        pressed = self.head.pressed_z is not None
        self.head.retract()
        if pressed and self.settings.wiggle_xy_offsets is not None:
            (x, y), speed = self.settings.wiggle_xy_offsets, self.settings.speed
            site = self.site
            touching.move_xy(self.host, site.x + x, site.y + y, speed)
            touching.move_xy(self.host, site.x, site.y, speed)


# The body of the probe's switch on the same pin
class SwitchMeasurement(Measurement):
    remedy = (
        "check %s, how the probe is seated, and that z_offset"
        " in section 'probe' is about the distance of nozzle and probe"
    )

    # 'is_limited': a good run of before has limited how far down it may look
    def __init__(self, run, site, sampling, is_limited=False):
        Measurement.__init__(self, run, site, sampling)
        self.is_limited = is_limited

    def advice(self):
        remedy = Measurement.advice(self)
        return remedy + IF_CHANGED if self.is_limited else remedy

    # Looks at the probe as well, which may have been attached right before
    def arrive(self, travel_z):
        attached = self.host.after_moves()
        Measurement.arrive(self, travel_z)
        self.check_probe_attached(touching.before_arrival(self.host, attached))

    # A probe that reads triggered is lost, or its plunger is pressed: lifting
    # the head tells which.
    def explain(self):
        if self.host.probing.endstop().query_endstop(self.host.after_moves()):
            self.lift_clear()
            self.check_probe_attached(self.host.after_moves())
            raise errors.CalibrationError(
                "the plunger of the probe was pressed where only its body"
                " should meet the pin; check %s" % (self.site.place(),)
            )
        Measurement.explain(self)

    # A probe whose plunger the pin presses, too, looks lost until it is lifted.
    # The sample counts, with a warning.
    def check_pressed(self):
        if self.host.probing.endstop().query_endstop(self.host.print_time()):
            self.lift_clear()
            self.check_probe_attached(self.host.after_moves())
            text = PLUNGER_PRESSED % (self.site.place(),)
            self.run.warn(self.site.name, text)


# The probe on the print surface, through the host's own probing, told where
# to end.
class BedMeasurement(Measurement):
    remedy = "check %s and the probe (QUERY_PROBE, PROBE)"
    # The host's own probing while a session lasts that ends at the floor
    probe_once = None

    # With bed_spread each sample is at a point of its own.  'lowest': the lowest offset
    # (mm) that the floor allows for, None: it is another floor
    def __init__(self, run, site, sampling, lowest=None):
        self.lowest = lowest
        self.spread = run.settings.bed_spread
        self.middle = site
        tolerance = spread_tolerance(sampling.tolerance, self.spread)
        sampling = sampling._replace(tolerance=tolerance)
        site = spread_site(site, self.spread, 0)
        Measurement.__init__(self, run, site, sampling)

    # X and Y of the bed; the plan keeps them, too
    def point_told(self):
        if not self.spread:
            return ""
        x, y = self.host.toolhead.get_position()[:2]
        x_offset, y_offset = self.host.probing.offsets()[:2]
        point = (x + x_offset, y + y_offset)
        self.run.plan.points.append(point)
        return " at %.2f, %.2f" % point

    # High enough to move on to the next point, around a dock that is so near
    def retract(self):
        pressed_z = self.head.pressed_z
        if not self.spread or pressed_z is None:
            Measurement.retract(self)
            return
        lift = max(self.sampling.retract_dist, CLEAR_OF_PLATE)
        self.head.lift(pressed_z + lift)
        site = spread_site(self.middle, self.spread, self.taken)
        everything = carrying.of(self.host.printer)
        everything.go_to(self.host, site.x, site.y, self.settings.speed)

    def touch_site(self, travel_z, floor):
        self.arrive(travel_z)
        down = functools.partial(self.come_down, travel_z, floor)
        return self.in_session(down, travel_z, floor, self.collect)

    # One fast touch, which tells how long the probe is; returns toolhead Z (mm).
    def look(self, travel_z, floor):
        with errors.about(self.site.name):
            self.go_there(travel_z)
            self.check_probe_attached(self.host.after_moves())
            down = functools.partial(self.first_touch, floor)
            return self.in_session(
                down, travel_z, floor, lambda unused: self.head.pressed_z
            )

    # Returns measure(floor), with the host's own probing begun.  down() comes
    # before that: some hosts run deactivate_gcode after it, too, and an error in
    # it would end the session unseen.  But outside of a session some
    # dockable_probe may lift the head after a move.
    def in_session(self, down, travel_z, floor, measure):
        inside = self.host.probing.lifts_outside_session()
        if not inside:
            down()
        speed = {"PROBE_SPEED": "%.6f" % (self.sampling.speed,)}
        session = touching.probing(self.head, floor, travel_z, **speed)
        with session as self.probe_once:
            if inside:
                down()
            measured = measure(floor)
            # Here, as the host may stow or dock it at the end
            self.leave(travel_z)
        return measured

    # Both sensors must be free again above the bed
    def leave(self, travel_z):
        self.head.lift(travel_z)
        print_time = self.host.after_moves()
        self.check_pin_open(print_time)
        self.check_probe_attached(print_time)

    def endstop(self):
        return self.host.probing.endstop()

    # The host's own probing begins a move of its own
    def can_join_way(self):
        return False

    # A host unknown to us cannot be told the floor: its probing would go on to
    # position_min, so the module touches by itself.
    def touch_once(self, floor):
        self.head.check_above(floor)
        if self.probe_once is not None:
            self.run.saw_twist(self.head.probe(self.probe_once).twist)
        else:
            Measurement.touch_once(self, floor)
            self.run.saw_twist(self.host.probing.twist())

    def explain(self):
        self.check_probe_attached(self.host.after_moves())

    # A bed that nothing was known of, down to the lowest that it may be
    def advice(self):
        remedy, place = "", self.site.place()
        is_below = self.lowest is not None and not self.taken
        if is_below and touching.is_at(self.host, self.floor):
            zero = self.host.axes.z_zero()
            remedy = below_margins(self.settings, self.lowest, zero, self.site)
        if self.site.option:
            place += ", switch_offset"
        return remedy or self.remedy % (place,)
