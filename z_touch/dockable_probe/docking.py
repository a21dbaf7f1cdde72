# Trips to the dock: fetching the probe, and docking it.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#            in                    in the dock      out
#
#   fetch    MOVE_TO_APPROACH_...  attach_gcode     MOVE_TO_EXTRACT_PROBE
#   dock     MOVE_TO_INSERT_...    detach_gcode     MOVE_TO_DETACH_PROBE
#
# pre_..._gcode runs before a trip, post_..._gcode after it, beside the dock, also
# where the trip has failed: a servo puts the dock away then.  A trip that has not
# brought about what it should is tried dock_retries times again.
# activate_gcode runs before the probe is fetched, deactivate_gcode when it was
# docked and the head is back.

import collections
import contextlib
import functools

from .. import command as running
from .. import templates
from ..errors import CalibrationError
from . import detour
from .sensors import ATTACHED, DOCKED, UNKNOWN
from .settings import POSITIONS, travel_height

# A contradiction of pins is believed when it still is there so long (s) after.
ASK_AGAIN = 0.5

# The bed may be so much (mm) higher than where the probe meets it.
HIGHER = 1.0

# How a person says where it is
IF_DOCKED = "run SET_PROBE_STATUS STATE=DOCKED where you see it in the dock"

# What takes the probe from one state into the other: the parts of the way in
# and out, what its options are called, what has become of the probe, and what
# to look at where it has not
Trip = collections.namedtuple(
    "Trip", "before after way_in way_out gcode done remedy"
)
FETCH = Trip(
    before=DOCKED,
    after=ATTACHED,
    way_in="MOVE_TO_APPROACH_PROBE",
    way_out="MOVE_TO_EXTRACT_PROBE",
    gcode="attach_gcode",
    done="fetched",
    remedy="in the dock it has to meet the head at dock_position; look where it"
    " is, and check the pins with GET_PROBE_STATUS: where it hangs on the head, a"
    " wire is broken, so take it off before you home, and " + IF_DOCKED,
)
DOCK = Trip(
    before=ATTACHED,
    after=DOCKED,
    way_in="MOVE_TO_INSERT_PROBE",
    way_out="MOVE_TO_DETACH_PROBE",
    gcode="detach_gcode",
    done="docked",
    remedy="the dock has to hold it back on the way to detach_position; look"
    " whether it came off: if it did, what reads ATTACHED never changes, so check"
    " pins and wires with GET_PROBE_STATUS and QUERY_PROBE, and if not,"
    " dock_position and detach_position",
)


