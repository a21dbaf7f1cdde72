# A probe that the printer fetches from a dock and puts back
#
# Copyright (C) 2026  the Z calibration developers
#
# This file may be distributed under the terms of the GNU GPLv3 license.
#
# To fetch the probe the head goes to the approach position, from there into
# the dock and out again to the extract position; to put it back it goes to the
# insert position, into the dock, and out to the detach position, which strips
# the probe off.  Anywhere else it stays out of a circle around the dock:
#
#          approach = extract = insert            . - - .
#                 o                             '    A    '    the head goes
#                 |                            (     |     )   around
#                 v                             ' .  v  . '
#         detach  |                                ' D '
#        o <----- D  dock
#
# Every place is one of the toolhead, in mm; G-code offset and bed mesh play no
# part.  What holds the probe is asked of the pins, never assumed: before it is
# fetched and put back, after that, and before and after each touch.  A pin
# proves nothing before it was seen to change on the way out of the dock.
from __future__ import absolute_import, division

import collections
import functools
import logging
import math

try:
    from .z_touch import host, options, probe_host, running, touching
except (ImportError, ValueError):
    try:
        # A plugin of Kalico since 2026-01-02 (2c9b0b4de)
        from ..extras.z_touch import host, options, probe_host
        from ..extras.z_touch import running, touching
    except (ImportError, ValueError):
        host = None  # load_config() tells

######################################################################
# Constants
######################################################################

__version__ = "0.3.0"

ATTACHED, DOCKED, UNKNOWN = "ATTACHED", "DOCKED", "UNKNOWN"

# XY speed (mm/s) outside of the dock.
TRAVEL_SPEED = 50.0

# A probing move ends this far (mm) above Z=0: the bed is about there, and the
# nozzle has to stay clear of it.
LOWEST_NOZZLE = 1.0

# A smaller z_offset (mm) of a switch was not measured yet; then the probe
# hangs at least as low as that, and may hang so much lower than the nozzle.
SMALLEST_Z_OFFSET = 2.0
UNMEASURED_PROBE = 10.0

# A position nearer (mm) to the dock is none of its own.
SMALLEST_DISTANCE = 1.0

# A head that leaves a dock is this close (mm) to the line it came along.
LANE = 3.0

# Off the way that takes the probe along, stripping it has to go at least so
# many degrees; less than the second is doubtful.
SAME_WAY = 20.0
DOUBTFUL_WAY = 45.0

# The way around a dock turns by so many degrees at each corner.
TURN = 15.0

# Of lengths (mm): what rounding makes of them.
ROUNDING = 1e-3

# Before a contradiction of pins is believed they are asked again after (s).
ASK_AGAIN = 0.5

# With allow_delayed_detach the probe is put back when so long (s) nobody has
# used it.
DETACH_DELAY = 1.0


######################################################################
# Places and ways (pure)
######################################################################

# z None: as it is
Place = collections.namedtuple("Place", "x y z")

# Where the head goes only to fetch the probe and to put it back: a circle, and
# the unit vectors of the lanes out of it.
Zone = collections.namedtuple("Zone", "x y radius lanes")


class NoWay(Exception):
    pass


def distance(a, b):
    return math.hypot(a[0] - b[0], a[1] - b[1])


# From a to b in the plane; (0, 0) where they are the same
def direction(a, b):
    length = distance(a, b)
    if length < SMALLEST_DISTANCE:
        return 0.0, 0.0
    return (b[0] - a[0]) / length, (b[1] - a[1]) / length


# How a head leaves the dock at first: Z moves before X and Y do.
def first_leg(dock, place):
    if None not in (dock.z, place.z) and dock.z != place.z:
        return 0.0, 0.0, math.copysign(1.0, place.z - dock.z)
    return direction(dock, place) + (0.0,)


# Degrees between two ways out of the dock
def angle_between(a, b):
    dot = sum(p * q for p, q in zip(a, b))
    return math.degrees(math.acos(max(-1.0, min(1.0, dot))))


def is_inside(point, zone):
    return distance(point, zone) < zone.radius - ROUNDING


# Least distance of the centre of the zone to the line from a to b
def least_distance(a, b, zone):
    dx, dy = b[0] - a[0], b[1] - a[1]
    length = dx * dx + dy * dy
    if not length:
        return distance(a, zone)
    part = ((zone.x - a[0]) * dx + (zone.y - a[1]) * dy) / length
    part = max(0.0, min(1.0, part))
    return distance((a[0] + part * dx, a[1] + part * dy), zone)


def is_within(point, limits):
    return all(
        low - ROUNDING <= xy <= high + ROUNDING
        for xy, (low, high) in zip(point, limits)
    )


def on_circle(zone, angle, radius):
    x, y = zone.x + radius * math.cos(angle), zone.y + radius * math.sin(angle)
    return x, y


def angle_of(point, zone):
    return math.atan2(point[1] - zone.y, point[0] - zone.x)


