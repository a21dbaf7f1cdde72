"""The options of [z_calibration] as declared fields, and what follows from them.

A new option is one field with its text, its use, and one test.  The documents take their
tables from OPTIONS, the rows of these fields.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    FrozenSet,
    List,
    Optional,
    Set,
    Tuple,
)

from .. import options, pin
from ..errors import CalibrationError
from ..host.endstops import chip_of
from ..options import Given
from ..sampling import AUTO, Sampling, filled
from ..texture import LARGEST_SPREAD
from ..touch import Site, option_site
from . import heights, pace

if TYPE_CHECKING:
    from ..host.klippy import Config, GCodeCommand, Template
    from ..host.toolhead import ZAxis

# Results outside these limits (mm) are refused: the homing is outdated or
# something was touched that should not have been.
OFFSET_MARGINS = (-1.0, 1.0)

# How far (mm) below the expected height a touch may still look.
TRAVEL_MARGIN = 1.0

# So high (mm) a pin of its own may stand that was never measured; the probe
# passes it before the nozzle touches it.
UNMEASURED_PIN = 10.0

# Lift (mm) between two touches where homing_retract_dist is 0, which is
# right for homing only: without a lift the next touch starts on a pressed
# switch.  2 mm is more than the hysteresis of any common micro switch.
FALLBACK_RETRACT = 2.0

# XY speed (mm/s) between the places, but for CALIBRATE_Z, see pace.py
IDLE_TRAVEL_SPEED = 50.0

# What the offset may be off by (mm, 95 %) with samples: auto
TARGET_UNCERTAINTY = 0.008

# What it may be off by with samples: auto and bed_spread (mm, 95 %): what seven touches
# of a rough plate give
ROUGH_TARGET = 0.013

# No hotend grows by more (mm per 100 C): 100 mm of aluminium do so by 0.24
LARGEST_GROWTH = 0.25

# Beside printer.cfg
FOLDER = "z_calibration"
RUNS = 1000
# Each is looked at when klippy connects
MOST_RUNS = 100000

# Whether the buttons that save the Z offset save into switch_offset
SAVE_BUTTON = {"off": False, "switch_offset": True}

# Parameters of a command, and the options that they stand for
PACE_PARAMS = (
    ("SAMPLE_RETRACT_DIST", "probing_retract_dist"),
    ("LIFT_SPEED", "lift_speed"),
)

# With samples: auto they count for nothing
IDLE_WITH_AUTO = (
    "samples_tolerance",
    "samples_tolerance_retries",
    "samples_result",
)

# Without it this does
IDLE_WITH_COUNT = ("target_uncertainty",)


def _read_shift(config: Config, name: str, row: options.Option) -> Any:
    """Return a distance in X and Y; none at all counts as not given."""
    shift = options.read_pair(config, name)
    return shift if shift and any(shift) else None


def why_negative(switch_offset: float) -> str:
    """Return what a negative switch_offset (mm) means: the specification has a chapter on it."""
    return (
        f"is {switch_offset:g}, and cannot be negative: the plunger triggers below the"
        " switch body, and where the nozzle is too close to the bed with 0, the pin"
        " does not press that body; check switch_xy_position, the endstop and its pin"
    )


def _read_switch_offset(config: Config, name: str, row: options.Option) -> Any:
    value = options.read_number(config, name, row.default)
    if value is not None and value < 0.0:
        raise options.config_error(config, name, why_negative(value))
    return value


def _read_folder(config: Config, name: str, row: options.Option) -> Any:
    """Return a folder, None where there is to be none."""
    folder = config.get(name, row.default).strip()
    if not folder:
        raise options.config_error(config, name, "is no folder, nor none")
    return None if folder.lower() == "none" else folder


SHIFT = options.PAIR._replace(read=_read_shift)
SWITCH_OFFSET = options.NUMBER._replace(read=_read_switch_offset)
HISTORY = options.Kind("folder", _read_folder, ("", " "))


def gcode(default: Optional[str], text: str) -> Any:
    """Declare G-code; where the default is None it matters whether there is any."""
    return options.other(options.GCODE, default, text)


@dataclass(frozen=True)
class Settings:
    """What the user has configured: mm and mm/s.

    None stands for "as the probe has it" until complete() has filled it in, and for a place
    or a switch_offset that is to come with the command.
    """

    nozzle_xy_position: Optional[Site] = options.declare(pin.NOZZLE_POSITION)
    switch_xy_position: Optional[Site] = options.declare(
        options.site_option(
            "switch_xy_position",
            "X, Y of the toolhead when the body of the probe's switch is above the same"
            " pin, with its flat side beside the plunger.",
        )
    )
    switch_xy_offsets: Optional[Tuple[float, float]] = options.other(
        options.PAIR,
        None,
        "Instead of switch_xy_position: the way from the nozzle position to it,"
        " in mm. There is no default.",
        unit="mm",
    )
    bed_xy_position: Optional[Site] = options.declare(
        options.site_option(
            "bed_xy_position",
            "The point of the bed that the probe touches. The default is"
            " zero_reference_position of [bed_mesh].",
        )
    )
    bed_spread: float = options.number(
        0.0,
        "For a textured plate, such as 3: each touch of the bed is at another"
        " point, up to so far from there, in mm. 0: all are at that point.",
        minval=0.0,
        maxval=LARGEST_SPREAD,
    )
    wiggle_xy_offsets: Optional[Tuple[float, float]] = options.other(
        SHIFT,
        None,
        "Moves the toolhead by so much and back after each touch of the nozzle, for"
        " a pin that sticks to it. There is no default.",
        unit="mm",
    )

    switch_offset: Optional[float] = options.other(
        SWITCH_OFFSET,
        None,
        "How far the plunger still sticks out of the switch body when the switch"
        " triggers, in mm. Larger: nozzle closer to the bed.",
        unit="mm",
        minval=0.0,
    )
    nozzle_growth: Optional[float] = options.number(
        None,
        "How much longer the nozzle is for each 100 C, in mm, for CALIBRATE_Z with"
        " EXTRUDER_TEMP. Z_CALIBRATION_NOZZLE_GROWTH finds it. There is no default.",
        minval=0.0,
        maxval=LARGEST_GROWTH,
    )
    save_button: bool = options.other(
        options.choice(SAVE_BUTTON),
        "off",
        "What the button that saves the Z offset does after a CALIBRATE_Z. off:"
        " the same as without this module. switch_offset: it keeps baby steps"
        " there.",
    )
    offset_margins: Tuple[float, float] = options.other(
        options.MARGINS,
        OFFSET_MARGINS,
        "An offset (in mm) outside of these is refused.",
        unit="mm",
        old=("max_deviation",),
    )

    safe_z_height: float = options.number(
        None,
        "The toolhead travels at least so high, in mm. The default is twice the"
        " z_offset of [probe].",
        above=0.0,
    )
    clearance: float = options.number(
        0.0,
        "Before it moves on to the next place the toolhead is lifted by at least this"
        " above the last touch, in mm.",
        minval=0.0,
    )
    travel_margin: float = options.number(
        TRAVEL_MARGIN,
        "How much lower than expected a touch may go, and how much room is left"
        " below the toolhead on its way, in mm.",
        above=0.0,
    )
    position_min: float = options.number(
        None,
        "No touch goes lower, in mm. The default is position_min of"
        " [stepper_z].",
    )
    endstop_pin: Optional[str] = options.declare(pin.ENDSTOP_PIN)

    speed: float = options.speed(
        IDLE_TRAVEL_SPEED,
        "Travel in X and Y, in mm/s. In CALIBRATE_Z the default is 100.",
    )
    probing_speed: float = options.speed(
        None,
        "The quick part of the way down, in mm/s. The default is homing_speed of"
        " [stepper_z]; in CALIBRATE_Z it is that of lift_speed, slower where half of"
        " travel_margin would not be enough to stop.",
        old=("homing_speed",),
    )
    probing_second_speed: float = options.speed(
        None,
        "The touches that count, in mm/s. The default is second_homing_speed of"
        " [stepper_z]; on the bed it is speed of [probe].",
        old=("second_homing_speed",),
    )
    probing_retract_dist: float = options.number(
        None,
        "Lift between two touches, in mm. In CALIBRATE_Z the default is as short as"
        " the switch opens, 0.5 or more. Otherwise it is homing_retract_dist of"
        " [stepper_z], on the bed sample_retract_dist of [probe].",
        old=("homing_retract_dist",),
        above=0.0,
    )
    lift_speed: Optional[float] = options.as_in_probe(
        "lift_speed",
        "All ways up, in mm/s. The default is that of [probe]; in CALIBRATE_Z it is"
        " homing_speed of [stepper_z] where that is larger.",
    )
    probing_first_fast: bool = options.other(
        options.FLAG,
        False,
        "True: the first touch at each place is a fast one that does not count, at"
        " probing_speed, or without that at homing_speed of [stepper_z].",
    )
    samples: Any = options.as_in_probe(
        "samples",
        "Touches at each place, or auto: as many as are needed. The default"
        " is that of [probe].",
        kind=options.SAMPLES,
    )
    target_uncertainty: float = options.number(
        Given("bed_spread", ROUGH_TARGET, TARGET_UNCERTAINTY),
        "With samples: auto, what the offset may be off by, in mm. With"
        " bed_spread the default is 0.013.",
        above=0.0,
    )
    samples_tolerance: Optional[float] = options.as_in_probe(
        "samples_tolerance",
        "How far touches may be apart, in mm. The default is that of [probe].",
    )
    samples_tolerance_retries: Optional[int] = options.as_in_probe(
        "samples_tolerance_retries",
        "How often they may start again. The default is that of [probe].",
    )
    samples_result: Optional[str] = options.as_in_probe(
        "samples_result",
        "median or average. The default is that of [probe]; none, which the"
        " original has by default, is the same as that.",
        kind=options.choice({**options.RESULTS, "none": None}),
    )

    retries: int = options.other(
        options.COUNT,
        0,
        "How often CALIBRATE_Z begins once more if touches have failed or differ too"
        " much. The probe is put away first, and clean_gcode runs.",
        minval=0,
        maxval=options.MOST_TRIES,
    )
    history: Optional[str] = options.other(
        HISTORY,
        FOLDER,
        "The folder, beside printer.cfg, that keeps a line for each run. none:"
        " nothing is kept.",
    )
    history_runs: int = options.other(
        options.COUNT,
        RUNS,
        "How many lines it keeps.",
        minval=1,
        maxval=MOST_RUNS,
    )

    start_gcode: Template = gcode("", "Your macro that attaches the probe.")
    clean_gcode: Optional[Template] = gcode(
        None,
        "Runs once in a run, if something seems to stick to the nozzle. There is"
        " no default.",
    )
    before_switch_gcode: Template = gcode(
        "",
        "Runs between nozzle and switch: attach the probe here, and not in"
        " start_gcode, where it is in the way of the nozzle. There is no"
        " default.",
    )
    end_gcode: Template = gcode(
        "", "Your macro that puts the probe away; it runs after an error, too."
    )
    offset_gcode: Optional[Template] = gcode(
        None,
        "Runs instead of SET_GCODE_OFFSET, with the offset as params.Z. There is"
        " no default.",
    )
    error_gcode: Optional[Template] = gcode(
        None,
        "Runs last after an error, with the message as params.ERROR. There is no"
        " default.",
    )

    # What follows from these, or comes when klippy connects

    # How what is on the pin is touched, and the bed; samples None: as many as needed
    on_pin: Sampling = Sampling(*[None] * 7)
    on_bed: Sampling = Sampling(*[None] * 7)
    # before_switch_gcode may attach the probe, or a dockable_probe does so by itself
    may_attach_late: bool = False
    start_homes: bool = False
    # Toolhead Z at which the pin stops Z in homing; None: Z is not homed on the pin
    position_endstop: Optional[float] = None
    # Of the Z axis
    position_max: float = float("inf")
    # Of the probe
    z_offset: float = 0.0
    # How high the pin is taken for until it was touched
    unmeasured_pin: float = 0.0
    # What the bed mesh covers, see pin.mesh_area()
    mesh_area: Optional[Tuple[pin.Point, pin.Point]] = None
    # The options that the user has given, or the command
    given: FrozenSet[str] = frozenset()
    # Of a CALIBRATE_Z: how hot (degrees C) the nozzle will print; None: that does not count
    extruder_temp: Optional[float] = None
    # Of a CALIBRATE_Z: how fast Z moves where nothing is touched; None: another command
    z_speed: Optional[float] = None

    def replace(self, **changes: Any) -> Settings:
        """Return the settings with other values."""
        return dataclasses.replace(self, **changes)

    @property
    def is_auto(self) -> bool:
        """Whether a place is touched as often as the result needs."""
        return bool(self.samples == AUTO)

    @property
    def target(self) -> Optional[float]:
        """What the offset may be off by (mm, 95 %) with samples: auto, else None."""
        return self.target_uncertainty if self.is_auto else None


OPTIONS = options.rows_of(Settings)


######################################################################
# Reading the section
######################################################################


def read_settings(
    config: Config, z_axis: ZAxis, old_names: options.OldNames
) -> Settings:
    """Return the settings as far as they are known before klippy connects.

    What the user is to be told is added to the notes of old_names.
    """
    values = options.read(
        config,
        OPTIONS,
        old_names,
        probing_speed=z_axis.homing_speed,
        probing_second_speed=z_axis.second_homing_speed,
        probing_retract_dist=z_axis.homing_retract_dist or FALLBACK_RETRACT,
    )
    _note_idle_options(values["samples"] == AUTO, old_names)
    if values["endstop_pin"] is None:
        # None also where it is the probe that Z is homed with: refused later
        values["position_endstop"] = z_axis.position_endstop
        if values["nozzle_xy_position"] is None:
            values["nozzle_xy_position"] = _read_home(config)
    _limit_position_min(config, values, z_axis, old_names)
    values["given"] = frozenset(
        row.name for row in OPTIONS if old_names.was_given(row.name)
    )
    values["on_pin"], values["on_bed"] = _samplings_of(values)
    values["mesh_area"] = pin.mesh_area(config)
    start, before_switch = [
        config.get(name, "") for name in ("start_gcode", "before_switch_gcode")
    ]
    values["start_homes"] = homes(start, _read_macros(config))
    values["may_attach_late"] = bool(
        before_switch.strip()
    ) or config.has_section("dockable_probe")
    return Settings(**values)


def _read_home(config: Config) -> Optional[Site]:
    """Return where Z is homed on the pin itself, by [safe_z_home]."""
    if not config.has_section("safe_z_home"):
        return None
    name, home = "home_xy_position", config.getsection("safe_z_home")
    point = home.getfloatlist(name, None, count=2, note_valid=False)
    return option_site(home, "nozzle", name, point) if point else None


def _samplings_of(values: Dict[str, Any]) -> Tuple[Sampling, Sampling]:
    """Return how pin and bed are touched.

    For the bed only what is given, the rest is as the probe has it.
    """
    given = values["given"]
    second_speed, retract = "probing_second_speed", "probing_retract_dist"
    on_pin = options.sampling_of(
        dict(
            values,
            samples=None if values["samples"] == AUTO else values["samples"],
            speed=values[second_speed],
            sample_retract_dist=values[retract],
        )
    )
    on_bed = on_pin._replace(
        speed=on_pin.speed if second_speed in given else None,
        retract_dist=on_pin.retract_dist if retract in given else None,
    )
    return on_pin, on_bed


def _limit_position_min(
    config: Config,
    values: Dict[str, Any],
    z_axis: ZAxis,
    old_names: options.OldNames,
) -> None:
    """Have position_min no lower than the axis, and refuse one that leaves no room."""
    lowest, homed_z = values["position_min"], values.get("position_endstop")
    position_min, section = z_axis.position_min, z_axis.section
    if lowest is not None and lowest < position_min:
        old_names.notes.append(
            f"option 'position_min: {lowest:g}' is ignored, section '{section}' ends at"
            f" {position_min:g}"
        )
    elif lowest is not None and lowest > position_min:
        position_min, section = lowest, config.get_name()
    values["position_min"] = position_min
    if homed_z is None or chip_of(z_axis.endstop_pin) == "probe":
        return
    if homed_z - position_min < heights.LEAST_ROOM:
        raise config.error(
            f"Option 'position_min' in section '{section}': {position_min:.3f} leaves no"
            f" touch the room to press the pin at position_endstop ({homed_z:.3f}) of"
            f" section '{z_axis.section}'; set it to"
            f" {homed_z - values['travel_margin']:.3f} or lower"
        )


def _note_idle_options(is_auto: bool, old_names: options.OldNames) -> None:
    """Note options that count for nothing, as samples is auto, or is not."""
    how = "with" if is_auto else "without"
    for name in IDLE_WITH_AUTO if is_auto else IDLE_WITH_COUNT:
        if old_names.was_given(name):
            old_names.notes.append(
                f"option '{name}' is ignored {how} 'samples: auto'"
            )


def _read_macros(config: Config) -> Dict[str, str]:
    """Return the texts of the user's macros by their names."""
    return {
        section.get_name().upper().split()[-1]: section.get(
            "gcode", "", note_valid=False
        ).upper()
        for section in config.get_prefix_sections("gcode_macro ")
    }


