"""A printer to play with: it lives, a watcher is in it, a page shows it."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any, Optional

from simplay import commands, film, network
from simplay.server import PageServer
from simplay.watcher import Spot, Watcher
from simprinter import Machine, Scene
from simprinter.hosts.living import LivingPrinter
from simprinter.hosts.moonraker import Moonraker, write_conf
from simprinter.hosts.printer import firmware_of
from simprinter.hosts.session import LiveSession, SessionError
from simprinter.world import CrashError


def middle_of_bed(scene: Scene) -> tuple[float, float]:
    """X and Y in mm."""
    bed = scene.world.bed
    return (bed.x_min + bed.x_max) / 2, (bed.y_min + bed.y_max) / 2


class Played(LivingPrinter):
    """Use as a context manager.

    Its page is served from open_page() on. Those who build upon it name the
    printer, and say what the page has beyond what fits any.
    """

    # What is typed to have it, for who has only its page
    program = ""

    def __init__(
        self, door: network.Door, say: Callable[[str], None], *printer: Any
    ):
        """say: shows a line. printer: see the class that comes next."""
        self._door = door
        self._tell = say
        self._claims: list[network.Claim] = []
        self.page: Optional[PageServer] = None
        self.watcher: Optional[Watcher] = None
        super().__init__(*printer)
        self.config_file = self.data / "config" / "printer.cfg"

    def __exit__(self, *error: object) -> None:
        try:
            super().__exit__(*error)
        finally:
            if self.page is not None:
                self.page.close()
            for claim in self._claims:
                claim.close()

    @property
    def moonraker_url(self) -> str:
        """Where Moonraker answers."""
        listen = self._door.listen
        host = network.LOOPBACK if listen == network.EVERYWHERE else listen
        return f"http://{host}:{self.moonraker.port}"

    def title(self) -> str:
        """Which printer it is, in some words."""
        raise NotImplementedError

    def about(self) -> str:
        """The same for its page, which may show its name elsewhere."""
        return self.title()

    def set_up(self) -> None:
        """Start klippy, once Moonraker runs."""
        self.start_klipper()

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
        self._claims.append(claim)
        origins = network.origins(listen, more)
        conf = self.moonraker_conf
        write_conf(self.data, port, listen, trusted, origins, conf)
        return Moonraker(python, self.data, port, self._env, trusted[0])

    def has_ended(self) -> Optional[BaseException]:
        """Why the printer cannot go on, if it cannot."""
        living = self._living
        if living is None or not living.done():
            return None
        return living.exception() or SessionError("the printer has ended")

    def look_after(self) -> list[str]:
        """Do what takes a restart; the programs that were started again."""
        return self.restart_ended()

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
        """The machine, what can be done to it, and what is this project's."""
        host, scene, watcher = self.host, self._scene, self.watcher
        return {
            "kind": "hello",
            "program": self.program,
            "machine": f"{self.about()}, {firmware_of(host)} {host.version}",
            "moonraker": self.moonraker_url,
            "parts": film.parts_of(scene),
            "spot": watcher.spot if watcher else self.place({}),
            "wires": list(commands.wires(scene)),
            "commands": list(commands.possible(scene)),
            "words": [*commands.COMMANDS, *commands.ENDS],
            "config": str(self.config_file),
            **self.more_of_hello(),
        }

    def more_of_hello(self) -> dict[str, Any]:
        """What the page shows beyond what fits any printer; all may be left out.

        scene, scenes: the printer's name, and those to choose from.
        shortcuts: (label, G-code, whether it stands out) of buttons; shown
            where klippy knows the command, and the axes are homed.
        first: beginnings of commands that come first when one completes.
        parameters: by command, what each of its parameters means.
        watched: sections whose status has `phase` and `progress`.
        cards: (what the console says, label, what is in front of the figure,
            digits), the first as a regular expression of JavaScript whose
            first group is a figure in mm, its second the uncertainty.
        verdict: the same for a sentence that goes below the figures.
        report: the same for the name of a picture; report_folder: where that
            is, seen from the folder of printer.cfg.
        tour: (title, text) of its steps, in which *this* is pressed, and `this`
            is typed.
        The `warnings` that a watched section has in its status colour the card.
        """
        return {}

    def place(self, settings: dict[str, Any]) -> Spot:
        """Where on the bed the true gap is told, and how large it is meant to be.

        settings: what klippy says of its configuration, by sections; {} before it
        has said anything.
        """
        return Spot(*middle_of_bed(self._scene))

    def choose(self, name: str) -> None:
        """Have another of the printers: there is none."""

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
        watcher = self.watcher = Watcher(machine, socket, self.place, self._say)
        watcher.on_look = film.Film(watcher, self._is_watched, self._show).look
        machine.simulation.peers.append(self.watcher)
        return session

    def _is_watched(self) -> bool:
        return self.page is not None and self.page.is_watched

    def _show(self, frame: dict[str, Any]) -> None:
        if self.page is not None:
            self.page.show_frame(frame)

    def _stop_klipper(self) -> None:
        watcher, self.watcher = self.watcher, None
        # Crashes have been told, and klippy may have ended with Ctrl-C
        with suppress(CrashError, SessionError):
            super()._stop_klipper()
        if watcher is not None:
            watcher.close()
