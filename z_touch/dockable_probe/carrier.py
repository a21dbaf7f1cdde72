# The probe of [dockable_probe] as others have to mind it, see core/carrying.py,
# and the host's commands that lower the nozzle while it may hang there.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import functools

from .. import attached as carrying
from .. import touch as touching
from ..attached import DOCKED, UNKNOWN
from ..errors import CalibrationError
from ..host.probe import TWIST
from . import detour
from .settings import travel_height

# Commands of the host after which a person lowers the nozzle with TESTZ, or onto
# a sheet of paper
BY_HAND = ("MANUAL_PROBE", "Z_ENDSTOP_CALIBRATE")
# After this one, too, straight at the first screw
SCREWS = "BED_SCREWS_ADJUST"
# Commands after which a person does so if they have METHOD=MANUAL
BY_METHOD = (
    "BED_MESH_CALIBRATE",
    "BED_TILT_CALIBRATE",
    "DELTA_CALIBRATE",
    "QUAD_GANTRY_LEVEL",
    "SCREWS_TILT_CALCULATE",
    "Z_TILT_ADJUST",
    # Of Kalico's [z_tilt_ng]
    "Z_TILT_AUTODETECT",
    "Z_TILT_CALIBRATE",
)
# These probe, and then ask for the paper; the second does so again at each ACCEPT,
# at points of its own.
PROBE_THEN_PAPER = {
    "PROBE_CALIBRATE": False,
    TWIST: True,
}
# After these nobody docks what was to be docked in a while.  RESTART has to be there
# when klippy is not ready, too, and nothing in its place would.
ENDS = ("M18", "M84", "SAVE_CONFIG")
# With these a print goes on where it has stopped, however high that is
GOES_ON = ("M24", "RESUME")
# What else probes, and what of ours says who holds the probe
PROBING = ("PROBE", "PROBE_ACCURACY")
HOLDING = ("ATTACH_PROBE", "SET_DOCKABLE_PROBE", "SET_PROBE_STATUS")


