# The object behind [dockable_probe], its settings, measurements and commands.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import functools
import logging
import math

from .. import __version__
from ..core import endstops, host, options, running, templates, touching
from . import detour
from . import virtual_probe as probe_host

ATTACHED, DOCKED, UNKNOWN = "ATTACHED", "DOCKED", "UNKNOWN"

# XY speed (mm/s) outside of the dock.
TRAVEL_SPEED = 50.0

# A probing move ends this far (mm) above Z=0: the bed is about there, and the
# nozzle has to stay clear of it.
LOWEST_NOZZLE = 1.0

# and so far (mm) below where the probe triggers at Z=0: less than the body
# of a usual probe is long, more than a bed or gantry hangs.
REACH = 5.0

# The second way down of homing ends so far (mm) below the first trigger.
SECOND_REACH = 1.0

# A smaller z_offset (mm) of a switch was not measured yet; then the probe
# hangs at least as low as that, and may hang so much lower than the nozzle.
SMALLEST_Z_OFFSET = 2.0
UNMEASURED_PROBE = 10.0

# Off the way that takes the probe along, stripping it has to go at least so
# many degrees; less than the second is doubtful.
SAME_WAY = 20.0
DOUBTFUL_WAY = 45.0

# Before a contradiction of pins is believed they are asked again after (s).
ASK_AGAIN = 0.5

# With allow_delayed_detach it is docked so long (s) after its last use.
DETACH_DELAY = 1.0

TEMPLATES = (
    "pre_attach attach post_attach pre_detach detach post_detach activate"
    " deactivate"
)

PLACES = ("dock", "approach", "extract", "insert", "detach")


def read_place(config, option, default=None):
    if default is not None:
        values = config.getfloatlist(option, ())
        if not values:
            return default
    else:
        values = config.getfloatlist(option)
    if not 2 <= len(values) <= 3 or not all(map(options.is_finite, values)):
        what = "has to be 'X, Y' or 'X, Y, Z' in mm, such as 250, 295"
        raise options.config_error(config, option, what)
    return detour.Position(*(tuple(values) + (None,))[:3])


# Or by dock_angle or detach_angle, with dock_safe_distance: of old, in degrees
# and mm
def read_old_place(config, dock, notes, old, new):
    angle = options.number(config, old)
    length = options.number(config, "dock_safe_distance", above=0.0)
    if angle is None:
        return read_place(config, new)
    if length is None:
        what = "needs dock_safe_distance; better write " + new
        raise options.config_error(config, old, what)
    x, y = detour.on_circle(
        detour.Zone(dock.x, dock.y, 0, ()), math.radians(angle), length
    )
    text = "options '%s' and 'dock_safe_distance' are now '%s: %.1f, %.1f'"
    notes.append(text % (old, new, x, y))
    return read_place(config, new, detour.Position(x, y, None))


# In the order of PLACES
def read_places(config, notes):
    dock = read_place(config, "dock_position")
    read_old = functools.partial(read_old_place, config, dock, notes)
    approach = read_old("dock_angle", "approach_position")
    detach = read_old("detach_angle", "detach_position")
    extract = read_place(config, "extract_position", approach)
    insert = read_place(config, "insert_position", extract)
    return dock, approach, extract, insert, detach


# Whether the dock is at the head's height in any case: without a word about it
# unless a place has a Z.
def read_fixed_z(config, places):
    given = config.getboolean("dock_fixed_z", None)
    if given is None:
        return all(place.z is None for place in places)
    if not given and places[0].z is None:
        what = "is False: dock_position needs the Z of the dock as third number"
        raise options.config_error(config, "dock_fixed_z", what)
    return given


def check_places(config, places, notes):
    dock, approach, extract, _, detach = places
    z = approach.z if dock.z is None else dock.z
    for name, place in zip(PLACES[1:], places[1:]):
        if detour.first_leg(dock, z, place) == (0.0, 0.0, 0.0):
            what = "(%g, %g) is at dock_position; give a point some 40 mm away"
            name += "_position"
            raise options.config_error(config, name, what % place[:2])
    if config.get("detach_gcode", "").strip():
        return
    angle = detour.strip_angle(dock, z, extract, detach)
    what = (
        "and extract_position (approach_position unless given) are the same way"
        " out of the dock, %.0f degrees apart: the probe %s stay on the head;"
        " choose one that strips it off, mostly at 90 degrees"
        % (angle, "would" if angle < SAME_WAY else "may")
    )
    if angle < SAME_WAY:
        raise options.config_error(config, "detach_position", what)
    if angle < DOUBTFUL_WAY:
        notes.append("detach_position " + what)


