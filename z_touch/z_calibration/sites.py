# Where z_calibration touches: nozzle and switch on the pin, the probe on the bed.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#            parameter          option                 or else
#
#   nozzle   NOZZLE_POSITION    nozzle_xy_position     home_xy_position
#   switch   SWITCH_POSITION    switch_xy_position     nozzle + switch_xy_offsets
#   bed      BED_POSITION       bed_xy_position        the zero of the bed mesh
#
# A site is where the head stands, in mm.  Users name the bed where the probe is to
# touch it; its site is that point less the probe's offset.

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

# Where else than in <name>_xy_position a site can be set
ELSEWHERE = {
    "nozzle": "",
    "switch": " or switch_xy_offsets",
    "bed": ", or %s in section 'bed_mesh'",
}

# The sites of one run: touching.Site
Sites = collections.namedtuple("Sites", "nozzle switch bed")


# Coordinates (mm) that add up to the end of an axis are not beyond it
def rounded(x, y):
    return round(x, 6), round(y, 6)


# What the user is told where nothing says where a site is
def no_site(name, mesh_option):
    elsewhere = ELSEWHERE[name].replace("%s", mesh_option)
    text = (
        "no place for the %s; run Z_CALIBRATION_SETUP, set %s_xy_position%s, or"
        " add %s_POSITION=X,Y"
    )
    return text % (name, name, elsewhere, name.upper())


# Finds the sites, and checks them.  Raises CalibrationError.
class SiteFinder:
    def __init__(self, host, settings):
        self.host = host
        self.settings = settings

    ##################################################################
    # Of the section
    ##################################################################

    # What is configured must be right; what comes with a command is checked then.
    def check(self):
        settings, nozzle = self.settings, self.settings.nozzle_xy_position
        if nozzle is not None:
            self.check_nozzle(nozzle)
        switch = self.switch_site(nozzle, settings.switch_xy_position)
        bed = self.bed_site(settings.bed_xy_position)
        for site in (switch, bed):
            if site is not None:
                self.check_reach(site)
        if None not in (switch, bed):
            self.check_apart(switch, bed)

    # What has to come with each command, in words
    def missing(self):
        settings = self.settings
        sites = (
            settings.nozzle_xy_position,
            settings.switch_xy_position or settings.switch_xy_offsets,
            self.bed_site(settings.bed_xy_position),
        )
        names = Sites._fields
        pairs = zip(names, sites)
        return [self.no_site(name) for name, site in pairs if site is None]

    def no_site(self, name):
        return no_site(name, self.host.features.mesh_zero_option())

    ##################################################################
    # Of a command
    ##################################################################

    # The Sites of a run
    def of_command(self, gcmd):
        nozzle = self.nozzle_of_command(gcmd)
        switch = self.switch_site(nozzle, self.given(gcmd, "switch"))
        bed = self.bed_site(self.given(gcmd, "bed"))
        for site, name in ((switch, "switch"), (bed, "bed")):
            if site is None:
                raise CalibrationError(self.no_site(name))
        self.check_reach(switch)
        self.check_reach(bed)
        self.check_apart(switch, bed)
        return Sites(nozzle, switch, bed)

    def nozzle_of_command(self, gcmd):
        nozzle = self.given(gcmd, "nozzle")
        if nozzle is None:
            raise CalibrationError(self.no_site("nozzle"))
        self.check_nozzle(nozzle)
        return nozzle

    # The point that the user has named: in the command, or else in the section
    def given(self, gcmd, name):
        param = name.upper() + "_POSITION"
        point = options.param_pair(gcmd, param)
        if point is None:
            return getattr(self.settings, name + "_xy_position")
        origin = "%s=%g,%g" % ((param,) + point)
        return touching.Site(name, point[0], point[1], origin, param)

    ##################################################################
    # What follows from other sections
    ##################################################################

    # From what is given, or else from the nozzle's site; either may be None, and
    # so may be the result.
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
        x, y = rounded(nozzle.x + offsets[0], nozzle.y + offsets[1])
        option = "switch_xy_offsets"
        origin = "Option '%s: %g,%g' in section 'z_calibration'"
        origin %= (option,) + tuple(offsets)
        return touching.Site("switch", x, y, origin, option)

    # From the point of the bed, or else from the mesh; None: there is neither.
    def bed_site(self, bed):
        if bed is None:
            zero = self.host.features.mesh_zero()
            if zero is None:
                return None
            option = "zero_reference_position of section 'bed_mesh'"
            origin = "The zero reference position of section 'bed_mesh'"
            bed = touching.Site("bed", zero[0], zero[1], origin, option)
        x_offset, y_offset = self.host.probing.offsets()[:2]
        x, y = rounded(bed.x - x_offset, bed.y - y_offset)
        return bed._replace(x=x, y=y)

    # X and Y (mm) of the bed that the probe touches at a site
    def bed_point(self, site):
        x_offset, y_offset = self.host.probing.offsets()[:2]
        return site.x + x_offset, site.y + y_offset

    ##################################################################
    # Checks
    ##################################################################

    # The head must be able to stand there
    def check_reach(self, site):
        remedy = touching.CHOOSE_ANOTHER
        shift = ", the probe's offset included" if site.name == "bed" else ""
        touching.check_reach(self.host, site, remedy, shift)
        if site.name == "bed":
            radius = self.settings.bed_spread
            touching.check_spread(self.host, site, radius, "z_calibration")

    # The head is also moved aside there, with wiggle_xy_offsets
    def check_nozzle(self, site):
        self.check_reach(site)
        if self.settings.wiggle_xy_offsets is None:
            return
        x, y = self.settings.wiggle_xy_offsets
        origin = "Option 'wiggle_xy_offsets' in section 'z_calibration'"
        aside = touching.Site("nozzle", site.x + x, site.y + y, origin)
        remedy = "choose the other direction"
        touching.check_reach(self.host, aside, remedy)

    # The floor of the bed lies below the pin: a body that is still on it
    # would be pressed down to there.
    def check_apart(self, switch, bed):
        apart = math.hypot(bed.x - switch.x, bed.y - switch.y)
        apart -= self.settings.bed_spread
        if apart < SWITCH_NEAR:
            raise CalibrationError(
                "%s puts the head %.1f mm from where it touches the switch, so"
                " that the probe's body would press the Z endstop again; choose"
                " a point of the bed at least %g mm away"
                % (bed.origin, apart, SWITCH_NEAR)
            )
