"""Boxes for install.sh."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.install.box import OVERRIDE, Box, Klipper


@pytest.fixture
def new_box() -> Iterator[Callable[..., Box]]:
    """Makes a home with nothing but our checkout, whatever its name."""
    with tempfile.TemporaryDirectory(prefix="install-") as folder:
        directory = Path(folder)
        directory.chmod(0o755)  # an unprivileged user works in it
        yield lambda home="home": Box(directory, home)


@pytest.fixture
def box(new_box: Callable[..., Box]) -> Box:
    """A home with nothing but our checkout."""
    return new_box()


@pytest.fixture
def machine(box: Box) -> Box:
    """A home as most have it, but for Klipper: Moonraker, systemd."""
    box.conf()
    box.systemd()
    return box


@pytest.fixture
def klipper(machine: Box) -> Klipper:
    """The Klipper of that machine."""
    return machine.klipper()


@pytest.fixture(params=["klipper", "kalico"])
def either(request: pytest.FixtureRequest, machine: Box) -> Klipper:
    """The same, and a Kalico that is told to take our modules."""
    if request.param == "klipper":
        return machine.klipper()
    machine.write("printer_data/config/printer.cfg", OVERRIDE)
    return machine.kalico()
