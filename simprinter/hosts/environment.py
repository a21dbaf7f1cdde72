"""Python environments and the commands run in them.

    python -m simprinter.hosts.environment DIRECTORY NAME

makes an environment for the tools.  Needs the standard library only, as it
runs before anything is installed.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from simprinter.hosts import needs
from simprinter.places import (
    IS_CHECKOUT,
    PACKAGE,
    REPO_ROOT,
    VARIABLE,
    build_root,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

# What each environment holds: NAME.in says what is wanted, NAME.txt which files
# of the package index that is, with their hashes ("make update-pins"); of hosts,
# and of what else the tools of a checkout need
OF_HOSTS = PACKAGE / "requirements"
REQUIREMENTS = REPO_ROOT / "requirements"

# How much of a failed command's output goes into the error.
OUTPUT_LINES = 25

# A machine without network should learn it in seconds, not minutes.
PIP_OPTIONS = (
    "--disable-pip-version-check",
    "--no-input",
    "--quiet",
    "--retries=2",
    "--timeout=20",
)

# Klippy up to 2023 calls RawConfigParser.readfp, which Python 3.12 removed, and
# is to run there unmodified.  Python executes such a line from a .pth file.
OLD_NAMES = (
    "import configparser as c;"
    " c.RawConfigParser.readfp = c.RawConfigParser.read_file\n"
)

# The signature is prescribed, see https://bford.info/cachedir/
CACHEDIR_TAG = "Signature: 8a477f597d28d172789f06886806bc55\n"

# In a folder that was made for the build, or that was empty when it began: only
# such a one may be removed as a whole. `make clean` looks for it, too.
STAMP = ".made-for-this-build"
# What linters and pytest leave where they run before anything was built
CACHES = {"CACHEDIR.TAG", "pytest_cache", "ruff_cache"}
_REMOVER = '"make clean" removes it' if IS_CHECKOUT else "it may be removed"
STAMP_TEXT = f"All in this folder was made by simprinter; {_REMOVER}.\n"


class HostError(Exception):
    """A host or an environment cannot be prepared; the text says why."""


class UnavailableError(HostError):
    """A package cannot be had from the package index."""


def build_dir() -> Path:
    """The directory for everything that is built, made where missing.

    See places.build_root().  Raises HostError for a path that the hosts cannot
    be built in, and for a folder with something in it that the build has not
    made: it would be removed with the rest.
    """
    directory = build_root()
    if any(character.isspace() for character in str(directory)):
        # Klippy gives gcc the paths of its sources through a shell, unquoted.
        raise HostError(
            f"klippy cannot be built in {directory}, as there is a space in"
            f" the path; set {VARIABLE} to a directory without"
        )
    if not (directory / STAMP).exists():
        _make_ours(directory)
    return directory


def _make_ours(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
        names = {path.name for path in directory.iterdir()}
    except OSError as error:
        raise HostError(f"no folder for the build: {error}") from error
    if not (directory / STAMP).exists() and names - CACHES - {STAMP}:
        raise HostError(
            f"{directory} holds something already, so it cannot become the"
            " folder of the build, which is removed as a whole. Name a new or"
            f" empty one: {VARIABLE}=FOLDER. If it is left from a build before"
            " November 2026, remove it"
        )
    # Where several begin at the same time, one is enough
    (directory / STAMP).write_text(STAMP_TEXT, encoding="ascii")
    (directory / "CACHEDIR.TAG").write_text(CACHEDIR_TAG, encoding="ascii")


def clean_environment(
    additions: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """The environment without what changes how Python, git or gcc behave.

    PYTHONPATH and its like belong to the process that runs the tests, and git
    sets GIT_DIR for a test run started from one of its hooks.
    """
    environment = {
        name: value
        for name, value in os.environ.items()
        if not name.startswith(("PYTHON", "GIT_", "OVERRIDE_"))
        and name not in ("LD_PRELOAD", "VIRTUAL_ENV", "__PYVENV_LAUNCHER__")
    }
    environment.update(additions or {})
    return environment


def run(
    argv: Sequence[str | Path],
    purpose: str,
    cwd: Path | None = None,
    additions: Mapping[str, str] | None = None,
    env: Mapping[str, str] | None = None,
) -> str:
    """Run a command and return what it printed.

    additions: to the environment; env: all of it.  Raises HostError with
    `purpose` and the end of the output if the command is missing or fails.
    """
    try:
        done = subprocess.run(
            [str(word) for word in argv],
            cwd=cwd,
            env=clean_environment(additions) if env is None else env,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            encoding="utf-8",
            errors="replace",
            check=False,
        )
    except OSError as error:
        raise HostError(f"{purpose}: {error}") from error
    if done.returncode:
        tail = "\n".join(done.stdout.splitlines()[-OUTPUT_LINES:])
        raise HostError(
            f"{purpose}: {Path(argv[0]).name} ended with exit code"
            f" {done.returncode}\n{tail}"
        )
    return done.stdout


@contextlib.contextmanager
def locked(path: Path) -> Iterator[None]:
    """Hold the lock file `path` against other processes and threads."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with open(path, "w", encoding="ascii") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@contextlib.contextmanager
