"""A home directory, a PATH and a user of its own for install.sh."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import NamedTuple, Optional, Union

from tests.hostkit.printer import module_files

REPO = Path(__file__).resolve().parents[2]
NOBODY = 65534
# All that the script may use; a real sudo or systemctl is out of reach
TOOLS = """awk basename bash cat chmod cmp cp date dirname env find git grep
head id ln mkdir mktemp mv readlink rm sed sort tail tr"""
ORIGIN = "https://example.com/somebody/z-calibration.git"

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
SUDO = FAKE + '[ "$1" != -n ] || shift\nexec "$@"\n'
CURL = FAKE + 'cat "$BOX/answer"\n'

KALICO_SHIPS = ("z_calibration", "dockable_probe")


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
        folder.mkdir(parents=True)
        for file in (REPO / "install.sh", *module_files().values()):
            shutil.copy2(file, folder)
        self.commit(folder)
        self.git(folder, "remote", "add", "origin", ORIGIN)
        return folder

    def commit(self, folder: Path) -> None:
        """Make a folder a repository with all that is in it."""
        self.git(folder, "init", "-q")
        self.git(folder, "add", "-A")
        self.git(
            folder,
            *("-c", "user.name=n", "-c", "user.email=e@example.com"),
            *("commit", "-q", "-m", "all"),
        )

    def klipper(self, name: str = "klipper") -> Path:
        """A Klipper, as far as the script looks at it."""
        folder = self.home / name
        extras = folder / "klippy" / "extras"
        extras.mkdir(parents=True)
        (extras / "__init__.py").write_text("")
        (extras / "probe.py").write_text("probe = 1\n")
        (folder / ".gitignore").write_text("*.pyc\n")
        self.commit(folder)
        return folder

    def kalico(self, name: str = "klipper") -> Path:
        """A Kalico, which ships some names itself and ignores plugins."""
        folder = self.home / name
        for part in ("extras", "plugins"):
            (folder / "klippy" / part).mkdir(parents=True)
            (folder / "klippy" / part / "__init__.py").write_text("")
        for module in KALICO_SHIPS:
            file = folder / "klippy" / "extras" / f"{module}.py"
            file.write_text("kalico = 1\n")
        ignored = "klippy/plugins/*\n!klippy/plugins/__init__.py\n"
        (folder / ".gitignore").write_text(ignored)
        self.commit(folder)
        return folder

    def conf(
        self, folder: str = "printer_data/config", text: str = "[server]\n"
    ) -> Path:
        """A moonraker.conf below HOME."""
        file = self.home / folder / "moonraker.conf"
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(text.encode())
        return file

    def systemd(
        self,
        units: Iterable[str] = ("klipper", "moonraker"),
        state: str = "running",
        answer: Optional[str] = '{"print_stats": {"state": "standby"}}',
        stopped: Iterable[str] = (),
    ) -> None:
        """Services and what Moonraker says; answer None: it is silent.

        stopped: those of the services that do not run.
        """
        names = list(units)
        (self.directory / "units").write_text(
            "".join(f"{name}.service\n" for name in names)
        )
        (self.directory / "active").write_text(
            "".join(f"{name}\n" for name in names if name not in stopped)
        )
        (self.directory / "state").write_text(f"{state}\n")
        (self.directory / "answer").write_text(answer or "")
        self.fake("systemctl", SYSTEMCTL)
        self.fake("sudo", SUDO)
        self.fake("curl", CURL)

    def calls(self) -> list[str]:
        """Calls of the fakes so far."""
        return (self.directory / "calls").read_text().splitlines()

    def forget_calls(self) -> None:
        """Begin anew with the calls."""
        (self.directory / "calls").write_text("")

    def restarted(self) -> list[str]:
        """The services that were restarted."""
        start = "systemctl restart "
        return [c[len(start) :] for c in self.calls() if c.startswith(start)]

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
            "GIT_CONFIG_GLOBAL": "/dev/null",
            "GIT_CONFIG_SYSTEM": "/dev/null",
            "GIT_CEILING_DIRECTORIES": str(self.directory),
            "GIT_CONFIG_COUNT": "1",
            "GIT_CONFIG_KEY_0": "init.defaultBranch",
            "GIT_CONFIG_VALUE_0": "main",
        }


def new_box(home: str = "home") -> Box:
    """A box that an unprivileged user can reach."""
    directory = Path(tempfile.mkdtemp(prefix="install-"))
    directory.chmod(0o755)
    return Box(directory, home)


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
