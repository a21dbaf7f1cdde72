# Options and parameters that the host's own getters cannot read.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections
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


# A section of another room, which has to read all of it by itself: what is read here
# counts as unread.
class Foreign:
    def __init__(self, section):
        self.section = section
        self.error = section.error
        self.get_name = section.get_name
        self.get_prefix_options = section.get_prefix_options
        self.get = self._unnoted(section.get)
        self.getfloat = self._unnoted(section.getfloat)
        self.getfloatlist = self._unnoted(section.getfloatlist)

    def _unnoted(self, read):
        return functools.partial(read, note_valid=False)


# Options under the names of older releases and of other plugins
class OldNames:
    def __init__(self, config):
        self.config = config
        # What the user is told
        self.notes = []
        # By name, what an option is given as
        self.names = {}

    def is_given(self, name):
        return name in self.config.get_prefix_options(name)

    # The name under which an option is given, looked up once.  An old name may
    # be a pair, of one option for X and one for Y.
    def name_of(self, name, *old_names):
        if name not in self.names:
            self.names[name] = name
            for old in old_names:
                is_pair = isinstance(old, tuple)
                look_up = self._look_up_axes if is_pair else self._look_up
                look_up(name, old)
        return self.names[name]

    # Whether an option was given, under any of its names
    def was_given(self, name):
        return self.names[name] != name or self.is_given(name)

    def _look_up(self, name, old):
        if not self.is_given(old):
            return
        # The host refuses what nobody reads
        self.config.get(old)
        if self.was_given(name):
            text = "option '%s' is ignored, '%s' is given"
            self.notes.append(text % (old, self.names[name]))
            return
        self.notes.append("option '%s' is now called '%s'" % (old, name))
        self.names[name] = old

    def _look_up_axes(self, name, axes):
        values = [number(self.config, axis) for axis in axes]
        if values == [None, None]:
            return
        if None in values:
            raise self.config.error(
                "Option '%s' in section '%s': only one of '%s' and '%s' is"
                " given; write both, better as '%s: X,Y'"
                % ((name, self.config.get_name()) + axes + (name,))
            )
        if self.was_given(name):
            text = "options '%s' and '%s' are ignored, '%s' is given"
            self.notes.append(text % (axes + (self.names[name],)))
            return
        text = "options '%s' and '%s' are now '%s: %g,%g'"
        self.notes.append(text % (axes + (name,) + tuple(values)))
        self.names[name] = axes


######################################################################
# Options as a table
######################################################################

# In place of a default: the option has to be given.
REQUIRED = object()

# In place of a default: the value of another option, which stands in a row above
Same = collections.namedtuple("Same", "name")

# In place of a default: what it is 'given' another option that is not 0, which
# stands in a row above, and 'else_' what
Given = collections.namedtuple("Given", "name given else_")

# A row: how a value is written and read (Kind); what it is where the option is
# left out, REQUIRED, Same, Given, or None for "something else decides"; limits as the
# host's getters take them (minval, maxval, above, below); its unit, one sentence
# for the document, and the names that the option had (pairs where it was one for
# X and one for Y).
Option = collections.namedtuple(
    "Option", "name kind default limits unit text old"
)


# What an owner writes, in words; read(config, name, row); values that must be
# refused, besides those outside the limits of a row; and of a choice the words
class Kind(collections.namedtuple("Kind", "word read nonsense words")):
    __slots__ = ()

    def __new__(cls, word, read, nonsense, words=()):
        return super().__new__(cls, word, read, nonsense, words)


def option(name, kind, default, unit, text, old=(), **limits):
    return Option(name, kind, default, limits, unit, text, old)


def _read_number(config, name, row):
    return number(config, name, row.default, **row.limits)


def _read_count(config, name, row):
    return config.getint(name, row.default, **row.limits)


def _read_flag(config, name, row):
    return config.getboolean(name, row.default)


def _read_text(config, name, row):
    return config.get(name, row.default)


# A blank one counts as not given.  The board tells whether it has this pin.
def _read_pin(config, name, row):
    if row.default is REQUIRED:
        return config.get(name)
    return config.get(name, "").strip() or row.default


def _read_pair(config, name, row):
    return pair(config, name)


def _read_margins(config, name, row):
    return margins(config, name, row.default)


def _read_samples(config, name, row):
    if config.get(name, "").strip().lower() == AUTO:
        return AUTO
    return config.getint(name, row.default, **row.limits)


def _refuse(config, name, row):
    # Looked for, not read: it is no option of this section.
    if name in config.get_prefix_options(name):
        raise config_error(config, name, row.text)


REFUSED = Kind("nothing", _refuse, ())
NUMBER = Kind("number", _read_number, ("many", "nan", "inf", "1,5"))
COUNT = Kind("whole number", _read_count, ("many", "1.5"))
FLAG = Kind("True or False", _read_flag, ("maybe",), ("True", "False"))
TEXT = Kind("text", _read_text, ())
PIN = Kind("MCU pin", _read_pin, ("no:PA1", "PZ9:1"))
PAIR = Kind("X, Y", _read_pair, ("100", "1, 2, 3", "a, b", "nan, 1"))
MARGINS = Kind("low, high", _read_margins, ("1, -1", "1, 2, 3", "nan", "0"))
SAMPLES = Kind(
    "whole number or auto", _read_samples, ("0", "1.5", "some"), (AUTO,)
)


