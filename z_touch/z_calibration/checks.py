"""What is wrong with a set-up, or worth telling, when klippy connects.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List

from .. import command
from ..errors import CalibrationError
from ..host.tools import INACTIVE, PRIMARY, Carriage
from . import heights
from .sites import SiteFinder
from .statistics import impossible

if TYPE_CHECKING:
    from ..host.printer import Host
    from .settings import Settings

# A carriage so near (mm) to where it is homed is parked
PARKED = 10.0


def check_probe(host: Host) -> None:
    """Raise the error of a configuration whose probe cannot press the pin."""
    for name in ("bltouch", "smart_effector"):
        # Neither has a switch body, and on a touch without the host's own
        # procedure the pin of a bltouch would be retracted.
        if host.printer.lookup_object(name, None) is not None:
            raise host.printer.config_error(
                f"Section '{name}': this probe has no switch body to press the"
                " Z endstop with; z_calibration needs a switch as [probe]"
            )
    if host.probing.probe is None or host.probing.endstop() is None:
        raise host.printer.config_error(
            "Section 'probe' is missing, or no switch on an endstop pin"
            " that stops the Z motors; z_calibration needs a [probe] with a"
            " switch that can press the Z endstop"
        )


def check_carriages(host: Host, settings: Settings) -> None:
    """Raise CalibrationError where another carriage of an IDEX would touch the bed, too.

    Or where the active one would be lost.
    """
    carriages = host.tools.carriages()
    active = [c for c in carriages if c.mode != INACTIVE]
    for carriage in active:
        if carriage.mode != PRIMARY:
            raise CalibrationError(
                f"{carriage.name} moves along ({carriage.mode}): two nozzles would go"
                f" down; run SET_DUAL_CARRIAGE for one of them first"
            )
    for carriage in carriages:
        axis = "xyz"[carriage.axis]
        is_idle = carriage.mode == INACTIVE and host.is_homed(axis)
        if carriage.is_first and is_idle and _is_over_bed(carriage, settings):
            raise CalibrationError(
                f"{carriage.name}, with which Z was homed, is not active and stands at"
                f" {axis.upper()}={carriage.position:.1f} over the bed, where its nozzle"
                f" may be the lower one; park it at its end ({carriage.end:.1f})"
            )
    command.check_carriage_is_kept(host)


def _is_over_bed(carriage: Carriage, settings: Settings) -> bool:
    """Return whether a carriage is over what the mesh covers, or, without one, not parked."""
    if settings.mesh_area is None:
        return abs(carriage.position - carriage.end) > PARKED
    low, high = (corner[carriage.axis] for corner in settings.mesh_area)
    return low <= carriage.position <= high


def check_settings(host: Host, settings: Settings) -> None:
    """Raise CalibrationError for completed settings that cannot work."""
    result = settings.on_bed.result
    if result not in ("median", "average"):
        raise CalibrationError(
            f"Option 'samples_result: {result}' in section 'probe' is not known to"
            " z_calibration; set it to median or average"
        )
    _check_travel_heights(host, settings)
    SiteFinder(host, settings).check()


def _check_travel_heights(host: Host, settings: Settings) -> None:
    """Check that both fit, the height that the user wants and the one that the pin needs."""
    high, homed_z = settings.position_max, settings.position_endstop or 0.0
    unlimited = settings.replace(position_max=float("inf"))
    above_pin = heights.travel_height(unlimited, homed_z, None)
    assert host.axes.z_axis is not None
    for height, remedy in (
        (settings.safe_z_height, "safe_z_height"),
        (homed_z + settings.clearance, "clearance"),
        (above_pin, "position_endstop there, travel_margin"),
    ):
        if height > high:
            raise CalibrationError(
                f"The travel height of z_calibration, z={height:.3f}, must lie"
                f" within position_max ({high:.3f}) of section"
                f" '{host.axes.z_axis.section}'; correct {remedy} in"
                " section 'z_calibration', or z_offset in section 'probe',"
                " the real distance between nozzle and probe"
            )


def notes(host: Host, settings: Settings) -> List[str]:
    """Return what the user is told at start of completed settings, empty texts among it."""
    texts = SiteFinder(host, settings).missing()
    if settings.unmeasured_pin:
        travel_z = heights.travel_height(settings, None, None)
        texts.append(
            f"until endstop_pin is touched the toolhead travels at z={travel_z:.1f}, enough"
            f" for a pin of {settings.unmeasured_pin:g} mm; where it is higher run"
            " Z_CALIBRATION_SETUP, or set safe_z_height"
        )
    texts.append(impossible(settings.target, host.axes.z_step()))
    texts.append(_position_min_note(host, settings))
    texts.append(_mesh_note(host, settings))
    return texts


def _position_min_note(host: Host, settings: Settings) -> str:
    """Return what to say of a position_min that lets the nozzle go less far than it may."""
    homed_z = settings.position_endstop
    if homed_z is None:
        return ""
    floor = homed_z - settings.travel_margin
    if settings.position_min <= floor + heights.ROUNDING:
        return ""
    return (
        f"the nozzle's touch ends at position_min ({settings.position_min:.3f}), only"
        f" {homed_z - settings.position_min:.3f} mm below position_endstop"
        f" ({homed_z:.3f}); set position_min of section"
        f" '{position_min_section(host, settings)}' to {floor:.3f} or lower"
    )


def position_min_section(host: Host, settings: Settings) -> str:
    """Return the section that position_min is of."""
    axis = host.axes.z_axis
    assert axis is not None
    is_own = settings.position_min > axis.position_min
    return host.section if is_own else axis.section


def margins_note(settings: Settings) -> str:
    """Return what to say of wide margins until a run was good; empty: nothing.

    Only then the next touches of the bed know better how low that may be.
    """
    low = settings.offset_margins[0]
    if low > -heights.BED_VARIES:
        return ""
    return (
        f"until a run was good, 'offset_margins' down to {low:g} let a probe that does"
        f" not answer be pressed {-low:g} mm into the bed; watch the first run, or write"
        " -1, 1"
    )


def _mesh_note(host: Host, settings: Settings) -> str:
    """Return what a mesh that is loaded after CALIBRATE_Z does to the gap; empty: nothing."""
    bed, zero = settings.bed_xy_position, host.transforms.mesh_zero()
    option = host.transforms.mesh_zero_option()
    if bed is None or host.printer.lookup_object("bed_mesh", None) is None:
        return ""
    if zero is None:
        return (
            f"section 'bed_mesh' has no {option}: a mesh that is loaded after"
            " CALIBRATE_Z makes the gap wrong by its height at bed_xy_position"
            f" ({bed.x:.3f}, {bed.y:.3f}); set it to that point, or load the mesh before"
        )
    if host.transforms.is_mesh_zero(bed.x, bed.y):
        return ""
    return (
        f"bed_xy_position ({bed.x:.3f}, {bed.y:.3f}) is not where the bed mesh is zero"
        f" ({zero[0]:.3f}, {zero[1]:.3f}): a mesh that is loaded after CALIBRATE_Z makes"
        " the gap wrong by its height there; load it before, leave bed_xy_position"
        f" out, or set {option} of section 'bed_mesh' to it"
    )
