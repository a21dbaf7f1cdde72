# Where z_calibration touches: nozzle and switch on the pin, the probe on the bed.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import math

from ..core import options, touching
from ..core.errors import CalibrationError

# A distance (mm) between nozzle and switch that no print head has: the
# option holds a position instead of an offset.
LARGEST_SWITCH_DISTANCE = 100.0

# Nearer (mm) to where its body is on the Z endstop the probe cannot touch the
# bed: half the length of a usual micro switch.
SWITCH_NEAR = 7.0

# The sites of one run: touching.Site
Sites = collections.namedtuple("Sites", "nozzle switch bed")


# Where nozzle, switch and bed are touched, from the section, the command and
# other sections.
class SiteFinder(object):
    def __init__(self, host, settings):
        self.host = host
        self.settings = settings

    # What is configured; what comes with a command is checked there.
    def check(self):
        settings = self.settings
        if settings.nozzle_xy_position is not None:
            self.check_nozzle(settings.nozzle_xy_position)
        switch = self.switch_site(
            settings.nozzle_xy_position, settings.switch_xy_position
        )
        bed = self.bed_site(settings.bed_xy_position)
        for site in (switch, bed):
            if site is not None:
                self.check_reach(site)
        if None not in (switch, bed):
            self.check_apart(switch, bed)

    # What has to come with each command, as nothing else says where it is
    def missing(self):
        settings = self.settings
        sites = (
            settings.nozzle_xy_position,
            settings.switch_xy_position or settings.switch_xy_offsets,
            self.bed_site(settings.bed_xy_position),
        )
        names = Sites._fields
        return [no_site(n) for n, site in zip(names, sites) if site is None]

    # The sites of a run, checked.
    def of_command(self, gcmd):
        settings = self.settings
        nozzle = self.nozzle_of_command(gcmd)
        switch = self.site_param(gcmd, "switch", settings.switch_xy_position)
        switch = self.switch_site(nozzle, switch)
        bed = self.bed_site(
            self.site_param(gcmd, "bed", settings.bed_xy_position)
        )
        for site, name in ((switch, "switch"), (bed, "bed")):
            if site is None:
                raise CalibrationError(no_site(name))
        self.check_reach(switch)
        self.check_reach(bed)
        self.check_apart(switch, bed)
        return Sites(nozzle, switch, bed)

    def nozzle_of_command(self, gcmd):
        nozzle = self.site_param(
            gcmd, "nozzle", self.settings.nozzle_xy_position
        )
        if nozzle is None:
            raise CalibrationError(no_site("nozzle"))
        self.check_nozzle(nozzle)
        return nozzle

    def site_param(self, gcmd, name, default):
        param = name.upper() + "_POSITION"
        pair = options.param_pair(gcmd, param)
        if pair is None:
            return default
        origin = "%s=%g,%g" % ((param,) + pair)
        return touching.Site(name, pair[0], pair[1], origin)

    # Of the nozzle, from a Site or None
    def switch_site(self, nozzle, switch):
        offsets = self.settings.switch_xy_offsets
        if switch is not None or offsets is None:
            return switch
        for axis, distance in zip("XY", offsets):
            if abs(distance) > LARGEST_SWITCH_DISTANCE:
                raise CalibrationError(
                    "Option 'switch_xy_offsets' in section 'z_calibration': %g"
                    " mm in %s is no distance from the nozzle to the switch;"
                    " if it is a position, write it as switch_xy_position"
                    % (distance, axis)
                )
        if nozzle is None:
            return None
        x, y = nozzle.x + offsets[0], nozzle.y + offsets[1]
        origin = "Option 'switch_xy_offsets: %g,%g' in section 'z_calibration'"
        return touching.Site("switch", x, y, origin % tuple(offsets))

    # The bed is named where the probe is to touch it, the other sites where
    # the head is to stand.
    def bed_site(self, bed):
        if bed is None:
            zero = self.host.mesh_zero()
            if zero is None:
                return None
            origin = "The zero reference position of section 'bed_mesh'"
            bed = touching.Site("bed", zero[0], zero[1], origin)
        x_offset, y_offset = self.host.probing.offsets()[:2]
        return bed._replace(x=bed.x - x_offset, y=bed.y - y_offset)

    def check_reach(self, site):
        remedy = "choose a point that it can reach"
        shift = ", the probe's offset included" if site.name == "bed" else ""
        touching.check_reach(self.host, site, remedy, shift)

    def check_nozzle(self, site):
        self.check_reach(site)
        if self.settings.wiggle_xy_offsets is None:
            return
        x, y = self.settings.wiggle_xy_offsets
        origin = "Option 'wiggle_xy_offsets' in section 'z_calibration'"
        moved = touching.Site("nozzle", site.x + x, site.y + y, origin)
        remedy = "choose the other direction"
        touching.check_reach(self.host, moved, remedy)

    # The floor of the bed lies below the pin: a body that is still on it
    # would be pressed down to there.
    def check_apart(self, switch, bed):
        apart = math.hypot(bed.x - switch.x, bed.y - switch.y)
        if apart < SWITCH_NEAR:
            raise CalibrationError(
                "%s puts the head %.1f mm from where it touches the switch, so"
                " that the probe's body would press the Z endstop again; choose"
                " a point of the bed at least %g mm away"
                % (bed.origin, apart, SWITCH_NEAR)
            )


# Where else than in <name>_xy_position a place can be set
ELSEWHERE = {
    "nozzle": "",
    "switch": " or switch_xy_offsets",
    "bed": ", or zero_reference_position in section 'bed_mesh'",
}


def no_site(name):
    text = (
        "no place for the %s: run Z_CALIBRATION_SETUP, set %s_xy_position%s, or"
        " add %s_POSITION=X,Y"
    )
    return text % (name, name, ELSEWHERE[name], name.upper())
