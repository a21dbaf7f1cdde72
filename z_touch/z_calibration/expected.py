# What earlier runs say to one that begins: where it should meet what it touches, how
# deep it may go, and whether its result is likely.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from . import heights

# Of switch minus nozzle: from here on (mm) a difference to the last run is not noise
# or heat.
GEOMETRY_JUMP = 0.5

# What earlier runs say: the last good heights.Result or None, whether the frame
# is still the one of that run, and departure(switch - nozzle), by how much that
# departs from many of them (mm), or None; and what of a good run holds for all later
# ones, heights.Kept or None.
Earlier = collections.namedtuple("Earlier", "last holds departure kept")
NOTHING_EARLIER = Earlier(None, False, None, None)


# Heights of one run before they are measured: toolhead Z (mm)
class Expectations:
    # 'settings': completed.  Of the touches on the pin: X and Y (mm) of the nozzle and
    # of the probe's body, None: nobody knows.
    def __init__(self, settings, earlier, nozzle=None, body=None):
        self.settings = settings
        self.earlier = earlier
        self.points = nozzle, body

    # Where each site should trigger; None: nobody knows

    def nozzle(self):
        last, holds = self.earlier.last, self.earlier.holds
        return heights.expect_nozzle(self.settings, last, holds)

    def switch(self, nozzle_z):
        last = self.earlier.last
        return heights.expect_switch(self.settings, nozzle_z, last)

    def bed(self, nozzle_z, switch_z):
        last = self.earlier.last
        return heights.expect_bed(self.settings, nozzle_z, switch_z, last)

    # Where a touch ends at the latest: of the nozzle; with nozzle_z of the switch;
    # with switch_z, too, of the bed.
    def floor(self, nozzle_z=None, switch_z=None):
        settings, kept = self.settings, self.earlier.kept
        if nozzle_z is None:
            floor = heights.nozzle_floor(settings, self.nozzle())
            return heights.floor_over(settings, floor, self.points[0])
        if switch_z is None:
            expected_z = self.switch(nozzle_z)
            floor = heights.switch_floor(settings, nozzle_z, expected_z, kept)
            below = heights.least_body(settings)
            return heights.floor_over(settings, floor, self.points[1], below)
        return heights.bed_floor(settings, nozzle_z, switch_z, kept)

    # That of the switch where the bed has just told how long the probe is
    def switch_floor_anew(self, nozzle_z):
        settings = self.settings
        floor = heights.switch_floor(settings, nozzle_z, None)
        below = heights.least_body(settings)
        return heights.floor_over(settings, floor, self.points[1], below)

    # Where the head moves over the pin; 'pin_z': how high that is, None: nobody knows
    def travel_height(self, pin_z):
        return heights.travel_height(self.settings, pin_z, self.body())

    # switch - nozzle (mm) of the probe that was there last, or None
    def body(self):
        last, holds = self.earlier.last, self.earlier.holds
        return last.switch - last.nozzle if holds else None


# switch - nozzle of one run (mm) against those of earlier ones.  An exchanged nozzle is
# what the module is for; dirt, or a probe that is seated badly, looks the same.
class Geometry:
    def __init__(self, earlier):
        self.earlier = earlier
        # What was measured; None: nothing yet
        self.body = None
        # By how much that departs from earlier runs; 0: it does not, or it is another
        # nozzle or probe
        self.departure = 0.0

    def compare(self, body):
        self.body, departure = body, self.earlier.departure
        if departure is None or self._is_another():
            self.departure = 0.0
        else:
            self.departure = departure(body)

    # Of the last good run
    def _before(self):
        last = self.earlier.last
        return self.body if last is None else last.switch - last.nozzle

    def _is_another(self):
        return abs(self.body - self._before()) > GEOMETRY_JUMP

    # What is odd about it, in words; empty: nothing
    def problem(self):
        if self._is_another():
            return (
                "switch - nozzle is %.3f mm and was %.3f mm in the last good"
                " run; if neither nozzle nor probe was exchanged, check how the"
                " probe is seated and that the nozzle is tight"
                % (self.body, self._before())
            )
        if self.departure:
            return (
                "switch - nozzle is %.3f mm and was %.3f mm in earlier runs that"
                " were as hot: the nozzle is dirty, or was exchanged, or the"
                " probe is not seated; clean it and run CALIBRATE_Z again"
                % (self.body, self.body - self.departure)
            )
        return ""

    # Why the nozzle is to be cleaned before all is measured again
    def dirt(self):
        text = "switch - nozzle is %.3f mm off earlier runs that were as hot"
        return text % (self.departure,)
