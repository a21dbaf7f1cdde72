"""What an owner of [z_calibration] may have wrong: a refusal is right then."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Optional

from tests.campaign.drawn_machines import (
    inverted,
    on_other_board,
    with_options,
    z_section,
)
from tests.campaign.z_calibration_printer import PIN_Y, ZPrinter, docked
from tests.simprinter import Scene

Mistake = Callable[[ZPrinter, Scene], Scene]


def _calibrating(**options: Callable[[ZPrinter], str]) -> Mistake:
    """Other options in [z_calibration]."""

    def change(printer: ZPrinter, scene: Scene) -> Scene:
        texts = {name: text(printer) for name, text in options.items()}
        return with_options(scene, "z_calibration", **texts)

    return change


def _z_axis(**options: Callable[[ZPrinter], Optional[str]]) -> Mistake:
    """Other options of the Z axis."""

    def change(printer: ZPrinter, scene: Scene) -> Scene:
        texts = {name: text(printer) for name, text in options.items()}
        return with_options(scene, z_section(scene), **texts)

    return change


def _wrong_sign(printer: ZPrinter, scene: Scene) -> Scene:
    probe = printer.probe
    return with_options(
        scene, "probe", x_offset=f"{-probe.x:g}", y_offset=f"{-probe.y:g}"
    )


def _wrong_probe_sense(printer: ZPrinter, scene: Scene) -> Scene:
    pin = scene.wiring.inputs["probe"]
    return with_options(scene, "probe", pin=inverted(pin))


def _wrong_pin_sense(printer: ZPrinter, scene: Scene) -> Scene:
    if printer.pin.is_own:
        pin = inverted(scene.wiring.inputs["nozzle_endstop"])
        return with_options(scene, "z_calibration", endstop_pin=pin)
    pin = inverted(scene.wiring.inputs["z_endstop"])
    return with_options(scene, z_section(scene), endstop_pin=pin)


def _no_probe(printer: ZPrinter, scene: Scene) -> Scene:
    wiring = dataclasses.replace(scene.wiring, outputs={"probe_attach": "PD0"})
    scene = dataclasses.replace(scene, wiring=wiring)
    return docked(
        with_options(
            scene,
            "z_calibration",
            start_gcode=None,
            before_switch_gcode=None,
            end_gcode=None,
        )
    )


def _sticky_probe(printer: ZPrinter, scene: Scene) -> Scene:
    """It lets go only above where the next sample begins."""
    probe = scene.world.mag_probe
    assert probe is not None
    hysteresis = printer.sampling.retract + 0.5
    noise = dataclasses.replace(probe.noise, hysteresis=hysteresis)
    return scene.with_world(mag_probe=dataclasses.replace(probe, noise=noise))


def _short_body(printer: ZPrinter, scene: Scene) -> Scene:
    probe = scene.world.mag_probe
    assert probe is not None
    return scene.with_world(mag_probe=dataclasses.replace(probe, body_drop=0.6))


def _at(x: float, y: float) -> str:
    return f"{x:g}, {y:g}"


MISTAKES: Mapping[str, Mistake] = {
    "sites swapped": _calibrating(
        nozzle_xy_position=lambda printer: _at(*printer.switch_head),
        switch_xy_position=lambda printer: _at(printer.pin.x, PIN_Y),
    ),
    "nozzle beside pin": _calibrating(
        nozzle_xy_position=lambda printer: _at(printer.pin.x + 4.0, PIN_Y)
    ),
    "nozzle over bed": _calibrating(
        nozzle_xy_position=lambda printer: _at(printer.pin.x, PIN_Y - 20.0)
    ),
    "body beside pin": _calibrating(
        switch_xy_position=lambda printer: _at(
            printer.switch_head[0] + 8.0, printer.switch_head[1]
        )
    ),
    "beside the bed": _calibrating(
        bed_xy_position=lambda printer: _at(printer.bed[0], 305.0)
    ),
    "switch_offset too large": _calibrating(
        switch_offset=lambda printer: f"{printer.probe.switch_offset + 3.0:g}"
    ),
    "low safe_z_height": _calibrating(safe_z_height=lambda printer: "1"),
    "floor above the bed": _calibrating(position_min=lambda printer: "0.4"),
    "endstop is the probe": _z_axis(
        endstop_pin=lambda printer: "probe:z_virtual_endstop",
        position_endstop=lambda printer: None,
    ),
    "endstop far off": _z_axis(
        position_endstop=lambda printer: f"{printer.pin.height + 2.5:g}"
    ),
    "no room above": _z_axis(
        position_max=lambda printer: "9",
        # Which the host cannot tell from such an axis
        homing_positive_dir=lambda printer: "False",
    ),
    "offsets of wrong sign": _wrong_sign,
    "probe normally open": _wrong_probe_sense,
    "endstop inverted": _wrong_pin_sense,
    "no probe": _no_probe,
    "sticky probe": _sticky_probe,
    "short body": _short_body,
}


def scene_of(printer: ZPrinter) -> Scene:
    """The printer with its boards, and with its mistake."""
    scene, signal = printer.scene(), printer.other_board
    if signal == "z_endstop" and printer.pin.is_own:
        signal = "nozzle_endstop"
    if signal:
        scene = on_other_board(scene, signal, printer.board_latency)
    if not printer.mistake:
        return scene
    return MISTAKES[printer.mistake](printer, scene)
