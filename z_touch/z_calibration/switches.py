"""What is known of common switches of probes.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Optional, Sequence

if TYPE_CHECKING:
    from .heights import Result
    from .runs import Run

# From the body to the trigger point (mm): the least of any healthy switch of that
# kind, by the limits of its operating position and the height of its body (a D2F
# has 5.5 +-0.3 over 5.0).  With a larger one the nozzle would be inside the bed for
# some of them; with this one Z=0 is at the bed or above it.
SWITCHES = {"D2F": 0.2, "SSG": 0.2}

# How to come down from there
COME_DOWN = (
    "come down with paper after CALIBRATE_Z (CALCULATE_SWITCH_OFFSET), or with"
    " baby steps and Z_CALIBRATION_SAVE_GCODE_OFFSET"
)


def reminder(
    switch_offset: float, runs: Sequence[Run], before: Optional[Result]
) -> str:
    """Return what the user is told with a switch_offset (mm) of that list.

    Empty: with one that was measured, or where an earlier run had it, too.  'before' is the
    result before this one, None without.
    """
    earlier = [run.switch_offset for run in runs if run.ok]
    if before is not None:
        earlier.append(before.switch_offset)
    if switch_offset not in SWITCHES.values() or switch_offset in earlier:
        return ""
    return (
        f"switch_offset={switch_offset:.3f} is the least that a healthy switch has, so Z=0"
        " is too high on purpose, by up to some tenths of a millimetre;"
        f" {COME_DOWN}"
    )
