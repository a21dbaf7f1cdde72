# What happens around the commands that probe.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import attached as carrying
from .. import pin as z_pin
from .. import touch as touching
from .holder import Holder
from .homing import ZHoming
from .sensors import ATTACHED
from .settings import LOWEST_NOZZLE, REACH, travel_height

# Lower than any axis gets (mm)
NO_FLOOR = -1e6


# The device behind virtual_probe.Facade: fetches the probe before the first
# touch of a command, sees that it is there around each, and docks it at the
# end.
class Prober:
    # 'docking': docking.Docking
    def __init__(self, docking, settings):
        self.host = docking.host
        self.docking = docking
        self.settings = settings
        self.moves = docking.moves
        self.sensors = docking.sensors
        self.homing = ZHoming(self.moves, settings)
        auto = settings.auto_attach_detach
        self.holder = Holder(self.host, self._dock_and_return_here, auto)
        # Toolhead Z at which the probe is just off what it has touched
        self.clear_z = 0.0
        # Whether the host asks at each place how deep a touch may go
        self.is_asked_there = True

    def use(self, settings):
        self.settings = settings
        self.homing.use(settings)

    ######################################################################
    # How deep a touch may go
    ######################################################################

    # Lowest toolhead Z of a probing move
    def floor(self, is_homing=False):
        axis = self.host.axes.z_axis
        position_min = axis.position_min if axis else NO_FLOOR
        return max(position_min, NO_FLOOR if is_homing else self._lowest())

    # Lowest toolhead Z for a host that asks once, before anything moves.  'is_raised':
    # it has each target raised, see raised().
    def floor_everywhere(self, is_raised):
        self.is_asked_there = is_raised
        if not is_raised:
            return self.floor()
        axis = self.host.axes.z_axis
        return max(
            axis.position_min if axis else NO_FLOOR, self.settings.lowest
        )

    # A target (toolhead Z) as high as it has to be where the head stands now
    def raised(self, z):
        is_over_pin = z_pin.is_over_pin(self.host, self.settings.z_pin)
        return max(z, self.settings.over_pin) if is_over_pin else z

    # The lowest useful one
    def _lowest(self):
        if not self.is_asked_there:
            return self.settings.over_pin
        return self.raised(self.settings.lowest)

    # See homing.ZHoming
    def homing_reach(self):
        return self.homing.reach()

    ######################################################################
    # What virtual_probe tells
    ######################################################################

    # A command that probes begins
    def begin(self, is_homing):
        self.docking.check_idle()
        self.holder.delay.cancel()
        self.homing.begin(is_homing)
        self.clear_z = 0.0
        if is_homing:
            self.moves.clear.forget()
        self.moves.stay(False)
        goal = self.homing.goal(self.moves.position())
        is_over_dock = self.moves.is_in_dock(goal)
        if is_over_dock and (is_homing or self.moves.stands_in_dock()):
            raise self.host.error(
                "the head stands in the dock (X=%.3f Y=%.3f), where nothing can"
                " be touched; move it away first, as MOVE_TO_APPROACH_PROBE"
                " does" % goal[:2]
            )
        is_left = not is_homing and self.moves.is_at_detach()
        if is_over_dock or is_left:
            # Nobody wants to touch there, and from there the host would go on
            # straight across the dock.
            goal = None
        # Nobody knows how high the head is, so the way down has no end.
        is_only_stop = is_homing and self.homing.reach() is None
        if not self.holder.auto:
            self._require_attached()
        elif self.docking.fetch(goal, is_only_stop):
            # Somebody has put it into its dock.
            self.holder.lose()
        if is_only_stop:
            self.docking.check_switch()
        if goal is None:
            if self.moves.is_at_detach():
                # It was on the head already.
                self.moves.go_beside(self.settings.extract_position)
            self.moves.leave_top()
            self.moves.stay(True)
        elif not self.moves.is_at(goal):
            self.moves.go_back(goal, self.moves.clear.lowest(self.settings))

    def _require_attached(self):
        state = self.sensors.confirm()
        if not state == self.sensors.proven == ATTACHED:
            self.sensors.distrust()
            raise self.host.error(
                "the probe is %s at z=%.3f (%s); auto_attach_detach is off, so"
                " it is not fetched by itself; run ATTACH_PROBE"
                % (state, self.host.motion.z(), self.sensors.describe())
            )

    # A probing move begins.  'pin' tells by itself whether the probe is there:
    # where it is lost, the move ends where it began.
    def before_move(self):
        if self.moves.stays():
            raise self.host.error(
                "the head stands beside the dock; move it to where it is to touch"
            )
        if not self.sensors.is_sensed():
            raise self._lost("is not ready")
        if self.sensors.proven != ATTACHED:
            raise self._lost("was not seen to be fetched")
        self._run_each_touch("activate_gcode")

    # A probing move has ended: whether the head has moved, and the probe
    # triggered
    def after_move(self, moved, triggered):
        self.clear_z = self.host.motion.z() + self.settings.sample_retract_dist
        self._run_each_touch("deactivate_gcode")
        if not self.sensors.is_sensed():
            raise self._lost("was lost in a touch")
        if not moved:
            raise self._lost("triggered before the head moved")
        # Homing sets Z to anything meanwhile
        if triggered and self.homing.way is None:
            self.moves.clear.note(self.clear_z)
        if self.homing.way is None:
            if not triggered and self._is_at_floor():
                self._tell_nothing_found()
        elif triggered:
            self.homing.met_bed()
        else:
            self._end_homing_of_nothing()

    # The command has probed, or failed
    def end(self):
        was_homing = self.homing.end()
        if not self.moves.is_homed("xy") or self.host.printer.is_shutdown():
            return
        goal = self.moves.position()
        if goal.z is not None:
            # The bed may lie higher than Z=0, and homing has set Z anew.
            height = travel_height(self.settings)
            clear_z = self.clear_z
            if was_homing:
                clear_z = goal.z + self.settings.sample_retract_dist
            if was_homing or self._is_at_floor():
                # Not back down to where nothing was found
                goal = goal._replace(z=height)
            self.moves.lift(max(height, clear_z))
        if self.sensors.look() != ATTACHED:
            raise self._lost("was lost, what was measured is wrong")
        if self.holder.delay.is_forbidden:
            # Whoever holds it, and wherever its owner wants the head: the paper is
            # put where the probe was.
            self.holder.hold(False)
            self.docking.dock(goal)
        elif self.holder.lets_go():
            self._dock_after_use(goal)

    def _run_each_touch(self, name):
        if self.settings.deactivate_on_each_sample:
            self.docking.run_still(name)

    ######################################################################
    # What goes wrong
    ######################################################################

    def _is_at_floor(self):
        return touching.is_at(self.host, self._lowest())

    def _tell_nothing_found(self):
        lowest = self._lowest()
        is_bed = self.host.axes.homes_with_probe() or lowest <= LOWEST_NOZZLE
        what = "bed" if is_bed else "pin that Z is homed on"
        self.host.say(
            "nothing down to z=%.3f, where the nozzle is just clear of the %s;"
            " check z_offset and the probe, then home Z again and level"
            % (lowest, what)
        )

    # The host turns the motors off then, so the head goes up before it does.
    def _end_homing_of_nothing(self):
        self.sensors.distrust()
        distance = self.settings.sample_retract_dist + REACH
        self.host.motion.lift_unhomed(distance, self.settings.lift_speed)
        self.host.say(
            "nothing where the bed was: the probe will be docked and fetched to"
            " see that it works, and then finds any bed; look whether its"
            " switch clicks, then home again"
        )

    def _lost(self, what):
        self.sensors.distrust()
        return self.host.error(
            "the probe %s, at z=%.3f (%s); raise the head and put the probe"
            " into its dock, then check it with"
            " GET_PROBE_STATUS"
            % (what, self.host.motion.z(), self.sensors.describe())
        )

    ######################################################################
    # Docking it at the end
    ######################################################################

    # Back to 'goal', unless the owner wants the head to stay beside the dock;
    # returns whether the probe was not there yet
    def dock_and_return(self, goal):
        goal = goal if self.settings.restore_toolhead else None
        return self.docking.dock(goal)

    # For somebody who goes down next, where the head stands now: there it is
    # again, whatever the owner wants of the commands.
    def dock_and_come_back(self):
        self.holder.hold(False)
        self.docking.dock(self.moves.position())

    def _dock_and_return_here(self):
        self.dock_and_return(self.moves.position())

    # Where a person is asked meanwhile, nothing may drive off later.
    def _dock_after_use(self, goal):
        is_asking = carrying.of(self.host.printer).is_asking(self.host)
        # The first layer may come at once.
        may_wait = not (is_asking or self.host.print_state())
        if self.settings.allow_delayed_detach and may_wait:
            self.holder.delay.start()
        else:
            self.dock_and_return(goal)
