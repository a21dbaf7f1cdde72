"""What vermin, ruff and a compiler cannot say of the doors and of z_touch.

`make lint` holds z_touch to Python 3.8, and the doors to what any Python can read.
"""

from __future__ import annotations

import ast
import re
from functools import lru_cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
DOORS = sorted(ROOT.glob("*.py"))
ROOMS = sorted(ROOT.glob("z_touch/**/*.py"))
SOURCES = [*DOORS, *ROOMS]

# Which room may import which, besides itself; a door goes into the room of its
# section.  What is missing here would turn the house into a heap.
ARROWS = {
    "z_calibration.py": {"core", "guide", "z_calibration"},
    "auto_z_offset.py": {"core", "auto_z_offset"},
    "dockable_probe.py": {"core", "dockable_probe"},
    "extra_probe.py": {"core", "extra_probe"},
    "core": set(),
    "uncertainty": {"core"},
    "history": {"core", "uncertainty"},
    "z_calibration": {"core", "uncertainty", "history"},
    "guide": {"core", "z_calibration"},
    "auto_z_offset": {"core"},
    "dockable_probe": {"core"},
    "extra_probe": {"core"},
}

# Of the standard library, what the modules use
IMPORTABLE = {
    "__future__",
    "collections",
    "contextlib",
    "errno",
    "fcntl",
    "functools",
    "glob",
    "hashlib",
    "io",
    "json",
    "logging",
    "math",
    "os",
    "re",
    "sys",
    "threading",
    "time",
}
# To find the host's own [probe], which ours is made of
OF_ONE_FILE = {"virtual_probe.py": {"importlib"}}
# What a door tells of a room that cannot be loaded
OF_DOORS = {"traceback"}

# Where it is known how hosts differ, and of what
OF_HOSTS = {
    # Objects, clocks, console, SAVE_CONFIG
    "core/host.py",
    # Axes, their motors
    "core/axes.py",
    # Moves of Z
    "core/motion.py",
    # The pins that stop a move
    "core/endstops.py",
    # What shifts Z between G-code and the motors
    "core/features.py",
    # The printer's probe
    "core/probing.py",
    # That Z was homed, set or turned off
    "core/frame.py",
    # A [dockable_probe] that is not ours
    "core/host_dock.py",
    # Motor drivers and their current
    "auto_z_offset/motors.py",
    # What probing wants to see of a probe
    "dockable_probe/virtual_probe.py",
}
# It has a method that Kalico calls, and asks nothing.
CALLED_BY_HOSTS = {"dockable_probe/module.py"}
# Date and commit of a change of the host
CHANGE = re.compile(r"# .*\b20\d\d-\d\d(-\d\d)? \([0-9a-f]{9}\)")

# Kalico greps for the first and calls what it takes for a function; the second
# switches the host's check for pins used twice off; the third marked copies.
FORBIDDEN = ("register_components", "allow_multi_use_pin", "# --- shared")

# Letters of what is a sentence, no name
A_SENTENCE = 30


sources = pytest.mark.parametrize(
    "path", SOURCES, ids=lambda path: str(path.relative_to(ROOT))
)


@lru_cache(maxsize=None)
def every_node(path):
    return list(ast.walk(ast.parse(path.read_text())))


def nodes(path, *kinds):
    return [node for node in every_node(path) if isinstance(node, kinds)]


def test_there_are_sources():
    assert len(DOORS) == 4 and len(ROOMS) > len(ARROWS)


@sources
def test_only_plain_characters_and_no_word_that_hosts_take_amiss(path):
    text = path.read_bytes().decode("ascii")
    assert [word for word in FORBIDDEN if word in text] == []


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


@sources
def test_only_the_library_is_imported(path):
    names = absolute_imports(path)
    allowed = IMPORTABLE | OF_ONE_FILE.get(path.name, set())
    if path in DOORS:
        allowed |= OF_DOORS
    assert names - allowed == set()
    assert "__import__" not in path.read_text()


@sources
def test_rooms_lead_only_where_the_plan_of_the_house_says(path):
    """Imports in a `try` or inside a function included."""
    room = room_of(path)
    allowed = ARROWS.get(room, set()) | {room}
    assert set(rooms_imported(path)) - allowed == set()


