"""docs/dockable_probe.md says what dockable_probe.py does."""

from __future__ import annotations

import ast
import re
from pathlib import Path

from tests.docs.dockable_probe_picture import PICTURE, draw
from tests.docs.documents import link_problems

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "dockable_probe.md"
MODULE = ROOT / "z_touch" / "dockable_probe" / "module.py"
TEXT = DOCUMENT.read_text(encoding="utf-8")
SOURCE = MODULE.read_text(encoding="utf-8")
SHARED = (ROOT / "z_touch" / "dockable_probe" / "virtual_probe.py").read_text(
    encoding="utf-8"
)
READERS = {
    "number",
    "pair",
    "get",
    "getint",
    "getfloat",
    "getboolean",
    "getchoice",
    "getfloatlist",
    "read_place",
    "read_old_place",
    "name_of",
    "read_old",
    "make_endstop",
}


def literals(source: str) -> set[str]:
    """Texts that are handed to something that reads an option."""
    found = set()
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = getattr(node.func, "attr", getattr(node.func, "id", ""))
        if name in READERS:
            found |= {
                arg.value
                for arg in node.args
                if isinstance(arg, ast.Constant) and isinstance(arg.value, str)
            }
    return found


def options() -> set[str]:
    """All options that the module reads."""
    found = {
        name
        for name in literals(SOURCE) | literals(SHARED)
        if re.fullmatch(r"[a-z]+(_[a-z]+)*", name)
    }
    templates = re.search(r'TEMPLATES = \(\s+"([^"]+)"\s+"([^"]+)"', SOURCE)
    names = " ".join(templates.groups()).split()
    found |= {f"{name}_gcode" for name in names}
    found |= {"probe_sense_pin", "dock_sense_pin"}
    # Of other sections, and a value
    return found - {"mesh_min", "mesh_max", "average"}


def commands() -> set[str]:
    """All commands that it registers."""
    return set(re.findall(r"cmd_([A-Z_]+)_help", SOURCE)) | {
        f"MOVE_TO_{part}_PROBE"
        for part in re.findall(r"cmd_MOVE_TO_([A-Z]+)_PROBE", SOURCE)
    }


def test_options_are_all_there():
    assert len(options()) > 35
    missing = {name for name in options() if f"`{name}`" not in TEXT}
    assert missing == set()


def test_no_option_that_does_not_exist():
    table = TEXT.split("## Which options are there?")[1].split("\n## ")[0]
    rows = re.findall(r"^\| `([a-z_]+)` \|", table, re.MULTILINE)
    assert len(rows) > 25
    assert set(rows) <= options()


def test_commands_are_all_there():
    assert len(commands()) == 12
    table = TEXT.split("## Which commands are there?")[1].split("\n## ")[0]
    told = set(re.findall(r"`([A-Z]+(?:_[A-Z]+)+)[ `]", table))
    assert commands() <= told
    for name in told - commands():
        assert name in ("PROBE_ACCURACY", "PROBE_CALIBRATE", "QUERY_PROBE") or (
            name == "Z_OFFSET_APPLY_PROBE"
        )


def test_links():
    assert link_problems(TEXT, DOCUMENT) == []


def test_picture_is_what_the_script_draws():
    assert PICTURE.read_text(encoding="utf-8") == draw()
