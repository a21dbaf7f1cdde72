"""Printers that several tests of a file share."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from simprinter.hosts.hosts import Host
from tools.kit.printer import Printer
from tools.kit.z_calibration import calibration, section, with_moves


@pytest.fixture(scope="module")
def calibrated() -> Iterator[Callable[[Host], Printer]]:
    """A printer on a host that was calibrated, for what leaves it so."""
    with ExitStack() as stack:

        @functools.cache
        def on(host: Host) -> Printer:
            printer = stack.enter_context(Printer(host))
            calibration(printer.homed())
            return printer

        yield on


@pytest.fixture
def watched(start: Callable[..., Printer]) -> Callable[..., Printer]:
    """A homed printer with these options of [z_calibration], whose moves are recorded."""

    def begin(**options: str) -> Printer:
        changes = {"moves": {}, **section(**options)}
        return start(changes=changes, modules=with_moves()).homed()

    return begin
