"""simplay: anybody's printer.cfg and plugins, to play with."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple, Optional

from simplay.network import Door
from simplay.played import Played
from simprinter.hosts.environment import clean_environment
from simprinter.hosts.hosts import Host, HostError, Installed, missing_hosts
from simprinter.hosts.living import for_web_interfaces, make_data
from simprinter.hosts.moonraker_package import find_moonraker
from simprinter.plugin_printer import modules_of, read_scene


def moonraker() -> Path:
    """The Python that has it. Raises HostError with why there is none."""
    python = find_moonraker()
    if python is None:
        raise HostError(f"simplay needs Moonraker: {_why_not()}")
    return python


def _why_not() -> str:
    return missing_hosts().get("moonraker", "it cannot be downloaded")


class Files(NamedTuple):
    """What a user has; see plugin_printer.start. seed: of all noise."""

    printer_cfg: Path
    world: Optional[Path] = None
    extras: Sequence[Path] = ()
    seed: int = 0


class PluginPlay(Played):
    """Klippy with plugins on the machine of a world file, with Moonraker.

    Its printer.cfg is a copy below `directory`: included files and what
    SAVE_CONFIG has added are in it, comments are not.
    """

    program = "simplay"

    def __init__(
        self,
        host: Host,
        python: Path,
        directory: Path,
        files: Files,
        speed: float,
        door: Door,
        say: Callable[[str], None],
    ):
        """python: the one that has Moonraker. directory: empty, for all files."""
        self._files = files
        self._modules = modules_of(files.extras)
        data = directory / "printer_data"
        make_data(data)
        (directory / "tmp").mkdir()
        # ~/printer_data of a printer.cfg is this one
        home = {"HOME": str(directory), "TMPDIR": str(directory / "tmp")}
        env = clean_environment(home)
        scene = read_scene(files.printer_cfg, files.world)
        super().__init__(door, say, host, python, data, scene, speed, env)
        self.seed = files.seed

    def title(self) -> str:
        return f"{self._files.printer_cfg}, seed {self.seed}"

    def about(self) -> str:
        return f"{self._files.printer_cfg.name}, seed {self.seed}"

    def more_of_hello(self) -> dict[str, Any]:
        # The page shows how far a plugin is that tells its phase
        return {"watched": list(self._modules)}

    def _installed(self) -> Installed:
        return self.host.install(self._modules)

    def _config(self, serials: Mapping[str, str]) -> str:
        # The page closes dialogs with a command of [respond]
        more = {**for_web_interfaces(self.data), "respond": {}}
        return self._scene.config(serials, more)
