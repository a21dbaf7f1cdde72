"""What vermin, ruff and a compiler cannot say of the modules and z_touch.

`make lint` holds them to the syntax and the library that Python 2.7 and 3 have
in common, as printers in the field run klippy on either.
"""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MODULES = sorted(ROOT.glob("*.py"))
SHARED = sorted(ROOT.glob("z_touch/*.py"))
SOURCES = [*MODULES, *SHARED]

# Of the standard library, what is in Python 2.7 and 3 under the same name
IMPORTABLE = {
    "__future__",
    "collections",
    "contextlib",
    "errno",
    "fcntl",
    "functools",
    "glob",
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
OF_ONE_FILE = {"probe_host.py": {"importlib"}}
# Where the modules find what they share, and where its files find each other
OF_MODULES = {".z_touch", "..extras.z_touch"}
OF_SHARED = {".", *(f".{path.stem}" for path in SHARED)}

# Kalico greps for the first and calls what it takes for a function; the second
# switches the host's check for pins used twice off; the third marked copies.
FORBIDDEN = ("register_components", "allow_multi_use_pin", "# --- shared")

LINES = {
    "z_calibration.py": 1400,
    "auto_z_offset.py": 1100,
    "dockable_probe.py": 900,
    "extra_probe.py": 500,
}
LINES_OF_A_SHARED_FILE = 400
# 1200 for z_calibration and auto_z_offset, 100 for the dialogs of extra_probe,
# 600 for a probe on every host and the ways around its dock, 300 for what a
# result is worth and how many touches it takes, 1000 for the history, what it
# says and its picture, 400 for writing it, and the places of z_calibration, 400
# for whole cycles, 300 for corrections and what SAVE_CONFIG cannot write, 1250 for
# Z_CALIBRATION_SETUP
LINES_OF_ALL_SHARED = 5550
LINES_OF_A_FUNCTION = 40
METHODS = 30
ATTRIBUTES = 12

sources = pytest.mark.parametrize("path", SOURCES, ids=lambda path: path.name)


def line_count(path):
    return len(path.read_text().splitlines())


def nodes(path, *kinds):
    found = ast.walk(ast.parse(path.read_text()))
    return [node for node in found if isinstance(node, kinds)]


def test_there_are_sources():
    assert MODULES and SHARED


@sources
def test_only_plain_characters_and_no_word_that_hosts_take_amiss(path):
    text = path.read_bytes().decode("ascii")
    assert [word for word in FORBIDDEN if word in text] == []


@sources
def test_imports_are_of_the_library_or_of_what_is_shared(path):
    names = {a.name for node in nodes(path, ast.Import) for a in node.names}
    names |= {
        "." * node.level + (node.module or "")
        for node in nodes(path, ast.ImportFrom)
    }
    allowed = OF_SHARED if path in SHARED else OF_MODULES
    allowed = allowed | OF_ONE_FILE.get(path.name, set())
    assert names - IMPORTABLE - allowed == set()
    assert "__import__" not in path.read_text()


@sources
def test_classes_have_a_base(path):
    """Without one, Python 2.7 makes a class of another kind."""
    assert [n.name for n in nodes(path, ast.ClassDef) if not n.bases] == []


@sources
def test_functions_are_short(path):
    functions = nodes(path, ast.FunctionDef)
    lengths = [(n.end_lineno - n.lineno + 1, n.name) for n in functions]
    assert [pair for pair in lengths if pair[0] > LINES_OF_A_FUNCTION] == []


@sources
def test_classes_are_small(path):
    for node in nodes(path, ast.ClassDef):
        methods = [n for n in node.body if isinstance(n, ast.FunctionDef)]
        attributes = {
            n.attr
            for n in ast.walk(node)
            if isinstance(n, ast.Attribute)
            and isinstance(n.ctx, ast.Store)
            and isinstance(n.value, ast.Name)
            and n.value.id == "self"
        }
        assert len(methods) <= METHODS, node.name
        assert len(attributes) <= ATTRIBUTES, (node.name, attributes)


@sources
def test_files_are_short(path):
    limit = LINES.get(path.name, LINES_OF_A_SHARED_FILE)
    assert line_count(path) <= limit


def test_what_is_shared_is_short():
    assert sum(map(line_count, SHARED)) <= LINES_OF_ALL_SHARED


def test_version_is_that_of_the_changelog():
    """The newest release; each module asks z_touch whether it is of the same."""
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    newest = re.search(r"(?m)^## \[(\d+\.\d+\.\d+)\] - \d{4}-\d\d-\d\d$", text)
    assert newest
    for path in (*MODULES, ROOT / "z_touch" / "__init__.py"):
        line = f'__version__ = "{newest[1]}"\n'
        assert line in path.read_text(encoding="utf-8"), path


def python2():
    """A Python 2.7, or a skipped test."""
    found = sorted(Path.home().glob(".pyenv/versions/2.7*/bin/python2.7"))
    # A version manager's own may only say that it is not installed
    for python in (*found, shutil.which("python2.7")):
        if python and not subprocess.run([python, "-c", ""]).returncode:
            return python
    pytest.skip("no Python 2.7 on the PATH or in ~/.pyenv/versions")


@pytest.mark.parametrize("name", [path.stem for path in MODULES])
def test_module_imports_on_python2(name, tmp_path):
    """As klippy does, of a package."""
    (tmp_path / "extras").mkdir()
    (tmp_path / "extras" / "__init__.py").touch()
    for path in (*MODULES, ROOT / "z_touch"):
        (tmp_path / "extras" / path.name).symlink_to(path)
    command = [
        python2(),
        "-B",
        "-c",
        f"import extras.{name} as m; assert m.host",
    ]
    subprocess.run(command, cwd=tmp_path, check=True)
