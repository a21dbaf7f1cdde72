# Docking a while after the last use, see allow_delayed_detach.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import attached as carrying

# The probe is docked so long (s) after its last use.
DETACH_DELAY = 1.0

# After these nobody goes on with what was pending: the motors may be off, and
# the boards may have forgotten their pins.
ENDED_BY = (
    "stepper_enable:motor_off",
    "gcode:request_restart",
    "klippy:shutdown",
    "klippy:disconnect",
)


# The docking that is to come, or none
class Delay:
    # dock() docks the probe, and goes back
    def __init__(self, host, dock):
        self.host = host
        self.dock = dock
        # A mark of what is pending, None where nothing is
        self.mark = None
        # Whether it is docked at once, as the nozzle is lowered next
        self.is_forbidden = False
        for event in ENDED_BY:
            host.printer.register_event_handler(event, self.cancel)

    # Some events come with a print time.
    def cancel(self, *unused):
        self.mark = None

    def forbid(self, is_forbidden):
        self.is_forbidden = is_forbidden

    # In a while, unless another command needs the probe before
    def start(self):
        self.mark = object()
        self._wait(self.mark)

    # At once, where it is to come
    def hurry(self):
        if self.mark is not None:
            self.mark = None
            self.dock()

    def _wait(self, mark):
        reactor = self.host.printer.get_reactor()
        reactor.register_callback(
            lambda eventtime: self._due(mark),
            reactor.monotonic() + DETACH_DELAY,
        )

    def _due(self, mark):
        with self.host.gcode.get_mutex():
            if self.mark is not mark:
                return
            if carrying.of(self.host.printer).is_asking(self.host):
                # A hand may be near the head.
                self._wait(mark)
                return
            self._tell(self.hurry)

    # There is no command that an error could be of.
    def _tell(self, dock):
        try:
            dock()
        except self.host.printer.command_error as e:
            self.host.gcode.respond_raw("!! %s" % (e,))

    # Before what ends it: later nobody would find the dock.  dock() does not leave the
    # head beside it, whence homing goes across.
    def end(self, dock):
        if self.mark is not None:
            self.mark = None
            self._tell(dock)
