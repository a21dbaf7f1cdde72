"""What a door finds behind it, by Python alone: the oldest and the one here.

Each case is a new process that imports doors as klippy does, of packages that
have the names of one host or another. In tests/modules real klippies do.
"""

from __future__ import annotations

import ast
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


@pytest.fixture(params=[EXTRAS, PACKAGED, PLUGINS])
def house(request, tmp_path):
    return House(tmp_path / "host", request.param, sys.executable)


def test_old_python_is_told_in_one_sentence(tmp_path):
    house = House(tmp_path / "host", EXTRAS, python2())
    script = "".join(f"print(fault({name!r}))\n" for name in NAMES)
    assert house.run(script) == [
        "this module needs Python 3.8 or newer, and this Klipper runs on 2.7;"
        " install Klipper anew, as KIAUH does, on a system that has it"
    ] * len(NAMES)


@pytest.mark.parametrize("path", DOORS, ids=lambda path: path.stem)
def test_doors_stay_readable_for_an_old_python(path):
    """Also where there is none to try: what it does not know is in no door."""
    text = path.read_text(encoding="ascii")
    ast.parse(text, feature_version=(3, 4))
    assert not re.search(
        r"\bf[\"']|print\(|nonlocal|\bfrom __future__|\) ->", text
    )


def test_whole_house_is_used(house):
    script = "".join(f"print(fault({name!r}))\n" for name in NAMES)
    assert house.run(script) == [""] * len(NAMES)


def unreadable(rooms):
    (rooms / "errors.py").write_bytes(b"a = 1\n\0\0\0\0")


def cut_off(rooms):
    (rooms / "errors.py").write_text("def fail(\n")


def mistaken(rooms):
    (rooms / "errors.py").write_text("fail = undefined\n")


MISSING = r"is not in klippy/extras"
BROKEN = r"cannot be loaded \(.+\)"
DAMAGES = {
    "missing": (shutil.rmtree, MISSING),
    "no host": (lambda rooms: shutil.rmtree(rooms / "host"), BROKEN),
    "no room": (lambda rooms: shutil.rmtree(rooms / "z_calibration"), BROKEN),
    "no file": (lambda rooms: (rooms / "errors.py").unlink(), BROKEN),
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
    face = house.rooms / "__init__.py"
    face.write_text(
        re.sub(r"(?m)^__version__.*", '__version__ = "0.9.0"', face.read_text())
    )
    fault = house.fault("extra_probe")
    assert " of version 0.9.0; run install.sh again" in fault


def test_doors_differ_in_their_rooms_only():
    """Four times the same lines, as none of them may be needed by another."""
    shared = set()
    for path in DOORS:
        text = path.read_text(encoding="utf-8")
        machinery = text.partition("import logging\n")[2]
        machinery = machinery.partition("\ndef load_config")[0]
        room = r"(?m)^ +from \.[.a-z]*z_touch\.\w+ import \w+\n"
        assert len(re.findall(room, machinery)) >= 2
        shared.add(re.sub(room, "", machinery))
    assert len(shared) == 1
