"""A home directory, a PATH and a user of its own for install.sh."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple, Optional, Union

from tools.kit.printer import FOLDER, module_files
from tools.kit.printer import MODULES as NAMES

REPO = Path(__file__).resolve().parents[2]
NOBODY = 65534
# All that the script may use; a real sudo or systemctl is out of reach
TOOLS = """awk bash cat cp date dirname env find git grep id ln mktemp mv
readlink rm sed sort tr wc"""
ORIGIN = "https://example.com/somebody/z-calibration.git"
MODULES = sorted(NAMES)
KALICO_SHIPS = ("z_calibration", "dockable_probe")
OVERRIDE = "[danger_options]\nallow_plugin_override: True\n"

# The first clone of this repository, which the others are copies of
_CLONE: list[tempfile.TemporaryDirectory] = []

# Notes its call; answers with what lies in the file of that name
FAKE = """#!/usr/bin/env bash
echo "${0##*/} $*" >>"$BOX/calls"
"""
SYSTEMCTL = (
    FAKE
    + """
case " $* " in
*" is-system-running "*) cat "$BOX/state" ;;
*" list-unit-files "*)
    pattern=${*: -1}
    while read -r unit; do
        # shellcheck disable=SC2053
        [[ $unit == $pattern ]] && echo "$unit enabled enabled"
    done <"$BOX/units" ;;
