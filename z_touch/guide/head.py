# The head between the sites of Z_CALIBRATION_SETUP: at a safe height, and slow.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import math

from ..core import carrying, jogging, options, running, touching
from ..core.errors import CalibrationError
from ..z_calibration.settings import with_counts
from ..z_calibration.sites import LARGEST_SWITCH_DISTANCE, Sites
from . import steps, texts
from .state import SITES

# The first touches of a site: at most so fast (mm/s), and so many
SLOW_SPEED = 2.0
FIRST_TOUCHES = 5

# The switch_offset (mm) by which floors are calculated until it is known
USUAL_SWITCH_OFFSET = 0.5

# By jogging nothing comes nearer (mm) to the pin, nor to where it may be as long as
# nobody knows its height.
CLEAR_OF_PIN = 1.0
CLEAR_OF_UNKNOWN_PIN = 3.0

# The nozzle comes down to so high (mm) above the highest bed that there may be, to
# meet the sheet of paper by small steps from there; no further (mm) aside is it over
# the sheet.
OVER_SHEET = 2.0
BESIDE_SHEET = 2.0

# So long (s) the head stays over each place for somebody to look
LOOK_TIME = 4.0

# A site nearer (mm) than this to dock_position is in the dock
DOCK_NEAR = 15.0

TAKE_THE_TYPE = "take the type of the switch"


# A sampling for first touches, at 'speed' (mm/s) or as slow as it is
def slow(sampling, speed):
    return sampling._replace(
        samples=FIRST_TOUCHES,
        tolerance=float("inf"),
        result="median",
        speed=min(SLOW_SPEED, speed),
    )


