"""[axis_twist_compensation] of the host: what it adds to the heights of a probe along X, or Y.

Its options are those of the host's own calibration, with a sheet of paper: where the nozzle
goes, from calibrate_start_x to calibrate_end_x at calibrate_y.  What is added has its own
ends.  The host looks it up where the toolhead stands while the probe touches, which is the
probe's offset away from the point of the bed.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple, Optional, Sequence

if TYPE_CHECKING:
    from .printer import Host

TWISTED = "axis_twist_compensation"


class Names(NamedTuple):
    """The options of one axis; also the names of the host's attributes."""

    start: str
    end: str
    across: str
    heights: str
    first: str
    last: str


NAMES = {
    "X": Names(
        "calibrate_start_x",
        "calibrate_end_x",
        "calibrate_y",
        "z_compensations",
        "compensation_start_x",
        "compensation_end_x",
    ),
    "Y": Names(
        "calibrate_start_y",
        "calibrate_end_y",
        "calibrate_x",
        "zy_compensations",
        "compensation_start_y",
        "compensation_end_y",
    ),
}


class Line(NamedTuple):
    """Where the nozzle goes to calibrate (mm): along the axis, and across it.

    None: the user has not said so.
    """

    start: Optional[float]
    end: Optional[float]
    across: Optional[float]


class Twist:
    """The compensation of the host for a twisted axis, "X" or "Y"."""

    def __init__(self, host: Host):
        self.host = host
        self.printer = host.printer

    def _section(self) -> Any:
        return self.printer.lookup_object(TWISTED, None)

    def has_section(self) -> bool:
        """Return whether the printer has the section."""
        return self._section() is not None

    def axes(self) -> str:
        """Return the axes that this host knows: "X", or "XY" since 2024-11-12 (4f3a7fd22)."""
        return "XY" if hasattr(self._section(), "zy_compensations") else "X"

    def line(self, axis: str) -> Line:
        """Return where the nozzle goes to calibrate an axis."""
        section, names = self._section(), NAMES[axis]
        return Line(*[getattr(section, option) for option in names[:3]])

    def is_in_force(self, axis: str) -> bool:
        """Return whether something is added along an axis."""
        return bool(getattr(self._section(), NAMES[axis].heights))

    def save(
        self, axis: str, first: float, last: float, heights: Sequence[float]
    ) -> str:
        """Hand what is to be added (mm) to SAVE_CONFIG; return it as it is written.

        'heights' are evenly apart, from the toolhead at 'first' to the toolhead at 'last' (mm).
        """
        names, line = NAMES[axis], self.line(axis)
        if self.axes() == "X":
            # Before, the host counts from where the nozzle goes, whatever the ends are
            assert line.start is not None and line.end is not None
            heights = moved(heights, (line.start - first) / (last - first))
            first, last = line.start, line.end
        # Without the sign of a rounded zero
        text = ", ".join([f"{round(z, 6) + 0.0:.6f}" for z in heights])
        configfile = self.printer.lookup_object("configfile")
        configfile.set(TWISTED, names.heights, text)
        configfile.set(TWISTED, names.first, f"{first:.3f}")
        configfile.set(TWISTED, names.last, f"{last:.3f}")
        return f"{names.heights}: {text}"


def moved(heights: Sequence[float], part: float) -> Sequence[float]:
    """Return the heights of a line that begins later, by a part of its length.

    Straight from one height to the next, and on beyond the ends, as the host does it.
    """
    most = len(heights) - 1
    found = []
    for number in range(len(heights)):
        at = number + part * most
        i = min(max(math.floor(at), 0), most - 1)
        found.append(heights[i] + (heights[i + 1] - heights[i]) * (at - i))
    return found
