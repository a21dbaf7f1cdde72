"""Boxes for install.sh."""

from __future__ import annotations

import shutil
from collections.abc import Iterator

import pytest

from tests.install.box import Box, new_box


@pytest.fixture
def box() -> Iterator[Box]:
    """A home with nothing but our checkout."""
    made = new_box()
    yield made
    shutil.rmtree(made.directory)


@pytest.fixture
def machine(box: Box) -> Box:
    """A home as most have it: Klipper, Moonraker, systemd."""
    box.klipper()
    box.conf()
    box.systemd()
    return box
