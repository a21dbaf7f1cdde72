"""The pin that nozzle and switch body press: the Z endstop, or one of its own.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Optional

from ..host import endstops

if TYPE_CHECKING:
    from ..host.klippy import Config, Endstop
    from ..host.printer import Host
    from ..options import OldNames


@dataclass(frozen=True)
class PressedPin:
    """An endstop that stops the Z motors.

    name is what messages call it; origin where its MCU pin is written, in words, and section
    and option the same.
    """

    endstop: Endstop
    name: str
    origin: str
    section: str
    option: str


def read_pin(
    config: Config, host: Host, old_names: OldNames
) -> Optional[PressedPin]:
    """Return the switch of endstop_pin, which is not the Z endstop; None without.

    'old_names' have looked the option up.
    """
    if not old_names.was_given("endstop_pin"):
        return None
    option = str(old_names.name_of("endstop_pin"))
    remedy = (
        "give the pin of the switch that the nozzle presses, or leave the"
        " option out to use the Z endstop"
    )
    return PressedPin(
        endstop=host.endstops.make(config, option, remedy),
        name=f"endstop_pin ({config.get(option)})",
        origin="Option 'endstop_pin' in section 'z_calibration'",
        section=config.get_name(),
        option=option,
    )


def find_pin(host: Host) -> PressedPin:
    """Return the Z endstop, which exists when klippy connects.

    Raises the error of a configuration where there is none that the nozzle can press.
    """
    axis, endstop = host.axes.z_axis, host.endstops.find_z()
    assert axis is not None
    origin = (
        f"Option 'endstop_pin: {axis.endstop_pin}' in section '{axis.section}'"
    )
    if endstop is None:
        raise host.printer.config_error(
            f"{origin}: the printer knows no endstop of that section; the Z axis"
            " needs a switch that the nozzle can press"
        )
    if endstops.is_virtual(endstop):
        raise host.printer.config_error(
            f"{origin} is the probe: z_calibration needs a Z endstop that the"
            " nozzle can press; set it to the pin of that switch, or give"
            " the pin as endstop_pin in section 'z_calibration'"
        )
    return PressedPin(
        endstop=endstop,
        name="the Z endstop",
        origin=origin,
        section=axis.section,
        option="endstop_pin",
    )
