"""Each module's page opens with its whole section: every option, no other.

Names and defaults are those of the page's tables, which klippy is asked about
in test_documents; those of dockable_probe are asked for here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import NamedTuple

import pytest

from simprinter.hosts.hosts import Host
from tests.docs.documents import OPTIONS, part, rows, spans, text_of
from tests.docs.option_rows import default_of, value_of
from tests.docs.test_dockable_probe_doc import SETTINGS
from tools.kit.dockable_probe import SENSED
from tools.kit.printer import Printer
from z_touch.core import options

WHOLE = "The whole section"
# Options of other releases have a table of their own
OLD = {"z_calibration": "Old names"}
NAMES = ("z_calibration", "auto_z_offset", "extra_probe", "dockable_probe")
# Options of the host's [probe] are not in the tables of these.
SHORT = ("dockable_probe",)
OF_PROBE = {
    row.name: default_of(row)
    for row in SETTINGS.PROBE
    if row.default is not options.REQUIRED
}


class Line(NamedTuple):
    """An option of the section: commented out, its value, what it does."""

    is_default: bool
    value: str
    comment: str


def whole_section(text: str) -> dict[str, Line]:
    """The options of the first code block of a page."""
    (block,) = re.findall(r"```ini\n\[.*\]\n(.*?)```", part(text, WHOLE), re.S)
    found: dict[str, Line] = {}
    pattern = r"(#?)([a-z_]+):(.*)\n((?:#   .*\n)*)"
    assert re.sub(pattern, "", block) == "", "neither option nor comment"
    for mark, name, value, comment in re.findall(pattern, block):
        assert name not in found, name
        found[name] = Line(mark == "#", value.strip(), comment)
    return found


def table_of(name: str, text: str) -> dict[str, str]:
    """Option -> its default, as the tables of a page have it."""
    body = part(text, OPTIONS)
    if name in OLD:
        body = body.replace(part(text, OLD[name]), "")
    found = {spans(row[0])[0]: row[1] for row in rows(body)}
    return {**OF_PROBE, "pin": "-", **found} if name in SHORT else found


def literal(default: str, table: dict[str, str]) -> str:
    """The value that a default is; empty: it comes from elsewhere."""
    words = re.fullmatch("`([^`]+)`", default)
    return words[1] if words and words[1] not in table else ""


def problems(name: str, text: str) -> Iterator[str]:
    """Where section and tables differ."""
    lines, table = whole_section(text), table_of(name, text)
    for option in sorted(set(lines) ^ set(table)):
        yield f"{option}: only in the section or only in the tables"
    for option in set(lines) & set(table):
        line, value = lines[option], literal(table[option], table)
        if not line.comment:
            yield f"{option}: no comment"
        if line.is_default and line.value != value:
            yield f"{option}: {line.value!r}, its default is {value!r}"
        if line.is_default and not value:
            said = "default" in line.comment or "SAVE_CONFIG" in line.comment
            if not said:
                yield f"{option}: nothing of its default"
        if not line.is_default and not line.value:
            yield f"{option}: an empty value"


MISTAKES = {
    "left out": (r"(?m)^#lift_speed:.*\n(#   .*\n)+", ""),
    "too many": (r"(?m)^#lift_speed:", "#no_speed: 1\n#   None.\n#lift_speed:"),
    "other default": (r"(?m)^#(\w+): (\d)", r"#\1: 1\2"),
    "no comment": (r"(?m)^(#lift_speed:.*\n)(#   .*\n)+", r"\1"),
}


@pytest.mark.parametrize("name", NAMES)
def test_whole_section_is_right_and_mistakes_are_found(name):
    text = text_of(name)
    assert re.search(r"(?m)^## (.*)", text)[1] == WHOLE
    assert list(problems(name, text)) == []
    for what, (old, new) in MISTAKES.items():
        changed, count = re.subn(old, new, text, count=1)
        assert count, what
        assert list(problems(name, changed)), what


def test_dockable_probe_has_these_defaults(host: Host):
    """Held against the document, row by row, in test_dockable_probe_doc."""
    rows_of = {row.name: row for row in SETTINGS.OPTIONS if value_of(row)}
    assert len(rows_of) > 15
    changes = {"dockable_probe": dict.fromkeys(rows_of)}
    with Printer(host, SENSED, changes) as printer:
        printer.session.require_ready()
        settings = printer.status("configfile")["settings"]["dockable_probe"]
    for name, row in rows_of.items():
        assert settings[name] == row.default, name
