"""What tests of [extra_probe membrane] have in common."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Optional

from tools.kit.dialogs import dialogs_of
from tools.kit.printer import Printer, RunningPrinter
from simprinter import Scene
from simprinter.world.spec import PinSpec
from tools.kit.scenes import SCENES

MICROSTEP = 0.0025
# Of the scenes, mm: where the membrane lies, how thick it is at its trigger,
# and where the bed is in klippy's frame after G28, there
POINT = (30.0, 20.0)
THICKNESS = 0.25
SLOPE = POINT[0] * 1e-4 - POINT[1] * 1e-4
BED = 0.45 + SLOPE
PROBE_BED = 2.0 - 2.2713
CALIBRATE = "EXTRA_PROBE_CALIBRATE PROBE=membrane"
CONTINUE = "EXTRA_PROBE_CONTINUE PROBE=membrane"
ABORT = "EXTRA_PROBE_ABORT PROBE=membrane"
NAME = "extra_probe membrane"


def section(**options: Optional[str]) -> dict[str, Any]:
    """Changes to [extra_probe membrane] only."""
    return {NAME: options}


def as_probe(**own: Optional[str]) -> dict[str, Any]:
    """Changes where the membrane is the printer's [probe]."""
    options = dict(SCENES["membrane"].sections[NAME])
    place = options.pop("xy_position")
    return {
        NAME: None,
        "probe": {**options, "x_offset": "0", "y_offset": "0"},
        "extra_probe probe": {"xy_position": place, **own},
    }


def membrane(scene: str = "membrane", **changes: Any) -> Scene:
    """A scene with another membrane."""
    spec = SCENES[scene].world.membrane
    assert spec is not None
    return SCENES[scene].with_world(membrane=replace(spec, **changes))


def lay(printer: RunningPrinter) -> None:
    """A hand that lays the membrane, and a finger on it where that is asked for."""
    printer.machine.lay_membrane()
    shown = dialogs_of(printer.session.console)[-1:]
    if any(dialog.is_open and "finger" in dialog.text for dialog in shown):
        press(printer)


def press(printer: RunningPrinter, after: Optional[bool] = None) -> list[str]:
    """Continue, and a finger on the membrane at once; after: as it is then."""
    session = printer.session
    (shown,) = dialogs_of(session.console)[-1:]
    command = session.begin(shown.gcode("Continue"))
    session.run_until(command, lambda: "with a finger" in session.console[-1])
    for pressed in (True, after):
        printer.machine.hold("membrane", pressed)
        session.wait(0.3)
    return session.finish(command)


def touch(printer: Printer, script: str = CALIBRATE) -> list[str]:
    """The first part, and a hand that lays the membrane; its lines."""
    printer.run(script)
    lay(printer)
    return printer.run(CONTINUE)


def calibrate(printer: Printer, script: str = CALIBRATE) -> list[str]:
    """The whole, with a hand that takes the membrane away; the last lines."""
    touch(printer, script)
    printer.machine.lay_membrane(False)
    return printer.run(CONTINUE)


def true_gap(printer: Printer) -> float:
    """True gap (mm) at G-code Z=0 where the membrane was."""
    return printer.gap(POINT)


def heights(printer: Printer) -> list[float]:
    """World heights (mm) of the tip at which the membrane triggered."""
    found = printer.machine.truth.touches
    return [t.trigger_z for t in found if t.site == "nozzle_membrane"]


def state(printer: Printer) -> dict[str, Any]:
    """All that a failed command must leave as it was."""
    pending = printer.status("configfile")["save_config_pending_items"]
    return {
        "offset": printer.offset(),
        "status": printer.status(NAME),
        "pending": dict(pending),
        "homed": printer.status("toolhead")["homed_axes"],
        "absolute": printer.status("gcode_move")["absolute_coordinates"],
    }


# A switch beside the bed: where it is, and how far above the bed it triggers at the
# point that the probe touches (mm)
BESIDE = (-8.0, 60.0)
BED_POINT = (110.0, 110.0)
HEIGHT = 1.5


def fixed_switch(
    height: float = HEIGHT,
    at: tuple[float, float] = BESIDE,
    over: tuple[float, float] = BED_POINT,
    size: float = 220.0,
) -> Scene:
    """A printer whose probe homes Z, with a switch beside the bed for the nozzle.

    at: where the switch is, over: the point of the bed whose height counts, size: how
    far X and Y go, mm. The section of the switch takes the membrane's place; its owner
    has measured its height. The probe senses the bed 2.2713 mm below the nozzle, and he
    says 2.
    """
    scene = SCENES["membrane_and_probe"]
    bed = replace(scene.world.bed, x_max=size, y_max=size)
    bed_z = bed.z0 + over[0] * bed.slope_x + over[1] * bed.slope_y
    inputs = {**scene.wiring.inputs, "nozzle_endstop": "^PF6"}
    del inputs["membrane"]
    pin = PinSpec(*at, bed_z + height, signal="nozzle_endstop")
    own = {
        "pin": "^PF6",
        "fixed": "True",
        "z_offset": None,
        "switch_height": f"{height}",
        "xy_position": "{}, {}".format(*at),
        "bed_xy_position": "{}, {}".format(*over),
    }
    section = {**scene.sections[NAME], **own}
    section = {name: text for name, text in section.items() if text is not None}
    sections = {**scene.sections, NAME: section}
    for axis in ("stepper_x", "stepper_y"):
        sections[axis] = {**sections[axis], "position_max": f"{size}"}
    return replace(
        scene,
        name="fixed_switch",
        wiring=replace(scene.wiring, inputs=inputs),
        sections=sections,
    ).with_world(pin=pin, membrane=None, bed=bed)
