"""Places where the toolhead can meet something, each reduced to one height.

A contact height is the Pose.z (mm, world frame) at which a presser first meets
its counterpart, for a toolhead at (x, y) at time t; None where there is nothing to
meet.  It includes thermal growth, so it compares with motor positions.

    nozzle tip     Pose.z - nozzle growth
    body bottom    Pose.z - body_drop - body growth    (hangs on the carriage,
                                                        not on the hot nozzle)
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Callable, NamedTuple, Optional, Sequence

from ..faults import Fault, Faults
from .bed import Bed
from .ooze import Ooze
from .sensors import TouchState
from .spec import (
    AxisSwitchSpec,
    InductiveSpec,
    MagProbeSpec,
    MembraneSpec,
    PinSpec,
)
from .thermal import Drift

# Of each carriage, where its nozzle is
Poses = Sequence[Sequence[float]]
# Growth, mm, or whether something is carried, at a time
Growth = Callable[[float], float]
Held = Callable[[float], bool]
ContactZ = Callable[[float, float, float], Optional[float]]
# How far (mm) the probe hangs lower than it should, as it was attached last
Seat = Callable[[], float]
# What is wrong with a touch, and the sign of its mm
_TRIGGERS = {"trigger_early": 1.0, "trigger_late": -1.0, "trigger_never": 0.0}


class Tracked:
    """Something that can be pressed, its limits, and what it is doing now.

    carriage: which one has what presses it, 0 or 1
    allowed: mm it may go beyond the trigger; allowed_drag: XY mm per contact
    hard_stop: mm beyond the trigger where nothing gives way, or infinity
    pressed, drag: committed state; drag is None while out of contact
    faults: of the touch of now, or of that which is sought next
    sought: a move looks for a touch that it has not met yet
    touched: pressed, or said to be so by a fault
    """

    __slots__ = (
        "allowed",
        "allowed_drag",
        "carriage",
        "drag",
        "faults",
        "hard_stop",
        "name",
        "pressed",
        "sought",
        "touched",
    )

    def __init__(self, name: str, carriage: int = 0) -> None:
        self.name = name
        self.carriage = carriage
        self.allowed = math.inf
        self.allowed_drag = math.inf
        self.hard_stop = math.inf
        self.pressed = False
        self.drag: Optional[float] = None
        self.faults: tuple[Fault, ...] = ()
        self.sought = False
        self.touched = False

    def expect(self, faults: Faults) -> None:
        """A move looks for a touch: learn what is wrong with it."""
        found = (faults.at_next_touch(name, self.name) for name in _TRIGGERS)
        self.faults = tuple(fault for fault in found if fault is not None)

    def mend(self) -> None:
        """It triggers where it should again."""
        self.faults = ()

    @property
    def early(self) -> float:
        """How many mm too early it triggers; negative: late."""
        return sum(_TRIGGERS[fault.name] * fault.mm for fault in self.faults)

    def is_below(self, t: float, poses: Poses) -> bool:
        """Whether a toolhead that goes on from there may meet it."""
        return True

    def reports(self, state: TouchState, beyond: float) -> bool:
        """Whether its switch would be asserted, `beyond` mm past its trigger."""
        if not self.faults:
            return state.asserted(beyond)
        if any(fault.name == "trigger_never" for fault in self.faults):
            return False
        return state.asserted(beyond + self.early)

    def meets(self, touched: bool) -> bool:
        """Commit whether it is touched; whether that is what was sought."""
        is_new = touched and not self.touched and self.sought
        self.touched = touched
        self.sought = self.sought and not is_new
        return is_new

    def limit(
        self, allowed: float, drag: float, hard_stop: float = math.inf
    ) -> None:
        """Set what is still no crash."""
        self.allowed = allowed
        self.allowed_drag = drag
        self.hard_stop = hard_stop

    def follow(self, touching: bool, moved: float) -> float:
        """Commit contact; XY mm dragged in this contact so far."""
        if not touching:
            self.drag = None
            return 0.0
        self.drag = 0.0 if self.drag is None else self.drag + moved
        return self.drag


class Site(Tracked):
    """One presser of the toolhead meeting one counterpart from above.

    contact_z: see the module; top: no contact above this Pose.z when cold
    press: mm from first contact to the trigger
    held: whether the toolhead carries what presses it; None: always
    """

    __slots__ = ("contact_z", "held", "press", "top")

    def __init__(
        self,
        name: str,
        contact_z: ContactZ,
        top: float,
        press: float = 0.0,
        held: Optional[Held] = None,
        carriage: int = 0,
    ) -> None:
        super().__init__(name, carriage)
        self.contact_z = contact_z
        self.top = top
        self.press = press
        self.held = held

    def contact(self, t: float, x: float, y: float) -> Optional[float]:
        """Its contact height, None as well where nobody carries its presser."""
        if self.held is not None and not self.held(t):
            return None
        return self.contact_z(x, y, t)

    def is_below(self, t: float, poses: Poses) -> bool:
        """Whether the toolhead has this presser, above its counterpart."""
        x, y, _ = poses[self.carriage]
        return self.contact(t, x, y) is not None


class Finding(NamedTuple):
    """What one commit found at a site.

    depth: mm beyond the trigger of this touch, negative before it
    trigger: Pose.z (axis switches: axis position) of that trigger
    drag: XY mm dragged so far in this contact
    met: it is the touch that a move was looking for
    """

    site: Tracked
    was_pressed: bool
    pressed: bool
    depth: float
    trigger: float
    drag: float
    met: bool


class Near(NamedTuple):
    """How far the toolhead is from something below it.

    distance: mm to the first contact; negative: so far into it
    pressed: the touch of now has triggered
    """

    site: str
    distance: float
    pressed: bool


class ContactSensor:
    """Sites that press one switch (or none): a pin has two pressers.

    early: mm above its ceiling at which a fault may have it touched
    """

    __slots__ = ("_busy", "_drift", "_top", "early", "sites", "state")

    def __init__(
        self, sites: Sequence[Site], state: TouchState, drift: Drift
    ) -> None:
        self.sites = tuple(sites)
        self.state = state
        self._drift = drift
        self.early = 0.0
        # First contact (site.top) is never below the trigger
        self._top = max(site.top for site in sites)
        # The last commit was low enough for a contact
        self._busy = False

    def ceiling(self) -> float:
        """Cold Pose.z above which nothing is touched and all is let go."""
        return self._top + self.state.rearm

    def expect(self) -> None:
        """Its state, or one of its sites, has another fault now."""
        early = self.state.early + max(site.early for site in self.sites)
        self.early = max(0.0, early)

    def level(self, t: float, poses: Poses) -> bool:
        """Whether the switch would be asserted; changes nothing."""
        state = self.state
        ceiling = self._top + state.rearm + self.early
        if lowest(poses) > ceiling + self._drift.bound(t):
            return False
        for site in self.sites:
            x, y, z = poses[site.carriage]
            contact = site.contact(t, x, y)
            if contact is not None and site.reports(
                state, contact - site.press - z
            ):
                return True
        return False

    def near(self, t: float, poses: Poses) -> Iterator[Near]:
        """What of it is below a toolhead that is there; changes nothing."""
        for site in self.sites:
            x, y, z = poses[site.carriage]
            contact = site.contact(t, x, y)
            if contact is not None:
                yield Near(site.name, z - contact, site.pressed)

    def commit(
        self, t: float, poses: Poses, moved: Sequence[float]
    ) -> list[Finding]:
        """Take over the new poses; returns what happened at each site.

        moved: XY mm of each carriage since the last commit.
        Contact is physical; what a fault reports only counts as met.
        """
        state = self.state
        findings: list[Finding] = []
        ceiling = self.ceiling() + self.early + self._drift.bound(t)
        above = lowest(poses) > ceiling
        if above and not state.spent and not self._busy:
            return findings
        deepest = -math.inf
        for site in self.sites:
            x, y, z = poses[site.carriage]
            contact = site.contact(t, x, y)
            beyond = -math.inf
            if contact is not None:
                beyond = contact - site.press - z
                deepest = max(deepest, beyond)
            slack = state.hysteresis if site.pressed else 0.0
            pressed = beyond + state.shift + slack >= 0.0
            is_on = contact is not None and z <= contact
            drag = site.follow(is_on, moved[site.carriage])
            was, site.pressed = site.pressed, pressed
            met = site.meets(pressed or site.reports(state, beyond))
            if pressed or was or drag or met:
                depth = beyond + state.shift
                findings.append(
                    Finding(site, was, pressed, depth, z + depth, drag, met)
                )
        self._busy = not above
        pressed = any(site.pressed for site in self.sites)
        state.settle(pressed, deepest)
        return findings


class AxisSwitch:
    """A position switch that one axis runs into."""

    __slots__ = ("_direction", "_place", "_position", "site", "state")

    def __init__(
        self,
        spec: AxisSwitchSpec,
        state: TouchState,
        place: Callable[[Poses], float],
        carriage: int = 0,
    ) -> None:
        """place: of what runs into it."""
        self._place = place
        self._direction = spec.direction
        self._position = spec.position
        self.state = state
        self.site = Tracked(spec.signal, carriage)
        stop = math.inf if spec.hard_stop is None else spec.hard_stop
        self.site.limit(stop, math.inf, stop)

    def level(self, poses: Poses) -> bool:
        """Whether the switch would be asserted; changes nothing."""
        beyond = self._direction * (self._place(poses) - self._position)
        return self.site.reports(self.state, beyond)

    def commit(self, poses: Poses) -> Optional[Finding]:
        """Take over the new poses; returns what happened, if anything."""
        place = self._place(poses)
        beyond = self._direction * (place - self._position)
        state, site = self.state, self.site
        is_far = beyond < -state.rearm - site.early and not site.touched
        if is_far and not state.spent and not state.pressed:
            return None
        slack = state.hysteresis if site.pressed else 0.0
        depth = beyond + state.shift
        was, site.pressed = site.pressed, depth + slack >= 0.0
        met = site.meets(site.pressed or site.reports(state, beyond))
        state.settle(site.pressed, beyond)
        if not (was or site.pressed or met):
            return None
        trigger = place - self._direction * depth
        return Finding(site, was, site.pressed, depth, trigger, 0.0, met)


def lowest(poses: Poses) -> float:
    """Height (mm) of the lowest nozzle, as the motors have put it."""
    if len(poses) == 1:
        return poses[0][2]
    return min(pose[2] for pose in poses)


def nozzle_on_bed(bed: Bed, drift: Drift, growth: Growth) -> ContactZ:
    """The tip meets the plate."""

    def contact_z(x: float, y: float, t: float) -> Optional[float]:
        if not bed.covers(x, y):
            return None
        return bed.met(x, y) + drift.bed(t) + growth(t)

    return contact_z


def with_ooze(contact_z: ContactZ, ooze: Ooze) -> ContactZ:
    """What hangs below the tip meets it before the tip does."""

    def meets(x: float, y: float, t: float) -> Optional[float]:
        z = contact_z(x, y, t)
        return None if z is None else z + ooze.height(t)

    return meets


def nozzle_on_pin(
    pin: PinSpec, drift: Drift, growth: Growth, ooze: Ooze
) -> ContactZ:
    """The tip, or what hangs below it, meets the pin, within its radius."""
    pin_x, pin_y, radius = pin.x, pin.y, pin.radius
    top = pin.z + pin.pretravel

    def contact_z(x: float, y: float, t: float) -> Optional[float]:
        if math.hypot(x - pin_x, y - pin_y) > radius:
            return None
        return top + drift.pin(t) + growth(t) + ooze.height(t)

    return contact_z


def body_on_pin(
    pin: PinSpec, probe: MagProbeSpec, drift: Drift, seat: Seat
) -> ContactZ:
    """The body's square bottom covers the pin's middle."""
    nozzle_x = pin.x - probe.x_offset
    nozzle_y = pin.y - probe.y_offset
    half = probe.half_width
    top = pin.z + pin.pretravel + probe.body_drop

    def contact_z(x: float, y: float, t: float) -> Optional[float]:
        if abs(x - nozzle_x) > half or abs(y - nozzle_y) > half:
            return None
        return top + drift.pin(t) + drift.body(t) + seat()

    return contact_z


def hanging_on_bed(
    bed: Bed, drift: Drift, probe: MagProbeSpec, below: float, seat: Seat
) -> ContactZ:
    """A point `below` mm under the body's bottom meets the plate."""
    offset_x, offset_y = probe.x_offset, probe.y_offset
    drop = probe.body_drop + below

    def contact_z(x: float, y: float, t: float) -> Optional[float]:
        x, y = x + offset_x, y + offset_y
        if not bed.covers(x, y):
            return None
        height = bed.met(x, y) + drop + drift.bed(t)
        return height + drift.body(t) + seat()

    return contact_z


