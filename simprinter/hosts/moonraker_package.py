"""The environment of a real Moonraker.

Needs the standard library only, as it is made while the tools are.
"""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Optional

from simprinter.hosts.environment import (
    HostError,
    UnavailableError,
    build_dir,
    ensure,
    environment_key,
    run,
)
from simprinter.hosts.hosts import if_available

# Moonraker needs the system's libsodium, which cannot be installed without
# root; the wheels of pyzmq have one in them.
REQUIREMENTS = "moonraker"


def find_moonraker() -> Optional[Path]:
    """The Python that has Moonraker, prepared where it is not yet.

    None where it may be missing and is, see `missing_hosts`.
    """
    return if_available("moonraker", _prepared)


def moonraker_version(python: Path) -> str:
    """The version of Moonraker in an environment."""
    program = "from importlib.metadata import version as v;"
    program += " print(v('moonraker'))"
    return run([python, "-c", program], "version of Moonraker").strip()


def _prepared() -> Path:
    key = environment_key(REQUIREMENTS)
    python = ensure(build_dir() / "envs" / key, REQUIREMENTS)
    lend_libsodium(python)
    try:
        run([python, "-c", "import libnacl"], "start of libnacl")
    except HostError as error:
        raise UnavailableError(
            "Moonraker needs libsodium, which pyzmq brings on most machines"
            f" but not here; install it (Debian: libsodium23)\n{error}"
        ) from error
    return python


def lend_libsodium(python: Path) -> None:
    """Let libnacl find the libsodium of pyzmq where the system has none."""
    program = "import sysconfig; print(sysconfig.get_path('platlib'))"
    folder = Path(run([python, "-c", program], "folder of packages").strip())
    link = folder / "libnacl" / "libsodium.so"
    for library in folder.glob("pyzmq.libs/libsodium-*.so*"):
        # Another worker may have been faster
        with contextlib.suppress(FileExistsError):
            link.symlink_to(Path("..", "pyzmq.libs", library.name))
