"""Where the toolhead stands to measure: the nozzle, then the probe, over one point of the bed.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .. import touch
from ..touch import Site

if TYPE_CHECKING:
    from ..host.printer import Host
    from .settings import Settings

OUT_OF_REACH = (
    "set bed_xy_position in section 'auto_z_offset' to a point that nozzle and"
    " probe can reach"
)


def bed_site(host: Host, settings: Settings) -> Site:
    """Return the nozzle over the point of the section, or over the middle of the axes."""
    if settings.bed_xy_position is not None:
        return settings.bed_xy_position
    (x_min, x_max), (y_min, y_max) = host.axes.limits()[:2]
    middle = (x_min + x_max) / 2.0, (y_min + y_max) / 2.0
    return Site("bed", middle[0], middle[1], "The middle of the axes")


def probe_site(host: Host, bed: Site) -> Site:
    """Return the probe over the point that the nozzle of 'bed' stands over."""
    x_offset, y_offset = host.probing.offsets()[:2]
    origin = f"{bed.origin}, with the probe above it,"
    return Site("probe", bed.x - x_offset, bed.y - y_offset, origin)


def check_sites(host: Host, settings: Settings) -> None:
    """Raise CalibrationError where nozzle or probe cannot get to the point."""
    bed = bed_site(host, settings)
    for site in (bed, probe_site(host, bed)):
        touch.check_reach(host, site, OUT_OF_REACH)
    # The probe sees so large a spot that it stays over the middle
    touch.check_spread(host, bed, settings.bed_spread, "auto_z_offset")
