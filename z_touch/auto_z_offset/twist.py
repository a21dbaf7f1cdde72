"""By how much the probe is wrong along an axis: a rail that is twisted rolls it up or down.

Nozzle and probe touch the same points of the bed, and the host's axis_twist_compensation is
told what to add to the probe's heights:

    added = correction at the point - mean of the corrections of all points

see the door for the correction.  The mean stays in that: the host leaves it out, too.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING, List, Sequence

from .. import options, touch
from ..errors import CalibrationError
from ..host.twist import NAMES, TWISTED
from ..touch import Site
from .sites import probe_site

if TYPE_CHECKING:
    from ..host.klippy import GCodeCommand
    from ..host.printer import Host
    from .settings import Settings

# Unless SAMPLE_COUNT says otherwise
POINTS = 5
MOST_POINTS = 50

# From one point to another no rail twists the probe by more (mm)
LARGEST_TWIST = 1.0

AFTERWARDS = (
    "probe_z_correction and the bed mesh were measured without that: after SAVE_CONFIG"
    " run G28, AUTO_Z_CALIBRATE and SAVE_CONFIG, then probe the mesh again"
)


def settings_of(settings: Settings) -> Settings:
    """Return those with which each point is touched: a bad touch must not stay unnoticed.

    As often as AUTO_Z_CALIBRATE measures its one point.
    """
    sampling = settings.sampling
    samples = max(sampling.samples, settings.offset_samples)
    return dataclasses.replace(
        settings, sampling=sampling._replace(samples=samples)
    )


def param_axis(gcmd: GCodeCommand) -> str:
    """Return AXIS, "X" or "Y"."""
    axis = gcmd.get("AXIS", "").strip().upper() or "X"
    if axis not in NAMES:
        raise options.param_error(gcmd, "AXIS", "X or Y")
    return axis


def param_count(gcmd: GCodeCommand) -> int:
    """Return SAMPLE_COUNT, the number of points."""
    count: int = options.param_int(
        gcmd, "SAMPLE_COUNT", POINTS, minval=2, maxval=MOST_POINTS
    )
    return count


def check_host(host: Host, axis: str) -> None:
    """Raise CalibrationError where the host has no use for it, or shifts what is measured."""
    if not host.twist.has_section():
        raise CalibrationError(
            f"section '{TWISTED}' is missing, with which Klipper uses what is measured;"
            f" write it, with {', '.join(NAMES[axis][:3])}"
        )
    if axis not in host.twist.axes():
        raise CalibrationError(
            f"section '{TWISTED}' of this Klipper knows X only; AXIS=Y needs one of"
            " November 2024 or newer, or Kalico"
        )
    if host.twist.is_in_force(axis):
        raise CalibrationError(
            f"{NAMES[axis].heights} in section '{TWISTED}' is in force; run"
            f" AXIS_TWIST_COMPENSATION_CALIBRATE AXIS={axis} and ABORT, with which"
            " Klipper forgets it until it restarts, then G28 and this command again"
        )
    if host.transforms.mesh_heights() is not None:
        raise CalibrationError(
            "a bed mesh is in force, which was probed with the twist in it; run"
            " BED_MESH_CLEAR, and probe it again when the twist is saved"
        )


def points(host: Host, settings: Settings, axis: str, count: int) -> List[Site]:
    """Return where the nozzle stands, from one end to the other, evenly apart.

    Raises CalibrationError where the user has not said where, or where nozzle or probe
    cannot get to.
    """
    names, (start, end, across) = NAMES[axis], host.twist.line(axis)
    if start is None or end is None or across is None:
        raise CalibrationError(
            f"section '{TWISTED}' does not say where to measure; write"
            f" {', '.join(names[:3])}"
        )
    if start == end:
        raise CalibrationError(
            f"{names.start} and {names.end} in section '{TWISTED}' are both {start:g};"
            " write the two ends of the bed"
        )
    remedy = f"change {', '.join(names[:3])} in section '{TWISTED}'"
    found = []
    for number in range(count):
        along = start + (end - start) * number / (count - 1)
        x, y = (along, across) if axis == "X" else (across, along)
        origin = f"Point {number + 1} of {count} in section '{TWISTED}'"
        bed = Site("bed", *touch.rounded(x, y), origin)
        for site in (bed, probe_site(host, bed)):
            touch.check_reach(host, site, remedy)
        touch.check_spread(host, bed, settings.bed_spread, host.section, remedy)
        found.append(bed)
    return found


def compensations(corrections: Sequence[float]) -> List[float]:
    """Return what the host is to add (mm) for the corrections of all points.

    Raises CalibrationError for what no twist is.
    """
    spread = max(corrections) - min(corrections)
    if spread > LARGEST_TWIST:
        raise CalibrationError(
            f"the error of the probe differs by {spread:.3f} mm, and {LARGEST_TWIST:g} mm"
            " is the limit of a twist; clean the nozzle, and look whether nozzle and probe"
            " are over the bed at each point"
        )
    mean = sum(corrections) / len(corrections)
    return [z - mean for z in corrections]


def save(
    host: Host, axis: str, beds: Sequence[Site], heights: Sequence[float]
) -> str:
    """Hand what is to be added (mm) at these points to SAVE_CONFIG; return it as written.

    The host adds it where the toolhead stands while the probe is over a point.
    """
    first, last = probe_site(host, beds[0]), probe_site(host, beds[-1])
    if axis == "X":
        return host.twist.save(axis, first.x, last.x, heights)
    return host.twist.save(axis, first.y, last.y, heights)
