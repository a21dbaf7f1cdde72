"""What the page shows of our modules comes from here alone."""

from __future__ import annotations

import json
import re

import pytest

from simprinter.places import PACKAGE
from tools.kit.printer import MODULES
from tools.playground.shown import ON_THE_PAGE

FILES = sorted(
    path
    for path in (PACKAGE / "play").rglob("*")
    if path.suffix in (".py", ".js", ".html", ".css")
)
COMMANDS = {gcode.split()[0] for _, gcode, _ in ON_THE_PAGE["shortcuts"]}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_the_package_knows_none_of_them(path):
    text = path.read_text(encoding="utf-8")
    # Klippy's own, which a document may name
    ours = [*MODULES, *COMMANDS - {"SAVE_CONFIG"}]
    assert [name for name in ours if name in text] == []


def test_there_are_files():
    assert len(FILES) > 20


def test_it_can_be_sent():
    """Expressions mean in JavaScript what they mean here."""
    assert json.loads(json.dumps(ON_THE_PAGE))["cards"]
    for pattern, *_ in ON_THE_PAGE["cards"]:
        assert re.compile(pattern).groups >= 1
    assert set(ON_THE_PAGE["watched"]) == set(MODULES)
