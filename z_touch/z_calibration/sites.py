"""Where z_calibration touches: nozzle and switch on the pin, the probe on the bed.

           parameter          option                 or else

  nozzle   NOZZLE_POSITION    nozzle_xy_position     home_xy_position
  switch   SWITCH_POSITION    switch_xy_position     nozzle + switch_xy_offsets
  bed      BED_POSITION       bed_xy_position        the zero of the bed mesh

A site is where the toolhead stands, in mm.  Users name the bed where the probe is to touch
it; its site is that point less the probe's offset.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, List, NamedTuple, Optional, Tuple

from .. import options, touch
from ..errors import CalibrationError
from ..touch import Site

if TYPE_CHECKING:
    from ..host.klippy import GCodeCommand
    from ..host.printer import Host
    from .settings import Settings

# A distance (mm) between nozzle and switch that no toolhead has: the
# option holds a position instead of an offset.
LARGEST_SWITCH_DISTANCE = 100.0

# Nearer (mm) to where its body is on the Z endstop the probe cannot touch the
# bed: half the length of a usual micro switch.
SWITCH_NEAR = 7.0


class Sites(NamedTuple):
    """The sites of one run; None: it is not touched."""

    nozzle: Optional[Site]
    switch: Optional[Site]
    bed: Optional[Site]


class SiteFinder:
    """Finds the sites, and checks them.  Raises CalibrationError."""

    def __init__(self, host: Host, settings: Settings):
        self.host = host
        self.settings = settings

    ##################################################################
    # Of the section
    ##################################################################

    def check(self) -> None:
        """Check what is configured; what comes with a command is checked then."""
        settings = self.settings
        nozzle = settings.nozzle_xy_position
        if nozzle is not None:
            self.check_nozzle(nozzle)
        switch = self.switch_site(nozzle, settings.switch_xy_position)
        bed = self.bed_site(settings.bed_xy_position)
        if switch is not None:
            self.check_reach(switch)
        if bed is not None:
            self.check_reach(bed)
        if switch is not None and bed is not None:
            self.check_apart(switch, bed)

    def missing(self) -> List[str]:
        """Return what has to come with each command, in words."""
        settings = self.settings
        switch = settings.switch_xy_position or settings.switch_xy_offsets
        places = (
            ("nozzle", settings.nozzle_xy_position),
            ("switch", switch),
            ("bed", self.bed_site(settings.bed_xy_position)),
        )
        return [self.no_site(name) for name, site in places if site is None]

    def no_site(self, name: str) -> str:
        """Return what the user is told where nothing says where a site is."""
        option = self.host.transforms.mesh_zero_option()
        elsewhere = {
            "nozzle": "",
            "switch": " or switch_xy_offsets",
            "bed": f", or {option} in section 'bed_mesh'",
        }
        return (
            f"no place for the {name}; run Z_CALIBRATION_SETUP, set"
            f" {name}_xy_position{elsewhere[name]}, or add {name.upper()}_POSITION=X,Y"
        )

    ##################################################################
    # Of a command
    ##################################################################

    def of_command(self, gcmd: GCodeCommand) -> Sites:
        """Return the sites of a run."""
        nozzle = self.nozzle_of_command(gcmd)
        switch = self.switch_site(nozzle, self.given(gcmd, "switch"))
        bed = self.bed_site(self.given(gcmd, "bed"))
        if switch is None:
            raise CalibrationError(self.no_site("switch"))
        if bed is None:
            raise CalibrationError(self.no_site("bed"))
        self.check_reach(switch)
        self.check_reach(bed)
        self.check_apart(switch, bed)
        return Sites(nozzle, switch, bed)

    def nozzle_of_command(self, gcmd: GCodeCommand) -> Site:
        """Return where the nozzle touches."""
        nozzle = self.given(gcmd, "nozzle")
        if nozzle is None:
            raise CalibrationError(self.no_site("nozzle"))
        self.check_nozzle(nozzle)
        return nozzle

    def given(self, gcmd: GCodeCommand, name: str) -> Optional[Site]:
        """Return the point that the user has named: in the command, or in the section."""
        param = name.upper() + "_POSITION"
        point = options.param_pair(gcmd, param)
        if point is None:
            site: Optional[Site] = getattr(self.settings, name + "_xy_position")
            return site
        x, y = point
        return Site(name, x, y, f"{param}={x:g},{y:g}", param)

    ##################################################################
    # What follows from other sections
    ##################################################################

    def switch_site(
        self, nozzle: Optional[Site], switch: Optional[Site]
    ) -> Optional[Site]:
        """Return the switch's site from what is given, or else from the nozzle's.

        None: neither is known.
        """
        offsets = self.settings.switch_xy_offsets
        if switch is not None or offsets is None:
            return switch
        for axis, distance in zip("XY", offsets):
            if abs(distance) > LARGEST_SWITCH_DISTANCE:
                raise CalibrationError(
                    "Option 'switch_xy_offsets' in section 'z_calibration':"
                    f" {distance:g} mm in {axis} is no distance from the nozzle to the"
                    " switch; if it is a position, write it as switch_xy_position"
                )
        if nozzle is None:
            return None
        x, y = touch.rounded(nozzle.x + offsets[0], nozzle.y + offsets[1])
        option = "switch_xy_offsets"
        origin = (
            f"Option '{option}: {offsets[0]:g},{offsets[1]:g}' in section"
            " 'z_calibration'"
        )
        return Site("switch", x, y, origin, option)

    def bed_site(self, bed: Optional[Site]) -> Optional[Site]:
        """Return the bed's site from the point of the bed, or else from the mesh.

        None: neither is known.
        """
        return touch.probe_site(self.host, bed)

    def bed_point(self, site: Site) -> Tuple[float, float]:
        """Return X and Y (mm) of the bed that the probe touches at a site."""
        x_offset, y_offset = self.host.probing.offsets()[:2]
        return site.x + x_offset, site.y + y_offset

    ##################################################################
    # Checks
    ##################################################################

    def check_reach(self, site: Site) -> None:
        """Check that the toolhead can stand there."""
        shift = ", the probe's offset included" if site.name == "bed" else ""
        touch.check_reach(self.host, site, touch.CHOOSE_ANOTHER, shift)
        if site.name == "bed":
            radius = self.settings.bed_spread
            touch.check_spread(self.host, site, radius, "z_calibration")

    def check_nozzle(self, site: Site) -> None:
        """Check the nozzle's site; it is also moved aside there, with wiggle_xy_offsets."""
        self.check_reach(site)
        if self.settings.wiggle_xy_offsets is None:
            return
        x, y = self.settings.wiggle_xy_offsets
        origin = "Option 'wiggle_xy_offsets' in section 'z_calibration'"
        aside = Site("nozzle", site.x + x, site.y + y, origin)
        touch.check_reach(self.host, aside, "choose the other direction")

    def check_apart(self, switch: Site, bed: Site) -> None:
        """Check that the probe's body is not on the pin any more where it touches the bed.

        The floor of the bed lies below the pin: a body that is still on it would be pressed
        down to there.
        """
        apart = math.hypot(bed.x - switch.x, bed.y - switch.y)
        apart -= self.settings.bed_spread
        if apart < SWITCH_NEAR:
            raise CalibrationError(
                f"{bed.origin} puts the toolhead {apart:.1f} mm from where it touches the"
                " switch, so that the probe's body would press the Z endstop again;"
                f" choose a point of the bed at least {SWITCH_NEAR:g} mm away"
            )
