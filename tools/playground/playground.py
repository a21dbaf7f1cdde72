"""A printer to play with: the lab of the tests, with a watcher in it."""

from __future__ import annotations

import queue
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Optional

from simplay.network import Door
from simplay.played import Played, middle_of_bed
from simplay.watcher import Spot
from simprinter import Scene, heated
from simprinter.hosts.hosts import Host
from simprinter.real import as_real
from tools.kit.docks import DOCK_SCENES, calibrating
from tools.kit.lab import Lab
from tools.kit.printer import firmware_of
from tools.kit.scenes import SCENES
from tools.playground import shown, tour
from tools.playground.parameters import all_parameters

# By the module that they show; all other scenes go by their names
SHOWN = {
    "z_calibration": SCENES["voron"],
    "auto_z_offset": SCENES["qidi"],
    "dockable_probe": calibrating(DOCK_SCENES["dock_gantry_switch"]),
    "extra_probe": SCENES["membrane"],
}
KNOWN = {**SHOWN, **SCENES}

# What a web interface expects, and what its buttons call
_MACROS = {
    "respond": {},
    "gcode_macro PAUSE": {
        "rename_existing": "BASE_PAUSE",
        "gcode": "\n  BASE_PAUSE",
    },
    "gcode_macro RESUME": {
        "rename_existing": "BASE_RESUME",
        "gcode": "\n  BASE_RESUME",
    },
    "gcode_macro CANCEL_PRINT": {
        "rename_existing": "BASE_CANCEL_PRINT",
        "gcode": "\n  TURN_OFF_HEATERS\n  BASE_CANCEL_PRINT",
    },
}


def dressed(scene: Scene) -> Scene:
    """The same with what a web interface expects."""
    return replace(scene, sections={**_MACROS, **scene.sections})


def point_of(
    scene: Scene, settings: Optional[Mapping[str, Any]] = None
) -> tuple[float, float]:
    """Where on the bed the gap is told, X and Y in mm: where the module measures.

    settings: what klippy says of its configuration (default: as the scene has it).
    """
    place = _measured_at(settings or scene.sections)
    if place is None:
        return middle_of_bed(scene)
    x, y = map(float, place.split(",") if isinstance(place, str) else place)
    return x, y


def _measured_at(sections: Mapping[str, Any]) -> Any:
    """The option with the point where a module of ours measures; None: none says."""
    mesh = (sections.get("bed_mesh") or {}).get("zero_reference_position")
    for name, options in sections.items():
        module = name.split(" ")[0]
        if module == "z_calibration":
            place = options.get("bed_xy_position") or mesh
        elif module == "auto_z_offset":
            place = options.get("bed_xy_position")
        elif module == "extra_probe":
            # The switch that is laid on the bed, or what is probed besides a fixed one
            is_fixed = str(options.get("fixed")) == "True"
            at_bed = options.get("bed_xy_position") or mesh
            place = at_bed if is_fixed else options.get("xy_position")
        else:
            continue
        if place:
            return place
    return None


class Choice(NamedTuple):
    """A printer that was chosen; seed: of all that is random."""

    name: str
    seed: int
    is_perfect: bool = False

    def scene(self) -> Scene:
        """The machine. Raises KeyError where there is none of that name."""
        scene = KNOWN[self.name]
        return dressed(scene if self.is_perfect else as_real(scene, self.seed))

    def kind(self) -> str:
        """How real it is."""
        if self.is_perfect:
            return "perfect"
        return f"as at home, seed {self.seed}"


class Playground(Played, Lab):
    """Use as a context manager; see Played."""

    program = "make printer"

    def __init__(
        self,
        host: Host,
        python: Path,
        directory: Path,
        choice: Choice,
        speed: float,
        door: Door,
        say: Callable[[str], None],
    ):
        self.choice = choice
        self._serials: dict[str, str] = {}
        self._chosen: queue.SimpleQueue[str] = queue.SimpleQueue()
        scene = choice.scene()
        super().__init__(door, say, host, python, directory, scene, speed)
        self.seed = choice.seed

    def title(self) -> str:
        """Its name, and how real it is."""
        return f"{self.choice.name}, {self.about()}"

    def about(self) -> str:
        """How real it is: the page has its name among those to choose from."""
        return self.choice.kind()

    def set_up(self) -> None:
        """Run install.sh, and do the restarts that it asks for."""
        options = ("--modules", "dockable_probe z_calibration", "--force")
        self.install(*(options if self._has_other_dock() else ()))
        self.obey()

    def _has_other_dock(self) -> bool:
        """Whether Kalico would take its own module for the scene's dock."""
        has_dock = "dockable_probe" in self._scene.sections
        return firmware_of(self.host) == "Kalico" and has_dock

    def look_after(self) -> list[str]:
        """Build what the page has chosen, and do what systemctl was told."""
        self._obey_page()
        return super().look_after() + self.restart_asked()

    def place(self, settings: dict[str, Any]) -> Spot:
        """Where the module measures, and how far above the bed it means Z=0 to be."""
        air_gap = settings.get("auto_z_offset", {}).get("z_offset", 0.0)
        return Spot(*point_of(self._scene, settings), air_gap)

    def more_of_hello(self) -> dict[str, Any]:
        """What is of our modules."""
        return {
            "scene": self.choice.name,
            "scenes": list(SHOWN),
            "parameters": all_parameters(),
            "tour": tour.steps(),
            **shown.ON_THE_PAGE,
        }

    def choose(self, name: str) -> None:
        """Have another of the printers; look_after() builds it."""
        self._chosen.put(name)

    def _obey_page(self) -> None:
        name = ""
        while not self._chosen.empty():
            name = self._chosen.get()
        if name not in KNOWN:
            return
        self._say(f"building {name} ...")
        self._stop_klipper()
        self.choice = self.choice._replace(name=name)
        self._scene = heated(self.choice.scene())
        # With it comes its own printer.cfg
        self._serials = {}
        if self.page is not None:
            self.page.show_hello()
        if self._has_other_dock():
            self.set_up()
        if self.printer is None:
            self.start_klipper()
        self._say(f"Printer    {self.title()}")

    # The printer is switched off and on with a restart of klippy's service

    def _config(self, serials: dict[str, str]) -> str:
        """printer.cfg as its owner has left it; serial devices are new."""
        own = self._installed().config
        if not self._serials:
            text = super()._config(serials)
        else:
            text = self.config_file.read_text().removeprefix(own)
            for name, device in serials.items():
                text = text.replace(self._serials[name], device)
        self._serials = dict(serials)
        return text
