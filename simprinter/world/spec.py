"""What a machine is made of: immutable records, checked when built.

World frame, mm and seconds, z up.  Heights of presses are positive downward
where the field says so.  A wrong value raises SpecError naming the field.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Optional, Tuple

Vector = Tuple[float, float, float]
# In the order in which klippy has them
TOWERS = ("a", "b", "c")
# What the second carriage runs along, and its motor's name
SECOND = "second"


class SpecError(ValueError):
    """A value that no machine can have: the field `name` of a `kind`."""

    def __init__(self, kind: str, name: str, value: object, wanted: str):
        super().__init__(f"{kind}.{name}: {value!r} is not {wanted}")
        self.name = name
        self.wanted = wanted


@dataclass(frozen=True)
class Spec:
    """Base: numbers are finite, those named here above zero or not below."""

    _POSITIVE: ClassVar[tuple[str, ...]] = ()
    _NOT_NEGATIVE: ClassVar[tuple[str, ...]] = ()
    _ANY: ClassVar[tuple[str, ...]] = ()

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            is_number = isinstance(value, (int, float))
            if is_number and name not in self._ANY:
                self._require(math.isfinite(value), name, "a finite number")
            if name in self._POSITIVE:
                self._require(is_number and value > 0.0, name, "above zero")
            if name in self._NOT_NEGATIVE:
                good = is_number and value >= 0.0
                self._require(good, name, "zero or more")
        self._check()

    def _check(self) -> None:
        """What else must be."""

    def _require(self, good: bool, name: str, wanted: str) -> None:
        if not good:
            kind, value = type(self).__name__, getattr(self, name)
            raise SpecError(kind, name, value, wanted)

    def _require_one_of(self, name: str, allowed: Collection) -> None:
        good = getattr(self, name) in allowed
        self._require(good, name, f"one of {allowed}")


@dataclass(frozen=True)
class NoiseSpec(Spec):
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

    _NOT_NEGATIVE = ("sigma", "outlier_chance", "hysteresis", "latency")

    def _check(self) -> None:
        good = self.outlier_chance <= 1.0
        self._require(good, "outlier_chance", "a chance of 0 to 1")


@dataclass(frozen=True)
class MeshSpec(Spec):
    """A grid of heights added to the bed's plane, bilinear in between.

    heights[row][column] in mm: rows from y_min to y_max, columns from x_min
    to x_max.  Outside its corners the edge value holds.
    """

    x_min: float
    y_min: float
    x_max: float
    y_max: float
    heights: Tuple[Tuple[float, ...], ...]

    def _check(self) -> None:
        self._require(self.x_max > self.x_min, "x_max", "> x_min")
        self._require(self.y_max > self.y_min, "y_max", "> y_min")
        widths = {len(row) for row in self.heights}
        self._require(
            len(self.heights) >= 2 and len(widths) == 1 and min(widths) >= 2,
            "heights",
            "two or more rows of two or more equal columns",
        )
        finite = all(math.isfinite(z) for row in self.heights for z in row)
        self._require(finite, "heights", "all finite")


@dataclass(frozen=True)
class TextureSpec(Spec):
    """A rough plate, as what is about a millimetre wide meets it, mm.

    sigma: standard deviation of the heights about their mean surface
    length: distance at which their correlation has fallen to 1 / e
    seed: of the plate

    Owners touch with a nozzle's flat or a plunger's end, each about 1 mm across,
    so that what they find is that of a spot already: RatOS's page on Beacon's true
    zero has up to 0.1 mm between touches 1 mm apart. With 15 um these differ by 21
    um, and the most of many thousand by 0.1 mm; length is an estimate.
    """

    sigma: float = 0.015
    length: float = 0.5
    seed: int = 0

    _POSITIVE = ("sigma", "length")


@dataclass(frozen=True)
class BedSpec(Spec):
    """The plate: surface z = z0 + slope_x * x + slope_y * y (+ mesh), mm.

    texture: what a nozzle or a plunger finds above or below that surface. The true
    gap is counted from the surface; what bridges the texture does not see it.
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
    texture: Optional[TextureSpec] = None
    allowed_press: float = 0.0

    _NOT_NEGATIVE = ("allowed_press",)

    def _check(self) -> None:
        self._require(self.x_max > self.x_min, "x_max", "> x_min")
        self._require(self.y_max > self.y_min, "y_max", "> y_min")


