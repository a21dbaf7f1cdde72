"""docs/dockable_probe.md says what dockable_probe.py does."""

from __future__ import annotations

import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.docs.documents import (
    OPTIONS,
    link_problems,
    part,
    rows,
    spans,
    text_of,
)
from tests.docs.option_rows import default_of, problems_of_lines, range_of

ROOT = Path(__file__).resolve().parents[2]
DOCUMENT = ROOT / "docs" / "dockable_probe.md"
MODULE = ROOT / "z_touch" / "dockable_probe" / "module.py"
TEXT = text_of("dockable_probe")
SOURCE = "".join(
    MODULE.with_name(name).read_text(encoding="utf-8")
    for name in ("module.py", "setup.py")
)
SETTINGS = importlib.import_module("z_touch.dockable_probe.settings")
# What the table says of a default that comes from elsewhere
ELSEWHERE = {
    "dock_fixed_z": "whether no position has a Z",
    "detach_dockable_before_z_home": "whether Z is homed on a switch",
    "safe_dock_distance": "distance of the nearest position",
}
# A limit that comes from elsewhere
UP_TO = {"safe_dock_distance": ", up to that"}
# These mean what they do in Klipper's [probe], and are not in the table.
OF_PROBE = {
    row.name for row in SETTINGS.PROBE if row.name != "sample_retract_dist"
} - {"z_offset"}


def options() -> set[str]:
    """All options that the module reads."""
    tables = (*SETTINGS.OPTIONS, *SETTINGS.OLD_POSITIONS)
    return {name for row in tables for name in (row.name, *row.old)}


def commands() -> set[str]:
    """All commands that it registers."""
    return set(re.findall(r"cmd_([A-Z_]+)_help", SOURCE)) | {
        f"MOVE_TO_{part}_PROBE"
        for part in re.findall(r"cmd_MOVE_TO_([A-Z]+)_PROBE", SOURCE)
    }


def problems_of_table(text: str) -> Iterator[str]:
    """Where the table of options differs from the rows of the source."""
    table = {spans(row[0])[0]: row[1:3] for row in rows(part(text, OPTIONS))}
    wanted = {
        row.name: [
            ELSEWHERE.get(row.name, default_of(row)),
            range_of(row) + UP_TO.get(row.name, ""),
        ]
        for row in SETTINGS.OPTIONS
        if row.name not in OF_PROBE
    }
    for name in sorted(set(table) | set(wanted)):
        if table.get(name) != wanted.get(name):
            yield f"{name}: {table.get(name)}, it is {wanted.get(name)}"


def test_options_are_all_there():
    assert len(options()) > 35
    missing = {name for name in options() if f"`{name}`" not in TEXT}
    assert missing == set()


MISTAKES = {
    "left out": (r"(?m)^\| `lift_speed` .*\n", ""),
    "default": (r"(\| `travel_speed` \| )`50`", r"\1`60`"),
    "as another one": (
        r"(\| `attach_speed` \| )`travel_speed`",
        r"\1`lift_speed`",
    ),
    "range": (r"(\| `z_hop` .*)≥ 0", r"\1> 0"),
    "line": (r"(?m)^(#lift_speed:\n#   )All", r"\1Some"),
    "value": (r"(?m)^#dock_retries: 0", "#dock_retries: 1"),
    "option that does not exist": (r"(?m)^#z_hop: 0", "#no_hop: 0"),
}


def problems(text: str) -> Iterator[str]:
    """Where table and whole section differ from the rows of the source."""
    yield from problems_of_table(text)
    yield from problems_of_lines(text, SETTINGS.OPTIONS)


def test_table_and_whole_section_are_the_rows_of_the_source():
    assert list(problems(TEXT)) == []


@pytest.mark.parametrize("what", MISTAKES)
def test_mistakes_are_found(what):
    changed, count = re.subn(*MISTAKES[what], TEXT)
    assert count
    assert list(problems(changed))


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