def homes(text: str, macros: Dict[str, str]) -> bool:
    """Return whether some G28 stands in G-code, or in macros that it calls."""
    todo = [text.upper()]
    seen: Set[str] = set()
    while todo:
        words = set(re.findall(r"[A-Z0-9_]+", todo.pop())) - seen
        if "G28" in words:
            return True
        seen |= words
        todo += [macros[word] for word in words if word in macros]
    return False


def complete(
    settings: Settings, probe: Sampling, z_offset: float, position_max: float
) -> Settings:
    """Let the probe and the axis decide what the user has left open (mm)."""
    settings = settings.replace(
        on_pin=filled(settings.on_pin, probe),
        on_bed=filled(settings.on_bed, probe),
        z_offset=z_offset,
        position_max=position_max,
    )
    if settings.safe_z_height is not None:
        return settings.replace(unmeasured_pin=0.0)
    # Perhaps with the probe on
    is_passed = settings.position_endstop is None
    return settings.replace(
        safe_z_height=heights.default_safe_z(z_offset),
        unmeasured_pin=UNMEASURED_PIN if is_passed else 0.0,
    )


######################################################################
# Parameters of commands
######################################################################


def with_touches(settings: Settings, gcmd: GCodeCommand) -> Settings:
    """Return the settings with what PROBE takes as parameters; they count everywhere."""
    on_pin = options.param_touches(gcmd, settings.on_pin)
    on_bed = options.param_touches(gcmd, settings.on_bed)
    count = options.param_samples(gcmd)
    if count is not None:
        settings = settings.replace(samples=count)
    if count not in (None, AUTO):
        on_pin = on_pin._replace(samples=count)
        on_bed = on_bed._replace(samples=count)
    given = settings.given.union(
        option for name, option in PACE_PARAMS if gcmd.get(name, "").strip()
    )
    return settings.replace(on_pin=on_pin, on_bed=on_bed, given=given)


