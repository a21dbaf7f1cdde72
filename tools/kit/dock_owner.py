"""Somebody who sets dockable_probe up by the buttons of its dialogs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, Optional

from simprinter import Fault, Scene
from tools.kit.dockable_probe import QUICK, SWITCH, section
from tools.kit.printer import Printer
from tools.kit.setup_user import User

SETUP = "DOCKABLE_PROBE_SETUP"
# As the section is before anything is known
UNKNOWN = {
    "dock_position": None,
    "approach_position": None,
    "detach_position": None,
}
# The buttons that lead there, for whoever has found the places of SWITCH
TRIAL = {"FETCH": 0, "STORE": 1, "SAVE": 2}


class Owner(User):
    """Of a printer whose dock is nowhere yet, the probe in it."""

    def begin(self) -> None:
        """The command that all begins with."""
        self.printer.run(SETUP)

    def put_on(self) -> None:
        """By hand."""
        machine = self.printer.machine
        now = machine.rig.seconds(machine.simulation.clock.now())
        machine.world.put_probe_on(now)

    def go(self, *places: str) -> None:
        """As the owner likes, without the buttons."""
        script = "\n".join(f"G1 {place} F3000" for place in places)
        self.printer.run(f"G90\n{script}\nM400")

    def find(self, until: str = "FETCH") -> None:
        """Begin, and the places of SWITCH, up to the trial or to a step before."""
        self.begin()
        if until == "ON":
            return
        self.press("Next")
        self.go("X50 Y270", "Y306")
        self.jog("Y", 2.0)
        for label, places in (
            ("Here", ["X90"]),
            ("Here", ["Y270", "X50"]),
            ("Here", []),
        ):
            if self.step() == until:
                return
            self.press(label)
            self.go(*places)
        if until != "INSERT":
            self.press("Same")

    def go_to(self, step: str) -> None:
        """From the beginning to a step, the last one included."""
        self.find("FETCH" if step in TRIAL else step)
        for label in ("Fetch", "Dock")[: TRIAL.get(step, 0)]:
            self.press(label)
        assert self.step() == step


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
