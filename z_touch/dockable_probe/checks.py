# Whether the positions of [dockable_probe] lead into the dock and out of it.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import options
from ..host.endstops import PROBE_PINS
from . import detour
from .settings import (
    DOCK,
    DOUBTFUL_WAY,
    MIDDLE,
    POSITIONS,
    SAME_WAY,
    dock_height,
)

######################################################################
# While the configuration is read
######################################################################


# Before anything else: what hosts say of pins and objects that are there twice
# does not lead to the section that is too many.
def check_only_probe(config):
    for name, _pin in PROBE_PINS:
        if name != config.get_name() and config.has_section(name):
            raise config.error(
                "Section '%s': there is a [%s], too, and a printer has one"
                " probe; remove the other, also '#*# [%s]' and the lines below"
                " it at the end of printer.cfg, where SAVE_CONFIG has written"
                " them" % (config.get_name(), name, name)
            )


# Nothing goes to the dock where X and Y have the motors of Z: the way there begins with
# a lift, before X and Y are known, and homing ends where they cannot move.
def check_kinematics(config, z_axis):
    if z_axis is not None:
        return
    kinematics = config.getsection("printer").get(
        "kinematics", "", note_valid=False
    )
    why = (
        "nothing moves there"
        if kinematics == "none"
        else "that has no Z axis of its own, and the head has to be lifted on the"
        " way to the dock before all of it is homed"
    )
    raise config.error(
        "Option 'kinematics: %s' in section 'printer': %s, so dockable_probe"
        " cannot be used on this machine; remove section '%s'"
        % (kinematics, why, config.get_name())
    )


# Whether another section lifts the head before X and Y are homed: the owner knows
# better then how much room there is above.
def is_lifted_elsewhere(config):
    if config.has_section("homing_override"):
        return True
    if not config.has_section("safe_z_home"):
        return False
    section = config.getsection("safe_z_home")
    return section.getfloat("z_hop", 0.0, note_valid=False) > 0.0


# Z (mm) of the dock and its positions, as far as they have one
def low_positions(settings):
    positions = [settings.dock_position]
    positions += [getattr(settings, row.name) for row in POSITIONS]
    return [p.z for p in positions if p.z is not None] or [settings.hang]


# Whether the positions lead out of the dock, and whether detach_position strips
# the probe off; 'notes' is told where that is doubtful
def check_positions(config, settings, notes):
    if not settings.is_placed:
        notes.append(
            "nothing says where the dock is, so the probe is neither fetched nor"
            " docked; set it up with DOCKABLE_PROBE_SETUP"
        )
        return
    dock = settings.dock_position
    z = settings.approach_position.z if dock.z is None else dock.z
    if settings.dock_fixed_z:
        # No move to a position changes Z but the one that strips the probe off
        z = None
    else:
        lowest = min(low_positions(settings))
        if lowest < settings.hang:
            notes.append(
                "Z of the dock (%g) is less than the probe hangs below the nozzle"
                " (%g): where there is a bed it would be dragged over it; check"
                " the Z of the positions" % (lowest, settings.hang)
            )
    for row in POSITIONS:
        position = getattr(settings, row.name)
        if detour.first_leg(dock, z, position) == (0.0, 0.0, 0.0):
            what = "(%g, %g) is at dock_position; give a point some 40 mm away"
            raise options.config_error(config, row.name, what % position[:2])
    check_strips(config, settings, z, notes)


# Whether the probe comes off on the way to detach_position; 'z' (mm) is the height of
# the dock, None where it goes up and down with the head
def check_strips(config, settings, z, notes):
    angle = detour.strip_angle(
        settings.dock_position,
        z,
        settings.extract_position,
        settings.detach_position,
    )
    if angle >= DOUBTFUL_WAY:
        return
    same = (
        "and extract_position (approach_position unless given) are the same way"
        " out of the dock, %.0f degrees apart: the probe %s stay on the head"
        % (angle, "would" if angle < SAME_WAY else "may")
    )
    if settings.strippers:
        strippers = " or ".join(settings.strippers)
        notes.append(
            "detach_position %s, unless %s strips it off" % (same, strippers)
        )
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
            "detach_position %s; choose one that is mostly at 90 degrees" % same
        )


######################################################################
# When klippy connects
######################################################################


# An option that does not fit the printer, as klippy finds when it connects
class Misfit(Exception):
    def __init__(self, name, problem):
        Exception.__init__(self, name, problem)
        self.name = name
        self.problem = problem


# Whether the head gets to each position, and so high; 'limits' (mm) are (low,
# high) of X, Y and Z.  Raises Misfit.
def check_reach(settings, limits):
    for row in (DOCK,) + POSITIONS if settings.is_placed else ():
        position = getattr(settings, row.name)
        for axis, at, (low, high) in zip("XYZ", position, limits):
            if at is not None and not low <= at <= high:
                raise Misfit(
                    row.name,
                    "%s=%.3f is outside of %.3f to %.3f, the reach of the"
                    " axis; correct it, or the limits of the axis"
                    % (axis, at, low, high),
                )
    height, highest = dock_height(settings), limits[2][1]
    if height > highest:
        raise Misfit(
            DOCK.name,
            "the way there is at z=%.3f, above position_max (%.3f); correct its"
            " Z, z_hop or z_offset" % (height, highest),
        )


# Z is homed with the probe: whether it can be fetched before Z is homed, and
# where the head stands then; returns (x, y), or None for "where it is then".
# Raises Misfit.
def check_homing(settings, limits):
    if not settings.dock_fixed_z and settings.is_placed:
        raise Misfit(
            DOCK.name,
            "to get there Z has to be homed, and Z is homed with the probe;"
            " leave Z out of all positions, or set dock_fixed_z: True if the"
            " dock is at the head's height",
        )
    dock, radius, xy = (
        settings.dock_position,
        settings.safe_dock_distance,
        settings.home_xy,
    )
    if xy == MIDDLE:
        # The probe over the middle of the axes
        offsets = settings.x_offset, settings.y_offset
        xy = tuple(
            (low + high) / 2.0 - shift
            for (low, high), shift in zip(limits, offsets)
        )
    if xy is not None and not detour.is_within(xy, limits):
        raise Misfit(
            "safe_z_position",
            "%g, %g is outside of %.3f to %.3f and %.3f to %.3f, the reach of X"
            " and Y; choose a point of the head where the probe is over the bed"
            % (tuple(xy) + tuple(limits[0]) + tuple(limits[1])),
        )
    if xy is not None and detour.distance(xy, dock) < radius - detour.ROUNDING:
        raise Misfit(
            "safe_z_position",
            "%g, %g is %.1f mm from the dock; choose a point that is at least"
            " %.1f mm away (safe_dock_distance)"
            % (tuple(xy) + (detour.distance(xy, dock), radius)),
        )
    return xy
