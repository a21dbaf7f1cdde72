"""Options of sections as declared fields, and parameters of commands.

A section's options are the fields of a frozen dataclass, made by the functions below:

    @dataclass(frozen=True)
    class Settings:
        clearance: float = number(0.0, "Lift after each touch, in mm.", minval=0.0)

read() takes them from printer.cfg, and the documents take their tables from rows_of().  A new
option is one field, its use, and one test.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from typing import (
    TYPE_CHECKING,
    Any,
    Callable,
    Dict,
    Iterable,
    Iterator,
    List,
    Mapping,
    NamedTuple,
    Optional,
    Tuple,
    Union,
    cast,
)

from .sampling import AUTO, Sampling
from .templates import load_template
from .touch import Site, option_site

if TYPE_CHECKING:
    from .host.klippy import Config, GCodeCommand, Printer

RESULTS: Dict[Optional[str], Optional[str]] = {
    "median": "median",
    "average": "average",
    None: None,
}

# Names of before: one option, or a pair of one for X and one for Y
OldName = Union[str, Tuple[str, str]]


# No printer has a length (mm) as large, or a speed (mm/s) as low; nor another number, such as
# an acceleration, or a speed, which owners write as 32000 for "as fast as it goes"
LARGEST_LENGTH = 10000.0
SLOWEST = 0.01
LARGEST_OTHER = 1000000.0

# More touches of one place take longer than a user waits
MOST_TOUCHES = 1000

# Who needs more tries has something to repair
MOST_TRIES = 10

# So many characters of a command are quoted in its error
LONGEST_QUOTE = 60


def is_finite(value: float) -> bool:
    """Return whether a number is neither nan nor infinite."""
    return not (math.isnan(value) or math.isinf(value))


def why_impossible(value: float, unit: str = "mm") -> str:
    """Return why no printer has such a number, in words; empty: one may have it."""
    if not is_finite(value):
        return "is not a finite number"
    if unit == "mm/s" and value < SLOWEST:
        return f"has to be {SLOWEST:g} mm/s at least, and is {value:g}"
    largest = LARGEST_LENGTH if unit == "mm" else LARGEST_OTHER
    if abs(value) > largest:
        return f"has to be {largest:.0f} at most, and is {value:g}"
    return ""


def config_error(config: Config, name: object, what: str) -> Exception:
    """Return the error of a configuration, about one option."""
    section = config.get_name()
    return config.error(f"Option '{name}' in section '{section}' {what}")


######################################################################
# Values that the host's own getters cannot read
######################################################################


def read_number(
    config: Config,
    name: str,
    default: Any = None,
    unit: str = "mm",
    **limits: float,
) -> Any:
    """Return a number; the host takes 'nan' and 'inf' for some, which no limit catches."""
    value = config.getfloat(name, default, **limits)
    why = "" if value is None else why_impossible(value, unit)
    if why:
        raise config_error(config, name, why)
    return value


def read_pair(config: Config, name: str) -> Optional[Tuple[float, float]]:
    """Return "x, y" as two numbers, None where it is not given."""
    values = config.getfloatlist(name, None, count=2)
    if values is None:
        return None
    x, y = values
    why = why_impossible(x) or why_impossible(y)
    if why:
        raise config_error(config, name, why)
    return x, y


def read_margins(
    config: Config, name: str, default: Tuple[float, float]
) -> Tuple[float, float]:
    """Return 'low, high', or one value for both directions."""
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
    low, high = values
    why = why_impossible(low) or why_impossible(high)
    if why:
        raise config_error(config, name, why)
    if low >= high:
        raise config_error(
            config,
            name,
            f"leaves no room between {low:g} and {high:g}; write the lower one first",
        )
    return low, high


class Foreign:
    """A section of another module, which has to read all of it by itself.

    What is read here counts as unread.
    """

    def __init__(self, section: Config):
        self.section = section
        self.error = section.error
        self.get_name = section.get_name
        self.get_prefix_options = section.get_prefix_options

    def get(self, option: str, default: Any = None) -> Any:
        """Return an option as text."""
        return self.section.get(option, default, note_valid=False)

    def getfloat(self, option: str, default: Any = None, **limits: Any) -> Any:
        """Return an option as a number."""
        return self.section.getfloat(
            option, default, note_valid=False, **limits
        )

    def getfloatlist(
        self, option: str, default: Any = None, count: Optional[int] = None
    ) -> Any:
        """Return an option as numbers."""
        return self.section.getfloatlist(
            option, default, count=count, note_valid=False
        )


class OldNames:
    """Options under the names of older releases and of other plugins."""

    def __init__(self, config: Config):
        self.config = config
        # What the user is told
        self.notes: List[str] = []
        # By name, what an option is given as
        self.names: Dict[str, OldName] = {}

    def is_given(self, name: str) -> bool:
        """Return whether an option is given under just that name."""
        return name in self.config.get_prefix_options(name)

    def name_of(self, name: str, *old_names: OldName) -> OldName:
        """Return the name under which an option is given, looked up once.

        An old name may be a pair, of one option for X and one for Y.
        """
        if name not in self.names:
            self.names[name] = name
            for old in old_names:
                if isinstance(old, tuple):
                    self._look_up_axes(name, old)
                else:
                    self._look_up(name, old)
        return self.names[name]

    def was_given(self, name: str) -> bool:
        """Return whether an option was given, under any of its names."""
        return self.names[name] != name or self.is_given(name)

    def _look_up(self, name: str, old: str) -> None:
        if not self.is_given(old):
            return
        # The host refuses what nothing reads
        self.config.get(old)
        if self.was_given(name):
            given = self.names[name]
            self.notes.append(f"option '{old}' is ignored, '{given}' is given")
            return
        self.notes.append(f"option '{old}' is now called '{name}'")
        self.names[name] = old

    def _look_up_axes(self, name: str, axes: Tuple[str, str]) -> None:
        x, y = (read_number(self.config, axis) for axis in axes)
        if x is None and y is None:
            return
        if x is None or y is None:
            section = self.config.get_name()
            raise self.config.error(
                f"Option '{name}' in section '{section}': only one of '{axes[0]}' and"
                f" '{axes[1]}' is given; write both, better as '{name}: X,Y'"
            )
        if self.was_given(name):
            given = self.names[name]
            self.notes.append(
                f"options '{axes[0]}' and '{axes[1]}' are ignored, '{given}' is given"
            )
            return
        self.notes.append(
            f"options '{axes[0]}' and '{axes[1]}' are now '{name}: {x:g},{y:g}'"
        )
        self.names[name] = axes


######################################################################
# Rows
######################################################################

# In place of a default: the option has to be given.
REQUIRED = object()


class Same(NamedTuple):
    """In place of a default: the value of another option, which stands above."""

    name: str


class Given(NamedTuple):
    """In place of a default: one with another option that is not 0, else another one.

    That option stands above.
    """

    name: str
    given: Any
    else_: Any


class Kind(NamedTuple):
    """How a value is written and read.

    word is what a user writes, in words; read(config, name, row) returns the value; nonsense
    are values that must be refused, besides those outside the limits of a row; words those
    of a choice.
    """

    word: str
    read: Callable[[Config, Any, Any], Any]
    nonsense: Tuple[str, ...]
    words: Tuple[str, ...] = ()


class Option(NamedTuple):
    """A row.

    default is what it is where the option is left out: REQUIRED, Same, Given, or None for
    "something else decides"; limits are those of the host's getters (minval, maxval, above,
    below); text one sentence for the document; old the names that the option had.
    """

    name: str
    kind: Kind
    default: Any
    limits: Dict[str, float]
    unit: str
    text: str
    old: Tuple[OldName, ...]


def option(
    name: str,
    kind: Kind,
    default: Any,
    unit: str,
    text: str,
    old: Tuple[OldName, ...] = (),
    **limits: float,
) -> Option:
    """Return a row."""
    return Option(name, kind, default, limits, unit, text, old)


def _read_number(config: Config, name: str, row: Option) -> Any:
    return read_number(config, name, row.default, row.unit, **row.limits)


def _read_count(config: Config, name: str, row: Option) -> Any:
    return config.getint(name, row.default, **row.limits)


def _read_flag(config: Config, name: str, row: Option) -> Any:
    return config.getboolean(name, row.default)


def _read_text(config: Config, name: str, row: Option) -> Any:
    return config.get(name, row.default)


def _read_pin(config: Config, name: str, row: Option) -> Any:
    """Return a pin; a blank one counts as not given.  The board tells whether it has it."""
    if row.default is REQUIRED:
        return config.get(name)
    return config.get(name, "").strip() or row.default


def _read_pair(config: Config, name: str, row: Option) -> Any:
    return read_pair(config, name)


def _read_margins(config: Config, name: str, row: Option) -> Any:
    return read_margins(config, name, row.default)


def _read_samples(config: Config, name: str, row: Option) -> Any:
    if config.get(name, "").strip().lower() == AUTO:
        return AUTO
    return config.getint(name, row.default, **row.limits)


def _refuse(config: Config, name: str, row: Option) -> None:
    # Looked for, not read: it is no option of this section.
    if name in config.get_prefix_options(name):
        raise config_error(config, name, row.text)


def _read_gcode(config: Config, name: str, row: Option) -> Any:
    """Return a template; where the default is None, a blank one is None, too."""
    if row.default is None and not config.get(name, "").strip():
        return None
    return load_template(config, name, row.default)


REFUSED = Kind("nothing", _refuse, ())
NUMBER = Kind("number", _read_number, ("many", "nan", "inf", "1,5", "1e7"))
COUNT = Kind("whole number", _read_count, ("many", "1.5"))
FLAG = Kind("True or False", _read_flag, ("maybe",), ("True", "False"))
TEXT = Kind("text", _read_text, ())
PIN = Kind("MCU pin", _read_pin, ("no:PA1", "PZ9:1"))
PAIR = Kind("X, Y", _read_pair, ("100", "1, 2, 3", "a, b", "nan, 1", "1e5, 1"))
MARGINS = Kind(
    "low, high", _read_margins, ("1, -1", "1, 2, 3", "nan", "0", "1e5")
)
SAMPLES = Kind(
    "whole number or auto", _read_samples, ("0", "1.5", "some"), (AUTO,)
)
GCODE = Kind("G-code", _read_gcode, ("{", "{% if %}"))


def choice(values: Mapping[Any, Any]) -> Kind:
    """Return the kind of an option that is one of some words, each for a value."""

    def read(config: Config, name: str, row: Option) -> Any:
        """Return the value of the word; another word is an error."""
        return config.getchoice(name, values, row.default)

    words = tuple(sorted(word for word in values if word is not None))
    return Kind(" or ".join(words), read, ("neither",), words)


RESULT = choice(RESULTS)


def site_kind(name: str) -> Kind:
    """Return the kind of an option that is a point (mm), read as a Site of that name.

    Under an old name it may be one option for X and one for Y.  None: it is not given.
    """

    def read(config: Config, option: OldName, row: Option) -> Optional[Site]:
        """Return the point (mm), or None where it is not given."""
        if isinstance(option, tuple):
            axes = [read_number(config, axis) for axis in option]
            return option_site(config, name, " and ".join(option), axes)
        point = read_pair(config, option)
        return option_site(config, name, option, point) if point else None

    return Kind(PAIR.word, read, PAIR.nonsense)


def site_option(name: str, text: str) -> Option:
    """Return the row of a site, which had an option for X and one for Y until 2023."""
    site = name.split("_")[0]
    axes = (f"probe_{site}_x", f"probe_{site}_y")
    return option(name, site_kind(site), None, "mm", text, old=(axes,))


def unused(name: str, why: str) -> Option:
    """Return a row of another release's option that is read, and not used."""
    return option(name, TEXT, None, "", why)


