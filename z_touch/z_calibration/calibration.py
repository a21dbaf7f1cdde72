# One run of a Z calibration: nozzle, switch and bed are touched in turn.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Each site is approached at the travel height, which follows what the run
# learns: first from what earlier runs say, then from the nozzle, then from the
# switch.  No touch goes below its floor, see heights.py.
#
#   nozzle   ->   before_switch_gcode   ->   switch   ->   bed
#     |                                        |
#     |  samples differ, or the first one      |  nothing is known of the probe, or
#     |  is higher: cleaned once               |  nothing down to where it should be:
#     +-> nozzle                               |  one touch of the bed tells how long
#                                              +-> the probe is, then the switch again
#
# Where switch - nozzle departs from earlier runs, and nothing was cleaned yet, it ends
# after the switch: end_gcode, start_gcode and clean_gcode run, and all is measured
# again.

from ..core import errors, touching
from ..history.formats import BODY
from . import heights
from .expected import NOTHING_EARLIER, Expectations, Geometry
from .measuring import BedMeasurement, NozzleMeasurement, SwitchMeasurement
from .sites import SiteFinder

# From here on (mm) the nozzle is too far from the height that Z was homed at.
STALE_Z = 0.5


# One run: nozzle, switch, bed.
class Calibration:
    # 'run': measuring.Run; 'sites': where the head stands
    def __init__(self, run, sites):
        self.run = run
        self.host = run.host
        self.settings = run.settings
        self.sites = sites
        # Why the nozzle was cleaned in this run; empty: it was not
        self.cleaned = ""
        self.know(NOTHING_EARLIER)

    # Before anything is measured; the frame may move until then
    def know(self, earlier):
        nozzle, switch = self.sites.nozzle, self.sites.switch
        finder = SiteFinder(self.host, self.settings)
        self.expected = Expectations(
            self.settings,
            earlier,
            nozzle=nozzle and (nozzle.x, nozzle.y),
            body=switch and finder.bed_point(switch),
        )
        self.geometry = Geometry(earlier)
        self.rise_over(self.expected.nozzle())

    # The travel height follows what is known of the pin (toolhead Z, mm, None:
    # nobody knows its height); the head is lifted to it later.
    def rise_over(self, pin_z):
        self.travel_z = self.expected.travel_height(pin_z)

    # Returns the heights.Result, or None where the nozzle is dirty.  attach_probe()
    # comes between nozzle and switch; 'clean' as in measure_nozzle(); 'why': it is
    # cleaned before the first touch, as an earlier look has found it dirty.
    def measure(self, attach_probe, clean=None, why=""):
        settings = self.settings
        if not settings.may_attach_late:
            # Nobody will attach it later: say so before anything is touched
            self.check_probe_attached()
        if why:
            self.clean(clean, why)
        nozzle_z = self.measure_nozzle(clean)
        self.rise_over(nozzle_z)
        self.lift()
        self.run.watch.enter("before_switch_gcode")
        attach_probe()
        self.run.watch.enter("switch")
        switch_z = self.measure_switch(nozzle_z)
        self.geometry.compare(switch_z - nozzle_z)
        may_clean = clean is not None and not self.cleaned
        if self.geometry.departure and may_clean:
            return None
        self.warn_of_geometry()
        self.run.watch.enter("bed")
        probe_z = self.measure_bed(nozzle_z, switch_z)
        parts = (probe_z, switch_z, nozzle_z, settings.switch_offset)
        return heights.Result(*parts + (heights.offset(*parts),))

    # What the offset may be off by (mm, 95 %), None: nobody knows.  What switch -
    # nozzle departs by may be nothing, or all wrong.
    def uncertainty(self):
        worth = self.run.plan.uncertainty()
        return worth if worth is None else worth + abs(self.geometry.departure)

    def warn_of_geometry(self):
        problem = self.geometry.problem()
        if problem:
            self.run.warn(BODY, problem)

    # Raises CalibrationError; a probe that is pressed is lifted off first
    def check_probe_attached(self):
        if self.host.probing.endstop().query_endstop(self.host.after_moves()):
            # A PROBE leaves it pressed on the bed
            self.lift()
            switch = self.at_switch()
            switch.check_probe_attached(self.host.after_moves())

    # To the travel height, never down
    def lift(self):
        speed = self.settings.pin.lift_speed
        touching.raise_to(self.host, self.travel_z, speed)

    # Returns toolhead Z (mm) of one site; 'before' are the heights of those that
    # come before it.
    def measure_site(self, name, *before):
        measure = {
            "nozzle": self.measure_nozzle,
            "switch": self.measure_switch,
            "bed": self.measure_bed,
        }
        return measure[name](*before)

    # What touches each site

    def at_nozzle(self):
        return NozzleMeasurement(self.run, self.sites.nozzle, self.settings.pin)

    def at_switch(self):
        site, sampling = self.sites.switch, self.settings.pin
        is_limited = self.expected.earlier.kept is not None
        return SwitchMeasurement(self.run, site, sampling, is_limited)

    # 'lowest': the lowest offset (mm) that the bed may have; None: its floor is not of
    # what that may be
    def at_bed(self, lowest=None):
        site, sampling = self.sites.bed, self.settings.probe
        return BedMeasurement(self.run, site, sampling, lowest)

    ##################################################################
    # Nozzle
    ##################################################################

    # Returns toolhead Z (mm).  clean(why) cleans the nozzle; None: nothing is
    # there to do so.
    def measure_nozzle(self, clean=None):
        self.sample_clean_nozzle(clean)
        z = self.run.plan.estimates["nozzle"].z
        homed_z = self.settings.position_endstop
        if homed_z is not None and abs(z - homed_z) > STALE_Z:
            text = (
                "nozzle: z=%.3f is far from position_endstop %.3f, at which Z"
                " was homed; " + heights.HOME_AGAIN
            )
            self.run.warn("nozzle", text % (z, homed_z))
        return z

    # Cleaned once where something seems to stick to it
    def sample_clean_nozzle(self, clean):
        try:
            self.sample_nozzle()
        except errors.CalibrationError:
            if clean is None or self.cleaned or not self.run.plan.differed:
                raise
        why = self.run.plan.doubt("nozzle")
        if clean is not None and why and not self.cleaned:
            self.run.watch.say(
                "nozzle: %s; cleaning it, then once more" % (why,)
            )
            self.clean(clean, why)
            self.sample_nozzle()
        flattened = self.run.plan.flattened("nozzle")
        if flattened:
            text = (
                "nozzle: %s: something that sticks to it is pressed flat; clean"
                " it before CALIBRATE_Z, or set clean_gcode"
            )
            self.run.warn("nozzle", text % (flattened,))

    def clean(self, clean, why):
        self.cleaned = why
        self.lift()
        clean(why)

    # The heights of the samples (mm)
    def sample_nozzle(self):
        self.run.watch.enter("nozzle")
        expected_z, floor = self.expected.nozzle(), self.expected.floor()
        return self.at_nozzle().take_samples(self.travel_z, expected_z, floor)

    ##################################################################
    # Switch
    ##################################################################

    # Returns toolhead Z (mm)
    def measure_switch(self, nozzle_z):
        switch = self.at_switch()
        expected_z = self.expected.switch(nozzle_z)
        floor = self.expected.floor(nozzle_z)
        if expected_z is None:
            floor = self.floor_from_bed(nozzle_z, floor)
        try:
            return switch.measure(self.travel_z, expected_z, floor)
        except errors.NoTrigger as e:
            if expected_z is None or switch.taken:
                raise
            floor = self.find_lower_floor(nozzle_z, floor, e)
            return switch.measure(self.travel_z, None, floor)

    # Nothing down to a floor that came from z_offset or from a probe that may
    # have been exchanged: the bed tells whether that was wrong, or the switch
    # is dead.  Raises 'error' again where the floor cannot be lower.
    def find_lower_floor(self, nozzle_z, floor, error):
        self.run.watch.say("%s" % (error,))
        self.run.watch.say("looking at the bed how long the probe is")
        hard = heights.switch_floor(self.settings, nozzle_z, None)
        try:
            lowest = self.lowest_switch(nozzle_z)
        except errors.CalibrationError as e:
            self.run.watch.say("%s" % (e,))
            raise error
        if max(lowest, hard) >= floor:
            raise error
        return max(lowest, hard)

    # Nothing known of the probe: the bed tells how long it is before its body
    # goes down where it may meet something else than the pin.
    def floor_from_bed(self, nozzle_z, hard):
        try:
            lowest = self.lowest_switch(nozzle_z)
        except errors.NoTrigger as e:
            self.run.watch.say("%s" % (e,))
            text = "searching for the switch down to z=%.3f"
            self.run.watch.say(text % (hard,))
            return hard
        return max(self.expected.switch_floor_anew(nozzle_z), lowest)

    # By one touch of the bed; raises NoTrigger where that cannot be found
    def lowest_switch(self, nozzle_z):
        settings = self.settings
        floor = heights.unmeasured_bed_floor(settings, nozzle_z)
        if floor >= self.travel_z:
            raise errors.NoTrigger(
                "bed: with offset_margins this wide the nozzle may meet it"
                " first, below z=%.3f" % (floor,)
            )
        bed_z = self.at_bed().look(self.travel_z, floor)
        kept = self.expected.earlier.kept
        return heights.lowest_switch(settings, nozzle_z, bed_z, kept)

    ##################################################################
    # Bed
    ##################################################################

    # Returns toolhead Z (mm)
    def measure_bed(self, nozzle_z, switch_z):
        expected_z = self.expected.bed(nozzle_z, switch_z)
        floor = self.expected.floor(nozzle_z, switch_z)
        self.travel_z = heights.travel_height_to_bed(
            self.settings, nozzle_z, switch_z
        )
        kept = self.expected.earlier.kept
        lowest, _ = heights.possible_offsets(self.settings, nozzle_z, kept)
        bed = self.at_bed(lowest)
        return bed.measure(self.travel_z, expected_z, floor)
