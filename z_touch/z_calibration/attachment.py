# Who puts the probe on the head for a run, and who takes it off.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# What the user's G-code does to the probe is seen, never read from its words:
#
#   start_gcode           has put it on: it stays on at the nozzle
#                         otherwise a dockable_probe is docked for the nozzle
#   before_switch_gcode   has not put it on: a dockable_probe fetches it
#   end_gcode             has not taken it off: a dockable_probe docks it
#
# Of a [probe] that macros attach only its switch tells, where that is wired as
# normally closed.

from ..core import carrying
from ..core.carrying import DOCKED
from ..core.errors import CalibrationError

# With these G28 is what its owner has made of it
OWN_HOMING = ("gcode_macro G28", "homing_override")


# What one run has seen of it, and so what is left to do
class Attachment:
    def __init__(self, host):
        self.host = host
        # What start_gcode has met: a mark of the carrier, or for a plain probe
        # whether it was on the head
        self.mark = None
        self.was_docked = self.was_on = False
        # Whether before_switch_gcode was seen to put a plain probe on
        self.is_late = False

    def carrier(self):
        return carrying.of(self.host.printer).carrier(self.host)

    # By its switch, which reads triggered where it is not on the head, or pressed
    def reads_attached(self, print_time):
        return not self.host.probing.endstop().query_endstop(print_time)

    # Before start_gcode
    def begin(self):
        carrier = self.carrier()
        self.was_docked = False
        self.was_on = self.reads_attached(self.host.after_moves())
        if carrier is not None:
            self.was_docked = carrier.state() == DOCKED
            self.mark = carrier.mark()

    # After start_gcode, or where there is none.  Raises CalibrationError where the
    # probe is known to be in the way.
    def free_nozzle(self):
        carrier = self.carrier()
        if carrier is None:
            self.check_absent()
        elif not carrier.is_put_on(self.mark, self.was_docked):
            everything = carrying.of(self.host.printer)
            everything.free_nozzle(self.host, regardless=True, goes_on=True)

    # Of a plain probe that was there before start_gcode, too
    def check_absent(self):
        if not (self.is_late and self.was_on):
            return
        if self.reads_attached(self.host.after_moves()):
            raise CalibrationError(
                "the probe is attached already, and before_switch_gcode has"
                " attached it in an earlier run: it may be in the way of the"
                " nozzle; detach it in start_gcode and check it with QUERY_PROBE"
            )

    # Before Z is homed on the pin with what hangs on the head now; 'axes': axes.Axes.
    # A G28 of the owner's own may put it away.
    def check_homing(self, axes):
        lookup = self.host.printer.lookup_object
        is_own = any(lookup(name, None) for name in OWN_HOMING)
        if is_own or not self.is_late or axes.homes_with_probe():
            return
        if self.reads_attached(self.host.after_moves()):
            raise CalibrationError(
                "the probe is on the head, and would meet the bed before the"
                " nozzle meets the pin; put it away before Z is homed: in"
                " end_gcode, or by hand"
            )

    # Around before_switch_gcode, which run() runs; 'may_attach': something stands in
    # it
    def come_late(self, run, may_attach):
        carrier = self.carrier()
        # A look waits until the head stands still: not for what is known already
        looks = carrier is None and may_attach and not self.is_late
        was_on = looks and self.reads_attached(self.host.after_moves())
        run()
        if carrier is not None:
            carrier.fetch()
        elif looks and not was_on:
            self.is_late = self.reads_attached(self.host.after_moves())

    # After end_gcode.  Where its owner wants no trips, the probe is where it was
    # before the run.
    def put_away(self):
        carrier = self.carrier()
        if carrier is None or not (carrier.auto or self.was_docked):
            return
        if carrier.state() != DOCKED:
            self.host.gcode.run_script_from_command("DETACH_PROBE")
