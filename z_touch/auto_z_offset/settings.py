# The options of [auto_z_offset], as tables, and the record made of them.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import options
from ..options import GCODE, REQUIRED, option, site_kind, unused
from ..texture import LARGEST_SPREAD
from .heights import LARGEST_OFFSET, inside_bed, section_floor

# A smaller hop (mm) leaves an inductive probe triggered.
SMALLEST_HOP = 4.0

# XY speed (mm/s) between the sites, unless configured.
TRAVEL_SPEED = 100.0

# Corrections of one AUTO_Z_CALIBRATE that differ more (mm) are no noise.
CYCLES_TOLERANCE = 0.2


# Upper case counts, too: the original module takes it
def _read_result(config, name, row):
    result = config.get(name, row.default).lower()
    if result not in options.RESULTS:
        raise options.config_error(config, name, "must be average or median")
    return result


RESULT = options.RESULT._replace(read=_read_result)


######################################################################
# Tables
######################################################################

SENSOR_OPTIONS = (
    option(
        "pin",
        options.PIN,
        REQUIRED,
        "",
        "The MCU pin with the signal of the bed sensor.",
    ),
    option(
        "prepare_gcode",
        GCODE,
        REQUIRED,
        "",
        "Your G-code that turns the sensor on. It runs once for each command"
        " that measures, with the head over the bed. May be empty.",
    ),
    option(
        "z_offset",
        options.NUMBER,
        0.2,
        "mm",
        "The air gap, in mm, between the trigger point of the sensor and Z=0."
        " Larger: nozzle further away from the bed. It is not the z_offset of"
        " the probe.",
        minval=-LARGEST_OFFSET,
        maxval=LARGEST_OFFSET,
    ),
    option(
        "probe_z_correction",
        options.NUMBER,
        None,
        "mm",
        "The result, in mm. SAVE_CONFIG writes it.",
        minval=-LARGEST_OFFSET,
        maxval=LARGEST_OFFSET,
    ),
    option(
        "corrected_probe_z_offset",
        options.NUMBER,
        None,
        "mm",
        "The z_offset of [probe] that it was measured with. SAVE_CONFIG writes"
        " it.",
    ),
)

TRAVEL_OPTIONS = (
    option(
        "bed_xy_position",
        site_kind("bed"),
        None,
        "mm",
        "The point of the bed to measure. The default is the middle of the"
        " axes.",
    ),
    option(
        "bed_spread",
        options.NUMBER,
        0.0,
        "mm",
        "For a textured plate, such as 3: each touch of the nozzle is at another"
        " point, up to so far from there, in mm. 0: all are at that point.",
        minval=0.0,
        maxval=LARGEST_SPREAD,
    ),
    option(
        "probe_hop",
        options.NUMBER,
        SMALLEST_HOP,
        "mm",
        "How far the head is lifted to travel, in mm.",
        minval=SMALLEST_HOP,
    ),
    option(
        "probe_z_min",
        options.NUMBER,
        None,
        "mm",
        "No touch goes lower, in mm; set it about 1 mm below the bed. The"
        " default is position_min of [stepper_z].",
    ),
    option(
        "travel_speed",
        options.NUMBER,
        TRAVEL_SPEED,
        "mm/s",
        "Travel in X and Y, in mm/s.",
        above=0.0,
    ),
    option(
        "probe_accel",
        options.NUMBER,
        0.0,
        "mm/s^2",
        "Limit of acceleration while the nozzle goes down, in mm/s^2. 0: none.",
        minval=0.0,
    ),
    option(
        "z_current_factor",
        options.NUMBER,
        0.33,
        "",
        "The Z motors have this share of their current while the nozzle goes"
        " down.",
        minval=0.1,
        maxval=1.0,
    ),
)

CYCLE_OPTIONS = (
    option(
        "offset_samples",
        options.COUNT,
        3,
        "",
        "Cycles of AUTO_Z_CALIBRATE.",
        minval=1,
        maxval=options.MOST_TOUCHES,
    ),
    option(
        "cycles_tolerance",
        options.NUMBER,
        CYCLES_TOLERANCE,
        "mm",
        "How far the results of the cycles may be apart, in mm.",
        minval=0.0,
    ),
)

