"""The parameters of our commands, as the documents list them, for completion."""

from __future__ import annotations

import re
from pathlib import Path

_DOCS = Path(__file__).resolve().parents[2] / "docs"
_PAGES = ("z_calibration", "auto_z_offset", "dockable_probe", "extra_probe")
_HEADING = re.compile(r"#+ (.*)")
_ROW = re.compile(r"\| `([A-Z_]+)` \|(?:.*\|)? *(.*?) *\|$")
# A command whose parameters stand in its own row
_INLINE = re.compile(r"\| `([A-Z_]+)((?: [A-Z_]+=<[^>]+>)+)` \|")
_GIVEN = re.compile(r"([A-Z_]+)=<([^>]+)>")


def _plain(text: str) -> str:
    """Without the marks of links and of code."""
    text = re.sub(r"\[([^]]*)\]\([^)]*\)", r"\1", text).replace("`", "")
    return "" if text == "see above" else text


def parameters_of(text: str) -> dict[str, dict[str, str]]:
    """By command: its parameters, and what a document says of each."""
    found: dict[str, dict[str, str]] = {}
    command = ""
    for line in text.splitlines():
        heading, row, inline = (
            pattern.match(line) for pattern in (_HEADING, _ROW, _INLINE)
        )
        if heading:
            title = heading[1]
            command = title if re.fullmatch("[A-Z_]+", title) else ""
        elif row and command:
            found.setdefault(command, {})[row[1]] = _plain(row[2])
        elif inline:
            found[inline[1]] = dict(_GIVEN.findall(inline[2]))
    return found


def all_parameters() -> dict[str, dict[str, str]]:
    """Of every command of this project that has any."""
    found: dict[str, dict[str, str]] = {}
    for name in _PAGES:
        text = (_DOCS / f"{name}.md").read_text(encoding="utf-8")
        found.update(parameters_of(text))
    return found