# The ends of the ways straight out of the circle, the best one first: along
# a lane where the head is in one, otherwise away from the dock.
def ways_out(point, zone):
    dx, dy = point[0] - zone.x, point[1] - zone.y
    for ux, uy in zone.lanes:
        along, aside = dx * ux + dy * uy, dx * uy - dy * ux
        if along >= -LANE and abs(aside) <= LANE:
            rest = math.sqrt(max(0.0, zone.radius**2 - aside**2)) - along
            yield point[0] + rest * ux, point[1] + rest * uy
    middle = angle_of(point, zone)
    # Further off the head would come nearer to the dock at first
    widest = math.acos(min(1.0, distance(point, zone) / zone.radius))
    for part in range(33):
        for side in (1, -1):
            angle = middle + side * widest * part / 32.0
            yield on_circle(zone, angle, zone.radius)


def way_out(point, zone, limits):
    for end in ways_out(point, zone):
        if is_within(end, limits):
            return end
    raise NoWay()


# The corners of a way around the circle, all of it outside; 'turn' is 1 with
# the angles, -1 against them.
def corners_around(start, end, zone, turn):
    angles = []
    for point, side in ((start, turn), (end, -turn)):
        tangent = math.acos(min(1.0, zone.radius / distance(point, zone)))
        angles.append(angle_of(point, zone) + side * tangent)
    sweep = (turn * (angles[1] - angles[0])) % (2.0 * math.pi)
    if sweep > 2.0 * math.pi - ROUNDING:
        sweep = 0.0
    count = int(math.ceil(sweep / math.radians(TURN)))
    if not count:
        return []
    step = sweep / count
    radius = zone.radius / math.cos(step / 2.0)
    return [
        on_circle(zone, angles[0] + turn * step * (i + 0.5), radius)
        for i in range(count)
    ]


def length_of(points):
    return sum(distance(a, b) for a, b in zip(points, points[1:]))


# The corners of the way from start to end that never gets nearer to the dock
# than it has to; the last one is where it ends: at 'end' or, where that is
# too near to the dock, as close to it as may be.  'via' None or the point that
# the way has to pass by.  Raises NoWay.
def way_around(start, end, zone, limits, via=None):
    start, end = tuple(start[:2]), tuple(end[:2])
    way = [start]
    if is_inside(start, zone):
        if distance(start, end) < ROUNDING:
            return []
        start = way_out(start, zone, limits)
        way.append(start)
    if is_inside(end, zone):
        end = way_out(end, zone, limits)
    if least_distance(start, end, zone) >= zone.radius - ROUNDING:
        return way[1:] + [end]
    ways = [corners_around(start, end, zone, turn) for turn in (1, -1)]
    ways = [w for w in ways if all(is_within(p, limits) for p in w)]
    if not ways:
        raise NoWay()

    def cost(corners):
        corners = [start] + corners + [end]
        if via is not None:
            return min(distance(corner, via) for corner in corners)
        return length_of(corners)

    return way[1:] + min(ways, key=cost) + [end]


######################################################################
# Options
######################################################################

# What the user configured: mm, mm/s.  'hang': how far the probe triggers below
# the nozzle, as far as anybody knows; 'retract': sample_retract_dist.
Settings = collections.namedtuple(
    "Settings",
    "dock approach extract insert detach fixed_z safe_z_position safe_position"
    " safe_dock_distance z_hop speed lift_speed travel_speed attach_speed"
    " detach_speed z_offset hang retract retries restore delayed each_sample"
    " undock_for_z",
)

Templates = collections.namedtuple(
    "Templates",
    "pre_attach attach post_attach pre_detach detach post_detach activate"
    " deactivate",
)


def read_place(config, name, default=None):
    values = config.getfloatlist(name, default and ())
    if not values:
        return default
    if not 2 <= len(values) <= 3 or not all(map(options.is_finite, values)):
        raise options.config_error(
            config,
            name,
            "has to be 'X, Y' or 'X, Y, Z' in mm, such as 250, 295",
        )
    return Place(*(tuple(values) + (None,))[:3])


# dock_angle, detach_angle and dock_safe_distance of old: degrees from X, mm
def read_old_places(config, dock, notes):
    length = options.number(config, "dock_safe_distance", above=0.0)
    found = {}
    for old, new in (
        ("dock_angle", "approach_position"),
        ("detach_angle", "detach_position"),
    ):
        angle = options.number(config, old)
        if angle is None:
            continue
        if length is None:
            raise options.config_error(
                config, old, "needs dock_safe_distance; better write " + new
            )
        angle = math.radians(angle)
        x, y = (
            dock.x + length * math.cos(angle),
            dock.y + length * math.sin(angle),
        )
        found[new] = Place(round(x, 3), round(y, 3), None)
        text = "options '%s' and 'dock_safe_distance' are now '%s: %g, %g'"
        notes.append(text % ((old, new) + found[new][:2]))
    return found


def read_places(config, notes):
    dock = read_place(config, "dock_position")
    old = read_old_places(config, dock, notes)
    approach, detach = [
        read_place(config, name, old.get(name))
        for name in ("approach_position", "detach_position")
    ]
    extract = read_place(config, "extract_position", approach)
    insert = read_place(config, "insert_position", extract)
    return dock, approach, extract, insert, detach


# Without a word about it the dock is at the head's height in any case unless
# a place has a Z.
def read_fixed_z(config, dock, places):
    given = config.getboolean("dock_fixed_z", None)
    if given is None:
        return all(place.z is None for place in places)
    if not given and dock.z is None:
        raise options.config_error(
            config,
            "dock_fixed_z",
            "is False, so dock_position needs the Z of the dock as its third"
            " number",
        )
    return given


