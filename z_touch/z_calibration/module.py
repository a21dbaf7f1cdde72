# The object behind [z_calibration], its settings, measurements and commands.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import contextlib
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
from ..history import recorder as recording
from ..uncertainty import adaptive
from . import corrections
from . import sites as places

######################################################################
# Constants
######################################################################

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

# So high (mm) a pin of its own may stand that nobody has measured; the probe
# passes it before the nozzle touches it.
UNMEASURED_PIN = 10.0

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

# Within this distance (mm) of its zero a bed mesh is as good as zero.
MESH_ZERO_NEAR = 1.0

# From here on (mm) a difference is not noise or heat: of the nozzle against
# the height Z was homed at, or of switch minus nozzle against the last run.
STALE_Z = 0.5
GEOMETRY_JUMP = 0.5

# Less (mm) is rounding.
NO_CHANGE = 0.0000001

# What the offset may be off by (mm, 95 %) with samples: auto
TARGET_UNCERTAINTY = 0.008

# What a plate or a material may need (mm) on top of what was measured
LARGEST_ADJUST = 0.5

# An offset of more than this (mm) is worth correcting in position_endstop.
LARGE_OFFSET = 0.2

######################################################################
# Records and maths
######################################################################

# The parts and the outcome of one calibration (mm); see the header.
Result = collections.namedtuple(
    "Result", "probe switch nozzle switch_offset offset"
)

# What the user configured: mm and mm/s.  None stands for "as the probe has
# it" until complete() has filled it in, and for a place or a switch_offset
# that is to come with the command; position_endstop is None where the pin is
# not what Z is homed on.
Settings = collections.namedtuple(
    "Settings",
    "nozzle switch switch_xy_offsets bed wiggle switch_offset"
    " attach_after_nozzle first_fast"
    " offset_margins travel_margin position_endstop position_min position_max"
    " safe_z_height speed probing_speed z_offset pin probe target save_button"
    " unmeasured_pin",
)


# What to do about samples that differ
DIFFER = "clean the nozzle and check the switch for play"

PLUNGER_PRESSED = (
    "switch: the pin presses the plunger of the probe besides its body, which"
    " makes the height wrong; correct switch_xy_position"
)

TOO_LOW = (
    "correct switch_offset, which is larger than any switch has it, or"
    " position_max of the Z axis"
)


def offset(probe, switch, nozzle, switch_offset):
    return probe - (switch - nozzle + switch_offset)


def check_offset(result, margins):
    low, high = margins
    if low <= result.offset <= high:
        return
    raise errors.CalibrationError(
        "offset %.3f is outside offset_margins %.3f to %.3f"
        " (probe=%.3f switch=%.3f nozzle=%.3f); home Z again (G28 Z) after any"
        " levelling, then check the three positions and position_endstop"
        % ((result.offset, low, high) + result[:3])
    )


# Expected heights (toolhead Z, mm; None: no idea): 'last' is the last good
# Result or None, 'holds' whether the frame is still the one of that run.


def expect_nozzle(settings, last, holds):
    if last is None or not (holds or settings.position_endstop is None):
        return settings.position_endstop
    return last.nozzle


def expect_switch(settings, nozzle_z, last):
    if last is not None:
        return nozzle_z + last.switch - last.nozzle
    if settings.z_offset < SMALLEST_Z_OFFSET:
        return None
    return nozzle_z + settings.z_offset - settings.switch_offset


def expect_bed(settings, nozzle_z, switch_z, last):
    gap = switch_z - nozzle_z + settings.switch_offset
    return gap + (last.offset if last is not None else 0.0)


# Lowest useful toolhead Z of each touch.  The nozzle meets the pin where Z
# was homed, give or take what the margins allow.
def nozzle_floor(settings, expected_z):
    reach = max(settings.travel_margin, -settings.offset_margins[0])
    homed_z = settings.position_endstop
    if homed_z is None:
        # A separate pin: nobody knows how high it is until it was touched
        homed_z = expected_z
    if homed_z is None:
        return settings.position_min
    return max(settings.position_min, homed_z - reach)


# The body hangs below the nozzle, in any case
def switch_floor(settings, nozzle_z, expected_z):
    floor = max(settings.position_min, nozzle_z + BODY_BELOW_NOZZLE)
    if expected_z is None:
        return floor
    return max(floor, expected_z - settings.travel_margin)


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


# Over a pin at pin_z (None: nobody knows), and the bed, with a probe whose body
# hangs 'body' below the nozzle.
def travel_height(settings, pin_z, body):
    if pin_z is None:
        pin_z = settings.unmeasured_pin
    hangs = max(settings.z_offset, UNMEASURED_PROBE)
    if body is not None:
        hangs = body + settings.switch_offset + FREE_PLUNGER
    # The bed lies at about 0
    clear = max(pin_z, 0.0) + hangs + settings.travel_margin
    return min(max(settings.safe_z_height, clear), settings.position_max)


# Over the pin and the bed, which may lie as high as the upper margin lets it.
def travel_height_to_bed(settings, nozzle_z, switch_z):
    gap = switch_z - nozzle_z + settings.switch_offset
    highest = max(nozzle_z, settings.offset_margins[1])
    clear = highest + gap + FREE_PLUNGER + settings.travel_margin
    return min(max(settings.safe_z_height, clear), settings.position_max)


