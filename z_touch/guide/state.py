# How far somebody has come with Z_CALIBRATION_SETUP.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

# In the order in which they are set up
SITES = ("nozzle", "switch", "bed")


# A switch_offset (mm), and the switch of the list that it is of; empty: it was measured
SwitchOffset = collections.namedtuple("SwitchOffset", "value kind")


# Where the probe is, and who has put it there
class ProbeState:
    def __init__(self):
        # It stays on the head
        self.is_fixed = False
        # A start_gcode has run since the last end_gcode
        self.is_fetched = False
        # It was on the head when that has got to a place, or was moved by hand
        self.is_attached = False


# What is known so far; nothing of it is saved before the last step.
class State:
    def __init__(self):
        self.step = "pin"
        # The head has got to where the step begins
        self.arrived = True
        self.probe = ProbeState()
        # Of the frame of the heights; None: not homed yet
        self.mark = None
        # Its owner knows that the pin has moved since Z was homed on it
        self.is_pin_told = False
        # Toolhead Z (mm) that the pin lies below; None: nobody knows
        self.pin_below = None
        # By name: touching.Site, interface.Touched
        self.sites = {}
        self.touched = {}
        # The extruder that was active then
        self.extruder = ""
        self.switch_offset = None

    # Toolhead Z (mm) at which the probe triggers on the bed, less what the body
    # hangs below the nozzle: where the nozzle would meet the bed if switch_offset
    # were 0.
    def contact(self):
        nozzle, switch, bed = [self.touched[name].z for name in SITES]
        return bed - (switch - nozzle)

    # Toolhead Z (mm) of a site, None: it was not touched yet
    def height(self, name):
        return self.touched[name].z if name in self.touched else None

    # All touches (mm), by the names of the sites
    def samples(self):
        return {name: site.samples for name, site in self.touched.items()}

    # Heights of the sites that are touched before this one
    def heights_before(self, name):
        return [self.height(site) for site in SITES[: SITES.index(name)]]
