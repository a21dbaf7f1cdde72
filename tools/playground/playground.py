"""A printer to play with: the lab of the tests, with a watcher in it."""

from __future__ import annotations

import queue
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, Optional

from simprinter import Machine, Scene, heated
from simprinter.hosts.hosts import Host
from simprinter.hosts.moonraker import Moonraker, write_conf
from simprinter.hosts.session import LiveSession, SessionError
from simprinter.real import as_real
from simprinter.world import CrashError
from tools.kit.docks import DOCK_SCENES, calibrating
from tools.kit.lab import Lab
from tools.kit.printer import firmware_of
from tools.kit.scenes import SCENES
from tools.playground import commands, film, network
from tools.playground.parameters import all_parameters
from tools.playground.server import PageServer
from tools.playground.watcher import Watcher

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


def point_of(scene: Scene) -> tuple[float, float]:
    """Where on the bed the gap is told, X and Y in mm."""
    section = scene.sections.get("z_calibration") or {}
    place = section.get("bed_xy_position")
    if place is None:
        bed = scene.world.bed
        return (bed.x_min + bed.x_max) / 2, (bed.y_min + bed.y_max) / 2
    x, y = map(float, place.split(","))
    return x, y


class Door(NamedTuple):
    """Where Moonraker listens, and to whom besides its own machine.

    port: or the next that is free. origins: of web pages from elsewhere.
    """

    listen: str = network.LOOPBACK
    port: int = 7125
    origins: Sequence[str] = ()


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


class Playground(Lab):
    """Use as a context manager.

    say: shows a line. Its page is served from open_page() on.
    """

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
        self._door = door
        self._tell = say
        self.choice = choice
        self.page: Optional[PageServer] = None
        self.watcher: Optional[Watcher] = None
        self._serials: dict[str, str] = {}
        self._chosen: queue.SimpleQueue[str] = queue.SimpleQueue()
        super().__init__(host, python, directory, choice.scene(), speed)
        self.seed = choice.seed
        self.config_file = self.data / "config" / "printer.cfg"

    @property
    def moonraker_url(self) -> str:
        """Where Moonraker answers."""
        listen = self._door.listen
        host = network.LOOPBACK if listen == network.EVERYWHERE else listen
        return f"http://{host}:{self.moonraker.port}"

    def open_page(self, wanted_port: int) -> str:
        """Serve the page, on that port or the next that is free; its address."""
        port, claim = network.reserved_port(network.LOOPBACK, wanted_port)
        self._claims.append(claim)
        page = PageServer(port, self)
        page.start()
        self.page = page
        return page.url

    def _say(self, line: str) -> None:
        self._tell(line)
        if self.page is not None:
            self.page.show_line(line)

    def _make_moonraker(self, python: Path) -> Moonraker:
        listen, wanted_port, more = self._door
        trusted = network.trusted(listen)
        port, claim = network.reserved_port(listen, wanted_port)
        self._claims = [claim]
        origins = network.origins(listen, more)
        conf = self.moonraker_conf
        write_conf(self.data, port, listen, trusted, origins, conf)
        return Moonraker(python, self.data, port, self._env, trusted[0])

    def set_up(self) -> None:
        """Run install.sh, and do the restarts that it asks for."""
        options = ("--modules", "dockable_probe z_calibration", "--force")
        self.install(*(options if self._has_other_dock() else ()))
        self.obey()

    def _has_other_dock(self) -> bool:
        """Whether Kalico would take its own module for the scene's dock."""
        has_dock = "dockable_probe" in self._scene.sections
        return firmware_of(self.host) == "Kalico" and has_dock

    def __exit__(self, *error: object) -> None:
        try:
            super().__exit__(*error)
        finally:
            if self.page is not None:
                self.page.close()
            for claim in self._claims:
                claim.close()

    def has_ended(self) -> Optional[BaseException]:
        """Why the printer cannot go on, if it cannot."""
        living = self._living
        if living is None or not living.done():
            return None
        return living.exception() or SessionError("the printer has ended")

    def restart_ended(self) -> list[str]:
        """Start Moonraker again where it has ended, as systemd does."""
        if not self.moonraker.has_ended():
            return []
        self.moonraker.stop()
        self.moonraker.start()
        return ["moonraker"]

    def do(self, line: str) -> None:
        """Do what was typed, in the simulation."""
        watcher = self.watcher
        if watcher is None:
            self._say("there is no printer yet")
            return

        def act() -> None:
            try:
                self._say(commands.run(line, watcher, self._scene))
            except commands.CommandError as error:
                self._say(f"!! {error}")
            # Klippy's next start goes on as fast
            pace = watcher.machine.simulation.pace
            self._speed = pace.speed if pace else self._speed

        watcher.order(act)

    # What its page asks for; see server.Desk

    def hello(self) -> dict[str, Any]:
        """The machine, and what can be done to it."""
        scene, choice = self._scene, self.choice
        return {
            "kind": "hello",
            "scene": choice.name,
            "scenes": list(SHOWN),
            "machine": f"{choice.kind()}, {firmware_of(self.host)}"
            f" {self.host.version}",
            "moonraker": self.moonraker_url,
            "parts": film.parts_of(scene),
            "point": point_of(scene),
            "wires": list(commands.wires(scene)),
            "commands": list(commands.possible(scene)),
            "parameters": all_parameters(),
            "config": str(self.config_file),
        }

    def choose(self, name: str) -> None:
        """Have another of the printers; obey_page() builds it."""
        self._chosen.put(name)

    def obey_page(self) -> None:
        """Do what the page asked for that takes a restart."""
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
        self._say(f"Printer    {name}, {self.choice.kind()}")

    # The printer is switched off and on with a restart of klippy's service

    def start_klipper(self) -> None:
        """As at boot; with a mistake in printer.cfg klippy waits for RESTART."""
        try:
            super().start_klipper()
        except SessionError as error:
            if self.printer is None:
                raise
            self._say(f"!! {str(error).splitlines()[0]}")
            self._begin_to_live()

    def _begin(self, machine: Machine) -> LiveSession:
        session = super()._begin(machine)
        socket = self.data / "comms" / "klippy.sock"
        point = point_of(self._scene)
        watcher = self.watcher = Watcher(machine, socket, point, self._say)
        watcher.on_look = film.Film(watcher, self._is_watched, self._show).look
        machine.simulation.peers.append(self.watcher)
        return session

    def _is_watched(self) -> bool:
        return self.page is not None and self.page.is_watched

    def _show(self, frame: dict[str, Any]) -> None:
        if self.page is not None:
            self.page.show_frame(frame)

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

    def _stop_klipper(self) -> None:
        watcher, self.watcher = self.watcher, None
        # Crashes have been told, and klippy may have ended with Ctrl-C
        with suppress(CrashError, SessionError):
            super()._stop_klipper()
        if watcher is not None:
            watcher.close()
