# Where the head stands to measure, and whether it can: the nozzle over a point
# of the bed, then the probe over the same point.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import touch as touching

OUT_OF_REACH = (
    "set bed_xy_position in section 'auto_z_offset' to a point that nozzle and"
    " probe can reach"
)


# The nozzle over the point of the section, or over the middle of the axes
def bed_site(host, settings):
    if settings.bed_xy_position is not None:
        return settings.bed_xy_position
    (x_min, x_max), (y_min, y_max) = host.axes.limits()[:2]
    middle = (x_min + x_max) / 2.0, (y_min + y_max) / 2.0
    origin = "The middle of the axes"
    return touching.Site("bed", middle[0], middle[1], origin)


# The probe over the point that the nozzle of 'bed' stands over
def probe_site(host, bed):
    x_offset, y_offset = host.probing.offsets()[:2]
    origin = "%s, with the probe above it," % (bed.origin,)
    return touching.Site("probe", bed.x - x_offset, bed.y - y_offset, origin)


# Raises CalibrationError.
def check_sites(host, settings):
    bed = bed_site(host, settings)
    for site in (bed, probe_site(host, bed)):
        touching.check_reach(host, site, OUT_OF_REACH)
    # The probe sees so large a spot that it stays over the middle
    touching.check_spread(host, bed, settings.bed_spread, "auto_z_offset")
