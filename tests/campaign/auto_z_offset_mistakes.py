"""What an owner of [auto_z_offset] may have wrong: a refusal is right then."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Optional

from tests.campaign.auto_z_offset_printer import PiezoPrinter
from tests.campaign.drawn_machines import (
    inverted,
    on_other_board,
    with_options,
    z_section,
)
from tests.simprinter import Scene

Mistake = Callable[[PiezoPrinter, Scene], Scene]


def _with(section: str, **options: Optional[str]) -> Mistake:
    """Other options in one section."""
    return lambda printer, scene: with_options(scene, section, **options)


def _wrong_sign(printer: PiezoPrinter, scene: Scene) -> Scene:
    probe = printer.inductive
    return with_options(
        scene, "probe", x_offset=f"{-probe.x:g}", y_offset=f"{-probe.y:g}"
    )


def _sensor_inverted(printer: PiezoPrinter, scene: Scene) -> Scene:
    pin = inverted(scene.wiring.inputs["bed_sensor"])
    return with_options(scene, "auto_z_offset", pin=pin)


def _probe_inverted(printer: PiezoPrinter, scene: Scene) -> Scene:
    pin = inverted(scene.wiring.inputs["probe"])
    return with_options(scene, "probe", pin=pin)


def _other_pin(printer: PiezoPrinter, scene: Scene) -> Scene:
    """Nothing is wired to it."""
    return with_options(scene, "auto_z_offset", pin="PC9")


def _beside_the_bed(printer: PiezoPrinter, scene: Scene) -> Scene:
    place = f"{printer.bed[0]:g}, 250"
    return with_options(scene, "auto_z_offset", bed_xy_position=place)


def _no_room(printer: PiezoPrinter, scene: Scene) -> Scene:
    # Which the host cannot tell from such an axis
    direction = {"homing_positive_dir": "False"}
    section = z_section(scene)
    return with_options(scene, section, position_max="6", **direction)


def _high_floor(printer: PiezoPrinter, scene: Scene) -> Scene:
    """Above where the sensor triggers."""
    floor = printer.correction - printer.options.z_offset + 0.3
    return with_options(scene, "auto_z_offset", probe_z_min=f"{floor:g}")


def _sticky_sensor(printer: PiezoPrinter, scene: Scene) -> Scene:
    sensor = scene.world.bed_sensor
    assert sensor is not None
    hysteresis = printer.options.probe_hop + 0.5
    noise = dataclasses.replace(sensor.noise, hysteresis=hysteresis)
    return scene.with_world(bed_sensor=dataclasses.replace(sensor, noise=noise))


def _saved_wrong(printer: PiezoPrinter, scene: Scene) -> Scene:
    correction = printer.correction + 2.0
    return with_options(
        scene, "auto_z_offset", probe_z_correction=f"{correction:.6f}"
    )


MISTAKES: Mapping[str, Mistake] = {
    "offsets of wrong sign": _wrong_sign,
    "sensor inverted": _sensor_inverted,
    "sensor off": _with("auto_z_offset", prepare_gcode=""),
    "another pin": _other_pin,
    "probe inverted": _probe_inverted,
    "beside the bed": _beside_the_bed,
    "no room above": _no_room,
    "floor above the bed": _high_floor,
    "sticky sensor": _sticky_sensor,
    "another correction saved": _saved_wrong,
}


def scene_of(printer: PiezoPrinter) -> Scene:
    """The printer with its boards, and with its mistake."""
    scene, signal = printer.scene(), printer.other_board
    if signal:
        scene = on_other_board(scene, signal, printer.board_latency)
    if not printer.mistake:
        return scene
    return MISTAKES[printer.mistake](printer, scene)
