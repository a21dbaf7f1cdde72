"""The probe as the host touches with it: what happens around the commands that probe.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Optional

from .. import attached, touch
from ..attached import ATTACHED
from ..pin import is_over_pin
from .homing import ZHoming
from .keeping import Keeping
from .settings import LOWEST_NOZZLE, REACH

if TYPE_CHECKING:
    from .dock import Dock
    from .path import Position
    from .settings import Settings

# Lower than any axis gets (mm)
NO_FLOOR = -1e6


class DockedProbe:
    """The Device behind host/own_probe.py.

    It fetches the probe before the first touch of a command, sees that it is there around
    each, and docks it at the end.  What moves may pause.
    """

    def __init__(self, dock: Dock, settings: Settings):
        self.host = dock.host
        self.dock = dock
        self.settings = settings
        self.moves = dock.moves
        self.sensors = dock.sensors
        self.known = dock.known
        self.height = dock.moves.height
        self.homing = ZHoming(self.height, settings)
        auto = settings.auto_attach_detach
        self.keeping = Keeping(self.host, auto, self.dock_and_return)
        # Toolhead Z at which the probe is just off what it has touched
        self.clear_z = 0.0
        # Whether the host asks at each place how deep a touch may go
        self.is_asked_there = True
        # Where the toolhead was left beside the dock, from where a command goes on
        self.stayed_at: Optional[Position] = None

    ######################################################################
    # How deep a touch may go: toolhead Z (mm)
    ######################################################################

    def floor(self, is_homing: bool = False) -> float:
        """Return the lowest end of a probing move."""
        return max(
            self._position_min(), NO_FLOOR if is_homing else self._lowest()
        )

    def _position_min(self) -> float:
        axis = self.host.axes.z_axis
        return axis.position_min if axis else NO_FLOOR

    def floor_everywhere(self, is_raised: bool) -> float:
        """Return the same for a host that asks once, before anything moves.

        'is_raised': it has each target raised, see raised().
        """
        self.is_asked_there = is_raised
        if not is_raised:
            return self.floor()
        return max(self._position_min(), self.settings.lowest)

    def raised(self, z: float) -> float:
        """Return a target as high as it has to be where the toolhead stands now."""
        is_over = is_over_pin(self.host, self.settings.z_pin)
        return max(z, self.settings.over_pin) if is_over else z

    def _lowest(self) -> float:
        """Return the lowest useful one."""
        if not self.is_asked_there:
            return self.settings.over_pin
        return self.raised(self.settings.lowest)

    def homing_reach(self) -> Optional[float]:
        """Return how far (mm) below z_offset a homing move may go; see ZHoming.reach()."""
        return self.homing.reach()

    ######################################################################
    # A command that probes
    ######################################################################

    def begin(self, is_homing: bool) -> None:
        """Attach the probe, the toolhead then where the command goes on."""
        self.dock.check_idle()
        self.check_may_fetch()
        self.keeping.cancel()
        self.homing.begin(is_homing)
        self.clear_z = 0.0
        if is_homing:
            self.height.clear_z = 0.0
        self.stayed_at = None
        goal = self._goal(is_homing)
        # Nothing tells how high the toolhead is, so the way down has no end
        is_only_stop = is_homing and self.homing.reach() is None
        if not self.keeping.auto:
            self._require_attached()
        elif self.dock.fetch(goal, is_only_stop):
            # Somebody has put it into its dock
            self.keeping.lose()
        if is_only_stop:
            self.dock.check_switch()
        if goal is None:
            self._stay_beside()
        elif not self.moves.is_at(goal):
            self.moves.go_back(goal, self.height.lowest(self.settings))

    def check_may_fetch(self) -> None:
        """Raise the host's error where commands fetch the probe, and must not now."""
        if self.keeping.auto:
            self.dock.check_no_print()

    def _goal(self, is_homing: bool) -> Optional[Position]:
        """Return where the command goes on; None: beside the dock.

        Nothing is to be touched at the dock, and from there the host would go on straight
        across it.
        """
        moves = self.moves
        goal = self.homing.goal(moves.position())
        is_over_dock = moves.is_in_dock(goal)
        if is_over_dock and (is_homing or moves.stands_in_dock()):
            raise self.host.error(
                f"the toolhead stands in the dock (X={goal.x:.3f} Y={goal.y:.3f}),"
                " where nothing can be touched; move it away first, as"
                " MOVE_TO_APPROACH_PROBE does"
            )
        is_left = not is_homing and moves.is_at_detach()
        return None if is_over_dock or is_left else goal

    def _stay_beside(self) -> None:
        """Leave the toolhead beside the dock, where the command goes on from."""
        moves = self.moves
        if moves.is_at_detach():
            # It was attached already
            moves.go_beside(self.settings.extract_position)
        moves.leave_top()
        if not moves.is_at_detach():
            self.stayed_at = moves.position()

    def _require_attached(self) -> None:
        state = self.sensors.confirm()
        if not state == self.known.proven == ATTACHED:
            self.known.distrust()
            raise self.host.error(
                f"the probe is {state} at z={self.host.motion.z():.3f}"
                f" ({self.sensors.describe()}); auto_attach_detach is off, so it is"
                " not fetched by itself; run ATTACH_PROBE"
            )

    def before_move(self) -> None:
        """Look whether a probing move may begin.

        'pin' tells by itself whether the probe is there: where it is lost, the move ends where
        it began.
        """
        if self.stayed_at is not None and self.moves.is_at(self.stayed_at):
            raise self.host.error(
                "the toolhead stands beside the dock; move it to where it is to touch"
            )
        if not self.sensors.is_sensed():
            raise self._lost("is not ready")
        if self.known.proven != ATTACHED:
            raise self._lost("was not seen to be fetched")
        self._run_each_touch("activate_gcode")

    def after_move(self, moved: bool, triggered: bool) -> None:
        """Look at the probe after a probing move."""
        self.clear_z = self.host.motion.z() + self.settings.sample_retract_dist
        self._run_each_touch("deactivate_gcode")
        if not self.sensors.is_sensed():
            raise self._lost("was lost in a touch")
        if not moved:
            raise self._lost("triggered before the toolhead moved")
        if self.homing.way is not None:
            # Homing sets Z to anything meanwhile
            if triggered:
                self.homing.met_bed()
            else:
                self._end_homing_of_nothing()
        elif triggered:
            self.height.note_clear(self.clear_z)
        elif self._is_at_floor():
            self._tell_nothing_found()

    def end(self) -> None:
        """Lift the probe off, and dock it; the command has probed, or failed."""
        was_homing = self.homing.end()
        if not self.host.is_homed("xy") or self.host.printer.is_shutdown():
            return
        goal = self.moves.position()
        if goal.z is not None:
            # The bed may lie higher than Z=0, and homing has set Z anew
            height = self.settings.travel_z
            clear_z = self.clear_z
            if was_homing:
                clear_z = goal.z + self.settings.sample_retract_dist
            if was_homing or self._is_at_floor():
                # Not back down to where nothing was found
                goal = goal._replace(z=height)
            self.moves.lift(max(height, clear_z))
        if self.sensors.look() != ATTACHED:
            raise self._lost("was lost, what was measured is wrong")
        if self.keeping.at_once:
            # Whatever holds it, and wherever the toolhead is wanted: the paper is put where
            # the probe was
            self.keeping.hold(False)
            self.dock.dock(goal)
        elif self.keeping.lets_go():
            self._dock_after_use(goal)

    def _run_each_touch(self, option: str) -> None:
        if self.settings.deactivate_on_each_sample:
            self.dock.run_still(option)

    def _dock_after_use(self, goal: Position) -> None:
        """Dock the probe, or in a while.

        Where a person is asked meanwhile, nothing may drive off later, and in a print the
        first layer may come at once.
        """
        is_asking = attached.of(self.host.printer).is_asking(self.host)
        may_wait = not (is_asking or self.host.print_state())
        if self.settings.allow_delayed_detach and may_wait:
            self.keeping.start()
        else:
            self.dock_and_return(goal)

    ######################################################################
    # What goes wrong
    ######################################################################

    def _is_at_floor(self) -> bool:
        return touch.is_at(self.host, self._lowest())

    def _tell_nothing_found(self) -> None:
        lowest = self._lowest()
        is_bed = self.host.axes.homes_with_probe() or lowest <= LOWEST_NOZZLE
        what = "bed" if is_bed else "pin that Z is homed on"
        self.host.say(
            f"nothing down to z={lowest:.3f}, where the nozzle is just clear of the"
            f" {what}; check z_offset and the probe, then home Z again and level"
        )

    def _end_homing_of_nothing(self) -> None:
        """Lift: the host turns the motors off then."""
        self.known.distrust()
        distance = self.settings.sample_retract_dist + REACH
        self.host.motion.lift_unhomed(distance, self.settings.lift_speed)
        self.host.say(
            "nothing where the bed was: the probe will be docked and fetched to"
            " see that it works, and then finds any bed; look whether its"
            " switch clicks, then home again"
        )

    def _lost(self, what: str) -> Exception:
        self.known.distrust()
        return self.host.error(
            f"the probe {what}, at z={self.host.motion.z():.3f}"
            f" ({self.sensors.describe()}); raise the toolhead and put the probe into its"
            " dock, then check it with GET_PROBE_STATUS"
        )

    ######################################################################
    # Docking it
    ######################################################################

    def dock_and_return(self, goal: Optional[Position] = None) -> bool:
        """Dock the probe, and go back to 'goal', or to where the toolhead is.

        Unless the user wants it to stay beside the dock.  Returns whether it was elsewhere.
        """
        goal = goal or self.moves.position()
        return self.dock.dock(goal if self.settings.restore_toolhead else None)

    def dock_and_come_back(self) -> None:
        """Dock the probe, the toolhead then just where it was: something goes down next."""
        self.keeping.hold(False)
        self.dock.dock(self.moves.position())
