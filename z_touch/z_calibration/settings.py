# The options of [z_calibration] as a table, and the settings that come of them.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# A new option is one row in OPTIONS, its use, and one test.  The settings have a
# field for each row, but for those of SAMPLING, which become the fields 'pin'
# and 'probe'.

from ..core import options, pin_options, touching, z_pin
from ..core.endstops import chip_of
from ..core.errors import CalibrationError
from ..core.options import option
from ..core.sampling import filled
from ..core.spread import LARGEST_SPREAD
from ..core.templates import GCODE
from ..uncertainty import adaptive
from . import heights, hooks

# Results outside these limits (mm) are refused: the homing is outdated or
# something was touched that should not have been.
OFFSET_MARGINS = (-1.0, 1.0)

# How far (mm) below the expected height a touch may still look.
TRAVEL_MARGIN = 1.0

# So high (mm) a pin of its own may stand that nobody has measured; the probe
# passes it before the nozzle touches it.
UNMEASURED_PIN = 10.0

# Lift (mm) between two touches where homing_retract_dist is 0, which is
# right for homing only: without a lift the next touch starts on a pressed
# switch.  2 mm is more than the hysteresis of any common micro switch.
FALLBACK_RETRACT = 2.0

# XY speed (mm/s) between the sites, but for CALIBRATE_Z, see pace.py
IDLE_TRAVEL_SPEED = 50.0

# What the offset may be off by (mm, 95 %) with samples: auto
TARGET_UNCERTAINTY = 0.008

# What it may be off by with samples: auto and bed_spread (mm, 95 %): what six touches
# of a rough plate are worth
ROUGH_TARGET = 0.014

# Beside printer.cfg
FOLDER = "z_calibration"
RUNS = 1000

# Whether the buttons that save the Z offset save into switch_offset
SAVE_BUTTON = {"off": False, "switch_offset": True}

######################################################################
# Kinds of options that only this section has
######################################################################


def _read_shift(config, name, row):
    shift = options.pair(config, name)
    return shift if shift and any(shift) else None


# A folder; None: there is to be none
def _read_folder(config, name, row):
    folder = config.get(name, row.default).strip()
    if not folder:
        raise options.config_error(config, name, "is no folder, nor none")
    return None if folder.lower() == "none" else folder


# A distance in X and Y; none at all counts as not given
SHIFT = options.PAIR._replace(read=_read_shift)
HISTORY = options.Kind("folder", _read_folder, ("", " "))

######################################################################
# The table
######################################################################


def mm_option(name, default, text, old=(), **limits):
    return option(name, options.NUMBER, default, "mm", text, old, **limits)


def speed_option(name, default, text, old=()):
    kind = options.NUMBER
    return option(name, kind, default, "mm/s", text, old, above=0.0)


# A row as [probe] has it, but for its default
def probe_option(name, text, **changes):
    (row,) = [row for row in options.PROBE_OPTIONS if row.name == name]
    return row._replace(default=None, text=text, **changes)


# Where the default is None it matters whether there is anything to run.
def gcode_option(name, default, text):
    return option(name, GCODE, default, "", text)


POSITIONS = (
    pin_options.NOZZLE_POSITION,
    touching.site_option(
        "switch_xy_position",
        "X, Y of the head when the body of the probe's switch is above the same"
        " pin, with its flat side beside the plunger.",
    ),
    option(
        "switch_xy_offsets",
        options.PAIR,
        None,
        "mm",
        "Instead of switch_xy_position: the way from the nozzle position to it,"
        " in mm. There is no default.",
    ),
    touching.site_option(
        "bed_xy_position",
        "The point of the bed that the probe touches. The default is"
        " zero_reference_position of [bed_mesh].",
    ),
    mm_option(
        "bed_spread",
        0.0,
        "For a textured plate, such as 3: each touch of the bed is at another"
        " point, up to so far from there, in mm. 0: all are at that point.",
        minval=0.0,
        maxval=LARGEST_SPREAD,
    ),
    option(
        "wiggle_xy_offsets",
        SHIFT,
        None,
        "mm",
        "Moves the head by so much and back after each touch of the nozzle, for"
        " a pin that sticks to it. There is no default.",
    ),
)

