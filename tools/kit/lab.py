"""A printer as its owner has it: Klipper, our checkout, Moonraker, services.

Everything is below one directory: an origin for the checkout, a home directory
with checkouts of Klipper (or Kalico) and of this repository, and stand-ins for
sudo and systemctl. Klippy, on the simulated printer, and Moonraker are real.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Mapping
from fnmatch import fnmatch
from pathlib import Path
from typing import Optional, Union

from simprinter import Scene, heated
from simprinter.hosts.environment import REPO_ROOT, clean_environment, run
from simprinter.hosts.hosts import Host, Installed
from simprinter.hosts.living import (
    LivingPrinter,
    for_web_interfaces,
    make_data,
)
from simprinter.hosts.trees import (
    FOLDER_PARENT,
    link_tree,
    put_folder,
    put_module,
)
from tools.kit.printer import FOLDER, RunningPrinter, firmware_of
from tools.kit.scenes import SCENES

# How much faster than a real printer the simulated one lives
SPEED = 20.0
FIRST_TAG = "v0.9.0"

_SERVICES = Path(__file__).with_name("services")
# What a host lacks of a whole checkout and Moonraker looks for
_REST_OF_KLIPPER = {
    "config/README.md": "",
    "docs/README.md": "",
    "scripts/klippy-requirements.txt": "",
    "scripts/install-octopi.sh": "",
}
# What Klipper's and Kalico's own repositories ignore
_IGNORED = "*.so\n*.pyc\n__pycache__/\nklippy/.version\n"
_IGNORED_PLUGINS = "klippy/plugins/*\n!klippy/plugins/__init__.py\n"

# What a release has behind the module, as Klipper loads it
_HELP = """

if "plugins" in __name__.split("."):
    from ..extras.z_touch import release
else:
    from .z_touch import release


def _released(config, load=load_config):
    module = load(config)
    gcode = config.get_printer().lookup_object("gcode")
    command = gcode.register_command("CALIBRATE_Z", None)
    gcode.register_command("CALIBRATE_Z", command, desc=release.HELP)
    return module


load_config = _released
"""
_GITCONFIG = """
[user]
    name = lab
    email = lab@example.com
"""
_MOONRAKER_CONF = """\
[machine]
provider: systemd_cli
validate_service: False

