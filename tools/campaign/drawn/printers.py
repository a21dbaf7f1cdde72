"""The printers that walks are on: a machine, its sections, and its owner's taste."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import Any, Optional

from hypothesis import strategies as st

from simprinter.scene import heated
from simprinter.world import NoiseSpec
from tools.campaign.drawn import (
    card,
    covering,
    features,
    machines,
    mechanics,
    values,
)
from tools.campaign.drawn.covering import Row
from tools.campaign.drawn.machines import BASES
from tools.campaign.drawn.mistakes import MISTAKES, possible
from tools.kit.scenes import Scene

# Over the bed wherever a dock is (mm)
POINT = (150.0, 150.0)
# By how much the heights of a bed may differ at most (mm)
MOST_BOW = 0.3
# How many options of each kind an owner has chosen at most
MOST = {"hook": 3, "switch": 3, "number": 2, "speed": 2}
SLOPE = 1e-3
# By how much a Z motor stands higher than the first (mm)
MOST_SKEW = 0.15
# What grows as fast as that (mm/s) grows by a third of a millimetre in an hour
MOST_DRIFT = 1e-4


@dataclass(frozen=True)
class Owned:
    """A printer.

    left_out: of our sections. kinematics, z_motors: the machine's own where they
    are empty. is_overridden: its owner's macro homes Z. options: section, option, value. too_high: mm by
    which the z_offset of the probe is too large. slope, bow, rough: of the plate,
    see machines.on_plate(). sigma: of the noise of all switches, mm. screw: mm a turn
    of the Z motors, 0: the machine's own, and microsteps. skew, drift, board,
    latency: see mechanics. mistake: the owner's, see mistakes.
    """

    base: str = "dock_gantry_switch"
    left_out: tuple[str, ...] = ()
    kinematics: str = ""
    z_motors: int = 0
    is_overridden: bool = False
    names: frozenset[str] = frozenset()
    options: tuple[tuple[str, str, Optional[str]], ...] = ()
    too_high: float = 0.0
    slope: tuple[float, float] = (0.0, 0.0)
    bow: float = 0.0
    rough: float = 0.0
    sigma: float = 0.0
    screw: float = 0.0
    microsteps: int = 16
    skew: tuple[float, ...] = ()
    drift: tuple[float, ...] = ()
    board: str = ""
    latency: float = 0.002
    mistake: str = ""
    seed: int = 0

    @cached_property
    def scene(self) -> Scene:
        """The machine and its owner's sections, but for those of Klipper."""
        scene = self._right
        return MISTAKES[self.mistake](scene) or scene if self.mistake else scene

    @cached_property
    def _right(self) -> Scene:
        """The same without a mistake."""
        scene = machines.without(BASES[self.base], *self.left_out)
        if self.screw:
            scene = mechanics.on_screws(scene, self.screw, self.microsteps)
        scene = machines.built(
            scene,
            self.z_motors or len(scene.z_motors),
            self.kinematics or scene.kinematics,
        )
        if self.is_overridden:
            scene = machines.overridden(scene, "skew" in self.names)
        if "hot" in self.names:
            scene = heated(scene)
        scene = machines.on_plate(scene, self.slope, self.bow, self.rough)
        world: dict[str, Any] = {}
        noise = NoiseSpec(sigma=self.sigma)
        for name in ("pin", "mag_probe", "inductive", "bed_sensor", "membrane"):
            part = getattr(scene.world, name)
            if part is not None and self.sigma:
                noise = replace(part.noise, sigma=self.sigma)
                world[name] = replace(part, noise=noise)
        scene = mechanics.skewed(scene.with_world(**world), self.skew)
        if self.drift:
            scene = mechanics.drifting(scene, self.drift)
        if self.board:
            scene = mechanics.boarded(scene, self.board, self.latency)
        return mechanics.giving(scene, self.fastest)

    @property
    def fastest(self) -> float:
        """Of all touches (mm/s), those of homing included."""
        chosen = [
            float(value or 0.0)
            for _, option, value in self.options
            if option in values.TOUCH_SPEEDS
        ]
        return max([values.USUAL_SPEED, *chosen])

    @property
    def uneven(self) -> float:
        """By how much the bed may be higher where nobody has homed Z, mm."""
        bed = BASES[self.base].world.bed
        x, y = bed.x_max - bed.x_min, bed.y_max - bed.y_min
        tilt = abs(self.slope[0]) * x + abs(self.slope[1]) * y
        return abs(self.bow) + tilt

    def changes(self, **paths: str) -> dict[str, dict[str, Optional[str]]]:
        """To the scene's configuration; paths: of files that it names."""
        found = features.sections(self.names, **paths)
        if "card" in self.names:
            found.update(card.macros(self))
        for section, option, value in self.options:
            if section in self.left_out:
                continue
            if section == values.OF_Z:
                section = mechanics.z_section(self.scene)
            text = None if value is None else value
            if value is not None and option.endswith("_gcode"):
                text = "\n  " + value
            found.setdefault(section, {})[option] = text
        section = "dockable_probe" if self.has("dockable_probe") else "probe"
        if self.too_high and self.has(section):
            here = self.scene.number(section, "z_offset") + self.too_high
            found.setdefault(section, {})["z_offset"] = f"{here:.4f}"
        if self.has("dockable_probe"):
            found["gcode_macro FETCH"] = {"gcode": "\n  ATTACH_PROBE"}
        else:
            # Whatever is drawn is there: a name that is not ends the run
            for name in ("ATTACH_PROBE", "DETACH_PROBE", "FETCH"):
                macro = f"gcode_macro {name}"
                if macro not in self.scene.sections:
                    found.setdefault(macro, {"gcode": "\n  G4 P1"})
        refuses = "{action_raise_error('%s')}" % values.NOT_READY
        found["gcode_macro READY"] = {"gcode": f"\n  {refuses}"}
        # Klipper says nothing to dialogs without it
        found.setdefault("respond", {})
        return found

    def has(self, section: str) -> bool:
        """Whether its scene has that section."""
        there = section in BASES[self.base].sections
        return there and section not in self.left_out

    def as_data(self) -> dict[str, Any]:
        """What from_data() makes it of again, for JSON."""
        return {**dataclasses.asdict(self), "names": sorted(self.names)}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Owned:
        """See as_data()."""
        options = tuple(tuple(row) for row in data["options"])
        names = frozenset(data["names"])
        own = {"names": names, "options": options}
        for name in ("slope", "skew", "drift"):
            own[name] = tuple(data.get(name, ()))
        own["left_out"] = tuple(data.get("left_out", ()))
        return cls(**{**data, **own})


