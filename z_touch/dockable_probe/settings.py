"""The options of [dockable_probe] as declared fields, and what follows from them.

Positions and heights are those of the toolhead, in mm, as GET_POSITION shows them after
"toolhead:"; G-code offset and bed mesh play no part.  Speeds are in mm/s.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    List,
    Mapping,
    Optional,
    Sequence,
    Tuple,
    Union,
)

from .. import options
from ..pin import Pin, read_pin
from ..sampling import Sampling
from . import path
from .path import Position

if TYPE_CHECKING:
    from ..host.klippy import Config, Template
    from ..host.printer import Host

# XY speed (mm/s) outside of the dock
TRAVEL_SPEED = 50.0

# A probing move ends this far (mm) above Z=0: the bed is about there, and the nozzle has
# to stay clear of it.
LOWEST_NOZZLE = 1.0

# A probing move ends this far (mm) below where the probe triggers at Z=0: less than the
# body of a usual probe is long, more than a bed or gantry hangs askew.
REACH = 5.0

# Between two places a bed that is bent is no higher (mm) than that above the straight
# line from one to the other.
BENT = 2.0

# The bed may be so much (mm) higher than where the probe meets it.
HIGHER = 1.0

# A smaller z_offset (mm) of a switch was not measured yet; then the probe may be so much
# (mm) longer below the nozzle.
SMALLEST_Z_OFFSET = 2.0
UNMEASURED_PROBE = 10.0

# The way out that strips the probe off turns at least so many degrees from the one that
# takes it along; less than the second is doubtful.
SAME_WAY = 20.0
DOUBTFUL_WAY = 45.0

# Where the toolhead stands while Z is homed with the probe, if the middle of the axes is
# meant, which is known when klippy has connected
MIDDLE = "middle"

# Parts of a trip, which are commands: a macro of that name stands in for one.
APPROACH = "MOVE_TO_APPROACH_PROBE"
ENTER = "MOVE_TO_DOCK_PROBE"
EXTRACT = "MOVE_TO_EXTRACT_PROBE"
INSERT = "MOVE_TO_INSERT_PROBE"
DETACH = "MOVE_TO_DETACH_PROBE"
PARTS = (APPROACH, ENTER, EXTRACT, INSERT, DETACH)


def _read_position(config: Config, name: str, row: options.Option) -> Any:
    """Return a position; a blank one counts as not given."""
    values = config.getfloatlist(name, None)
    if not values and row.default is not options.REQUIRED:
        return row.default
    if not 2 <= len(values) <= 3 or not all(map(options.is_finite, values)):
        what = "has to be 'X, Y' or 'X, Y, Z' in mm, such as 250, 295"
        raise options.config_error(config, name, what)
    return Position(*(*values, None)[:3])


POSITION = options.Kind(
    "X, Y[, Z]", _read_position, ("50", "1, 2, 3, 4", "50, inf", "50, x")
)


def position(default: Any, text: str) -> Any:
    """Declare a position of the toolhead (mm)."""
    return options.other(POSITION, default, text, unit="mm")


def flag(
    default: Optional[bool], text: str, old: Tuple[options.OldName, ...] = ()
) -> Any:
    """Declare an option that is True or False."""
    return options.other(options.FLAG, default, text, old=old)


def gcode(text: str) -> Any:
    """Declare G-code of the user; there is no default."""
    return options.other(options.GCODE, None, text)


def as_probe(name: str) -> Any:
    """Declare an option just as [probe] has it."""
    (row,) = [row for row in options.PROBE_OPTIONS if row.name == name]
    return options.declare(row)


@dataclass(frozen=True)
class Settings:
    """What the user has configured: mm and mm/s; None: not given."""

    dock_position: Position = position(
        options.REQUIRED,
        "X, Y of the toolhead in the dock, in mm; a third number is Z.",
    )
    approach_position: Position = position(
        options.REQUIRED, "Straight into the dock from here."
    )
    detach_position: Position = position(
        options.REQUIRED, "Straight out to here, without the probe."
    )
    extract_position: Position = position(
        options.Same("approach_position"),
        "Straight out to here, with the probe. The default is"
        " approach_position.",
    )
    insert_position: Position = position(
        options.Same("extract_position"),
        "Straight into the dock from here, with the probe. The default is"
        " extract_position.",
    )
    # The default, which is the largest value, too, comes from the positions
    safe_dock_distance: float = options.number(
        None,
        "On all other ways the toolhead stays so far away from the dock, in mm. The"
        " default is the distance of the nearest position.",
        minval=0.0,
    )

    z_offset: float = options.number(
        options.REQUIRED, "How far the probe triggers below the nozzle, in mm."
    )
    pin: str = options.other(
        options.PIN, options.REQUIRED, "The MCU pin of the probe's switch."
    )
    x_offset: float = options.number(
        0.0, "The probe stands so far to the right of the nozzle, in mm."
    )
    y_offset: float = options.number(
        0.0, "The probe stands so far behind the nozzle, in mm."
    )
    samples: int = as_probe("samples")
    samples_tolerance: float = as_probe("samples_tolerance")
    samples_tolerance_retries: int = as_probe("samples_tolerance_retries")
    samples_result: str = as_probe("samples_result")
    speed: float = as_probe("speed")
    sample_retract_dist: float = as_probe("sample_retract_dist")

    # None while it is read: see is_fixed_z()
    dock_fixed_z: bool = flag(
        None,
        "False: the dock has a height of its own. The default is True where no"
        " position has a Z.",
    )
    z_hop: float = options.number(
        0.0,
        "Lowest height of the toolhead on the way to the dock, in mm.",
        minval=0.0,
    )
    safe_position: Optional[Position] = position(
        None,
        "The toolhead goes around the dock on the side of this point. There is no"
        " default.",
    )
    safe_z_position: Optional[Tuple[float, float]] = options.other(
        options.PAIR,
        None,
        "Where the toolhead stands while Z is homed with the probe. There is no"
        " default.",
        unit="mm",
    )
    travel_speed: float = options.speed(
        TRAVEL_SPEED, "Outside of the dock, in mm/s."
    )
    lift_speed: float = options.speed(
        options.Same("speed"), "All ways in Z, in mm/s. The default is speed."
    )
    attach_speed: float = options.speed(
        options.Same("travel_speed"),
        "Into the dock, and out with the probe, in mm/s. The default is"
        " travel_speed.",
    )
    detach_speed: float = options.speed(
        options.Same("travel_speed"),
        "Out without the probe, in mm/s. The default is travel_speed.",
    )
    dock_retries: int = options.other(
        options.COUNT,
        0,
        "How often fetching and docking are tried again.",
        minval=0,
    )
    restore_toolhead: bool = flag(
        True,
        "False: the toolhead stays at detach_position afterwards.",
        old=("return_to_last_probe_position_after_detach",),
    )

    check_open_attach: bool = flag(
        False,
        "True: pin reads open with the probe on the toolhead and TRIGGERED without"
        " it.",
    )
    probe_sense_pin: Optional[str] = options.other(
        options.PIN,
        None,
        "An MCU pin that is triggered while the probe is on the toolhead. There is"
        " no default.",
    )
    dock_sense_pin: Optional[str] = options.other(
        options.PIN,
        None,
        "An MCU pin that is triggered while the probe is in the dock. There is"
        " no default.",
    )

    auto_attach_detach: bool = flag(
        True,
        "False: commands that probe do not fetch and dock the probe by"
        " themselves.",
    )
    allow_delayed_detach: bool = flag(
        False, "True: the probe is docked one second after its last use."
    )
    detach_dockable_before_z_home: Optional[bool] = flag(
        None,
        "True: the probe is docked before Z is homed on its switch. The default"
        " is whether Z is homed so.",
    )
    drop_first_result: bool = flag(
        False, "True: one touch before the samples that does not count."
    )

    pre_attach_gcode: Optional[Template] = gcode(
        "Before the toolhead goes to fetch the probe. There is no default."
    )
    attach_gcode: Optional[Template] = gcode(
        "In the dock, at each attempt to fetch it. There is no default."
    )
    post_attach_gcode: Optional[Template] = gcode(
        "When it was fetched, or could not be. There is no default."
    )
    pre_detach_gcode: Optional[Template] = gcode(
        "Before the toolhead goes to dock it. There is no default."
    )
    detach_gcode: Optional[Template] = gcode(
        "In the dock, at each attempt to dock it. There is no default."
    )
    post_detach_gcode: Optional[Template] = gcode(
        "When it was docked, or could not be. There is no default."
    )
    activate_gcode: Optional[Template] = gcode(
        "Before the probe is fetched; must not move the toolhead. There is no"
        " default."
    )
    deactivate_gcode: Optional[Template] = gcode(
        "When it was docked, and the toolhead is back; must not move the toolhead. There"
        " is no default."
    )
    deactivate_on_each_sample: bool = flag(
        False, "True: both around each touch."
    )

    # What follows from these

    # How often and how fast a point is touched
    sampling: Sampling = Sampling(*[None] * 7)
    # How far (mm) the probe triggers below the nozzle, as far as that is known
    length: float = 0.0
    # Lowest useful toolhead Z (mm) of a probing move; the second over the pin that Z is
    # homed on, and everywhere where it is not known where that is
    lowest: float = 0.0
    over_pin: float = 0.0
    # The pin that Z is homed on; None: there is none, or it is not known where
    z_pin: Optional[Pin] = None
    # Where the toolhead stands while Z is homed with the probe: (x, y), MIDDLE, or None for
    # "where it is then"
    home_xy: Union[Tuple[float, float], str, None] = None
    # (low, high) of X and Y (mm) of the toolhead while a bed mesh is probed, or None
    mesh: Optional[List[Tuple[float, float]]] = None
    # Whether the section says where the dock is; otherwise the positions stand for none
    is_placed: bool = True
    # Toolhead Z (mm) to go to in a dock that goes up and down with the toolhead, before it
    # leaves without the probe; None: it stays as high
    strip_z: Optional[float] = None
    # Those of PARTS that a macro of the user stands in for
    macros: Tuple[str, ...] = ()
    # What may strip the probe off besides the way in X and Y, by name
    strippers: Tuple[str, ...] = ()

    def replace(self, **changes: Any) -> Settings:
        """Return the settings with other values."""
        return dataclasses.replace(self, **changes)

    @property
    def positions(self) -> Dict[str, Position]:
        """The positions outside of the dock, by option."""
        return {name: getattr(self, name) for name in OUTSIDE}

    @property
    def zone(self) -> path.Zone:
        """The circle around the dock."""
        dock = self.dock_position
        lanes = [path.direction(dock, p) for p in self.positions.values()]
        return path.Zone(dock.x, dock.y, self.safe_dock_distance, lanes)

    ##################################################################
    # Heights: toolhead Z (mm)
    ##################################################################

    @property
    def travel_z(self) -> float:
        """Where the attached probe is clear of the bed."""
        return self.length + self.sample_retract_dist

    @property
    def clear_z(self) -> float:
        """Where a straight line to or from the height of the way to the dock begins."""
        return max(
            self.length + max(self.sample_retract_dist, BENT), self.z_hop
        )

    @property
    def way_z(self) -> float:
        """How high the way to the dock is, over a bed or below a gantry that hangs askew.

        Levelling is what fetches the probe.  Where a dock goes up and down with the toolhead,
        its Z is what has to be cleared besides the bed.
        """
        more = self.dock_position.z or 0.0 if self.dock_fixed_z else 0.0
        clear = self.length + max(self.sample_retract_dist, REACH)
        return max(clear + more, self.z_hop)


OPTIONS = options.rows_of(Settings)

DOCK = "dock_position"
OUTSIDE = (
    "approach_position",
    "detach_position",
    "extract_position",
    "insert_position",
)
DISTANCE = "safe_dock_distance"
_PLACES = (DOCK, *OUTSIDE)


def _rows(*names: str) -> Tuple[options.Option, ...]:
    return tuple(row for row in OPTIONS if row.name in names)


# Of other plugins: the angle (degrees from +X towards +Y) of a position, and its distance
# from the dock
OLD_POSITIONS = (
    options.option(
        "dock_angle",
        options.NUMBER,
        None,
        "degrees",
        "Of approach_position.",
    ),
    options.option(
        "detach_angle",
        options.NUMBER,
        None,
        "degrees",
        "Of detach_position.",
    ),
    options.option(
        "dock_safe_distance",
        options.NUMBER,
        None,
        "mm",
        "Of both from the dock.",
        above=0.0,
    ),
)

# Stands for a position that is not known yet
NOWHERE = Position(0.0, 0.0, None)


######################################################################
# Reading them
######################################################################


def read_settings(
    config: Config, host: Host, old_names: options.OldNames
) -> Settings:
    """Return the settings; 'old_names' is told of what the user should write otherwise."""
    values = _read_positions(config, old_names.notes)
    nearest = nearest_distance(values)
    (row,) = _rows(DISTANCE)
    if values["is_placed"]:
        row = row._replace(limits=dict(row.limits, maxval=nearest))
    values.update(options.read(config, (row,), safe_dock_distance=nearest))
    if not values["is_placed"]:
        # Nothing is to be gone around
        values[DISTANCE] = nearest
    before = (*_PLACES, DISTANCE)
    others = [row for row in OPTIONS if row.name not in before]
    values.update(options.read(config, others, old_names))
    values["dock_fixed_z"] = is_fixed_z(config, values)
    check_senses(config, values)
    z_offset, homes_z = values["z_offset"], host.axes.homes_with_probe()
    endstop_z = host.axes.z_axis.position_endstop if host.axes.z_axis else None
    over_pin = lowest_touch(z_offset, homes_z, endstop_z)
    pin = read_pin(config, host.axes.z_axis)
    values.update(
        sampling=options.sampling_of(values),
        length=length_of(z_offset, homes_z),
        lowest=over_pin if pin is None else LOWEST_NOZZLE,
        z_pin=pin,
        over_pin=over_pin,
        home_xy=home_xy(config, values["safe_z_position"]),
        mesh=read_mesh(config, (values["x_offset"], values["y_offset"])),
        strip_z=strip_z(values),
        macros=read_macros(config),
    )
    return Settings(**values, strippers=strippers(values))


def _read_positions(config: Config, notes: List[str]) -> Dict[str, Any]:
    """Return those of the dock; a section that has none of them is to be set up."""
    given = [*_PLACES, *(row.name for row in OLD_POSITIONS)]
    if all(config.get(name, None) is None for name in given):
        nowhere: Dict[str, Any] = dict.fromkeys(_PLACES, NOWHERE)
        return dict(nowhere, is_placed=False)
    values = options.read(config, _rows(DOCK))
    angles = _read_angles(config, values[DOCK], notes)
    defaults: Dict[str, Any] = {**angles}
    values.update(options.read(config, _rows(*OUTSIDE), **defaults))
    return dict(values, is_placed=True)


def _read_angles(
    config: Config, dock: Position, notes: List[str]
) -> Dict[str, Position]:
    """Return positions that are given by the angles of old, by the names of their options."""
    given = options.read(config, OLD_POSITIONS)
    length, positions = given["dock_safe_distance"], {}
    for old, new in (
        ("dock_angle", "approach_position"),
        ("detach_angle", "detach_position"),
    ):
        if given[old] is None:
            continue
        if length is None:
            what = f"needs dock_safe_distance; better write {new}"
            raise options.config_error(config, old, what)
        x, y = path.on_circle(dock, math.radians(given[old]), length)
        positions[new] = Position(x, y, None)
        notes.append(
            f"options '{old}' and 'dock_safe_distance' are now '{new}: {x:.1f},"
            f" {y:.1f}'"
        )
    return positions


def nearest_distance(values: Mapping[str, Any]) -> float:
    """Return the distance (mm) from the dock to the nearest position that is another place.

    'values' are the positions by their options.
    """
    dock = values[DOCK]
    apart = [path.distance(dock, values[name]) for name in OUTSIDE]
    return min([mm for mm in apart if mm >= path.SMALLEST_DISTANCE] or [0.0])


def is_fixed_z(config: Config, values: Mapping[str, Any]) -> bool:
    """Return whether the dock is at the toolhead's height in any case.

    It is so without a word about it, unless a position has a Z.
    """
    dock, given = values[DOCK], values["dock_fixed_z"]
    if given is None:
        return all(values[name].z is None for name in _PLACES)
    if not given and dock.z is None and values["is_placed"]:
        what = "is False: dock_position needs the Z of the dock as third number"
        raise options.config_error(config, "dock_fixed_z", what)
    return bool(given)


def strip_z(values: Mapping[str, Any]) -> Optional[float]:
    """Return where (mm) to go in the dock to strip the probe off up or down, None: nowhere.

    A Z of detach_position is how high the toolhead is on the way out.  Where the dock goes
    up and down with it only that Z can mean to strip the probe off: where the ways in X and
    Y do not, and no G-code of the user does.
    """
    angle = path.strip_angle(
        values[DOCK],
        None,
        values["extract_position"],
        values["detach_position"],
    )
    is_wanted = values["dock_fixed_z"] and values["detach_gcode"] is None
    z: Optional[float] = values["detach_position"].z
    return z if is_wanted and angle < DOUBTFUL_WAY else None


def read_macros(config: Config) -> Tuple[str, ...]:
    """Return those of PARTS that a macro of the user stands in for."""
    names = {
        section.get_name().split()[-1].upper()
        for section in config.get_prefix_sections("gcode_macro ")
    }
    return tuple(name for name in PARTS if name in names)


def strippers(values: Mapping[str, Any]) -> Tuple[str, ...]:
    """Return what may strip the probe off besides the way in X and Y, by name."""
    found = [
        name
        for name in ("detach_gcode", "pre_detach_gcode")
        if values[name] is not None
    ]
    if values["strip_z"] is not None:
        found.append("the Z of detach_position")
    return (*found, *("the macro " + name for name in values["macros"]))


def check_senses(config: Config, values: Mapping[str, Any]) -> None:
    """Raise the error of a configuration where nothing tells where the probe is."""
    senses = "check_open_attach", "probe_sense_pin", "dock_sense_pin"
    if not any(values[name] for name in senses):
        raise config.error(
            f"Section '{config.get_name()}': nothing tells whether the probe is"
            " attached; set check_open_attach: True if 'pin' reads open with the"
            " probe on the toolhead and TRIGGERED without it, or give"
            " probe_sense_pin or dock_sense_pin"
        )


def home_xy(
    config: Config, safe_z_position: Optional[Tuple[float, float]]
) -> Union[Tuple[float, float], str, None]:
    """Return where the toolhead stands while Z is homed with the probe; see Settings.

    Other sections that say so leave it there.
    """
    others = ("safe_z_home", "homing_override")
    if safe_z_position is None and not any(map(config.has_section, others)):
        return MIDDLE
    return safe_z_position


def read_mesh(
    config: Config, offsets: Sequence[float]
) -> Optional[List[Tuple[float, float]]]:
    """Return (low, high) of X and Y (mm) of the toolhead while a mesh is probed, or None.

    'offsets': X and Y (mm) from the nozzle to the probe.
    """
    if not config.has_section("bed_mesh"):
        return None
    section = config.getsection("bed_mesh")
    low, high = (
        section.getfloatlist(name, None, count=2, note_valid=False)
        for name in ("mesh_min", "mesh_max")
    )
    if None in (low, high):
        return None
    return [(a - shift, b - shift) for a, b, shift in zip(low, high, offsets)]


######################################################################
# Heights
######################################################################


def length_of(z_offset: float, homes_z: bool) -> float:
    """Return how far (mm) the probe triggers below the nozzle, as far as that is known.

    Where Z is homed with the probe it triggers at z_offset, whatever that is.
    """
    if z_offset >= SMALLEST_Z_OFFSET or homes_z:
        return z_offset
    return UNMEASURED_PROBE


def lowest_touch(
    z_offset: float, homes_z: bool, endstop_z: Optional[float]
) -> float:
    """Return the lowest useful toolhead Z (mm) of a probing move.

    'homes_z': Z is homed with the probe.  'endstop_z' (mm) is otherwise where the nozzle may
    meet the pin that Z is homed on, or None.
    """
    if not homes_z:
        above_pin = (endstop_z or 0.0) + LOWEST_NOZZLE
        return max(LOWEST_NOZZLE, above_pin if above_pin < z_offset else 0.0)
    if z_offset < SMALLEST_Z_OFFSET:
        return z_offset - LOWEST_NOZZLE
    return max(LOWEST_NOZZLE, z_offset - REACH)