# All in mm, mm/s.  'hang': how far the probe triggers below the nozzle, as far
# as anybody knows.
def read_settings(config, is_z_endstop, endstop_z, old_names):
    number = functools.partial(options.number, config)
    places = read_places(config, old_names.notes)
    check_places(config, places, old_names.notes)
    apart = [detour.distance(places[0], place) for place in places[1:]]
    apart = min([mm for mm in apart if mm >= detour.SMALLEST_DISTANCE] or [0.0])
    restore = old_names.name_of(
        "restore_toolhead", "return_to_last_probe_position_after_detach"
    )
    speed = number("speed", 5.0, above=0.0)
    z_offset = number("z_offset", config.getfloat("z_offset"))
    known = z_offset >= SMALLEST_Z_OFFSET or is_z_endstop
    found = dict(
        zip(PLACES, places),
        fixed_z=read_fixed_z(config, places),
        safe_z_position=options.pair(config, "safe_z_position"),
        safe_position=read_place(config, "safe_position", ()),
        radius=number("safe_dock_distance", apart, minval=0.0, maxval=apart),
        z_hop=number("z_hop", 0.0, minval=0.0),
        lift_speed=number("lift_speed", speed, above=0.0),
        travel_speed=number("travel_speed", TRAVEL_SPEED, above=0.0),
        attach_speed=number("attach_speed", speed, above=0.0),
        detach_speed=number("detach_speed", speed, above=0.0),
        offsets=(number("x_offset", 0.0), number("y_offset", 0.0)),
        z_offset=z_offset,
        hang=z_offset if known else UNMEASURED_PROBE,
        retract=number("sample_retract_dist", 2.0, above=0.0),
        retries=config.getint("dock_retries", 0, minval=0),
        restore=config.getboolean(restore, True),
        delayed=config.getboolean("allow_delayed_detach", False),
        each_sample=config.getboolean("deactivate_on_each_sample", False),
        lowest=lowest_touch(z_offset, is_z_endstop, endstop_z),
    )
    return collections.namedtuple("Settings", sorted(found))(**found)


# Lowest useful toolhead Z of a probing move.  'endstop_z' None, or where the
# nozzle may meet the pin that Z is homed on.
def lowest_touch(z_offset, is_z_endstop, endstop_z):
    if not is_z_endstop:
        above_pin = (endstop_z or 0.0) + LOWEST_NOZZLE
        return max(LOWEST_NOZZLE, above_pin if above_pin < z_offset else 0.0)
    if z_offset < SMALLEST_Z_OFFSET:
        return z_offset - LOWEST_NOZZLE
    return max(LOWEST_NOZZLE, z_offset - REACH)


# Toolhead Z (mm) at which the probe is clear of the bed
def travel_height(settings):
    return settings.hang + settings.retract


# and that on the way to the dock; a Z of a dock that goes up and down with the
# head is what else has to be cleared
def dock_height(settings):
    more = settings.dock.z or 0.0 if settings.fixed_z else 0.0
    return max(travel_height(settings) + more, settings.z_hop)


# A pin: its option, and what it reads with the probe on the head
Sense = collections.namedtuple("Sense", "name endstop when_attached")


