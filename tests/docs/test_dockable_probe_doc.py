"""docs/dockable_probe.md says what dockable_probe.py does."""

from __future__ import annotations

import importlib
import re
from pathlib import Path

from tests.docs.documents import (
    link_problems,
    part,
    text_of,
)

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "dockable_probe.md"
MODULE = ROOT / "z_touch" / "dockable_probe" / "module.py"
TEXT = text_of("dockable_probe")
SOURCE = "".join(
    MODULE.with_name(name).read_text(encoding="utf-8")
    for name in ("module.py", "setup.py")
)
SETTINGS = importlib.import_module("z_touch.dockable_probe.settings")


def old_names() -> set[str]:
    """All options of other releases that the module reads."""
    rows = SETTINGS.OLD_POSITIONS
    return {row.name for row in rows} | {
        name for row in SETTINGS.OPTIONS for name in row.old
    }


def commands() -> set[str]:
    """All commands that it registers."""
    return set(re.findall(r"cmd_([A-Z_]+)_help", SOURCE)) | {
        f"MOVE_TO_{part}_PROBE"
        for part in re.findall(r"cmd_MOVE_TO_([A-Z]+)_PROBE", SOURCE)
    }


def test_old_names_are_all_there():
    assert len(old_names()) > 3
    missing = {name for name in old_names() if f"`{name}`" not in TEXT}
    assert missing == set()


def test_commands_are_all_there():
    assert len(commands()) == 13
    table = part(TEXT, "Which commands are there?")
    told = set(re.findall(r"`([A-Z]+(?:_[A-Z]+)+)[ `]", table))
    assert commands() <= told
    for name in told - commands():
        assert name in ("PROBE_ACCURACY", "PROBE_CALIBRATE", "QUERY_PROBE") or (
            name == "Z_OFFSET_APPLY_PROBE"
        )


def test_links():
    assert link_problems(TEXT, DOCUMENT) == []