def check_places(config, dock, approach, extract, detach, notes):
    for name, place in (
        ("approach_position", approach),
        ("extract_position", extract),
        ("detach_position", detach),
    ):
        if first_leg(dock, place) == (0.0, 0.0, 0.0):
            raise options.config_error(
                config,
                name,
                "(%g, %g) is at dock_position; give a point outside of the"
                " dock, some 40 mm away" % place[:2],
            )
    if config.get("detach_gcode", "").strip():
        return
    angle = angle_between(first_leg(dock, detach), first_leg(dock, extract))
    text = (
        "leads the same way out of the dock as extract_position (the same as"
        " approach_position unless given), %.0f degrees apart: the probe %s"
        " stay on the head; it has to strip the probe off, mostly at 90"
        " degrees" % (angle, "would" if angle < SAME_WAY else "may")
    )
    if angle < SAME_WAY:
        raise options.config_error(config, "detach_position", text)
    if angle < DOUBTFUL_WAY:
        notes.append("detach_position " + text)


def read_safe_dock_distance(config, dock, places):
    lengths = [distance(dock, place) for place in places]
    lengths = [length for length in lengths if length >= SMALLEST_DISTANCE]
    most = min(lengths + [1e6]) if lengths else 0.0
    return options.number(
        config, "safe_dock_distance", most, minval=0.0, maxval=most
    )


def read_hang(z_offset, is_z_endstop):
    if z_offset >= SMALLEST_Z_OFFSET or is_z_endstop:
        return z_offset
    return UNMEASURED_PROBE


def read_settings(config, is_z_endstop, old_names):
    number = functools.partial(options.number, config)
    places = read_places(config, old_names.notes)
    dock, approach, extract, insert, detach = places
    check_places(config, dock, approach, extract, detach, old_names.notes)
    z_offset = number("z_offset")
    speed = number("speed", 5.0, above=0.0)
    safe_z = options.pair(config, "safe_z_position")
    restore = old_names.name_of(
        "restore_toolhead", "return_to_last_probe_position_after_detach"
    )
    return Settings(
        dock=dock,
        approach=approach,
        extract=extract,
        insert=insert,
        detach=detach,
        fixed_z=read_fixed_z(config, dock, places),
        safe_z_position=safe_z,
        safe_position=read_place(config, "safe_position", approach),
        safe_dock_distance=read_safe_dock_distance(config, dock, places[1:]),
        z_hop=number("z_hop", 0.0, minval=0.0),
        speed=speed,
        lift_speed=number("lift_speed", speed, above=0.0),
        travel_speed=number("travel_speed", TRAVEL_SPEED, above=0.0),
        attach_speed=number("attach_speed", speed, above=0.0),
        detach_speed=number("detach_speed", speed, above=0.0),
        z_offset=z_offset,
        hang=read_hang(z_offset, is_z_endstop),
        retract=number("sample_retract_dist", 2.0, above=0.0),
        retries=config.getint("dock_retries", 0, minval=0),
        restore=config.getboolean(restore, True),
        delayed=config.getboolean("allow_delayed_detach", False),
        each_sample=config.getboolean("deactivate_on_each_sample", False),
        undock_for_z=config.getboolean("detach_dockable_before_z_home", False),
    )


# Lowest useful toolhead Z of a probing move
def lowest_touch(settings, is_z_endstop):
    if is_z_endstop and settings.z_offset < SMALLEST_Z_OFFSET:
        return settings.z_offset - LOWEST_NOZZLE
    return LOWEST_NOZZLE


# Toolhead Z (mm) at which the probe is clear of the bed, and that on the way
# to the dock
def travel_height(settings):
    return settings.hang + settings.retract


def dock_height(settings):
    height = travel_height(settings)
    if settings.fixed_z:
        height += settings.dock.z or 0.0
    return max(height, settings.z_hop)


######################################################################
# Pins
######################################################################

# A pin, its option, and what it reads with the probe on the head
Sense = collections.namedtuple("Sense", "name endstop when_attached")