# What tells where the probe is
class Sensors(object):
    def __init__(self, config, machine, printer):
        self.host = machine
        self.pin = Sense(
            "pin", machine.endstops.make_plain(config, "pin"), False
        )
        self.senses = []  # besides 'pin'
        check_open = config.getboolean("check_open_attach", None)
        for name, when_attached in (
            ("probe_sense_pin", True),
            ("dock_sense_pin", False),
        ):
            if config.get(name, "").strip():
                endstop = machine.endstops.make_plain(config, name)
                self.senses.append(Sense(name, endstop, when_attached))
        if check_open is None:
            # As other plugins have it
            check_open = [s.name for s in self.senses] == ["dock_sense_pin"]
        if not self.senses and not check_open:
            raise config.error(
                "Section '%s': nothing tells whether the probe is attached;"
                " set check_open_attach: True if 'pin' reads open with the"
                " probe on the head and TRIGGERED without it, or give"
                " probe_sense_pin or dock_sense_pin" % (config.get_name(),)
            )
        self.all = self.senses + ([self.pin] if check_open else [])
        # 'left': where we have put the probe, and they were seen to change
        self.left = self.last = UNKNOWN

    def state(self, print_time, senses):
        attached = [
            self.reads(s, print_time) == s.when_attached for s in senses
        ]
        some = UNKNOWN if any(attached) else DOCKED
        self.last = ATTACHED if all(attached) else some
        return self.last

    def reads(self, sense, print_time):
        return bool(sense.endstop.query_endstop(print_time))

    # After all moves so far; those of 'go_on' need not wait for the answer
    def look(self, go_on=None):
        print_time = self.host.after_moves()
        if go_on is not None:
            go_on()
        return self.state(print_time, self.all)

    # The same, but the head need not stop to see the probe where it was left
    def look_again(self):
        if self.state(self.host.print_time(), self.all) == self.left != UNKNOWN:
            return self.left
        return self.look()

    # What the pins read, for people
    def describe(self):
        print_time, words = self.host.after_moves(), ("open", "TRIGGERED")
        return ", ".join(
            "%s reads %s" % (s.name, words[self.reads(s, print_time)])
            for s in [self.pin] + self.senses
        )


class Ways(object):
    def __init__(self, machine, printer, settings):
        self.host = machine
        self.printer = printer
        self.settings = settings
        dock = settings.dock
        lanes = [
            detour.direction(dock, getattr(settings, n)) for n in PLACES[1:]
        ]
        self.zone = detour.Zone(dock.x, dock.y, settings.radius, lanes)
        self.is_lifted = False  # where nobody knows Z
        # What the Z motors had moved when Z was homed with the probe
        self.homed_at = None
        register = machine.printer.register_event_handler
        register("stepper_enable:motor_off", self.forget)

    def forget(self, *unused):
        self.is_lifted, self.homed_at = False, None

    # In mm, up is positive; the mean of all, None where X or Y share them
    def motors_z(self):
        pairs = zip(self.host.z_steppers(), self.host.z_datum())
        moved = [s.get_commanded_position() + datum for s, datum in pairs]
        return sum(moved) / len(moved) if moved else None

    def is_homed(self, axes):
        homed = self.host.toolhead_status()["homed_axes"]
        return all(axis in homed for axis in axes)

    def require_homed(self, axes=None):
        axes = axes or ("xy" if self.settings.fixed_z else "xyz")
        missing = [a.upper() for a in axes if not self.is_homed(a)]
        if missing:
            raise probe_error(
                self.host,
                "not homed: %s; the way to the dock is not known before; home"
                " first (G28 %s)" % (", ".join(missing), " ".join(missing)),
            )

    # Toolhead position; Z is None where nobody knows it
    def here(self):
        x, y, z = self.host.toolhead.get_position()[:3]
        return detour.Position(x, y, z if self.is_homed("z") else None)

    def is_at(self, place):
        return detour.distance(self.here(), place) < detour.ROUNDING

    # Z up where it is too low, never down
    def lift(self, height):
        if self.is_homed("z"):
            self.is_lifted = False
            touching.raise_to(self.host, height, self.settings.lift_speed)
        elif not self.is_lifted:
            self.printer.hop(height, self.settings.lift_speed)
            self.is_lifted = True

    def lift_for_dock(self):
        self.lift(dock_height(self.settings))

    def to_height(self, z):
        if z is not None and z != self.host.z():
            speed = self.settings.lift_speed
            self.host.toolhead.manual_move([None, None, z], speed)

    # The Z of a place, where it is one
    def to_z_of(self, place):
        if not self.settings.fixed_z:
            self.to_height(place.z)

    # Not through the dock
    def travel(self, place, speed):
        here, limits = self.here(), self.host.axis_limits()[:2]
        via = self.settings.safe_position or None
        # After homing the head stands a part of a step too far
        place = [
            min(max(xy, low), high) for xy, (low, high) in zip(place, limits)
        ]
        try:
            way = detour.around(here, place, self.zone, limits, via)
        except detour.NoDetour:
            raise probe_error(
                self.host,
                "no way from %.3f, %.3f to %.3f, %.3f around the dock in the"
                " reach of X and Y; move the head away from it, or lower"
                " safe_dock_distance (%.3f)"
                % (here[:2] + tuple(place) + (self.zone.radius,)),
            )
        for x, y in way:
            touching.move_xy(self.host, x, y, speed)

    # To a place before the dock
    def go_before(self, place):
        self.require_homed()
        self.lift_for_dock()
        self.travel(place, self.settings.travel_speed)
        self.to_z_of(place)

    # Into the dock from the place before it
    def go_in(self, before):
        self.require_homed()
        dock, speed = self.settings.dock, self.settings.attach_speed
        if not self.is_at(before) and not self.is_at(dock):
            self.go_before(before)
        self.to_z_of(dock)
        touching.move_xy(self.host, dock.x, dock.y, speed)

    # Out of the dock; from elsewhere around it
    def go_out(self, place, speed):
        self.require_homed()
        if not self.is_at(self.settings.dock):
            self.go_before(place)
            return
        self.to_z_of(place)
        touching.move_xy(self.host, place.x, place.y, speed)

    # Over where the head was, and down there, not lower than 'lowest'
    def go_back(self, place, lowest=None):
        self.lift_for_dock()
        self.travel(place, self.settings.travel_speed)
        if None not in (lowest, place.z, self.here().z):
            self.to_height(max(place.z, lowest))