@dataclass(frozen=True)
class PinSpec(Spec):
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

    _POSITIVE = ("radius",)
    _NOT_NEGATIVE = ("pretravel", "pin_travel")

    def _check(self) -> None:
        self._require(bool(self.signal), "signal", "a name")


@dataclass(frozen=True)
class TowerSpec(Spec):
    """A tower of a delta; a carriage on it carries the head by a pair of arms.

    name: "a", "b" or "c"; x, y: where the arms' upper joints would be if the
        lower ones were in the nozzle, mm; arm: length, mm
    """

    name: str
    x: float
    y: float
    arm: float

    def _check(self) -> None:
        self._require_one_of("name", TOWERS)
        good = self.arm > math.hypot(self.x, self.y)
        self._require(good, "arm", "longer than the tower is away")

    def rise(self, x: float, y: float) -> float:
        """How far (mm) the carriage is above a nozzle at x, y.

        ValueError where the arms do not reach.
        """
        rest = self.arm**2 - (x - self.x) ** 2 - (y - self.y) ** 2
        if rest < 0.0:
            raise ValueError(f"the arms of tower {self.name} are too short")
        return math.sqrt(rest)

    def place(self, tip: Sequence[float]) -> float:
        """Where the carriage is with the nozzle there, mm.

        Counted so that with the nozzle in the middle it is the nozzle's z.
        """
        return tip[2] + self.rise(tip[0], tip[1]) - self.rise(0.0, 0.0)


@dataclass(frozen=True)
class CarriageSpec(Spec):
    """A second carriage on the rail of X, with a nozzle of its own.

    x: of its nozzle at first, mm. y_offset, z_offset: how far it is behind and
    above the nozzle of the first, mm. clearance: nearest that the two nozzles come
    to each other along X, mm: there, the carriages meet. On which side of the first
    it is at first, it stays.
    """

    x: float
    y_offset: float = 0.0
    z_offset: float = 0.0
    clearance: float = 0.0

    _NOT_NEGATIVE = ("clearance",)


@dataclass(frozen=True)
class AxisSwitchSpec(Spec):
    """A switch that one axis runs into.

    axis: "x", "y" or "z", "second" for the second carriage's X, or the tower "a",
    "b" or "c" of a delta; direction: +1 triggers at position and above, -1 at
    position and below (mm; of a tower see TowerSpec.place).  hard_stop: mm from the
    trigger to the end of the axis, None if it never comes.
    """

    signal: str
    axis: str
    position: float
    direction: int = 1
    hard_stop: Optional[float] = None
    noise: NoiseSpec = field(default_factory=NoiseSpec)

    def _check(self) -> None:
        self._require(bool(self.signal), "signal", "a name")
        self._require_one_of("axis", ("x", "y", "z", SECOND, *TOWERS))
        self._require_one_of("direction", (1, -1))
        stop = self.hard_stop
        self._require(stop is None or stop >= 0.0, "hard_stop", "zero or more")