# Let the probe and the axis decide what the user left open.
def complete(settings, probe, z_offset, position_max):
    settings = settings._replace(
        pin=filled(settings.pin, probe),
        probe=filled(settings.probe, probe),
        z_offset=z_offset,
        position_max=position_max,
    )
    if settings.safe_z_height is not None:
        return settings._replace(unmeasured_pin=0.0)
    # A probe that comes after the nozzle finds the pin measured
    is_passed = settings.position_endstop is None
    is_passed = is_passed and not settings.attach_after_nozzle
    return settings._replace(
        safe_z_height=default_safe_z(z_offset),
        unmeasured_pin=UNMEASURED_PIN if is_passed else 0.0,
    )


# A record with the values of another one where it has none
def filled(record, other):
    pairs = zip(record, other)
    return record._make(b if a is None else a for a, b in pairs)


######################################################################
# Options
######################################################################


# A Site or None: under its option, or as probe_<name>_x and _y of old
def read_site(config, name, old_names):
    option = name + "_xy_position"
    olds = ["probe_%s_%s" % (name, axis) for axis in "xy"]
    pair = options.pair(config, option)
    old = [options.number(config, axis) for axis in olds]
    if None in old and old != [None, None]:
        raise config.error(
            "Option '%s' in section '%s': only one of '%s' and '%s' is given;"
            " write both, better as '%s: X,Y'"
            % ((option, config.get_name()) + tuple(olds) + (option,))
        )
    if None not in old:
        text, values = "options '%s' and '%s' are ignored, '%s' is given", []
        if pair is None:
            text, values = "options '%s' and '%s' are now '%s: %g,%g'", old
        old_names.notes.append(text % tuple(olds + [option] + values))
    if pair is None and None not in old:
        return touching.option_site(config, name, " and ".join(olds), old)
    return pair and touching.option_site(config, name, option, pair)


# Where Z is homed on the pin itself, [safe_z_home] has its place.
def read_nozzle_site(config, own_pin, old_names):
    site = read_site(config, "nozzle", old_names)
    if site is not None or own_pin or not config.has_section("safe_z_home"):
        return site
    home = config.getsection("safe_z_home")
    pair = home.getfloatlist(
        "home_xy_position", None, count=2, note_valid=False
    )
    return pair and touching.option_site(
        home, "nozzle", "home_xy_position", pair
    )


# Of the pin; for the bed only what is given, the rest is as the probe has it.
def read_samplings(config, z_axis, old_names):
    number = functools.partial(options.number, config)
    speed = old_names.name_of("probing_second_speed", "second_homing_speed")
    retract = old_names.name_of("probing_retract_dist", "homing_retract_dist")
    default_retract = z_axis.homing_retract_dist or FALLBACK_RETRACT
    pin = sampling.Sampling(
        samples=options.samples(config),
        tolerance=number("samples_tolerance", minval=0.0),
        retries=config.getint("samples_tolerance_retries", None, minval=0),
        result=config.getchoice("samples_result", options.RESULTS, None),
        speed=number(speed, z_axis.second_homing_speed, above=0.0),
        retract_dist=number(retract, default_retract, above=0.0),
        lift_speed=number("lift_speed", above=0.0),
    )
    bed = pin._replace(
        speed=pin.speed if old_names.is_given(speed) else None,
        retract_dist=pin.retract_dist if old_names.is_given(retract) else None,
    )
    return pin, bed


def read_position_min(config, z_axis, homed_z, old_names):
    own = options.number(config, "position_min")
    if own is None:
        return z_axis.position_min
    if homed_z is not None and own > homed_z:
        raise config.error(
            "Option 'position_min' in section 'z_calibration': %.3f is above"
            " position_endstop (%.3f) of section '%s', no touch could reach"
            " the pin; remove it or write a smaller value"
            % (own, homed_z, z_axis.section)
        )
    if own < z_axis.position_min:
        old_names.notes.append(
            "option 'position_min: %g' is ignored, section '%s' ends at %g"
            % (own, z_axis.section, z_axis.position_min)
        )
    return max(own, z_axis.position_min)


# mm at 95 %, for samples: auto
def read_target(config, pin, old_names):
    target = options.number(
        config, "target_uncertainty", TARGET_UNCERTAINTY, above=0.0
    )
    is_auto = pin.samples == sampling.AUTO
    idle = (
        ("samples_tolerance", "samples_tolerance_retries", "samples_result")
        if is_auto
        else ("target_uncertainty",)
    )
    for name in idle:
        if old_names.is_given(name):
            text = "option '%s' is ignored %s 'samples: auto'"
            how = "with" if is_auto else "without"
            old_names.notes.append(text % (name, how))
    return target


def read_wiggle(config):
    pair = options.pair(config, "wiggle_xy_offsets")
    return pair if pair and any(pair) else None


# 'own_pin' where the nozzle presses another switch than the Z endstop
def read_settings(config, z_axis, own_pin, old_names):
    number = functools.partial(options.number, config)
    # None where it is the probe that Z is homed with; that is refused later
    homed_z = None if own_pin else z_axis.position_endstop
    speed = old_names.name_of("probing_speed", "homing_speed")
    margins = old_names.name_of("offset_margins", "max_deviation")
    safe_z = old_names.name_of("safe_z_height", "clearance")
    # 0 was "as the probe has it" under the old name
    lowest = {"minval": 0.0} if safe_z == "clearance" else {"above": 0.0}
    pin, bed = read_samplings(config, z_axis, old_names)
    return Settings(
        nozzle=read_nozzle_site(config, own_pin, old_names),
        switch=read_site(config, "switch", old_names),
        switch_xy_offsets=options.pair(config, "switch_xy_offsets"),
        bed=read_site(config, "bed", old_names),
        wiggle=read_wiggle(config),
        switch_offset=number("switch_offset", minval=0.0),
        attach_after_nozzle=templates.attaches_probe(
            config.get("before_switch_gcode", ""),
            config.get("start_gcode", ""),
            templates.read_macros(config),
        ),
        first_fast=config.getboolean("probing_first_fast", False),
        offset_margins=options.margins(config, margins, OFFSET_MARGINS),
        travel_margin=number("travel_margin", TRAVEL_MARGIN, above=0.0),
        position_endstop=homed_z,
        position_min=read_position_min(config, z_axis, homed_z, old_names),
        safe_z_height=number(safe_z, **lowest) or None,
        speed=number("speed", TRAVEL_SPEED, above=0.0),
        probing_speed=number(speed, z_axis.homing_speed, above=0.0),
        pin=pin,
        probe=bed,
        target=read_target(config, pin, old_names),
        save_button=corrections.read_button(config),
        # From the probe and the axes, when klippy connects
        position_max=None,
        z_offset=None,
        unmeasured_pin=None,
    )


