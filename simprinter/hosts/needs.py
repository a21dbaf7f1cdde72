"""What a machine needs before anything is downloaded: gcc and a package index.

Both would be missed minutes later otherwise, after half of the packages, and
with a page of a compiler's or of pip's own words.
"""

from __future__ import annotations

import importlib.util
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping

# How long the index may take before it is said what is being waited for (s),
# and before it counts as away: a name server that is away needs some seconds.
PATIENCE = 1.0
LIMIT = 20.0


def missing_compiler() -> str:
    """Why klippy's C helper cannot be compiled here, or ""."""
    if shutil.which("gcc") is not None:
        return ""
    return (
        "the C helper of klippy needs gcc: install gcc and the headers of the C"
        " library (Debian: apt install gcc libc6-dev)"
    )


def missing_index(pins: Path, env: Mapping[str, str]) -> str:
    """Why the requirements in `pins` cannot be downloaded here, or ""."""
    pip = _pip()
    if pip is None:
        return ""
    package = _first_package(pins)
    if _is_given(package, pip, env):
        return ""
    return (
        f"the package index does not give {package}, so nothing was"
        " downloaded: check the network and `pip config list`, which names"
        " the index that pip asks, then run this again"
    )


def _pip() -> list[str] | None:
    """A pip that is there before there is any environment of ours.

    Debian leaves out that of Python itself, but has the one for environments,
    and a wheel of pip can be run as it is.
    """
    if importlib.util.find_spec("pip"):
        return [sys.executable, "-m", "pip"]
    folders = [sysconfig.get_config_var("WHEEL_PKG_DIR")]
    bundled = importlib.util.find_spec("ensurepip")
    if bundled is not None and bundled.origin:
        folders.append(str(Path(bundled.origin).with_name("_bundled")))
    for folder in filter(None, folders):
        for wheel in sorted(Path(folder).glob("pip-*.whl")):
            return [sys.executable, str(wheel / "pip")]
    return None


def _first_package(pins: Path) -> str:
    """A package that is going to be wanted, whatever Python this is."""
    lines = pins.read_text(encoding="ascii").splitlines()
    wanted = [line for line in lines if "==" in line and ";" not in line]
    return wanted[0].split("==")[0].split("[")[0]


def _is_given(package: str, pip: list[str], env: Mapping[str, str]) -> bool:
    # pip itself knows proxies, mirrors, folders and credentials of this machine
    command = [*pip, "--disable-pip-version-check", "--no-input", "--no-color"]
    command += ["--retries=0", "--timeout=5", "index", "versions", package]
    process = subprocess.Popen(
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        encoding="utf-8",
        errors="replace",
        env=env,
    )
    with process:
        try:
            output, _ = process.communicate(timeout=PATIENCE)
        except subprocess.TimeoutExpired:
            sys.stderr.write("Waiting for the package index ...\n")
            try:
                output, _ = process.communicate(timeout=LIMIT)
            except subprocess.TimeoutExpired:
                process.kill()
                output = ""
    # A pip of before 2021 has no such command: the installation will tell
    return not process.returncode or "unknown command" in output