def probe_error(machine, text):
    return machine.printer.command_error("%s: %s" % (machine.section, text))


# What takes the probe from one state into the other: parts of the way, and what
# templates are called
Trip = collections.namedtuple("Trip", "before after into out gcode done")
FETCH = Trip(DOCKED, ATTACHED, "APPROACH", "EXTRACT", "attach", "fetched")
STOW = Trip(ATTACHED, DOCKED, "INSERT", "DETACH", "detach", "docked")

REMEDIES = {
    FETCH: (
        "look whether the probe is in the dock and meets the head where"
        " dock_position is; check the pins with GET_PROBE_STATUS"
    ),
    STOW: (
        "look whether it came off: if it did, what reads ATTACHED never changes;"
        " check pins and wires with GET_PROBE_STATUS and QUERY_PROBE, otherwise"
        " dock_position and detach_position"
    ),
}


class Docking(object):
    def __init__(self, settings, sensors, ways, templates):
        self.host = ways.host
        self.settings = settings
        self.sensors = sensors
        self.ways = ways
        self.templates = templates

    def say(self, text):
        self.host.gcode.respond_info("%s: %s" % (self.host.section, text))

    # Puts the probe on the head, and goes back to 'goal' where there is one.
    # What reads "attached" has changed on the way out of the dock, then.
    def attach(self, goal=None):
        sensors, state = self.sensors, self.sensors.look_again()
        if state == sensors.left == ATTACHED:
            return
        self.ways.require_homed()
        self.ways.lift_for_dock()
        if not state == sensors.left == DOCKED:
            # Where the probe is pressed it looked as if it was not there
            state = sensors.look()
        if not state == sensors.left == ATTACHED:
            self.fetch(state, goal)
        if goal is not None:
            self.ways.go_back(goal, travel_height(self.settings))

    def fetch(self, state, goal):
        if state == ATTACHED:
            self.say("it reads attached, which proves nothing; docking it")
            self.dock()
            state = DOCKED
        if not self.sensors.reads(self.sensors.pin, self.host.print_time()):
            self.say(
                "'pin' reads open without the probe, too: if it breaks, nothing"
                " stops the nozzle; wire it as normally closed, and set"
                " check_open_attach: True"
            )
        self.make(FETCH, state, goal)

    # Puts the probe into the dock, and goes back to 'goal' where there is one
    def dock(self, goal=None):
        sensors, z = self.sensors, self.ways.here().z
        state = sensors.look_again()
        if state == DOCKED and not (sensors.left == DOCKED or sensors.senses):
            self.ways.lift(travel_height(self.settings))  # or it is pressed
            state = sensors.look()
        if state == DOCKED:
            self.ways.to_height(z)
            return
        self.ways.require_homed()
        self.ways.lift_for_dock()
        self.make(STOW, state, goal)
        if goal is not None:
            self.ways.go_back(goal, 0.0)

    def run(self, name):
        if name in self.templates:
            self.templates[name].run_gcode_from_command()

    # post_..._gcode runs beside the dock
    def make(self, trip, state, goal):
        self.sensors.left, go_on = UNKNOWN, None
        self.run("pre_" + trip.gcode)
        if goal is not None and "post_" + trip.gcode not in self.templates:
            go_on = functools.partial(self.ways.go_back, goal)
        self.repeat(trip, state, go_on)
        self.run("post_" + trip.gcode)
        self.sensors.left = trip.after

    # The parts are commands, as a macro may stand in for one
    def in_and_out(self, trip):
        leg = self.host.gcode.run_script_from_command
        leg("MOVE_TO_%s_PROBE" % (trip.into,))
        leg("MOVE_TO_DOCK_PROBE")
        leave = functools.partial(leg, "MOVE_TO_%s_PROBE" % (trip.out,))
        with running.always(self.host, leave, "leaving the dock"):
            self.run(trip.gcode)

    # 'state' was seen just before
    def repeat(self, trip, state, go_on):
        look, retries = self.sensors.look, self.settings.retries
        for attempt in range(retries + 1):
            if state == UNKNOWN:
                self.host.toolhead.dwell(ASK_AGAIN)
                state = look()
            if state == trip.before:
                self.in_and_out(trip)
                state = look(go_on)
                state = state if state == trip.after else look()
            if state == trip.after:
                return
            seen = "the probe was not %s, it is %s (%s)"
            seen %= (trip.done, state, self.sensors.describe())
            if attempt < retries:
                self.say("%s; try %d of %d" % (seen, attempt + 2, retries + 1))
                state = look()
        self.ways.lift_for_dock()
        raise probe_error(self.host, "%s; %s" % (seen, REMEDIES[trip]))


