# What G-code may do while the probe hangs on the head: that of macros and prints, and
# of whoever types it.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# The probe hangs lower than the nozzle.  A head that G-code takes down to a first
# layer would press it into the bed, all of its length but its travel:
#
#     |_____|  head
#      | |  \/                 - - - Z of the head
#      |_|       nozzle
#       | probe                from z_offset (mm) on it meets the bed
#     =========  bed           - - - Z=0
#
# Each move of G-code passes here, as it passes a bed mesh: G1, an arc, the way back of
# RESTORE_GCODE_STATE and of RESUME, a baby step.  Moves of modules (probing, homing,
# the way to the dock) do not.  What goes down is looked at: a head that is low already
# was brought there by somebody who has looked, or has a Z that homing has made up.

from .. import attached as carrying
from ..attached import DOCKED
from . import detour
from .docking import HIGHER
from .settings import POSITIONS

# A nozzle with so many degrees C is that of a print, which may be OctoPrint's.
HOT = 100.0


# A link in the host's chain of what moves pass, with the two functions that it asks
class GcodeMoves:
    # 'prober': prober.Prober; 'carrier': carrier.Carrier
    def __init__(self, prober, carrier):
        self.host = prober.host
        self.prober = prober
        self.carrier = carrier
        self.carrying = carrying.of(self.host.printer)
        self.moves = prober.moves
        self.sensors = prober.sensors
        # The next link, at last the toolhead
        self.next = None
        register = self.host.printer.register_event_handler
        # What is in the chain for good is there then.
        register("klippy:ready", self._join)

    def _join(self):
        self.next = self._gcode_move().set_move_transform(self, force=True)

    def _gcode_move(self):
        return self.host.printer.lookup_object("gcode_move")

    def get_position(self):
        return self.next.get_position()

    # 'newpos' (X, Y, Z, E...; mm) as G-code has it, its offset added; 'speed' in mm/s
    def move(self, newpos, speed):
        if not self.sensors.may_hang or self._is_fine(newpos):
            self.next.move(newpos, speed)
            return
        if self.carrier.state() == DOCKED:
            # Two pins of their own say so: nobody need look again.
            self.sensors.be_told(DOCKED)
            self.next.move(newpos, speed)
            return
        goal = list(newpos)
        self._require_trip(goal)
        # The host counts from there already, and so would G-code of the dock's.
        self._gcode_move().reset_last_position()
        self.prober.dock_and_come_back()
        self.next.move(goal, speed)
        self._gcode_move().reset_last_position()

    # Toolhead Z (mm)
    def _meets_bed(self):
        return self.prober.settings.z_offset + HIGHER

    # Whether the probe is in nobody's way there
    def _is_fine(self, newpos):
        now = self.next.get_position()
        down = now[2] - newpos[2]
        z = self.host.toolhead.get_position()[2] - down
        return (
            down < detour.ROUNDING
            or z >= self._meets_bed()
            or self._is_known_to(newpos)
        )

    # Whether whoever moves the head knows what hangs on it: a trip, a measurement with
    # the owner's G-code, somebody who is asked to bring the probe to its dock, or who
    # goes there.
    def _is_known_to(self, newpos):
        return (
            self.prober.docking.is_busy()
            or not self.prober.settings.is_placed
            or self.carrying.is_measuring()
            or (self._is_asking() and not self._may_print())
            or self._is_at_dock(detour.Position(*newpos[:3]))
        )

    # A print has nothing to do there, but for macros that do without our trips.
    def _is_at_dock(self, goal):
        moves, settings = self.moves, self.prober.settings
        stays_in = moves.stands_in_dock() and moves.is_in_dock(goal)
        if self._may_print() and self.prober.holder.auto:
            return stays_in
        beside = [getattr(settings, row.name) for row in POSITIONS]
        return (
            stays_in
            or detour.is_inside(goal, moves.zone)
            or any(detour.distance(goal, p) < detour.ROUNDING for p in beside)
        )

    # Whoever prints has cleared the bed.
    def _is_asking(self):
        is_asking = self.carrying.is_asking(self.host)
        return is_asking and not self.host.print_state()

    def _may_print(self):
        is_hot = self.host.nozzle_temperature() >= HOT
        return is_hot or bool(self.host.print_state())

    # A print goes on without it, and so does what comes within a second after the last
    # use.  Who types G-code has put it on to stay, and is near; who is asked where its
    # dock is may have given another place.
    def _require_trip(self, goal):
        holder = self.prober.holder
        is_kept = holder.is_held and not self._may_print()
        if is_kept or self._is_asking() or not holder.auto:
            raise self.host.error(
                "the probe may be on the head (%s), and may meet the bed from"
                " z=%.3f on; that is higher than z=%.3f; run DETACH_PROBE first"
                % (self.carrier.reads(), self._meets_bed(), goal[2])
            )
