# Where the probe is: asked of the pins, never assumed.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import collections

from ..core.carrying import ATTACHED, DOCKED, UNKNOWN

# A pin: its option, and whether it reads TRIGGERED with the probe on the head
Sense = collections.namedtuple("Sense", "name endstop when_attached")


# What tells where the probe is
class Sensors(object):
    # 'settings': settings.Settings
    def __init__(self, config, host, settings):
        def sense(name, when_attached):
            endstop = host.endstops.make_plain(config, name)
            return Sense(name, endstop, when_attached)

        self.host = host
        # The switch of the probe, which is pressed in a touch
        self.pin = sense("pin", False)
        # Pins that tell by themselves, whether the probe is pressed or not
        self.senses = []
        if settings.probe_sense_pin is not None:
            self.senses.append(sense("probe_sense_pin", True))
        if settings.dock_sense_pin is not None:
            self.senses.append(sense("dock_sense_pin", False))
        self.all = list(self.senses)
        if settings.check_open_attach:
            self.all.append(self.pin)
        # Where the trip that ended last has put the probe, and the pins were
        # seen to change on it; UNKNOWN: what they read proves nothing
        self.proven = UNKNOWN
        # What somebody who looked has seen last
        self.last_state = UNKNOWN

    def state(self, print_time, senses):
        attached = [
            self.is_triggered(sense, print_time) == sense.when_attached
            for sense in senses
        ]
        self.last_state = UNKNOWN
        if all(attached):
            self.last_state = ATTACHED
        elif not any(attached):
            self.last_state = DOCKED
        return self.last_state

    def is_triggered(self, sense, print_time):
        return bool(sense.endstop.query_endstop(print_time))

    # The state after all moves so far.  The head need not stand still until the
    # board has answered: 'meanwhile' queues moves that come after.
    def look(self, meanwhile=None):
        print_time = self.host.after_moves()
        if meanwhile is not None:
            meanwhile()
        return self.state(print_time, self.all)

    # The state, at once where the pins read what is proven, so that the head
    # need not stop for it; otherwise after all moves
    def confirm(self):
        state = self.state(self.host.print_time(), self.all)
        if state == self.proven != UNKNOWN:
            return state
        return self.look()

    # Whether the pins that tell by themselves say that the probe is on the
    # head, or there are none
    def is_sensed(self):
        if not self.senses:
            return True
        return self.state(self.host.print_time(), self.senses) == ATTACHED

    # What the pins read, for people
    def describe(self):
        print_time = self.host.after_moves()
        return ", ".join(
            "%s reads %s"
            % (
                sense.name,
                "TRIGGERED" if self.is_triggered(sense, print_time) else "open",
            )
            for sense in [self.pin] + self.senses
        )