# What happens around commands that probe; see probe_host.Facade
class Prober(object):
    def __init__(self, docking, home_place, auto):
        self.host = docking.host
        self.docking = docking
        self.settings = docking.settings
        self.ways = docking.ways
        self.sensors = docking.sensors
        # Where Z is homed with the probe; None: where the head is
        self.home_place = home_place
        self.auto = auto
        self.is_held = False  # by ATTACH_PROBE
        self.ways_down = 0  # that homing still has to go
        self.clear_z = 0.0  # toolhead Z, the probe just off what it has touched
        self.delayed = None  # the docking that is to come

    # Lowest toolhead Z of a probing move
    def floor(self, is_homing=False):
        axis = self.host.z_axis
        position_min = axis.position_min if axis else -1e6
        return max(position_min, -1e6 if is_homing else self.settings.lowest)

    # Of homing: as deep as any touch, then hardly deeper than the first one.
    # Counted by the motors, as homing and others say of Z what they like.
    def way_down(self):
        now, before = self.ways.motors_z(), self.ways.homed_at
        deepest = self.settings.z_offset - self.settings.lowest
        beyond = deepest if self.ways_down == 2 else SECOND_REACH
        return None if None in (now, before) else now - before + beyond

    def begin(self, is_homing):
        self.delayed = None
        self.ways_down, self.clear_z = 2 if is_homing else 0, 0.0
        goal = self.ways.here()
        if is_homing and self.home_place is not None:
            goal = goal._replace(x=self.home_place[0], y=self.home_place[1])
        if not self.auto:
            state = self.sensors.look_again()
            if not state == self.sensors.left == ATTACHED:
                off = "is %s and auto_attach_detach is off: run ATTACH_PROBE"
                raise self.lost(off % (state,))
        if self.auto:
            self.docking.attach(goal)
        if not self.ways.is_at(goal):
            self.ways.go_back(goal, travel_height(self.settings))
        self.run_still("activate", False)

    def run_still(self, name, of_touch):
        if of_touch != self.settings.each_sample:
            return
        before = self.host.toolhead.get_position()[:3]
        self.docking.run(name)
        if self.host.toolhead.get_position()[:3] != before:
            text = "the head moved in %s_gcode; move it in another option"
            raise probe_error(self.host, text % (name,))

    # A probing move begins.  'pin' tells by itself: where the probe is lost,
    # the move ends where it began.
    def before_move(self):
        sensors, senses = self.sensors, self.sensors.senses
        if senses and sensors.state(self.host.print_time(), senses) != ATTACHED:
            raise self.lost("is not ready")
        if sensors.left != ATTACHED:
            raise self.lost("was not seen to be fetched")
        self.run_still("activate", True)

    def after_move(self, moved, triggered):
        sensors = self.sensors
        self.clear_z = self.host.z() + self.settings.retract
        self.run_still("deactivate", True)
        senses = sensors.senses
        if senses and sensors.state(self.host.print_time(), senses) != ATTACHED:
            raise self.lost("was lost in a touch")
        if not moved:
            raise self.lost("triggered before the head moved")
        if self.ways_down and triggered:
            # Elsewhere the bed may be much higher, or the gantry lower
            self.ways.homed_at = self.ways.motors_z()
            self.ways_down = 1
        elif self.ways_down:
            # The host turns the motors off then
            sensors.left = UNKNOWN
            distance = self.settings.retract + REACH
            self.ways.printer.hop(distance, self.settings.lift_speed)
            self.docking.say(
                "nothing where the bed was; look whether the switch clicks, and"
                " home again: it is docked and fetched to see that, and finds"
                " any bed"
            )
        elif not triggered and touching.is_at(self.host, self.settings.lowest):
            self.docking.say(
                "nothing down to z=%.3f, where the nozzle is just clear of the"
                " bed; home Z again, level, check z_offset and the probe"
                % (self.settings.lowest,)
            )

    def lost(self, what):
        self.sensors.left = UNKNOWN
        return probe_error(
            self.host,
            "the probe %s, at z=%.3f (%s); where it is lost or pressed, raise"
            " the head, put it into its dock, and check it with"
            " GET_PROBE_STATUS"
            % (what, self.host.z(), self.sensors.describe()),
        )

    # The command has probed, or failed
    def end(self):
        homed, self.ways_down = self.ways_down, 0
        if not self.ways.is_homed("xy") or self.host.printer.is_shutdown():
            return
        here = self.ways.here()
        if here.z is not None:
            # The bed may lie higher than Z=0, and Z is said to be another now
            height = travel_height(self.settings)
            top = here.z + self.settings.retract if homed else self.clear_z
            if homed or touching.is_at(self.host, self.settings.lowest):
                here = here._replace(z=height)  # Not back down to nothing
            self.ways.lift(max(height, top))
        self.run_still("deactivate", False)
        if self.sensors.look() != ATTACHED:
            raise self.lost("was lost, what was measured is wrong")
        if self.is_held or not self.auto:
            return
        if self.settings.delayed:
            self.dock_later()
        else:
            self.dock_and_return(here)

    def dock_and_return(self, here):
        self.docking.dock(here if self.settings.restore else None)

    def dock_later(self):
        wanted = self.delayed = object()
        reactor = self.host.printer.get_reactor()

        def dock(eventtime):
            with self.host.gcode.get_mutex():
                if self.delayed is not wanted:
                    return
                self.delayed = None
                try:
                    self.dock_and_return(self.ways.here())
                except self.host.printer.command_error as e:
                    self.host.gcode.respond_raw("!! %s" % (e,))

        reactor.register_callback(dock, reactor.monotonic() + DETACH_DELAY)

    def hold(self, wanted):
        self.delayed = None
        self.is_held = wanted


