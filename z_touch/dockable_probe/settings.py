# What the owner has written in [dockable_probe], and whether it can work.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Positions and heights are those of the toolhead, in mm, as GET_POSITION shows
# them after "toolhead:"; G-code offset and bed mesh play no part.  Speeds are
# in mm/s.

import functools
import math

from .. import options
from .. import pin as z_pin
from ..options import (
    COUNT,
    FLAG,
    GCODE,
    NUMBER,
    PAIR,
    PIN,
    PROBE_OPTIONS,
    REQUIRED,
    Kind,
    Same,
    option,
)
from . import detour
from .detour import Position

# XY speed (mm/s) outside of the dock
TRAVEL_SPEED = 50.0

# A probing move ends this far (mm) above Z=0: the bed is about there, and the
# nozzle has to stay clear of it.
LOWEST_NOZZLE = 1.0

# A probing move ends this far (mm) below where the probe triggers at Z=0: less
# than the body of a usual probe is long, more than a bed or gantry hangs askew.
REACH = 5.0

# Between two places a bed that is bent is no higher (mm) than that above the straight
# line from one to the other.
BENT = 2.0

# A smaller z_offset (mm) of a switch was not measured yet; then the probe may
# hang so much (mm) lower than the nozzle.
SMALLEST_Z_OFFSET = 2.0
UNMEASURED_PROBE = 10.0

# The way out that strips the probe off turns at least so many degrees from the
# one that takes it along; less than the second is doubtful.
SAME_WAY = 20.0
DOUBTFUL_WAY = 45.0

# Where the head stands while Z is homed with the probe, if the middle of the
# axes is meant, which is known when klippy has connected
MIDDLE = "middle"


######################################################################
# The options
#
# A row is all that a new option needs here: it is read, has its field in
# Settings, and the document and the tests of wrong values ask for it.
######################################################################


# Blank counts as not given.
def _read_position(config, name, row):
    values = config.getfloatlist(name, None)
    if not values and row.default is not REQUIRED:
        return row.default
    if not 2 <= len(values) <= 3 or not all(map(options.is_finite, values)):
        what = "has to be 'X, Y' or 'X, Y, Z' in mm, such as 250, 295"
        raise options.config_error(config, name, what)
    return Position(*(tuple(values) + (None,))[:3])


POSITION = Kind(
    "X, Y[, Z]", _read_position, ("50", "1, 2, 3, 4", "50, inf", "50, x")
)


# Rows of a kind, but for name, default and the line of the document


def position_option(name, default, text):
    return option(name, POSITION, default, "mm", text)


def speed_option(name, default, text):
    return option(name, NUMBER, default, "mm/s", text, above=0.0)


def flag_option(name, default, text, old=()):
    return option(name, FLAG, default, "", text, old)


def gcode_option(name, text):
    return option(name, GCODE, None, "", text)


PROBE = (
    option(
        "z_offset",
        NUMBER,
        REQUIRED,
        "mm",
        "How far the probe triggers below the nozzle, in mm.",
    ),
    option("pin", PIN, REQUIRED, "", "The MCU pin of the probe's switch."),
    option(
        "x_offset",
        NUMBER,
        0.0,
        "mm",
        "The probe stands so far to the right of the nozzle, in mm.",
    ),
    option(
        "y_offset",
        NUMBER,
        0.0,
        "mm",
        "The probe stands so far behind the nozzle, in mm.",
    ),
) + tuple(
    # Here it is the speed of all ways in Z, see TRIP.
    row
    for row in PROBE_OPTIONS
    if row.name != "lift_speed"
)

DOCK = position_option(
    "dock_position",
    REQUIRED,
    "X, Y of the head in the dock, in mm; a third number is Z.",
)

POSITIONS = (
    position_option(
        "approach_position", REQUIRED, "Straight into the dock from here."
    ),
    position_option(
        "detach_position",
        REQUIRED,
        "Straight out to here, without the probe.",
    ),
    position_option(
        "extract_position",
        Same("approach_position"),
        "Straight out to here, with the probe. The default is"
        " approach_position.",
    ),
    position_option(
        "insert_position",
        Same("extract_position"),
        "Straight into the dock from here, with the probe. The default is"
        " extract_position.",
    ),
)

# The default, which is the largest value, too, comes from the positions.
DISTANCE = option(
    "safe_dock_distance",
    NUMBER,
    None,
    "mm",
    "On all other ways the head stays so far away from the dock, in mm. The"
    " default is the distance of the nearest position.",
    minval=0.0,
)

