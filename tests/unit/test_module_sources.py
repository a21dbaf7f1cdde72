"""What vermin, ruff and a compiler cannot say of the doors and of z_touch.

`make lint` holds z_touch to Python 3.8, and the doors to what any Python can read.
"""

from __future__ import annotations

import ast
import re
import sys
from functools import lru_cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOORS = sorted(ROOT.glob("*.py"))
ROOMS = sorted(ROOT.glob("z_touch/**/*.py"))
SOURCES = [*DOORS, *ROOMS]

# Rooms lead to shared files and the host, never to another room, and what is shared
# leads to no room.
ROOM_NAMES = {
    "z_calibration",
    "auto_z_offset",
    "dockable_probe",
    "extra_probe",
    "report",
}
# The report draws what the calibration has kept
ALLOWED = {"report": {"z_calibration"}}

# Where it is known how hosts differ, besides z_touch/host
OF_HOSTS = {
    # Motor drivers and their current
    "auto_z_offset/motors.py",
    # Prepares nothing: it says what happened
    "datum.py",
}
# It has a method that Kalico calls, and asks nothing.
CALLED_BY_HOSTS = {"dockable_probe/module.py"}
# Date and commit of a change of the host
CHANGE = re.compile(r"# .*\b20\d\d-\d\d(-\d\d)? \([0-9a-f]{9}\)")

# Kalico greps for the first and calls what it takes for a function; the second
# switches the host's check for pins used twice off; the third marked copies.
FORBIDDEN = ("register_components", "allow_multi_use_pin", "# --- shared")


def files_with(find, paths=SOURCES):
    """What is found in each file, by its name, without those that have nothing."""
    found = {str(path.relative_to(ROOT)): find(path) for path in paths}
    return {name: list(what) for name, what in found.items() if what}


@lru_cache(maxsize=None)
def every_node(path):
    return list(ast.walk(ast.parse(path.read_text())))


def nodes(path, *kinds):
    return [node for node in every_node(path) if isinstance(node, kinds)]


def test_there_are_sources():
    assert len(DOORS) == 4 and len(ROOMS) > 50


def test_only_plain_characters_and_no_word_that_hosts_take_amiss():
    def forbidden(path):
        text = path.read_bytes().decode("ascii")
        return [word for word in FORBIDDEN if word in text]

    assert files_with(forbidden) == {}


def room_of(path):
    """The room that a file is in; a door is one of its own."""
    inside = path.relative_to(ROOT).parts
    return inside[1] if len(inside) > 2 else inside[-1]


def rooms_imported(path):
    """The rooms that the relative imports of a file lead to."""
    for node in nodes(path, ast.ImportFrom):
        if not node.level:
            continue
        parts = [part for part in (node.module or "").split(".") if part]
        if path in DOORS:
            # Of the folder itself comes its version
            yield from parts[parts.index("z_touch") + 1 :][:1]
        elif node.level == 1:
            yield room_of(path)
        elif parts:
            yield parts[0]


def absolute_imports(path):
    """The modules that a file names in full."""
    names = {a.name for node in nodes(path, ast.Import) for a in node.names}
    return names | {
        node.module for node in nodes(path, ast.ImportFrom) if not node.level
    }


def test_only_the_library_is_imported():
    library = getattr(sys, "stdlib_module_names", None)
    if library is None:
        pytest.skip("Python 3.9 does not say what is of its library")

    def others(path):
        names = {name.partition(".")[0] for name in absolute_imports(path)}
        # The report is run as a program, too
        own = {"z_touch"} if path.name == "__main__.py" else set()
        hidden = {"__import__"} & set(re.findall(r"\w+", path.read_text()))
        return (names - library - own) | hidden

    assert files_with(others) == {}


def test_rooms_lead_to_what_is_shared_only():
    """Imports in a `try` or inside a function included."""

    def other_rooms(path):
        room = room_of(path)
        others = ROOM_NAMES - {room} - ALLOWED.get(room, set())
        return set(rooms_imported(path)) & others

    assert files_with(other_rooms, ROOMS) == {}


def test_nothing_is_imported_when_it_is_needed():
    """What is loaded later may be of another update."""

    def late(path):
        return [
            node.lineno
            for function in nodes(path, ast.FunctionDef)
            for node in ast.walk(function)
            if isinstance(node, (ast.Import, ast.ImportFrom))
        ]

    assert files_with(late) == {}


def in_z_touch(path):
    """As the document of developers names it, without the folder."""
    return path.relative_to(ROOT / "z_touch").as_posix()


def outside(paths):
    """Those that are not in z_touch/host."""
    return [path for path in paths if not in_z_touch(path).startswith("host/")]


def test_only_some_files_know_how_hosts_differ():
    def known(path):
        asked = [
            node.lineno
            for node in nodes(path, ast.Call)
            if isinstance(node.func, ast.Name)
            # getattr() with a default asks, too
            and (node.func.id, len(node.args))
            in (("hasattr", 2), ("getattr", 3))
        ]
        if in_z_touch(path) not in CALLED_BY_HOSTS:
            asked += CHANGE.findall(path.read_text())
        return asked

    others = [path for path in ROOMS if in_z_touch(path) not in OF_HOSTS]
    assert files_with(known, outside(others)) == {}


def test_version_is_that_of_the_changelog():
    """The newest release; each module asks z_touch whether it is of the same."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.search(r"(?m)^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", text)
    assert newest
    for path in (*DOORS, ROOT / "z_touch" / "__init__.py"):
        line = f'__version__ = "{newest[1]}"\n'
        assert line in path.read_text(encoding="utf-8"), path


# Objects of our own that are not the one that sets their attribute
OWN = {
    "self",
    "self.run",
    "run",
    "place",
    "found",
    "self.found",
    "page",
}
WRITTEN_TO = {
    # All of these are of the room itself
    "dockable_probe": {
        "keeping",
        "self.height",
        "self.low_moves",
        "self.probe.homing",
        "self.probe.keeping",
        "self.section.low_moves",
        "self.underway",
    },
    "auto_z_offset": {"gcmd"},
}


def written_to(text):
    """Attributes that are set, or deleted, on objects that may be the host's."""
    for node in ast.walk(ast.parse(text)):
        is_set = isinstance(node, ast.Attribute) and isinstance(
            node.ctx, (ast.Store, ast.Del)
        )
        if is_set:
            yield ast.unparse(node.value)
        if isinstance(node, ast.Call) and ast.unparse(node.func) in (
            "setattr",
            "delattr",
        ):
            yield ast.unparse(node.args[0])


def test_nothing_of_the_host_is_written_to():
    """But in z_touch/host, where each such place says why there is no other way."""

    def written(path):
        allowed = OWN | WRITTEN_TO.get(room_of(path), set())
        return set(written_to(path.read_text())) - allowed

    assert files_with(written, outside(ROOMS)) == {}
