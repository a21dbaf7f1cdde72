"""The plate's surface: world frame, mm, z up, before thermal growth."""

from __future__ import annotations

import math
import random

from .spec import BedSpec, MeshSpec, TextureSpec

# Of which a texture is made: enough for heights that are as good as normal
WAVES = 64
# No tip and no dip is farther from the mean surface, in standard deviations
TIPS = 4.0


class Mesh:
    """Bilinear heights on a regular grid, the edge value held outside."""

    __slots__ = ("_columns", "_rows", "_scale_x", "_scale_y", "_spec")

    def __init__(self, spec: MeshSpec) -> None:
        self._spec = spec
        self._rows = len(spec.heights)
        self._columns = len(spec.heights[0])
        self._scale_x = (self._columns - 1) / (spec.x_max - spec.x_min)
        self._scale_y = (self._rows - 1) / (spec.y_max - spec.y_min)

    def height(self, x: float, y: float) -> float:
        """Height at (x, y), mm."""
        spec = self._spec
        column, across = _cell((x - spec.x_min) * self._scale_x, self._columns)
        row, along = _cell((y - spec.y_min) * self._scale_y, self._rows)
        low, high = spec.heights[row], spec.heights[row + 1]
        front = low[column] + across * (low[column + 1] - low[column])
        back = high[column] + across * (high[column + 1] - high[column])
        return front + along * (back - front)

    def highest(self) -> float:
        """Highest point, mm; a bilinear cell never exceeds its corners."""
        return max(max(row) for row in self._spec.heights)


def _cell(place: float, count: int) -> tuple[int, float]:
    """Index of the cell holding `place`, and how far into it (0..1)."""
    if place <= 0.0:
        return 0, 0.0
    if place >= count - 1:
        return count - 2, 1.0
    index = int(place)
    return index, place - index


class Texture:
    """Heights with a Gaussian correlation: a sum of waves drawn from a seed.

    Wave numbers of such a field are normal with a standard deviation of
    sqrt(2) / length (Rahimi and Recht, Random Features, 2007).
    """

    __slots__ = ("_last", "_scale", "_waves", "highest")

    def __init__(self, spec: TextureSpec) -> None:
        draw = random.Random(f"{spec.seed}/texture")
        wide = math.sqrt(2.0) / spec.length
        self._waves = tuple(
            (
                draw.gauss(0.0, wide),
                draw.gauss(0.0, wide),
                draw.uniform(0.0, 2.0 * math.pi),
            )
            for _ in range(WAVES)
        )
        self._scale = spec.sigma * math.sqrt(2.0 / WAVES)
        self.highest = TIPS * spec.sigma
        # A touch asks for the same point again and again
        self._last = (math.nan, math.nan, 0.0)

    def height(self, x: float, y: float) -> float:
        """Height at (x, y) above the mean surface, mm."""
        last_x, last_y, z = self._last
        if last_x != x or last_y != y:
            whole = math.fsum(
                math.cos(a * x + b * y + phase) for a, b, phase in self._waves
            )
            z = max(-self.highest, min(self.highest, self._scale * whole))
            self._last = x, y, z
        return z


class Bed:
    """Plane plus optional mesh, and where the plate ends."""

    __slots__ = (
        "_mesh",
        "_slope_x",
        "_slope_y",
        "_spec",
        "_texture",
        "_z0",
        "highest",
    )

    def __init__(self, spec: BedSpec) -> None:
        self._spec = spec
        self._z0 = spec.z0
        self._slope_x = spec.slope_x
        self._slope_y = spec.slope_y
        self._mesh = None if spec.mesh is None else Mesh(spec.mesh)
        corners = [
            spec.z0 + spec.slope_x * x + spec.slope_y * y
            for x in (spec.x_min, spec.x_max)
            for y in (spec.y_min, spec.y_max)
        ]
        texture = spec.texture
        self._texture = None if texture is None else Texture(texture)
        bump = 0.0 if self._mesh is None else self._mesh.highest()
        bump += 0.0 if self._texture is None else self._texture.highest
        # An upper bound: plane and mesh may peak at different places
        self.highest = max(corners) + bump

    def covers(self, x: float, y: float) -> bool:
        """Whether the plate is below (x, y)."""
        spec = self._spec
        return spec.x_min <= x <= spec.x_max and spec.y_min <= y <= spec.y_max

    def met(self, x: float, y: float) -> float:
        """Where the tip or a plunger meets the plate at (x, y), mm."""
        z = self.height(x, y)
        return z if self._texture is None else z + self._texture.height(x, y)

    def height(self, x: float, y: float) -> float:
        """Mean surface z at (x, y), mm; continued outside the plate."""
        z = self._z0 + self._slope_x * x + self._slope_y * y
        if self._mesh is not None:
            z += self._mesh.height(x, y)
        return z
