"""A printer to play with: the lab of the tests, with a watcher in it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple, Optional

from simprinter import SCENES, Machine, Scene
from simprinter.docks import DOCK_SCENES, calibrating
from simprinter.hosts.hosts import Host
from simprinter.hosts.moonraker import Moonraker
from simprinter.hosts.session import LiveSession, SessionError
from simprinter.world import CrashError
from tools.kit.lab import Lab
from tools.kit.printer import firmware_of
from tools.playground import commands, network
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


class Playground(Lab):
    """Use as a context manager.

    say: shows a line.
    """

    def __init__(
        self,
        host: Host,
        python: Path,
        directory: Path,
        scene: Scene,
        speed: float,
        door: Door,
        say: Callable[[str], None],
    ):
        self._door = door
        self._say = say
        self.watcher: Optional[Watcher] = None
        self._serials: dict[str, str] = {}
        super().__init__(host, python, directory, dressed(scene), speed)

    @property
    def url(self) -> str:
        """Where Moonraker answers."""
        listen = self._door.listen
        host = network.LOOPBACK if listen == network.EVERYWHERE else listen
        return f"http://{host}:{self.moonraker.port}"

    def _make_moonraker(self, python: Path) -> Moonraker:
        listen, wanted_port, more = self._door
        trusted = network.trusted(listen)
        port, self._claim = network.reserved_port(listen, wanted_port)
        origins = network.origins(listen, more)
        self._write_moonraker_conf(port, listen, trusted, origins)
        return Moonraker(python, self.data, port, self._env, trusted[0])

    def set_up(self) -> None:
        """Run install.sh, and do the restarts that it asks for."""
        # Kalico has a module of that name of its own
        forced = firmware_of(self.host) == "Kalico" and self._has_dock()
        options = ("--modules", "dockable_probe z_calibration", "--force")
        self.install(*(options if forced else ()))
        self.obey()

    def __exit__(self, *error: object) -> None:
        try:
            super().__exit__(*error)
        finally:
            self._claim.close()

    def _has_dock(self) -> bool:
        return "dockable_probe" in self._scene.sections

    def has_ended(self) -> Optional[BaseException]:
        """Why the printer cannot go on, if it cannot."""
        living = self._living
        if living is None or not living.done():
            return None
        return living.exception() or SessionError("the printer has ended")

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

        watcher.order(act)

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
        self.watcher = Watcher(machine, socket, point, self._say)
        machine.simulation.peers.append(self.watcher)
        return session

    def _config(self, serials: dict[str, str]) -> str:
        """printer.cfg as its owner has left it; serial devices are new."""
        file = self.data / "config" / "printer.cfg"
        own = self._installed().config
        if not self._serials:
            text = super()._config(serials)
        else:
            text = file.read_text().removeprefix(own)
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