# Over which XY Z is homed with the probe: None where the head is then, empty
# in the middle.
def read_home_place(config, settings):
    others = ("safe_z_home", "homing_override")
    if settings.safe_z_position or any(map(config.has_section, others)):
        return settings.safe_z_position
    return ()


# The rectangle of the head while a mesh is probed, or None
def read_mesh(config, offsets):
    if not config.has_section("bed_mesh"):
        return None
    read = functools.partial(
        config.getsection("bed_mesh").getfloatlist, count=2, note_valid=False
    )
    low, high = read("mesh_min", None), read("mesh_max", None)
    if None in (low, high):
        return None
    return [(a - shift, b - shift) for a, b, shift in zip(low, high, offsets)]


# The object behind [dockable_probe]
class DockableProbe(object):
    def __init__(self, config):
        logging.info("dockable_probe %s", __version__)
        machine = self.host = host.Host(config)
        self.probe_host = probe_host.ProbeHost(machine)
        old = self.old_names = options.OldNames(config)
        axis = machine.z_axis
        is_z_endstop = bool(
            axis and endstops.chip_of(axis.endstop_pin) == "probe"
        )
        endstop_z = axis.position_endstop if axis else None
        settings = read_settings(config, is_z_endstop, endstop_z, old)
        self.settings = settings
        self.sensors = Sensors(config, machine, self.probe_host)
        self.ways = Ways(machine, self.probe_host, settings)
        loaded = {
            name: templates.load_template(config, name + "_gcode")
            for name in TEMPLATES.split()
            if config.get(name + "_gcode", "").strip()
        }
        self.docking = Docking(settings, self.sensors, self.ways, loaded)
        auto = config.getboolean("auto_attach_detach", True)
        place = read_home_place(config, settings)
        self.prober = Prober(self.docking, place, auto)
        # Of this name for Kalico's safe_z_home
        self.detach_dockable_before_z_home = config.getboolean(
            "detach_dockable_before_z_home", False
        )
        self.mesh = read_mesh(config, settings.offsets)
        self.probe_host.install(
            config, self.prober, self.sensors.pin.endstop, settings.z_offset
        )
        register = machine.printer.register_event_handler
        register("klippy:connect", self.connect)
        register("klippy:ready", self.tell_notes)
        register("homing:home_rails_begin", self.home_rails_begin)
        running.register_commands(machine, self)

    def connect(self):
        machine, settings = self.host, self.settings
        machine.connect()
        limits = machine.axis_limits()
        for name in PLACES:
            place = getattr(settings, name)
            for axis, at, (low, high) in zip("XYZ", place, limits):
                if at is not None and not low <= at <= high:
                    raise self.wrong(
                        name,
                        "%s=%.3f is outside of %.3f to %.3f, the reach of the"
                        " axis; correct it, or the limits of the axis"
                        % (axis, at, low, high),
                    )
        height, high = dock_height(settings), limits[2][1]
        if height > high:
            text = "the way there is at z=%.3f, above position_max (%.3f);"
            text += " correct its Z, z_hop or z_offset"
            raise self.wrong("dock", text % (height, high))
        if self.probe_host.is_z_endstop():
            self.connect_z_endstop(limits)

    def connect_z_endstop(self, limits):
        if not self.settings.fixed_z:
            raise self.wrong(
                "dock",
                "to get there Z has to be homed, and Z is homed with the probe;"
                " leave Z out of all positions, or set dock_fixed_z: True if the"
                " dock is at the head's height",
            )
        if self.prober.home_place == ():
            # The probe over the middle of the axes
            self.prober.home_place = [
                (low + high) / 2.0 - shift
                for (low, high), shift in zip(limits, self.settings.offsets)
            ]
        place = self.prober.home_place
        if place is not None and detour.is_inside(place, self.ways.zone):
            text = "%g, %g is %.1f mm from the dock; choose a point that is"
            text += " at least %.1f mm away (safe_dock_distance)"
            apart = (
                detour.distance(place, self.ways.zone),
                self.ways.zone.radius,
            )
            raise self.wrong("safe_z", text % (tuple(place) + apart))

    def wrong(self, name, what):
        text = "Option '%s_position' in section '%s': %s"
        text %= (name, self.host.section, what)
        return self.host.printer.config_error(text)

    def tell_notes(self):
        for note in self.old_names.notes + self.probe_host.notes:
            self.docking.say(note)
        dock = self.settings.dock[:2]
        if self.mesh is not None and detour.is_within(dock, self.mesh):
            self.docking.say(
                "dock_position (%g, %g) lies where the head goes while the bed"
                " mesh is probed; make the mesh smaller, or move the dock"
                % dock
            )

    # Where Z is homed without the probe, that may be in the way
    def home_rails_begin(self, homing_state, rails):
        wanted = self.detach_dockable_before_z_home and self.ways.is_homed("xy")
        is_z = 2 in homing_state.get_axes()
        if wanted and is_z and not self.probe_host.is_among(rails):
            self.detach_probe()

    @property
    def auto_attach_detach(self):
        return self.prober.auto

    def get_status(self, eventtime):
        status = dict(self.probe_host.probe.get_status(eventtime))
        status["last_status"] = self.sensors.last
        status["auto_attach_detach"] = self.prober.auto
        return status

    cmd_GET_PROBE_STATUS_help = "Tell where the probe is"

    def cmd_GET_PROBE_STATUS(self, gcmd):
        gcmd.respond_info("Probe Status: %s" % (self.sensors.look(),))
        self.docking.say(self.sensors.describe())

    cmd_QUERY_DOCKABLE_PROBE_help = cmd_GET_PROBE_STATUS_help
    cmd_QUERY_DOCKABLE_PROBE = cmd_GET_PROBE_STATUS

    cmd_SET_PROBE_STATUS_help = "Tell where you have put the probe by hand"

    def cmd_SET_PROBE_STATUS(self, gcmd):
        state, states = gcmd.get("STATE").upper(), (ATTACHED, DOCKED, UNKNOWN)
        if state not in states:
            raise options.param_error(gcmd, "STATE", ", ".join(states))
        seen = self.sensors.look()
        if state not in (UNKNOWN, seen):
            text = "STATE=%s, but the probe is %s (%s); put it there first"
            text %= (state, seen, self.sensors.describe())
            raise probe_error(self.host, text)
        self.sensors.left = UNKNOWN
        self.prober.hold(state == ATTACHED)

    cmd_SET_DOCKABLE_PROBE_help = "Switch going to the dock by itself on or off"

    def cmd_SET_DOCKABLE_PROBE(self, gcmd):
        name, auto = "AUTO_ATTACH_DETACH", self.prober.auto
        auto = options.param_int(gcmd, name, auto, minval=0, maxval=1)
        self.prober.auto = bool(auto)

    cmd_ATTACH_PROBE_help = "Fetch the probe"

    def cmd_ATTACH_PROBE(self, gcmd):
        self.prober.hold(False)
        here = self.ways.here()
        self.docking.attach(here if self.settings.restore else None)
        self.prober.hold(True)

    cmd_DETACH_PROBE_help = "Dock the probe"

    def cmd_DETACH_PROBE(self, gcmd=None):
        self.prober.hold(False)
        self.prober.dock_and_return(self.ways.here())

    # Of this name for Kalico's safe_z_home, since 2026-02-24 (9500bd614)
    detach_probe = cmd_DETACH_PROBE

    cmd_MOVE_TO_APPROACH_PROBE_help = "Move to approach_position"

    def cmd_MOVE_TO_APPROACH_PROBE(self, gcmd):
        self.ways.go_before(self.settings.approach)

    cmd_MOVE_TO_DOCK_PROBE_help = "Move into the dock"

    def cmd_MOVE_TO_DOCK_PROBE(self, gcmd):
        is_on, settings = self.sensors.last == ATTACHED, self.settings
        self.ways.go_in(settings.insert if is_on else settings.approach)

    cmd_MOVE_TO_EXTRACT_PROBE_help = "Move out of the dock, with the probe"

    def cmd_MOVE_TO_EXTRACT_PROBE(self, gcmd):
        self.ways.go_out(self.settings.extract, self.settings.attach_speed)

    cmd_MOVE_TO_INSERT_PROBE_help = "Move to insert_position"

    def cmd_MOVE_TO_INSERT_PROBE(self, gcmd):
        self.ways.go_before(self.settings.insert)

    cmd_MOVE_TO_DETACH_PROBE_help = "Move out of the dock, without the probe"

    def cmd_MOVE_TO_DETACH_PROBE(self, gcmd):
        self.ways.go_out(self.settings.detach, self.settings.detach_speed)

    cmd_MOVE_AVOIDING_DOCK_help = "Move to X and Y around the dock"

    def cmd_MOVE_AVOIDING_DOCK(self, gcmd):
        self.ways.require_homed("xy")
        number = functools.partial(options.param_number, gcmd)
        here, speed = self.ways.here(), self.settings.travel_speed
        goal = detour.Position(number("X", here.x), number("Y", here.y), None)
        self.ways.travel(goal, number("SPEED", speed, above=0.0))