# For both sensors, with the names that [probe] has for them; its own are not
# used here.
SAMPLING_OPTIONS = (
    option(
        "speed",
        options.NUMBER,
        5.0,
        "mm/s",
        "Down, with sensor and probe, in mm/s.",
        above=0.0,
    ),
    option(
        "lift_speed", options.NUMBER, 20.0, "mm/s", "Up, in mm/s.", above=0.0
    ),
    option(
        "samples",
        options.COUNT,
        1,
        "",
        "Touches of sensor and probe in each cycle.",
        minval=1,
        maxval=options.MOST_TOUCHES,
    ),
    option(
        "samples_tolerance",
        options.NUMBER,
        0.1,
        "mm",
        "How far touches at one point may be apart, in mm.",
        minval=0.0,
    ),
    option(
        "samples_tolerance_retries",
        options.COUNT,
        0,
        "",
        "How often touches may start again.",
        minval=0,
        maxval=options.MOST_TOUCHES,
    ),
    option(
        "samples_result",
        RESULT,
        "average",
        "",
        "average or median, of touches and of cycles.",
    ),
    option(
        "sample_retract_dist",
        options.NUMBER,
        3.0,
        "mm",
        "Lift between two touches, in mm.",
        above=0.0,
    ),
)

OPTIONS = SENSOR_OPTIONS + TRAVEL_OPTIONS + CYCLE_OPTIONS + SAMPLING_OPTIONS

NOZZLE_ITSELF = "is ignored: the nozzle itself presses the bed"

# Of the original module: why each is not used.
UNUSED_OPTIONS = (
    unused(
        "calibrated_z_offset",
        "is not applied: it contains the whole z_offset of the probe; run"
        " AUTO_Z_CALIBRATE again, then SAVE_CONFIG",
    ),
    unused("x_offset", NOZZLE_ITSELF),
    unused("y_offset", NOZZLE_ITSELF),
    unused("activate_gcode", "is not run; move it into prepare_gcode"),
    unused(
        "deactivate_gcode",
        "is not run; move it into a macro that runs after AUTO_Z_CALIBRATE",
    ),
    unused("deactivate_on_each_sample", "is ignored"),
    unused("stow_on_each_sample", "is ignored"),
    unused("recovery_time", "is ignored; end prepare_gcode with G4 instead"),
)


######################################################################
# The record
######################################################################

# What becomes the field 'sampling'
SAMPLING = [row.name for row in options.PROBE_OPTIONS]

# mm, mm/s and mm/s^2; bed_xy_position is None for the middle of the axes.
#
#   sampling             what the options of sampling become
#   floor                heights.Floor, the lowest point of all touches
#   unused               what is given of UNUSED_OPTIONS, by their names
#   lost_activate_gcode  the G-code is given that powered the sensor with the
#                        original module
#   is_others            calibrated_z_offset is given and z_offset is below 0: the
#                        section of the original module, as it was
Settings = options.record(
    "Settings",
    [row for row in OPTIONS if row.name not in SAMPLING],
    also="sampling floor unused lost_activate_gcode is_others",
)


def read_settings(config, z_axis):
    values = options.read(config, OPTIONS)
    unused = options.read(config, UNUSED_OPTIONS)
    values.update(
        sampling=options.sampling_of(values),
        floor=section_floor(z_axis, values["probe_z_min"]),
        unused=unused,
        lost_activate_gcode=bool(unused["activate_gcode"]),
        is_others=values["z_offset"] < 0.0
        and bool(unused["calibrated_z_offset"]),
    )
    return Settings(**{name: values[name] for name in Settings._fields})


# What the user is told of his section when klippy is ready
def settings_notes(settings):
    notes = options.unused_notes(settings.unused, UNUSED_OPTIONS)
    probe_z_min, floor = settings.probe_z_min, settings.floor
    if probe_z_min is not None and probe_z_min < floor.z:
        notes.append(
            "'probe_z_min: %g' is ignored, %s is %g"
            % (probe_z_min, floor.why, floor.z)
        )
    note = inside_bed(settings.z_offset)
    return notes + [note] if note else notes
