# Where the nozzle has met the pin while the probe was on the head: there nothing else
# meets the bed before.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import math

# The pin is wider than this (mm)
SAME_PLACE = 1.0


# X and Y of the head (mm), since klippy has started
class Places:
    # 'is_homed_on': homing Z meets the pin, too
    def __init__(self, host, is_homed_on):
        self.host = host
        self.met = []
        if is_homed_on:
            register = host.printer.register_event_handler
            register("homing:home_rails_end", self._homed)

    # Without the probe nobody knows where it would be; one that is pressed meets the
    # bed there.  Both read alike.
    def _homed(self, homing_state, rails):
        if 2 not in homing_state.get_axes():
            return
        probe, now = self.host.probing.endstop(), self.host.print_time()
        if not probe.query_endstop(now):
            self.note(*self.host.toolhead.get_position()[:2])

    def note(self, x, y):
        if not self.is_met_at(x, y):
            self.met.append((x, y))

    # Whether it was about there
    def is_met_at(self, x, y):
        return any(
            math.hypot(x - px, y - py) <= SAME_PLACE for px, py in self.met
        )
