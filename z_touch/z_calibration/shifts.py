"""What Klipper's own features add to Z at the point of the bed that was measured.

It is taken off the offset, so that the gap is right there, and the user is told.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Iterator, List, Tuple

from ..errors import CalibrationError
from .result import bed_seen
from .runs import Warned

if TYPE_CHECKING:
    from ..host.printer import Host
    from ..host.transforms import Part
    from .result import LastRun

# Less (mm) is rounding.
SMALLEST_PART = 0.0005

# From here on (mm) it is more than the interpolation of a mesh at its zero.
WORTH_A_WARNING = 0.02

MESH = "bed_mesh"


class Shifts:
    """What is added at the point of a run, as it is now."""

    def __init__(self, host: Host, last: LastRun):
        self.last = last
        transforms = host.transforms
        x, y = last.point
        parts = transforms.parts(
            x, y, last.result.offset, bed_z=bed_seen(host, last)
        )
        self.parts = [p for p in parts if abs(p.height) >= SMALLEST_PART]
        # The same over pin and bed, so it is lasting
        self.unknown = last.unknown_shift
        if abs(self.unknown) < WORTH_A_WARNING:
            self.unknown = 0.0
        self.mesh_zero_option = transforms.mesh_zero_option()
        self.is_beyond_mesh = transforms.is_beyond_mesh(x, y)
        self.is_guessed = transforms.is_mesh_guessed(x, y)

    def offset(self) -> float:
        """Return the G-code offset (mm) with which the gap is right.

        Z_ADJUST is in it, and what the nozzle grows until it prints.
        """
        taken = sum(part.height for part in self.parts) + self.unknown
        last = self.last
        return last.result.offset + last.z_adjust + last.grown - taken

    def lines(self) -> Iterator[Tuple[bool, Warned]]:
        """Yield what the user is told, and whether that is a warning."""
        for part in self.parts:
            is_large = abs(part.height) >= WORTH_A_WARNING
            yield is_large, Warned(part.name, self._of_part(part))
        if self.is_guessed:
            x, y = self.last.point
            yield (
                True,
                Warned(
                    MESH,
                    f"bed_mesh ends before {x:.1f}, {y:.1f}, and its zero is elsewhere:"
                    " what was taken off is the height of its rim, and the first layer"
                    f" may be wrong; set {self.mesh_zero_option} of section 'bed_mesh'"
                    " there",
                ),
            )
        if self.unknown:
            yield (
                True,
                Warned(
                    "another",
                    f"another feature shifts Z by {self.unknown:.3f} mm, over the pin"
                    " and over the bed: taken off; check the first layer",
                ),
            )

    def _of_part(self, part: Part) -> str:
        x, y = self.last.point
        if part.name != MESH:
            # Heat goes on from here, a tilt is the same.
            return f"{part.name} shifts Z by {part.height:.3f} mm there now: taken off"
        text = (
            f"bed_mesh is {part.height:.3f} mm at {x:.1f}, {y:.1f}, where the bed was"
            " measured: taken off"
        )
        if self.is_guessed:
            return text
        where = "within the mesh" if self.is_beyond_mesh else "there"
        text += f", the gap is right {where}"
        if abs(part.height) < WORTH_A_WARNING:
            return text
        return (
            f"{text}; for all of the bed set {self.mesh_zero_option} of section"
            " 'bed_mesh' there"
        )

    def warnings(self) -> List[Warned]:
        """Return those that are warnings."""
        return [text for is_warning, text in self.lines() if is_warning]


def check_unknown(over_pin: float, over_bed: float) -> None:
    """Raise CalibrationError where what is not known adds something else over pin and bed.

    Both are mm, see Transforms.unknown_here().
    """
    if abs(over_bed - over_pin) < WORTH_A_WARNING:
        return
    raise CalibrationError(
        f"another feature shifts Z by {over_pin:.3f} mm over the pin and by"
        f" {over_bed:.3f} mm over the bed, such as exclude_object, a retraction with a"
        " lift, or a module of its own; turn it off before CALIBRATE_Z"
    )
