"""Sections of real printers, see tests/corpus; machines are made of them.

The configuration is the entry's, the machine behind it a healthy printer.
make test runs a few of them, make test-rest the others.
"""

from __future__ import annotations

import json
from collections.abc import Container, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Optional

import pytest

_FILES = Path(__file__).resolve().parents[2] / "tests" / "corpus"
# Not on every host; means nothing without a print
_MESH_OPTIONS_LEFT_OUT = {"adaptive_margin"}

Point = tuple[float, float]
Options = dict[str, Optional[str]]


@dataclass(frozen=True)
class Entry:
    """One section of a real printer, with the sections around it."""

    index: int
    options: Mapping[str, str]
    context: Mapping[str, Mapping[str, str]]

    def section(self, name: str) -> Mapping[str, str]:
        """A section of the context; empty where there is none."""
        return self.context.get(name, {})

    def number(self, option: str, default: float) -> float:
        """An option of the section; the default where it is none."""
        try:
            return float(self.options.get(option, ""))
        except ValueError:
            return default

    def mesh(self) -> Options:
        """The section bed_mesh, as every host takes it."""
        mesh = self.section("bed_mesh")
        names = [name for name in mesh if name not in _MESH_OPTIONS_LEFT_OUT]
        return chosen(mesh, " ".join(names))


def load(module: str) -> list[Entry]:
    """All entries of one module, in the order of the file."""
    text = (_FILES / f"{module}.json").read_text(encoding="utf-8")
    return [
        Entry(index, entry["options"], entry.get("context", {}))
        for index, entry in enumerate(json.loads(text))
    ]


def each(entries: Sequence[Entry], usual: Container[int]) -> Any:
    """Runs a test with each entry, in make test with those of these numbers."""
    cases = [
        pytest.param(
            entry,
            marks=() if entry.index in usual else pytest.mark.slow,
            id=str(entry.index),
        )
        for entry in entries
    ]
    return pytest.mark.parametrize("entry", cases)


def chosen(options: Mapping[str, str], names: str) -> Options:
    """Some of the options, as values for a file."""
    return {
        name: indented(options[name])
        for name in names.split()
        if options.get(name)
    }


def indented(text: str) -> str:
    """A value with its further lines indented."""
    return text.replace("\n", "\n  ")