*" is-active "*) grep -qx "${*: -1}" "$BOX/active" ;;
*" restart "*) ! grep -qx "${*: -1}" "$BOX/broken" ;;
esac
"""
)
SUDO = FAKE + '[ "$1" != -v ] || exit 0\n[ "$1" != -n ] || shift\nexec "$@"\n'
# What the program says of the Moonraker at an address: two units and a state
PYTHON = """#!/usr/bin/env bash
url=${*: -1}
echo "python3 $url" >>"$BOX/calls"
cat "$BOX/answer-${url##*:}" 2>/dev/null || cat "$BOX/answer"
"""


class Outcome(NamedTuple):
    """How a run of the script ended."""

    code: int
    out: str
    err: str


class Box:
    """Klipper, Moonraker's configuration and our checkout in one HOME."""

    def __init__(self, directory: Path, home: str = "home"):
        """home: name of the home directory."""
        self.directory = directory
        self.home = directory / home
        self.bin = directory / "bin"
        self.temporary = directory / "tmp"
        self.locale = "C"
        for folder in (self.home, self.bin, self.temporary):
            folder.mkdir()
        for tool in TOOLS.split():
            found = shutil.which(tool)
            assert found, f"{tool} is missing on this machine"
            (self.bin / tool).symlink_to(found)
        for name in ("calls", "active", "broken", "units", "answer"):
            (directory / name).write_text("")
        self.checkout = self.clone(self.home / "klipper_z_calibration")

    # What is there

    def fake(self, name: str, script: str) -> None:
        """A program that the script finds instead of the machine's."""
        file = self.bin / name
        file.unlink(missing_ok=True)
        file.write_text(script)
        file.chmod(0o755)

    def failing(self, name: str, when: str = "*") -> None:
        """A program that fails if its words fit, and does its work if not."""
        real = shutil.which(name)
        self.fake(
            name,
            f'#!/usr/bin/env bash\n[[ "$*" != {when} ]] || exit 1\n'
            f'exec {real} "$@"\n',
        )

    def git(self, folder: Path, *words: str) -> str:
        """Run git in a folder."""
        done = subprocess.run(
            ["git", "-c", "safe.directory=*", "-C", str(folder), *words],
            env=self._environment(),
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            check=False,
        )
        assert done.returncode == 0, done.stdout
        return done.stdout

    def clone(self, folder: Path) -> Path:
        """A clone of this repository, as far as the script needs it."""
        if not _CLONE:
            _CLONE.append(tempfile.TemporaryDirectory(prefix="clone-"))
            self._make_clone(Path(_CLONE[0].name))
        return shutil.copytree(_CLONE[0].name, folder, symlinks=True)

    def _make_clone(self, folder: Path) -> None:
        for file in (
            REPO / "install.sh",
            *(REPO / f"{name}.py" for name in MODULES),
        ):
            shutil.copy2(file, folder)
        shutil.copytree(
            module_files()[FOLDER],
            folder / FOLDER,
            ignore=shutil.ignore_patterns("__pycache__"),
        )
        shutil.copytree(REPO / "installer", folder / "installer")
        self.commit(folder)
        self.git(folder, "remote", "add", "origin", ORIGIN)

    def commit(self, folder: Path) -> None:
        """Make a folder a repository with all that is in it."""
        self.git(folder, "init", "-q")
        self.git(folder, "add", "-A")
        self.git(
            folder,
            *("-c", "user.name=n", "-c", "user.email=e@example.com"),
            *("commit", "-q", "-m", "all"),
        )

    def klipper(self, name: str = "klipper", **files: str) -> Klipper:
        """A Klipper, as far as the script looks at it; files: in extras."""
        klipper = Klipper(self.home / name, self)
        return klipper.made({"extras": {"probe": "a = 1\n", **files}})

    def kalico(self, name: str = "klipper") -> Klipper:
        """A Kalico, which ships some names itself and ignores plugins."""
        klipper = Klipper(self.home / name, self, "klippy/plugins")
        shipped = dict.fromkeys(KALICO_SHIPS, "kalico = 1\n")
        return klipper.made(
            {"extras": shipped, "plugins": {}},
            ignored="klippy/plugins/*\n!klippy/plugins/__init__.py\n",
        )

    def conf(
        self, folder: str = "printer_data/config", text: str = "[server]\n"
    ) -> Path:
        """A moonraker.conf below HOME."""
        return self.write(f"{folder}/moonraker.conf", text)

    def write(self, name: str, text: str) -> Path:
        """A file below HOME."""
        file = self.home / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text.encode())
        return file

    def systemd(
        self,
        units: Iterable[str] = ("klipper", "moonraker"),
        state: str = "running",
        answer: str = "idle",
        stopped: Iterable[str] = (),
    ) -> None:
        """Services and what each Moonraker says; "" if it is silent.

        One that knows its units says "klipper-1 moonraker-1 idle", another one
        only what its printer does. stopped: those of the services that do not
        run.
        """
        names = list(units)
        active = [name for name in names if name not in stopped]
        for name, lines in (
            ("units", [f"{name}.service" for name in names]),
            ("active", active),
            ("state", [state]),
            ("answer", [self._said(answer)] if answer else []),
        ):
            text = "".join(f"{line}\n" for line in lines)
            (self.directory / name).write_text(text)
        self.fake("systemctl", SYSTEMCTL)
        self.fake("sudo", SUDO)
        self.fake("python3", PYTHON)

    def answers(self, port: int, answer: str) -> None:
        """What the Moonraker at that port says."""
        text = f"{self._said(answer)}\n" if answer else ""
        (self.directory / f"answer-{port}").write_text(text)

    @staticmethod
    def _said(answer: str) -> str:
        return answer if " " in answer else f"- - {answer}"

    def calls(self, program: str = "") -> list[str]:
        """Calls of the fakes so far."""
        lines = (self.directory / "calls").read_text().splitlines()
        return [line for line in lines if line.startswith(program)]

    def restarted(self) -> list[str]:
        """The services that were restarted since the last time."""
        start = "systemctl restart "
        names = [call[len(start) :] for call in self.calls(start)]
        (self.directory / "calls").write_text("")
        return names

    def short(self, path: object) -> str:
        """A path as the script shows it to a person."""
        return str(path).replace(f"{self.home}/", "~/")

    # Running it

    def run(
        self, *options: str, script: Optional[Path] = None, **more: str
    ) -> Outcome:
        """Run the script as an unprivileged user; more: environment."""
        path = script or self.checkout / "install.sh"
        return self.command([str(path), *options], more)

    def command(
        self,
        command: list[str],
        more: Optional[Mapping[str, str]] = None,
        stdin: Union[bytes, int] = subprocess.DEVNULL,
    ) -> Outcome:
        """Run any command in the box; stdin: its text or a descriptor."""
        user: dict = {}
        if os.getuid() == 0:
            give_away(self.directory)
            user = {"user": NOBODY, "group": NOBODY, "extra_groups": []}
        done = subprocess.run(
            command,
            env={**self._environment(), **(more or {})},
            cwd=self.directory,
            capture_output=True,
            timeout=60,
            check=False,
            **{"input" if isinstance(stdin, bytes) else "stdin": stdin},
            **user,
        )
        out, err = done.stdout.decode(), done.stderr.decode()
        assert list(self.temporary.iterdir()) == [], "scratch was left behind"
        return Outcome(done.returncode, out, err)

    def installed(self, *options: str, **more: str) -> str:
        """Run it, expect success and no complaint; what it said."""
        outcome = self.run(*options, **more)
        assert (outcome.code, outcome.err) == (0, ""), outcome
        return outcome.out

    def refused(self, code: int, *options: str, **more: str) -> str:
        """Run it, expect that code and nothing changed; its complaint."""
        self.restarted()
        before = snapshot(self.home)
        outcome = self.run(*options, **more)
        assert outcome.code == code, outcome
        assert snapshot(self.home) == before
        assert self.restarted() == []
        return outcome.err

    def _environment(self) -> dict[str, str]:
        return {
            "PATH": str(self.bin),
            "HOME": str(self.home),
            "TMPDIR": str(self.temporary),
            "BOX": str(self.directory),
            "LC_ALL": self.locale,
            "GIT_CONFIG_GLOBAL": "/dev/null",
            "GIT_CONFIG_SYSTEM": "/dev/null",
            "GIT_CEILING_DIRECTORIES": str(self.directory),
            "GIT_CONFIG_COUNT": "1",
            "GIT_CONFIG_KEY_0": "init.defaultBranch",
            "GIT_CONFIG_VALUE_0": "main",
        }


