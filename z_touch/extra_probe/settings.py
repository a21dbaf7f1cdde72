"""The options of [extra_probe NAME] as declared fields.

A new option is one field with its text, its use, and one test.  The documents take their
tables from OPTIONS, the rows of these fields.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Dict, Optional

from .. import options
from ..sampling import Sampling, filled
from ..touch import Site

if TYPE_CHECKING:
    from ..host.klippy import Config, Template

# The name of a section whose switch is [probe]
PROBE = "probe"

SAFE_Z = 10.0  # mm: room for a hand, and above a bed that is homed wrongly
TRAVEL_SPEED = 50.0  # mm/s, in X and Y
MAX_TEMPERATURE = 120.0  # C; a nozzle that is hotter is refused


@dataclass(frozen=True)
class SwitchSettings:
    """What a switch on a pin of its own has; [extra_probe probe] has none of these."""

    pin: str = options.other(
        options.PIN, options.REQUIRED, "The MCU pin of the switch."
    )
    activate_gcode: Template = options.other(
        options.GCODE,
        "",
        "Runs before each touch, and must not move the toolhead. There is no"
        " default.",
    )
    deactivate_gcode: Template = options.other(
        options.GCODE,
        "",
        "Runs after each touch, and must not move the toolhead. There is no"
        " default.",
    )
    deactivate_on_each_sample: bool = options.other(
        options.FLAG,
        True,
        "False: both run once, before the first and after the last touch.",
    )


@dataclass(frozen=True)
class Settings:
    """What every such section has: mm and degrees C; None: not given.

    In [extra_probe probe] z_offset and the fields of sampling are None where the user has
    left them out, until complete() has filled them in.
    """

    z_offset: float = options.number(
        0.0,
        "How thick the switch is when it triggers, in mm. EXTRA_PROBE_CALIBRATE"
        " needs it: 0.25 or 0.3, by the data sheet.",
        minval=0.0,
    )
    fixed: bool = options.other(
        options.FLAG,
        False,
        "True: the switch stays where it is, such as one beside the bed that the"
        " nozzle presses. Nothing is asked then, and the probe touches the bed.",
    )
    switch_height: Optional[float] = options.number(
        None,
        "With fixed: how far above the bed the switch triggers, in mm, below it:"
        " negative. There is no default, and EXTRA_PROBE_CALIBRATE needs it: see A"
        " switch beside the bed.",
    )
    bed_xy_position: Optional[Site] = options.other(
        options.site_kind("bed"),
        None,
        "With fixed: the point of the bed that the probe touches. By default it is"
        " the zero of the bed mesh.",
        unit="mm",
    )
    xy_position: Optional[Site] = options.other(
        options.site_kind("switch"),
        None,
        "Where the nozzle touches. By default it is where the toolhead is.",
        unit="mm",
    )
    safe_z_height: float = options.number(
        SAFE_Z,
        "The toolhead is lifted so high, at least, before it travels there, in mm.",
        above=0.0,
    )
    position_min: Optional[float] = options.number(
        None,
        "No touch goes lower, in mm. There is no default: see How low can a"
        " touch go?",
    )
    max_temperature: Optional[float] = options.number(
        None,
        "A hotter nozzle is refused, in degrees Celsius. The default is 120, with"
        " fixed there is none.",
        unit="C",
        above=0.0,
    )
    saved_homing_z: Optional[float] = options.number(
        None, "Written by SAVE_CONFIG; leave it alone."
    )

    # What the options of sampling become
    sampling: Sampling = Sampling(*[None] * 7)

    def replace(self, **changes: Any) -> Settings:
        """Return the settings with other values."""
        return dataclasses.replace(self, **changes)


SWITCH_OPTIONS = options.rows_of(SwitchSettings)
CALIBRATION_OPTIONS = options.rows_of(Settings)
OPTIONS = SWITCH_OPTIONS + options.PROBE_OPTIONS + CALIBRATION_OPTIONS

# Of the other sections: what lies on the tips of a textured plate covers what is
# between them, so that one point is as good as many.
REFUSED_OPTIONS = (
    options.refused(
        "bed_spread", "is not needed, as the switch covers texture; remove it"
    ),
)


def read_switch_settings(config: Config) -> SwitchSettings:
    """Return what a switch on a pin of its own has."""
    return SwitchSettings(**options.read(config, SWITCH_OPTIONS))


def read_settings(config: Config) -> Settings:
    """Return the settings as far as they are known before klippy connects."""
    options.read(config, REFUSED_OPTIONS)
    defaults: Dict[str, None] = {}
    if config.get_name().split()[-1] == PROBE:
        names = [row.name for row in options.PROBE_OPTIONS]
        defaults = dict.fromkeys([*names, "z_offset"])
    sampling = options.read(config, options.PROBE_OPTIONS, **defaults)
    values = options.read(config, CALIBRATION_OPTIONS, **defaults)
    return Settings(**values, sampling=options.sampling_of(sampling))


def complete(
    settings: Settings, sampling: Sampling, z_offset: float
) -> Settings:
    """Let the probe decide what the user of [extra_probe probe] has left open.

    'sampling' and z_offset (mm) are those of the probe.
    """
    settings = settings.replace(sampling=filled(settings.sampling, sampling))
    if settings.z_offset is None:
        settings = settings.replace(z_offset=z_offset)
    return settings
