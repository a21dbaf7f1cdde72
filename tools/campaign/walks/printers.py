"""The printers that walks are on: a machine, its sections, and its owner's taste."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Optional

from hypothesis import strategies as st

from simprinter.world import MeshSpec, NoiseSpec
from tools.campaign.drawing import around, often
from tools.campaign.walks import features
from tools.kit.carrying import with_all
from tools.kit.docks import DOCK_SCENES
from tools.kit.scenes import SCENES, Scene

# Over the bed wherever a dock is (mm)
POINT = (150.0, 150.0)

# What an owner says of a probe that comes and goes; None: nothing
_HOOKS = (
    None,
    "ATTACH_PROBE",
    "DETACH_PROBE",
    "M117 x",
    "SET_GCODE_OFFSET Z=0.05",
)
_YES_NO = ("True", "False")
# Values of options that change what follows what, by section
CHOICES: Mapping[str, Mapping[str, Sequence[Optional[str]]]] = {
    "dockable_probe": {
        "restore_toolhead": _YES_NO,
        "allow_delayed_detach": _YES_NO,
        "auto_attach_detach": _YES_NO,
        "detach_dockable_before_z_home": _YES_NO,
        "z_hop": ("0", "15"),
    },
    "z_calibration": {
        "start_gcode": _HOOKS,
        "before_switch_gcode": _HOOKS,
        "end_gcode": _HOOKS,
        "samples": ("1", "auto"),
        "clearance": ("5", "20"),
    },
    "auto_z_offset": {"samples": ("1", "3"), "offset_samples": ("1", "3")},
    "extra_probe membrane": {"samples": ("1", "3")},
}


def _without(scene: Scene, *sections: str) -> Scene:
    left = {k: v for k, v in scene.sections.items() if k not in sections}
    return replace(scene, sections=left)


def _bases() -> dict[str, Scene]:
    found = {}
    for name, scene in DOCK_SCENES.items():
        # Where Z is homed with the probe there is no pin for the nozzle
        whole = with_all(scene)
        found[name] = (
            whole if scene.world.pin else _without(whole, "z_calibration")
        )
    for name in ("voron", "hybrid", "cartesian", "separate_pin", "qidi"):
        found[name] = SCENES[name]
    for name in ("membrane_and_probe", "piezo_cartesian"):
        found[name] = SCENES[name]
    # Its Z switch lets the nozzle go below the bed: an owner homes beside it
    aside = {"home_xy_position": "-8, -2", "z_hop": "10"}
    membrane = SCENES["membrane"]
    sections = {**membrane.sections, "safe_z_home": aside}
    found["membrane"] = replace(membrane, sections=sections)
    return found


BASES = _bases()


@dataclass(frozen=True)
class Owned:
    """A printer.

    options: section, option, value. too_high: mm by which the z_offset of the
    probe is too large. bow: mm that the bed is higher in its middle.
    """

    base: str = "dock_gantry_switch"
    names: frozenset[str] = frozenset()
    options: tuple[tuple[str, str, Optional[str]], ...] = ()
    too_high: float = 0.0
    bow: float = 0.0
    sigma: float = 0.0
    seed: int = 0

    @property
    def scene(self) -> Scene:
        """The machine and its owner's sections, but for those of Klipper."""
        scene = BASES[self.base]
        world: dict[str, Any] = {}
        if self.bow:
            world["bed"] = replace(scene.world.bed, mesh=self._mesh(scene))
        noise = NoiseSpec(sigma=self.sigma)
        for name in ("pin", "mag_probe", "inductive", "bed_sensor", "membrane"):
            part = getattr(scene.world, name)
            if part is not None and self.sigma:
                noise = replace(part.noise, sigma=self.sigma)
                world[name] = replace(part, noise=noise)
        return scene.with_world(**world) if world else scene

    def _mesh(self, scene: Scene) -> MeshSpec:
        bed, bow = scene.world.bed, self.bow
        heights = (0.0, 0.0, 0.0), (0.0, bow, 0.0), (0.0, 0.0, 0.0)
        return MeshSpec(bed.x_min, bed.y_min, bed.x_max, bed.y_max, heights)

    def changes(self, **paths: str) -> dict[str, dict[str, Optional[str]]]:
        """To the scene's configuration; paths: of files that it names."""
        found = features.sections(self.names, **paths)
        for section, option, value in self.options:
            text = None if value is None else value
            if value is not None and option.endswith("_gcode"):
                text = "\n  " + value
            found.setdefault(section, {})[option] = text
        section = "dockable_probe" if self.has("dockable_probe") else "probe"
        if self.too_high and self.has(section):
            here = self.scene.number(section, "z_offset") + self.too_high
            found.setdefault(section, {})["z_offset"] = f"{here:.4f}"
        # Klipper says nothing to dialogs without it
        found.setdefault("respond", {})
        return found

    def has(self, section: str) -> bool:
        """Whether its scene has that section."""
        return section in BASES[self.base].sections

    def as_data(self) -> dict[str, Any]:
        """What from_data() makes it of again, for JSON."""
        return {**dataclasses.asdict(self), "names": sorted(self.names)}

    @classmethod
    def from_data(cls, data: Mapping[str, Any]) -> Owned:
        """See as_data()."""
        options = tuple(tuple(row) for row in data["options"])
        names = frozenset(data["names"])
        return cls(**{**data, "names": names, "options": options})


def _choices(base: str) -> list[tuple[str, str, Sequence[Optional[str]]]]:
    """Section, option and values, as far as a machine has them."""
    scene = BASES[base]
    rows = [
        (section, option, values)
        for section, options in CHOICES.items()
        if section in scene.sections
        for option, values in options.items()
    ]
    if scene.world.dock is not None:
        return rows
    # Whatever brings that probe is not for its owner to choose
    kept = [row for row in rows if not row[1].endswith("_gcode")]
    others = [hook for hook in _HOOKS if hook and "PROBE" not in hook]
    options = scene.sections.get("z_calibration") or {}
    if options and "end_gcode" not in options:
        kept.append(("z_calibration", "end_gcode", others))
    return kept


def _options(base: str) -> st.SearchStrategy:
    rows = [
        st.tuples(st.just(section), st.just(option), st.sampled_from(values))
        for section, option, values in _choices(base)
    ]
    if not rows:
        return st.just(())
    chosen = st.lists(
        st.one_of(rows), max_size=4, unique_by=lambda row: row[:2]
    )
    return chosen.map(tuple)


def _printers_of(base: str) -> st.SearchStrategy:
    there = BASES[base].sections
    names = st.frozensets(
        st.sampled_from(sorted(features.FEATURES)), max_size=4
    )
    return st.builds(
        Owned,
        base=st.just(base),
        names=names.filter(lambda found: features.is_possible(found, there)),
        options=_options(base),
        too_high=often(0.0, around(0.0, -0.7, 0.7, 0.1)),
        bow=often(0.0, around(0.0, -0.3, 0.3, 0.1)),
        sigma=often(0.0, around(0.0, 0.0, 0.003, 0.001)),
        seed=st.integers(0, 999),
    )


def printers(bases: Sequence[str] = ()) -> st.SearchStrategy:
    """Random ones; bases: of these machines only."""
    chosen = st.sampled_from(sorted(bases or BASES))
    return chosen.flatmap(_printers_of)
