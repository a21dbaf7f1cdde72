# Whether somebody prints: a dialog that moves the head has to know.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import


# Also of a print that no print_stats knows of; what moves because of a set-up itself
# is none.
class Prints(object):
    def __init__(self, host):
        self.host = host
        # Until when own moves were queued (print time); None: there were none
        self.own_time = None

    # The moves up to here are of the set-up
    def has_moved(self):
        self.own_time = self._queued_time()

    # Raises the command's error
    def check_none(self, gcmd):
        host = self.host
        if host.print_state():
            raise gcmd.error("%s: not during a print" % (host.section,))
        if self._moves_hot() and not self._is_own():
            raise gcmd.error(
                "%s: the head moves with a nozzle hot enough to print, as in a"
                " print of OctoPrint; wait until it stands still, then again"
                % (host.section,)
            )

    # Stays where no new moves come; None: nobody knows it of those that have come
    def _queued_time(self):
        host = self.host
        queued, passed, is_empty = host.toolhead.check_busy(host.eventtime())
        return queued if is_empty else None

    def _is_own(self):
        return self.own_time is not None and (
            self._queued_time() == self.own_time
        )

    # The head moves, or has done so half a second ago, with a nozzle that is kept
    # hot enough to print.
    def _moves_hot(self):
        host, look_up = self.host, self.host.printer.lookup_object
        idle_timeout, name = look_up("idle_timeout", None), host.extruder()
        extruder = look_up(name, None) if name else None
        if idle_timeout is None or extruder is None:
            return False
        eventtime = host.eventtime()
        status = extruder.get_status(eventtime)
        is_hot = status.get("can_extrude") and status.get("target", 0.0) > 0.0
        state = idle_timeout.get_status(eventtime).get("state")
        return bool(is_hot and state == "Printing")
