# A finger that presses the switch once, before the nozzle comes down on it.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import logging

from ..errors import CalibrationError

# How often (s) the switch is looked at
LOOK_INTERVAL = 0.1

# What a switch reads in turn that somebody presses once
PRESSED_ONCE = (False, True, False)

# What to do about one that reads triggered too early
TRIGGERED = (
    "the switch reads triggered before it is touched; check it with %s, and"
    " whether pin needs a '!'"
)


# Watches the switch while a question is open.  'switch' is what lies on the bed,
# 'say' tells the console.
class Finger:
    def __init__(self, host, switch, say):
        self.host = host
        self.switch = switch
        self.say = say
        # What it has read, each change once; None: nobody has to press it
        self.readings = None
        self.timer = None

    # From now on it has to be pressed
    def watch(self):
        self.end()
        self.readings = []
        reactor = self.host.printer.get_reactor()
        self.timer = reactor.register_timer(self.look, reactor.NOW)

    # Whatever it was, nobody has to press it (any more)
    def end(self):
        self.readings = None
        if self.timer is not None:
            self.host.printer.get_reactor().unregister_timer(self.timer)
            self.timer = None

    # Raises CalibrationError until it was pressed
    def check(self):
        if self.readings is None or self.was_pressed():
            return
        if self.readings[:1] == [True]:
            raise CalibrationError(TRIGGERED % (self.switch.query,))
        raise CalibrationError(
            "the switch was not pressed yet; press it once with a finger, then"
            " Continue, or look with %s if that changes nothing"
            % (self.switch.query,)
        )

    def was_pressed(self):
        count = len(PRESSED_ONCE)
        return tuple(self.readings[-count:]) == PRESSED_ONCE

    # Of the reactor
    def look(self, eventtime):
        if not self.read():
            return self.host.printer.get_reactor().NEVER
        return self.host.eventtime() + LOOK_INTERVAL

    # Whether it has to be looked at again
    def read(self):
        try:
            endstop = self.switch.endstop()
            reading = self.host.endstops.read_between_commands(endstop)
        except Exception:
            # From here it would end klippy; the calibration can begin again
            logging.exception("%s: looking at the switch", self.host.section)
            return False
        if self.readings is None:
            return False
        if reading is None:
            return True
        if self.readings[-1:] != [reading]:
            self.readings.append(reading)
        if not self.was_pressed():
            return True
        self.say("the switch was pressed, and works; take the hand away")
        return False