# Where our probe is, and its way onto the head and off it, as core.carrying asks
class Carrier:
    # 'prober': prober.Prober; 'is_by_paper': virtual_probe.VirtualProbe.is_by_paper
    def __init__(self, prober, is_by_paper):
        self.host = prober.host
        self.is_by_paper = is_by_paper
        self.prober = prober
        self.moves = prober.moves
        self.sensors = prober.sensors
        self.settings = prober.settings
        self.carrying = carrying.of(self.host.printer)
        self.carrying.join(self)
        # All sections have registered their commands then, and no macro has
        # taken the place of one.
        register = self.host.printer.register_event_handler
        register("klippy:mcu_identify", self._guard_commands)
        register("klippy:ready", self._guard_macros)

    ######################################################################
    # For whoever lowers the nozzle
    ######################################################################

    @property
    def auto(self):
        return self.prober.holder.auto

    # Docked by 'pin' alone may be on the head, and pressed: then the head is
    # lifted for a second look, and comes back where it is docked.
    def state(self):
        sensors, moves = self.sensors, self.moves
        state, z = sensors.look(), moves.position().z
        is_certain = sensors.proven == DOCKED or sensors.senses
        clear_z = travel_height(self.settings)
        if state != DOCKED or is_certain or z is None or z >= clear_z:
            return self._believed(state)
        moves.lift(clear_z)
        state = self._believed(sensors.look())
        if state == DOCKED:
            moves.go_to_height(z)
        return state

    # A probe that nobody has docked may hang there with a wire that is broken.
    def _believed(self, state):
        is_doubtful = state == DOCKED and self.sensors.is_doubtful()
        return UNKNOWN if is_doubtful else state

    def reads(self):
        return self.sensors.describe()

    def dock_and_come_back(self):
        self.prober.dock_and_come_back()

    def dock_pending(self):
        self.prober.holder.delay.hurry()

    # ATTACH_PROBE says so, also where the probe was on already; a delayed docking,
    # that it does not.
    def mark(self):
        return self.prober.holder.times_held

    def is_put_on(self, mark, was_docked):
        holder = self.prober.holder
        if holder.is_held:
            return was_docked or holder.times_held != mark
        is_free = holder.delay.mark is None
        return was_docked and is_free and self.state() != DOCKED

    def fetch(self):
        self.host.gcode.run_script_from_command("ATTACH_PROBE")

    # A place in the circle that the owner has chosen is reached straight where the
    # way comes no nearer to the dock than its ends do.
    def go_to(self, x, y, speed):
        start, goal = self.moves.position(), detour.Position(x, y, None)
        zone = self.moves.zone
        nearest = min(detour.distance(start, zone), detour.distance(goal, zone))
        least = detour.least_distance(start, goal, zone)
        if detour.is_inside(goal, zone) and least > nearest - detour.ROUNDING:
            touching.move_xy(self.host, x, y, speed)
        else:
            self.moves.travel(goal, speed, into=True)

    ######################################################################
    # Commands of the host
    ######################################################################

    def _guard_commands(self):
        wrap = self._guard
        wrap("G28", self._before_homing)
        for name in BY_HAND:
            wrap(name, self._before_paper)
        wrap(SCREWS, self._before_paper_elsewhere)
        for name in ENDS:
            wrap(name, self._before_end)
        for name in GOES_ON:
            wrap(name, self._before_going_on)
        for name in BY_METHOD:
            wrap(name, self._before_manual_method)
        for name, asks_again in PROBE_THEN_PAPER.items():
            wrap(name, functools.partial(self._around_paper, asks_again))
        for name in PROBING + HOLDING:
            wrap(name, self._as_it_is)

    # A macro of that name may go back to the print before it runs the command.
    def _guard_macros(self):
        for name in GOES_ON:
            self._guard(name, self._before_going_on)

    def _guard(self, name, around):
        def guarded(command, gcmd):
            self._end_asking_again()
            around(command, gcmd)

        self.host.wrap_command(name, guarded)

    # No host tells when a command that asks again has ended.  Between its points a
    # person is asked; the owner's G-code on the way to the dock is part of one.
    def _end_asking_again(self):
        if not (
            self.host.probing.is_manual_probing()
            or self.prober.docking.is_busy()
        ):
            self.prober.holder.delay.forbid(False)

    def _as_it_is(self, command, gcmd):
        command(gcmd)

    def _before_homing(self, command, gcmd):
        axes = [
            number
            for number, axis in enumerate("XYZ")
            if gcmd.get(axis, None) is not None
        ]
        axes = axes or (0, 1, 2)
        self.prober.docking.leave(axes)
        if 2 in axes:
            self._dock_where_height_counts()
        command(gcmd)

    # The way to such a dock goes by Z, which a [homing_override] may set to anything
    # before it homes.
    def _dock_where_height_counts(self):
        settings = self.settings
        is_known = settings.is_placed and self.moves.is_homed("xyz")
        wanted = settings.detach_dockable_before_z_home is not False
        if settings.dock_fixed_z or not (is_known and wanted and self.auto):
            return
        if self.sensors.look() != DOCKED:
            self.prober.dock_and_come_back()

    def _before_paper(self, command, gcmd):
        try:
            self.carrying.free_nozzle(self.host)
        except CalibrationError as e:
            raise self.host.error(str(e))
        command(gcmd)

    def _before_manual_method(self, command, gcmd):
        method = gcmd.get("METHOD", "automatic").strip().lower()
        if self.is_by_paper(method):
            self._before_paper_elsewhere(command, gcmd)
        else:
            command(gcmd)

    # It goes straight to its first point.
    def _before_paper_elsewhere(self, command, gcmd):
        self.prober.docking.leave()
        self._before_paper(command, gcmd)

    def _before_end(self, command, gcmd):
        self.prober.holder.delay.end(self.prober.dock_and_come_back)
        command(gcmd)

    # The way back ends beside what is printed, where the probe hangs lower.
    def _before_going_on(self, command, gcmd):
        is_known = self.settings.is_placed and self.moves.is_homed("xyz")
        if self.sensors.may_hang and is_known:
            self._before_paper(command, gcmd)
        else:
            command(gcmd)

    # The probe is docked at the end of each session, whoever held it.
    def _around_paper(self, asks_again, command, gcmd):
        if asks_again:
            if not self.auto:
                # Docked for the paper it could not be fetched for the next point.
                raise self.host.error(
                    "auto_attach_detach is off, and the probe has to be fetched and"
                    " docked at each point; run SET_DOCKABLE_PROBE"
                    " AUTO_ATTACH_DETACH=1 first"
                )
            # It goes straight to its first point, before the probe is fetched.
            self.prober.docking.leave()
        delay = self.prober.holder.delay
        # What is refused changes nothing: another one may be asking.
        is_forbidden = delay.is_forbidden
        delay.forbid(True)
        try:
            command(gcmd)
            is_forbidden = asks_again and self.auto
        finally:
            delay.forbid(is_forbidden)
