"""What moves and wires a machine, where its owner has built it otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Optional

from simprinter import Scene
from simprinter.world import DriftSpec
from tools.kit.scenes import OTHER_BOARD, on_board

FULL_STEPS = 200
# Of a screw (mm a turn), and microsteps; with the last screw no distance is a whole
# number of steps
SCREWS = (8.0, 4.0, 7.77)
MICROSTEPS = (16, 32, 8)
# Inputs that may be on a board of their own, and how far away that is (s)
ON_BOARDS = ("z_endstop", "nozzle_endstop", "probe", "bed_sensor")
LATENCIES = (0.001, 0.002, 0.004, 0.005)
# A board that hears of a trigger elsewhere stops within this time (s), or the
# host ends the move with a communication error
BOARD_STOPS = 0.025
# What every switch gives beyond its trigger (mm)
GIVE = 0.05


def z_section(scene: Scene) -> str:
    """The section with the endstop of Z."""
    return "stepper_z" if "stepper_z" in scene.sections else "carriage z"


def with_options(scene: Scene, section: str, **options: Optional[str]) -> Scene:
    """The same with other options in a section."""
    own = {**(scene.sections.get(section) or {}), **options}
    return replace(scene, sections={**scene.sections, section: own})


def on_screws(scene: Scene, screw: float, microsteps: int) -> Scene:
    """The same with Z motors that turn such screws."""
    motors = dict(scene.wiring.motors)
    for name, _, _ in scene.z_motors:
        scene = with_options(
            scene,
            f"stepper_{name}",
            rotation_distance=f"{screw:g}",
            gear_ratio=None,
            microsteps=f"{microsteps}",
        )
        step = screw / (FULL_STEPS * microsteps)
        motors[name] = replace(motors[name], step_dist=step)
    return replace(scene, wiring=replace(scene.wiring, motors=motors))


def skewed(scene: Scene, heights: Sequence[float]) -> Scene:
    """The same, its Z motors but the first so much (mm) higher."""
    names = [name for name, _, _ in scene.z_motors][1:]
    return replace(scene, z_skew=dict(zip(names, heights)))


def boards_of(scene: Scene) -> Sequence[str]:
    """The inputs that may be on a board of their own, if none is yet."""
    if scene.wiring.boards:
        return ()
    return [name for name in ON_BOARDS if name in scene.wiring.inputs]


def boarded(scene: Scene, signal: str, latency: float) -> Scene:
    """The same with an input on a board of its own, s away."""
    board = replace(OTHER_BOARD, latency=latency)
    return on_board(scene, "other", board, [scene.wiring.inputs[signal]])


def giving(scene: Scene, fastest: float) -> Scene:
    """The same with switches that give as far as touches at a speed (mm/s) go on."""
    world = scene.world
    parts = [world.pin, world.mag_probe, world.inductive, world.bed_sensor]
    parts.append(world.membrane)
    late = max(part.noise.latency for part in parts if part is not None)
    late += BOARD_STOPS if scene.wiring.boards else 0.0
    give = max(world.overtravel, GIVE + fastest * late)
    return scene.with_world(overtravel=give)


def drifting(scene: Scene, rates: Sequence[float]) -> Scene:
    """The same, which grows: nozzle, pin, bed and the probe's body, mm/s."""
    return scene.with_world(drift=DriftSpec(*rates))
