"""Whether the positions of [dockable_probe] lead into the dock and out of it.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, List, Optional

from .. import options
from ..host.endstops import PROBE_PINS
from . import path
from .settings import DOCK, DOUBTFUL_WAY, MIDDLE, SAME_WAY

if TYPE_CHECKING:
    from ..host.klippy import Config
    from ..host.toolhead import ZAxis
    from .settings import Settings


######################################################################
# While the configuration is read
######################################################################


def check_only_probe(config: Config) -> None:
    """Raise the error of a configuration where another section is a probe.

    Before anything else: what hosts say of pins and objects that are there twice does not
    lead to the section that is too many.
    """
    for name, _pin in PROBE_PINS:
        if name != config.get_name() and config.has_section(name):
            raise config.error(
                f"Section '{config.get_name()}': there is a [{name}], too, and a"
                f" printer has one probe; remove the other, also '#*# [{name}]' and"
                " the lines below it at the end of printer.cfg, where SAVE_CONFIG"
                " has written them"
            )


def check_kinematics(config: Config, z_axis: Optional[ZAxis]) -> None:
    """Raise the error of a configuration for a machine without a Z axis of its own.

    Nothing goes to the dock where X and Y have the motors of Z: the way there begins with a
    lift, before X and Y are known, and homing ends where they cannot move.
    """
    if z_axis is not None:
        return
    section = config.getsection("printer")
    kinematics = section.get("kinematics", "", note_valid=False)
    why = (
        "nothing moves there"
        if kinematics == "none"
        else "that has no Z axis of its own, and the toolhead has to be lifted on the"
        " way to the dock before all of it is homed"
    )
    raise config.error(
        f"Option 'kinematics: {kinematics}' in section 'printer': {why}, so"
        " dockable_probe cannot be used on this machine; remove section"
        f" '{config.get_name()}'"
    )


def is_lifted_elsewhere(config: Config) -> bool:
    """Return whether another section lifts the toolhead before X and Y are homed.

    The user knows better then how much room there is above.
    """
    if config.has_section("homing_override"):
        return True
    if not config.has_section("safe_z_home"):
        return False
    section = config.getsection("safe_z_home")
    z_hop: float = section.getfloat("z_hop", 0.0, note_valid=False)
    return z_hop > 0.0


def check_positions(
    config: Config, settings: Settings, notes: List[str]
) -> None:
    """Raise the error of a configuration unless the positions lead out of the dock.

    'notes' is told of what is doubtful.
    """
    if not settings.is_placed:
        notes.append(
            "nothing says where the dock is, so the probe is neither fetched nor"
            " docked; set it up with DOCKABLE_PROBE_SETUP"
        )
        return
    dock, positions = settings.dock_position, settings.positions
    # No move to a position changes Z but the one that strips the probe off
    z = None
    if not settings.dock_fixed_z:
        z = settings.approach_position.z if dock.z is None else dock.z
        places = [dock, *positions.values()]
        lowest = min([p.z for p in places if p.z is not None])
        if lowest < settings.length:
            notes.append(
                f"Z of the dock ({lowest:g}) is less than the probe hangs below the"
                f" nozzle ({settings.length:g}): where there is a bed it would be"
                " dragged over it; check the Z of the positions"
            )
    for name, position in positions.items():
        if path.first_leg(dock, z, position) == (0.0, 0.0, 0.0):
            what = (
                f"({position.x:g}, {position.y:g}) is at dock_position; give a point"
                " some 40 mm away"
            )
            raise options.config_error(config, name, what)
    _check_strips(config, settings, z, notes)


def _check_strips(
    config: Config, settings: Settings, z: Optional[float], notes: List[str]
) -> None:
    """Look whether the probe comes off on the way to detach_position.

    'z' (mm) is the height of the dock, None where it goes up and down with the toolhead.
    """
    angle = path.strip_angle(
        settings.dock_position,
        z,
        settings.extract_position,
        settings.detach_position,
    )
    if angle >= DOUBTFUL_WAY:
        return
    would = "would" if angle < SAME_WAY else "may"
    same = (
        "and extract_position (approach_position unless given) are the same way"
        f" out of the dock, {angle:.0f} degrees apart: the probe {would} stay on"
        " the toolhead"
    )
    if settings.strippers:
        named = " or ".join(settings.strippers)
        notes.append(f"detach_position {same}, unless {named} strips it off")
    elif angle < SAME_WAY:
        raise options.config_error(
            config,
            "detach_position",
            same
            + "; choose one that strips it off, mostly at 90 degrees, or give"
            " detach_gcode with the moves that do, such as 'detach_gcode: G1 Z1"
            " F600'",
        )
    else:
        notes.append(
            f"detach_position {same}; choose one that is mostly at 90 degrees"
        )


######################################################################
# When klippy connects
######################################################################


class Misfit(Exception):
    """An option that does not fit the printer, as klippy finds when it connects."""

    def __init__(self, name: str, problem: str):
        Exception.__init__(self, name, problem)
        self.name = name
        self.problem = problem


def check_reach(settings: Settings, limits: path.Limits) -> None:
    """Raise Misfit unless the toolhead gets to each position, and so high.

    'limits' (mm) are (low, high) of X, Y and Z.
    """
    positions = {DOCK: settings.dock_position, **settings.positions}
    for name, position in positions.items() if settings.is_placed else ():
        for axis, at, (low, high) in zip("XYZ", position, limits):
            if at is not None and not low <= at <= high:
                raise Misfit(
                    name,
                    f"{axis}={at:.3f} is outside of {low:.3f} to {high:.3f}, the"
                    " reach of the axis; correct it, or the limits of the axis",
                )
    way_z, highest = settings.way_z, limits[2][1]
    if way_z > highest:
        raise Misfit(
            DOCK,
            f"the way there is at z={way_z:.3f}, above position_max ({highest:.3f});"
            " correct its Z, z_hop or z_offset",
        )


def check_homing(
    settings: Settings, limits: path.Limits
) -> Optional[path.Point]:
    """Return where the toolhead stands while Z is homed with the probe.

    None: where it is then.  Raises Misfit where the probe cannot be fetched before Z is
    homed, or there.
    """
    if not settings.dock_fixed_z and settings.is_placed:
        raise Misfit(
            DOCK,
            "to get there Z has to be homed, and Z is homed with the probe;"
            " leave Z out of all positions, or set dock_fixed_z: True if the"
            " dock is at the toolhead's height",
        )
    wanted = settings.home_xy
    if wanted is None:
        return None
    if isinstance(wanted, tuple):
        xy = wanted
    else:
        # MIDDLE: the probe over the middle of the axes
        assert wanted == MIDDLE
        offsets = settings.x_offset, settings.y_offset
        x, y = (
            (low + high) / 2.0 - shift
            for (low, high), shift in zip(limits, offsets)
        )
        xy = x, y
    if not path.is_within(xy, limits):
        (low_x, high_x), (low_y, high_y) = limits[:2]
        raise Misfit(
            "safe_z_position",
            f"{xy[0]:g}, {xy[1]:g} is outside of {low_x:.3f} to {high_x:.3f} and"
            f" {low_y:.3f} to {high_y:.3f}, the reach of X and Y; choose a point of"
            " the toolhead where the probe is over the bed",
        )
    apart = path.distance(xy, settings.dock_position)
    radius = settings.safe_dock_distance
    if apart < radius - path.ROUNDING:
        raise Misfit(
            "safe_z_position",
            f"{xy[0]:g}, {xy[1]:g} is {apart:.1f} mm from the dock; choose a point"
            f" that is at least {radius:.1f} mm away (safe_dock_distance)",
        )
    return xy
