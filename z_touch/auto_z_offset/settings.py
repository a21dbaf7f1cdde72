"""The options of [auto_z_offset].

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Dict, List, Optional

from .. import options
from ..sampling import Sampling
from ..texture import LARGEST_SPREAD
from ..touch import Site
from .heights import LARGEST_OFFSET, Floor, inside_bed, section_floor

if TYPE_CHECKING:
    from ..host.klippy import Config, Template
    from ..host.toolhead import ZAxis

# A smaller hop (mm) leaves an inductive probe triggered.
SMALLEST_HOP = 4.0

# XY speed (mm/s) between the sites, unless configured.
TRAVEL_SPEED = 100.0

# Corrections of one AUTO_Z_CALIBRATE that differ more (mm) are no noise.
CYCLES_TOLERANCE = 0.2

# Piezo sensors miss slower touches (mm/s): field reports of owners, nothing was measured
# here.  One of 1,400 touches had no trigger below 3.5 mm/s.
SLOW_TOUCH = 4.0


def _read_result(config: Config, name: str, row: options.Option) -> Any:
    """Return average or median; upper case counts, too: the original module takes it."""
    result = config.get(name, row.default).lower()
    if result not in options.RESULTS:
        raise options.config_error(config, name, "must be average or median")
    return result


RESULT = options.RESULT._replace(read=_read_result)

NOZZLE_ITSELF = "is ignored: the nozzle itself presses the bed"

# Of the original module: why each is not used.
UNUSED_OPTIONS = (
    options.unused(
        "calibrated_z_offset",
        "is not applied: it contains the whole z_offset of the probe; run"
        " AUTO_Z_CALIBRATE again, then SAVE_CONFIG",
    ),
    options.unused("x_offset", NOZZLE_ITSELF),
    options.unused("y_offset", NOZZLE_ITSELF),
    options.unused("activate_gcode", "is not run; move it into prepare_gcode"),
    options.unused(
        "deactivate_gcode",
        "is not run; move it into a macro that runs after AUTO_Z_CALIBRATE",
    ),
    options.unused("deactivate_on_each_sample", "is ignored"),
    options.unused("stow_on_each_sample", "is ignored"),
    options.unused(
        "recovery_time", "is ignored; end prepare_gcode with G4 instead"
    ),
)


@dataclass(frozen=True)
class Settings:
    """What the user has configured: mm, mm/s and mm/s^2."""

    pin: str = options.other(
        options.PIN,
        options.REQUIRED,
        "The MCU pin with the signal of the bed sensor.",
    )
    prepare_gcode: Template = options.other(
        options.GCODE,
        options.REQUIRED,
        "Your G-code that turns the sensor on. It runs once for each command"
        " that measures, with the toolhead over the bed. May be empty.",
    )
    z_offset: float = options.number(
        0.2,
        "The air gap, in mm, between the trigger point of the sensor and Z=0."
        " Larger: nozzle further away from the bed. It is not the z_offset of"
        " the probe.",
        minval=-LARGEST_OFFSET,
        maxval=LARGEST_OFFSET,
    )
    probe_z_correction: Optional[float] = options.number(
        None,
        "The result, in mm. SAVE_CONFIG writes it.",
        minval=-LARGEST_OFFSET,
        maxval=LARGEST_OFFSET,
    )
    corrected_probe_z_offset: Optional[float] = options.number(
        None,
        "The z_offset of [probe] that it was measured with. SAVE_CONFIG writes"
        " it.",
    )
    corrected_bed_temp: Optional[float] = options.number(
        None,
        "How hot the bed was then, in degrees C. SAVE_CONFIG writes it.",
        unit="",
        minval=-100.0,
        maxval=500.0,
    )
    corrected_chamber_temp: Optional[float] = options.number(
        None,
        "How hot the chamber was then, in degrees C, where a heater or a sensor has"
        " that name. SAVE_CONFIG writes it.",
        unit="",
        minval=-100.0,
        maxval=500.0,
    )
    # None: the middle of the axes
    bed_xy_position: Optional[Site] = options.other(
        options.site_kind("bed"),
        None,
        "The point of the bed to measure. The default is the middle of the axes.",
        unit="mm",
    )
    bed_spread: float = options.number(
        0.0,
        "For a textured plate, such as 3: each touch of the nozzle is at another"
        " point, up to so far from there, in mm. 0: all are at that point.",
        minval=0.0,
        maxval=LARGEST_SPREAD,
    )
    probe_hop: float = options.number(
        SMALLEST_HOP,
        "How far the toolhead is lifted to travel, in mm.",
        minval=SMALLEST_HOP,
    )
    probe_z_min: Optional[float] = options.number(
        None,
        "No touch goes lower, in mm; set it about 1 mm below the bed. The"
        " default is position_min of [stepper_z].",
    )
    travel_speed: float = options.speed(
        TRAVEL_SPEED, "Travel in X and Y, in mm/s."
    )
    probe_accel: float = options.number(
        0.0,
        "Limit of acceleration while the nozzle goes down, in mm/s^2. 0: none.",
        unit="mm/s^2",
        minval=0.0,
    )
    z_current_factor: float = options.number(
        0.33,
        "The Z motors have this share of their current while the nozzle goes"
        " down.",
        unit="",
        minval=0.1,
        maxval=1.0,
    )
    offset_samples: int = options.other(
        options.COUNT,
        3,
        "Cycles of AUTO_Z_CALIBRATE.",
        minval=1,
        maxval=options.MOST_TOUCHES,
    )
    retries: int = options.other(
        options.COUNT,
        0,
        "How often AUTO_Z_CALIBRATE begins once more, with prepare_gcode, if touches"
        " have failed or differ too much.",
        minval=0,
        maxval=options.MOST_TRIES,
    )
    cycles_tolerance: float = options.number(
        CYCLES_TOLERANCE,
        "How far the results of the cycles may be apart, in mm.",
        minval=0.0,
    )

    # For both sensors, with the names that [probe] has for them; its own are not used here
    speed: float = options.speed(5.0, "Down, with sensor and probe, in mm/s.")
    lift_speed: float = options.speed(20.0, "Up, in mm/s.")
    samples: int = options.other(
        options.COUNT,
        1,
        "Touches of sensor and probe in each cycle.",
        minval=1,
        maxval=options.MOST_TOUCHES,
    )
    samples_tolerance: float = options.number(
        0.1,
        "How far touches at one point may be apart, in mm.",
        minval=0.0,
    )
    samples_tolerance_retries: int = options.other(
        options.COUNT,
        0,
        "How often touches may start again.",
        minval=0,
        maxval=options.MOST_TOUCHES,
    )
    samples_result: str = options.other(
        RESULT, "average", "average or median, of touches and of cycles."
    )
    sample_retract_dist: float = options.number(
        3.0, "Lift between two touches, in mm.", above=0.0
    )

    # What follows from these

    # What the options of sampling become
    sampling: Sampling = Sampling(*[None] * 7)
    # The lowest point of all touches
    floor: Floor = Floor(0.0, "", "")
    # What the user is told when klippy is ready
    notes: List[str] = None  # type: ignore[assignment]
    # The G-code is given that powered the sensor with the original module
    lost_activate_gcode: bool = False
    # calibrated_z_offset is given and z_offset is below 0: the section of the original
    # module, as it was
    is_others: bool = False


OPTIONS = options.rows_of(Settings)


def read_settings(config: Config, z_axis: ZAxis) -> Settings:
    """Return the settings of the section."""
    values = options.read(config, OPTIONS)
    unused = options.read(config, UNUSED_OPTIONS)
    values.update(
        sampling=options.sampling_of(values),
        floor=section_floor(z_axis, values["probe_z_min"]),
        notes=options.unused_notes(unused, UNUSED_OPTIONS),
        lost_activate_gcode=bool(unused["activate_gcode"]),
        is_others=values["z_offset"] < 0.0
        and bool(unused["calibrated_z_offset"]),
    )
    values["notes"] += _settings_notes(values)
    return Settings(**values)


def _settings_notes(values: Dict[str, Any]) -> List[str]:
    """Return what the user is told of the section when klippy is ready."""
    notes = []
    probe_z_min, floor = values["probe_z_min"], values["floor"]
    if probe_z_min is not None and probe_z_min < floor.z:
        notes.append(
            f"'probe_z_min: {probe_z_min:g}' is ignored, {floor.why} is {floor.z:g}"
        )
    inside = inside_bed(values["z_offset"])
    if inside:
        notes.append(inside)
    if values["speed"] < SLOW_TOUCH:
        notes.append(
            f"'speed: {values['speed']:g}' is slow for a piezo sensor, which may not"
            f" trigger below {SLOW_TOUCH:g} mm/s; set speed to 5 or more"
        )
    return notes