RESULT = (
    mm_option(
        "switch_offset",
        None,
        "How far the plunger still sticks out of the switch body when the switch"
        " triggers, in mm. Larger: nozzle closer to the bed.",
        minval=0.0,
    ),
    option(
        "save_button",
        options.choice(SAVE_BUTTON),
        "off",
        "",
        "What the button that saves the Z offset does after a CALIBRATE_Z. off:"
        " the same as without this module. switch_offset: it keeps baby steps"
        " there.",
    ),
    option(
        "offset_margins",
        options.MARGINS,
        OFFSET_MARGINS,
        "mm",
        "An offset (in mm) outside of these is refused.",
        old=("max_deviation",),
    ),
)

HEIGHTS = (
    option(
        "safe_z_height",
        options.NUMBER,
        None,
        "mm",
        "The head travels at least so high, in mm. The default is twice the"
        " z_offset of [probe].",
        above=0.0,
    ),
    mm_option(
        "clearance",
        0.0,
        "The head is lifted by at least this after each touch, in mm.",
        minval=0.0,
    ),
    mm_option(
        "travel_margin",
        TRAVEL_MARGIN,
        "How much lower than expected a touch may go, and how much room is left"
        " below the head on its way, in mm.",
        above=0.0,
    ),
    mm_option(
        "position_min",
        None,
        "No touch goes lower, in mm. The default is position_min of"
        " [stepper_z].",
    ),
    pin_options.ENDSTOP_PIN,
)

# What is left out of these is as in [probe]; two have other names than there.
SAMPLING = (
    "probing_second_speed",
    "probing_retract_dist",
    "lift_speed",
    "samples",
    "samples_tolerance",
    "samples_tolerance_retries",
    "samples_result",
)

SPEEDS = (
    speed_option(
        "speed",
        IDLE_TRAVEL_SPEED,
        "Travel in X and Y, in mm/s. In CALIBRATE_Z the default is 100.",
    ),
    speed_option(
        "probing_speed",
        None,
        "The quick part of the way down, in mm/s. The default is homing_speed of"
        " [stepper_z]; in CALIBRATE_Z it is that of lift_speed, slower where half of"
        " travel_margin would not be enough to stop.",
        old=("homing_speed",),
    ),
    speed_option(
        "probing_second_speed",
        None,
        "The touches that count, in mm/s. The default is second_homing_speed of"
        " [stepper_z]; on the bed it is speed of [probe].",
        old=("second_homing_speed",),
    ),
    mm_option(
        "probing_retract_dist",
        None,
        "Lift between two touches, in mm. In CALIBRATE_Z the default is as short as"
        " the switch opens, 0.5 or more. Otherwise it is homing_retract_dist of"
        " [stepper_z], on the bed sample_retract_dist of [probe].",
        old=("homing_retract_dist",),
        above=0.0,
    ),
    probe_option(
        "lift_speed",
        "All ways up, in mm/s. The default is that of [probe]; in CALIBRATE_Z it is"
        " homing_speed of [stepper_z] where that is larger.",
    ),
    option(
        "probing_first_fast",
        options.FLAG,
        False,
        "",
        "True: the first touch at each place is made at probing_speed and does"
        " not count.",
    ),
    probe_option(
        "samples",
        "Touches at each place, or auto: as many as are needed. The default"
        " is that of [probe].",
        kind=options.SAMPLES,
    ),
    mm_option(
        "target_uncertainty",
        options.Given("bed_spread", ROUGH_TARGET, TARGET_UNCERTAINTY),
        "With samples: auto, what the offset may be off by, in mm. With"
        " bed_spread the default is 0.014.",
        above=0.0,
    ),
    probe_option(
        "samples_tolerance",
        "How far touches may be apart, in mm. The default is that of [probe].",
    ),
    probe_option(
        "samples_tolerance_retries",
        "How often they may start again. The default is that of [probe].",
    ),
    probe_option(
        "samples_result",
        "median or average. The default is that of [probe]; none, which the"
        " original has by default, is the same as that.",
        kind=options.choice(dict(options.RESULTS, none=None)),
    ),
)

KEPT = (
    option(
        "history",
        HISTORY,
        FOLDER,
        "",
        "The folder, beside printer.cfg, that keeps a line for each run. none:"
        " nothing is kept.",
    ),
    option(
        "history_runs",
        options.COUNT,
        RUNS,
        "",
        "How many lines it keeps.",
        minval=1,
    ),
    option(
        "history_times",
        options.FLAG,
        True,
        "",
        "False: its lines do not say when that was.",
    ),
)

