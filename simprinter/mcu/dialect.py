"""How firmware speaks: as the host of its own version does."""

from __future__ import annotations

from typing import NamedTuple


class Dialect(NamedTuple):
    """What differs from one version of the firmware to another.

    app: what its dictionary says it is, Klipper or Kalico
    analog_batches: analog inputs report several readings at once, since
        2026-02-23 (41bc240b1)
    """

    app: str = "Klipper"
    analog_batches: bool = False

    @classmethod
    def of(cls, app: str, source: str) -> Dialect:
        """Of a host, by the text of its klippy/mcu.py."""
        return cls(app, "bytes_per_report" in source)