TRIP = (
    flag_option(
        "dock_fixed_z",
        None,
        "False: the dock has a height of its own. The default is True where no"
        " position has a Z.",
    ),
    option(
        "z_hop",
        NUMBER,
        0.0,
        "mm",
        "Lowest height of the head on the way to the dock, in mm.",
        minval=0.0,
    ),
    position_option(
        "safe_position",
        None,
        "The head goes around the dock on the side of this point. There is no"
        " default.",
    ),
    option(
        "safe_z_position",
        PAIR,
        None,
        "mm",
        "Where the head stands while Z is homed with the probe. There is no"
        " default.",
    ),
    speed_option("travel_speed", TRAVEL_SPEED, "Outside of the dock, in mm/s."),
    speed_option(
        "lift_speed",
        Same("speed"),
        "All ways in Z, in mm/s. The default is speed.",
    ),
    speed_option(
        "attach_speed",
        Same("travel_speed"),
        "Into the dock, and out with the probe, in mm/s. The default is"
        " travel_speed.",
    ),
    speed_option(
        "detach_speed",
        Same("travel_speed"),
        "Out without the probe, in mm/s. The default is travel_speed.",
    ),
    option(
        "dock_retries",
        COUNT,
        0,
        "",
        "How often fetching and docking are tried again.",
        minval=0,
    ),
    flag_option(
        "restore_toolhead",
        True,
        "False: the head stays at detach_position afterwards.",
        old=("return_to_last_probe_position_after_detach",),
    ),
)

SENSING = (
    flag_option(
        "check_open_attach",
        False,
        "True: pin reads open with the probe on the head and TRIGGERED without"
        " it.",
    ),
    option(
        "probe_sense_pin",
        PIN,
        None,
        "",
        "An MCU pin that is triggered while the probe is on the head. There is"
        " no default.",
    ),
    option(
        "dock_sense_pin",
        PIN,
        None,
        "",
        "An MCU pin that is triggered while the probe is in the dock. There is"
        " no default.",
    ),
)

PROBING = (
    flag_option(
        "auto_attach_detach",
        True,
        "False: commands that probe do not fetch and dock the probe by"
        " themselves.",
    ),
    flag_option(
        "allow_delayed_detach",
        False,
        "True: the probe is docked one second after its last use.",
    ),
    flag_option(
        "detach_dockable_before_z_home",
        None,
        "True: the probe is docked before Z is homed on its switch. The default"
        " is whether Z is homed so.",
    ),
    flag_option(
        "drop_first_result",
        False,
        "True: one touch before the samples that does not count.",
    ),
)

TEMPLATES = (
    gcode_option(
        "pre_attach_gcode",
        "Before the head goes to fetch the probe. There is no default.",
    ),
    gcode_option(
        "attach_gcode",
        "In the dock, at each attempt to fetch it. There is no default.",
    ),
    gcode_option(
        "post_attach_gcode",
        "When it was fetched, or could not be. There is no default.",
    ),
    gcode_option(
        "pre_detach_gcode",
        "Before the head goes to dock it. There is no default.",
    ),
    gcode_option(
        "detach_gcode",
        "In the dock, at each attempt to dock it. There is no default.",
    ),
    gcode_option(
        "post_detach_gcode",
        "When it was docked, or could not be. There is no default.",
    ),
    gcode_option(
        "activate_gcode",
        "Before the probe is fetched; must not move the head. There is no"
        " default.",
    ),
    gcode_option(
        "deactivate_gcode",
        "When it was docked, and the head is back; must not move the head. There"
        " is no default.",
    ),
    flag_option(
        "deactivate_on_each_sample", False, "True: both around each touch."
    ),
)

# All but those of DOCK, POSITIONS and DISTANCE, which are read before them
OTHERS = PROBE + TRIP + SENSING + PROBING + TEMPLATES
OPTIONS = (DOCK,) + POSITIONS + (DISTANCE,) + OTHERS

# Of other plugins: the angle (degrees from +X towards +Y) of a position, and
# its distance from the dock
OLD_POSITIONS = (
    option("dock_angle", NUMBER, None, "degrees", "Of approach_position."),
    option("detach_angle", NUMBER, None, "degrees", "Of detach_position."),
    option(
        "dock_safe_distance",
        NUMBER,
        None,
        "mm",
        "Of both from the dock.",
        above=0.0,
    ),
)