USER_GCODE = (
    gcode_option(
        "start_gcode",
        "",
        "Your macro that attaches the probe.",
    ),
    gcode_option(
        "clean_gcode",
        None,
        "Runs once in a run, if something seems to stick to the nozzle. There is"
        " no default.",
    ),
    gcode_option(
        "before_switch_gcode",
        "",
        "Runs between nozzle and switch: attach the probe here, and not in"
        " start_gcode, where it is in the way of the nozzle. There is no"
        " default.",
    ),
    gcode_option(
        "end_gcode",
        "",
        "Your macro that puts the probe away; it runs after an error, too.",
    ),
    gcode_option(
        "offset_gcode",
        None,
        "Runs instead of SET_GCODE_OFFSET, with the offset as params.Z. There is"
        " no default.",
    ),
    gcode_option(
        "error_gcode",
        None,
        "Runs last after an error, with the message as params.ERROR. There is no"
        " default.",
    ),
)

OPTIONS = POSITIONS + RESULT + HEIGHTS + SPEEDS + KEPT + USER_GCODE

######################################################################
# The settings
######################################################################

# mm and mm/s.  None stands for "as the probe has it" until complete() has filled
# it in, and for a site or a switch_offset that is to come with the command.
#
#   pin, probe           sampling.Sampling of what is touched on the pin, and of
#                        the bed
#   counting             how many touches that are: adaptive.FixedCount, or
#                        adaptive.Automatic with samples: auto
#   may_attach_late      before_switch_gcode may attach the probe, or does so with
#                        a dockable_probe by itself
#   start_homes          start_gcode homes
#   position_endstop     toolhead Z at which the pin stops Z in homing; None: the
#                        pin is not what Z is homed on
#   position_max         of the Z axis
#   z_offset             of the probe
#   unmeasured_pin       how high the pin is taken for until it was touched
#   mesh_area            what the bed mesh covers, see z_pin
#   z_speed              of a CALIBRATE_Z: how fast Z moves where nothing is touched;
#                        None: it is another command
#   said                 the names of those options that its owner has given, or the
#                        command
Settings = options.record(
    "Settings",
    [row for row in OPTIONS if row.name not in SAMPLING],
    "pin probe counting may_attach_late start_homes position_endstop position_max"
    " z_offset unmeasured_pin mesh_area said z_speed",
)


# As far as they are known before klippy connects; what the user is to be told is
# in old_names.
def read_settings(config, z_axis, old_names):
    defaults = {"probing_speed": z_axis.homing_speed}
    defaults["probing_second_speed"] = z_axis.second_homing_speed
    defaults["probing_retract_dist"] = (
        z_axis.homing_retract_dist or FALLBACK_RETRACT
    )
    values = options.read(config, OPTIONS, old_names, **defaults)
    counting = adaptive.choose(values["samples"], values["target_uncertainty"])
    note_idle_options(counting, old_names)
    homed_z, site = None, values["nozzle_xy_position"]
    if values["endstop_pin"] is None:
        # None also where it is the probe that Z is homed with: refused later
        homed_z = z_axis.position_endstop
        values["nozzle_xy_position"] = site or read_home(config)
    values["position_min"] = limit_position_min(
        config,
        values["position_min"],
        z_axis,
        homed_z,
        values["travel_margin"],
        old_names,
    )
    values["samples"] = counting.count
    pin, probe = samplings_of(values, old_names)
    values.update(hooks.read_texts(config))
    values.update(pin=pin, probe=probe, counting=counting)
    values["position_endstop"] = homed_z
    values["mesh_area"] = z_pin.mesh_area(config)
    values["said"] = frozenset(
        row.name for row in OPTIONS if old_names.was_given(row.name)
    )
    return Settings(*[values.get(name) for name in Settings._fields])


# Where Z is homed on the pin itself, [safe_z_home] has its site.
def read_home(config):
    if not config.has_section("safe_z_home"):
        return None
    name, home = "home_xy_position", config.getsection("safe_z_home")
    point = home.getfloatlist(name, None, count=2, note_valid=False)
    return point and touching.option_site(home, "nozzle", name, point)


# Of the pin and of the bed; for the bed only what is given, the rest is as the
# probe has it.
def samplings_of(values, old_names):
    speed, retract = "probing_second_speed", "probing_retract_dist"
    pin = options.sampling_of(
        dict(values, speed=values[speed], sample_retract_dist=values[retract])
    )
    has = old_names.was_given
    probe = pin._replace(
        speed=pin.speed if has(speed) else None,
        retract_dist=pin.retract_dist if has(retract) else None,
    )
    return pin, probe