# Moves the head over the sites, and by hand.
class GuidedHead:
    # 'section': interface.Interface
    def __init__(self, section):
        self.section = section
        self.host = section.host

    # The settings in force, but slow
    def slow_settings(self):
        settings = self.section.settings()
        pin, probe = settings.pin, settings.probe
        if settings.switch_offset is None:
            settings = settings._replace(switch_offset=USUAL_SWITCH_OFFSET)
        settings = settings._replace(
            probing_speed=min(settings.probing_speed, 2.0 * SLOW_SPEED),
            probing_first_fast=False,
            # Texture would look like a switch that varies
            bed_spread=0.0,
            # Where it is on the head, the bed may be met before the pin
            may_attach_late=True,
        )
        speed = pin.speed
        return with_counts(settings, slow(pin, speed), slow(probe, speed))

    # What touches the sites: interface.FirstTouches
    def first_touches(self, state):
        sites = Sites(*[state.sites.get(name) for name in SITES])
        settings, pin_z = self.slow_settings(), self.pin_z(state)
        return self.section.first_touches(settings, sites, pin_z)

    # Toolhead Z (mm) at which the head moves over pin and bed
    def travel_z(self, state):
        return self.first_touches(state).travel_z()

    # No higher than this is the pin (toolhead Z, mm); None: nobody knows
    def pin_z(self, state):
        homed_z = self.section.settings().position_endstop
        if homed_z is None or self.section.pin_moved():
            homed_z = state.pin_below
        nozzle_z = state.height("nozzle")
        return homed_z if nozzle_z is None else nozzle_z

    ##################################################################
    # Sites
    ##################################################################

    # The site that the section names, or that follows from another one; None:
    # there is none yet
    def candidate(self, name, state):
        settings = self.section.settings()
        if name in state.sites:
            return state.sites[name]
        if name == "nozzle":
            return settings.nozzle_xy_position
        if name == "switch":
            nozzle = state.sites.get("nozzle")
            if state.step == "nozzle":
                # The place that is taken next
                x, y = self.host.toolhead.get_position()[:2]
                nozzle = touching.Site("nozzle", x, y, "")
            return self.switch_candidate(nozzle)
        finder = self.section.site_finder()
        site = finder.bed_site(settings.bed_xy_position)
        if site is None:
            middle = [sum(axis) / 2.0 for axis in self.host.axes.limits()[:2]]
            site = self.with_probe(name, middle, "The middle of the bed")
        return site

    # The body is about where the probe is, until somebody has looked
    def switch_candidate(self, nozzle):
        finder = self.section.site_finder()
        position = self.section.settings().switch_xy_position
        site = finder.switch_site(nozzle, position)
        if site is None and nozzle is not None:
            xy = nozzle.x, nozzle.y
            site = self.with_probe("switch", xy, "The body of the switch")
        return site

    # Whether nobody but the probe's offset says where the switch is: its plunger is
    # about over the pin then
    def is_at_plunger(self, state):
        settings = self.section.settings()
        given = settings.switch_xy_position, settings.switch_xy_offsets
        return given == (None, None) and "switch" not in state.sites

    # Where the head stands to have the probe at xy, as far as it reaches
    def with_probe(self, name, xy, origin):
        limits, offsets = self.host.axes.limits(), self.host.probing.offsets()
        x, y = [
            min(max(a - offset, low), high)
            for a, offset, (low, high) in zip(xy, offsets, limits)
        ]
        return touching.Site(name, x, y, origin)

    # Keeps the site that the head stands at
    def take_site(self, gcmd, state):
        name = state.step
        x, y = [round(a, 3) for a in self.host.toolhead.get_position()[:2]]
        site = touching.Site(name, x, y, "The place of the %s" % (name,))
        self.check_site(site, state)
        if name == "nozzle":
            # The pin is no higher than the nozzle over it
            state.pin_below = self.host.motion.z()
        self.lift(state)
        state.sites[name] = site

    def check_site(self, site, state):
        finder = self.section.site_finder()
        if site.name == "nozzle":
            finder.check_nozzle(site)
        else:
            finder.check_reach(site)
        nozzle = state.sites.get("nozzle", site)
        apart = math.hypot(site.x - nozzle.x, site.y - nozzle.y)
        if site.name == "switch" and not 0.0 < apart <= LARGEST_SWITCH_DISTANCE:
            raise CalibrationError(
                "the switch cannot be %.1f mm from the nozzle; move the head"
                " until its body is over the pin" % (apart,)
            )
        if site.name == "bed":
            finder.check_apart(state.sites["switch"], site)
        self.check_dock(site)

    # The host's own text, as the option is one of several modules
    def check_dock(self, site):
        configfile = self.host.printer.lookup_object("configfile")
        status = configfile.get_status(self.host.eventtime())
        dockable = status["config"].get("dockable_probe", {})
        parts = dockable.get("dock_position", "").split(",")[:2]
        dock = [float(part) for part in parts if part.strip()]
        if len(dock) < 2:
            return
        apart = math.hypot(site.x - dock[0], site.y - dock[1])
        if apart < DOCK_NEAR:
            raise CalibrationError(
                "%s is %.1f mm from the dock; choose one at least %g mm away"
                % (site.origin, apart, DOCK_NEAR)
            )

    ##################################################################
    # Moves
    ##################################################################

    # Never down
    def lift(self, state):
        running.check_homed(self.host)
        self.first_touches(state).lift()

    # Lifted to (x, y), around a dock that is known; over the pin X first, as another
    # one is more often beside it than in front of it.
    def go(self, state, x, y, to_pin):
        self.lift(state)
        speed = self.section.settings().speed
        everything = carrying.of(self.host.printer)
        everything.go_to(self.host, x, y, speed, to_pin)

    # To all places, with time to look
    def look_around(self, state):
        for name in SITES:
            site = state.sites[name]
            self.go(state, site.x, site.y, name != "bed")
            self.host.toolhead.wait_moves()
            self.host.say("Look: %s" % (texts.LOOKED_AT[name],))
            self.host.toolhead.dwell(LOOK_TIME)
        self.host.toolhead.wait_moves()

    # Where the nozzle stands over the point of the bed, and how high
    def over_sheet(self, state):
        bed, offsets = state.sites["bed"], self.host.probing.offsets()
        x, y = bed.x + offsets[0], bed.y + offsets[1]
        site = touching.Site("bed", x, y, "The nozzle over the sheet")
        touching.check_reach(self.host, site, TAKE_THE_TYPE)
        return x, y, state.contact() + OVER_SHEET

    # Elsewhere the bed has another height, or the pin is below
    def check_over_sheet(self, state):
        x, y = self.over_sheet(state)[:2]
        here = self.host.toolhead.get_position()
        if math.hypot(here[0] - x, here[1] - y) > BESIDE_SHEET:
            raise CalibrationError(
                "the nozzle has left the sheet; 'Back', then 'Paper'"
            )

    def go_over_sheet(self, state):
        x, y, z = self.over_sheet(state)
        self.go(state, x, y, False)
        speed = self.section.settings().pin.lift_speed
        self.host.toolhead.manual_move([None, None, z], speed)

    # How low (toolhead Z, mm) the head may be moved by hand at a step
    def jog_floor(self, state, attached):
        pin_z = self.pin_z(state)
        if state.step == "bed":
            return self.travel_z(state)
        clear = CLEAR_OF_PIN
        if pin_z is None:
            pin_z, clear = 0.0, CLEAR_OF_UNKNOWN_PIN
        hangs = 0.0
        if attached or state.step == "switch":
            # With what the plunger hangs lower than its trigger
            hangs = self.section.may_hang(CLEAR_OF_PIN)
        return max(pin_z, 0.0) + hangs + clear

    # Moves by the X, Y and Z of the command (mm), up first
    def jog(self, gcmd, state, attached):
        running.check_homed(self.host)
        toolhead, settings = self.host.toolhead, self.section.settings()
        speed, start = settings.pin.lift_speed, toolhead.get_position()
        end = [
            self.jog_end(gcmd, state, attached, i, start[i]) for i in range(3)
        ]
        if end[2] is not None and end[2] > start[2]:
            toolhead.manual_move([None, None, end[2]], speed)
        if end[:2] != [None, None]:
            toolhead.manual_move(end, settings.speed)
        elif end[2] is not None:
            toolhead.manual_move(end, speed)
        # Whoever looks decides on the next one
        toolhead.wait_moves()
        gcmd.respond_info("X=%.3f Y=%.3f Z=%.3f" % self.position())

    # Where the head is (mm)
    def position(self):
        return tuple(self.host.toolhead.get_position()[:3])

    # How low the buttons lead, in words
    def lowest(self, state):
        floor = self.jog_floor(state, state.probe.is_attached)
        pin_z = self.pin_z(state)
        if pin_z is None:
            return texts.LOWEST_OF_ANY % (floor,)
        if floor > pin_z + CLEAR_OF_PIN + 1e-6:
            return texts.LOWEST_OF_PROBE % (floor,)
        return texts.LOWEST % (CLEAR_OF_PIN, floor)

    # Where an axis (0 to 2) ends (mm); None: it stays.  Raises CalibrationError.
    def jog_end(self, gcmd, state, attached, number, start):
        axis = "XYZ"[number]
        distance = options.param_number(gcmd, axis)
        if distance is None:
            return None
        if axis not in steps.STEPS[state.step].axes:
            raise CalibrationError("%s stays as it is here" % (axis,))
        low, high = self.host.axes.limits()[number]
        stops = axis == "Z" and state.step != "paper"
        if stops:
            low = self.jog_floor(state, attached)
        elif axis == "Z":
            low = steps.paper_floor(state.contact(), start, distance)
        return jogging.jogged(axis, start, distance, low, high, stops)