class Klipper:
    """A checkout of Klipper or Kalico in a box."""

    def __init__(self, path: Path, box: Box, modules: str = "klippy/extras"):
        """modules: the folder where ours belong."""
        self.path = path
        self.box = box
        self.modules = modules
        self.exclude = path / ".git" / "info" / "exclude"

    def made(
        self, folders: Mapping[str, Mapping[str, str]], ignored: str = ""
    ) -> Klipper:
        """The same, with these files in klippy/ committed."""
        for folder, files in folders.items():
            place = self.path / "klippy" / folder
            place.mkdir(parents=True)
            for name, text in {"__init__": "", **files}.items():
                (place / f"{name}.py").write_text(text)
        (self.path / ".gitignore").write_text(f"*.pyc\n{ignored}")
        self.box.commit(self.path)
        return self

    def place(self, name: str = "z_calibration.py") -> Path:
        """Where a module's link belongs, or the folder's."""
        folder = "klippy/extras" if name == FOLDER else self.modules
        return self.path / folder / name

    def links(self) -> dict[str, str]:
        """Every link in extras and plugins, with what it points to."""
        folder = self.path / "klippy"
        paths = sorted(folder.glob("*/*"))
        return {
            str(path.relative_to(folder)): os.readlink(path)
            for path in paths
            if path.is_symlink()
        }

    def expected(self, *modules: str) -> dict[str, str]:
        """What links() is with these modules of ours, and the folder.

        Kalico keeps its own dockable_probe unless ours is asked for.
        """
        kept = "plugins" in self.place("dockable_probe.py").parts
        ours = [m for m in modules if not (kept and m == "dockable_probe")]
        names = [f"{module}.py" for module in ours] + [FOLDER]
        folder = self.path / "klippy"
        places = {self.place(n).relative_to(folder): n for n in names}
        return {
            str(place): str(self.box.checkout / name)
            for place, name in sorted(places.items())
        }

    def status(self) -> str:
        """What git has to say of it."""
        return self.box.git(self.path, "status", "--porcelain")


def options_in(shown: str) -> set[str]:
    """The options that a help text shows."""
    words = re.findall(r"^  +(-.*?)(?:  |$)", shown, re.M)
    return set(re.findall(r"--?[a-z][a-z-]*", "\n".join(words)))


def give_away(folder: Path) -> None:
    """Make all of a folder the unprivileged user's."""
    for path in (folder, *folder.rglob("*")):
        os.chown(path, NOBODY, NOBODY, follow_symlinks=False)


def snapshot(folder: Path) -> dict[str, tuple]:
    """Everything below a folder but git's index: kind, mode, content."""
    found: dict[str, tuple] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if name.endswith(".git/index"):
            continue
        mode = path.lstat().st_mode
        if path.is_symlink():
            found[name] = ("link", os.readlink(path))
        elif path.is_dir():
            found[name] = ("directory", mode)
        else:
            found[name] = ("file", mode, path.read_bytes())
    return found
