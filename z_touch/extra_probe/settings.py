# The options of [extra_probe NAME], as tables, and the records made of them.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import options
from ..options import GCODE, REQUIRED, option, site_kind
from ..sampling import filled

# The name of a section whose switch is [probe]
PROBE = "probe"

SAFE_Z = 10.0  # mm: room for a hand, and above a bed that is homed wrongly
MAX_TEMPERATURE = 120.0  # C; a nozzle that is hotter is refused


######################################################################
# Tables
######################################################################

# Of a switch on a pin of its own; [extra_probe probe] has none of these.
SWITCH_OPTIONS = (
    option("pin", options.PIN, REQUIRED, "", "The MCU pin of the switch."),
    option(
        "activate_gcode",
        GCODE,
        "",
        "",
        "Runs before each touch, and must not move the head. There is no"
        " default.",
    ),
    option(
        "deactivate_gcode",
        GCODE,
        "",
        "",
        "Runs after each touch, and must not move the head. There is no"
        " default.",
    ),
    option(
        "deactivate_on_each_sample",
        options.FLAG,
        True,
        "",
        "False: both run once, before the first and after the last touch.",
    ),
)

# In [extra_probe probe] the defaults of z_offset and of the options of sampling are
# what the probe has, see complete().
CALIBRATION_OPTIONS = (
    option(
        "z_offset",
        options.NUMBER,
        0.0,
        "mm",
        "How thick the switch is when it triggers, in mm. EXTRA_PROBE_CALIBRATE"
        " needs it: 0.25 or 0.3, by the data sheet.",
        minval=0.0,
    ),
    option(
        "xy_position",
        site_kind("switch"),
        None,
        "mm",
        "Where the nozzle touches. By default it is where the head is.",
    ),
    option(
        "safe_z_height",
        options.NUMBER,
        SAFE_Z,
        "mm",
        "The head is lifted so high, at least, before it travels there, in mm.",
        above=0.0,
    ),
    option(
        "position_min",
        options.NUMBER,
        None,
        "mm",
        "No touch goes lower, in mm. There is no default: see How low can a"
        " touch go?",
    ),
    option(
        "max_temperature",
        options.NUMBER,
        MAX_TEMPERATURE,
        "C",
        "A hotter nozzle is refused, in degrees Celsius.",
        above=0.0,
    ),
    option(
        "saved_homing_z",
        options.NUMBER,
        None,
        "mm",
        "Written by SAVE_CONFIG; leave it alone.",
    ),
)

# Of the other sections: what lies on the tips of a textured plate covers what is
# between them, so that one point is as good as many.
REFUSED_OPTIONS = (
    options.refused(
        "bed_spread", "is not needed, as the switch covers texture; remove it"
    ),
)

SAMPLING_OPTIONS = options.PROBE_OPTIONS
OPTIONS = SWITCH_OPTIONS + SAMPLING_OPTIONS + CALIBRATION_OPTIONS


######################################################################
# Records
######################################################################

# What every such section has, with what its options of sampling become.  None is
# not given.
Settings = options.record("Settings", CALIBRATION_OPTIONS, also="sampling")

# What a switch on a pin of its own has besides; the G-code as templates
SwitchSettings = options.record("SwitchSettings", SWITCH_OPTIONS)


def read_switch_settings(config):
    return SwitchSettings(**options.read(config, SWITCH_OPTIONS))


def read_settings(config):
    options.read(config, REFUSED_OPTIONS)
    rows, defaults = SAMPLING_OPTIONS + CALIBRATION_OPTIONS, {}
    if config.get_name().split()[-1] == PROBE:
        names = [row.name for row in SAMPLING_OPTIONS]
        defaults = dict.fromkeys(names + ["z_offset"])
    values = options.read(config, rows, **defaults)
    values["sampling"] = options.sampling_of(values)
    return Settings(**{name: values[name] for name in Settings._fields})


# Lets the probe decide what the owner of [extra_probe probe] has left open.
# 'sampling', 'z_offset' (mm): of the probe
def complete(settings, sampling, z_offset):
    settings = settings._replace(sampling=filled(settings.sampling, sampling))
    if settings.z_offset is None:
        settings = settings._replace(z_offset=z_offset)
    return settings