@dataclass(frozen=True)
class DockSpec(Spec):
    """Where a probe of mode "dock" is kept.

    x, y, z: nozzle position at which head and docked probe meet, mm
    reach: radius around it within which they are joined, mm
    approach: direction in which a toolhead leaves to take the probe along
    release: direction in which a toolhead leaves to strip the probe off
    cone: degrees by which leaving may differ from those directions
    lifted: it goes up and down with the toolhead, so z does not matter; with a release of
        straight up or down a toolhead that moves so by `reach` in it strips the probe off
    body: radius around it, mm, in which the toolhead hits something, except in
        lanes this wide to either side along approach, release and `lanes`
    top: mm over z to which that something reaches
    swing: seconds that a servo, on the output "dock_swing", needs to swing it
        out; 0: it stands there for ever. Swung in, it holds the probe back from
        any head, and is in the way of one that comes to where they would meet;
        while it swings, of one in `body` and its lanes, too.
    out_from: duty (0..1) of that output from which it is to be out
    """

    x: float
    y: float
    z: float
    reach: float = 3.0
    approach: Vector = (0.0, 1.0, 0.0)
    release: Vector = (1.0, 0.0, 0.0)
    cone: float = 40.0
    lifted: bool = False
    body: float = 0.0
    lane: float = 2.0
    lanes: Tuple[Vector, ...] = ()
    top: float = 10.0
    swing: float = 0.0
    out_from: float = 0.05

    _POSITIVE = ("reach", "cone", "out_from")
    _NOT_NEGATIVE = ("body", "lane", "top", "swing")

    def _check(self) -> None:
        self._require(self.cone < 90.0, "cone", "below 90")
        for name in ("approach", "release"):
            vector = getattr(self, name)
            good = len(vector) == 3 and math.hypot(*vector) > 0.0
            self._require(good, name, "a direction (x, y, z)")
        lengths = math.hypot(*self.approach) * math.hypot(*self.release)
        dot = sum(a * b for a, b in zip(self.approach, self.release))
        apart = math.degrees(math.acos(max(-1.0, min(1.0, dot / lengths))))
        wanted = f"more than twice the cone ({self.cone} degrees) off approach"
        self._require(apart > 2.0 * self.cone, "release", wanted)


@dataclass(frozen=True)
class MagProbeSpec(Spec):
    """A switch hanging beside the nozzle that can be taken off.

    x_offset, y_offset: its place relative to the nozzle, mm
    body_drop: mm its body's bottom hangs below the cold nozzle tip
    switch_offset: mm from the body's bottom down to the plunger's trigger
        point, so that it triggers on the bed at a nozzle height of
        body_drop + switch_offset
    pretravel: mm the plunger moves from first contact to the trigger
    half_width: half the side of the body's square bottom around the plunger,
        mm; the body of a D2F is 12.8 mm long
    reseat: spread (sigma, mm) of how low it hangs from one attaching to the
        next, body and plunger alike; cut off at 3 sigma
    mode: "output" (a board output attaches), "dock" (moves do), "fixed"
    initial: "attached", "docked" or "lost"
    attach_time: seconds from the output's edge to the change, mode "output"
    plunger_on_pin: whether the pin that the body is put on presses the plunger
    normally_open: whether the switch closes when it is pressed; it reads open
        without the probe, too
    signal: another one than "probe" where there are several
    dock: where it is kept, mode "dock"; of the first WorldSpec.dock does
    on_second: whether it hangs on the second carriage
    """

    x_offset: float
    y_offset: float
    body_drop: float
    switch_offset: float
    pretravel: float = 0.3
    half_width: float = 6.4
    reseat: float = 0.0
    mode: str = "fixed"
    initial: str = "attached"
    attach_time: float = 0.0
    plunger_on_pin: bool = False
    normally_open: bool = False
    noise: NoiseSpec = field(default_factory=NoiseSpec)
    signal: str = "probe"
    dock: Optional[DockSpec] = None
    on_second: bool = False

    _POSITIVE = ("body_drop", "half_width")
    _NOT_NEGATIVE = ("switch_offset", "pretravel", "attach_time", "reseat")

    def _check(self) -> None:
        self._require(bool(self.signal), "signal", "a name")
        good = self.dock is None or self.mode == "dock"
        self._require(good, "dock", "given for mode 'dock' only")
        self._require_one_of("mode", ("output", "dock", "fixed"))
        states = ("attached", "docked", "lost")
        fixed = self.mode == "fixed"
        self._require_one_of("initial", ("attached",) if fixed else states)
        good = self.mode == "output" or self.attach_time == 0.0
        self._require(good, "attach_time", "zero, as there is no output")


