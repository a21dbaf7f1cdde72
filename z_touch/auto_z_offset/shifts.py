"""What Klipper's own features shift where AUTO_Z_CALIBRATE has measured.

The correction makes the gap right as long as Z is shifted there by where the probe says
that the bed is, and by nothing else: by 0 after homing with it, by the height of its own
mesh where that has no zero.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List, Optional, Sequence, Tuple

from ..host.transforms import Part

if TYPE_CHECKING:
    from ..host.printer import Host
    from ..touch import Site
    from .heights import Result

# From here on (mm) it is told: with the noise of both sensors on top, what is not told
# is less than 0.02.
WORTH_TELLING = 0.015

# Less (mm) is rounding.
NO_SHIFT = 0.0005


def parts_at(
    host: Host, site: Site, z: float, bed_z: Optional[float] = None
) -> List[Part]:
    """Return what shifts Z at a site, by what is worth a word; see Transforms.parts().

    The toolhead stands over it, where what is not known by its name is seen as well.
    """
    parts = host.transforms.parts(site.x, site.y, z, bed_z=bed_z)
    parts.append(Part("another feature", host.transforms.unknown_here()))
    return [part for part in parts if abs(part.height) >= NO_SHIFT]


def wrong_zero(host: Host, site: Site, z: float) -> str:
    """Return what the user is told where the bed sensor has set Z, the bed at z (mm) now.

    Empty: the gap is right, and stays so.  Here it counts from the bed, not from the probe.
    """
    parts, transforms = parts_at(host, site, z), host.transforms
    shift = sum(part.height for part in parts)
    if abs(shift) >= WORTH_TELLING:
        names = ", ".join(part.name for part in parts)
        return (
            f"{names}: Z is shifted by {shift:.3f} mm here, and the gap is wrong by"
            " that; clear it before AUTO_Z_HOME_Z, or use AUTO_Z_CALIBRATE"
        )
    has_zero = transforms.is_mesh_zero(site.x, site.y)
    if transforms.has_mesh_section() and not has_zero:
        return (
            f"bed_mesh has no zero at {site.x:.1f}, {site.y:.1f}: one that is probed or"
            " loaded now makes the gap wrong by its height there; set its"
            f" {transforms.mesh_zero_option()} to that point"
        )
    return ""


def wrong_mesh(host: Host) -> str:
    """Return what the user is told of a mesh with a zero where Z is not homed with the probe.

    There it takes off nothing of what the probe says of the bed.  Empty: it is none.
    """
    transforms = host.transforms
    if host.axes.homes_with_probe() or transforms.mesh_zero() is None:
        return ""
    return (
        "Z is homed without the probe, and the bed mesh has a zero of its own: the"
        " gap is wrong by the height at which the probe sees the bed there; remove"
        f" {transforms.mesh_zero_option()} from section 'bed_mesh', and probe the mesh"
        " again"
    )


def wrong_gap(host: Host, site: Site, results: Sequence[Result]) -> str:
    """Return what the user is told of the gap at the nozzle's site; empty: it is right.

    'results' are those of all cycles.
    """
    if host.transforms.is_mesh_guessed(site.x, site.y):
        return (
            f"bed_mesh ends before {site.x:.1f}, {site.y:.1f}, and its zero is"
            " elsewhere: it is not known by how much the gap is wrong; a bed mesh has to be"
            " zero where Z is homed, or nowhere"
        )
    seen = sum(r.probe - r.probe_z_offset for r in results) / len(results)
    parts = parts_at(host, site, results[0].sensor, bed_z=seen)
    shift = sum(part.height for part in parts)
    wrong = shift - (seen - host.probing.homed_bed_z())
    # Without any part it is homing that is old, and that is told by itself
    if not parts or abs(wrong) < WORTH_TELLING:
        return ""
    names = ", ".join(part.name for part in parts)
    return (
        f"{names}: Z is shifted by {shift:.3f} mm here, and the probe sees the bed at"
        f" {seen:.3f}: the gap is wrong by {wrong:.3f} mm; a bed mesh has to be zero"
        " where Z is homed, or nowhere; correct that, or the first layer where something"
        " else shifts Z"
    )


def wrong_where_homed(host: Host, toolhead: Tuple[float, float]) -> str:
    """Return what the user is told of a mesh that is not zero where Z was homed.

    'toolhead' is where that stood (X and Y, mm).  There the offset alone makes the gap
    right.  Empty: the mesh in force is zero there, or there is none.
    """
    transforms = host.transforms
    x_offset, y_offset = host.probing.offsets()[:2]
    x, y = toolhead[0] + x_offset, toolhead[1] + y_offset
    wrong = transforms.height(x, y, bed_z=host.probing.homed_bed_z())
    if transforms.mesh_heights() is None or abs(wrong) < WORTH_TELLING:
        return ""
    return (
        f"bed_mesh: Z is shifted by {wrong:.3f} mm at {x:.1f}, {y:.1f}, where Z was homed"
        " with the probe: the gap is wrong by that; a bed mesh has to be zero where Z is"
        " homed, or nowhere"
    )
