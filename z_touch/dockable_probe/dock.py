"""Trips to the dock: fetching the probe, and docking it.

           in                    in the dock      out

  fetch    MOVE_TO_APPROACH_...  attach_gcode     MOVE_TO_EXTRACT_PROBE
  dock     MOVE_TO_INSERT_...    detach_gcode     MOVE_TO_DETACH_PROBE

pre_..._gcode runs before a trip, post_..._gcode after it, beside the dock, also where the
trip has failed: a servo puts the dock away then.  A trip that has not brought about what it
should is tried dock_retries times again.  activate_gcode runs before the probe is fetched,
deactivate_gcode when it was docked and the toolhead is back.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Iterator, NamedTuple, Optional, Sequence

from .. import templates
from ..attached import ATTACHED, DOCKED, UNKNOWN
from ..command import always, check_no_print
from ..errors import CalibrationError
from . import path
from .moves import Moves
from .settings import APPROACH, DETACH, ENTER, EXTRACT, HIGHER, INSERT

if TYPE_CHECKING:
    from ..host.printer import Host
    from .height import Height
    from .known import Known
    from .path import Position
    from .sensors import Sensors
    from .settings import Settings

# A contradiction of pins is believed when it still is there so long (s) after.
ASK_AGAIN = 0.5

# How a person says where it is
IF_DOCKED = "run SET_PROBE_STATUS STATE=DOCKED where you see it in the dock"


class Trip(NamedTuple):
    """What takes the probe from one state into another one.

    way_in, way_out are parts of it; gcode is the option of what runs in the dock; done is
    what has become of the probe, remedy what to look at where it has not.
    """

    before: str
    after: str
    way_in: str
    way_out: str
    gcode: str
    done: str
    remedy: str


FETCH = Trip(
    before=DOCKED,
    after=ATTACHED,
    way_in=APPROACH,
    way_out=EXTRACT,
    gcode="attach_gcode",
    done="fetched",
    remedy="in the dock it has to meet the toolhead at dock_position; look where it"
    " is, and check the pins with GET_PROBE_STATUS: where it hangs on the toolhead, a"
    " wire is broken, so take it off before you home, and " + IF_DOCKED,
)
DOCK = Trip(
    before=ATTACHED,
    after=DOCKED,
    way_in=INSERT,
    way_out=DETACH,
    gcode="detach_gcode",
    done="docked",
    remedy="the dock has to hold it back on the way to detach_position; look"
    " whether it came off: if it did, what reads ATTACHED never changes, so check"
    " pins and wires with GET_PROBE_STATUS and QUERY_PROBE, and if not,"
    " dock_position and detach_position",
)


@dataclass
class Underway:
    """What the user's G-code may be a part of.

    option is the one whose G-code runs, None: none does; trip is the one that is made, None:
    none is; is_brought says whether a macro has brought the toolhead to where the dock is
    entered from.
    """

    option: Optional[str] = None
    trip: Optional[Trip] = None
    is_brought: bool = False

    def is_any(self) -> bool:
        """Return whether G-code of the user may be running."""
        return self.trip is not None or self.option is not None


class Dock:
    """Fetches the probe and docks it, and sees that it did.  All that moves may pause."""

    def __init__(
        self,
        host: Host,
        settings: Settings,
        sensors: Sensors,
        known: Known,
        height: Height,
        underway: Underway,
    ):
        self.host = host
        self.settings = settings
        self.sensors = sensors
        self.known = known
        self.moves = Moves(host, settings, height)
        self.underway = underway
        # What the pins read before a way into the dock by itself, and whether it might have
        # been on the toolhead nevertheless
        self.seen_before, self.might_be_on = UNKNOWN, True

    def at_other_place(self, settings: Settings) -> Dock:
        """Return the same dock at another place, as it is tried before it is saved."""
        height, underway = self.moves.height, self.underway
        return Dock(
            self.host, settings, self.sensors, self.known, height, underway
        )

    ######################################################################
    # Fetching and docking
    ######################################################################

    def fetch(
        self, goal: Optional[Position] = None, is_only_stop: bool = False
    ) -> bool:
        """Attach the probe, and go back to 'goal' where there is one.

        The pins have changed on the way out of the dock, then.  Returns whether it was in the
        dock.  'is_only_stop': nothing else will end the way down that comes next.
        """
        self.check_idle()
        sensors, known = self.sensors, self.known
        state = sensors.confirm()
        if state == known.proven == ATTACHED:
            return False
        self._require_way(state)
        self.moves.lift_for_dock(on_the_way=True)
        if not state == known.proven == DOCKED:
            # Where the probe was pressed it looked as if it were not there
            state = sensors.look()
        if not state == known.proven == ATTACHED:
            self._fetch_from(state, goal, is_only_stop)
        if goal is not None:
            self._go_back_attached(goal)
        return state == DOCKED

    def _go_back_attached(self, goal: Position) -> None:
        self.moves.go_back(goal, self.moves.height.lowest(self.settings))

    def _fetch_from(
        self, state: str, goal: Optional[Position], is_only_stop: bool
    ) -> None:
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

    def check_no_print(self) -> None:
        """Raise the host's error where a print goes on from here: the probe must not be fetched.

        It would be on the toolhead when the print goes on.  A macro that has to dock it may
        do so, also where it is fetched to see that it is there.
        """
        try:
            check_no_print(self.host)
        except CalibrationError as e:
            raise self.host.error(e)

    def check_switch(self) -> None:
        """Raise the host's error where 'pin' may be broken, before it alone ends a way down."""
        if self.sensors.is_pin_asked and not self.sensors.is_switch_seen:
            raise self.host.error(
                "'pin' reads open without the probe, as a broken wire does, and"
                " nothing else would stop the nozzle; look at the switch and its"
                " wires, or set check_open_attach: False if it is normally open"
            )

    def dock(
        self, goal: Optional[Position] = None, may_fetch: bool = True
    ) -> bool:
        """Put the probe into the dock, and go back to 'goal' where there is one.

        Returns whether it was anywhere else.  'may_fetch': to see that it is there.
        """
        self.check_idle()
        sensors, z = self.sensors, self.moves.position().z
        state = sensors.confirm()
        is_certain = self.known.proven == DOCKED or sensors.senses
        if state == DOCKED and not is_certain and z is not None:
            # Perhaps it is attached, and pressed.  Where Z is not homed the toolhead would
            # go up at each look.
            self.moves.lift(self.settings.travel_z)
            state = sensors.look()
        if state == DOCKED and sensors.is_doubtful() and may_fetch:
            self._check_can_fetch()
            self.host.say(
                "it reads docked, and was not seen to be docked; fetching it, to"
                " see that it is there, and docking it"
            )
            self.fetch()
            state = ATTACHED
        if state == DOCKED:
            self.moves.go_to_height(z)
            return False
        self._require_way(state)
        self.moves.lift_for_dock(on_the_way=True)
        self._make(DOCK, state, goal)
        if goal is not None:
            self.moves.go_back(goal, 0.0)
        self._deactivate_or_lift()
        return True

    def _deactivate_or_lift(self) -> None:
        """Run deactivate_gcode; where that fails near the bed, the toolhead goes up again."""
        is_done = False

        def lift() -> None:
            """Lift the toolhead unless deactivate_gcode has ended well."""
            if not is_done:
                self.moves.lift_for_dock()

        with always(self.host, lift, "lifting the toolhead"):
            self.deactivate()
            is_done = True

    def _check_can_fetch(self) -> None:
        """Raise the host's error where it cannot be fetched to see that it is there."""
        if not self.moves.is_way_known():
            raise self.host.error(
                f"the probe reads DOCKED ({self.sensors.describe()}), and it was"
                " not seen docked: it may be on the toolhead, its wire broken; if so,"
                f" take it off before you home, and {IF_DOCKED}"
            )

    def _require_way(self, state: str) -> None:
        """Raise the host's error where the axes are not homed that lead to the dock.

        To home Z on its switch with the probe attached would press it into the bed.
        """
        settings, is_homed = self.settings, self.host.is_homed
        needs_z = not settings.dock_fixed_z or settings.strip_z is not None
        is_z_missing = needs_z and not is_homed("z")
        if state != DOCKED and is_z_missing and is_homed("xy"):
            raise self.host.error(
                f"the probe is {state} ({self.sensors.describe()}), and to find the"
                " dock Z has to be homed; take the probe off by hand and put it"
                " into the dock, then SET_PROBE_STATUS STATE=DOCKED and G28"
            )
        self.moves.require_homed()

    ######################################################################
    # G-code of the user
    ######################################################################

    def run(self, option: str) -> None:
        """Run the G-code of an option, where it is given."""
        template = getattr(self.settings, option)
        if template is None:
            return
        outer, self.underway.option = self.underway.option, option
        try:
            with self._checking_commands(option):
                template.run_gcode_from_command()
        finally:
            self.underway.option = outer

    @contextlib.contextmanager
    def _checking_commands(self, name: str) -> Iterator[None]:
        """Begin with absolute coordinates; raise the host's error, which says where it was.

        An unknown command is an error, too.
        """
        try:
            with self._in_absolute(), templates.checking_commands(
                self.host, name
            ):
                yield
        except CalibrationError as e:
            raise self.host.error(e)
        except self.host.printer.command_error as e:
            if self.host.printer.is_shutdown():
                raise
            raise self.host.error(f"{name}: {e}")

    @contextlib.contextmanager
    def _in_absolute(self) -> Iterator[None]:
        """Have G-code begin with absolute coordinates.

        A trip may begin in the middle of any G-code, which goes on with the modes and the
        speed of before.
        """
        gcode_state = self.host.gcode_state
        modes = gcode_state.modes()
        gcode_state.set_modes(modes._replace(absolute=True))
        try:
            yield
        finally:
            gcode_state.set_modes(modes)

    def run_still(self, option: str) -> None:
        """Run G-code that must not move the toolhead."""
        before = self.host.toolhead.get_position()[:3]
        self.run(option)
        if self.host.toolhead.get_position()[:3] != before:
            raise self.host.error(
                f"the toolhead moved in {option}; move it in another option"
            )

    def activate(self) -> None:
        """Say that the probe is about to be used; see deactivate_on_each_sample."""
        if not self.settings.deactivate_on_each_sample:
            self.run_still("activate_gcode")

    def deactivate(self) -> None:
        """Say that the probe was used."""
        if not self.settings.deactivate_on_each_sample:
            self.run_still("deactivate_gcode")

    def check_idle(self) -> None:
        """Raise the host's error in G-code that is a part of fetching or docking.

        Fetching it for what runs in the middle of fetching it would never end.
        """
        option = self.underway.option
        if option is None and self.underway.trip is not None:
            option = "a macro over a part of the way"
        if option is not None:
            raise self.host.error(
                f"a command in {option} needs the probe fetched or docked, which that"
                " is a part of; remove the command there"
            )

    ######################################################################
    # A trip
    ######################################################################

    def _make(self, trip: Trip, state: str, goal: Optional[Position]) -> None:
        """Make a trip with the G-code around it; 'state' is what was seen just before."""
        self.known.trip_begins()
        waits = getattr(self.settings, f"post_{trip.gcode}") is not None
        with self._dock_out(trip):
            self._try(trip, state, None if waits else goal)
        self.known.trip_ended(trip.after)

    @contextlib.contextmanager
    def _dock_out(self, trip: Trip) -> Iterator[None]:
        """Bring the dock out, and put it away afterwards where the toolhead is not in it."""

        def put_away() -> None:
            """Put the dock away, unless the toolhead stands in it."""
            # A toolhead that was not brought out of the dock still is in it
            if not self.moves.stands_in_dock():
                self.run(f"post_{trip.gcode}")

        self.underway.trip = trip
        try:
            with always(self.host, put_away, "putting the dock away"):
                self._make_room(trip)
                self.run(f"pre_{trip.gcode}")
                yield
        finally:
            self.underway.trip = None

    def _make_room(self, trip: Trip) -> None:
        """Move aside: while the dock is away a toolhead may stand where it comes out."""
        moves, settings = self.moves, self.settings
        comes_out = getattr(settings, f"pre_{trip.gcode}") is not None
        is_near = path.is_inside(moves.position(), moves.zone)
        if comes_out and is_near and not moves.stands_in_dock():
            moves.go_beside(self._beside(trip))

    def _beside(self, trip: Trip) -> Position:
        """Return where a trip goes into the dock from."""
        if trip is FETCH:
            return self.settings.approach_position
        return self.settings.insert_position

    def _try(self, trip: Trip, state: str, goal: Optional[Position]) -> None:
        """Go into the dock until the probe is where the trip should bring it.

        'goal': the way back there is queued at once, and need not wait for what the pins
        read.  Raises the host's error, with the toolhead lifted, when no retry is left.
        """
        look, retries = self.sensors.look, self.settings.dock_retries
        seen = ""
        for attempt in range(retries + 1):
            if state == UNKNOWN:
                self.host.toolhead.dwell(ASK_AGAIN)
                state = look()
            if state == trip.before:
                self._visit(trip)
                out = self.host.after_moves()
                if goal is not None:
                    self.moves.go_back(goal)
                state = self.sensors.look_at(out)
                # What chatters while the toolhead moves is asked when it stands
                state = state if state == trip.after else look()
            if state == trip.after:
                return
            seen = (
                f"the probe was not {trip.done}, it is {state}"
                f" ({self.sensors.describe()})"
            )
            if attempt < retries:
                self.host.say(f"{seen}; try {attempt + 2} of {retries + 1}")
                state = look()
        self.moves.lift_for_dock()
        raise self.host.error(f"{seen}; {trip.remedy}")

    def _visit(self, trip: Trip) -> None:
        """Go into the dock, and out of it as the trip does."""
        self._part(trip.way_in)
        # A macro's way in ends where the dock is entered from
        self.underway.is_brought = trip.way_in in self.settings.macros
        try:
            self._part(ENTER)
        finally:
            self.underway.is_brought = False
        with always(
            self.host, lambda: self._part(trip.way_out), "leaving the dock"
        ):
            self.run(trip.gcode)

    ######################################################################
    # Parts of a trip, which are commands, too
    ######################################################################

    def _part(self, name: str) -> None:
        """Go a part of a trip; a macro of that name stands in for it."""
        if name in self.settings.macros:
            with self._checking_commands(name):
                self.host.gcode.run_script_from_command(name)
        elif name == APPROACH:
            self.approach()
        elif name == INSERT:
            self.insert()
        elif name == ENTER:
            self.enter()
        elif name == EXTRACT:
            self.extract()
        else:
            self.detach()

    def approach(self) -> None:
        """Move to approach_position."""
        self.moves.go_beside(self.settings.approach_position)

    def insert(self) -> None:
        """Move to insert_position."""
        self.moves.go_beside(self.settings.insert_position)

    def enter(self) -> None:
        """Move into the dock, straight from a position outside.

        By itself from where the toolhead stands, where that is before the dock already, or by
        what is attached; then the dock was not brought out yet.
        """
        moves, settings = self.moves, self.settings
        trip = self.underway.trip
        if trip is not None:
            is_brought = self.underway.is_brought
            moves.go_in(moves.position() if is_brought else self._beside(trip))
            return
        beside = settings.approach_position
        if not moves.is_at(beside) and (
            moves.is_at(settings.insert_position)
            or self.sensors.look() == ATTACHED
        ):
            beside = settings.insert_position
        if moves.stands_in_dock():
            moves.go_in(beside)
            return
        moves.require_homed()
        state = self.sensors.look()
        # It may be left in any way, also without our commands
        self.might_be_on = self.known.may_be_on
        self.known.trip_begins()
        self.seen_before = state
        with self._dock_out(DOCK if state == ATTACHED else FETCH):
            moves.go_in(beside)

    def extract(self) -> None:
        """Move out of the dock with the probe."""
        settings = self.settings
        self._go_out(FETCH, settings.extract_position, settings.attach_speed)

    def detach(self) -> None:
        """Move out of the dock without the probe."""
        settings = self.settings
        self._go_out(DOCK, settings.detach_position, settings.detach_speed)

    def _go_out(self, trip: Trip, position: Position, speed: float) -> None:
        """Move out of the dock as a trip ends; by itself the dock is put away, too."""
        is_on_trip = self.underway.trip is not None
        is_by_itself = self.moves.stands_in_dock() and not is_on_trip
        if is_by_itself:
            before, self.seen_before = self.seen_before, UNKNOWN
            self.known.trip_begins()
        if trip is DOCK:
            self._strip_off()
        self.moves.go_out(position, speed, is_on_trip)
        if not is_by_itself:
            return
        # A way in and out part by part proves as much as a trip, and one on which the
        # probe has stayed in the dock nothing else than what was known
        state = self.sensors.look()
        if (before, state) == (trip.before, trip.after):
            self.known.trip_ended(trip.after)
        elif before == state == trip.after == DOCKED:
            self.known.stayed_docked(self.might_be_on)
        self.run(f"post_{trip.gcode}")

    def _strip_off(self) -> None:
        """Go up or down in a dock that holds the probe back on that way.

        A probe that stays on goes no lower than it is clear of a bed, on which it would read
        as docked, and is not dragged out there.
        """
        moves, strip_z = self.moves, self.settings.strip_z
        z = moves.position().z
        if strip_z is None or z is None or not moves.stands_in_dock():
            return
        clear = self.settings.length + HIGHER
        moves.go_to_height(clear if strip_z < clear < z else strip_z)
        came_off = self.sensors.look() != ATTACHED
        moves.go_to_height(strip_z if came_off else z)

    ######################################################################
    # Around it, and away from it
    ######################################################################

    def around(self, goal: Position, speed: float) -> None:
        """Move around the dock to a place that anybody may have asked for.

        What was brought out for the way in is put away.
        """
        is_by_itself = (
            self.moves.stands_in_dock() and self.underway.trip is None
        )
        self.moves.travel_beside(goal, speed)
        if is_by_itself:
            trip = FETCH if self.sensors.look() == ATTACHED else DOCK
            self.run(f"post_{trip.gcode}")

    def leave(self, axes: Sequence[int] = ()) -> None:
        """Move to where what goes straight on from here does not begin across the dock.

        The toolhead stays where the way out is not known, or the way is part of a trip.
        'axes' are those that are homed next (0: X).
        """
        moves = self.moves
        if self.underway.trip is not None or not moves.is_way_known():
            return
        if moves.stands_in_dock():
            self.detach()
        if moves.is_near_dock() and moves.make_way_for_homing(axes):
            return
        if moves.is_at_detach():
            self.approach()
        # What goes on from straight above it goes down at first
        moves.leave_top()
