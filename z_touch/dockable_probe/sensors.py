# Where the probe is: asked of the pins, never assumed.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from ..attached import ATTACHED, DOCKED, UNKNOWN

# A pin: its option, and whether it reads TRIGGERED with the probe on the head
Sense = collections.namedtuple("Sense", "name endstop when_attached")


# What a pin reads, for people
def level(is_triggered):
    return "TRIGGERED" if is_triggered else "open"


# What tells where the probe is
class Sensors:
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
        # Whether 'pin', too, tells where the probe is: alone it decides.  Beside
        # others it has a veto: TRIGGERED it is not on the head, or pressed.  Open
        # says nothing there, as a switch that is normally open reads so anywhere.
        self.is_pin_asked = settings.check_open_attach
        # Whether 'pin' read TRIGGERED when the probe was last fetched: a wire that
        # is broken never does
        self.is_switch_seen = False
        # Where the trip that ended last has put the probe, and the pins were seen
        # to change on it; UNKNOWN: what they read proves nothing
        self.proven = UNKNOWN
        # Whether it may hang on the head where the pins read as if it were docked:
        # it was fetched, or was to be, and not seen to be docked since
        self.may_hang = False
        # What somebody who looked has seen last
        self.last_state = UNKNOWN

    # A trip begins that puts the probe on the head, or takes it off
    def begin_trip(self):
        self.distrust()
        self.may_hang = True

    # It has put the probe there, and the pins were seen to change on it
    def end_trip(self, state):
        self.proven, self.may_hang = state, state == ATTACHED

    # It was on its way without the probe, which is as doubtful as it was before
    def stayed_docked(self, was_doubtful):
        self.may_hang = was_doubtful

    # From now on what the pins read proves nothing
    def distrust(self):
        self.proven = UNKNOWN

    # Somebody says where the probe is, and has looked, or wants it seen
    def be_told(self, state):
        self.distrust()
        if state != UNKNOWN:
            self.may_hang = state == ATTACHED

    def state(self, print_time):
        state = self._agreed(print_time, self.senses or [self.pin])
        has_veto = state == ATTACHED and self.senses and self.is_pin_asked
        if has_veto and self.is_triggered(self.pin, print_time):
            state = UNKNOWN
        self.last_state = state
        return state

    # Whether a DOCKED proves nothing.  Two pins of their own that agree are believed.
    def is_doubtful(self):
        return self.may_hang and len(self.senses) < 2

    # What all of these pins say, UNKNOWN where they contradict each other
    def _agreed(self, print_time, senses):
        attached = [
            self.is_triggered(sense, print_time) == sense.when_attached
            for sense in senses
        ]
        if all(attached):
            return ATTACHED
        return UNKNOWN if any(attached) else DOCKED

    def is_triggered(self, sense, print_time):
        return bool(sense.endstop.query_endstop(print_time))

    # The state after all moves so far.  The head need not stand still until the
    # board has answered: 'meanwhile' queues moves that come after.
    def look(self, meanwhile=None):
        print_time = self.host.after_moves()
        if meanwhile is not None:
            meanwhile()
        return self.state(print_time)

    # The state, at once where the pins read what is proven, so that the head
    # need not stop for it; otherwise after all moves
    def confirm(self):
        state = self.state(self.host.print_time())
        if state == self.proven != UNKNOWN:
            return state
        return self.look()

    # The pins that tell where the probe is, and whether each reads TRIGGERED with
    # the probe on the head and in the dock at once
    def when_joined(self):
        asked = [(sense, True) for sense in self.senses]
        if self.is_pin_asked or not asked:
            asked.append((self.pin, False))
        return asked

    # Whether they read so after all moves
    def is_joined(self):
        print_time = self.host.after_moves()
        return all(
            self.is_triggered(sense, print_time) == wanted
            for sense, wanted in self.when_joined()
        )

    # While the probe is in the dock
    def look_at_switch(self):
        print_time = self.host.print_time()
        self.is_switch_seen = self.is_triggered(self.pin, print_time)

    # Whether the pins that tell by themselves say that the probe is on the
    # head, or there are none
    def is_sensed(self):
        if not self.senses:
            return True
        self.last_state = self._agreed(self.host.print_time(), self.senses)
        return self.last_state == ATTACHED

    # What the pins read, for people
    def describe(self):
        print_time = self.host.after_moves()
        return ", ".join(
            "%s reads %s"
            % (sense.name, level(self.is_triggered(sense, print_time)))
            for sense in [self.pin] + self.senses
        )
