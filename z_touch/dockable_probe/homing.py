# Homing, with the probe and without it.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .sensors import DOCKED
from .settings import travel_height

# Homing goes down twice: to find the bed, and slowly again from a little above.
FIRST, SECOND = "first", "second"

# The second way down of homing ends so far (mm) below the first trigger.
SECOND_REACH = 1.0


# How Z is homed with the probe: where, and how far down
class ZHoming:
    # 'moves': moves.Moves
    def __init__(self, moves, settings):
        self.moves = moves
        self.use(settings)
        # See home_over()
        self.xy = None
        # The way down that comes next, None where nobody homes
        self.way = None

    def use(self, settings):
        self.settings = settings

    # Where the head stands meanwhile, as klippy finds when it connects: (x, y);
    # None: where it is then
    def home_over(self, xy):
        self.xy = xy

    # A command that probes begins
    def begin(self, is_homing):
        self.way = FIRST if is_homing else None

    # It has ended; returns whether it was homing
    def end(self):
        was_homing, self.way = self.way is not None, None
        return was_homing

    # Where the head is to be for it
    def goal(self, position):
        if self.way is None or self.xy is None:
            return position
        return position._replace(x=self.xy[0], y=self.xy[1])

    # How far (mm) below z_offset the way down may go that begins now: at first as
    # deep as any touch, then hardly deeper than the first one.  It is counted by the
    # motors, as homing and others say of Z what they like.  None: nobody knows how
    # high the head is.
    def reach(self):
        motors_z, homed_z = self.moves.motors_z(), self.moves.homed_z
        if motors_z is None or homed_z is None:
            return None
        beyond = SECOND_REACH
        if self.way == FIRST:
            beyond = self.settings.z_offset - self.settings.lowest
        return motors_z - homed_z + beyond

    # Touches elsewhere tell nothing of how high the bed is: there it may be much
    # higher, or the gantry lower.
    def met_bed(self):
        self.moves.note_bed()
        self.way = SECOND


# What is done about the probe before axes are homed that do not need it
class BeforeHoming:
    # 'prober': prober.Prober; 'homes_z': whether Z is homed with the probe;
    # 'is_lifted_elsewhere': the owner lifts the head before X and Y are homed.
    def __init__(self, prober, homes_z, is_lifted_elsewhere):
        self.host = prober.host
        self.prober = prober
        self.homes_z = homes_z
        self.is_lifted_elsewhere = is_lifted_elsewhere
        register = self.host.printer.register_event_handler
        register("homing:home_rails_begin", self._before_xy)
        register("homing:home_rails_begin", self._before_z)

    # Whether the probe is docked before Z is homed
    def docks_before_z(self):
        wanted = self.prober.settings.detach_dockable_before_z_home
        return not self.homes_z() if wanted is None else wanted

    def _may_be_on_head(self, state):
        return state != DOCKED or self.prober.sensors.is_doubtful()

    # What hangs on the head may be lower than the bed when X and Y are homed, and
    # nobody knows that yet.
    def _before_xy(self, homing_state, rails):
        if self.is_lifted_elsewhere:
            return
        if self.host.axes.homed_axis(rails) is None:
            return
        if self._may_be_on_head(self.prober.sensors.confirm()):
            self.prober.moves.lift(travel_height(self.prober.settings))

    # Where Z is homed without the probe, that may be in the way.
    def _before_z(self, homing_state, rails):
        is_z = 2 in homing_state.get_axes()
        if not self.docks_before_z() or not is_z or self.homes_z():
            return
        # Without X and Y it cannot be docked, which is said where it is not.
        is_on_head = self._may_be_on_head(self.prober.sensors.look())
        if self.prober.moves.is_homed("xy") or is_on_head:
            self.prober.dock_and_come_back()
