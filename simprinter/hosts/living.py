"""A printer that lives by itself, as at home: klippy, and Moonraker before it.

Both share one data directory, laid out as installers do it. The printer's
seconds go by as real ones do, or so many times as fast.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import Future
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Optional

from simprinter import Machine, Scene
from simprinter.hosts.hosts import Host, Installed
from simprinter.hosts.moonraker import (
    ALONE,
    Moonraker,
    free_port,
    write_conf,
)
from simprinter.hosts.printer import RunningPrinter, dialect_of
from simprinter.hosts.session import LiveSession

# Of the data directory
_FOLDERS = ("config", "comms", "gcodes", "logs", "misc")


class LivingPrinter:
    """One such printer; use as a context manager.

    At first only Moonraker runs. Those who build upon it say how klippy is
    installed, and what its printer.cfg is.
    """

    # What `printer` is
    printer_class = RunningPrinter
    # What moonraker.conf says beside where it listens
    moonraker_conf = ALONE

    def __init__(
        self,
        host: Host,
        python: Path,
        data: Path,
        scene: Scene,
        speed: float,
        env: Mapping[str, str],
    ):
        """python: the one that has Moonraker. data: see make_data().

        speed: of the printer's life, times real time. env: of both programs.
        """
        self.host = host
        self.data = data
        self.printer: Optional[RunningPrinter] = None
        # Of all that is random in the machine
        self.seed = 0
        self._scene = scene
        self._speed = speed
        self._env = env
        self._living: Optional[Future] = None
        self._life = ExitStack()
        self.moonraker = self._make_moonraker(python)

    def __enter__(self) -> LivingPrinter:
        self.moonraker.start()
        return self

    def __exit__(self, *unused: object) -> None:
        try:
            self._stop_klipper()
        finally:
            self.moonraker.stop()

    def _make_moonraker(self, python: Path) -> Moonraker:
        port = free_port()
        write_conf(self.data, port, more=self.moonraker_conf)
        return Moonraker(python, self.data, port, self._env)

    def _installed(self) -> Installed:
        raise NotImplementedError

    def _config(self, serials: Mapping[str, str]) -> str:
        """printer.cfg for boards on these serial devices.

        Without what the host itself needs.
        """
        raise NotImplementedError

    @contextmanager
    def standing(self) -> Iterator[RunningPrinter]:
        """The printer, which for so long does not live by itself."""
        assert self.printer is not None
        self._life.close()
        try:
            yield self.printer
        finally:
            self._begin_to_live()

    def start_klipper(self) -> None:
        """Have klippy on the printer, as at boot."""
        dialect = dialect_of(self.host)
        machine = Machine(self._scene, self.seed, dialect=dialect)
        self.printer = self.printer_class(machine, self._begin)
        self.printer.session.require_ready()
        self._begin_to_live()

    def _begin_to_live(self) -> None:
        assert self.printer is not None
        living = self.printer.session.living(self._speed)
        self._living = self._life.enter_context(living)

    def _begin(self, machine: Machine) -> LiveSession:
        installed = self._installed()
        installed = replace(installed, env={**self._env, **installed.env})
        config = self._config(machine.serials)
        return LiveSession(installed, machine, config, self.data)

    def _stop_klipper(self) -> None:
        if self.printer is None:
            return
        printer, self.printer = self.printer, None
        with printer:
            self._life.close()


def make_data(data: Path) -> None:
    """Make the folders of a data directory."""
    for name in _FOLDERS:
        (data / name).mkdir(parents=True)
    # Moonraker would fetch one from the internet
    (data / "misc" / "usb.ids").touch()


def for_web_interfaces(data: Path) -> dict[str, dict[str, str]]:
    """Sections of printer.cfg that Moonraker asks for, with their options."""
    return {
        "virtual_sdcard": {"path": str(data / "gcodes")},
        "display_status": {},
        "pause_resume": {},
    }