def refused(name: str, why: str) -> Option:
    """Return a row of another section's option that is wrong in this one."""
    return option(name, REFUSED, None, "", why)


def unused_notes(given: Mapping[str, Any], rows: Iterable[Option]) -> List[str]:
    """Return what the user is told of unused options; 'given' as read() has them."""
    return [
        f"option '{row.name}' {row.text}" for row in rows if given[row.name]
    ]


def nonsense(row: Option) -> List[str]:
    """Return values (text) that a row must not accept."""
    steps = (("minval", -1), ("above", 0), ("maxval", 1), ("below", 0))
    outside = [
        f"{row.limits[name] + step:g}"
        for name, step in steps
        if name in row.limits
    ]
    slow = ["1e-10"] if row.unit == "mm/s" else []
    return [*row.kind.nonsense, *outside, *slow]


######################################################################
# Rows as the fields of a dataclass
######################################################################


def declare(row: Option) -> Any:
    """Return the field of an option; its name is that of the field."""
    return dataclasses.field(metadata={"option": row})


def number(
    default: Any,
    text: str,
    *,
    unit: str = "mm",
    old: Tuple[OldName, ...] = (),
    **limits: float,
) -> Any:
    """Declare a number."""
    return declare(option("", NUMBER, default, unit, text, old, **limits))


