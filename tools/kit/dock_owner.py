"""Somebody who sets dockable_probe up by the buttons of its dialogs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Optional

from simprinter import Fault, Scene
from tools.kit.dockable_probe import QUICK, SWITCH, section, where
from tools.kit.printer import Printer
from tools.kit.setup_user import User

SETUP = "DOCKABLE_PROBE_SETUP"
# As the section is before anything is known
UNKNOWN = {
    "dock_position": None,
    "approach_position": None,
    "detach_position": None,
}


class Owner(User):
    """Of a printer whose dock is nowhere yet, the probe in it."""

    SETUP = SETUP

    def put_on(self) -> None:
        """By hand."""
        printer = self.printer
        printer.machine.world.put_probe_on(printer.now())

    def go(self, *places: str) -> None:
        """As the owner likes, without the buttons."""
        script = "\n".join(f"G1 {place} F3000" for place in places)
        self.printer.run(f"G90\n{script}\nM400")

    def look_and_jog(self, step: str) -> None:
        """The toolhead to where it has to be for the places of SWITCH."""
        if step == "DOCK":
            self.go("X50 Y270", "Y306")
            self.jog("Y", 2.0)
        elif step == "OUT":
            self.go("X90")
        elif step == "APPROACH":
            self.go("Y270", "X50")
        elif step == "FETCH" and where(self.printer) == "attached":
            # Put back by hand, as it was fetched before
            self.go("X50 Y270", "Y308", "X90", "Y270")


def dock_owner(
    start: Callable[..., Printer],
    scene: Scene = SWITCH,
    faults: Iterable[Fault] = (),
    more: Optional[dict[str, Any]] = None,
    **options: Optional[str],
) -> Owner:
    """One whose probe is on the toolhead already, in the middle of the bed."""
    changes = section(**{**UNKNOWN, **QUICK, **options})
    changes.update({"respond": {}, **(more or {})})
    user = Owner(start(scene, changes, faults=list(faults)).homed())
    user.go("X150 Y150 Z20")
    user.put_on()
    return user
