"""What a door finds behind it, by Python alone: the oldest and the one here.

Each case is a new process that imports doors as klippy does, of packages that
have the names of one host or another. In tests/modules real klippies do.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOORS = sorted(ROOT.glob("*.py"))
NAMES = [path.stem for path in DOORS]
# Names of the packages: Klipper; klippy-l and Kalico; plugins of Kalico
EXTRAS, PACKAGED, PLUGINS = "extras", "klippy.extras", "klippy.plugins"

PRELUDE = """
from __future__ import print_function
import importlib, os, sys
def fault(name, package=sys.argv[1]):
    return importlib.import_module(package + "." + name).FAULT
"""


def python2() -> str:
    """A Python 2.7, or a skipped test."""
    found = sorted(Path.home().glob(".pyenv/versions/2.7*/bin/python2.7"))
    # A version manager's own may only say that it is not installed
    for python in (*found, shutil.which("python2.7")):
        if python and not subprocess.run([python, "-c", ""]).returncode:
            return str(python)
    pytest.skip("no Python 2.7 on the PATH or in ~/.pyenv/versions")


class House:
    """Doors and rooms, beside each other or as Kalico has them."""

    def __init__(self, folder: Path, package: str, python: str):
        self.top, self.package, self.python = folder, package, python
        self.doors = folder.joinpath(*package.split("."))
        self.rooms = self.doors.parent / "extras" / "z_touch"
        for parent in (self.doors, self.rooms.parent):
            parent.mkdir(parents=True, exist_ok=True)
            (parent / "__init__.py").touch()
        if self.doors.parent != folder:
            (self.doors.parent / "__init__.py").touch()
        for path in DOORS:
            shutil.copy(path, self.doors)
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / "z_touch", self.rooms, ignore=ignored)

    def run(self, script: str) -> list[str]:
        """The lines that Python prints."""
        command = [self.python, "-c", PRELUDE + script, self.package]
        done = subprocess.run(
            [*command, str(self.rooms), str(self.doors)],
            cwd=self.top,
            # With bytecode, as klippy has it
            env={**os.environ, "PYTHONDONTWRITEBYTECODE": ""},
            capture_output=True,
            encoding="utf-8",
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout.splitlines()

    def fault(self, name: str) -> str:
        """Why a door cannot be used, in a process of its own."""
        (line,) = self.run(f"print(fault({name!r}))")
        return line


# All that have packages need Python 3
@pytest.fixture(
    params=[
        ("python2", EXTRAS),
        ("python3", EXTRAS),
        ("python3", PACKAGED),
        ("python3", PLUGINS),
    ],
    ids=" ".join,
)
def house(request, tmp_path):
    version, package = request.param
    python = python2() if version == "python2" else sys.executable
    return House(tmp_path / "host", package, python)


def test_whole_house_is_used(house):
    script = "".join(f"print(fault({name!r}))\n" for name in NAMES)
    assert house.run(script) == [""] * len(NAMES)


def unreadable(rooms):
    (rooms / "core" / "errors.py").write_bytes(b"a = 1\n\0\0\0\0")


def cut_off(rooms):
    (rooms / "core" / "errors.py").write_text("def fail(\n")


def mistaken(rooms):
    (rooms / "core" / "errors.py").write_text("fail = undefined\n")


MISSING = r"is not in klippy/extras"
BROKEN = r"cannot be loaded \(.+\)"
DAMAGES = {
    "missing": (shutil.rmtree, MISSING),
    "no core": (lambda rooms: shutil.rmtree(rooms / "core"), BROKEN),
    "no room": (lambda rooms: shutil.rmtree(rooms / "guide"), BROKEN),
    "no file": (lambda rooms: (rooms / "core/errors.py").unlink(), BROKEN),
    "no copies": (lambda rooms: (rooms / "core/copies.py").unlink(), BROKEN),
    "empty face": (
        lambda rooms: (rooms / "__init__.py").write_text(""),
        BROKEN,
    ),
    "unreadable": (unreadable, BROKEN),
    "cut off": (cut_off, BROKEN),
    "mistaken": (mistaken, BROKEN),
}


@pytest.mark.parametrize(("damage", "what"), DAMAGES.values(), ids=DAMAGES)
def test_what_is_broken_is_told_as_what_it_is(house, damage, what):
    damage(house.rooms)
    assert re.fullmatch(
        f"the folder z_touch that belongs to this module {what}; run install.sh"
        " again, or copy all of z_touch to klippy/extras, then restart the"
        " Klipper service",
        house.fault("z_calibration"),
    )


def test_folder_without_a_face_is_incomplete(house):
    """To Python 3 it is a package all the same, to Python 2 there is none."""
    (house.rooms / "__init__.py").unlink()
    what = MISSING if house.python != sys.executable else BROKEN
    assert re.search(what, house.fault("z_calibration"))


CHANGED = "the folder z_touch was changed, as by an update, after Klipper"
ERRORS = 'os.path.join(sys.argv[2], "core", "errors.py")'
MODULE = 'os.path.join(sys.argv[2], "extra_probe", "module.py")'


@pytest.mark.parametrize(
    ("update", "is_refused"),
    [
        (f"open({ERRORS}, 'a').write('# new')", True),
        (
            f"open({ERRORS}, 'a').write('NEW = 1')\n"
            f"open({MODULE}, 'a').write('from ..core.errors import NEW')",
            True,
        ),
        (f"os.remove({ERRORS})", True),
        (f"os.utime({ERRORS}, (1e9, 1e9))", False),
        (f"open({ERRORS} + '~.py', 'w').write('')", False),
    ],
    ids=["changed", "a new name", "gone", "written again", "a new file"],
)
def test_what_was_loaded_before_is_what_is_there(house, update, is_refused):
    # Once before, so that Python 2 loads bytecode and names it
    house.fault("auto_z_offset")
    first, second = house.run(
        f"print(fault('auto_z_offset'))\n{update}\nprint(fault('extra_probe'))"
    )
    assert first == ""
    assert second.startswith(CHANGED) if is_refused else second == ""


def test_release_whose_files_had_other_names_is_refused(house):
    """Loaded from a folder that was flat; nobody has noted its files."""
    old = house.rooms / "options.py"
    old.write_text("")
    (fault,) = house.run(
        f"""