# What tells where the probe is
class Sensors(object):
    def __init__(self, config, machine, device):
        self.host = device
        self.endstop = machine.make_endstop(config, "pin")
        self.senses = []
        check_open = config.getboolean("check_open_attach", None)
        for name, when_attached in (
            ("probe_sense_pin", True),
            ("dock_sense_pin", False),
        ):
            if config.get(name, "").strip():
                endstop = machine.make_endstop(config, name)
                self.senses.append(Sense(name, endstop, when_attached))
        if check_open is None:
            # As other plugins have it
            names = [sense.name for sense in self.senses]
            check_open = names == ["dock_sense_pin"]
        self.check_open = check_open
        if not self.senses and not check_open:
            raise config.error(
                "Section '%s': nothing tells whether the probe is attached;"
                " set check_open_attach: True if 'pin' reads open with the"
                " probe on the head and TRIGGERED without it, or give"
                " probe_sense_pin or dock_sense_pin" % (config.get_name(),)
            )
        # Whether they were seen to change when the probe was last fetched
        self.proven = False
        # What 'pin' read without the probe; the user was told that it is open
        self.read_docked = self.is_told = False
        self.last = UNKNOWN

    def all(self):
        own = [Sense("pin", self.endstop, False)] if self.check_open else []
        return own + self.senses

    def state(self, print_time, senses=None):
        senses = self.all() if senses is None else senses
        attached = [
            bool(s.endstop.query_endstop(print_time)) == s.when_attached
            for s in senses
        ]
        self.last = UNKNOWN
        if all(attached):
            self.last = ATTACHED
        elif not any(attached):
            self.last = DOCKED
        return self.last

    # After all moves
    def look(self):
        return self.state(self.host.after_moves())

    def is_pressed(self, print_time):
        return bool(self.endstop.query_endstop(print_time))

    # What the pins read, for people
    def describe(self):
        print_time = self.host.after_moves()
        senses = [Sense("pin", self.endstop, None)] + self.senses
        words = ("open", "TRIGGERED")
        return ", ".join(
            "%s reads %s"
            % (s.name, words[bool(s.endstop.query_endstop(print_time))])
            for s in senses
        )


######################################################################
# The way to the dock and back
######################################################################


class Ways(object):
    def __init__(self, machine, lifter, settings):
        self.host = machine
        self.lifter = lifter
        self.settings = settings
        dock = settings.dock
        places = (settings.approach, settings.extract, settings.insert)
        lanes = [direction(dock, p) for p in places + (settings.detach,)]
        self.zone = Zone(dock.x, dock.y, settings.safe_dock_distance, lanes)
        # Z was lifted where nobody knows it
        self.is_lifted = False
        register = machine.printer.register_event_handler
        register("stepper_enable:motor_off", self._forget_lift)

    def _forget_lift(self, *unused):
        self.is_lifted = False

    def homed(self):
        return self.host.toolhead_status()["homed_axes"]

    def require_homed(self):
        self.require("xy" if self.settings.fixed_z else "xyz")

    def require(self, axes):
        homed = self.homed()
        missing = [axis.upper() for axis in axes if axis not in homed]
        if missing:
            raise self.host.printer.command_error(
                "%s: not homed: %s; the way to the dock is not known before;"
                " home first (G28 %s)"
                % (self.host.name, ", ".join(missing), " ".join(missing))
            )

    def require_xy(self):
        self.require("xy")

    # Z up where it is too low to travel, never down
    def lift(self, height):
        if "z" in self.homed():
            self.is_lifted = False
            touching.raise_to(self.host, height, self.settings.lift_speed)
        elif not self.is_lifted:
            self.lifter.hop(height, self.settings.lift_speed)
            self.is_lifted = True

    def lift_for_dock(self):
        self.lift(dock_height(self.settings))

    # To a place without going through the dock
    def travel(self, place, speed):
        here = self.host.toolhead.get_position()
        limits = self.host.axis_limits()[:2]
        via = self.settings.safe_position
        if via == self.settings.approach:
            via = None
        if self.zone.radius <= 0.0:
            way = [place[:2]]
        else:
            try:
                way = way_around(here, place, self.zone, limits, via)
            except NoWay:
                raise self.host.printer.command_error(
                    "%s: no way from %.3f, %.3f to %.3f, %.3f around the dock"
                    " within the reach of X and Y; move the head elsewhere or"
                    " lower safe_dock_distance (%.3f)"
                    % (
                        (self.host.name, here[0], here[1], place[0], place[1])
                        + (self.zone.radius,)
                    )
                )
        for x, y in way:
            touching.move_xy(self.host, x, y, speed)

    def is_at(self, place):
        return distance(self.host.toolhead.get_position(), place) < ROUNDING

    def to_z(self, place):
        if not self.settings.fixed_z and place.z is not None:
            self.to_height(place.z)

    def to_height(self, z):
        if z != self.host.z():
            speed = self.settings.lift_speed
            self.host.toolhead.manual_move([None, None, z], speed)

    # To a place outside of the dock, from anywhere
    def go_before(self, place):
        self.require_homed()
        self.lift_for_dock()
        self.travel(place, self.settings.travel_speed)
        self.to_z(place)

    # Into the dock, from a place before it
    def go_in(self, before):
        self.require_homed()
        if not self.is_at(before) and not self.is_at(self.settings.dock):
            self.go_before(before)
        self.to_z(self.settings.dock)
        dock, speed = self.settings.dock, self.settings.attach_speed
        touching.move_xy(self.host, dock.x, dock.y, speed)

    # Out of the dock; from elsewhere around it
    def go_out(self, place, speed):
        self.require_homed()
        if not self.is_at(self.settings.dock):
            self.go_before(place)
            return
        self.to_z(place)
        touching.move_xy(self.host, place.x, place.y, speed)

    # Clear of dock and bed
    def get_clear(self):
        if "z" in self.homed() or self.settings.fixed_z:
            self.lift_for_dock()
        if "x" in self.homed() and "y" in self.homed():
            here = self.host.toolhead.get_position()
            if is_inside(here, self.zone):
                self.travel(here, self.settings.travel_speed)

    # Back to where the head was, not lower than 'lowest'
    def go_back(self, here, lowest):
        self.travel(here, self.settings.travel_speed)
        if "z" in self.homed() and here[2] is not None:
            self.to_height(max(here[2], lowest))


