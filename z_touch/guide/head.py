# The head on its ways between the places of Z_CALIBRATION_SETUP.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import functools
import math

from ..core import options, running, touching
from ..core.errors import CalibrationError
from ..z_calibration.sites import LARGEST_SWITCH_DISTANCE, SiteFinder, Sites
from . import steps

# First touches: mm/s, and how often
SLOW_SPEED = 2.0
FIRST_TOUCHES = 5

# For the floors of the first touches (mm), until it is known
USUAL_SWITCH_OFFSET = 0.5

# As near (mm) the head comes over the pin by jogging, and over one whose height
# nobody knows yet
CLEAR_OF_PIN = 1.0
CLEAR_OF_UNKNOWN_PIN = 3.0

# A smaller z_offset (mm) of the probe was never measured; what it may hang below
# the nozzle then
LEAST_MEASURED = 2.0
UNMEASURED_HANGS = 11.0

# The nozzle stands so high (mm) over the highest bed there may be
OVER_SHEET = 2.0

# Nearer (mm) than this to the dock is in it
DOCK_NEAR = 15.0

PLACES = ("nozzle", "switch", "bed")


# At a safe height, and slow
class Ways(object):
    # 'module' is the object behind [z_calibration]
    def __init__(self, module):
        self.module = module
        self.host = module.host

    # As CALIBRATE_Z has them, but slow
    def settings(self):
        settings = self.module.settings
        pin, probe = settings.pin, settings.probe
        slow = functools.partial(self.slow, speed=min(SLOW_SPEED, pin.speed))
        if settings.switch_offset is None:
            settings = settings._replace(switch_offset=USUAL_SWITCH_OFFSET)
        return settings._replace(
            pin=slow(pin),
            probe=slow(probe),
            probing_speed=min(settings.probing_speed, 2.0 * SLOW_SPEED),
            probing_first_fast=False,
        )

    @staticmethod
    def slow(sampling, speed):
        return sampling._replace(
            samples=FIRST_TOUCHES,
            tolerance=float("inf"),
            result="median",
            speed=speed,
        )

    # What measures, knowing nothing of earlier runs; it has the travel height
    def run(self, state):
        sites = Sites(*[state.sites.get(name) for name in PLACES])
        plan = self.module.recorder.make_plan(None)
        run = self.module.new_calibration(self.settings(), sites, plan)
        run.rise_over(self.pin_z(state))
        return run

    def travel_z(self, state):
        return self.run(state).travel_z

    # No higher than this is the pin (mm); None: nobody knows
    def pin_z(self, state):
        homed_z = self.module.settings.position_endstop
        if homed_z is None:
            homed_z = state.below
        return state.heights.get("nozzle", homed_z)

    def places(self):
        return SiteFinder(self.host, self.module.settings)

    # The place that the section names, or that follows from another one; None
    def candidate(self, name, state):
        settings, places = self.module.settings, self.places()
        if name in state.sites:
            return state.sites[name]
        if name == "nozzle":
            return settings.nozzle_xy_position
        nozzle = state.sites.get("nozzle")
        x, y = self.host.probing.offsets()[:2]
        if name == "switch":
            site = places.switch_site(nozzle, settings.switch_xy_position)
            if site is None and nozzle is not None:
                x, y = self.within(nozzle.x - x, nozzle.y - y)
                site = touching.Site(name, x, y, "The body of the switch")
            return site
        site = places.bed_site(settings.bed_xy_position)
        if site is None:
            middle = [sum(a) / 2.0 for a in self.host.axis_limits()[:2]]
            x, y = self.within(middle[0] - x, middle[1] - y)
            site = touching.Site(name, x, y, "The middle of the bed")
        return site

    def within(self, *xy):
        limits = self.host.axis_limits()
        return [min(max(a, low), high) for a, (low, high) in zip(xy, limits)]

    def lift(self, state):
        running.check_homed(self.host)
        self.run(state).lift()

    # Over the pin X first, as a dock is more often beside it than in front of it
    def go(self, state, x, y, to_pin):
        self.lift(state)
        speed = self.module.settings.speed
        if to_pin:
            before_y = self.host.toolhead.get_position()[1]
            touching.move_xy(self.host, x, before_y, speed)
        touching.move_xy(self.host, x, y, speed)

    # Where the nozzle stands over the point of the bed, and how high
    def sheet(self, state):
        bed, offsets = state.sites["bed"], self.host.probing.offsets()
        x, y = bed.x + offsets[0], bed.y + offsets[1]
        site = touching.Site("bed", x, y, "The nozzle over the sheet")
        touching.check_reach(self.host, site, "take the type of the switch")
        return x, y, self.contact(state) + OVER_SHEET

    # Toolhead Z of the bed, if switch_offset were 0
    @staticmethod
    def contact(state):
        z = state.heights
        return z["bed"] - (z["switch"] - z["nozzle"])

    # How low (mm) the head may be moved by hand at a step
    def jog_floor(self, state, attached):
        z_offset, pin_z = self.module.settings.z_offset, self.pin_z(state)
        if state.step == "bed":
            return self.travel_z(state)
        clear = CLEAR_OF_PIN
        if pin_z is None:
            pin_z, clear = 0.0, CLEAR_OF_UNKNOWN_PIN
        hangs = 0.0
        if attached or state.step == "switch":
            # With what the plunger hangs lower than its trigger
            hangs = z_offset + CLEAR_OF_PIN
            if z_offset < LEAST_MEASURED:
                hangs = UNMEASURED_HANGS
        return max(pin_z, 0.0) + hangs + clear

    def jog(self, gcmd, state, attached):
        running.check_homed(self.host)
        here, end = self.host.toolhead.get_position(), [None, None, None]
        limits = self.host.axis_limits()
        for i, axis in enumerate("XYZ"):
            distance = options.param_number(gcmd, axis)
            if distance is None:
                continue
            if axis not in steps.STEPS[state.step].axes:
                raise CalibrationError("%s stays as it is here" % (axis,))
            low, high = limits[i]
            if axis == "Z":
                low = self.jog_floor(state, attached)
                if state.step == "paper":
                    contact = self.contact(state)
                    low = steps.paper_floor(contact, here[2], distance)
            end[i] = steps.jogged(axis, here[i], distance, low, high)
        speed = self.module.settings.pin.lift_speed
        if end[2] is not None and end[2] > here[2]:
            self.host.toolhead.manual_move([None, None, end[2]], speed)
        if end[:2] != [None, None]:
            self.host.toolhead.manual_move(end, self.module.settings.speed)
        elif end[2] is not None:
            self.host.toolhead.manual_move(end, speed)
        # Whoever looks decides on the next one
        self.host.toolhead.wait_moves()
        x, y, z = self.host.toolhead.get_position()[:3]
        gcmd.respond_info("X=%.3f Y=%.3f Z=%.3f" % (x, y, z))

    # The place the head stands at
    def take_place(self, gcmd, state):
        name = state.step
        x, y = [round(a, 3) for a in self.host.toolhead.get_position()[:2]]
        site = touching.Site(name, x, y, "The place of the %s" % (name,))
        places = self.places()
        if name == "nozzle":
            places.check_nozzle(site)
        else:
            places.check_reach(site)
        nozzle = state.sites.get("nozzle", site)
        apart = math.hypot(site.x - nozzle.x, site.y - nozzle.y)
        if name == "switch" and not 0.0 < apart <= LARGEST_SWITCH_DISTANCE:
            raise CalibrationError(
                "the switch cannot be %.1f mm from the nozzle; move the head"
                " until its body is over the pin" % (apart,)
            )
        if name == "bed":
            places.check_apart(state.sites["switch"], site)
        self.check_dock(site)
        if name == "nozzle":
            # The pin is no higher than the nozzle over it
            state.below = self.host.z()
        self.lift(state)
        state.sites[name] = site

    # The host's own text, as the option is one of several modules
    def check_dock(self, site):
        configfile = self.host.printer.lookup_object("configfile")
        status = configfile.get_status(self.host.eventtime())
        text = (
            status["config"].get("dockable_probe", {}).get("dock_position", "")
        )
        dock = [float(part) for part in text.split(",")[:2] if part.strip()]
        if len(dock) < 2:
            return
        apart = math.hypot(site.x - dock[0], site.y - dock[1])
        if apart < DOCK_NEAR:
            raise CalibrationError(
                "%s is %.1f mm from dock_position; choose one at least %g mm"
                " away" % (site.origin, apart, DOCK_NEAR)
            )
