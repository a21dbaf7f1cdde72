"""What tools, and tests outside of tests/unit, take from inside the product.

All else they see as an owner does. No other file of theirs names what is in z_touch:
what moves there moves here, too.
"""

from __future__ import annotations

from typing import Any

from z_touch import options
from z_touch.auto_z_offset import settings as _auto_z_offset
from z_touch.dockable_probe import settings as _dockable_probe
from z_touch.errors import SamplesDiffer
from z_touch.extra_probe import settings as _extra_probe
from z_touch.options import GCODE
from z_touch.report import picture, trend, verdict
from z_touch.sampling import AUTO, Sampling, summarize
from z_touch.z_calibration import pace, run_log, runs, statistics
from z_touch.z_calibration import settings as _z_calibration
from z_touch.z_calibration.setup_steps import STEPS as _STEPS

__all__ = [
    "AUTO",
    "GCODE",
    "HISTORY",
    "OLD_POSITIONS",
    "OPTIONS",
    "ORDER",
    "SamplesDiffer",
    "Sampling",
    "options",
    "pace",
    "picture",
    "run_log",
    "runs",
    "statistics",
    "summarize",
    "trend",
    "verdict",
]

# Rows of options, by module
OPTIONS: dict[str, tuple[Any, ...]] = {
    "z_calibration": _z_calibration.OPTIONS,
    "auto_z_offset": _auto_z_offset.OPTIONS,
    "dockable_probe": _dockable_probe.OPTIONS,
    "extra_probe": _extra_probe.OPTIONS,
}
# Of a [dockable_probe] of other releases
OLD_POSITIONS: tuple[Any, ...] = _dockable_probe.OLD_POSITIONS
# What a row of z_calibration's history is
HISTORY = _z_calibration.HISTORY
# The steps of Z_CALIBRATION_SETUP
ORDER = [step.name for step in _STEPS]
