"""docs/klippy.csv: every attribute, method and event of klippy that z_touch touches.

    build/venv/bin/python -m tests.docs.klippy

writes its last column anew, the files that use a name; all others are written by hand.
`need`: empty where each host has the name; words where it is one of several that offer the
same, of which each host has one; `if there` where nothing is missing without it.
"""

from __future__ import annotations

import ast
import csv
import io
import re
from collections.abc import Collection, Iterator
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from tests.docs.sources import ROOT

DOCUMENT = ROOT / "docs" / "klippy.csv"
FOLDER = ROOT / "z_touch"
OPTIONAL = "if there"
EVENT = "event"
# More files than that are no help to a reader
MOST_FILES = 4


class Row(NamedTuple):
    """One name of an object of klippy."""

    object: str
    name: str
    need: str
    hosts: str
    used_in: str


HEAD = Row("object", "name", "need", "hosts", "used in")


def rows() -> list[Row]:
    """The rows without their head."""
    text = DOCUMENT.read_text(encoding="utf-8")
    head, *found = csv.reader(io.StringIO(text))
    assert tuple(head) == HEAD
    return [Row(*row) for row in found]


def missing(
    table: Collection[Row], present: Collection[tuple[str, str]]
) -> list[str]:
    """What a host lacks that has these (object, name)."""
    there = [row for row in table if (row.object, row.name) in present]
    needs = {row.need for row in table} - {"", OPTIONAL}
    lacking = [
        f"{row.object}: {row.name}"
        for row in table
        if not row.need and row not in there
    ]
    return lacking + sorted(needs - {row.need for row in there})


@lru_cache(maxsize=None)
def sources() -> dict[Path, ast.Module]:
    """What runs in klippy, by its path below z_touch."""
    return {
        path.relative_to(FOLDER): ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(FOLDER.rglob("*.py"))
        if path.parent.name != "report" and path.name != "klippy.py"
    }


@lru_cache(maxsize=None)
def names_in(tree: ast.Module) -> set[str]:
    """Attributes that are read, and names in quotes, also several of them."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute):
            found.add(node.attr)
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            words = node.value.split()
            are_names = all("_" in word for word in words)
            found |= {node.value, *(words if are_names else ())}
    # A lock is used by "with"
    return found | {"__enter__", "__exit__"}


def used_in(row: Row) -> str:
    """The files that use it; the last one of several attributes counts."""
    word = row.name if row.object == EVENT else row.name.rpartition(".")[2]
    # G-code that gcode_move runs by its own method
    words = {word or row.object, word.replace("cmd_", "")}
    files = [
        path.as_posix()
        for path, tree in sources().items()
        if words & names_in(tree)
    ]
    return " ".join(files) if len(files) <= MOST_FILES else "many"


def generated() -> str:
    """The data file with its last column as the sources have it."""
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(HEAD)
    writer.writerows(row._replace(used_in=used_in(row)) for row in rows())
    return out.getvalue()


def looked_up() -> Iterator[str]:
    """The name of each object that z_touch looks up by a word."""
    methods = ("lookup_object", "lookup_objects", "load_object", "lookup")
    for tree in sources().values():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Call):
                continue
            if ast.unparse(node.func).rpartition(".")[2] in methods:
                for word in node.args:
                    if isinstance(word, ast.Constant) and word.value:
                        yield str(word.value)


def heard() -> Iterator[str]:
    """Each event that z_touch names."""
    pattern = "(klippy|toolhead|stepper_enable|homing|gcode|probe):[a-z_]+"
    for tree in sources().values():
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and re.fullmatch(
                pattern, str(node.value)
            ):
                yield str(node.value)


def asked() -> Iterator[str]:
    """Each attribute that host/ asks an object for by a word, as hosts differ."""
    for path, tree in sources().items():
        if path.parts[0] != "host":
            continue
        for node in ast.walk(tree):
            if isinstance(node, ast.Call) and ast.unparse(node.func) in (
                "getattr",
                "hasattr",
            ):
                word = node.args[1]
                if isinstance(word, ast.Constant):
                    yield str(word.value)


def typed() -> Iterator[str]:
    """Each name in the types of klippy's objects."""
    text = (FOLDER / "host" / "klippy.py").read_text(encoding="utf-8")
    for node in ast.parse(text).body:
        if isinstance(node, ast.ClassDef):
            for inner in node.body:
                if isinstance(inner, ast.FunctionDef):
                    yield inner.name
                if isinstance(inner, ast.AnnAssign):
                    yield ast.unparse(inner.target)


if __name__ == "__main__":
    DOCUMENT.write_text(generated(), encoding="utf-8")
