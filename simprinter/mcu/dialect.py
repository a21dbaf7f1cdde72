"""How firmware spells its messages: as the host of its own version does."""

from __future__ import annotations

from typing import NamedTuple

_CONFIG = "config is_config=%c crc=%u is_shutdown=%c move_count=%hu"
_OLD_CONFIG = "config is_config=%c crc=%u move_count=%hu is_shutdown=%c"
_PULSE = " step_pulse_ticks=%u"


class Dialect(NamedTuple):
    """What differs from one version of the firmware to another.

    app: what its dictionary says it is, Klipper or Kalico
    shutdown_last: is_shutdown comes last in the answer to get_config, up to
        2021-11-06 (d4aee4f55)
    bare_steppers: how long a step lasts is not told, up to 2021-11-04
        (4acfd8d7c)
    analog_batches: analog inputs report several readings at once, since
        2026-02-23 (41bc240b1)
    """

    app: str = "Klipper"
    shutdown_last: bool = False
    bare_steppers: bool = False
    analog_batches: bool = False

    @classmethod
    def of(cls, app: str, source: str) -> Dialect:
        """Of a host, by the text of its klippy/mcu.py and klippy/stepper.py."""
        return cls(
            app,
            _OLD_CONFIG in source,
            "step_pulse_ticks" not in source,
            "bytes_per_report" in source,
        )

    def spelled(self, text: str) -> str:
        """A command or a response as this dialect has it."""
        if self.shutdown_last and text == _CONFIG:
            return _OLD_CONFIG
        if self.bare_steppers and text.startswith("config_stepper "):
            return text.replace(_PULSE, "")
        return text
