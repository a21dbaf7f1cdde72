"""A machine in its starting state, and the printer.cfg that fits it.

The world is the truth; the configuration is what the owner believes. Both meet
in the wiring: the same pin texts serve both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Optional, TypeVar, Union

from .wiring import MAIN, Wiring
from .world import Pose, WorldSpec

# Of one section; a value of None leaves the option out
Options = Mapping[str, Optional[str]]
# By section name
Sections = Mapping[str, Optional[Options]]


@dataclass(frozen=True)
class Scene:
    """A machine in its starting state.

    z_motors: (name, x, y) of every Z motor, none of a delta. start: where the nozzle tip is,
    world frame; near the endstops, as the way there proves nothing and takes
    time. z_skew: mm by which Z motors stand higher. Frame of the
    configuration: x and y are the world's; its z comes from homing.
    """

    name: str
    kinematics: str
    z_motors: Sequence[tuple[str, float, float]]
    world: WorldSpec
    wiring: Wiring
    sections: Sections
    start: Pose
    z_skew: Mapping[str, float] = field(default_factory=dict)

    def config(
        self,
        serial: Union[str, Mapping[str, str]],
        changes: Optional[Sections] = None,
    ) -> str:
        """printer.cfg for boards on these serial devices, with changes.

        serial: the main board's, or each one's by its name. A change replaces
        or adds options; None as a value takes an option away, None as a
        section the section.
        """
        serials = {MAIN: serial} if isinstance(serial, str) else serial
        boards = {
            MAIN if name == MAIN else f"mcu {name}": {"serial": device}
            for name, device in serials.items()
        }
        merged: dict[str, dict[str, Optional[str]]] = {}
        for part in (self.sections, boards, changes or {}):
            for name, options in part.items():
                if options is None:
                    merged.pop(name, None)
                else:
                    merged.setdefault(name, {}).update(options)
        lines: list[str] = []
        for name, options in merged.items():
            lines.append(f"[{name}]")
            lines += [
                f"{key}: {value}"
                for key, value in options.items()
                if value is not None
            ]
            lines.append("")
        return "\n".join(lines)

    def with_world(self: S, **changes: object) -> S:
        """The same machine with another world."""
        return replace(self, world=replace(self.world, **changes))

    def number(self, section: str, option: str) -> float:
        """What the configuration says."""
        return float((self.sections[section] or {})[option] or 0.0)


S = TypeVar("S", bound=Scene)


def heated(scene: S) -> S:
    """The same with sections for its hotend (PH0, PI0) and its bed (PH1, PI1).

    A machine may be wired for them and do without, see [heaters] of a world
    file: two thermometers make a fifth of all that happens while it calibrates.
    """
    return replace(scene, sections={**scene.sections, **parse(_HOT)})


def parse(text: str) -> dict[str, Options]:
    """A printer.cfg that may have several options in a line."""
    made: dict[str, dict[str, Optional[str]]] = {}
    for line in filter(None, text.splitlines()):
        if line[0] == "[":
            section = made[line[1:-1]] = {}
        else:
            section.update(option.split(": ") for option in line.split("; "))
    return made


_HOT = """
[thermistor beta3950]
temperature1: 25; resistance1: 100000; beta: 3950
[extruder]
step_pin: PG0; dir_pin: PG1; enable_pin: !PG2; microsteps: 16
rotation_distance: 22.6; nozzle_diameter: 0.4; filament_diameter: 1.75
heater_pin: PH0; sensor_type: beta3950; sensor_pin: PI0; control: watermark
min_temp: 0; max_temp: 300
[heater_bed]
heater_pin: PH1; sensor_type: beta3950; sensor_pin: PI1; control: watermark
min_temp: 0; max_temp: 130
"""
