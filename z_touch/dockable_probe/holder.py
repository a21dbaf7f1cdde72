# Who keeps the probe on the head between two commands.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .delay import Delay


# Whether the probe stays on the head when a command has used it, or is docked then
class Holder:
    # dock() docks the probe, and goes back; 'auto': whether commands fetch and dock
    # it by themselves
    def __init__(self, host, dock, auto):
        self.auto = auto
        # Whether ATTACH_PROBE has fetched the probe to stay, and how often
        self.is_held, self.times_held = False, 0
        # The docking that is to come in a while
        self.delay = Delay(host, dock)

    def hold(self, is_held):
        self.delay.cancel()
        self.is_held = is_held
        self.times_held += is_held

    # Whoever held it has lost it.
    def lose(self):
        self.is_held = False

    # Off: what is pending is called off, too.
    def set_auto(self, auto):
        self.auto = auto
        if not auto:
            self.delay.cancel()

    # Whether it is docked when a command has used it
    def lets_go(self):
        return self.auto and not self.is_held
