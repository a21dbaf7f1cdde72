"""What tests of [z_calibration] have in common."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, Optional, Union

import pytest

from simprinter.hosts.hosts import Host
from tools.kit.load_errors import load
from tools.kit.printer import Printer, module_files
from simprinter import Fault, Scene

MICROSTEP = 0.0025
RESULT = re.compile(
    r"Z-CALIBRATION: probe=(\S+) - \(switch=(\S+) - nozzle=(\S+)"
    r" \+ switch_offset=(\S+)\) --> new offset=(\S+)"
)
# Heights of the voron scene in klippy's frame, mm
PIN = 1.6
BED = PIN - (1.9012 - 0.4)
BODY = 6.415
TRIGGER = BODY + 0.5
SWITCH_OFFSET = 0.44
SAVE = "Z_CALIBRATION_SAVE_GCODE_OFFSET"


def section(**options: Optional[str]) -> dict[str, Any]:
    """Changes to [z_calibration] only."""
    return {"z_calibration": options}


def result_of(lines: list[str]) -> tuple[float, ...]:
    """The numbers of the result line: probe, switch, nozzle, so, offset."""
    found = [m for m in map(RESULT.search, lines) if m]
    assert len(found) == 1, lines
    return tuple(map(float, found[0].groups()))


def touched_sites(printer: Printer, start: int = 0) -> list[str]:
    """Sites touched in order, without the homing of X and Y."""
    return [
        touch.site
        for touch in printer.machine.truth.touches[start:]
        if not touch.site.endswith("endstop")
    ]


def calibration(
    printer: Printer, script: str = "CALIBRATE_Z"
) -> tuple[tuple[float, ...], list[str]]:
    """Run it; the result, and the sites touched by it."""
    before = len(printer.machine.truth.touches)
    lines = printer.run(script)
    return result_of(lines), touched_sites(printer, before)


def validity(printer: Printer) -> tuple[bool, bool, str]:
    """Whether the heights hold, whether the offset does, and why not."""
    status = printer.status("z_calibration")
    return status["measured"], status["valid"], status["reason"]


def pending(printer: Printer) -> dict[str, dict[str, str]]:
    """What waits for SAVE_CONFIG, by section."""
    config = printer.status("configfile")
    waiting: dict[str, dict[str, str]] = config["save_config_pending_items"]
    return waiting


def kept_runs(
    printer: Printer, folder: Optional[Path] = None
) -> list[dict[str, Any]]:
    """The lines of the history, once what is under way has ended."""
    printer.session.wait(1.0)
    folder = folder or printer.session.data / "config" / "z_calibration"
    lines = (folder / "printer.jsonl").read_text().splitlines()
    return [json.loads(line) for line in lines]


def reported(
    printer: Printer, words: str, command: str = "Z_CALIBRATION_REPORT"
) -> str:
    """The line with these words, once the report that a command starts has it.

    A process of its own draws it, in its own time.
    """
    before = len(printer.session.console)
    printer.run(command)
    for _ in range(120):
        for line in printer.session.console[before:]:
            if words in line:
                return line
        printer.session.wait(0.5)
    raise AssertionError(printer.session.console[before:])


def lowest_tip(printer: Printer) -> float:
    """True height of the tip over the bed at its lowest, mm."""
    return printer.machine.truth.min_gap


def assert_unharmed(printer: Printer, offset: float = 0.0) -> None:
    """What holds after every failure."""
    assert printer.session.state()[0] == "ready"
    assert printer.offset() == pytest.approx(offset)
    printer.session.wait(2.0)
    assert printer.session.position()[2] >= 13.7


def marker(name: str, body: str = "") -> dict[str, str]:
    """A macro that leaves a line on the console."""
    code = f"\n  RESPOND MSG={name}"
    if body:
        code += f"\n  {body}"
    return {"gcode": code}


def marked(*names: str, **bodies: str) -> dict[str, Any]:
    """Macros for the three templates, each leaving a line."""
    changes = {"respond": {}}
    for name in names:
        changes[f"gcode_macro {name}"] = marker(name, bodies.get(name, ""))
    return changes


def with_dead_pin(
    start: Callable,
    touch: int = 2,
    command: str = "CALIBRATE_Z",
    **options: Any,
) -> Printer:
    """A homed printer whose pin is dead at that touch of a command."""
    fault = Fault(
        "trigger_never", site="nozzle_pin", touch=touch, command=command
    )
    printer = start(faults=[fault], **options)
    printer.machine.tolerate("nozzle_pin", 1.01)
    return printer.homed()


def with_extra(folder: Path, code: str) -> dict[str, Path]:
    """Modules to install so that the section [extra] runs this code.

    Once every object is there: printer, probe, homing, gcode, toolhead.
    """
    body = "".join(f"        {line}\n" for line in code.strip().splitlines())
    source = folder / "extra.py"
    source.write_text(
        "def load_config(config):\n"
        "    printer = config.get_printer()\n"
        "    def change():\n"
        "        look_up = printer.lookup_object\n"
        "        probe, homing = look_up('probe'), look_up('homing')\n"
        "        gcode, toolhead = look_up('gcode'), look_up('toolhead')\n"
        f"{body}"
        "    printer.register_event_handler('klippy:mcu_identify', change)\n"
    )
    return {**module_files(), "extra": source}


# For [extra]: a feature that lifts Z where that is so, such as position[1] > 200
LIFT = """
class Lift(object):
    def __init__(self):
        self.next = printer.lookup_object("gcode_move").set_move_transform(
            self, force=True
        )
    def height(self, position):
        return 0.12 if %s else 0.0
    def get_position(self):
        position = self.next.get_position()
        position[2] -= self.height(position)
        return position
    def move(self, newpos, speed):
        lifted = list(newpos)
        lifted[2] += self.height(newpos)
        self.next.move(lifted, speed)
printer.register_event_handler("klippy:connect", Lift)
"""


def with_moves() -> dict[str, Path]:
    """Modules to install so that the section [moves] records every move."""
    source = Path(__file__).with_name("extras") / "moves.py"
    return {**module_files(), "moves": source}


def refusal(
    host: Host, changes: dict[str, Any], scene: Union[str, Scene] = "voron"
) -> str:
    """The message klippy stops with; it is not an internal error."""
    state, message = load(host, changes, scene)
    assert state == "error", message
    assert "Internal error" not in message
    return message