# Objects of a room that others in it fill in: the progress of a set-up, a page that
# is drawn, a thread of the library.
FILLED_IN = {
    "guide": {"state", "self.state", "state.probe"},
    "history": {"page", "self.page", "thread"},
    # Wraps a command, so that its parameters are numbers
    "auto_z_offset": {"gcmd"},
    # The progress of a set-up; the host's probe and its session, as hosts do
    "dockable_probe": {"state", "self.state", "self.probe", "self.facade"},
}


def changed_from_outside(text, allowed=frozenset()):
    """Attributes that are set, or deleted, on another object than self."""
    for node in ast.walk(ast.parse(text)):
        is_set = isinstance(node, ast.Attribute) and isinstance(
            node.ctx, (ast.Store, ast.Del)
        )
        if is_set and ast.unparse(node.value) not in {"self", *allowed}:
            yield ast.unparse(node)


@sources
def test_an_object_is_changed_by_itself_only(path):
    allowed = FILLED_IN.get(room_of(path), ())
    assert list(changed_from_outside(path.read_text(), allowed)) == []


# Who has z_calibration's interface instead of the object behind the section
INTERFACE = ROOT / "z_touch" / "z_calibration" / "interface.py"
CORRECTIONS = INTERFACE.with_name("corrections.py")
INTERFACE_USERS = [*sorted(ROOT.glob("z_touch/guide/*.py")), CORRECTIONS]
# What these may import of the room, besides functions and records
OF_THE_ROOM = {"settings", "sites", "switches"}
# Records, of which all may be read, and the adapter to the host
RECORDS = {"settings", "pin", "last", "host"}
# Public for all their underscores
OF_NAMED_TUPLES = {"_replace", "_asdict", "_fields"}
# Its classes, by the names that users have for them; of what else it makes, one dot
# further is their business.
OFFERING = {"section": "Interface", "first_touches": "FirstTouches"}
MADE = {*OFFERING, "finder"}


def public_names(path, name):
    """The methods and attributes of a class that others may use."""
    (node,) = (n for n in nodes(path, ast.ClassDef) if n.name == name)
    methods = {n.name for n in node.body if isinstance(n, ast.FunctionDef)}
    attributes = {
        n.attr
        for n in ast.walk(node)
        if isinstance(n, ast.Attribute)
        and isinstance(n.ctx, ast.Store)
        and ast.unparse(n.value) == "self"
    }
    return {n for n in methods | attributes if not n.startswith("_")}


def chain_of(node):
    """a.b().c -> [a, b, c], where self.a counts as a; empty: no name at all."""
    names = []
    while isinstance(node, (ast.Attribute, ast.Call)):
        if isinstance(node, ast.Attribute):
            names.insert(0, node.attr)
            node = node.value
        else:
            node = node.func
    if not isinstance(node, ast.Name):
        return []
    return names if node.id == "self" else [node.id, *names]


def reached_into(text):
    """Where a user of the interface goes further than that."""
    offered = {
        name: public_names(INTERFACE, kind) for name, kind in OFFERING.items()
    }
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.ImportFrom) and node.level:
            inside = (node.module or "").rpartition("z_calibration")
            if inside[1] and inside[2].strip(".") not in OF_THE_ROOM:
                yield ast.unparse(node)
        if not isinstance(node, ast.Attribute):
            continue
        chain = chain_of(node)
        head, *rest = chain or [""]
        hidden = {name for name in rest if name.startswith("_")}
        if hidden - OF_NAMED_TUPLES:
            yield ast.unparse(node)
        for name, asked in zip(chain, chain[1:]):
            if name in offered and asked not in offered[name]:
                yield ast.unparse(node)
        if head not in MADE or not rest:
            continue
        first = rest.pop(0) if head == "section" else head
        if first not in RECORDS and len(rest) > 1:
            yield ast.unparse(node)


@pytest.mark.parametrize("path", INTERFACE_USERS, ids=lambda path: path.name)
def test_a_room_reaches_into_no_other(path):
    assert list(reached_into(path.read_text())) == []


