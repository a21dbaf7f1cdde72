"""What owners get wrong: a refusal is right then, and nothing deep in the bed.

Each is a function of a machine that is right; None where there is nothing like that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Optional

from simprinter import Scene
from tools.campaign.drawn.mechanics import with_options, z_section

Mistake = Callable[[Scene], Optional[Scene]]

# Along the body of the probe, to where no pin is (mm)
BESIDE_BODY = 8.0
# Out of each plate (mm): of a point in its middle, of its edge
BESIDE_BED = 160.0
BESIDE_EDGE = 3.0
# What the host cannot tell from so short an axis
NOT_UP = {"homing_positive_dir": "False"}


def _at(x: float, y: float) -> str:
    return f"{x:g}, {y:g}"


def _place(scene: Scene, section: str, option: str) -> tuple[float, float]:
    x, y = ((scene.sections[section] or {})[option] or "").split(",")
    return float(x), float(y)


def inverted(pin: str) -> str:
    """The pin with its sense reversed."""
    return pin.replace("!", "") if "!" in pin else f"!{pin}".replace("!^", "^!")


def _other_sense(section: str, option: str) -> Mistake:
    """A pin that reads the other way round."""

    def change(scene: Scene) -> Optional[Scene]:
        pin = (scene.sections.get(section) or {}).get(option) or ""
        if not pin or ":z_virtual" in pin:
            return None
        return with_options(scene, section, **{option: inverted(pin)})

    return change


def _option(section: str, option: str, text: Optional[str]) -> Mistake:
    """Another text in a section that is there."""

    def change(scene: Scene) -> Optional[Scene]:
        if section not in scene.sections:
            return None
        return with_options(scene, section, **{option: text})

    return change


def _more(section: str, option: str, by: float) -> Mistake:
    """A number that is larger by so much."""

    def change(scene: Scene) -> Optional[Scene]:
        name = z_section(scene) if section == "z" else section
        text = (scene.sections.get(name) or {}).get(option)
        if text is None:
            return None
        return with_options(scene, name, **{option: f"{float(text) + by:g}"})

    return change


def _beside(section: str, option: str, x: float, y: float) -> Mistake:
    """A place that is elsewhere by so much."""

    def change(scene: Scene) -> Optional[Scene]:
        if option not in (scene.sections.get(section) or {}):
            return None
        own = _place(scene, section, option)
        place = _at(own[0] + x, own[1] + y)
        return with_options(scene, section, **{option: place})

    return change


def _swapped(scene: Scene) -> Optional[Scene]:
    names = ("nozzle_xy_position", "switch_xy_position")
    own = scene.sections.get("z_calibration") or {}
    if not all(name in own for name in names):
        return None
    nozzle, switch = names
    changed = {nozzle: own[switch], switch: own[nozzle]}
    return with_options(scene, "z_calibration", **changed)


def _off_bed(scene: Scene) -> Optional[Scene]:
    if "auto_z_offset" not in scene.sections:
        return None
    bed = scene.world.bed
    place = _at(0.5 * (bed.x_min + bed.x_max), bed.y_max + BESIDE_EDGE)
    return with_options(scene, "auto_z_offset", bed_xy_position=place)


def _wrong_sign(scene: Scene) -> Optional[Scene]:
    own = scene.sections.get("probe") or {}
    if "x_offset" not in own:
        return None
    names = ("x_offset", "y_offset")
    signs = {name: f"{-float(own[name] or 0.0):g}" for name in names}
    return with_options(scene, "probe", **signs)


def _short_axis(scene: Scene) -> Optional[Scene]:
    name = z_section(scene)
    return with_options(scene, name, position_max="9", **NOT_UP)


def _no_templates(scene: Scene) -> Optional[Scene]:
    own = scene.sections.get("z_calibration") or {}
    names = ("start_gcode", "before_switch_gcode", "end_gcode")
    if not any(name in own for name in names):
        return None
    return with_options(scene, "z_calibration", **dict.fromkeys(names))


def _sticky(part: str) -> Mistake:
    """A switch that lets go only above where the next touch begins."""

    def change(scene: Scene) -> Optional[Scene]:
        spec = getattr(scene.world, part)
        if spec is None:
            return None
        noise = replace(spec.noise, hysteresis=4.0)
        return scene.with_world(**{part: replace(spec, noise=noise)})

    return change


MISTAKES: dict[str, Mistake] = {
    "places swapped": _swapped,
    "nozzle beside pin": _beside("z_calibration", "nozzle_xy_position", 4, 0),
    "nozzle over bed": _beside("z_calibration", "nozzle_xy_position", 0, -20),
    "body beside pin": _beside(
        "z_calibration", "switch_xy_position", BESIDE_BODY, 0
    ),
    "probe beside bed": _beside(
        "z_calibration", "bed_xy_position", 0, BESIDE_BED
    ),
    "nozzle beside bed": _off_bed,
    "switch_offset too large": _more("z_calibration", "switch_offset", 3.0),
    "z_offset too large": _more("probe", "z_offset", 3.0),
    "endstop too high": _more("z", "position_endstop", 1.0),
    "low safe_z_height": _option("z_calibration", "safe_z_height", "1"),
    "floor above the bed": _option("z_calibration", "position_min", "0.4"),
    "sensor's floor above the bed": _option(
        "auto_z_offset", "probe_z_min", "0.9"
    ),
    "another correction saved": _option(
        "auto_z_offset", "probe_z_correction", "2.1"
    ),
    "no room above": _short_axis,
    "offsets of wrong sign": _wrong_sign,
    "endstop inverted": _other_sense("stepper_z", "endstop_pin"),
    "probe inverted": _other_sense("probe", "pin"),
    "sensor inverted": _other_sense("auto_z_offset", "pin"),
    "another pin": _option("auto_z_offset", "pin", "PC9"),
    "sensor off": _option("auto_z_offset", "prepare_gcode", ""),
    "no probe": _no_templates,
    "sticky probe": _sticky("mag_probe"),
    "sticky sensor": _sticky("bed_sensor"),
}


def possible(scene: Scene) -> list[str]:
    """Those that a machine's owner may make."""
    return [name for name, change in MISTAKES.items() if change(scene)]
