"""The plate's surface: world frame, mm, z up, before thermal growth."""

from __future__ import annotations

from .spec import BedSpec, MeshSpec


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


class Bed:
    """Plane plus optional mesh, and where the plate ends."""

    __slots__ = ("_mesh", "_slope_x", "_slope_y", "_spec", "_z0", "highest")

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
        bump = 0.0 if self._mesh is None else self._mesh.highest()
        # An upper bound: plane and mesh may peak at different places
        self.highest = max(corners) + bump

    def covers(self, x: float, y: float) -> bool:
        """Whether the plate is below (x, y)."""
        spec = self._spec
        return spec.x_min <= x <= spec.x_max and spec.y_min <= y <= spec.y_max

    def height(self, x: float, y: float) -> float:
        """Surface z at (x, y), mm; continued outside the plate."""
        z = self._z0 + self._slope_x * x + self._slope_y * y
        if self._mesh is not None:
            z += self._mesh.height(x, y)
        return z