# Printers deviate from what works, so what hypothesis makes simpler leads back there


def around(standard: float, low: float, high: float, digit: float = 0.01):
    """Numbers from low to high in whole digits away from the standard."""
    first = math.ceil((low - standard) / digit)
    last = math.floor((high - standard) / digit)
    return st.integers(first, last).map(
        lambda count: round(standard + count * digit, 6)
    )


def often(standard: Any, others: st.SearchStrategy) -> st.SearchStrategy:
    """The standard in about half of all draws."""
    return st.one_of(st.just(standard), others)


def seldom(usual: Any, others: st.SearchStrategy) -> st.SearchStrategy:
    """The others in about a sixth of all draws."""
    return st.integers(0, 5).flatmap(
        lambda n: others if n == 5 else st.just(usual)
    )


@lru_cache(maxsize=None)
def _options(base: str) -> st.SearchStrategy:
    kinds: dict[str, list[st.SearchStrategy]] = {}
    for choice in values.choices(BASES[base]):
        section, option, found = choice
        row = st.tuples(
            st.just(section), st.just(option), st.sampled_from(found)
        )
        kinds.setdefault(values.kind_of(choice), []).append(row)
    chosen = [
        st.lists(
            st.one_of(rows), max_size=MOST[kind], unique_by=lambda row: row[:2]
        )
        for kind, rows in sorted(kinds.items())
    ]
    return st.tuples(*chosen).map(lambda found: tuple(sum(found, [])))


@lru_cache(maxsize=None)
def _mechanics(base: str) -> st.SearchStrategy:
    """What its owner has built otherwise, or got wrong: each of it now and then."""
    scene = BASES[base]
    skews = st.tuples(*[around(0.0, -MOST_SKEW, MOST_SKEW)] * 3)
    rates = st.tuples(*[around(0.0, -MOST_DRIFT, MOST_DRIFT, 1e-5)] * 4)
    mistakes = possible(scene)
    parts: dict[str, st.SearchStrategy] = {
        "microsteps": st.sampled_from(mechanics.MICROSTEPS),
        "skew": seldom((), skews),
        "drift": seldom((), rates),
        "latency": st.sampled_from(mechanics.LATENCIES),
        "mistake": seldom("", st.sampled_from(mistakes)),
    }
    if scene.kinematics != "corexz":
        # Its Z is on the belt
        screws = st.sampled_from(mechanics.SCREWS)
        parts["screw"] = often(0.0, screws)
    boards = mechanics.boards_of(scene)
    if boards:
        parts["board"] = seldom("", st.sampled_from(boards))
    return st.fixed_dictionaries(parts)


@lru_cache(maxsize=None)
def _mostly(value: Any, simple: Any) -> st.SearchStrategy:
    """That value; in a walk that is made shorter, the simple one."""
    return st.sampled_from((simple,) + (value,) * 999)


def _beyond(low: float, high: float, digit: float) -> st.SearchStrategy:
    """Anything but what is next to nothing."""
    return around(0.0, low, high, digit).filter(lambda found: found != 0.0)


@st.composite
def printers(draw: st.DrawFn, row: Row) -> Owned:
    """Those that have what a row of the covering array says."""
    own = covering.of_machine(row.base)
    kept = [n for n in sorted(row.names) if draw(_mostly(True, False))]
    if row.kinematics == machines.GENERIC and "heat" in kept:
        # Klipper itself looks for a motor that is called stepper_z
        kept.remove("heat")
    names = features.possible(kept, BASES[row.base].sections)
    slopes = _beyond(-SLOPE, SLOPE, 0.5 * SLOPE)
    plates = {
        "tilt": ("slope", st.tuples(slopes, slopes), (0.0, 0.0)),
        "bow": ("bow", _beyond(-MOST_BOW, MOST_BOW, 0.1), 0.0),
        "texture": ("rough", st.sampled_from((0.005, 0.015)), 0.0),
    }
    drawn: dict[str, Any] = {}
    if row.plate:
        name, strategy, flat = plates[row.plate]
        drawn[name] = draw(_mostly(draw(strategy), flat))
    if row.noise:
        sigma = draw(_beyond(0.0, 0.003, 0.001))
        drawn["sigma"] = draw(_mostly(sigma, 0.0))
    drawn.update(draw(_mechanics(row.base)))
    return Owned(
        base=row.base,
        left_out=draw(_mostly((row.left_out,) if row.left_out else (), ())),
        kinematics=draw(_mostly(row.kinematics, own.kinematics)),
        z_motors=draw(_mostly(row.z_motors, own.z_motors)),
        is_overridden=draw(_mostly(bool(row.homing), False)),
        names=names,
        options=draw(_options(row.base)),
        too_high=draw(often(0.0, around(0.0, -0.7, 0.7, 0.1))),
        seed=draw(st.integers(0, 999)),
        **drawn,
    )
