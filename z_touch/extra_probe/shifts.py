"""What Klipper's own features add to Z where the switch lies, a bed mesh above all.

The offset is applied below them, so what they add is taken off it, and the user is told.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Iterator, Tuple

if TYPE_CHECKING:
    from ..host.printer import Host

# Less (mm) is rounding.
SMALLEST_PART = 0.0005

# From here on (mm) it is worth telling what is not known.
LARGEST_REST = 0.02


class Shifts:
    """What is added with the nozzle at X, Y, Z (toolhead, mm), as it is now.

    'is_saved': for a value that counts from the next homing on, when the mesh is as it is,
    but not the heat.  'place' says what is there.
    """

    def __init__(
        self,
        host: Host,
        point: Tuple[float, float, float],
        is_saved: bool,
        place: str,
    ):
        self.transforms = host.transforms
        self.place = place
        self.x, self.y, z = point
        self.parts = [
            part
            for part in self.transforms.parts(self.x, self.y, z)
            if abs(part.height) >= SMALLEST_PART
            and not (is_saved and self.transforms.follows_heat(part))
        ]
        self.rest = self.transforms.unknown_here()
        is_beyond = self.transforms.is_beyond_mesh(self.x, self.y)
        # It is not known what the mesh would be there
        self.is_guessed = is_beyond and not self._is_mesh_zero()

    def height(self) -> float:
        """Return what is to be taken off the offset (mm)."""
        return sum(part.height for part in self.parts)

    def _is_mesh_zero(self) -> bool:
        return self.transforms.is_mesh_zero(self.x, self.y)

    def _is_mesh_elsewhere(self) -> bool:
        """Return whether Z=0 will be where a later mesh sees it, not where the switch lay.

        A mesh in force was taken off, and stays right.
        """
        has_none = self.transforms.mesh_heights() is None
        may_come = self.transforms.has_mesh_section()
        return may_come and has_none and not self._is_mesh_zero()

    def lines(self, z_offset: float) -> Iterator[str]:
        """Yield what the user is told; z_offset: what has become of the offset (mm)."""
        x, y = self.x, self.y
        if self.parts:
            parts = ", ".join(
                f"{part.name} {part.height:.3f} mm" for part in self.parts
            )
            yield (
                f"{parts} at {x:.1f}, {y:.1f}, {self.place}, taken off: the"
                f" offset is {z_offset:.6f}, and right there while that is in force"
            )
        if self.is_guessed:
            yield (
                f"bed_mesh ends before {x:.1f}, {y:.1f}, {self.place}: what was"
                " taken off is the height of its rim; check the first layer"
            )
        if self._is_mesh_elsewhere():
            option = self.transforms.mesh_zero_option()
            yield (
                f"bed_mesh has no zero at {x:.1f}, {y:.1f}, {self.place}: one"
                " that is probed or loaded now makes Z=0 wrong by its height there; set"
                f" its {option} to that point, probe it, and calibrate again"
            )
        if abs(self.rest) >= LARGEST_REST:
            yield (
                f"another feature shifts Z by {self.rest:.3f} mm there: not taken off;"
                " check the first layer"
            )
