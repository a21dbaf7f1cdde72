"""Each module's page opens with its whole section: every option, no other.

Names and defaults are those of the page's tables, which klippy is asked about
in test_documents; those of dockable_probe are asked for here.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pytest

from simprinter.hosts.hosts import Host
from tests.docs.documents import OPTIONS, part, rows, spans
from tests.docs.test_dockable_probe_doc import options as module_options
from tools.kit.dockable_probe import SWITCH
from tools.kit.printer import Printer

DOCS = Path(__file__).resolve().parents[2] / "docs"
WHOLE = "The whole section"
# Options of other releases have a table of their own
OLD = {"z_calibration": "Old names"}
NAMES = ("z_calibration", "auto_z_offset", "extra_probe", "dockable_probe")
# Options of the host's [probe] are not in the table of dockable_probe
OF_PROBE = {
    "pin": "-",
    "x_offset": "`0.0`",
    "y_offset": "`0.0`",
    "speed": "`5.0`",
    "samples": "`1`",
    "samples_result": "`average`",
    "samples_tolerance": "`0.1`",
    "samples_tolerance_retries": "`0`",
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
    return {**found, **(OF_PROBE if name == "dockable_probe" else {})}


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
    text = (DOCS / f"{name}.md").read_text(encoding="utf-8")
    assert re.search(r"(?m)^## (.*)", text)[1] == WHOLE
    assert list(problems(name, text)) == []
    for what, (old, new) in MISTAKES.items():
        changed, count = re.subn(old, new, text, count=1)
        assert count, what
        assert list(problems(name, changed)), what


def test_dockable_probe_has_these_options_and_defaults(one_host: Host):
    text = (DOCS / "dockable_probe.md").read_text(encoding="utf-8")
    lines = whole_section(text)
    old = set(re.findall(r"`(\w+)`", text.partition("\nOld names: ")[2]))
    assert set(lines) >= module_options() - old
    defaults = {n: x.value for n, x in lines.items() if x.is_default}
    changes = {"dockable_probe": dict.fromkeys(defaults)}
    with Printer(one_host, SWITCH, changes) as printer:
        printer.session.require_ready()
        settings = printer.status("configfile")["settings"]["dockable_probe"]
    for option, value in defaults.items():
        if value:
            real = settings[option]
            same_words = value.lower() == str(real).lower()
            assert same_words or float(value) == real, option
