# Options and parameters that the host's own getters cannot read.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import functools
import math

from .sampling import AUTO, Sampling

RESULTS = {"median": "median", "average": "average", None: None}


def is_finite(value):
    return not (math.isnan(value) or math.isinf(value))


def config_error(config, name, what):
    text = "Option '%s' in section '%s' %s"
    return config.error(text % (name, config.get_name(), what))


# The host reads 'nan' and 'inf' as numbers, which no limit catches.
def number(config, name, default=None, **limits):
    value = config.getfloat(name, default, **limits)
    if value is not None and not is_finite(value):
        raise config_error(config, name, "is not a finite number")
    return value


# A count, AUTO, or None where it is not given
def samples(config):
    if config.get("samples", "").strip().lower() == AUTO:
        return AUTO
    return config.getint("samples", None, minval=1)


# "x, y" -> (x, y), or None where it is not given
def pair(config, name):
    values = config.getfloatlist(name, None, count=2)
    if values is not None and not all(map(is_finite, values)):
        raise config_error(config, name, "is not a pair of finite numbers")
    return values


# 'low, high', or one value for both directions
def margins(config, name, default):
    values = config.getfloatlist(name, None)
    if values is None:
        return default
    if len(values) == 1:
        values = (-abs(values[0]), abs(values[0]))
    if len(values) != 2 or not all(map(is_finite, values)):
        raise config_error(
            config,
            name,
            "must be 'low, high' in mm, such as -1.0, 1.0, or one value for"
            " both directions",
        )
    if values[0] >= values[1]:
        text = "leaves no room between %g and %g; write the lower one first"
        raise config_error(config, name, text % tuple(values))
    return tuple(values)


# Options under the names of older releases and of other plugins
class OldNames(object):
    def __init__(self, config):
        self.config = config
        # What the user is told
        self.notes = []

    def is_given(self, name):
        return name in self.config.get_prefix_options(name)

    # The name under which an option is given
    def name_of(self, name, *old_names):
        found = name
        for old in old_names:
            if not self.is_given(old):
                continue
            # The host refuses what nobody reads
            self.config.get(old)
            if self.is_given(name) or found != name:
                text = "option '%s' is ignored, '%s' is given"
                self.notes.append(text % (old, found))
                continue
            self.notes.append("option '%s' is now called '%s'" % (old, name))
            found = old
        return found


# Parameters of a command; a blank one counts as not given.


def param_number(gcmd, name, default=None, **limits):
    if not gcmd.get(name, "").strip():
        return default
    value = gcmd.get_float(name, **limits)
    if not is_finite(value):
        raise param_error(gcmd, name, "a finite number")
    return value


def param_int(gcmd, name, default=None, **limits):
    if not gcmd.get(name, "").strip():
        return default
    return gcmd.get_int(name, **limits)


def param_pair(gcmd, name):
    text = gcmd.get(name, "").strip()
    if not text:
        return None
    try:
        x, y = [float(part) for part in text.split(",")]
    except ValueError:
        x = y = float("nan")
    if not (is_finite(x) and is_finite(y)):
        raise param_error(gcmd, name, "X and Y in mm, such as 100,100")
    return x, y


def param_error(gcmd, name, wanted):
    return gcmd.error(
        "Error on '%s': %s has to be %s"
        % (gcmd.get_commandline(), name, wanted)
    )


# Sampling, as [probe] has it in options and in parameters

# Where the options are left out, on every host; lift_speed is as speed
PROBE_SAMPLING = Sampling(1, 0.1, 0, "average", 5.0, 2.0, None)


def read_sampling(config, defaults=PROBE_SAMPLING):
    get = functools.partial(number, config)
    count = config.getint
    speed = get("speed", defaults.speed, above=0.0)
    return Sampling(
        samples=count("samples", defaults.samples, minval=1),
        tolerance=get("samples_tolerance", defaults.tolerance, minval=0.0),
        retries=count("samples_tolerance_retries", defaults.retries, minval=0),
        result=config.getchoice("samples_result", RESULTS, defaults.result),
        speed=speed,
        retract_dist=get(
            "sample_retract_dist", defaults.retract_dist, above=0.0
        ),
        lift_speed=get("lift_speed", defaults.lift_speed or speed, above=0.0),
    )


def param_sampling(gcmd, own):
    get = functools.partial(param_number, gcmd)
    count = functools.partial(param_int, gcmd)
    result = gcmd.get("SAMPLES_RESULT", "").strip().lower() or own.result
    if result not in RESULTS:
        raise param_error(gcmd, "SAMPLES_RESULT", "median or average")
    return Sampling(
        samples=count("SAMPLES", own.samples, minval=1),
        tolerance=get("SAMPLES_TOLERANCE", own.tolerance, minval=0.0),
        retries=count("SAMPLES_TOLERANCE_RETRIES", own.retries, minval=0),
        result=result,
        speed=get("PROBE_SPEED", own.speed, above=0.0),
        retract_dist=get("SAMPLE_RETRACT_DIST", own.retract_dist, above=0.0),
        lift_speed=get("LIFT_SPEED", own.lift_speed, above=0.0),
    )


# Values that SAVE_CONFIG writes

SAVE_HINT = (
    "The SAVE_CONFIG command will update the printer config file\nwith the"
    " above and restart the printer."
)


def save(printer, section, option, text):
    printer.lookup_object("configfile").set(section, option, text)