def limit_position_min(config, lowest, z_axis, homed_z, margin, old_names):
    position_min, section = z_axis.position_min, z_axis.section
    if lowest is not None and lowest < position_min:
        old_names.notes.append(
            "option 'position_min: %g' is ignored, section '%s' ends at %g"
            % (lowest, section, position_min)
        )
    elif lowest is not None and lowest > position_min:
        position_min, section = lowest, config.get_name()
    is_homed_on = homed_z is not None and chip_of(z_axis.endstop_pin) != "probe"
    if is_homed_on and homed_z - position_min < heights.LEAST_ROOM:
        raise config.error(
            "Option 'position_min' in section '%s': %.3f leaves no touch the room to"
            " press the pin at position_endstop (%.3f) of section '%s'; set it to"
            " %.3f or lower"
            % (section, position_min, homed_z, z_axis.section, homed_z - margin)
        )
    return position_min


# Options that count for nothing, as samples is auto, or is not
def note_idle_options(counting, old_names):
    for name in counting.idle:
        if old_names.was_given(name):
            text = "option '%s' is ignored %s 'samples: auto'"
            old_names.notes.append(text % (name, counting.idle_how))


# Lets the probe and the axis decide what the user has left open.  'probe':
# sampling.Sampling; mm.
def complete(settings, probe, z_offset, position_max):
    settings = settings._replace(
        pin=filled(settings.pin, probe),
        probe=filled(settings.probe, probe),
        z_offset=z_offset,
        position_max=position_max,
    )
    if settings.safe_z_height is not None:
        return settings._replace(unmeasured_pin=0.0)
    # Perhaps with the probe on
    is_passed = settings.position_endstop is None
    return settings._replace(
        safe_z_height=heights.default_safe_z(z_offset),
        unmeasured_pin=UNMEASURED_PIN if is_passed else 0.0,
    )


# The settings with a fixed number of touches: 'pin' and 'probe' are the samplings
def with_counts(settings, pin, probe):
    counting = adaptive.FixedCount()
    return settings._replace(pin=pin, probe=probe, counting=counting)


# Parameters of a command, and the options that they stand for
PACE_PARAMS = (
    ("SAMPLE_RETRACT_DIST", "probing_retract_dist"),
    ("LIFT_SPEED", "lift_speed"),
)


# The settings with what PROBE takes as parameters; they count at all places.
def param_touches(gcmd, settings):
    count, counting = options.param_samples(gcmd), settings.counting
    pin, probe = [
        options.param_touches(gcmd, sampling)
        for sampling in (settings.pin, settings.probe)
    ]
    if count is not None:
        counting = adaptive.choose(count, settings.target_uncertainty)
    if counting.count is not None:
        pin = pin._replace(samples=counting.count)
        probe = probe._replace(samples=counting.count)
    said = settings.said.union(
        option for name, option in PACE_PARAMS if gcmd.get(name, "").strip()
    )
    return settings._replace(pin=pin, probe=probe, counting=counting, said=said)


# Of these parameters, those that count for nothing
def idle_params(gcmd, settings):
    if not settings.counting.is_free:
        return []
    names = [name.upper() for name in settings.counting.idle]
    return [name for name in names if gcmd.get(name, "").strip()]


# VERBOSE of a command: whether it tells every single touch
def param_verbose(gcmd):
    return bool(options.param_int(gcmd, "VERBOSE", 0, minval=0, maxval=1))


# ACCEPT_CHANGE of a command: pin, bed or plate was changed
def param_accept_change(gcmd):
    value = options.param_int(gcmd, "ACCEPT_CHANGE", 0, minval=0, maxval=1)
    return bool(value)


# PLATE of a command: the owner's name of it, in any case of its letters
def param_plate(gcmd):
    return " ".join(gcmd.get("PLATE", "").lower().split())


# SWITCH_OFFSET of a command (mm), or else 'default', or else the user is asked
def param_switch_offset(gcmd, default):
    value = options.param_number(gcmd, "SWITCH_OFFSET", default, minval=0.0)
    if value is None:
        raise CalibrationError(
            "no switch_offset; run Z_CALIBRATION_SETUP, set it in section"
            " 'z_calibration', or add SWITCH_OFFSET=mm"
        )
    return value