def idle_params(settings: Settings, gcmd: GCodeCommand) -> List[str]:
    """Return those of these parameters that count for nothing."""
    if not settings.is_auto:
        return []
    names = [name.upper() for name in IDLE_WITH_AUTO]
    return [name for name in names if gcmd.get(name, "").strip()]


def with_switch_offset(settings: Settings, gcmd: GCodeCommand) -> Settings:
    """Return the settings with SWITCH_OFFSET; see param_switch_offset()."""
    switch_offset = param_switch_offset(gcmd, settings.switch_offset)
    return settings.replace(switch_offset=switch_offset)


def param_switch_offset(gcmd: GCodeCommand, default: Optional[float]) -> float:
    """Return SWITCH_OFFSET (mm), or the default.

    Raises CalibrationError where there is neither.
    """
    value: Optional[float] = options.param_number(
        gcmd, "SWITCH_OFFSET", default
    )
    if value is not None and value < 0.0:
        raise CalibrationError(f"SWITCH_OFFSET {why_negative(value)}")
    if value is None:
        raise CalibrationError(
            "no switch_offset; run Z_CALIBRATION_SETUP, set it in section"
            " 'z_calibration', or add SWITCH_OFFSET=mm"
        )
    return value


def with_pace(settings: Settings, z_speed: float, z_accel: float) -> Settings:
    """Return the settings of one CALIBRATE_Z, with what the section leaves open.

    z_speed: as fast as the user moves Z elsewhere (mm/s); z_accel: of Z (mm/s^2).  See pace.py.
    """
    on_pin, on_bed, given = settings.on_pin, settings.on_bed, settings.given
    if "lift_speed" not in given:
        on_pin = on_pin._replace(lift_speed=z_speed)
        on_bed = on_bed._replace(lift_speed=z_speed)
    settings = settings.replace(z_speed=on_pin.lift_speed)
    if may_lengthen(settings):
        on_bed = pace.shortened(on_bed, z_accel)
        if settings.wiggle_xy_offsets is None:
            on_pin = pace.shortened(on_pin, z_accel)
    if "probing_speed" not in given:
        fastest = min(z_speed, on_pin.lift_speed)
        settings = settings.replace(
            probing_speed=pace.armed_speed(
                settings.travel_margin, fastest, z_accel
            )
        )
    if "speed" not in given:
        settings = settings.replace(speed=pace.TRAVEL_SPEED)
    return settings.replace(on_pin=on_pin, on_bed=on_bed)


def may_lengthen(settings: Settings) -> bool:
    """Return whether the lifts between touches are the module's, as in CALIBRATE_Z."""
    is_run = settings.z_speed is not None
    return is_run and "probing_retract_dist" not in settings.given