[update_manager]
enable_auto_refresh: False
enable_system_updates: False
"""


class Lab(LivingPrinter):
    """One such printer; use as a context manager.

    At first only Moonraker runs, and klippy does for systemd: install() asks
    for restarts of what it has set up, and obey() does them. Who copies by hand
    starts klippy, too.
    """

    printer_class = RunningPrinter
    moonraker_conf = _MOONRAKER_CONF

    def __init__(
        self,
        host: Host,
        python: Path,
        directory: Path,
        scene: Union[str, Scene] = "voron",
        speed: float = SPEED,
    ):
        """python: the one that has Moonraker. speed: of the printer's life."""
        self.directory = directory
        self.home = directory / "home"
        self.checkout = self.home / "klipper_z_calibration"
        self.klipper = self.home / firmware_of(host).lower()
        self.module_dir = self.klipper / host.layout.module_dir
        self._sources = directory / "sources"
        self._releases = 0
        data = self.home / "printer_data"
        self._make_folders(data)
        scene = SCENES[scene] if isinstance(scene, str) else scene
        env = self._environment()
        super().__init__(host, python, data, heated(scene), speed, env)
        self._make_klipper()
        self._make_checkout()
        self._make_configs()

    def __enter__(self) -> Lab:
        for name in ("klipper", "moonraker"):
            (self.directory / "running" / name).touch()
        super().__enter__()
        return self

    # Making it

    def _environment(self) -> dict[str, str]:
        env = clean_environment(
            {
                "HOME": str(self.home),
                "TMPDIR": str(self.directory / "tmp"),
                "PATH": f"{self.directory / 'bin'}:{os.environ['PATH']}",
                "GIT_CONFIG_GLOBAL": str(self.directory / "gitconfig"),
                "GIT_CONFIG_NOSYSTEM": "1",
            }
        )
        # Moonraker updates itself, too, and shall find nothing newer
        env = {k: text for k, text in env.items() if not k.startswith("PIP_")}
        return {**env, "PIP_NO_INDEX": "1", "PIP_CONFIG_FILE": os.devnull}

    def _make_folders(self, data: Path) -> None:
        make_data(data)
        for name in ("tmp", "running"):
            (self.directory / name).mkdir()
        shutil.copytree(_SERVICES, self.directory / "bin")
        (self.directory / "gitconfig").write_text(_GITCONFIG)

    def _make_klipper(self) -> None:
        link_tree(self.host.directory / "base", self.klipper)
        files = {**_REST_OF_KLIPPER, ".gitignore": _IGNORED}
        if self.module_dir.name == "plugins":
            files[".gitignore"] += _IGNORED_PLUGINS
        for name, text in files.items():
            path = self.klipper / name
            path.parent.mkdir(exist_ok=True)
            path.write_text(text)
        self._publish(self.klipper, "klipper.git", "master")

    def _make_checkout(self) -> None:
        """The origin with what is in this repository now, and a clone."""
        copy_own_files(self._sources)
        url = self._publish(self._sources, "origin.git", "main")
        self.git(self.home, "clone", "--quiet", url, self.checkout.name)

    def _publish(self, folder: Path, name: str, branch: str) -> str:
        """Make a folder a repository with an origin; the origin's address."""
        origin = self.directory / name
        start = ("init", "--quiet", "--initial-branch", branch)
        self.git(self.directory, *start, "--bare", name)
        self.git(folder, *start)
        self.git(folder, "remote", "add", "origin", origin.as_uri())
        self._push(folder, branch, FIRST_TAG)
        return origin.as_uri()

    def _push(self, folder: Path, branch: str, tag: str) -> None:
        """Commit and publish what is in a repository now."""
        self.git(folder, "add", "--all")
        self.git(folder, "commit", "--quiet", "--message", tag)
        self.git(folder, "tag", tag)
        options = ("--quiet", "--tags", "--set-upstream")
        self.git(folder, "push", *options, "origin", branch)

    def _make_configs(self) -> None:
        # Klippy gets one with its serial device when it is started
        text = self._installed().config + self._config({})
        (self.data / "config" / "printer.cfg").write_text(text)

    def _config(self, serials: Mapping[str, str]) -> str:
        return self._scene.config(serials, for_web_interfaces(self.data))

    def _installed(self) -> Installed:
        return self.host.at(self.klipper)

    # What its owner does

    def install(self, *options: str) -> str:
        """Run install.sh; what it says. Raises HostError if it fails."""
        if os.getuid() == 0:
            options = (*options, "--allow-root")
        told = self.run([self.checkout / "install.sh", *options])
        # It restarts nothing of which nobody knows whether it prints; whoever
        # has just set it up knows, and does as told
        for unit in re.findall(r"sudo systemctl restart (\S+)", told):
            self.run(["systemctl", "restart", unit])
        return told

    def git(self, folder: Path, *words: str) -> str:
        """What a git command says."""
        return self.run(["git", *words], folder)

    def copy_by_hand(self, module: str) -> None:
        """Instead: one module and the folder, into a Klipper without git."""
        shutil.rmtree(self.klipper / ".git")
        put_module(self.module_dir, module, self.checkout / f"{module}.py")
        folder = self.checkout / FOLDER
        put_folder(self.klipper / FOLDER_PARENT, FOLDER, folder)

    def release(self) -> str:
        """Publish another help text of CALIBRATE_Z; which one.

        It comes from a file of the shared folder, which is new in the first
        release and a changed one in all others.
        """
        self._releases += 1
        help_text = f"As of release {self._releases}"
        file = self._sources / FOLDER / "release.py"
        file.write_text(f'HELP = "{help_text}"\n', encoding="utf-8")
        if self._releases == 1:
            module = self._sources / "z_calibration.py"
            module.write_text(module.read_text("utf-8") + _HELP, "utf-8")
        self._push(self._sources, "main", f"v0.9.{self._releases}")
        return help_text

    def run(
        self, command: list[str | Path], folder: Optional[Path] = None
    ) -> str:
        """What a command says. Raises HostError if it fails."""
        purpose = f"{command[0]} in the lab"
        return run(command, purpose, folder, env=self._env)

    # What systemd does

    def obey(self) -> list[str]:
        """Restart what systemctl was told to, and wait until all is ready."""
        names = self.restart_asked()
        if names:
            self.moonraker.wait_until_ready()
        return names

    def restart_asked(self) -> list[str]:
        """Restart what systemctl was told to since the last time."""
        requests = self.directory / "restarts"
        names = requests.read_text().split() if requests.exists() else []
        requests.unlink(missing_ok=True)
        for name in names:
            (self.directory / "running" / name).touch()
            if name == "klipper":
                self._stop_klipper()
                self.start_klipper()
            else:
                self.moonraker.stop()
                self.moonraker.start()
        return names


def copy_own_files(folder: Path) -> None:
    """Copy this repository as it is now, but for what git would ignore."""
    for name in _own_files():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(REPO_ROOT / name, target)


def _own_files() -> list[str]:
    if not (REPO_ROOT / ".git").exists():
        return _files_but_ignored_ones()
    # In a container it may belong to somebody else
    git = ["git", "-c", "safe.directory=*", "-C", REPO_ROOT]
    names = run(
        [*git, "ls-files", "-z", "-c", "-o", "--exclude-standard"],
        "git ls-files",
        additions={"GIT_OPTIONAL_LOCKS": "0"},
    ).split("\0")
    return [name for name in names if (REPO_ROOT / name).is_file()]


def _files_but_ignored_ones() -> list[str]:
    """The same where there are only the files, such as from an archive."""
    ignored = (REPO_ROOT / ".gitignore").read_text("utf-8").split()
    patterns = [name.rstrip("/") for name in ignored]
    found = []
    for folder, folders, files in os.walk(REPO_ROOT):
        for names in (folders, files):
            names[:] = [
                name
                for name in names
                if not any(fnmatch(name, pattern) for pattern in patterns)
            ]
        inner = Path(folder).relative_to(REPO_ROOT)
        found += [str(inner / name) for name in files]
    return found
