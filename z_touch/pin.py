"""The metal pin that Z is homed on, and what the bed mesh covers, as sections say it.

No section says that the Z endstop is a pin below the nozzle.  It is one where [z_calibration]
has the nozzle press it, or where Z is homed beside what the bed mesh covers.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Optional, Tuple

from . import options

if TYPE_CHECKING:
    from .host.klippy import Config
    from .host.printer import Host
    from .host.toolhead import ZAxis

# So near (mm, in X and in Y) the nozzle may meet the pin: its half, and that of a
# worn nozzle's flat.
NEAR = 5.0

# A pin is pressed so far (mm) below where it triggers, at most.
BELOW_TRIGGER = 1.0

# A switch that triggers higher (mm) is at the other end of the axis.
HIGHEST = 10.0

Point = Tuple[float, float]

# Two options of [z_calibration], which other sections look at
NOZZLE_POSITION = options.site_option(
    "nozzle_xy_position",
    "X, Y of the toolhead, in mm, when the nozzle is above the middle of the metal pin."
    " The default is home_xy_position of [safe_z_home]; there is none with"
    " endstop_pin.",
)
ENDSTOP_PIN = options.option(
    "endstop_pin",
    options.PIN,
    None,
    "",
    "The MCU pin of another switch that nozzle and body press, such as ^PG10. By"
    " default they press the Z endstop.",
    old=("calibration_endstop_pin",),
)


class Pin(NamedTuple):
    """Where the pin is (mm, of the toolhead), and the toolhead Z of its trigger."""

    x: float
    y: float
    trigger_z: float


def read_pin(config: Config, z_axis: Optional[ZAxis]) -> Optional[Pin]:
    """Return the pin that the sections of the printer tell of, None: they do not."""
    trigger_z = low_switch(z_axis)
    if trigger_z is None:
        return None
    xy = _calibrated_at(config) or _homed_beside_mesh(config)
    return Pin(xy[0], xy[1], trigger_z) if xy else None


def low_switch(z_axis: Optional[ZAxis]) -> Optional[float]:
    """Return the toolhead Z (mm) at which the switch triggers that Z is homed on.

    None: there is none near the bed.
    """
    if z_axis is None or "z_virtual_endstop" in z_axis.endstop_pin:
        return None
    trigger_z = z_axis.position_endstop
    return trigger_z if trigger_z is None or trigger_z <= HIGHEST else None


def _calibrated_at(config: Config) -> Optional[Point]:
    """Return where the nozzle is on the pin as [z_calibration] has it."""
    if not config.has_section("z_calibration"):
        return None
    section = options.Foreign(config.getsection("z_calibration"))
    values = options.read(section, (NOZZLE_POSITION, ENDSTOP_PIN))
    if values[ENDSTOP_PIN.name] is not None:
        # Another pin, whose height is not known yet
        return None
    site = values[NOZZLE_POSITION.name]
    return _home(config) if site is None else (site.x, site.y)


def _homed_beside_mesh(config: Config) -> Optional[Point]:
    home, area = _home(config), mesh_area(config)
    if home is None or area is None or is_over(home, area, NEAR):
        return None
    return home


def mesh_area(config: Config) -> Optional[Tuple[Point, Point]]:
    """Return the corners (X and Y, mm) of what the bed mesh covers.

    None: it is round, or there is none.
    """
    low = _point(config, "bed_mesh", "mesh_min")
    high = _point(config, "bed_mesh", "mesh_max")
    return None if low is None or high is None else (low, high)


def is_over(xy: Point, area: Tuple[Point, Point], near: float = 0.0) -> bool:
    """Return whether X and Y (mm) are in an area, or that near to it."""
    return all(
        low - near <= at <= high + near for at, low, high in zip(xy, *area)
    )


def _home(config: Config) -> Optional[Point]:
    return _point(config, "safe_z_home", "home_xy_position")


def _point(config: Config, section: str, option: str) -> Optional[Point]:
    if not config.has_section(section):
        return None
    read = config.getsection(section).getfloatlist
    point = read(option, None, count=2, note_valid=False)
    if not point or not all(map(options.is_finite, point)):
        return None
    return point[0], point[1]


def is_over_pin(host: Host, pin: Optional[Pin]) -> bool:
    """Return whether the nozzle stands over the pin now."""
    if pin is None:
        return False
    x, y = host.toolhead.get_position()[:2]
    return max(abs(x - pin.x), abs(y - pin.y)) <= NEAR


def floor(host: Host, pin: Optional[Pin]) -> Optional[float]:
    """Return the lowest toolhead Z (mm) of a touch where the toolhead stands now.

    None: it is not over the pin.
    """
    if pin is None or not is_over_pin(host, pin):
        return None
    return pin.trigger_z - BELOW_TRIGGER
