# One place to touch: get there, come down, touch, come up again.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Every height is a toolhead Z: the position, in mm and in the frame that the
# last homing defined, at which a touch triggered.  G-code offset, bed mesh and
# skew play no part in it.  Up is positive.  Speeds are in mm/s.

import collections
import contextlib
import functools
import math

from . import options
from .errors import CalibrationError, NoTrigger
from .motion import has_no_trigger, was_not_heard
from .running import always

# What to do about a board that was not heard
LATE = (
    "a board was not heard in time, as the computer or the line to it is too"
    " slow or broken; run it again, and look into klippy.log if it comes back"
)

# What to do about a touch by the host's own probing
CHECK_PROBE = "check the probe with QUERY_PROBE and PROBE"

# Nothing down to where a touch ends
NO_ANSWER = "the switch did not answer"

# A trigger this close (mm) to the start is none: the sensor was pressed.
# Less than any microstep is long, more than rounding.
NO_TRAVEL = 0.0001


# Something to touch (mm): the word used in messages, where the head stands for
# it, where the user has said so, and by which option or parameter.
class Site(collections.namedtuple("Site", "name x y origin option")):
    __slots__ = ()

    def __new__(cls, name, x, y, origin, option=""):
        return super().__new__(cls, name, x, y, origin, option)

    # What to check where the head does not stand as it should
    def place(self):
        return self.option or "the place of the %s" % (self.name,)


def option_site(config, name, option, pair):
    origin = "Option '%s: %g,%g' in section '%s'"
    origin %= (option, pair[0], pair[1], config.get_name())
    return Site(name, pair[0], pair[1], origin, option)


# The kind of an option that is a point (mm), as a Site of that name; under an old
# name it may be one option for X and one for Y.  None: it is not given.
def site_kind(name):
    def read(config, option, row):
        if isinstance(option, tuple):
            point = [options.number(config, axis) for axis in option]
            return option_site(config, name, " and ".join(option), point)
        point = options.pair(config, option)
        return point and option_site(config, name, option, point)

    return options.Kind(options.PAIR.word, read, options.PAIR.nonsense)


# The row of such an option, which had one for X and one for Y until 2023
def site_option(name, text):
    site = name.split("_")[0]
    axes = tuple("probe_%s_%s" % (site, axis) for axis in "xy")
    kind = site_kind(site)
    return options.option(name, kind, None, "mm", text, old=(axes,))


# What to do where the head does not get to a point that is the user's choice
CHOOSE_ANOTHER = "choose a point that it can reach"


# 'shift' says why the head is elsewhere than the user's point.
def check_reach(host, site, remedy, shift=""):
    for axis, xy, (low, high) in zip("XY", site[1:3], host.axes.limits()):
        if not low <= xy <= high:
            raise CalibrationError(
                "%s needs the head at %s=%.3f%s, outside its %.3f to %.3f; %s"
                % (site.origin, axis, xy, shift, low, high, remedy)
            )


# Raises CalibrationError where the head does not reach all points of a bed_spread (mm)
# around a site.  'section': whose option it is.
def check_spread(host, site, radius, section):
    if not radius:
        return
    origin = "Option 'bed_spread: %g' in section '%s'" % (radius, section)
    remedy = "choose a smaller one, or another bed_xy_position"
    for x, y in ((-1, 0), (1, 0), (0, -1), (0, 1)):
        x, y = site.x + x * radius, site.y + y * radius
        edge = site._replace(x=x, y=y, origin=origin)
        check_reach(host, edge, remedy)


# Motors stop on whole steps, so not exactly there
def is_near(host, z, there):
    return abs(z - there) <= 2.0 * host.axes.z_step()


def is_at(host, z):
    return is_near(host, host.motion.z(), z)


# The end of the printer is nothing that a hint of ours would mend
def pass_on_shutdown(host, error):
    if host.printer.is_shutdown():
        raise error


# Never down, and not where Z is not known (any more)
def raise_to(host, z, speed):
    if host.motion.z() < z and "z" in host.toolhead_status()["homed_axes"]:
        host.toolhead.manual_move([None, None, z], speed)


# A move that follows on others in time is told to the host so long (s) before they
# end: BUFFER_TIME_START of its toolhead.py, 0.25 s, and some for the answer of a switch
MOVE_START = 0.3


# The print time to look at a switch while the head is still under way: late, but the
# next move begins in time.  Not before 'begun', a print time.
def before_arrival(host, begun):
    return max(begun, host.after_moves() - MOVE_START)


# A head so near (mm) to a site is over it
SAME_SITE = 0.01


def is_over(host, site):
    here = host.toolhead.get_position()
    return max(abs(here[0] - site.x), abs(here[1] - site.y)) <= SAME_SITE


def move_xy(host, x, y, speed):
    if tuple(host.toolhead.get_position()[:2]) != (x, y):
        host.toolhead.manual_move([x, y], speed)


