# How far somebody has come with Z_CALIBRATION_SETUP.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

# In the order in which they are set up
SITES = ("nozzle", "switch", "bed")


# What is known so far; nothing of it is saved before the last step.
class State(object):
    def __init__(self):
        self.step = "pin"
        # The head has got to where the step begins
        self.arrived = True
        # The probe stays on the head
        self.is_fixed = False
        # A start_gcode has run since the last end_gcode
        self.is_fetched = False
        # It was there when the head has got to a place, or was moved by hand
        self.is_attached = False
        # Of the frame of the heights; None: not homed yet
        self.mark = None
        # Toolhead Z (mm) that the pin lies below; None: nobody knows
        self.pin_below = None
        # By name: touching.Site, toolhead Z (mm), all touches (mm)
        self.sites = {}
        self.heights = {}
        self.samples = {}
        # mm; and the switch of the list that it is of, empty: it was measured
        self.switch_offset = None
        self.kind = ""

    # Toolhead Z (mm) at which the probe triggers on the bed, less what the body
    # hangs below the nozzle: where the nozzle would meet the bed if switch_offset
    # were 0.
    def contact(self):
        z = self.heights
        return z["bed"] - (z["switch"] - z["nozzle"])

    # Heights of the sites that are touched before this one
    def heights_before(self, name):
        return [self.heights.get(site) for site in SITES[: SITES.index(name)]]