######################################################################
# Fetching and docking
######################################################################


class Docking(object):
    def __init__(self, machine, settings, sensors, ways, templates):
        self.host = machine
        self.settings = settings
        self.sensors = sensors
        self.ways = ways
        self.templates = templates

    def error(self, text):
        return self.host.printer.command_error(
            "%s: %s" % (self.host.name, text)
        )

    def say(self, text):
        self.host.gcode.respond_info("%s: %s" % (self.host.name, text))

    # A part of the way, as the command that a macro may have replaced
    def leg(self, name):
        self.host.gcode.run_script_from_command("MOVE_TO_%s_PROBE" % (name,))

    # Puts the probe on the head and returns whether the head went for it.
    # What says "attached" has changed on the way out of the dock, then.
    def attach(self):
        sensors = self.sensors
        state = sensors.look()
        if state == ATTACHED and sensors.proven:
            return False
        self.ways.require_homed()
        self.ways.lift_for_dock()
        # Pressed on the bed it looked as if it was not there
        state = sensors.look()
        if state == ATTACHED and sensors.proven:
            return True
        if state == ATTACHED:
            self.say(
                "the probe reads attached, but nobody has seen that change;"
                " docking and fetching it to see that it does"
            )
            self.dock()
        self.fetch()
        return True

    def fetch(self):
        self.sensors.proven = False
        self.templates.pre_attach.run_gcode_from_command()
        self.repeat(DOCKED, ATTACHED, self.fetch_once, "fetched")
        self.templates.post_attach.run_gcode_from_command()
        self.sensors.proven = True
        self.check_changed()

    def fetch_once(self):
        self.leg("APPROACH")
        self.leg("DOCK")
        leave = functools.partial(self.leg, "EXTRACT")
        with running.always(self.host, leave, "leaving the dock"):
            self.templates.attach.run_gcode_from_command()

    # Puts the probe into the dock and returns whether the head went there.
    def dock(self):
        sensors, height = self.sensors, travel_height(self.settings)
        state = sensors.look()
        if state == DOCKED and self.may_be_pressed(height):
            z = self.host.z()
            self.ways.lift(height)
            state = sensors.look()
            if state == DOCKED:
                self.ways.to_height(z)
        if state == DOCKED:
            return False
        self.ways.require_homed()
        self.ways.lift_for_dock()
        sensors.proven = False
        self.templates.pre_detach.run_gcode_from_command()
        self.repeat(ATTACHED, DOCKED, self.dock_once, "docked")
        self.templates.post_detach.run_gcode_from_command()
        return True

    # Without another sense a probe on the bed looks as if it was not there
    def may_be_pressed(self, height):
        low = "z" in self.ways.homed() and self.host.z() < height
        return low and not self.sensors.senses

    def dock_once(self):
        self.leg("INSERT")
        self.leg("DOCK")
        leave = functools.partial(self.leg, "DETACH")
        with running.always(self.host, leave, "leaving the dock"):
            self.templates.detach.run_gcode_from_command()

    # do() takes the probe from one state into the other, at last
    def repeat(self, before, after, do, what):
        sensors, state = self.sensors, UNKNOWN
        sensors.read_docked = sensors.is_pressed(self.host.after_moves())
        for attempt in range(self.settings.retries + 1):
            if attempt:
                self.say(
                    "not %s, the probe is %s (%s); trying again (%d of %d)"
                    % (
                        (what, state, sensors.describe(), attempt)
                        + (self.settings.retries,)
                    )
                )
            state = sensors.look()
            if state == UNKNOWN:
                self.host.toolhead.dwell(ASK_AGAIN)
                state = sensors.look()
            if state == before:
                do()
                state = sensors.look()
            if state == after:
                return
        seen = sensors.describe()
        self.ways.get_clear()
        raise self.error(
            "the probe was not %s after %d attempts: %s (%s); %s"
            % (what, self.settings.retries + 1, state, seen, REMEDIES[what])
        )

    # A probe pin that reads open without the probe, too, proves nothing.
    def check_changed(self):
        sensors = self.sensors
        if sensors.is_told or sensors.check_open or sensors.read_docked:
            return
        sensors.is_told = True
        self.say(
            "'pin' reads open with and without the probe, so a broken one is"
            " not noticed before it has to stop the head; wire it as normally"
            " closed and set check_open_attach: True"
        )


REMEDIES = {
    "fetched": (
        "look whether the probe is in the dock and hangs on the head where"
        " dock_position is, check the pins with GET_PROBE_STATUS"
    ),
    "docked": (
        "look whether the probe came off; if it did, what says that it is on"
        " the head never changes: check pins and wires with GET_PROBE_STATUS"
        " and QUERY_PROBE, otherwise dock_position and detach_position"
    ),
}


######################################################################
# The probe of the printer
######################################################################


