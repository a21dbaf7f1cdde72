"""A folder z_touch that is missing, broken or another one; and an update of it."""

from __future__ import annotations

import ast
import re
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from simprinter import Machine
from simprinter.hosts.hosts import Host
from simprinter.hosts.session import LiveSession
from simprinter.hosts.trees import FOLDER_PARENT, link_tree
from tests.docs.sources import files, imported
from tools.kit.printer import (
    FOLDER,
    MODULES,
    ROOT,
    dialect_of,
    module_files,
)
from tools.kit.scenes import SCENES, Sections

# Homes Z with its probe, which is a switch: two of the modules can be used
SCENE = SCENES["separate_pin"]
AUTO = {"auto_z_offset": {"pin": "^PC9", "prepare_gcode": ""}}
ONLY_AUTO = {**AUTO, "z_calibration": None}


class Home:
    """A host, and what its owner has put into it."""

    def __init__(self, host: Host, folder: Path):
        self.host = host
        self.folder = folder
        self.tree = folder / "tree"
        link_tree(host.install({}).cwd, self.tree)
        self.rooms = self.tree / FOLDER_PARENT / FOLDER
        (folder / "data").mkdir()

    def clone(self, name: str) -> Path:
        """A clone of this repository, as far as klippy reads it."""
        clone = self.folder / name
        clone.mkdir()
        for file in module_files().values():
            copy(file, clone / file.name)
        return clone

    def door(self, name: str) -> Path:
        """Where a module belongs."""
        return self.tree / self.host.layout.module_dir / f"{name}.py"

    def link(self, clone: Path, *names: str) -> None:
        """What install.sh does; names: of modules, or of the folder."""
        for name in names or (*MODULES, FOLDER):
            place = self.rooms if name == FOLDER else self.door(name)
            place.unlink(missing_ok=True)
            place.symlink_to(clone / place.name)

    def copy(self, clone: Path) -> None:
        """What an owner does who makes no links."""
        for name in (*MODULES, FOLDER):
            place = self.rooms if name == FOLDER else self.door(name)
            copy(clone / place.name, place)

    def config(self, machine: Machine, changes: Sections) -> str:
        return SCENE.config(machine.serials, changes)

    @contextmanager
    def service(self, changes: Sections) -> Iterator[LiveSession]:
        """Klippy in a new process, with a printer.cfg."""
        with Machine(SCENE, dialect=dialect_of(self.host)) as machine:
            config = self.config(machine, changes)
            # Files that stay: one that starts, not a fork of one that has
            # loaded the modules before
            data = self.folder / "data"
            installed = self.host.at(self.tree)
            with LiveSession(installed, machine, config, data) as session:
                yield session


def copy(source: Path, target: Path) -> None:
    if source.is_dir():
        shutil.rmtree(target, ignore_errors=True)
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(source, target, ignore=ignored)
    else:
        # Of the host's own, the file may be shared with other trees
        target.unlink(missing_ok=True)
        shutil.copyfile(source, target)


def entered(name: str) -> set[Path]:
    """The files behind a module that its door imports itself."""
    door = ROOT / f"{name}.py"
    return {
        path
        for node in ast.walk(files(name)[door])
        if isinstance(node, ast.ImportFrom) and node.level
        for path in imported(door, node)
        if path.exists()
    }


def of_both() -> Path:
    """A file below the folder that auto_z_offset and z_calibration need."""
    shared = files("auto_z_offset").keys() & files("z_calibration").keys()
    found = shared - entered("z_calibration")
    # A package is one without that, too
    needed = (path for path in found if path.name != "__init__.py")
    return min(needed).relative_to(ROOT / FOLDER)


def append(file: Path, text: str = "\n# Of an update\n") -> None:
    file.write_text(file.read_text() + text)


@pytest.fixture
def home(host, tmp_path):
    return Home(host, tmp_path)


# A folder that cannot be used


def without_its_face(folder):
    (folder / "__init__.py").unlink()


def without_rooms(folder):
    for room in folder.iterdir():
        if room.is_dir():
            shutil.rmtree(room)


def without_a_file(folder):
    (folder / of_both()).unlink()


def without_a_room(folder):
    shutil.rmtree(folder / "auto_z_offset")


def empty(folder):
    (folder / "__init__.py").write_text("")


def cut_off(folder):
    (folder / of_both()).write_text("def fail(\n")


MISSING = (
    "the folder z_touch that belongs to this module is not in klippy/extras"
)
BROKEN = "the folder z_touch that belongs to this module cannot be loaded ("
NO_VERSION = BROKEN + "cannot import name 'why_apart'"
NO_MODULE = BROKEN + "No module named"
# What is broken, and what is told of it
DAMAGES = {
    # Kalico stumbles over a package without one by itself
    "no __init__.py": (without_its_face, BROKEN),
    "empty __init__.py": (empty, NO_VERSION),
    "no rooms": (without_rooms, NO_MODULE),
    "no file": (without_a_file, BROKEN),
    "no room": (without_a_room, NO_MODULE),
    "half a file": (cut_off, BROKEN),
}


@pytest.mark.every_host("each host has packages of other names")
def test_module_without_its_folder_is_refused(home):
    """Each host has packages of other names."""
    refused(home, shutil.rmtree, MISSING)


@pytest.mark.parametrize(("damage", "told"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_damaged_is_told_as_what_it_is(home, damage, told):
    refused(home, damage, told)


def refused(home, damage, told):
    """Klippy does not start with a damaged folder, and says so."""
    home.copy(home.clone("clone"))
    damage(home.rooms)
    with home.service(ONLY_AUTO) as session:
        state, message = session.start()
        log = session.log()
    assert state == "error"
    assert message.startswith("Section 'auto_z_offset': " + told)
    assert (
        "; run install.sh again, or copy all of z_touch to klippy/extras, then"
        " restart the Klipper service"
    ) in message
    # Of the traceback of an import, which klippy itself does not log
    assert "in <module>" in log.partition("z_touch: ")[2]


def test_folder_of_another_version_is_refused(home):
    home.copy(home.clone("clone"))
    face = home.rooms / "__init__.py"
    text = re.sub(
        "(?m)^__version__.*", '__version__ = "0.0.1"', face.read_text()
    )
    face.write_text(text)
    with home.service(ONLY_AUTO) as session:
        state, message = session.start()
    assert state == "error"
    assert message.startswith(
        "Section 'auto_z_offset': this module is of version 1.0.0, the folder"
        " z_touch in klippy/extras of version 0.0.1; run install.sh again, or"
        " copy both from one place, then restart the Klipper service (RESTART is"
        " not enough)"
    )


def test_what_is_loaded_goes_on_after_an_update(home):
    clone = home.clone("clone")
    home.link(clone)
    with home.service(AUTO) as session:
        session.require_ready()
        for file in clone.rglob("*.py"):
            append(file, "\nraise SystemError('of an update')\n")
        session.restart("RESTART")
        session.run("G28\nCALIBRATE_Z")


def test_module_and_folder_of_two_clones_are_refused(home):
    clones = [home.clone(name) for name in ("first", "second")]
    home.link(clones[0])
    home.link(clones[1], FOLDER)
    with home.service(AUTO) as session:
        state, message = session.start()
        assert state == "error"
        assert (
            f"this module is a link to {clones[0]}, the folder z_touch in"
            f" klippy/extras one to {clones[1]}; run install.sh of the one that"
            " you want, then restart the Klipper service"
        ) in message
    home.link(clones[1])
    with home.service(AUTO) as session:
        session.require_ready()