# One of some words, each for a value
def choice(values):
    def read(config, name, row):
        return config.getchoice(name, values, row.default)

    words = tuple(sorted(word for word in values if word is not None))
    return Kind(" or ".join(words), read, ("neither",), words)


RESULT = choice(RESULTS)


# A record of all options of a table by their names, and of 'also', what follows
# from them or comes when klippy connects
def record(name, rows, also=""):
    return collections.namedtuple(
        name, [row.name for row in rows] + also.split()
    )


# The values of all rows by their names.  'defaults' are those that other
# sections decide; 'old_names' is told of options under the names of old.
def read(config, rows, old_names=None, **defaults):
    old_names = old_names or OldNames(config)
    values = {}
    for row in rows:
        name = old_names.name_of(row.name, *row.old)
        default = defaults.get(row.name, row.default)
        if default is REQUIRED:
            # Where it is missing the host says so in its own words
            config.get(name)
        else:
            default = settled(default, values)
        row = row._replace(default=default)
        values[row.name] = row.kind.read(config, name, row)
    return values


# The default that one of a row is by the values of the rows above
def settled(default, values):
    if isinstance(default, Same):
        return values[default.name]
    if isinstance(default, Given):
        return default.given if values[default.name] else default.else_
    return default


# A row of another release's option that is read, and not used; 'why' is told
# where it is given.
def unused(name, why):
    return option(name, TEXT, None, "", why)


# A row of another section's option that is wrong in this one; 'why' is the error.
def refused(name, why):
    return option(name, REFUSED, None, "", why)


# What the user is told of unused options; 'given': as read() has them
def unused_notes(given, rows):
    return [
        "option '%s' %s" % (row.name, row.text)
        for row in rows
        if given[row.name]
    ]


# Values (text) that a row must not accept
def nonsense(row):
    limits = row.limits
    outside = [
        "%g" % (limits[name] + step,)
        for name, step in (
            ("minval", -1),
            ("above", 0),
            ("maxval", 1),
            ("below", 0),
        )
        if name in limits
    ]
    return list(row.kind.nonsense) + outside


######################################################################
# Sampling, as [probe] has it in options and in parameters
######################################################################

# On every host; lift_speed is as speed where it is left out
PROBE_OPTIONS = (
    option("samples", COUNT, 1, "", "How often a point is touched.", minval=1),
    option(
        "samples_tolerance",
        NUMBER,
        0.1,
        "mm",
        "By how much the touches of a point may differ, in mm.",
        minval=0.0,
    ),
    option(
        "samples_tolerance_retries",
        COUNT,
        0,
        "",
        "How often the touches of a point begin again if they differ by more.",
        minval=0,
    ),
    option(
        "samples_result",
        RESULT,
        "average",
        "",
        "average or median of the touches of a point.",
    ),
    option("speed", NUMBER, 5.0, "mm/s", "Of a touch, in mm/s.", above=0.0),
    option(
        "sample_retract_dist",
        NUMBER,
        2.0,
        "mm",
        "How far the head is lifted between two touches, in mm.",
        above=0.0,
    ),
    option(
        "lift_speed",
        NUMBER,
        Same("speed"),
        "mm/s",
        "Of the way up, in mm/s. The default is speed.",
        above=0.0,
    ),
)


# The values of a table that has the PROBE_OPTIONS, as a record
def sampling_of(values):
    return Sampling(
        samples=values["samples"],
        tolerance=values["samples_tolerance"],
        retries=values["samples_tolerance_retries"],
        result=values["samples_result"],
        speed=values["speed"],
        retract_dist=values["sample_retract_dist"],
        lift_speed=values["lift_speed"],
    )


# What PROBE takes: SAMPLES and the rest
def param_sampling(gcmd, sampling):
    count = param_int(gcmd, "SAMPLES", sampling.samples, minval=1)
    return param_touches(gcmd, sampling)._replace(samples=count)


# The rest alone
def param_touches(gcmd, sampling):
    get = functools.partial(param_number, gcmd)
    count = functools.partial(param_int, gcmd)
    result = gcmd.get("SAMPLES_RESULT", "").strip().lower() or sampling.result
    if result not in RESULTS:
        raise param_error(gcmd, "SAMPLES_RESULT", "median or average")
    return sampling._replace(
        tolerance=get("SAMPLES_TOLERANCE", sampling.tolerance, minval=0.0),
        retries=count("SAMPLES_TOLERANCE_RETRIES", sampling.retries, minval=0),
        result=result,
        speed=get("PROBE_SPEED", sampling.speed, above=0.0),
        retract_dist=get(
            "SAMPLE_RETRACT_DIST", sampling.retract_dist, above=0.0
        ),
        lift_speed=get("LIFT_SPEED", sampling.lift_speed, above=0.0),
    )


# SAMPLES where it may be AUTO, too; None: it is not given
def param_samples(gcmd):
    if gcmd.get("SAMPLES", "").strip().lower() == AUTO:
        return AUTO
    return param_int(gcmd, "SAMPLES", None, minval=1)


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


# Values that SAVE_CONFIG writes

SAVE_HINT = (
    "The SAVE_CONFIG command will update the printer config file\nwith the"
    " above and restart the printer."
)


def save(printer, section, option, text):
    printer.lookup_object("configfile").set(section, option, text)