REACHES = (
    "from ..z_calibration.module import ZCalibration",
    "from ..z_calibration import module",
    "self.section._section.settings",
    "section.results.last",
    "self.section.runner.watch.phase",
    "self.section.first_touches(a, b, c).calibration",
    "self.head.first_touches(state).plan",
    "first_touches.lift().now",
    "self.section.site_finder().host.toolhead",
)
CHANGES = (
    "self.module.settings = settings",
    "section.settings().speed = 1",
    "calibration.travel_z += 1",
    "del self.section.host",
    "run.clean, x = clean, 1",
)


def test_reaching_into_another_room_is_found():
    assert INTERFACE_USERS[:-1]
    for text in REACHES:
        assert list(reached_into(text)), text
    for text in CHANGES:
        assert list(changed_from_outside(text)), text


def test_interface_shows_nothing_of_the_object_behind_it():
    """Methods, and the host, which everybody has; a room is handed only that."""
    shown = set().union(
        *(public_names(INTERFACE, k) for k in OFFERING.values())
    )
    methods = {n.name for n in nodes(INTERFACE, ast.FunctionDef)}
    assert shown - methods == {"host"}
    used = {n.attr for p in INTERFACE_USERS for n in nodes(p, ast.Attribute)}
    assert shown - used == set()
    made = [
        ast.unparse(node)
        for path in (
            ROOT / "z_calibration.py",
            INTERFACE.with_name("module.py"),
        )
        for node in nodes(path, ast.Call)
        if ast.unparse(node.func) in ("dialog.Setup", "corrections.Corrections")
    ]
    assert made == [
        "dialog.Setup(calibration.interface)",
        "corrections.Corrections(self.interface)",
    ]


@sources
def test_nothing_is_imported_when_it_is_needed(path):
    """What is loaded later may be of another update."""
    late = [
        node.lineno
        for function in nodes(path, ast.FunctionDef)
        for node in ast.walk(function)
        if isinstance(node, (ast.Import, ast.ImportFrom))
    ]
    assert late == []


@sources
def test_each_class_says_what_it_is(path):
    lines = path.read_text(encoding="utf-8").splitlines()
    silent = [
        node.name
        for node in nodes(path, ast.ClassDef)
        if not lines[first_line(node) - 2].lstrip().startswith("#")
    ]
    assert silent == []


def first_line(node):
    return min([node.lineno, *(d.lineno for d in node.decorator_list)])


def in_z_touch(path):
    """As the document of developers names it, without the folder."""
    return path.relative_to(ROOT / "z_touch").as_posix()


@pytest.mark.parametrize("path", ROOMS, ids=in_z_touch)
def test_only_some_files_know_how_hosts_differ(path):
    if in_z_touch(path) in OF_HOSTS:
        return
    asked = [
        node.lineno
        for node in nodes(path, ast.Call)
        if isinstance(node.func, ast.Name)
        # getattr() with a default asks, too
        and (node.func.id, len(node.args)) in (("hasattr", 2), ("getattr", 3))
    ]
    assert asked == []
    if in_z_touch(path) not in CALLED_BY_HOSTS:
        assert not CHANGE.search(path.read_text())


def test_each_sentence_stands_in_one_place():
    """Not in the doors: each says by itself that z_touch is not there."""
    places: dict[str, list[str]] = {}
    for path in ROOMS:
        for node in nodes(path, ast.Constant):
            if isinstance(node.value, str) and len(node.value) >= A_SENTENCE:
                where = f"{in_z_touch(path)}:{node.lineno}"
                places.setdefault(node.value, []).append(where)
    assert len(places) > 500
    assert {s: where for s, where in places.items() if where[1:]} == {}


def test_version_is_that_of_the_changelog():
    """The newest release; each module asks z_touch whether it is of the same."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.search(r"(?m)^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", text)
    assert newest
    for path in (*DOORS, ROOT / "z_touch" / "__init__.py"):
        line = f'__version__ = "{newest[1]}"\n'
        assert line in path.read_text(encoding="utf-8"), path
