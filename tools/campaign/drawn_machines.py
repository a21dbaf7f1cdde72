"""What random printers are made of, and their scenes."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, Optional

from simprinter import Scene
from simprinter.wiring import Motor
from simprinter.world import BedSpec, MeshSpec
from tools.kit.scenes import (
    OTHER_BOARD,
    Sections,
    on_board,
    on_carriages,
)

# Of every printer here; a host may not have them all
KINEMATICS = (
    "corexy",
    "cartesian",
    "hybrid_corexy",
    "corexz",
    "generic_cartesian",
)
# Where Z motors hold a gantry, by their number (mm)
HOLDERS = {
    1: ((150.0, 150.0),),
    2: ((-60.0, 150.0), (360.0, 150.0)),
    3: ((-60.0, -10.0), (150.0, 370.0), (360.0, -10.0)),
    4: ((-60.0, -10.0), (-60.0, 370.0), (360.0, 370.0), (360.0, -10.0)),
}
_FULL_STEPS = 200
# Of belts that move Z without gears; so fine that a step is no longer
_BELT = 40.0
_BELT_FACTOR = 4

# A board that hears of a trigger elsewhere stops within this time (s), or the
# host ends the move with a communication error.
OTHER_BOARD_STOPS = 0.025
# What every switch gives beyond its trigger, mm
GIVE = 0.05


@dataclass(frozen=True)
class Gantry:
    """What moves the toolhead.

    z_motors: how many. screw: mm that a turn moves Z. skew: mm by which each
    Z motor stands higher than the first.
    """

    kinematics: str = "corexy"
    z_motors: int = 2
    screw: float = 8.0
    microsteps: int = 16
    skew: tuple[float, ...] = ()

    @property
    def step(self) -> float:
        """Travel of one microstep of a Z motor, mm."""
        if self.kinematics == "corexz":
            return _BELT / (_FULL_STEPS * _BELT_FACTOR * self.microsteps)
        return self.screw / (_FULL_STEPS * self.microsteps)

    @property
    def names(self) -> tuple[str, ...]:
        """Of the Z motors."""
        count = 1 if self.kinematics == "corexz" else self.z_motors
        return ("z", "z1", "z2", "z3")[:count]

    def turned(self, motor: str) -> dict[str, Optional[str]]:
        """Options of a stepper that say how far a step is."""
        if self.kinematics == "corexz":
            turn, microsteps = _BELT, _BELT_FACTOR * self.microsteps
        elif motor in ("x", "y"):
            turn, microsteps = 40.0, 16
        else:
            turn, microsteps = self.screw, self.microsteps
        return {
            "rotation_distance": f"{turn:g}",
            "gear_ratio": None,
            "microsteps": str(microsteps),
        }

    def step_of(self, motor: str) -> float:
        """Travel of one microstep of any motor, mm."""
        turned = self.turned(motor)
        turn = float(turned["rotation_distance"] or 0.0)
        return turn / (_FULL_STEPS * int(turned["microsteps"] or 0))


@dataclass(frozen=True)
class Plate:
    """The bed: mm, and mm per mm. bow: by how much its middle is higher."""

    z: float = 0.4
    slope_x: float = 0.0
    slope_y: float = 0.0
    bow: float = 0.0

    def spec(self, size: float) -> BedSpec:
        """A plate of size by size mm."""
        edge = (0.0, 0.0, 0.0)
        mesh = MeshSpec(
            0.0, 0.0, size, size, (edge, (0.0, self.bow, 0.0), edge)
        )
        return BedSpec(
            x_max=size,
            y_max=size,
            z0=self.z,
            slope_x=self.slope_x,
            slope_y=self.slope_y,
            mesh=mesh if self.bow else None,
        )


@dataclass(frozen=True)
class Homing:
    """Of Z: mm/s and mm."""

    speed: float = 8.0
    second_speed: float = 3.0
    retract: float = 3.0

    def options(self) -> dict[str, Optional[str]]:
        """Of the section with the endstop of Z."""
        return {
            "homing_speed": f"{self.speed:g}",
            "second_homing_speed": f"{self.second_speed:g}",
            "homing_retract_dist": f"{self.retract:g}",
        }


@dataclass(frozen=True)
class Sampling:
    """How a height is sampled: mm and mm/s."""

    samples: int = 3
    result: str = "median"
    tolerance: float = 0.01
    retries: int = 3
    speed: float = 5.0
    retract: float = 2.0

    def least_speed(self, accel: float) -> float:
        """What a touch has at its trigger at least, mm/s.

        Newer hosts go at full speed for half of a move (min_cruise_ratio), so
        that a fourth of the way is left to reach it.
        """
        return min(self.speed, math.sqrt(accel * self.retract / 2.0))

    def options(self) -> dict[str, Optional[str]]:
        """As a [probe] has them, and who samples by itself."""
        return {
            "speed": f"{self.speed:g}",
            "samples": f"{self.samples}",
            "samples_result": self.result,
            "sample_retract_dist": f"{self.retract:g}",
            "samples_tolerance": f"{self.tolerance:g}",
            "samples_tolerance_retries": f"{self.retries}",
        }


# Building scenes


def with_gantry(scene: Scene, gantry: Gantry) -> Scene:
    """The scene's machine on another gantry."""
    motors, sections = _without_z(scene)
    for number, name in enumerate(gantry.names):
        motors[name] = _z_motor(scene, number, gantry)
    for name, motor in motors.items():
        sections[f"stepper_{name}"] = _stepper(sections, name, motor, gantry)
        motors[name] = dataclasses.replace(
            motor, step_dist=gantry.step_of(name)
        )
    kinematics = gantry.kinematics
    sections["printer"] = {**sections["printer"], "kinematics": kinematics}
    if kinematics == "generic_cartesian":
        names = {name: f"my_{name}" for name in motors}
        sections = on_carriages(sections, names)
        kinematics = "cartesian"
    holders = zip(gantry.names, HOLDERS[len(gantry.names)])
    skew = dict(zip(gantry.names[1:], gantry.skew))
    return dataclasses.replace(
        scene,
        name="random",
        kinematics=kinematics,
        z_motors=[(name, x, y) for name, (x, y) in holders],
        z_skew=skew,
        wiring=dataclasses.replace(scene.wiring, motors=motors),
        sections=sections,
    )


