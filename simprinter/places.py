"""Where things are kept: in a checkout beside it, else in a cache of the user."""

from __future__ import annotations

import os
from pathlib import Path

PACKAGE = Path(__file__).resolve().parent
# What an installation has not: there, nothing beside the package is ours
IS_CHECKOUT = (PACKAGE / "pyproject.toml").exists()
REPO_ROOT = PACKAGE.parent
# Which of them names the folder, for messages
VARIABLE = "BUILD_DIR" if IS_CHECKOUT else "SIMPRINTER_CACHE"


def build_root() -> Path:
    """The folder for all that is downloaded or compiled; it may be missing.

    In a checkout `build` beside this package, or what BUILD_DIR names, where a
    relative one is taken from there, wherever klippy is started. Of an
    installation `simprinter` in the user's folder of caches, or what
    SIMPRINTER_CACHE names.
    """
    named = os.environ.get(VARIABLE)
    if IS_CHECKOUT:
        return REPO_ROOT / (named or "build")
    if named:
        return Path(named).expanduser().absolute()
    caches = os.environ.get("XDG_CACHE_HOME")
    folder = Path(caches) if caches else Path.home() / ".cache"
    return folder / "simprinter"


def build_directory() -> Path:
    """Where compiled parts are kept."""
    return build_root() / "simprinter"
