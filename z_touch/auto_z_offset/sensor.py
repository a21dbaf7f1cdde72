"""The sensor below the bed.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .. import pin as z_pin
from ..errors import CalibrationError
from .motors import Motors

if TYPE_CHECKING:
    from ..host.klippy import Config
    from ..host.printer import Host

# On QIDI's printers that section is the bed sensor
OF_SMART_EFFECTOR = (
    "remove that section, and write [probe] with the pin of the inductive probe"
    " instead"
)

# A sensor that still reads triggered after lifting is asked again then (s).
SECOND_LOOK = 0.3


class BedSensor:
    """The bed sensor, which stops the Z motors."""

    def __init__(self, config: Config, host: Host, pin: str):
        self.host = host
        self.pin = pin
        self.endstop = host.endstops.make(
            config,
            "pin",
            "give the pin of the bed sensor, as in 'pin: U_1:PC1'",
            {"smart_effector": OF_SMART_EFFECTOR},
        )
        # The pin that Z is homed on, where no bed is; None: there is none that is known
        self.z_pin = z_pin.read_pin(config, host.axes.z_axis)
        # Their current is low while the nozzle goes down; from connect() on
        self.motors: Motors

    def connect(self) -> None:
        """Find the motors, which exist when klippy connects."""
        self.motors = Motors(self.host)

    def check_open(self, print_time: float) -> None:
        """Raise CalibrationError where the sensor reads triggered at a print time (s).

        And a moment later still.  May pause.
        """
        if not self.endstop.query_endstop(print_time):
            return
        self.host.toolhead.dwell(SECOND_LOOK)
        if self.endstop.query_endstop(self.host.after_moves()):
            raise CalibrationError(
                f"reads triggered at z={self.host.motion.z():.3f}, where nothing should"
                " press it; check that prepare_gcode turns it on (an [output_pin] rests"
                f" at its 'value'), then 'pin: {self.pin}' with QUERY_ENDSTOPS (a '!' in"
                " front of it turns the meaning)"
            )