@dataclass(frozen=True)
class InductiveSpec(Spec):
    """A probe that senses the plate from a distance.

    sense_distance: height of the cold nozzle tip over the plate's surface
    below the probe, mm, at which it triggers, with the toolhead at X=0.
    twist: mm that it hangs lower for each mm of X, on an axis that is twisted
    bend: and mm for each mm of X squared, on one that is twisted more at its end
    twist_y: mm that it hangs lower for each mm of Y
    signal: another one than "probe" beside a probe that is detachable
    """

    x_offset: float
    y_offset: float
    sense_distance: float
    noise: NoiseSpec = field(default_factory=NoiseSpec)
    twist: float = 0.0
    bend: float = 0.0
    twist_y: float = 0.0
    signal: str = "probe"

    _POSITIVE = ("sense_distance",)

    def _check(self) -> None:
        self._require(bool(self.signal), "signal", "a name")

    def roll(self, x: float, y: float) -> float:
        """How much lower it hangs with the toolhead there, mm."""
        return (self.twist + self.bend * x) * x + self.twist_y * y


@dataclass(frozen=True)
class BedSensorSpec(Spec):
    """A pressure sensor under a compliant bed.

    press_depth: mm the nozzle presses into the bed to trigger it
    enable_output: whether it works only while "bed_sensor_enable" is on
    """

    press_depth: float = 0.05
    enable_output: bool = False
    noise: NoiseSpec = field(default_factory=NoiseSpec)

    _NOT_NEGATIVE = ("press_depth",)


@dataclass(frozen=True)
class MembraneSpec(Spec):
    """A membrane switch of known thickness lying on the bed.

    x, y: its middle; either radius or half_x with half_y, mm
    thickness: mm above the bed; press: mm below its top that trigger it
    laid: it lies there from the start
    signal: another one than "membrane" where there are several
    """

    x: float
    y: float
    thickness: float
    press: float = 0.0
    radius: Optional[float] = None
    half_x: Optional[float] = None
    half_y: Optional[float] = None
    laid: bool = True
    noise: NoiseSpec = field(default_factory=NoiseSpec)
    signal: str = "membrane"

    _POSITIVE = ("thickness",)
    _NOT_NEGATIVE = ("press",)

    def _check(self) -> None:
        self._require(bool(self.signal), "signal", "a name")
        good = self.press <= self.thickness
        self._require(good, "press", "at most the thickness")
        sides = [self.half_x, self.half_y]
        if self.radius is not None:
            self._require(sides == [None, None], "radius", "alone")
            sides = [self.radius]
        good = all(side is not None and side > 0.0 for side in sides)
        self._require(good, "radius", "above zero, nor are the sides")