# Fetches the probe and docks it, and sees that it did
class Docking:
    # 'sensors': sensors.Sensors; 'moves': moves.Moves
    def __init__(self, settings, sensors, moves):
        self.host = moves.host
        self.settings = settings
        self.sensors = sensors
        self.moves = moves
        # The option whose G-code runs, None where none does
        self.running = None
        # Whether the parts of a trip are run by the trip
        self.is_on_trip = False
        # Whether a macro has brought the head to where the dock is entered from
        self.is_brought = False
        # What the pins read before a way into the dock by itself, and whether that
        # was doubtful
        self.seen_before, self.was_doubtful = UNKNOWN, True

    def use(self, settings):
        self.settings = settings

    # Puts the probe on the head, and goes back to 'goal' where there is one.
    # The pins have changed on the way out of the dock, then.  Returns whether it
    # was in the dock.  'is_only_stop': nothing else will end the way down.
    def fetch(self, goal=None, is_only_stop=False):
        self.check_idle()
        sensors, state = self.sensors, self.sensors.confirm()
        if state == sensors.proven == ATTACHED:
            return False
        self._require_homed(state)
        self.moves.lift_for_dock(on_the_way=True)
        if not state == sensors.proven == DOCKED:
            # Where the probe was pressed it looked as if it were not there.
            state = sensors.look()
        if not state == sensors.proven == ATTACHED:
            self._fetch_from(state, goal, is_only_stop)
        if goal is not None:
            self.moves.go_back(goal, self.moves.clear.lowest(self.settings))
        return state == DOCKED

    def _fetch_from(self, state, goal, is_only_stop):
        if state == ATTACHED:
            self.host.say("it reads attached, which proves nothing; docking it")
            self.dock(may_fetch=False)
            state = DOCKED
        sensors = self.sensors
        sensors.look_at_switch()
        if is_only_stop:
            self.check_switch()
        if not sensors.is_switch_seen:
            self.host.say(
                "'pin' reads open without the probe, too: if it breaks, nothing"
                " stops the nozzle; wire it as normally closed, and set"
                " check_open_attach: True"
            )
        self.activate()
        self._make(FETCH, state, goal)

    # Before a way down that nothing else ends
    def check_switch(self):
        if self.sensors.is_pin_asked and not self.sensors.is_switch_seen:
            raise self.host.error(
                "'pin' reads open without the probe, as a broken wire does, and"
                " nothing else would stop the nozzle; look at the switch and its"
                " wires, or set check_open_attach: False if it is normally open"
            )

    # Puts the probe into the dock, and goes back to 'goal' where there is one.
    # Returns whether it was anywhere else.  'may_fetch': to see that it is there
    def dock(self, goal=None, may_fetch=True):
        self.check_idle()
        sensors, z = self.sensors, self.moves.position().z
        state = sensors.confirm()
        is_certain = sensors.proven == DOCKED or sensors.senses
        if state == DOCKED and not is_certain and z is not None:
            # Perhaps it is on the head, and pressed.  Where nobody knows Z the
            # head would go up at each look.
            self.moves.lift(travel_height(self.settings))
            state = sensors.look()
        if state == DOCKED and sensors.is_doubtful() and may_fetch:
            self._check_reach()
            self.host.say(
                "it reads docked, and was not seen to be docked; fetching it, to"
                " see that it is there, and docking it"
            )
            self.fetch()
            state = ATTACHED
        if state == DOCKED:
            self.moves.go_to_height(z)
            return False
        self._require_homed(state)
        self.moves.lift_for_dock(on_the_way=True)
        self._make(DOCK, state, goal)
        if goal is not None:
            self.moves.go_back(goal, 0.0)
        self._deactivate_or_lift()
        return True

    # The head may be back near the bed, and goes up again where that fails.
    def _deactivate_or_lift(self):
        done = []

        def lift():
            if not done:
                self.moves.lift_for_dock()

        with running.always(self.host, lift, "lifting the head"):
            self.deactivate()
            done.append(True)

    # Whether the way to the dock is known
    def _is_in_reach(self):
        axes = "xy" if self.settings.dock_fixed_z else "xyz"
        return self.settings.is_placed and self.moves.is_homed(axes)

    # What cannot be fetched cannot be seen to be there.
    def _check_reach(self):
        if not self._is_in_reach():
            raise self.host.error(
                "the probe reads DOCKED (%s), and nobody has seen it docked: it may"
                " hang on the head, its wire broken; if so, take it off before you"
                " home, and %s" % (self.sensors.describe(), IF_DOCKED)
            )

    # To home Z on its switch with the probe on would press it into the bed.
    def _require_homed(self, state):
        moves, settings = self.moves, self.settings
        needs_z = not settings.dock_fixed_z or settings.strip_z is not None
        is_z_missing = needs_z and not moves.is_homed("z")
        if state != DOCKED and is_z_missing and moves.is_homed("xy"):
            raise self.host.error(
                "the probe is %s (%s), and to find the dock Z has to be homed;"
                " take the probe off by hand and put it into the dock, then"
                " SET_PROBE_STATUS STATE=DOCKED and G28"
                % (state, self.sensors.describe())
            )
        moves.require_homed()

    ######################################################################
    # G-code of the owner's
    ######################################################################

    # The G-code of an option, where it is given.  A trip may begin in the middle of
    # anybody's G-code: it begins with absolute coordinates, and what comes after it
    # goes on with the modes and the speed of before.
    def run(self, name):
        template = getattr(self.settings, name)
        if template is None:
            return
        outer, self.running = self.running, name
        try:
            with self._in_absolute(), templates.checking_commands(
                self.host, name
            ):
                template.run_gcode_from_command()
        except CalibrationError as e:
            raise self.host.error(e)
        finally:
            self.running = outer

    @contextlib.contextmanager
    def _in_absolute(self):
        gcode_state = self.host.gcode_state
        modes = gcode_state.modes()
        gcode_state.set_modes(modes._replace(absolute=True))
        try:
            yield
        finally:
            gcode_state.set_modes(modes)

    # It must not move the head.
    def run_still(self, name):
        before = self.host.toolhead.get_position()[:3]
        self.run(name)
        if self.host.toolhead.get_position()[:3] != before:
            raise self.host.error(
                "the head moved in %s; move it in another option" % (name,)
            )

    # The probe is about to be used for a while, and was used; with
    # deactivate_on_each_sample that is each touch, see prober.Prober
    def activate(self):
        if not self.settings.deactivate_on_each_sample:
            self.run_still("activate_gcode")

    def deactivate(self):
        if not self.settings.deactivate_on_each_sample:
            self.run_still("deactivate_gcode")

    # Whether G-code of the owner's may be running
    def is_busy(self):
        return self.is_on_trip or self.running is not None

    # Fetching it for what runs in the middle of fetching it would never end.
    def check_idle(self):
        if self.running is not None:
            raise self.host.error(
                "a command in %s needs the probe fetched or docked, which that"
                " is a part of; remove the command there" % (self.running,)
            )

    ######################################################################
    # A trip
    ######################################################################

    # A trip with the G-code around it.  'state' is what was seen just before.
    def _make(self, trip, state, goal):
        self.sensors.begin_trip()
        after = "post_" + trip.gcode
        go_on = None
        if goal is not None and getattr(self.settings, after) is None:
            go_on = functools.partial(self.moves.go_back, goal)
        with self._dock_out(trip):
            self._try(trip, state, go_on)
        self.sensors.end_trip(trip.after)

    # The dock is brought out before, and put away afterwards where the head is
    # not in it.
    @contextlib.contextmanager
    def _dock_out(self, trip):
        after = "post_" + trip.gcode
        put_away = functools.partial(self._run_beside_dock, after)
        self.is_on_trip = True
        try:
            with running.always(self.host, put_away, "putting the dock away"):
                self._make_room(trip)
                self.run("pre_" + trip.gcode)
                yield
        finally:
            self.is_on_trip = False

    # While the dock is away a head may stand where it comes out.
    def _make_room(self, trip):
        moves, settings = self.moves, self.settings
        comes_out = getattr(settings, "pre_" + trip.gcode) is not None
        is_near = detour.is_inside(moves.position(), moves.zone)
        if comes_out and is_near and not moves.stands_in_dock():
            is_fetched = trip is FETCH
            moves.go_beside(
                settings.approach_position
                if is_fetched
                else settings.insert_position
            )

    # A head that was not brought out of the dock still is in it.
    def _run_beside_dock(self, name):
        if not self.moves.stands_in_dock():
            self.run(name)

    # Until the probe is where the trip should bring it; raises the host's
    # error, with the head lifted, when no retry is left.  'go_on' queues the
    # way back, which need not wait for what the pins read.
    def _try(self, trip, state, go_on):
        look, retries = self.sensors.look, self.settings.dock_retries
        for attempt in range(retries + 1):
            if state == UNKNOWN:
                self.host.toolhead.dwell(ASK_AGAIN)
                state = look()
            if state == trip.before:
                self._visit_dock(trip)
                state = look(go_on)
                # What chatters while the head moves is asked when it stands.
                state = state if state == trip.after else look()
            if state == trip.after:
                return
            seen = "the probe was not %s, it is %s (%s)" % (
                trip.done,
                state,
                self.sensors.describe(),
            )
            if attempt < retries:
                self.host.say(
                    "%s; try %d of %d" % (seen, attempt + 2, retries + 1)
                )
                state = look()
        self.moves.lift_for_dock()
        raise self.host.error("%s; %s" % (seen, trip.remedy))

    # MOVE_TO_DOCK_PROBE, straight from a position outside.  Whoever sends it by
    # itself has not brought the dock out.
    def go_in(self, beside):
        moves = self.moves
        if self.is_on_trip or moves.stands_in_dock():
            moves.go_in(moves.position() if self.is_brought else beside)
            return
        moves.require_homed()
        state = self.sensors.look()
        trip = DOCK if state == ATTACHED else FETCH
        # The owner may leave it in any way, also without our commands.
        self.was_doubtful = self.sensors.may_hang
        self.sensors.begin_trip()
        self.seen_before = state
        with self._dock_out(trip):
            moves.go_in(beside)

    # Out of the dock as a trip ends; by itself the dock is put away, too.
    def go_out(self, trip, position, speed):
        is_by_itself = self.moves.stands_in_dock() and not self.is_on_trip
        if is_by_itself:
            before, self.seen_before = self.seen_before, UNKNOWN
            self.sensors.begin_trip()
        if trip is DOCK:
            self._strip_off()
        self.moves.go_out(position, speed, self.is_on_trip)
        if not is_by_itself:
            return
        # A way in and out part by part proves as much as a trip, and one on which the
        # probe has stayed in the dock nothing else than what was known.
        state = self.sensors.look()
        if (before, state) == (trip.before, trip.after):
            self.sensors.end_trip(trip.after)
        elif before == state == trip.after == DOCKED:
            self.sensors.stayed_docked(self.was_doubtful)
        self.run("post_" + trip.gcode)

    # Up or down in a dock that holds the probe back on that way.  A probe that stays
    # on the head goes no lower than it is clear of a bed, and is not dragged out there.
    def _strip_off(self):
        moves, strip_z = self.moves, self.settings.strip_z
        z = moves.position().z
        if None in (strip_z, z) or not moves.stands_in_dock():
            return
        # Pressed onto a bed it would read as docked.
        clear = self.settings.hang + HIGHER
        if strip_z < clear < z:
            moves.go_to_height(clear)
        else:
            moves.go_to_height(strip_z)
        if self.sensors.look() == ATTACHED:
            moves.go_to_height(z)
        else:
            moves.go_to_height(strip_z)

    # Around another way out of the dock: what was brought out for the way in is put
    # away.
    @contextlib.contextmanager
    def putting_away(self):
        is_by_itself = self.moves.stands_in_dock() and not self.is_on_trip
        yield
        if is_by_itself:
            trip = FETCH if self.sensors.look() == ATTACHED else DOCK
            self.run("post_" + trip.gcode)

    # Homing, and what else goes straight on, would begin across the dock.  Where
    # nobody knows the way out, or the way is part of a trip, the head stays.  'axes'
    # are those that are homed (0: X).
    def leave(self, axes=()):
        moves, settings = self.moves, self.settings
        if self.is_on_trip or not self._is_in_reach():
            return
        if moves.stands_in_dock():
            self.go_out(DOCK, settings.detach_position, settings.detach_speed)
        is_near = detour.is_inside(moves.position(), moves.zone)
        is_beside = is_near or self._is_beside()
        if is_beside and self._make_way_for_homing(axes):
            return
        if moves.is_at_detach():
            moves.go_beside(settings.approach_position)
        # What goes on from straight above it goes down at first.
        moves.leave_top()

    # Whether the head stands at a position of the dock's, out of it
    def _is_beside(self):
        positions = [getattr(self.settings, row.name) for row in POSITIONS]
        return any(
            self.moves.is_at(position)
            for position in positions
            if not self.moves.is_in_dock(position)
        )

    # Rather for both axes: the other one may be homed next, from where this ends.
    # Returns whether homing does not pass the dock now.
    def _make_way_for_homing(self, axes):
        ends = self.host.axes.xy_ends()
        wanted = {axis: end for axis, end in ends.items() if axis in axes}
        return bool(wanted) and (self._make_way(ends) or self._make_way(wanted))

    # To the nearest place where that is so, see detour.homing_lines()
    def _make_way(self, ends):
        moves, via = self.moves, self.settings.safe_position
        start, limits = moves.position(), self.host.axes.limits()[:2]
        if detour.is_clear_for_homing(start, ends, moves.zone):
            return True
        for x, y in detour.places_for_homing(start, ends, moves.zone, limits):
            try:
                detour.around(start, (x, y), moves.zone, limits, via)
            except detour.NoDetour:
                continue
            moves.go_beside(detour.Position(x, y, None))
            return True
        return False

    # The parts of the way are commands, so that a macro may stand in for one.
    def _visit_dock(self, trip):
        go = self._go
        go(trip.way_in)
        # A macro's way in ends where the dock is entered from.
        self.is_brought = trip.way_in in self.settings.macros
        try:
            go("MOVE_TO_DOCK_PROBE")
        finally:
            self.is_brought = False
        leave = functools.partial(go, trip.way_out)
        with running.always(self.host, leave, "leaving the dock"):
            self.run(trip.gcode)

    def _go(self, part):
        with self._in_absolute():
            self.host.gcode.run_script_from_command(part)
