"""The machines that walks are on, and what their owners might have built instead."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from simprinter.world import MeshSpec, TextureSpec
from tools.kit.carrying import with_all
from tools.kit.docks import DOCK_SCENES, on_generic
from tools.kit.extra_probe import fixed_switch
from tools.kit.scenes import SCENES, Options, Scene, on_gantry

GENERIC = "generic_cartesian"
# Where so many motors hold the gantry, mm; four are as the machine has them
Z_MOTORS = {
    1: {"z": (150.0, 150.0)},
    2: {"z": (-60.0, 150.0), "z1": (360.0, 150.0)},
    3: {"z": (-50.0, 18.0), "z1": (150.0, 348.0), "z2": (350.0, 18.0)},
}
# What levels with so many
_LEVEL: Options = {"speed": "200", "horizontal_move_z": "10"}
LEVELS: dict[int, dict[str, Options]] = {
    1: {},
    2: {
        "z_tilt": {
            **_LEVEL,
            "z_positions": "-60, 150\n  360, 150",
            "points": "50, 150\n  250, 150",
        }
    },
    3: {
        "z_tilt": {
            **_LEVEL,
            "z_positions": "-50, 18\n  150, 348\n  350, 18",
            "points": "40, 20\n  150, 230\n  250, 20",
            "retries": "3",
            "retry_tolerance": "0.02",
        }
    },
    4: {
        "quad_gantry_level": {
            **_LEVEL,
            "gantry_corners": "-60, -10\n  360, 370",
            "points": "50, 25\n  50, 225\n  250, 225\n  250, 25",
            "max_adjust": "10",
        }
    },
}
# Sections of ours that an owner of several may do without
OURS = ("z_calibration", "auto_z_offset", "extra_probe membrane")
_OF_MOTORS = ("z_tilt", "quad_gantry_level")
OVERRIDE = """
  G90
  G1 Z10 F900
  G28 X Y
  %s
  G28 Z
  G1 Z15 F900"""
_ACROSS = "G1 X%g Y%g F9000"
_AROUND = "MOVE_AVOIDING_DOCK X=%g Y=%g SPEED=150"


def without(scene: Scene, *sections: str) -> Scene:
    """The same without those."""
    left = {k: v for k, v in scene.sections.items() if k not in sections}
    return replace(scene, sections=left)


def _front(scene: Scene) -> Scene:
    """The same, its pin before the bed: the probe is over the bed there."""
    assert scene.world.pin is not None
    home = {**(scene.sections["safe_z_home"] or {})}
    home["home_xy_position"] = "206, 10"
    sections = {**scene.sections, "safe_z_home": home}
    front = without(replace(scene, sections=sections), "z_calibration")
    return front.with_world(
        pin=replace(scene.world.pin, y=10.0),
        bed=replace(scene.world.bed, y_min=15.0),
    )


def _docked_at(scene: Scene, **positions: str) -> Scene:
    """The same, its dock approached or left from elsewhere."""
    dock = {**(scene.sections["dockable_probe"] or {}), **positions}
    return replace(scene, sections={**scene.sections, "dockable_probe": dock})


def _near_pin(scene: Scene) -> Scene:
    """The same, the pin within the circle around the dock that ways go around."""
    assert scene.world.dock is not None
    dock = replace(scene.world.dock, x=178.0, release=(-1.0, 0.0, 0.0))
    return _docked_at(
        scene.with_world(dock=dock),
        dock_position="178, 308",
        approach_position="178, 270",
        detach_position="138, 308",
    )


def _bases() -> dict[str, Scene]:
    found = {}
    for name, scene in DOCK_SCENES.items():
        # Where Z is homed with the probe there is no pin for the nozzle
        whole = with_all(scene)
        found[name] = (
            whole if scene.world.pin else without(whole, "z_calibration")
        )
    found["dock_front"] = _front(found["dock_gantry_switch"])
    found["dock_near_pin"] = _near_pin(found["dock_gantry_switch"])
    for name in ("voron", "corexz", "cartesian", "separate_pin", "qidi"):
        found[name] = SCENES[name]
    for name in ("voron_two_boards", "qidi_two_boards", "piezo_cartesian"):
        found[name] = SCENES[name]
    found["membrane_and_probe"] = SCENES["membrane_and_probe"]
    found["fixed_switch"] = fixed_switch()
    # Its Z switch lets the nozzle go below the bed: an owner homes beside it
    aside = {"home_xy_position": "-8, -2", "z_hop": "10"}
    for name in ("membrane", "membrane_two_boards"):
        membrane = SCENES[name]
        sections = {**membrane.sections, "safe_z_home": aside}
        found[name] = replace(membrane, sections=sections)
    return found


BASES = _bases()


def kinematics_of(base: str) -> Sequence[str]:
    """Those that a machine may have, its own first."""
    own = BASES[base].kinematics
    if own == "corexz":
        # Its Z is on the belt
        return (own,)
    others = ("cartesian", "corexy", "hybrid_corexy", GENERIC)
    return (own, *(name for name in others if name != own))


def counts_of(base: str) -> Sequence[int]:
    """How many Z motors a machine may have, its own first."""
    own = len(BASES[base].z_motors)
    return (4, 3, 2, 1) if own == 4 else (own,)


def can_override(base: str) -> bool:
    """Whether macros may home it: where to, safe_z_home says."""
    return "safe_z_home" in BASES[base].sections


def can_leave_out(base: str, section: str) -> bool:
    """Whether another one of ours is there, too."""
    there = BASES[base].sections
    others = [
        n for n in (*OURS, "dockable_probe") if n in there and n != section
    ]
    return section in there and bool(others)


def built(scene: Scene, z_motors: int, kinematics: str) -> Scene:
    """The same on another gantry; what levels it is there where it was."""
    if z_motors != len(scene.z_motors):
        name = scene.name
        scene = on_gantry(scene, name, scene.kinematics, **Z_MOTORS[z_motors])
        levels = any(name in scene.sections for name in _OF_MOTORS)
        scene = without(scene, *_OF_MOTORS)
        sections = {**scene.sections, **(LEVELS[z_motors] if levels else {})}
        scene = replace(scene, sections=sections)
    if kinematics == GENERIC:
        return on_generic(scene)
    if kinematics == scene.kinematics:
        return scene
    motors = {name: (x, y) for name, x, y in scene.z_motors}
    return on_gantry(scene, scene.name, kinematics, **motors)


def overridden(scene: Scene, has_skew: bool = False) -> Scene:
    """The same homed by its owner's macro instead of [safe_z_home].

    has_skew: it is told to correct one, with which it would go beside the pin.
    """
    x, y = _numbers(scene, "safe_z_home", "home_xy_position")
    way = _AROUND if "dockable_probe" in scene.sections else _ACROSS
    clear = "\n  SET_SKEW CLEAR=1" if has_skew else ""
    code = clear + OVERRIDE % (way % (x, y))
    section = {"axes": "z", "set_position_z": "0", "gcode": code}
    sections = {**scene.sections, "homing_override": section}
    return without(replace(scene, sections=sections), "safe_z_home")


def _numbers(scene: Scene, section: str, option: str) -> list[float]:
    text = (scene.sections[section] or {})[option] or ""
    return [float(part) for part in text.split(",")]


def on_plate(
    scene: Scene, slope: tuple[float, float], bow: float, rough: float
) -> Scene:
    """The same with another plate, in its middle as high as before.

    slope: mm per mm in X and Y. bow: mm that its middle is higher than its edge,
    over a slope. rough: sigma of its texture, mm.
    """
    bed = scene.world.bed
    mid_x, mid_y = 0.5 * (bed.x_min + bed.x_max), 0.5 * (bed.y_min + bed.y_max)
    changes: dict[str, Any] = {
        "z0": bed.z0 - slope[0] * mid_x - slope[1] * mid_y,
        "slope_x": bed.slope_x + slope[0],
        "slope_y": bed.slope_y + slope[1],
    }
    if bow:
        flat = (0.0, 0.0, 0.0)
        heights = flat, (0.0, bow, 0.0), flat
        changes["mesh"] = MeshSpec(
            bed.x_min, bed.y_min, bed.x_max, bed.y_max, heights
        )
    if rough:
        changes["texture"] = TextureSpec(sigma=rough)
    return scene.with_world(bed=replace(bed, **changes))