@dataclass(frozen=True)
class DriftSpec(Spec):
    """Thermal growth in mm/s between two times (seconds).

    tau: seconds in which it slows down to 37 %; infinity: it stays as fast

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
    tau: float = math.inf

    _ANY = ("stop", "tau")

    def _check(self) -> None:
        self._require(self.tau > 0.0, "tau", "above zero")
        self._require(self.stop >= self.start, "stop", ">= start")


@dataclass(frozen=True)
class HotendSpec(Spec):
    """A nozzle that is longer when it is hot.

    growth: mm per 100 C above the first temperature of the heater `extruder`;
    lag: seconds by which the metal follows its thermistor, to 63 %
    """

    growth: float
    lag: float = 0.0

    _NOT_NEGATIVE = ("growth", "lag")


@dataclass(frozen=True)
class OozeSpec(Spec):
    """Plastic below the nozzle, between its tip and the pin.

    height: mm, at first and at most; kept: share of it that a touch of the pin
    leaves; rate: mm/s that come out again. A nozzle within `radius` mm of x, y
    is wiped clean there.
    """

    height: float
    kept: float = 0.5
    rate: float = 0.0
    x: float = 0.0
    y: float = 0.0
    radius: float = 0.0

    _POSITIVE = ("height",)
    _NOT_NEGATIVE = ("kept", "rate", "radius")

    def _check(self) -> None:
        self._require(self.kept <= 1.0, "kept", "a share of 0 to 1")


@dataclass(frozen=True)
class WorldSpec(Spec):
    """A machine.

    towers: the three of a delta, none of another machine
    second_carriage: of a machine with two on one rail
    more_pins, more_membranes, more_probes: beside the first, each with a signal of
        its own
    overtravel: mm a presser may go beyond the trigger of pin, bed sensor or
    membrane; allowed_drag: mm of XY travel allowed in one contact.
    probe_sense, dock_sense: whether the board can see those states.
    z_play: mm by which the toolhead may hang lower than the Z motors say, anywhere
    within at each touch.
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
    hotend: Optional[HotendSpec] = None
    ooze: Optional[OozeSpec] = None
    z_play: float = 0.0
    probe_sense: bool = False
    dock_sense: bool = False
    overtravel: float = 0.05
    allowed_drag: float = 0.05
    more_pins: Tuple[PinSpec, ...] = ()
    more_membranes: Tuple[MembraneSpec, ...] = ()
    more_probes: Tuple[MagProbeSpec, ...] = ()
    towers: Tuple[TowerSpec, ...] = ()
    second_carriage: Optional[CarriageSpec] = None

    _NOT_NEGATIVE = ("overtravel", "allowed_drag", "z_play")

    def _check(self) -> None:
        names = tuple(tower.name for tower in self.towers)
        self._require(names in ((), TOWERS), "towers", f"none, or {TOWERS}")
        if self.towers:
            a, b, c = self.towers
            area = (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)
            self._require(area != 0.0, "towers", "at the corners of a triangle")
        for switch in self.switches:
            good = switch.axis != SECOND or self.second_carriage is not None
            self._require(good, "switches", "of carriages that are there")
        self._check_docks()
        mag = self.mag_probe
        for name in ("probe_sense", "dock_sense"):
            good = mag is not None or not getattr(self, name)
            self._require(good, name, "possible without a probe")
        signals = self.signals()
        twice = sorted({name for name in signals if signals.count(name) > 1})
        told = f"told a signal for each; {twice} is that of more than one"
        self._require(not twice, "switches", told)

    def _check_docks(self) -> None:
        mag = self.mag_probe
        wants = mag is not None and mag.mode == "dock" and mag.dock is None
        good = wants == (self.dock is not None)
        self._require(good, "dock", "given exactly for a probe of mode 'dock'")
        good = all(p.dock or p.mode != "dock" for p in self.more_probes)
        self._require(good, "more_probes", "told a dock each, for mode 'dock'")
        if self.second_carriage is None:
            good = not any(probe.on_second for probe in self.probes())
            self._require(good, "second_carriage", "given for what is on it")

    def signals(self) -> tuple[str, ...]:
        """Names of all signals this machine drives."""
        probe = self.inductive
        named = (
            *self.switches,
            *self.pins(),
            *([] if probe is None else [probe]),
            *self.probes(),
            *self.membranes(),
        )
        parts = {
            "bed_sensor": self.bed_sensor,
            "probe_sense": self.probe_sense,
            "dock_sense": self.dock_sense,
        }
        names = [part.signal for part in named]
        return (*names, *(name for name, part in parts.items() if part))

    def probes(self) -> tuple[MagProbeSpec, ...]:
        """All detachable probes, the first one first."""
        first = [] if self.mag_probe is None else [self.mag_probe]
        return (*first, *self.more_probes)

    def dock_of(self, probe: MagProbeSpec) -> Optional[DockSpec]:
        """Where one of them is kept, None: in no dock."""
        return (
            self.dock if probe is self.mag_probe and self.dock else probe.dock
        )

    def pins(self) -> tuple[PinSpec, ...]:
        """All pins, the first one first."""
        return (*([] if self.pin is None else [self.pin]), *self.more_pins)

    def membranes(self) -> tuple[MembraneSpec, ...]:
        """All membrane switches, the first one first."""
        first = [] if self.membrane is None else [self.membrane]
        return (*first, *self.more_membranes)
