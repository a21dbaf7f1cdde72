"""What a machine is made of: immutable records, checked when built.

World frame, mm and seconds, z up.  Heights of presses are positive downward
where the field says so.  A wrong value raises ValueError naming the field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Optional, Tuple

Vector = Tuple[float, float, float]


def _check(good: bool, name: str, value: object, wanted: str) -> None:
    if not good:
        raise ValueError(f"{name}: {value!r} is not {wanted}")


def _finite(owner: object, *names: str) -> None:
    for name in names:
        value = getattr(owner, name)
        _check(
            isinstance(value, (int, float)) and math.isfinite(value),
            f"{type(owner).__name__}.{name}",
            value,
            "a finite number",
        )


def _not_negative(owner: object, *names: str) -> None:
    _finite(owner, *names)
    for name in names:
        value = getattr(owner, name)
        full = f"{type(owner).__name__}.{name}"
        _check(value >= 0.0, full, value, "zero or more")


def _positive(owner: object, *names: str) -> None:
    _finite(owner, *names)
    for name in names:
        value = getattr(owner, name)
        full = f"{type(owner).__name__}.{name}"
        _check(value > 0.0, full, value, "above zero")


@dataclass(frozen=True)
class NoiseSpec:
    """How a switch differs from touch to touch.

    sigma: spread of the trigger point, mm (cut off at 5 sigma)
    outlier_chance, outlier_size: with that chance (0..1) the trigger point is
        shifted by that many mm; positive triggers earlier (higher)
    hysteresis: mm between trigger and release
    latency: seconds from the physical change to the level at the board
    """

    sigma: float = 0.0
    outlier_chance: float = 0.0
    outlier_size: float = 0.0
    hysteresis: float = 0.0
    latency: float = 0.0

    def __post_init__(self) -> None:
        _not_negative(self, "sigma", "outlier_chance", "hysteresis", "latency")
        _finite(self, "outlier_size")
        _check(
            self.outlier_chance <= 1.0,
            "NoiseSpec.outlier_chance",
            self.outlier_chance,
            "a chance of 0 to 1",
        )


@dataclass(frozen=True)
class MeshSpec:
    """A grid of heights added to the bed's plane, bilinear in between.

    heights[row][column] in mm: rows from y_min to y_max, columns from x_min
    to x_max.  Outside its corners the edge value holds.
    """

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    heights: Tuple[Tuple[float, ...], ...]

    def __post_init__(self) -> None:
        _finite(self, "x_min", "y_min", "x_max", "y_max")
        _check(self.x_max > self.x_min, "MeshSpec.x_max", self.x_max, "> x_min")
        _check(self.y_max > self.y_min, "MeshSpec.y_max", self.y_max, "> y_min")
        widths = {len(row) for row in self.heights}
        _check(
            len(self.heights) >= 2 and len(widths) == 1 and min(widths) >= 2,
            "MeshSpec.heights",
            self.heights,
            "two or more rows of two or more equal columns",
        )
        _check(
            all(math.isfinite(z) for row in self.heights for z in row),
            "MeshSpec.heights",
            self.heights,
            "all finite",
        )


@dataclass(frozen=True)
class BedSpec:
    """The plate: surface z = z0 + slope_x * x + slope_y * y (+ mesh), mm.

    There is nothing to touch outside x_min..x_max, y_min..y_max.
    allowed_press: mm the nozzle may press a plate that has no sensor.
    """

    x_min: float = 0.0
    y_min: float = 0.0
    x_max: float = 300.0
    y_max: float = 300.0
    z0: float = 0.0
    slope_x: float = 0.0
    slope_y: float = 0.0
    mesh: Optional[MeshSpec] = None
    allowed_press: float = 0.0

    def __post_init__(self) -> None:
        _finite(self, "x_min", "y_min", "x_max", "y_max")
        _finite(self, "z0", "slope_x", "slope_y")
        _check(self.x_max > self.x_min, "BedSpec.x_max", self.x_max, "> x_min")
        _check(self.y_max > self.y_min, "BedSpec.y_max", self.y_max, "> y_min")
        _not_negative(self, "allowed_press")


@dataclass(frozen=True)
class PinSpec:
    """A vertical pin over a switch, pressed by nozzle tip or probe body.

    x, y, radius: where a presser meets it, mm
    z: height of the presser's bottom at which it triggers
    pretravel: mm the pin sinks from first contact to the trigger
    pin_travel: mm from the trigger to the hard stop
    signal: "z_endstop" when Z homes on it
    """

    x: float
    y: float
    z: float
    radius: float = 2.0
    pretravel: float = 0.0
    pin_travel: float = 1.0
    signal: str = "z_endstop"
    noise: NoiseSpec = field(default_factory=NoiseSpec)

    def __post_init__(self) -> None:
        _finite(self, "x", "y", "z")
        _positive(self, "radius")
        _not_negative(self, "pretravel", "pin_travel")
        _check(bool(self.signal), "PinSpec.signal", self.signal, "a name")


@dataclass(frozen=True)
class AxisSwitchSpec:
    """A switch that one axis runs into.

    axis: "x", "y" or "z"; direction: +1 triggers at position and above, -1
    at position and below (mm).  hard_stop: mm from the trigger to the end of
    the axis, None if it never comes.
    """

    signal: str
    axis: str
    position: float
    direction: int = 1
    hard_stop: Optional[float] = None
    noise: NoiseSpec = field(default_factory=NoiseSpec)

    def __post_init__(self) -> None:
        name = "AxisSwitchSpec"
        _check(bool(self.signal), f"{name}.signal", self.signal, "a name")
        axes = ("x", "y", "z")
        _check(self.axis in axes, f"{name}.axis", self.axis, "x, y or z")
        _finite(self, "position")
        _check(
            self.direction in (1, -1),
            f"{name}.direction",
            self.direction,
            "1 or -1",
        )
        if self.hard_stop is not None:
            _not_negative(self, "hard_stop")


@dataclass(frozen=True)
class MagProbeSpec:
    """A switch hanging beside the nozzle that can be taken off.

    x_offset, y_offset: its place relative to the nozzle, mm
    body_drop: mm its body's bottom hangs below the cold nozzle tip
    switch_offset: mm from the body's bottom down to the plunger's trigger
        point, so that it triggers on the bed at a nozzle height of
        body_drop + switch_offset
    pretravel: mm the plunger moves from first contact to the trigger
    half_width: half the side of the body's square bottom, mm
    mode: "output" (a board output attaches), "dock" (moves do), "fixed"
    initial: "attached", "docked" or "lost"
    attach_time: seconds from the output's edge to the change, mode "output"
    plunger_on_pin: whether the pin that the body is put on presses the plunger
    """

    x_offset: float
    y_offset: float
    body_drop: float
    switch_offset: float
    pretravel: float = 0.3
    half_width: float = 4.0
    mode: str = "fixed"
    initial: str = "attached"
    attach_time: float = 0.0
    plunger_on_pin: bool = False
    noise: NoiseSpec = field(default_factory=NoiseSpec)

    def __post_init__(self) -> None:
        _finite(self, "x_offset", "y_offset")
        _positive(self, "body_drop", "half_width")
        _not_negative(self, "switch_offset", "pretravel", "attach_time")
        name = "MagProbeSpec"
        modes = ("output", "dock", "fixed")
        _check(self.mode in modes, f"{name}.mode", self.mode, f"in {modes}")
        states = ("attached", "docked", "lost")
        _check(
            self.initial in states,
            f"{name}.initial",
            self.initial,
            f"in {states}",
        )
        _check(
            self.mode != "fixed" or self.initial == "attached",
            f"{name}.initial",
            self.initial,
            "'attached', as mode 'fixed' needs",
        )
        _check(
            self.mode == "output" or self.attach_time == 0.0,
            f"{name}.attach_time",
            self.attach_time,
            "zero, as modes without an output need",
        )


@dataclass(frozen=True)
class DockSpec:
    """Where a probe of mode "dock" is kept.

    x, y, z: nozzle position at which head and docked probe meet, mm
    reach: radius around it within which they are joined, mm
    approach: direction in which a head leaves to take the probe along
    release: direction in which a head leaves to strip the probe off
    cone: degrees by which leaving may differ from those directions
    """

    x: float
    y: float
    z: float
    reach: float = 3.0
    approach: Vector = (0.0, 1.0, 0.0)
    release: Vector = (1.0, 0.0, 0.0)
    cone: float = 40.0

    def __post_init__(self) -> None:
        _finite(self, "x", "y", "z")
        _positive(self, "reach", "cone")
        _check(self.cone < 90.0, "DockSpec.cone", self.cone, "below 90")
        for name in ("approach", "release"):
            vector = getattr(self, name)
            good = len(vector) == 3 and math.hypot(*vector) > 0.0
            _check(good, f"DockSpec.{name}", vector, "a direction (x, y, z)")
        lengths = math.hypot(*self.approach) * math.hypot(*self.release)
        dot = sum(a * b for a, b in zip(self.approach, self.release))
        apart = math.degrees(math.acos(max(-1.0, min(1.0, dot / lengths))))
        _check(
            apart > 2.0 * self.cone,
            "DockSpec.release",
            self.release,
            f"more than twice the cone ({self.cone} degrees) off approach",
        )


@dataclass(frozen=True)
class InductiveSpec:
    """A probe that senses the plate from a distance.

    sense_distance: height of the cold nozzle tip over the plate's surface
    below the probe, mm, at which it triggers, with the head at X=0.
    twist: mm that it hangs lower for each mm of X, on an axis that is twisted
    """

    x_offset: float
    y_offset: float
    sense_distance: float
    twist: float = 0.0
    noise: NoiseSpec = field(default_factory=NoiseSpec)

    def __post_init__(self) -> None:
        _finite(self, "x_offset", "y_offset", "twist")
        _positive(self, "sense_distance")


@dataclass(frozen=True)
class BedSensorSpec:
    """A pressure sensor under a compliant bed.

    press_depth: mm the nozzle presses into the bed to trigger it
    enable_output: whether it works only while "bed_sensor_enable" is on
    """

    press_depth: float = 0.05
    enable_output: bool = False
    noise: NoiseSpec = field(default_factory=NoiseSpec)

    def __post_init__(self) -> None:
        _not_negative(self, "press_depth")


@dataclass(frozen=True)
class MembraneSpec:
    """A membrane switch of known thickness lying on the bed.

    x, y: its middle; either radius or half_x with half_y, mm
    thickness: mm above the bed; press: mm below its top that trigger it
    """

    x: float
    y: float
    thickness: float
    press: float = 0.0
    radius: Optional[float] = None
    half_x: Optional[float] = None
    half_y: Optional[float] = None
    noise: NoiseSpec = field(default_factory=NoiseSpec)

    def __post_init__(self) -> None:
        _finite(self, "x", "y")
        _positive(self, "thickness")
        _not_negative(self, "press")
        _check(
            self.press <= self.thickness,
            "MembraneSpec.press",
            self.press,
            "at most the thickness",
        )
        if self.radius is not None:
            no_sides = self.half_x is None and self.half_y is None
            _check(no_sides, "MembraneSpec.radius", self.radius, "alone")
            _positive(self, "radius")
        else:
            _positive(self, "half_x", "half_y")


@dataclass(frozen=True)
class DriftSpec:
    """Linear thermal growth in mm/s between two times (seconds).

    nozzle: positive makes the tip hang lower (the probe's body does not)
    pin: positive raises the pin; bed: positive raises the plate
    body: positive makes the probe's body hang lower
    """

    nozzle: float = 0.0
    pin: float = 0.0
    bed: float = 0.0
    body: float = 0.0
    start: float = 0.0
    stop: float = math.inf

    def __post_init__(self) -> None:
        _finite(self, "nozzle", "pin", "bed", "body", "start")
        _check(self.stop >= self.start, "DriftSpec.stop", self.stop, ">= start")


@dataclass(frozen=True)
class WorldSpec:
    """A machine.

    overtravel: mm a presser may go beyond the trigger of pin, bed sensor or
    membrane; allowed_drag: mm of XY travel allowed in one contact.
    probe_sense, dock_sense: whether the board can see those states.
    """

    bed: BedSpec = field(default_factory=BedSpec)
    pin: Optional[PinSpec] = None
    switches: Tuple[AxisSwitchSpec, ...] = ()
    mag_probe: Optional[MagProbeSpec] = None
    dock: Optional[DockSpec] = None
    inductive: Optional[InductiveSpec] = None
    bed_sensor: Optional[BedSensorSpec] = None
    membrane: Optional[MembraneSpec] = None
    drift: DriftSpec = field(default_factory=DriftSpec)
    probe_sense: bool = False
    dock_sense: bool = False
    overtravel: float = 0.05
    allowed_drag: float = 0.05

    def __post_init__(self) -> None:
        _not_negative(self, "overtravel", "allowed_drag")
        mag = self.mag_probe
        _check(
            mag is None or self.inductive is None,
            "WorldSpec.inductive",
            self.inductive,
            "possible beside mag_probe: both drive 'probe'",
        )
        wants_dock = mag is not None and mag.mode == "dock"
        _check(
            wants_dock == (self.dock is not None),
            "WorldSpec.dock",
            self.dock,
            "given exactly when mag_probe.mode is 'dock'",
        )
        for name in ("probe_sense", "dock_sense"):
            asked = getattr(self, name)
            full = f"WorldSpec.{name}"
            _check(not asked or mag is not None, full, asked, "without a probe")
        signals = self.signals()
        repeated = {name for name in signals if signals.count(name) > 1}
        _check(not repeated, "WorldSpec.switches", repeated, "unique signals")

    def signals(self) -> tuple[str, ...]:
        """Names of all signals this machine drives."""
        names = [switch.signal for switch in self.switches]
        parts = (
            (self.pin is not None, self.pin.signal if self.pin else ""),
            (self.mag_probe is not None, "probe"),
            (self.inductive is not None, "probe"),
            (self.bed_sensor is not None, "bed_sensor"),
            (self.membrane is not None, "membrane"),
            (self.probe_sense, "probe_sense"),
            (self.dock_sense, "dock_sense"),
        )
        names.extend(name for there, name in parts if there)
        return tuple(names)