# What happens around commands that probe; see probe_host.Facade
class Prober(object):
    def __init__(self, docking, lowest, home_place, auto):
        self.host = docking.host
        self.docking = docking
        self.settings = docking.settings
        self.lowest = lowest
        # XY (mm) over which Z is homed with the probe; None: where it is
        self.home_place = home_place
        self.auto = auto
        # Somebody wants the probe to stay on the head
        self.is_held = False
        # A command probes, and the probe was looked at since it began
        self.is_open = self.is_checked = False
        # The delayed docking that is to come
        self.delayed = None

    def note(self, text):
        self.docking.say(text)

    # Lowest toolhead Z of a probing move.  Where Z is homed nobody knows how
    # high the head is; the second time it has come up by a known distance.
    def floor(self, home_attempt):
        if not home_attempt:
            return self.lowest
        if home_attempt == "1":
            return self.host.z_axis.position_min
        return self.settings.z_offset

    def is_homed(self):
        homed = self.docking.ways.homed()
        return "x" in homed and "y" in homed

    def begin(self, is_homing):
        self.delayed = None
        here = self.here()
        goal = here
        if is_homing and self.home_place is not None:
            goal = list(self.home_place) + here[2:]
        if not self.auto:
            self.require_attached()
            fetched = False
        else:
            fetched = self.docking.attach()
        ways = self.docking.ways
        if fetched or goal is not here:
            if not ways.is_at(goal):
                ways.lift(travel_height(self.settings))
            ways.go_back(goal, travel_height(self.settings))
        self.is_open, self.is_checked = True, False
        if not self.settings.each_sample:
            self.run_still("activate")

    # Toolhead position; Z is None where nobody knows it
    def here(self):
        here = list(self.host.toolhead.get_position()[:3])
        if "z" not in self.docking.ways.homed():
            here[2] = None
        return here

    def require_attached(self):
        sensors = self.docking.sensors
        if sensors.look() != ATTACHED:
            raise self.docking.error(
                "the probe is not attached (%s) and auto_attach_detach is off;"
                " run ATTACH_PROBE first" % (sensors.describe(),)
            )
        if not sensors.proven:
            raise self.docking.error(
                "the probe reads attached, but nobody has seen that change;"
                " run ATTACH_PROBE, which docks it and fetches it again"
            )

    def run_still(self, name):
        before = self.host.toolhead.get_position()[:3]
        getattr(self.docking.templates, name).run_gcode_from_command()
        if self.host.toolhead.get_position()[:3] != before:
            raise self.docking.error(
                "the head moved in %s_gcode; move it in another option"
                % (name,)
            )

    # A probing move begins.  Later in a session the pin itself tells: where
    # the probe is lost, the move ends where it began.
    def before_move(self):
        sensors, print_time = self.docking.sensors, self.host.now()
        if self.is_checked:
            state = ATTACHED
            if sensors.senses:
                state = sensors.state(print_time, sensors.senses)
        else:
            print_time = self.host.after_moves()
            state = sensors.state(print_time)
            if state == ATTACHED and sensors.is_pressed(print_time):
                state = UNKNOWN
        if state != ATTACHED or not sensors.proven:
            raise self.docking.error(
                "the probe is not ready for a touch: %s%s (%s); it was lost,"
                " or is pressed; put it into its dock, run ATTACH_PROBE"
                % (
                    state,
                    "" if sensors.proven else ", not seen to change",
                    sensors.describe(),
                )
            )
        self.is_checked = self.is_open
        if self.settings.each_sample:
            self.run_still("activate")

    def after_move(self, moved):
        sensors = self.docking.sensors
        if self.settings.each_sample:
            self.run_still("deactivate")
        if not moved:
            raise self.docking.error(
                "the probe triggered at z=%.3f before the head moved: it was"
                " lost or is pressed; put it into its dock, check it with"
                " GET_PROBE_STATUS" % (self.host.z(),)
            )
        senses = sensors.senses
        if senses and sensors.state(self.host.now(), senses) != ATTACHED:
            raise self.docking.error(
                "the probe was lost in a touch (%s); put it into its dock"
                % (sensors.describe(),)
            )
        if touching.is_at(self.host, self.lowest):
            self.note(
                "nothing down to z=%.3f, where the nozzle is just clear of the"
                " bed; home Z again (G28 Z), level, and check z_offset and the"
                " probe" % (self.lowest,)
            )

    # The command has probed, or failed
    def end(self):
        self.is_open = False
        if not self.is_homed() or self.host.printer.is_shutdown():
            return
        docking, here = self.docking, self.here()
        height = travel_height(self.settings)
        if here[2] is not None:
            # The bed may lie higher than Z=0 here
            height = max(height, here[2] + self.settings.retract)
            docking.ways.lift(height)
        if not self.settings.each_sample:
            self.run_still("deactivate")
        if docking.sensors.look() != ATTACHED:
            docking.sensors.proven = False
            raise docking.error(
                "the probe was lost (%s): what was measured last is wrong; put"
                " it into its dock" % (docking.sensors.describe(),)
            )
        if self.is_held or not self.auto:
            return
        if self.settings.delayed:
            self.dock_later()
        else:
            self.dock_and_return(here)

    def dock_and_return(self, here):
        if self.docking.dock() and self.settings.restore:
            self.docking.ways.go_back(here, 0.0)

    def dock_later(self):
        wanted = self.delayed = object()
        reactor = self.host.printer.get_reactor()

        def dock(eventtime):
            with self.host.gcode.get_mutex():
                if self.delayed is not wanted:
                    return
                self.delayed = None
                try:
                    self.dock_and_return(self.here())
                except self.host.printer.command_error as e:
                    self.host.gcode.respond_raw("!! %s" % (e,))

        when = reactor.monotonic() + DETACH_DELAY
        reactor.register_callback(dock, when)

    def hold(self, wanted):
        self.delayed = None
        self.is_held = wanted