def staged(target: Path) -> Iterator[Path]:
    """A new directory that becomes `target` once the block has succeeded.

    So whoever finds `target` finds it complete, also after a power cut.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    staging = Path(tempfile.mkdtemp(prefix=".new-", dir=target.parent))
    try:
        staging.chmod(0o755)
        yield staging
        staging.rename(target)
    finally:
        shutil.rmtree(staging, ignore_errors=True)


def klippy_startup() -> str:
    """What Python has to do first for any klippy to run on it."""
    return OLD_NAMES if sys.version_info >= (3, 12) else ""


def pins(name: str) -> Path:
    """The file with the requirements of that name, each pinned by hashes."""
    own = OF_HOSTS / f"{name}.txt"
    return own if own.exists() else REQUIREMENTS / f"{name}.txt"


def environment_key(name: str, startup: str = "") -> str:
    """Names the environment with these requirements on this Python."""
    parts = ["%d.%d" % sys.version_info[:2], sys.base_prefix, startup]
    parts.append(pins(name).read_text(encoding="ascii"))
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:12]


def klippy_environment(name: str) -> Path:
    """The interpreter of the klippy environment with these requirements."""
    return cached_environment(name, klippy_startup())


def cached_environment(name: str, startup: str = "") -> Path:
    """The interpreter of the environment with these requirements.

    It is made where it is missing.  For `startup` and errors see `ensure`.
    """
    key = environment_key(name, startup)
    return ensure(build_dir() / "envs" / key, name, startup)


def ensure(directory: Path, name: str, startup: str = "") -> Path:
    """Make the environment `directory` unless it is there; return its Python.

    `startup` is a line of code that this Python runs whenever it starts.
    Raises HostError if there is no gcc or this Python cannot make environments,
    and UnavailableError if a requirement cannot be installed.
    """
    python = directory / "bin" / "python"
    stamp = directory / "requirements.stamp"
    key = environment_key(name, startup)

    def is_ready() -> bool:
        # `python` is a link that dangles once its base is uninstalled.
        return (
            python.exists()
            and stamp.exists()
            and stamp.read_text(encoding="ascii") == key
        )

    if is_ready():
        return python
    with locked(directory.with_name(directory.name + ".lock")):
        if not is_ready():
            _check_needs(name)
            _create(directory)
            _install(python, name)
            if startup:
                _write_startup(python, startup)
            stamp.write_text(key, encoding="ascii")
    return python


def _check_needs(name: str) -> None:
    problem = needs.missing_compiler()
    if problem:
        raise HostError(problem)
    problem = needs.missing_index(pins(name), clean_environment())
    if problem:
        raise UnavailableError(problem)


def _create(directory: Path) -> None:
    commands = [
        [sys.executable, "-m", "venv", directory],
        ["virtualenv", "--python", sys.executable, directory],
        [sys.executable, "-m", "virtualenv", directory],
    ]
    for command in commands:
        shutil.rmtree(directory, ignore_errors=True)
        try:
            run(command, "new environment")
            run([directory / "bin" / "python", "-m", "pip", "--version"], "pip")
        except HostError:
            continue
        return
    shutil.rmtree(directory, ignore_errors=True)
    raise HostError(
        f"{sys.executable} cannot make a virtual environment: install the"
        " package python3-venv (Debian: apt install python3-venv), or"
        " virtualenv"
    )


def _install(python: Path, name: str) -> None:
    try:
        # What is downloaded is what was looked at, and none of it runs here.
        # The file is complete: until 23.2 pip takes an extra of something that
        # is pinned for another requirement, without a pin.
        run(
            [python, "-m", "pip", "install", *PIP_OPTIONS, "--no-deps"]
            + ["--require-hashes", "--only-binary=:all:", "-r", pins(name)],
            f"installation of requirements/{name}.txt",
        )
    except HostError as error:
        raise UnavailableError(str(error)) from error


def _write_startup(python: Path, startup: str) -> None:
    program = "import sysconfig; print(sysconfig.get_path('purelib'))"
    folder = run([python, "-c", program], "folder of the packages").strip()
    file = Path(folder) / "startup.pth"
    file.write_text(startup, encoding="ascii")


def check_python() -> None:
    """Raises SystemExit where this Python is too old for the tests."""
    if sys.version_info < (3, 9):
        sys.exit("the tests need Python 3.9 or newer; set PYTHON to one")


def main() -> int:
    check_python()
    if len(sys.argv) != 3:
        sys.exit("usage: python -m simprinter.hosts.environment DIRECTORY NAME")
    try:
        build_dir()
        directory = Path(sys.argv[1]).absolute()
        ensure(directory, sys.argv[2])
    except HostError as error:
        sys.exit(f"error: {error}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