def _without_z(scene: Scene) -> tuple[dict[str, Motor], dict[str, Any]]:
    """Motors and sections without all Z motors but the first's section."""
    motors = {name: scene.wiring.motors[name] for name in ("x", "y")}
    sections = {
        name: options
        for name, options in scene.sections.items()
        if name[:-1] != "stepper_z" and not name.startswith("tmc")
    }
    return motors, sections


def _z_motor(scene: Scene, number: int, gantry: Gantry) -> Motor:
    """The Z motor of that number, at pins that no scene has otherwise."""
    first = scene.wiring.motors["z"]
    if number == 0:
        return first
    pins = [f"PB{3 * number + pin}" for pin in range(3)]
    uart = f"PE{number}" if first.uart else ""
    return Motor(pins[0], f"!{pins[1]}", gantry.step, uart, 0, f"!{pins[2]}")


def _stepper(
    sections: Sections, name: str, motor: Motor, gantry: Gantry
) -> dict[str, Optional[str]]:
    """The section of a motor."""
    return {
        **(sections.get(f"stepper_{name}") or {}),
        "step_pin": motor.step_pin,
        "dir_pin": motor.dir_pin,
        "enable_pin": motor.enable_pin,
        **gantry.turned(name),
    }


def with_options(scene: Scene, name: str, **options: Optional[str]) -> Scene:
    """The scene with other options in one section."""
    section = {**(scene.sections.get(name) or {}), **options}
    sections = {**scene.sections, name: section}
    return dataclasses.replace(scene, sections=sections)


def z_section(scene: Scene) -> str:
    """The section with the endstop of Z."""
    return "stepper_z" if "stepper_z" in scene.sections else "carriage z"


def on_other_board(scene: Scene, signal: str, latency: float) -> Scene:
    """The scene with one input on a board of its own, s away."""
    board = dataclasses.replace(OTHER_BOARD, latency=latency)
    return on_board(scene, "other", board, [scene.wiring.inputs[signal]])


def inverted(pin: str) -> str:
    """The pin with its sense reversed."""
    return pin.replace("!", "") if "!" in pin else f"!{pin}".replace("!^", "^!")