extras = sys.argv[1].replace("plugins", "extras")
importlib.import_module(extras + ".z_touch.options")
os.remove({str(old)!r})
print(fault("extra_probe"))
"""
    )
    assert fault.startswith(CHANGED)


def test_what_came_in_after_an_update_is_not_forgotten(house):
    """The update is taken back, but its rooms have been loaded."""
    faults = house.run(
        f"""
print(fault("auto_z_offset"))
errors, module = open({ERRORS}).read(), open({MODULE}).read()
open({ERRORS}, "a").write("# new")
open({MODULE}, "a").write("# new")
print(fault("extra_probe"))
open({ERRORS}, "w").write(errors)
open({MODULE}, "w").write(module)
print(fault("dockable_probe"))
"""
    )
    assert [fault.startswith(CHANGED) for fault in faults] == [
        False,
        True,
        True,
    ]


def test_plugin_that_is_run_again_at_each_restart(tmp_path):
    """By Kalico of 2023-11-01 to 2026-01-01; in no table of loaded modules."""
    house = House(tmp_path, PACKAGED, sys.executable)
    script = f"""
import types
importlib.import_module(sys.argv[1])
def again(name):
    path = os.path.join(sys.argv[3], name + ".py")
    module = types.ModuleType(sys.argv[1] + "." + name)
    module.__file__, module.__package__ = path, sys.argv[1]
    exec(compile(open(path).read(), path, "exec"), module.__dict__)
    return module.FAULT
print(again("auto_z_offset"))
open({ERRORS}, "a").write("# new")
print(again("auto_z_offset"))
print(again("extra_probe"))
print(again("extra_probe"))
open(os.path.join(sys.argv[3], "auto_z_offset.py"), "a").write("# new")
print(again("auto_z_offset"))
"""
    faults = [fault.startswith(CHANGED) for fault in house.run(script)]
    assert faults == [False, False, True, True, True]


def test_links_into_two_clones_are_refused(house, tmp_path):
    clones = [tmp_path / "first", tmp_path / "second"]
    for clone in clones:
        clone.mkdir()
        shutil.copy(house.doors / "extra_probe.py", clone)
        shutil.copytree(house.rooms, clone / "z_touch")
    door = house.doors / "extra_probe.py"
    for target, place in (
        (clones[0] / door.name, door),
        (clones[1], house.rooms),
    ):
        if place.is_dir():
            shutil.rmtree(place)
            target = target / "z_touch"
        else:
            place.unlink()
        place.symlink_to(target)
    assert house.fault("extra_probe").startswith(
        f"this module is a link to {clones[0]}, the folder z_touch in"
        f" klippy/extras one to {clones[1]}; run install.sh of the one that you"
        " want, then restart the Klipper service (RESTART is not enough)"
    )
    house.rooms.unlink()
    house.rooms.symlink_to(clones[0] / "z_touch")
    assert house.fault("extra_probe") == ""


def test_another_version_is_refused(house):
    (house.rooms / "__init__.py").write_text('__version__ = "0.9.0"\n')
    fault = house.fault("extra_probe")
    assert " of version 0.9.0; run install.sh again" in fault


def test_doors_differ_in_their_rooms_only():
    """Four times the same lines, as none of them may be needed by another."""
    shared = set()
    for path in DOORS:
        text = path.read_text(encoding="utf-8")
        machinery = text.partition("import logging\n")[2]
        machinery = machinery.partition("\ndef load_config")[0]
        room = r"(?m)^ +from \.[.a-z]*z_touch\.(?!core)\w+ import \w+\n"
        assert len(re.findall(room, machinery)) >= 2
        shared.add(re.sub(room, "", machinery))
    assert len(shared) == 1