# Straight to X, Y and Z (mm); Z None: as high as it is.  At 'speed' in the plane and
# 'lift_speed' up or down (mm/s), whichever takes longer.
def move_xyz(host, place, speed, lift_speed):
    x, y, z = place
    here = host.toolhead.get_position()
    up = 0.0 if z is None else abs(z - here[2])
    if not up:
        move_xy(host, x, y, speed)
        return
    flat = math.hypot(x - here[0], y - here[1])
    seconds = max(flat / speed, up / lift_speed)
    host.toolhead.manual_move([x, y, z], math.hypot(flat, up) / seconds)


# The head at one place, and whether it still presses what it has touched.
class Head:
    # 'remedy': what to do where the head is too low for a touch
    def __init__(self, host, sampling, remedy):
        self.host = host
        self.sampling = sampling
        self.remedy = remedy
        # Where the last touch triggered; None: the head was lifted since
        self.pressed_z = None

    # Down to z where nothing should be yet.  None, or the toolhead Z where
    # the endstop triggered nevertheless.
    def come_down(self, endstop, z, speed):
        if self.host.motion.z() <= z:
            return None
        try:
            return self._move_down(endstop, z, speed)
        except NoTrigger:
            return None

    # Down until the endstop triggers; returns the toolhead Z of the trigger.
    # Raises NoTrigger at the floor.
    def touch(self, endstop, floor, speed):
        self.check_above(floor)
        return self._move_down(endstop, floor, speed)

    # A touch after a motion.Way, in one move.  Returns whether it was the touch that
    # has triggered: what is met on the way is met at another speed.
    def touch_after(self, way, endstop, floor, speed):
        self.check_above(floor)
        z = self._move_down(endstop, floor, speed, way)
        return z < way.z and not is_near(self.host, z, way.z)

    def _move_down(self, endstop, z, speed, way=None):
        host, start_z = self.host, self.host.motion.z()
        move = host.motion.probing_move
        if way is not None:
            move = functools.partial(host.motion.probing_move_after, way)
        try:
            trigger_z = move(endstop, z, speed)
        except host.printer.command_error as e:
            pass_on_shutdown(host, e)
            ended = has_no_trigger(e) and is_at(host, z)
            kind = NoTrigger if ended else CalibrationError
            # The host calls whatever is touched a probe
            is_probe = endstop is host.probing.endstop()
            told = e if is_probe or not has_no_trigger(e) else NO_ANSWER
            raise self._stopped(e, kind, told)
        return self._pressed(start_z, trigger_z, trigger_z)

    # Down until the host's own probing has triggered, see probing(); returns Probed.
    def probe(self, probe_once):
        host, start_z = self.host, self.host.motion.z()
        try:
            probed = probe_once()
        except host.printer.command_error as e:
            pass_on_shutdown(host, e)
            raise self._stopped(e, CalibrationError)
        # QIDI's hosts answer a probe that is pressed already with a result
        self._pressed(start_z, host.motion.z(), probed.z)
        return probed

    # 'told': in other words than those of the host
    def _stopped(self, error, kind, told=None):
        # Without the sign of a rounded zero
        z = round(self.host.motion.z(), 3) + 0.0
        text = "%s (stopped at z=%.3f)" % (told or error, z)
        if was_not_heard(error):
            # Nothing about the sensor or its place
            return CalibrationError(text).advised(LATE)
        return kind(text)

    # A touch goes down, whatever it is told
    def check_above(self, floor):
        z = self.host.motion.z()
        if z <= floor:
            text = "the head is at z=%.3f, this touch ends at z=%.3f already; "
            raise CalibrationError(text % (z, floor) + self.remedy)

    def _pressed(self, start_z, end_z, trigger_z):
        if start_z - end_z <= NO_TRAVEL:
            raise CalibrationError(
                "triggered at z=%.3f before the head moved: the sensor was"
                " pressed or is not attached" % (start_z,)
            )
        self.pressed_z = trigger_z
        return trigger_z

    # Down to z in the air above what was touched before
    def move_down(self, z, speed):
        if self.host.motion.z() > z:
            self.host.toolhead.manual_move([None, None, z], speed)

    # From now on retract() lifts by that (mm)
    def use_lift(self, distance):
        self.sampling = self.sampling._replace(retract_dist=distance)

    # Up to where the next touch begins
    def retract(self):
        if self.pressed_z is not None:
            self.lift(self.pressed_z + self.sampling.retract_dist)

    def lift(self, z):
        self.pressed_z = None
        raise_to(self.host, z, self.sampling.lift_speed)


# A session of the host's own probing that ends each touch at 'floor' and lifts
# the head to 'top' before it ends: the host may stow or dock the probe then.
# Yields a function that touches once, for Head.probe(); None where the host
# cannot be told about the floor.
@contextlib.contextmanager
def probing(head, floor, top, **params):
    host = head.host
    # One by one: what is wanted of several is looked at between them
    params["SAMPLES"] = "1"
    probe_once, end = host.probing.start(params)
    # An error inside activate_gcode makes the host end the session by itself;
    # ending it again is then an error that must not be shown.
    session = always(host, end, "ending the probe session")
    lift = always(host, functools.partial(head.lift, top), "lifting")
    with session, host.probing.floor(floor) as limited, lift:
        yield probe_once if limited else None