# Every option by its name, with what follows for those that are left out, and
#   sampling   how often and how fast a point is touched
#   hang       how far (mm) the probe triggers below the nozzle, as far as that
#              is known
#   lowest     lowest useful toolhead Z (mm) of a probing move
#   z_pin      the z_pin.Pin that Z is homed on; None: there is none, or nobody knows
#              where
#   over_pin   lowest over it; where it is not known, everywhere
#   home_xy    where the head stands while Z is homed with the probe: (x, y),
#              MIDDLE, or None for "where it is then"
#   mesh       (low, high) of X and Y (mm) of the head while a bed mesh is
#              probed, or None
#   is_placed  whether the section says where the dock is; where it does not, the
#              positions stand for none
#   strip_z    toolhead Z (mm) that the head goes to in a dock that goes up and down
#              with it, before it leaves without the probe; None: it stays as high
#   macros     those of PARTS that a macro of the owner's stands in for
#   strippers  what else than the way in X and Y may strip the probe off, by name
Settings = options.record(
    "Settings",
    OPTIONS,
    "sampling hang lowest z_pin over_pin home_xy mesh is_placed strip_z"
    " macros strippers",
)

# Commands that are parts of a trip.  A macro of that name stands in for one.
PARTS = (
    "MOVE_TO_APPROACH_PROBE",
    "MOVE_TO_DOCK_PROBE",
    "MOVE_TO_EXTRACT_PROBE",
    "MOVE_TO_INSERT_PROBE",
    "MOVE_TO_DETACH_PROBE",
)

# Stands for a position that is not known yet
NOWHERE = Position(0.0, 0.0, None)


######################################################################
# Reading them
######################################################################


# 'host': host.Host.  'old_names' is told of what the owner should write in
# another way.
def read_settings(config, host, old_names):
    values = read_positions(config, old_names.notes)
    nearest = nearest_distance(values)
    row = DISTANCE._replace(limits=dict(DISTANCE.limits, maxval=nearest))
    if not values["is_placed"]:
        row = DISTANCE
    values.update(options.read(config, (row,), safe_dock_distance=nearest))
    if not values["is_placed"]:
        # Nothing is to be gone around
        values["safe_dock_distance"] = nearest
    values.update(options.read(config, OTHERS, old_names))
    values["dock_fixed_z"] = is_fixed_z(config, values)
    check_senses(config, values)
    z_offset, homes_z = values["z_offset"], host.axes.homes_with_probe()
    endstop_z = host.axes.z_axis.position_endstop if host.axes.z_axis else None
    over_pin = lowest_touch(z_offset, homes_z, endstop_z)
    pin = z_pin.read_pin(config, host.axes.z_axis)
    values.update(
        sampling=options.sampling_of(values),
        hang=hang(z_offset, homes_z),
        lowest=over_pin if pin is None else LOWEST_NOZZLE,
        z_pin=pin,
        over_pin=over_pin,
        home_xy=home_xy(config, values["safe_z_position"]),
        mesh=read_mesh(config, (values["x_offset"], values["y_offset"])),
        strip_z=strip_z(values),
        macros=read_macros(config),
    )
    values["strippers"] = strippers(values)
    return Settings(**values)


# Those of the dock.  A section that has none of them is to be set up.
def read_positions(config, notes):
    places = (DOCK,) + POSITIONS
    rows = places + OLD_POSITIONS
    if all(config.get(row.name, None) is None for row in rows):
        values = dict.fromkeys((row.name for row in places), NOWHERE)
        return dict(values, is_placed=False)
    values = options.read(config, (DOCK,))
    angles = read_angles(config, values["dock_position"], notes)
    values.update(options.read(config, POSITIONS, **angles))
    return dict(values, is_placed=True)


# Positions that are given by the angles of old, by the names of their options
def read_angles(config, dock, notes):
    given = options.read(config, OLD_POSITIONS)
    length, positions = given["dock_safe_distance"], {}
    for old, new in (
        ("dock_angle", "approach_position"),
        ("detach_angle", "detach_position"),
    ):
        if given[old] is None:
            continue
        if length is None:
            what = "needs dock_safe_distance; better write %s" % (new,)
            raise options.config_error(config, old, what)
        x, y = detour.on_circle(dock, math.radians(given[old]), length)
        positions[new] = Position(x, y, None)
        text = "options '%s' and 'dock_safe_distance' are now '%s: %.1f, %.1f'"
        notes.append(text % (old, new, x, y))
    return positions


# Distance (mm) from the dock to the nearest position that is one of its own
def nearest_distance(values):
    dock = values["dock_position"]
    apart = [detour.distance(dock, values[row.name]) for row in POSITIONS]
    return min([mm for mm in apart if mm >= detour.SMALLEST_DISTANCE] or [0.0])


