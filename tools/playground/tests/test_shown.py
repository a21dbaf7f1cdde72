"""What the page shows of our modules comes from here alone."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import simplay
from tools.kit.printer import MODULES
from tools.playground.shown import ON_THE_PAGE

FOLDER = Path(simplay.__file__).parent
FILES = sorted([*FOLDER.glob("*.py"), *FOLDER.glob("page/*")])
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