def sensed_bed(bed: Bed, drift: Drift, probe: InductiveSpec) -> ContactZ:
    """The plate comes within the coil's distance; the coil is not hot.

    It sees more of the plate than a texture is wide.
    """
    offset_x, offset_y = probe.x_offset, probe.y_offset

    def contact_z(x: float, y: float, t: float) -> Optional[float]:
        distance = probe.sense_distance + probe.roll(x, y)
        x, y = x + offset_x, y + offset_y
        if not bed.covers(x, y):
            return None
        return bed.height(x, y) + distance + drift.bed(t)

    return contact_z


def nozzle_on_membrane(
    bed: Bed,
    drift: Drift,
    growth: Growth,
    spec: MembraneSpec,
    is_laid: Callable[[], bool],
) -> ContactZ:
    """The tip meets the top of the membrane switch, while it lies there."""

    def inside(x: float, y: float) -> bool:
        if spec.radius is not None:
            return math.hypot(x - spec.x, y - spec.y) <= spec.radius
        half_x, half_y = spec.half_x or 0.0, spec.half_y or 0.0
        return abs(x - spec.x) <= half_x and abs(y - spec.y) <= half_y

    def contact_z(x: float, y: float, t: float) -> Optional[float]:
        if not (is_laid() and inside(x, y)):
            return None
        if not bed.covers(x, y):
            return None
        # It bridges a texture
        plate = bed.height(x, y) + drift.bed(t) + growth(t)
        return plate + spec.thickness

    return contact_z