def speed(default: Any, text: str, *, old: Tuple[OldName, ...] = ()) -> Any:
    """Declare a speed (mm/s) above 0."""
    return number(default, text, unit="mm/s", old=old, above=0.0)


def other(kind: Kind, default: Any, text: str, **more: Any) -> Any:
    """Declare an option of any kind; 'unit', 'old' and limits as in option()."""
    unit = more.pop("unit", "")
    return declare(option("", kind, default, unit, text, **more))


def as_in_probe(name: str, text: str, **changes: Any) -> Any:
    """Declare an option of [probe], whose value is the default."""
    (row,) = [row for row in PROBE_OPTIONS if row.name == name]
    return declare(row._replace(default=None, text=text, **changes))


def rows_of(settings: type) -> Tuple[Option, ...]:
    """Return the rows of a dataclass in their order, by the names of its fields."""
    rows = []
    for field in dataclasses.fields(cast(Any, settings)):
        row: Optional[Option] = field.metadata.get("option")
        if row is not None:
            rows.append(row._replace(name=field.name))
    return tuple(rows)


######################################################################
# Reading them
######################################################################


def read(
    config: Any,
    rows: Iterable[Option],
    old_names: Optional[OldNames] = None,
    **defaults: Any,
) -> Dict[str, Any]:
    """Return the values of all rows by their names.

    'defaults' are those that other sections decide; 'old_names' is told of options under the
    names of old.
    """
    old_names = old_names or OldNames(config)
    values: Dict[str, Any] = {}
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


