"""From motor positions to the nozzle tip and back.

Frame: world, mm, x right, y back, z up.  A motor's position is the belt or
screw travel in mm, counted in the direction klippy counts it.  The signs are
those of klippy's chelper/kin_*.c:

    cartesian      x = x        y = y        z = z
    corexy         x = x + y    y = x - y    z = z
    corexz         x = x + z    y = y        z = x - z
    hybrid_corexy  x = x - y    y = y        z = z
    hybrid_corexz  x = x - z    y = y        z = z
    delta          a, b, c: the carriages on the towers, see TowerSpec.place

A second carriage shares all motors but that of x; where this one mixes x with
another axis, its own mixes both the other way round (hybrid_corexy: x + y).

Several Z motors carry one stiff gantry: the toolhead's z is the height, at the
head's XY, of the least squares plane through the motors' heights (exact for
three).  Motors on one line, two being the usual case, fix the tilt along that
line only; across it the gantry stays level.
"""

from __future__ import annotations

import math
from typing import Callable, Mapping, NamedTuple, Sequence, Tuple

from .spec import SECOND, TOWERS, CarriageSpec, TowerSpec

# (name, x, y) of the place where a Z motor holds the gantry
ZMotor = Tuple[str, float, float]
# A motor's share in the toolhead's height, as constant, per-x and per-y terms
Weight = Tuple[str, float, float, float]


class Pose(NamedTuple):
    """Nozzle tip in the world frame, mm, as the motors have put it.

    Thermal growth is not in it: the hot tip hangs below `z`.
    """

    x: float
    y: float
    z: float


Three = Tuple[float, float, float]
# x, y, z to motors x, y, z, and back
_MIXES: dict[str, tuple[Callable[..., Three], Callable[..., Three]]] = {
    "cartesian": (lambda x, y, z: (x, y, z), lambda a, b, c: (a, b, c)),
    "corexy": (
        lambda x, y, z: (x + y, x - y, z),
        lambda a, b, c: (0.5 * (a + b), 0.5 * (a - b), c),
    ),
    "corexz": (
        lambda x, y, z: (x + z, y, x - z),
        lambda a, b, c: (0.5 * (a + c), b, 0.5 * (a - c)),
    ),
    "hybrid_corexy": (
        lambda x, y, z: (x - y, y, z),
        lambda a, b, c: (a + b, b, c),
    ),
    "hybrid_corexz": (
        lambda x, y, z: (x - z, y, z),
        lambda a, b, c: (a + c, b, c),
    ),
}


# Which motor that of x is mixed with, where a second carriage's is mixed otherwise
_MIRRORED = {
    "cartesian": None,
    "hybrid_corexy": "y",
    "hybrid_corexz": "z",
}


class Kinematics:
    """Motors x and y, and Z motors that hold a plane."""

    __slots__ = (
        "_mirrored",
        "_mix",
        "_second",
        "_unmix",
        "_weights",
        "z_names",
    )

    def __init__(
        self,
        kind: str,
        z_motors: Sequence[ZMotor],
        second: CarriageSpec | None = None,
    ) -> None:
        self.z_names = tuple(name for name, _, _ in z_motors)
        if not z_motors or len(set(self.z_names)) != len(z_motors):
            raise ValueError("z_motors: need one or more, names not repeated")
        unknown = set(self.z_names) - {"z", "z1", "z2", "z3"}
        if unknown:
            raise ValueError(f"z_motors: unknown names {sorted(unknown)}")
        self._mix, self._unmix = _MIXES[kind]
        self._weights = plane_weights(z_motors)
        self._second = second
        self._mirrored = _MIRRORED.get(kind)

    def poses(self, motors: Mapping[str, float]) -> tuple[Pose, ...]:
        """Nozzle tip (mm) of each carriage for the motors' positions (mm)."""
        first, second = self.pose(motors), self._second
        if second is None:
            return (first,)
        # Where the first would be with the second one's motor
        motor = motors[SECOND]
        if self._mirrored is not None:
            motor -= 2.0 * motors[self._mirrored]
        x, y, z = self.pose({**motors, "x": motor})
        return first, Pose(x, y + second.y_offset, z + second.z_offset)

    def pose(self, motors: Mapping[str, float]) -> Pose:
        """Nozzle tip (mm) for the motors' positions (mm)."""
        a, b = motors["x"], motors["y"]
        if len(self._weights) == 1:
            return Pose(*self._unmix(a, b, motors[self.z_names[0]]))
        x, y, _ = self._unmix(a, b, 0.0)
        z = 0.0
        for name, const, per_x, per_y in self._weights:
            z += (const + per_x * x + per_y * y) * motors[name]
        return Pose(x, y, z)

    def motors(
        self,
        tip: Sequence[float],
        z_offsets: Mapping[str, float] | None = None,
    ) -> dict[str, float]:
        """Motor positions (mm) that put the nozzle tip at `tip`.

        A second carriage is where it is at first.
        All Z motors stand level; `z_offsets` (mm, added to the named motors)
        starts with a skewed gantry, which then moves the tip as well.
        """
        a, b, c = self._mix(*tip)
        motors = {"x": a, "y": b, **dict.fromkeys(self.z_names, c)}
        if self._second is not None:
            motor, _, _ = self._mix(self._second.x, *tip[1:])
            if self._mirrored is not None:
                motor += 2.0 * (b if self._mirrored == "y" else c)
            motors[SECOND] = motor
        for name, offset in (z_offsets or {}).items():
            motors[name] += offset
        return motors


