"""Printers that several tests of a file share."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest

from simprinter.hosts.hosts import Host
from tools.kit.printer import Printer
from tools.kit.z_calibration import calibration


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