# Whether the dock is at the head's height in any case: without a word about it
# unless a position has a Z
def is_fixed_z(config, values):
    dock, given = values["dock_position"], values["dock_fixed_z"]
    if given is None:
        positions = [dock] + [values[row.name] for row in POSITIONS]
        return all(position.z is None for position in positions)
    if not given and dock.z is None and values["is_placed"]:
        what = "is False: dock_position needs the Z of the dock as third number"
        raise options.config_error(config, "dock_fixed_z", what)
    return given


# A Z of detach_position is how high the head is on the way out, and where the dock
# goes up and down with it only that Z can mean to strip the probe off: where the ways
# in X and Y do not, and no G-code of the owner's does.
def strip_z(values):
    z = values["detach_position"].z
    angle = detour.strip_angle(
        values["dock_position"],
        None,
        values["extract_position"],
        values["detach_position"],
    )
    is_wanted = values["dock_fixed_z"] and values["detach_gcode"] is None
    return z if is_wanted and angle < DOUBTFUL_WAY else None


# What may strip the probe off besides the way in X and Y
def strippers(values):
    found = [
        name
        for name in ("detach_gcode", "pre_detach_gcode")
        if values[name] is not None
    ]
    if values["strip_z"] is not None:
        found.append("the Z of detach_position")
    return found + ["the macro " + name for name in values["macros"]]


# Those of PARTS that a macro of the owner's stands in for
def read_macros(config):
    names = {
        section.get_name().split()[-1].upper()
        for section in config.get_prefix_sections("gcode_macro ")
    }
    return [name for name in PARTS if name in names]


# Something has to tell where the probe is
def check_senses(config, values):
    senses = "check_open_attach", "probe_sense_pin", "dock_sense_pin"
    if not any(values[name] for name in senses):
        raise config.error(
            "Section '%s': nothing tells whether the probe is attached;"
            " set check_open_attach: True if 'pin' reads open with the"
            " probe on the head and TRIGGERED without it, or give"
            " probe_sense_pin or dock_sense_pin" % (config.get_name(),)
        )


# Other sections that say where the head stands while Z is homed leave it there.
def home_xy(config, safe_z_position):
    others = ("safe_z_home", "homing_override")
    if safe_z_position is None and not any(map(config.has_section, others)):
        return MIDDLE
    return safe_z_position


# 'offsets': X and Y (mm) from the nozzle to the probe
def read_mesh(config, offsets):
    if not config.has_section("bed_mesh"):
        return None
    read = functools.partial(
        config.getsection("bed_mesh").getfloatlist, count=2, note_valid=False
    )
    low, high = read("mesh_min", None), read("mesh_max", None)
    if None in (low, high):
        return None
    return [(a - shift, b - shift) for a, b, shift in zip(low, high, offsets)]


######################################################################
# Heights
######################################################################


# Where Z is homed with the probe it triggers at z_offset, whatever that is.
def hang(z_offset, homes_z):
    if z_offset >= SMALLEST_Z_OFFSET or homes_z:
        return z_offset
    return UNMEASURED_PROBE


# 'homes_z': Z is homed with the probe.  'endstop_z' (mm) is otherwise where the
# nozzle may meet the pin that Z is homed on, or None.
def lowest_touch(z_offset, homes_z, endstop_z):
    if not homes_z:
        above_pin = (endstop_z or 0.0) + LOWEST_NOZZLE
        return max(LOWEST_NOZZLE, above_pin if above_pin < z_offset else 0.0)
    if z_offset < SMALLEST_Z_OFFSET:
        return z_offset - LOWEST_NOZZLE
    return max(LOWEST_NOZZLE, z_offset - REACH)


# Toolhead Z (mm) at which the probe on the head is clear of the bed
def travel_height(settings):
    return settings.hang + settings.sample_retract_dist


# Toolhead Z (mm) where a straight line to or from the height of the way to the dock
# begins or ends
def clear_height(settings):
    clear = settings.hang + max(settings.sample_retract_dist, BENT)
    return max(clear, settings.z_hop)


# Toolhead Z (mm) of the way to the dock, over a bed or below a gantry that may hang
# askew: levelling is what fetches the probe.  Where a dock goes up and down with the
# head, its Z is what has to be cleared besides the bed.
def dock_height(settings):
    more = settings.dock_position.z or 0.0 if settings.dock_fixed_z else 0.0
    clear = settings.hang + max(settings.sample_retract_dist, REACH)
    return max(clear + more, settings.z_hop)
