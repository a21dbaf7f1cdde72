"""What is loaded is what is there: a folder z_touch that is missing, broken,
another one, or changed since Klipper has loaded it.
"""

from __future__ import annotations

import ast
import os
import shutil
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from simprinter import Machine
from simprinter.hosts.environment import REPO_ROOT
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
    return min(shared - entered("z_calibration")).relative_to(ROOT / FOLDER)


def of_one(name: str) -> Path:
    """One that only this module needs, as soon as it is loaded."""
    others = [files(other).keys() for other in MODULES if other != name]
    own = entered(name).difference(*others)
    return min(own).relative_to(ROOT / FOLDER)


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
NO_VERSION = BROKEN + "cannot import name '__version__'"
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
    (home.rooms / "__init__.py").write_text('__version__ = "0.0.1"\n')
    with home.service(ONLY_AUTO) as session:
        state, message = session.start()
    assert state == "error"
    assert message.startswith(
        "Section 'auto_z_offset': this module is of version 1.0.0, the folder"
        " z_touch in klippy/extras of version 0.0.1; run install.sh again, or"
        " copy both from one place, then restart the Klipper service (RESTART is"
        " not enough)"
    )


# A folder that has changed since it was loaded

CHANGED = (
    "the folder z_touch was changed, as by an update, after Klipper had loaded"
    " it; restart the Klipper service (RESTART is not enough)"
)


def comment(clone):
    """What nobody would notice, here; the next one may be another."""
    append(clone / FOLDER / of_both())


def new_name(clone):
    """A room of the new commit needs what core of the old one has not."""
    shared, own = of_both(), of_one("z_calibration")
    append(clone / FOLDER / shared, "\nNEW = 1\n")
    package = "." * len(own.parts) + ".".join(shared.parts[:-1])
    needs = f"\nfrom {package} import {shared.stem}\n\n{shared.stem}.NEW\n"
    append(clone / FOLDER / own, needs)


UPDATES = {f.__name__: f for f in (comment, new_name)}


@pytest.mark.slow
@pytest.mark.every_host(
    "Kalico of 2023-11 to 2026-01 runs a plugin again at each RESTART"
)
@pytest.mark.parametrize("update", UPDATES.values(), ids=UPDATES)
def test_section_added_after_an_update_needs_the_service(home, update):
    clone = home.clone("clone")
    home.link(clone)
    with home.service(ONLY_AUTO) as session:
        session.require_ready()
        update(clone)
        config = home.config(session.machine, AUTO)
        state, message = session.reload(config, "RESTART")
        assert state == "error"
        assert message.startswith(f"Section 'z_calibration': {CHANGED}")
        # And not the second time either
        assert session.reload(config, "RESTART") == (state, message)
    with home.service(AUTO) as session:
        session.require_ready()
        session.run("G28\nCALIBRATE_Z")


# auto_z_offset and z_calibration of it have the version that they have today
FLAT = "78f40567881e1f6a9f0e01a47a00c984e7436ff2"


def test_section_added_after_the_update_that_brings_the_rooms(home):
    """From files that are gone, by which no door of today was loaded."""
    newest = home.clone("newest")
    clone = home.folder / "clone"
    clone.mkdir()
    check_out(FLAT, clone)
    home.link(clone, "auto_z_offset", "z_calibration", FOLDER)
    with home.service(ONLY_AUTO) as session:
        session.require_ready()
        shutil.rmtree(clone)
        newest.rename(clone)
        config = home.config(session.machine, AUTO)
        state, message = session.reload(config, "RESTART")
        assert state == "error"
        assert message.startswith(f"Section 'z_calibration': {CHANGED}")


def check_out(commit, folder):
    """The modules of a commit of this repository, where it has its history."""
    git = ["git", "-c", "safe.directory=*", "-C", str(REPO_ROOT)]
    names = ["auto_z_offset.py", "z_calibration.py", FOLDER]
    done = subprocess.run(
        [*git, "archive", commit, *names], capture_output=True, check=False
    )
    if done.returncode:
        pytest.skip(f"NOT TESTED: no commit {commit[:7]} in this clone")
    subprocess.run(["tar", "-xC", folder], input=done.stdout, check=True)


def touched(clone):
    """The same files written again: to another branch and back."""
    for file in clone.rglob("*.py"):
        os.utime(file, (1e9, 1e9))


def not_loaded(clone):
    """Of a room that nobody has entered."""
    append(clone / FOLDER / of_one("dockable_probe"))


def new_room(clone):
    """Of the room whose section is new."""
    append(clone / FOLDER / of_one("z_calibration"))


HARMLESS = {f.__name__: f for f in (touched, not_loaded, new_room)}


@pytest.mark.slow
@pytest.mark.parametrize("update", HARMLESS.values(), ids=HARMLESS)
def test_section_added_where_all_that_is_loaded_is_there(home, update):
    clone = home.clone("clone")
    home.link(clone)
    with home.service(ONLY_AUTO) as session:
        session.require_ready()
        update(clone)
        config = home.config(session.machine, AUTO)
        # As RESTART, but that boards take another configuration only so
        assert session.reload(config, "FIRMWARE_RESTART")[0] == "ready"
        session.run("G28\nCALIBRATE_Z")


def test_what_is_loaded_goes_on_after_an_update(home):
    clone = home.clone("clone")
    home.link(clone)
    with home.service(AUTO) as session:
        session.require_ready()
        for file in clone.rglob("*.py"):
            append(file, "\nraise SystemError('of an update')\n")
        session.restart("RESTART")
        session.run("G28\nCALIBRATE_Z")


def test_copies_by_hand_are_held_to_the_same(home):
    home.copy(home.clone("clone"))
    with home.service(ONLY_AUTO) as session:
        session.require_ready()
        newer = home.clone("newer")
        comment(newer)
        home.copy(newer)
        config = home.config(session.machine, AUTO)
        state, message = session.reload(config, "RESTART")
        assert (state, CHANGED in message) == ("error", True)
    with home.service(AUTO) as session:
        session.require_ready()


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
