"""Printers without anything of this repository beside klippy."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from simprinter.hosts.hosts import Host
from simprinter.hosts.printer import Printer


@pytest.fixture
def start(host: Host) -> Iterator[Callable[..., Printer]]:
    """start(scene, changes, faults, seed ...): a Printer on the host."""
    with ExitStack() as stack:
        yield lambda *args, **options: stack.enter_context(
            Printer(host, *args, **options)
        )
