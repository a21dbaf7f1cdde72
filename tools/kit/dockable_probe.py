"""What tests of [dockable_probe] have in common."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Optional, Union

from simprinter.hosts.hosts import Host
from tools.kit.load_errors import load
from tools.kit.printer import Printer
from simprinter import Scene
from tools.kit.docks import DOCK_SCENES, HANG

# Toolhead Z (mm): as low as the probe may travel
CLEAR = HANG + 2.0
# On the way to the dock, where the gantry may hang askew
WAY = HANG + 5.0
# A dead switch is pressed until the floor of the touch
FLOOR = HANG - 5.0
GANTRY = DOCK_SCENES["dock_gantry"]
SWITCH = DOCK_SCENES["dock_gantry_switch"]
SENSED = DOCK_SCENES["dock_sensed"]
SERVO = DOCK_SCENES["dock_servo"]
FRAME = DOCK_SCENES["dock_frame"]
BED = DOCK_SCENES["dock_bed"]
ABOVE = DOCK_SCENES["dock_above"]
# How Z comes to be homed with the probe, and where the toolhead stands then
HOMING = {
    # Over the middle of the axes: of X 0 to 300, of Y 0 to 310
    "middle": ({"safe_z_home": None}, (152.0, 130.25)),
    "safe_z_position": (
        {
            "safe_z_home": None,
            "dockable_probe": {"safe_z_position": "100, 90"},
        },
        (100.0, 90.0),
    ),
    "safe_z_home": ({}, (152.0, 125.25)),
    "homing_override": (
        {
            "safe_z_home": None,
            "homing_override": {
                "axes": "z",
                "gcode": "\n  G28 X Y\n  G90\n  G1 X120 Y130 F6000\n  G28 Z",
            },
        },
        (120.0, 130.0),
    ),
}
# A pair of points, each three samples, is enough where it is not about more
QUICK = {"samples": "1"}


def section(**options: Optional[str]) -> dict[str, Any]:
    """Changes to [dockable_probe] only."""
    return {"dockable_probe": options}


def where(printer: Printer) -> str:
    """Where the probe really is."""
    printer.session.wait(0.3)
    # What it has done up to now is settled
    assert printer.machine.truth is not None
    return printer.machine.world.probe_state(printer.now())


# What G-code does not do with the probe on: straight down from Z=20 to a Z
FORCE = {"force_move": {"enable_force_move": "True"}}


def down_by_force(z: float) -> str:
    """The lines for it."""
    return (
        f"G90\nG1 Z20 F900\nSET_KINEMATIC_POSITION Z={40 - z}\nG1 Z20 F300"
        f"\nSET_KINEMATIC_POSITION Z={z}\nM400"
    )


def at(printer: Printer) -> tuple[float, float]:
    """Where the toolhead comes to stand, X and Y (mm)."""
    printer.session.wait(1.0)
    x, y, *_ = printer.session.position()
    return x, y


def moves(printer: Printer, script: str) -> list[tuple[float, float, float]]:
    """Where each move of a script has ended, by the extra [moves]."""
    before = len(printer.status("moves")["ends"])
    printer.run(script)
    return [tuple(end) for end in printer.status("moves")["ends"][before:]]


def with_probe(scene: Scene, **changes: Any) -> Scene:
    """The same with another probe."""
    return scene.with_world(mag_probe=replace(scene.world.mag_probe, **changes))


def trips(printer: Printer, start: int = 0) -> list[str]:
    """What became of the probe, in order: attach, dock, lost ..."""
    return [event.kind for event in printer.machine.truth.events[start:]]


def assert_safe(printer: Printer) -> None:
    """What holds after every failure."""
    assert printer.session.state()[0] == "ready"
    # The nozzle never went where the bed is
    assert printer.machine.truth.min_gap > 0.5


def refusal(
    host: Host, changes: dict[str, Any], scene: Union[str, Scene] = GANTRY
) -> str:
    """The message klippy stops with; it is not an internal error."""
    state, message = load(host, changes, scene)
    assert state == "error", message
    assert "Internal error" not in message
    return message
