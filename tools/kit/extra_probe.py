"""What tests of [extra_probe membrane] have in common."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Optional

from tools.kit.dialogs import dialogs_of
from tools.kit.printer import Printer, RunningPrinter
from simprinter import Scene
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
    """Continue, and a finger on the membrane meanwhile; after: as it is then."""
    session = printer.session
    (shown,) = dialogs_of(session.console)[-1:]
    command = session.begin(shown.gcode("Continue"))
    session.wait(0.3)
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
