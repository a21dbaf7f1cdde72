"""Hosts that run on Python 2.7, as printers in the field do.

A checkout is given an interpreter as FOLDER@PYTHON; one from before 2021-10-04
(f1747b511), which runs on no other, finds it by itself.
"""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from typing import NamedTuple, Optional

from simprinter.hosts.environment import (
    PIP_OPTIONS,
    HostError,
    UnavailableError,
    build_dir,
    environment_key,
    klippy_environment,
    locked,
    pins,
    run,
    staged,
)

REQUIREMENTS = "klipper-python2"
# Where pyenv keeps them
_PYENV = ".pyenv/versions/2.7*/bin/python2.7"
# The wheels that are pinned
_PLATFORMS = ("manylinux1_x86_64", "manylinux2010_x86_64")


class Named(NamedTuple):
    """A checkout and the interpreter that it was given, if it was."""

    folder: Path
    python: Optional[str]


def named(text: str) -> Named:
    """FOLDER or FOLDER@PYTHON."""
    folder = Path(text).expanduser()
    before, is_given, python = text.rpartition("@")
    if is_given and not folder.exists():
        return Named(Path(before).expanduser(), python)
    return Named(folder, None)


def is_wanted(checkout: Named) -> bool:
    """Whether it is to run on Python 2.7, or else on that of simprinter.

    Raises HostError for another one.
    """
    if checkout.python is not None:
        if Path(checkout.python).name in ("python2", "python2.7"):
            return True
        raise HostError(
            f"{checkout.folder}@{checkout.python}: give python2.7 or its path,"
            " or nothing: it then runs on the Python that simprinter runs on"
        )
    reactor = checkout.folder / "klippy" / "reactor.py"
    # It has another name in Python 3
    return reactor.exists() and "Queue as queue" in reactor.read_text("utf-8")


def interpreter(checkout: Named) -> Path:
    """The Python 2.7 that it runs on. Raises HostError if there is none."""
    named = checkout.python or "python2.7"
    candidates = [shutil.which(named) or named]
    if Path(named).name == named:
        candidates += map(str, sorted(Path.home().glob(_PYENV)))
    for candidate in candidates:
        # Where pyenv is, there is a command for each Python that it might have
        with contextlib.suppress(HostError):
            if _version(candidate) == "2.7":
                return Path(candidate)
    raise HostError(
        f"{checkout.folder} is to run on Python 2.7, but {named} is none:"
        " install it (pyenv has 2.7.18), or name it: FOLDER@PYTHON"
    )


def _version(python: str) -> str:
    program = "import sys; print('%d.%d' % sys.version_info[:2])"
    return run([python, "-c", program], f"start of {python}").strip()


def packages(python: Path) -> Path:
    """The folder with what klippy needs there, made where it is missing.

    Raises UnavailableError where the package index does not give it.
    """
    program = "import sys; print('mu' if sys.maxunicode > 65535 else 'm')"
    suffix = run([python, "-c", program], f"start of {python}").strip()
    folder = build_dir() / "envs" / f"{environment_key(REQUIREMENTS)}-{suffix}"
    # Python 2.7's own pip may be missing; ours fetches for others, too
    own = klippy_environment("klipper")
    with locked(folder.with_name(folder.name + ".lock")):
        if not folder.exists():
            with staged(folder) as staging:
                _install(own, suffix, staging)
    return folder


def _install(pip_python: Path, suffix: str, target: Path) -> None:
    options = ["--python-version", "27", "--implementation", "cp"]
    options += ["--abi", f"cp27{suffix}", "--abi", "none"]
    for platform in _PLATFORMS:
        options += ["--platform", platform]
    try:
        run(
            [pip_python, "-m", "pip", "install", *PIP_OPTIONS, *options]
            + ["--no-deps", "--require-hashes", "--only-binary=:all:"]
            + ["--target", target, "-r", pins(REQUIREMENTS)],
            f"installation of requirements/{REQUIREMENTS}.txt",
        )
    except HostError as error:
        raise UnavailableError(str(error)) from error