class Delta:
    """Three towers, each with a carriage that carries the head by its arms."""

    __slots__ = ("_towers",)

    def __init__(self, towers: Sequence[TowerSpec]) -> None:
        if len(towers) != len(TOWERS):
            raise ValueError(f"towers: a delta has {TOWERS}")
        self._towers = tuple(towers)

    def poses(self, motors: Mapping[str, float]) -> tuple[Pose, ...]:
        """The nozzle tip (mm), as that of the only carriage."""
        return (self.pose(motors),)

    def pose(self, motors: Mapping[str, float]) -> Pose:
        """Nozzle tip (mm) for the carriages' places (mm).

        It is where three spheres around the upper joints meet, below them.
        """
        joints = [
            (tower.x, tower.y, motors[tower.name] + tower.rise(0.0, 0.0))
            for tower in self._towers
        ]
        # The differences of their equations are two planes
        x0, y0, h0 = joints[0]
        arm = self._towers[0].arm
        planes = []
        for tower, (x, y, h) in zip(self._towers[1:], joints[1:]):
            far = x * x + y * y + h * h - tower.arm**2
            near = x0 * x0 + y0 * y0 + h0 * h0 - arm * arm
            planes.append((x - x0, y - y0, h - h0, 0.5 * (far - near)))
        (ax, ay, ah, a), (bx, by, bh, b) = planes
        # ... which meet in a line: x and y by z
        area = ax * by - ay * bx
        x_at, x_per = (a * by - b * ay) / area, (bh * ay - ah * by) / area
        y_at, y_per = (ax * b - bx * a) / area, (bx * ah - ax * bh) / area
        dx, dy = x_at - x0, y_at - y0
        square = 1.0 + x_per * x_per + y_per * y_per
        half = x_per * dx + y_per * dy - h0
        root = half * half - square * (dx * dx + dy * dy + h0 * h0 - arm * arm)
        if root < 0.0:
            raise ValueError("the arms of the delta are torn apart")
        z = (-half - math.sqrt(root)) / square
        return Pose(x_at + x_per * z, y_at + y_per * z, z)

    def motors(
        self,
        tip: Sequence[float],
        z_offsets: Mapping[str, float] | None = None,
    ) -> dict[str, float]:
        """Places (mm) of the carriages that put the nozzle tip at `tip`.

        z_offsets: mm by which the named ones stand higher.
        """
        offsets = z_offsets or {}
        return {
            tower.name: tower.place(tip) + offsets.get(tower.name, 0.0)
            for tower in self._towers
        }


def make_kinematics(
    kind: str,
    z_motors: Sequence[ZMotor] = (("z", 0.0, 0.0),),
    towers: Sequence[TowerSpec] = (),
    second: CarriageSpec | None = None,
) -> Kinematics | Delta:
    """The kinematics klippy calls `kind`, with its Z motors' (name, x, y).

    towers: those of a delta, which has no Z motors. second: the second carriage
    on X. ValueError where no such machine has that.
    """
    if second is not None and kind not in _MIRRORED:
        raise ValueError(
            f"second carriage: of {sorted(_MIRRORED)} only, not of {kind}"
        )
    if kind == "delta":
        return Delta(towers)
    if kind not in _MIXES:
        raise ValueError(
            f"kinematics: unknown kind {kind!r}, know {sorted(_MIXES)}"
        )
    belt_z = kind in ("corexz", "hybrid_corexz")
    if belt_z and [name for name, _, _ in z_motors] != ["z"]:
        # The x belt is coupled to one z, so a tilted gantry has no meaning
        raise ValueError(f"z_motors: {kind} takes a single motor named 'z'")
    return Kinematics(kind, z_motors, second)


def plane_weights(z_motors: Sequence[ZMotor]) -> tuple[Weight, ...]:
    """Each motor's share in the height of the least squares plane.

    height(x, y) = sum of (const + per_x * x + per_y * y) * motor height.
    Directions in which the motors do not spread get no tilt.
    """
    count = len(z_motors)
    mid_x = sum(x for _, x, _ in z_motors) / count
    mid_y = sum(y for _, _, y in z_motors) / count
    spread = [(name, x - mid_x, y - mid_y) for name, x, y in z_motors]
    inverse_xx, inverse_xy, inverse_yy = _inverse_scatter(spread)
    weights: list[Weight] = []
    for name, dx, dy in spread:
        per_x = inverse_xx * dx + inverse_xy * dy
        per_y = inverse_xy * dx + inverse_yy * dy
        const = 1.0 / count - per_x * mid_x - per_y * mid_y
        weights.append((name, const, per_x, per_y))
    return tuple(weights)


def _inverse_scatter(
    spread: Sequence[ZMotor],
) -> tuple[float, float, float]:
    """Pseudo-inverse (xx, xy, yy) of the 2x2 scatter matrix of the motors."""
    xx = sum(dx * dx for _, dx, _ in spread)
    xy = sum(dx * dy for _, dx, dy in spread)
    yy = sum(dy * dy for _, _, dy in spread)
    trace = xx + yy
    if trace == 0.0:
        return 0.0, 0.0, 0.0
    determinant = xx * yy - xy * xy
    if determinant > 1e-9 * trace * trace:
        return yy / determinant, -xy / determinant, xx / determinant
    # One line: the matrix is trace * (d d^T), d its unit direction
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    dx, dy = math.cos(angle), math.sin(angle)
    return dx * dx / trace, dx * dy / trace, dy * dy / trace