######################################################################
# Measuring
######################################################################


# One site: approach it, touch it, come back up.  'watch' is told of every
# touch.
class Measurement(object):
    def __init__(self, run, site, samples):
        self.host = run.host
        self.settings = run.settings
        self.pin = run.pin
        self.plan = run.plan
        self.watch = run.watch
        self.warn = run.warn
        self.site = site
        self.sampling = samples
        self.head = touching.Head(run.host, samples, TOO_LOW)
        self.expected_z = None
        self.taken = 0

    # Returns the height: toolhead Z in mm
    def measure(self, travel_z, expected_z, floor):
        self.samples(travel_z, expected_z, floor)
        return self.plan.found[self.site.name].z

    def samples(self, travel_z, expected_z, floor):
        self.expected_z = expected_z
        with errors.about(self.site.name):
            return self.run(travel_z, expected_z, floor)

    def run(self, travel_z, expected_z, floor):
        self.go_there(travel_z)
        self.come_down(travel_z, expected_z, floor)
        return self.collect(floor)

    # What is to be pressed at this site
    def endstop(self):
        return self.pin.endstop

    # The other sensor of the two, which is not armed: before the first touch
    def check_arrived(self):
        pass

    # and while the head still presses.  The armed one is looked at by the
    # host, see Head.touch().
    def check_pressed(self):
        pass

    # Raises what is known of a touch that failed
    def explain(self):
        self.check_pin_open(self.host.after_moves())

    # Up first, so that nothing is hit on the way; never down to get there.
    def go_there(self, travel_z):
        self.head.lift(travel_z)
        site, speed = self.site, self.settings.speed
        touching.move_xy(self.host, site.x, site.y, speed)
        self.check_arrived()

    # Down to where every sample begins.  'expected_z' None: slowly from the
    # travel height on, then.
    def come_down(self, travel_z, expected_z, floor):
        if self.settings.first_fast:
            self.first_touch(floor)
            return
        top = travel_z
        if expected_z is not None:
            top = max(expected_z, floor) + self.sampling.retract_dist
        speed = self.settings.probing_speed
        self.touching(self.head.come_down, self.endstop(), top, speed)

    # The first touch gets the head down; it is no sample
    def first_touch(self, floor):
        speed = self.settings.probing_speed
        self.touching(self.head.touch, self.endstop(), floor, speed)

    def collect(self, floor):
        take = functools.partial(self.sample, floor)
        name, samples = self.site.name, self.sampling
        return self.plan.collect(name, take, samples, self.report, DIFFER)

    def sample(self, floor):
        self.retract()
        self.touching(self.touch_once, floor)
        self.check_pressed()
        self.taken += 1
        self.watch.touched()
        self.report("touched at z=%.6f" % (self.head.pressed_z,))
        return self.head.pressed_z

    def touch_once(self, floor):
        self.head.touch(self.endstop(), floor, self.sampling.speed)

    def touching(self, touch, *args):
        start_z = self.host.z()
        try:
            touch(*args)
        except errors.CalibrationError as e:
            at_start = touching.is_at(self.host, start_z)
            if isinstance(e, errors.NoTrigger) or at_start:
                self.explain()
            wanted = ""
            if self.expected_z is not None:
                wanted = ", expected a trigger at z=%.3f" % (self.expected_z,)
            raise e.advised(self.remedy, wanted)

    # Up to where the next touch begins
    def retract(self):
        self.head.retract()

    def report(self, msg):
        self.watch.say("%s: %s" % (self.site.name, msg))

    def check_pin_open(self, print_time):
        if self.pin.endstop.query_endstop(print_time):
            raise errors.CalibrationError(
                "%s reads triggered where nothing should press it; check it"
                " with QUERY_ENDSTOPS" % (self.pin.name,)
            )

    def check_probe_attached(self, print_time):
        if self.host.probing.endstop().query_endstop(print_time):
            raise errors.CalibrationError(
                "the probe reads triggered: it is not attached, or not wired"
                " as normally closed; attach it in start_gcode or"
                " before_switch_gcode, check it with QUERY_PROBE"
            )