######################################################################
# Commands
######################################################################


# Over which XY Z is homed with the probe, None: where the head is then
def read_home_place(config, settings):
    if settings.safe_z_position is not None:
        return settings.safe_z_position
    for section in ("safe_z_home", "homing_override"):
        if config.has_section(section):
            return None
    return ()


# The rectangle of the head while a mesh is probed, or None
def read_mesh(config, offsets):
    if not config.has_section("bed_mesh"):
        return None
    mesh = config.getsection("bed_mesh")
    low, high = [
        mesh.getfloatlist(name, None, count=2, note_valid=False)
        for name in ("mesh_min", "mesh_max")
    ]
    if low is None or high is None:
        return None
    return [
        (a - offset, b - offset) for a, b, offset in zip(low, high, offsets)
    ]


# The object behind [dockable_probe]
class DockableProbe(object):
    def __init__(self, config):
        logging.info("dockable_probe %s", __version__)
        machine = host.Host(config)
        self.host = machine
        self.probe_host = probe_host.ProbeHost(machine)
        self.old_names = options.OldNames(config)
        axis = machine.z_axis
        is_z_endstop = bool(axis and host.chip_of(axis.endstop_pin) == "probe")
        settings = read_settings(config, is_z_endstop, self.old_names)
        self.sensors = Sensors(config, self.probe_host, machine)
        self.ways = Ways(machine, self.probe_host, settings)
        loaded = [
            options.load_template(config, name + "_gcode", "")
            for name in Templates._fields
        ]
        self.docking = Docking(
            machine, settings, self.sensors, self.ways, Templates(*loaded)
        )
        lowest = lowest_touch(settings, is_z_endstop)
        if axis is not None:
            lowest = max(lowest, axis.position_min)
        auto = config.getboolean("auto_attach_detach", True)
        place = read_home_place(config, settings)
        self.prober = Prober(self.docking, lowest, place, auto)
        self.detach_dockable_before_z_home = settings.undock_for_z
        x_offset = options.number(config, "x_offset", 0.0)
        y_offset = options.number(config, "y_offset", 0.0)
        self.offsets = (x_offset, y_offset)
        self.mesh = read_mesh(config, self.offsets)
        endstop = self.sensors.endstop
        self.probe_host.install(config, self.prober, endstop, settings.z_offset)
        register = machine.printer.register_event_handler
        register("klippy:connect", self.connect)
        register("klippy:ready", self.tell_notes)
        register("homing:home_rails_begin", self.home_rails_begin)
        self.register_commands()

    def register_commands(self):
        for name, handler, text in (
            ("ATTACH_PROBE", self.cmd_ATTACH_PROBE, "Fetch the probe"),
            ("DETACH_PROBE", self.cmd_DETACH_PROBE, "Dock the probe"),
            ("GET_PROBE_STATUS", self.cmd_STATUS, "Where the probe is"),
            ("QUERY_DOCKABLE_PROBE", self.cmd_STATUS, "Where the probe is"),
            (
                "SET_PROBE_STATUS",
                self.cmd_SET_PROBE_STATUS,
                "Tell that the probe was attached or docked by hand",
            ),
            (
                "SET_DOCKABLE_PROBE",
                self.cmd_SET_DOCKABLE_PROBE,
                "Switch fetching and docking for commands that probe on or off",
            ),
            (
                "MOVE_AVOIDING_DOCK",
                self.cmd_MOVE_AVOIDING_DOCK,
                "Move to X and Y around the dock",
            ),
        ):
            self.host.gcode.register_command(name, handler, desc=text)
        for part in ("APPROACH", "DOCK", "EXTRACT", "INSERT", "DETACH"):
            self.host.gcode.register_command(
                "MOVE_TO_%s_PROBE" % (part,),
                getattr(self, "cmd_" + part),
                desc="Move the head to %s_position" % (part.lower(),),
            )

    # Set-up

    def connect(self):
        machine, settings = self.host, self.docking.settings
        machine.connect()
        self.check_reach()
        limits = machine.axis_limits()
        if self.prober.home_place == ():
            # The probe over the middle of the axes
            self.prober.home_place = [
                (low + high) / 2.0 - offset
                for (low, high), offset in zip(limits, self.offsets)
            ]
        if not self.probe_host.is_z_endstop():
            return
        if not settings.fixed_z:
            raise machine.printer.config_error(
                "Option 'dock_position' in section 'dockable_probe' has a Z, so"
                " Z has to be homed before the probe can be fetched, but it is"
                " homed with the probe; leave Z out of all positions, or set"
                " dock_fixed_z: True if the dock is at the head's height"
            )
        place = self.prober.home_place
        if place is not None and is_inside(place, self.ways.zone):
            raise machine.printer.config_error(
                "Option 'safe_z_position: %g, %g' in section 'dockable_probe' is"
                " %.1f mm from the dock; choose a point that is %.1f mm away"
                % (
                    tuple(place)
                    + (distance(place, self.ways.zone), self.ways.zone.radius)
                )
            )

    def check_reach(self):
        machine, settings = self.host, self.docking.settings
        limits = machine.axis_limits()
        for name in ("dock", "approach", "extract", "insert", "detach"):
            place = getattr(settings, name)
            for axis, at, (low, high) in zip("XYZ", place, limits):
                if at is None or low <= at <= high:
                    continue
                raise machine.printer.config_error(
                    "Option '%s_position' in section 'dockable_probe': %s=%.3f"
                    " is outside of %.3f to %.3f, the reach of the axis;"
                    " correct it, or position_min and position_max"
                    % (name, axis, at, low, high)
                )
        height, high = dock_height(settings), limits[2][1]
        if height > high:
            raise machine.printer.config_error(
                "Option 'dock_position' in section 'dockable_probe': the way to"
                " the dock is at z=%.3f, above position_max %.3f; correct its"
                " Z, z_hop or z_offset" % (height, high)
            )

    def tell_notes(self):
        for note in self.old_names.notes:
            self.docking.say(note)
        dock = self.docking.settings.dock
        if self.mesh is not None and is_within(dock[:2], self.mesh):
            self.docking.say(
                "dock_position (%g, %g) lies where the head goes while the bed"
                " mesh is probed; make the mesh smaller, or move the dock"
                % dock[:2]
            )

    # Where Z is homed without it the probe would be in the way
    def home_rails_begin(self, homing_state, rails):
        if not self.docking.settings.undock_for_z:
            return
        if 2 in homing_state.get_axes() and not self.probe_host.is_among(rails):
            if self.prober.is_homed():
                self.detach_probe()

    # Status

    @property
    def auto_attach_detach(self):
        return self.prober.auto

    def get_status(self, eventtime):
        status = self.probe_host.probe.get_status(eventtime)
        status = dict(status)
        status["last_status"] = self.sensors.last
        status["auto_attach_detach"] = self.prober.auto
        return status

    def cmd_STATUS(self, gcmd):
        state = self.sensors.look()
        gcmd.respond_info("Probe Status: %s" % (state,))
        self.docking.say(self.sensors.describe())

    def cmd_SET_PROBE_STATUS(self, gcmd):
        state = gcmd.get("STATE").strip().upper()
        if state not in (ATTACHED, DOCKED, UNKNOWN):
            raise options.param_error(
                gcmd, "STATE", "ATTACHED, DOCKED or UNKNOWN"
            )
        seen = self.sensors.look()
        if UNKNOWN not in (state, seen) and state != seen:
            raise self.docking.error(
                "STATE=%s, but the probe is %s (%s)"
                % (state, seen, self.sensors.describe())
            )
        self.sensors.proven = False
        self.prober.hold(state == ATTACHED)

    def cmd_SET_DOCKABLE_PROBE(self, gcmd):
        auto = options.param_int(
            gcmd, "AUTO_ATTACH_DETACH", None, minval=0, maxval=1
        )
        if auto is not None:
            self.prober.auto = bool(auto)

    # Fetching and docking

    def cmd_ATTACH_PROBE(self, gcmd):
        here = self.prober.here()
        self.prober.hold(False)
        if self.docking.attach() and self.docking.settings.restore:
            lowest = travel_height(self.docking.settings)
            self.ways.go_back(here, lowest)
        self.prober.hold(True)

    def cmd_DETACH_PROBE(self, gcmd):
        self.detach_probe()

    # Called by Kalico's safe_z_home, too, since 2026-02-24 (9500bd614)
    def detach_probe(self, return_pos=None):
        here = self.prober.here()
        self.prober.hold(False)
        self.prober.dock_and_return(here)

    # Parts of the way

    def cmd_APPROACH(self, gcmd):
        self.ways.go_before(self.docking.settings.approach)

    def cmd_DOCK(self, gcmd):
        settings = self.docking.settings
        attached = self.sensors.last == ATTACHED
        self.ways.go_in(settings.insert if attached else settings.approach)

    def cmd_EXTRACT(self, gcmd):
        settings = self.docking.settings
        self.ways.go_out(settings.extract, settings.attach_speed)

    def cmd_INSERT(self, gcmd):
        self.ways.go_before(self.docking.settings.insert)

    def cmd_DETACH(self, gcmd):
        settings = self.docking.settings
        self.ways.go_out(settings.detach, settings.detach_speed)

    def cmd_MOVE_AVOIDING_DOCK(self, gcmd):
        here = self.host.toolhead.get_position()
        number = functools.partial(options.param_number, gcmd)
        goal = number("X", here[0]), number("Y", here[1])
        default = self.docking.settings.travel_speed
        self.ways.require_xy()
        self.ways.travel(goal, number("SPEED", default, above=0.0))


def load_config(config):
    if host is None or host.__version__ != __version__:
        raise config.error(
            "Section '%s': the folder z_touch that belongs to this module is"
            " not in klippy/extras, or not of version %s; run install.sh again,"
            " or copy z_touch there, too, then restart the Klipper service"
            % (config.get_name(), __version__)
        )
    return DockableProbe(config)