def settled(default: Any, values: Mapping[str, Any]) -> Any:
    """Return the default that one is by the values of the rows above."""
    if isinstance(default, Same):
        return values[default.name]
    if isinstance(default, Given):
        return default.given if values[default.name] else default.else_
    return default


######################################################################
# Sampling, as [probe] has it in options and in parameters
######################################################################

# On every host; lift_speed is as speed where it is left out
PROBE_OPTIONS = (
    option(
        "samples",
        COUNT,
        1,
        "",
        "How often a point is touched.",
        minval=1,
        maxval=MOST_TOUCHES,
    ),
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
        maxval=MOST_TOUCHES,
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
        "How far the toolhead is lifted between two touches, in mm.",
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


def sampling_of(values: Mapping[str, Any]) -> Sampling:
    """Return the values of a table that has the PROBE_OPTIONS."""
    return Sampling(
        samples=values["samples"],
        tolerance=values["samples_tolerance"],
        retries=values["samples_tolerance_retries"],
        result=values["samples_result"],
        speed=values["speed"],
        retract_dist=values["sample_retract_dist"],
        lift_speed=values["lift_speed"],
    )


def param_sampling(gcmd: GCodeCommand, sampling: Sampling) -> Sampling:
    """Return a sampling with what PROBE takes: SAMPLES and the rest."""
    count = param_int(
        gcmd, "SAMPLES", sampling.samples, minval=1, maxval=MOST_TOUCHES
    )
    return param_touches(gcmd, sampling)._replace(samples=count)


def param_touches(gcmd: GCodeCommand, sampling: Sampling) -> Sampling:
    """Return a sampling with what PROBE takes besides SAMPLES."""
    result = gcmd.get("SAMPLES_RESULT", "").strip().lower() or sampling.result
    if result not in RESULTS:
        raise param_error(gcmd, "SAMPLES_RESULT", "median or average")
    return sampling._replace(
        tolerance=param_number(
            gcmd, "SAMPLES_TOLERANCE", sampling.tolerance, minval=0.0
        ),
        retries=param_int(
            gcmd,
            "SAMPLES_TOLERANCE_RETRIES",
            sampling.retries,
            minval=0,
            maxval=MOST_TOUCHES,
        ),
        result=result,
        speed=param_number(gcmd, "PROBE_SPEED", sampling.speed, above=0.0),
        retract_dist=param_number(
            gcmd, "SAMPLE_RETRACT_DIST", sampling.retract_dist, above=0.0
        ),
        lift_speed=param_number(
            gcmd, "LIFT_SPEED", sampling.lift_speed, above=0.0
        ),
    )


def param_samples(gcmd: GCodeCommand) -> Union[int, str, None]:
    """Return SAMPLES where it may be AUTO, too; None: it is not given."""
    if gcmd.get("SAMPLES", "").strip().lower() == AUTO:
        return AUTO
    count: Optional[int] = param_int(
        gcmd, "SAMPLES", None, minval=1, maxval=MOST_TOUCHES
    )
    return count


######################################################################
# Parameters of a command; a blank one counts as not given
######################################################################


def param_number(
    gcmd: GCodeCommand, name: str, default: Any = None, **limits: float
) -> Any:
    """Return a parameter as a number that a printer may have."""
    if not gcmd.get(name, "").strip():
        return default
    with quoting(gcmd, name):
        value = gcmd.get_float(name, **limits)
    why = why_impossible(value, "mm/s" if name.endswith("SPEED") else "mm")
    if why:
        raise gcmd.error(
            f"Error on '{quoted(gcmd.get_commandline())}': {name} {why}"
        )
    return value


def param_int(
    gcmd: GCodeCommand, name: str, default: Any = None, **limits: int
) -> Any:
    """Return a parameter as a whole number."""
    if not gcmd.get(name, "").strip():
        return default
    with quoting(gcmd, name):
        value: int = gcmd.get_int(name, **limits)
    return value


def param_flag(gcmd: GCodeCommand, name: str, default: bool = False) -> bool:
    """Return a parameter that is 0 or 1."""
    return bool(param_int(gcmd, name, int(default), minval=0, maxval=1))


def param_pair(gcmd: GCodeCommand, name: str) -> Optional[Tuple[float, float]]:
    """Return a parameter as X and Y (mm), None: it is not given."""
    text = gcmd.get(name, "").strip()
    if not text:
        return None
    try:
        x, y = [float(part) for part in text.split(",")]
    except ValueError:
        x = y = float("nan")
    if why_impossible(x) or why_impossible(y):
        raise param_error(gcmd, name, "X and Y in mm, such as 100,100")
    return x, y


def param_word(gcmd: GCodeCommand, name: str) -> str:
    """Return a parameter that is one of some words, as far as an error quotes it.

    Empty: it is not given.
    """
    return quoted(gcmd.get(name, "").strip())


def param_error(gcmd: GCodeCommand, name: str, wanted: str) -> Exception:
    """Return the error of a parameter, in the words of the host."""
    line = quoted(gcmd.get_commandline())
    return gcmd.error(f"Error on '{line}': {name} has to be {wanted}")


def quoted(text: str) -> str:
    """Return a text as far as it is quoted."""
    if len(text) <= LONGEST_QUOTE:
        return text
    return text[: LONGEST_QUOTE - 3] + "..."


@contextlib.contextmanager
def quoting(gcmd: GCodeCommand, name: str) -> Iterator[None]:
    """Have the host's error about a parameter quote a bit of a long line only."""
    try:
        yield
    except gcmd.error as e:
        text = str(e)
        for whole in (gcmd.get_commandline(), gcmd.get(name)):
            text = text.replace(whole, quoted(whole))
        raise gcmd.error(text)


######################################################################
# Values that SAVE_CONFIG writes
######################################################################

SAVE_HINT = (
    "The SAVE_CONFIG command will update the printer config file\nwith the"
    " above and restart the printer."
)


def save(printer: Printer, section: str, option: str, text: str) -> None:
    """Hand a value to SAVE_CONFIG."""
    printer.lookup_object("configfile").set(section, option, text)