# The nozzle tip on the pin
class NozzleMeasurement(Measurement):
    remedy = (
        "home Z again (G28 Z) after any levelling; check nozzle_xy_position"
        " and the switch there"
    )

    def run(self, travel_z, expected_z, floor):
        samples = Measurement.run(self, travel_z, expected_z, floor)
        if self.settings.wiggle is not None:
            self.retract()
        return samples

    # A pin that sticks to the nozzle is shaken off before it is pulled up
    def retract(self):
        pressed = self.head.pressed_z is not None
        self.head.retract()
        if pressed and self.settings.wiggle is not None:
            (x, y), speed = self.settings.wiggle, self.settings.speed
            site = self.site
            touching.move_xy(self.host, site.x + x, site.y + y, speed)
            touching.move_xy(self.host, site.x, site.y, speed)

    # X first: a dock is more often beside the pin than in front of it
    def go_there(self, travel_z):
        self.head.lift(travel_z)
        y = self.host.toolhead.get_position()[1]
        touching.move_xy(self.host, self.site.x, y, self.settings.speed)
        Measurement.go_there(self, travel_z)

    def check_arrived(self):
        if self.settings.attach_after_nozzle:
            self.check_probe_absent(self.host.after_moves())

    def check_pressed(self):
        if self.settings.attach_after_nozzle:
            self.check_probe_absent(self.host.print_time())

    def check_probe_absent(self, print_time):
        if not self.host.probing.endstop().query_endstop(print_time):
            raise errors.CalibrationError(
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
        if self.host.probing.endstop().query_endstop(self.host.after_moves()):
            self.head.lift(self.host.z() + self.sampling.retract_dist)
            self.check_probe_attached(self.host.after_moves())
            raise errors.CalibrationError(
                "the plunger of the probe was pressed where only its body"
                " should meet the pin; check switch_xy_position"
            )
        Measurement.explain(self)

    # Where the pin presses the plunger, too, it looks lost until lifted
    def check_pressed(self):
        if self.host.probing.endstop().query_endstop(self.host.print_time()):
            z = self.head.pressed_z
            self.retract()
            self.check_probe_attached(self.host.after_moves())
            self.head.pressed_z = z
            self.warn(PLUNGER_PRESSED)


# The probe on the print surface, through the host's own probing, told where
# to end.
class BedMeasurement(Measurement):
    remedy = "check bed_xy_position, switch_offset and the probe"
    # The host's own probing while a session lasts that ends at the floor
    probe_once = None

    def run(self, travel_z, expected_z, floor):
        self.go_there(travel_z)
        down = functools.partial(self.come_down, travel_z, expected_z, floor)
        return self.in_session(down, travel_z, floor, self.collect)

    # One touch: how long is this probe?
    def look(self, travel_z, floor):
        with errors.about(self.site.name):
            self.go_there(travel_z)
            self.check_probe_attached(self.host.after_moves())
            down = functools.partial(self.first_touch, floor)
            return self.in_session(
                down, travel_z, floor, lambda unused: self.head.pressed_z
            )

    # Outside of a session Kalico's dockable_probe lifts the head after a move;
    # otherwise down() comes before: some hosts run deactivate_gcode after it,
    # too, and an error in it would end the session unseen.
    def in_session(self, down, travel_z, floor, measure):
        lookup = self.host.printer.lookup_object
        inside = lookup("dockable_probe", None) is not None
        if not inside:
            down()
        speed = {"PROBE_SPEED": "%.6f" % (self.sampling.speed,)}
        session = touching.probing(self.head, floor, travel_z, **speed)
        with session as self.probe_once:
            if inside:
                down()
            found = measure(floor)
            # Here, as the host may stow or dock it at the end
            self.leave(travel_z)
        return found

    def leave(self, travel_z):
        self.head.lift(travel_z)
        print_time = self.host.after_moves()
        self.check_pin_open(print_time)
        self.check_probe_attached(print_time)

    def endstop(self):
        return self.host.probing.endstop()

    def touch_once(self, floor):
        self.head.check_above(floor)
        if self.probe_once is not None:
            self.head.probe(self.probe_once)
        else:
            # A host unknown to us: its probing would go on to position_min
            Measurement.touch_once(self, floor)

    def explain(self):
        self.check_probe_attached(self.host.after_moves())


# One run: nozzle, switch, bed.
class Calibration(object):
    def __init__(self, machine, settings, pin, sites, watch, plan):
        self.host = machine
        self.settings = settings
        self.pin = pin
        self.sites = sites
        self.watch = watch
        self.plan = plan
        self.warnings = []
        # Cleans the nozzle, told why; None: nothing is there to do so
        self.clean = None
        # switch - nozzle of earlier runs: trend.Summary
        self.learned = None
        # The last good Result or None, and whether the frame is still its
        self.last = None
        self.holds = False
        self.know(None, False)

    def know(self, last, holds):
        self.last = last
        self.holds = holds
        self.rise_over(expect_nozzle(self.settings, last, holds))

    # Follows what the run learns; the head is lifted to it
    def rise_over(self, pin_z):
        self.travel_z = travel_height(self.settings, pin_z, self.body())

    # switch - nozzle (mm) of the probe that was there last, or None
    def body(self):
        return self.last.switch - self.last.nozzle if self.holds else None

    def measure(self, attach_probe):
        settings = self.settings
        if not settings.attach_after_nozzle:
            # Nobody will attach it later: say so before anything is touched
            self.check_probe_attached()
        nozzle_z = self.measure_nozzle()
        self.rise_over(nozzle_z)
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

    # Once for all samples
    def warn(self, text):
        if text not in self.warnings:
            self.warnings.append(text)
            self.watch.say(text)

    def check_probe_attached(self):
        if self.host.probing.endstop().query_endstop(self.host.after_moves()):
            # A PROBE leaves it pressed on the bed
            self.lift()
            switch = self.site_of_switch()
            switch.check_probe_attached(self.host.after_moves())

    def lift(self):
        speed = self.settings.pin.lift_speed
        touching.raise_to(self.host, self.travel_z, speed)

    def measure_nozzle(self):
        self.sample_clean_nozzle()
        z = self.plan.found["nozzle"].z
        homed_z = self.settings.position_endstop
        if homed_z is not None and abs(z - homed_z) > STALE_Z:
            self.warn(
                "nozzle: z=%.3f is far from position_endstop %.3f, at which Z"
                " was homed; home Z again (G28 Z) after any levelling"
                % (z, homed_z)
            )
        return z

    # Cleaned once where something seems to stick to it
    def sample_clean_nozzle(self):
        try:
            self.sample_nozzle()
        except errors.CalibrationError:
            if self.clean is None or not self.plan.differed:
                raise
        why = self.plan.doubt("nozzle")
        if self.clean is not None and why:
            self.watch.say("nozzle: %s; cleaning it, then once more" % (why,))
            self.lift()
            self.clean(why)
            self.sample_nozzle()

    # Where the touches of the nozzle, of the switch, of the bed end at the latest
    def floor(self, nozzle_z=None, switch_z=None):
        settings = self.settings
        if nozzle_z is None:
            expected_z = expect_nozzle(settings, self.last, self.holds)
            return nozzle_floor(settings, expected_z)
        if switch_z is None:
            expected_z = expect_switch(settings, nozzle_z, self.last)
            return switch_floor(settings, nozzle_z, expected_z)
        return bed_floor(settings, nozzle_z, switch_z)

    def sample_nozzle(self):
        self.watch.enter("nozzle")
        settings = self.settings
        nozzle = NozzleMeasurement(self, self.sites.nozzle, settings.pin)
        expected_z = expect_nozzle(settings, self.last, self.holds)
        floor = self.floor()
        return nozzle.samples(self.travel_z, expected_z, floor)

    def site_of_switch(self):
        return SwitchMeasurement(self, self.sites.switch, self.settings.pin)

    def site_of_bed(self):
        return BedMeasurement(self, self.sites.bed, self.settings.probe)

    def measure_switch(self, nozzle_z):
        settings, switch = self.settings, self.site_of_switch()
        expected_z = expect_switch(settings, nozzle_z, self.last)
        floor = self.floor(nozzle_z)
        if expected_z is None:
            floor = self.floor_from_bed(nozzle_z, floor)
        try:
            return switch.measure(self.travel_z, expected_z, floor)
        except errors.NoTrigger as e:
            if expected_z is None or switch.taken:
                raise
            floor = self.find_lower_floor(nozzle_z, floor, e)
            return switch.measure(self.travel_z, None, floor)

    # Nothing down to a floor that came from z_offset or from a probe that may
    # have been exchanged: the bed tells whether that was wrong, or the switch
    # is dead.
    def find_lower_floor(self, nozzle_z, floor, error):
        self.watch.say("%s; looking at the bed how long the probe is" % error)
        hard = switch_floor(self.settings, nozzle_z, None)
        try:
            lowest = self.lowest_switch(nozzle_z)
        except errors.CalibrationError as e:
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
        except errors.NoTrigger as e:
            text = "%s; searching for the switch down to z=%.3f"
            self.watch.say(text % (e, hard))
            return hard

    def lowest_switch(self, nozzle_z):
        settings = self.settings
        floor = unmeasured_bed_floor(settings, nozzle_z)
        if floor >= self.travel_z:
            raise errors.NoTrigger(
                "bed: with offset_margins this wide the nozzle may meet it"
                " first, below z=%.3f" % (floor,)
            )
        bed_z = self.site_of_bed().look(self.travel_z, floor)
        return lowest_switch(settings, nozzle_z, bed_z)

    # An exchanged nozzle is what the module is for; a probe that is seated
    # badly looks the same.
    def check_geometry(self, body):
        before = body
        if self.last is not None:
            before = self.last.switch - self.last.nozzle
        if abs(body - before) > GEOMETRY_JUMP:
            self.warn(
                "switch - nozzle is %.3f mm and was %.3f mm in the last good"
                " run; if neither nozzle nor probe was exchanged, check how the"
                " probe is seated and that the nozzle is tight" % (body, before)
            )
        elif self.learned is not None and self.learned.departs(body):
            self.warn(
                "switch - nozzle is %.3f mm and was %.3f mm in earlier runs:"
                " nozzle exchanged, or the probe is not seated"
                % (body, self.learned.fingerprint.middle)
            )

    def measure_bed(self, nozzle_z, switch_z):
        settings = self.settings
        expected_z = expect_bed(settings, nozzle_z, switch_z, self.last)
        self.travel_z = travel_height_to_bed(settings, nozzle_z, switch_z)
        floor = self.floor(nozzle_z, switch_z)
        return self.site_of_bed().measure(self.travel_z, expected_z, floor)


######################################################################
# Commands
######################################################################


# The last run that was applied: its Result, the frame that was measured in, and
# what was odd; what it is worth (mm at 95 %, None: nobody knows); what Z_ADJUST
# added, and the G-code offset that came of it (mm)
Last = collections.namedtuple(
    "Last", "result mark warnings uncertainty z_adjust applied"
)

# What nozzle and body press, and its name in messages
Pin = collections.namedtuple("Pin", "endstop name")


# The object behind [z_calibration]
class ZCalibration(object):
    def __init__(self, config):
        logging.info("z_calibration %s", __version__)
        self.printer = config.get_printer()
        self.host = host.Host(config)
        host.check_z_axis(config, self.host.z_axis)
        self.frame = frame.Frame(self.host)
        self.runner = running.Runner(self.host)
        self.old_names = options.OldNames(config)
        # None: the Z endstop, which exists when klippy connects
        self.pin = self.read_pin(config)
        self.settings = read_settings(
            config, self.host.z_axis, self.pin is not None, self.old_names
        )
        self.recorder = recording.Recorder(config, self.host, __version__)
        self.templates = templates.load_templates(config)
        # Of the run that is under way; of the last one that was applied
        self.measured = None
        self.last = Last(None, None, (), None, 0.0, 0.0)
        self.last_query = False
        register = self.printer.register_event_handler
        register("klippy:connect", self.connect)
        register("klippy:ready", self.tell_notes)
        running.register_commands(self.host, self)
        running.register_commands(self.host, self.recorder)
        corrections.Corrections(self)

    # Set-up
    def read_pin(self, config):
        name = self.old_names.name_of("endstop_pin", "calibration_endstop_pin")
        text = config.get(name, None)
        if text is None:
            return None
        remedy = (
            "give the pin of the switch that the nozzle presses, or leave the"
            " option out to use the Z endstop"
        )
        endstop = self.host.endstops.make(config, name, remedy)
        return Pin(endstop, "endstop_pin (%s)" % (text,))

    def connect(self):
        machine = self.host
        machine.connect()
        where = "Option 'endstop_pin' in section 'z_calibration'"
        if self.pin is None:
            where, self.pin = self.find_pin()
        machine.endstops.check_stops_z(self.pin.endstop, where)
        self.check_probe()
        self.settings = complete(
            self.settings,
            machine.probing.sampling(),
            machine.probing.offsets()[2],
            machine.axis_limits()[2][1],
        )
        try:
            self.check_settings()
            places.Places(machine, self.settings).check()
        except errors.CalibrationError as e:
            raise self.printer.config_error(str(e))

    def find_pin(self):
        axis, endstop = self.host.z_axis, self.host.endstops.find_z()
        where = "Option 'endstop_pin: %s' in section '%s'"
        where %= (axis.endstop_pin, axis.section)
        if endstop is None:
            raise self.printer.config_error(
                "%s: the printer knows no endstop of that section; the Z axis"
                " needs a switch that the nozzle can press" % (where,)
            )
        if endstops.is_virtual(endstop):
            raise self.printer.config_error(
                "%s is the probe: z_calibration needs a Z endstop that the"
                " nozzle can press; set it to the pin of that switch, or give"
                " the pin as endstop_pin in section 'z_calibration'" % (where,)
            )
        return where, Pin(endstop, "the Z endstop")

    def check_probe(self):
        for name in ("bltouch", "smart_effector"):
            # Neither has a switch body, and on a touch without the host's own
            # procedure the pin of a bltouch would be retracted.
            if self.printer.lookup_object(name, None) is not None:
                raise self.printer.config_error(
                    "Section '%s': this probe has no switch body to press the"
                    " Z endstop with; z_calibration needs a switch as [probe]"
                    % (name,)
                )
        if (
            self.host.probing.probe is None
            or self.host.probing.endstop() is None
        ):
            raise self.printer.config_error(
                "Section 'probe' is missing, or no switch on an endstop pin"
                " that stops the Z motors; z_calibration needs a [probe] with a"
                " switch that can press the Z endstop"
            )

    def check_settings(self):
        result = self.settings.probe.result
        if result not in ("median", "average"):
            raise errors.CalibrationError(
                "Option 'samples_result: %s' in section 'probe' is not known to"
                " z_calibration; set it to median or average" % (result,)
            )
        # Both must fit, the one the user wants and the one the pin needs
        settings, high = self.settings, self.settings.position_max
        free = settings._replace(position_max=float("inf"))
        above_pin = travel_height(free, settings.position_endstop or 0.0, None)
        for height, remedy in (
            (settings.safe_z_height, "safe_z_height"),
            (above_pin, "position_endstop there, travel_margin"),
        ):
            if height > high:
                raise errors.CalibrationError(
                    "The travel height of z_calibration, z=%.3f, must lie"
                    " within position_max (%.3f) of section '%s'; correct %s in"
                    " section 'z_calibration', or z_offset in section 'probe',"
                    " which is the real distance between nozzle and probe"
                    % (height, high, self.host.z_axis.section, remedy)
                )

    # With a mesh loaded, Z=0 is right where the mesh is zero.
    def tell_notes(self):
        for note in self.old_names.notes:
            self.runner.watch.say(note)
        for text in places.Places(self.host, self.settings).missing():
            self.runner.watch.say(text)
        if self.settings.unmeasured_pin:
            self.runner.watch.say(
                "until endstop_pin is touched the head travels at z=%.1f, enough"
                " for a pin of %g mm; where it is higher run"
                " Z_CALIBRATION_SETUP, or set safe_z_height"
                % (
                    travel_height(self.settings, None, None),
                    self.settings.unmeasured_pin,
                )
            )
        bed, zero = self.settings.bed, self.host.mesh_zero()
        if bed is None or zero is None:
            return
        if math.hypot(bed.x - zero[0], bed.y - zero[1]) > MESH_ZERO_NEAR:
            self.runner.watch.say(
                "bed_xy_position (%.3f, %.3f) is not where the bed mesh is zero"
                " (%.3f, %.3f): with a mesh loaded, the gap is wrong by its"
                " height there; leave bed_xy_position out, or set"
                " zero_reference_position of section 'bed_mesh' to it"
                % (bed.x, bed.y, zero[0], zero[1])
            )

    # Status: 'last_query' and 'last_z_offset' as upstream has them; for
    # end_gcode the heights are of the run that is under way.
    def get_status(self, eventtime):
        result = self.measured or self.last.result
        adjust = 0.0 if self.measured else self.last.z_adjust
        reason = "not applied yet" if self.measured else self.why_not()
        status = {
            "last_query": self.last_query,
            "last_z_offset": 0.0 if result is None else result.offset + adjust,
            "last_result": {} if result is None else dict(result._asdict()),
            "valid": not reason,
            "reason": reason,
            "warnings": list(self.last.warnings),
            "uncertainty": self.last.uncertainty,
            "z_adjust": self.last.z_adjust,
            "history": self.recorder.history.status,
        }
        status.update(self.runner.watch.status())
        return status

    # Why the last result does not hold (any more); empty: it does
    def why_not(self):
        if self.last.result is None:
            return "not calibrated yet"
        return self.frame.moved_since(self.last.mark)

    def switch_offset(self, gcmd, default):
        value = options.param_number(gcmd, "SWITCH_OFFSET", default, minval=0.0)
        if value is None:
            raise errors.CalibrationError(
                "no switch_offset: run Z_CALIBRATION_SETUP, set it in section"
                " 'z_calibration', or add SWITCH_OFFSET=mm"
            )
        return value

    # CALIBRATE_Z
    cmd_CALIBRATE_Z_help = "Measure nozzle, switch and bed, set the Z offset"

    def cmd_CALIBRATE_Z(self, gcmd):
        settings = self.settings
        work = functools.partial(self.calibrate_and_apply, gcmd)
        self.runner.check_idle(gcmd)
        plan = self.recorder.begin(settings.target)
        wanted = 2 * plan.expected(settings.pin) + plan.expected(settings.probe)
        self.last_query = False
        try:
            self.last = self.runner.run(
                gcmd, work, "start_gcode", wanted, self.failed
            )
        finally:
            self.measured = None
        self.last_query = True
        self.report(gcmd, self.last)
        self.recorder.good(self.last)

    def calibrate_and_apply(self, gcmd):
        before = self.host.gcode_offset()
        last, at_end = self.calibrate(gcmd)
        # What end_gcode adds stays; what it restores or resets is not added
        now = self.host.gcode_offset()
        is_back = min(abs(now - before), abs(now)) < NO_CHANGE
        added = 0.0 if is_back else now - at_end
        z_offset = last.result.offset + last.z_adjust + added
        self.use_offset(z_offset)
        if abs(added) >= NO_CHANGE:
            text = "end_gcode changed the G-code Z offset by %.6f: it is %.6f"
            self.runner.watch.say(text % (added, z_offset))
        return last._replace(applied=self.host.gcode_offset())

    # end_gcode runs before the offset is applied: the way to the dock does
    # not shift with the offset, and a probe that could not be put away
    # leaves everything as it was.
    def calibrate(self, gcmd):
        machine = self.host
        settings = self.settings._replace(
            switch_offset=self.switch_offset(gcmd, self.settings.switch_offset)
        )
        z_adjust = options.param_number(
            gcmd, "Z_ADJUST", 0.0, minval=-LARGEST_ADJUST, maxval=LARGEST_ADJUST
        )
        sites = places.Places(machine, settings).of_command(gcmd)
        run = self.start_run(settings, sites, self.recorder.plan)
        run.learned = self.recorder.history.summary
        if self.templates.clean is not None:
            run.clean = self.clean_nozzle
        with self.ready(run):
            result = self.measure(run)
            worth = run.plan.uncertainty()
            mark = self.frame.mark()
            last = Last(result, mark, run.warnings, worth, z_adjust, 0.0)
            check_offset(result, settings.offset_margins)
            self.measured = result
            at_end = machine.gcode_offset()
        running.check_homed(machine)
        if self.frame.moved_since(last.mark) == frame.LEVELLED:
            raise errors.CalibrationError(
                "%s in end_gcode: the offset does not hold then; do it before"
                " CALIBRATE_Z" % (frame.LEVELLED,)
            )
        return last, at_end

    # What is around a run
    @contextlib.contextmanager
    def ready(self, run):
        machine = self.host
        if not self.templates.start_homes:
            running.check_homed(machine)
        dock = running.always(machine, self.dock, "end_gcode")
        lift = running.always(machine, run.lift, "lifting")
        with self.holding_probe(), dock, lift:
            # User G-code may home, move, or turn the motors off
            self.run_template("start")
            running.check_homed(machine)
            run.know(self.last.result, not self.why_not())
            yield

    def measure(self, run):
        attach = functools.partial(self.attach_probe, self.frame.mark())
        return run.measure(attach)

    def start_run(self, settings, sites, plan):
        watch = self.runner.watch
        return Calibration(self.host, settings, self.pin, sites, watch, plan)

    def run_template(self, part, **params):
        template = getattr(self.templates, part)
        name = part + "_gcode"
        templates.run_template(self.host, name, template, **params)

    # A dockable_probe must not fetch and dock it by itself, at any session
    @contextlib.contextmanager
    def holding_probe(self):
        dockable = self.printer.lookup_object("dockable_probe", None)
        if not getattr(dockable, "auto_attach_detach", False):
            yield
            return
        run = self.host.gcode.run_script_from_command
        line = "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=%d"
        release = functools.partial(run, line % (1,))
        with running.always(self.host, release, "auto_attach_detach"):
            run(line % (0,))
            yield

    def attach_probe(self, mark):
        self.run_template("before_switch")
        moved = self.frame.moved_since(mark)
        if moved:
            raise errors.CalibrationError(
                "%s in before_switch_gcode: nozzle and switch cannot be"
                " compared then; do it before CALIBRATE_Z" % (moved,)
            )
        running.check_homed(self.host)

    def clean_nozzle(self, why):
        self.recorder.cleaned = why
        self.runner.watch.enter("clean_gcode")
        mark = self.frame.mark()
        self.run_template("clean")
        moved = self.frame.moved_since(mark)
        if moved:
            raise errors.CalibrationError(
                "%s in clean_gcode; do it before CALIBRATE_Z" % (moved,)
            )

    def dock(self):
        self.runner.watch.enter("end_gcode")
        self.run_template("end")

    def report(self, gcmd, last):
        result = last.result
        if self.why_not():
            self.runner.watch.say(
                "%s after measuring, in end_gcode or offset_gcode: the offset"
                " holds no more" % (self.why_not(),)
            )
        gcmd.respond_info(
            "Z-CALIBRATION: probe=%.3f - (switch=%.3f - nozzle=%.3f"
            " + switch_offset=%.3f) --> new offset=%.6f" % result
        )
        if last.uncertainty is not None:
            gcmd.respond_info(
                "Z-CALIBRATION: --> new offset=%.6f +-%.3f"
                % (result.offset, last.uncertainty)
            )
        if last.z_adjust:
            gcmd.respond_info(
                "Z-CALIBRATION: with Z_ADJUST=%.3f the offset is %.6f"
                % (last.z_adjust, result.offset + last.z_adjust)
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
        self.run_template("offset", Z="%.6f" % (z_offset,))

    def failed(self, error):
        self.recorder.refused(error)
        watch = self.runner.watch
        if self.measured is not None:
            text = "the measured offset %.6f was not applied"
            watch.say(text % (self.measured.offset,))
        if self.templates.error is None:
            return
        watch.enter("error_gcode")
        try:
            self.run_template("error", ERROR=error)
        except (self.printer.command_error, errors.CalibrationError) as e:
            # Must not hide the one it is told of
            logging.exception("z_calibration: error_gcode failed, too")
            watch.say("after the error: %s" % (e,))

    # CALIBRATE_Z_ACCURACY
    cmd_CALIBRATE_Z_ACCURACY_help = "Repeat whole calibrations, apply nothing"

    def cmd_CALIBRATE_Z_ACCURACY(self, gcmd):
        wanted = recording.Wanted(gcmd, self.settings)
        work = functools.partial(self.measure_cycles, gcmd, wanted)
        touches = 2 * wanted.settings.pin.samples
        touches += wanted.settings.probe.samples
        self.runner.check_idle(gcmd)
        self.recorder.begin(None)
        before = self.host.gcode_offset()
        found = self.runner.run(
            gcmd, work, "start_gcode", wanted.cycles * touches, self.failed
        )
        # What end_gcode adds belongs to a run that is applied
        if self.host.gcode_offset() != before:
            self.host.set_gcode_offset(before)
        self.recorder.tell_cycles(gcmd, found)

    def measure_cycles(self, gcmd, wanted):
        settings, attach = wanted.settings, wanted.attach
        settings = settings._replace(
            switch_offset=self.switch_offset(gcmd, settings.switch_offset)
        )
        if not attach and settings.attach_after_nozzle:
            raise errors.CalibrationError(
                "ATTACH=0 needs the probe on the head all the time: attach it"
                " in start_gcode, not in before_switch_gcode"
            )
        sites = places.Places(self.host, settings).of_command(gcmd)
        found = []
        while len(found) < wanted.cycles:
            if wanted.home:
                self.host.gcode.run_script_from_command("G28 Z")
            run = self.start_run(settings, sites, self.recorder.plan)
            with self.ready(run):
                for _ in range(1 if attach else wanted.cycles):
                    self.measure(run)
                    found.append(self.recorder.cycle(settings.switch_offset))
                    self.runner.watch.say("cycle %d is done" % (len(found),))
        return found

    # PROBE_Z_ACCURACY
    cmd_PROBE_Z_ACCURACY_help = "Touch the Z endstop with the nozzle repeatedly"

    def cmd_PROBE_Z_ACCURACY(self, gcmd):
        work = functools.partial(self.measure_accuracy, gcmd)
        samples = self.runner.run(gcmd, work, "nozzle", 0)
        gcmd.respond_info(
            "probe z accuracy results: maximum %.6f, minimum %.6f, range"
            " %.6f, average %.6f, median %.6f, standard deviation %.6f"
            % sampling.accuracy(samples)
        )

    def measure_accuracy(self, gcmd):
        pin, watch = self.settings.pin, self.runner.watch
        number = functools.partial(options.param_number, gcmd)
        count = pin.samples
        if count == sampling.AUTO:
            count = adaptive.MOST
        pin = pin._replace(
            samples=options.param_int(gcmd, "SAMPLES", count, minval=1),
            speed=number("PROBE_SPEED", pin.speed, above=0.0),
            lift_speed=number("LIFT_SPEED", pin.lift_speed, above=0.0),
            retract_dist=number(
                "SAMPLE_RETRACT_DIST", pin.retract_dist, above=0.0
            ),
            # The spread is what is asked for
            tolerance=float("inf"),
        )
        nozzle = places.Places(self.host, self.settings).nozzle_of_command(gcmd)
        running.check_homed(self.host)
        settings = self.settings._replace(pin=pin)
        sites = places.Sites(nozzle, None, None)
        plan = self.recorder.make_plan(settings.target)
        run = self.start_run(settings, sites, plan)
        run.know(self.last.result, not self.why_not())
        gcmd.respond_info(
            "PROBE_Z_ACCURACY at X:%(x).3f Y:%(y).3f (samples=%(samples)d"
            " retract=%(retract_dist).3f speed=%(speed).1f"
            " lift_speed=%(lift_speed).1f)"
            % dict(pin._asdict(), x=nozzle.x, y=nozzle.y)
        )
        watch.wanted = pin.samples
        with running.always(self.host, run.lift, "lifting"):
            return run.sample_nozzle()
