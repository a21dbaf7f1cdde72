# What is wrong with a set-up, or worth telling, when klippy connects.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from ..core.errors import CalibrationError
from . import heights
from .sites import SiteFinder


# Raises the error of a configuration whose probe cannot press the pin.
def check_probe(host):
    for name in ("bltouch", "smart_effector"):
        # Neither has a switch body, and on a touch without the host's own
        # procedure the pin of a bltouch would be retracted.
        if host.printer.lookup_object(name, None) is not None:
            raise host.printer.config_error(
                "Section '%s': this probe has no switch body to press the"
                " Z endstop with; z_calibration needs a switch as [probe]"
                % (name,)
            )
    if host.probing.probe is None or host.probing.endstop() is None:
        raise host.printer.config_error(
            "Section 'probe' is missing, or no switch on an endstop pin"
            " that stops the Z motors; z_calibration needs a [probe] with a"
            " switch that can press the Z endstop"
        )


# klipper-toolchanger shifts Z by what the section of the tool on the toolhead says,
# below the G-code offset, which would then hold it a second time.  Raises
# CalibrationError.
def check_tool_offset(host):
    for name, shift in host.active_tools():
        if shift:
            raise CalibrationError(
                "gcode_z_offset of section '%s' is %.3f and that tool is active:"
                " CALIBRATE_Z measures what its nozzle needs, so it would count"
                " twice; set it to 0 there" % (name, shift)
            )


# Raises CalibrationError.  'settings' are completed.
def check_settings(host, settings):
    result = settings.probe.result
    if result not in ("median", "average"):
        raise CalibrationError(
            "Option 'samples_result: %s' in section 'probe' is not known to"
            " z_calibration; set it to median or average" % (result,)
        )
    check_travel_heights(host, settings)
    SiteFinder(host, settings).check()


# Both must fit, the one that the user wants and the one that the pin needs
def check_travel_heights(host, settings):
    high, homed_z = settings.position_max, settings.position_endstop or 0.0
    unlimited = settings._replace(position_max=float("inf"))
    above_pin = heights.travel_height(unlimited, homed_z, None)
    for height, remedy in (
        (settings.safe_z_height, "safe_z_height"),
        (homed_z + settings.clearance, "clearance"),
        (above_pin, "position_endstop there, travel_margin"),
    ):
        if height > high:
            raise CalibrationError(
                "The travel height of z_calibration, z=%.3f, must lie"
                " within position_max (%.3f) of section '%s'; correct %s in"
                " section 'z_calibration', or z_offset in section 'probe',"
                " the real distance between nozzle and probe"
                % (height, high, host.axes.z_axis.section, remedy)
            )


# What the user is told at start, empty texts among it; 'settings' are completed.
def notes(host, settings):
    for text in SiteFinder(host, settings).missing():
        yield text
    if settings.unmeasured_pin:
        travel_z = heights.travel_height(settings, None, None)
        yield (
            "until endstop_pin is touched the head travels at z=%.1f, enough"
            " for a pin of %g mm; where it is higher run"
            " Z_CALIBRATION_SETUP, or set safe_z_height"
            % (travel_z, settings.unmeasured_pin)
        )
    yield settings.counting.impossible(host.axes.z_step())
    yield position_min_note(host, settings)
    yield mesh_note(host, settings)


# A position_min that lets the nozzle's touch go less far down than it may; empty: it
# does not
def position_min_note(host, settings):
    homed_z = settings.position_endstop
    if homed_z is None:
        return ""
    floor = homed_z - settings.travel_margin
    if settings.position_min <= floor + heights.ROUNDING:
        return ""
    return (
        "the nozzle's touch ends at position_min (%.3f), only %.3f mm below"
        " position_endstop (%.3f); set position_min of section '%s' to %.3f or lower"
        % (
            settings.position_min,
            homed_z - settings.position_min,
            homed_z,
            position_min_section(host, settings),
            floor,
        )
    )


# The section that position_min is of
def position_min_section(host, settings):
    axis = host.axes.z_axis
    is_own = settings.position_min > axis.position_min
    return host.section if is_own else axis.section


# Until a run was good, no touch of the bed knows better how low that may be.  Empty:
# with these margins it ends soon enough
def margins_note(settings):
    low = settings.offset_margins[0]
    if low > -heights.BED_VARIES:
        return ""
    return (
        "until a run was good, 'offset_margins' down to %g let a probe that does not"
        " answer be pressed %g mm into the bed; watch the first run, or write -1, 1"
        % (low, -low)
    )


# What a mesh that is loaded after CALIBRATE_Z does to the gap; empty: nothing
def mesh_note(host, settings):
    bed, zero = settings.bed_xy_position, host.features.mesh_zero()
    option = host.features.mesh_zero_option()
    if bed is None or host.printer.lookup_object("bed_mesh", None) is None:
        return ""
    if zero is None:
        return (
            "section 'bed_mesh' has no %s: a mesh that is loaded after"
            " CALIBRATE_Z makes the gap wrong by its height at bed_xy_position"
            " (%.3f, %.3f); set it to that point, or load the mesh before"
            % (option, bed.x, bed.y)
        )
    if host.features.is_mesh_zero(bed.x, bed.y):
        return ""
    return (
        "bed_xy_position (%.3f, %.3f) is not where the bed mesh is zero"
        " (%.3f, %.3f): a mesh that is loaded after CALIBRATE_Z makes the gap"
        " wrong by its height there; load it before, leave bed_xy_position"
        " out, or set %s of section 'bed_mesh' to it"
        % (bed.x, bed.y, zero[0], zero[1], option)
    )
