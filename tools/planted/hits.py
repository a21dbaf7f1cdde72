"""Loaded by each file of a copy of the product: keeps which test runs which block.

A block is a list of statements that runs as a whole or not at all. Which test runs is
what the plugin in recording.py writes into a page that it shares with klippy, as a
klippy may outlive a test. A test has a file with a byte for each block.
"""

from __future__ import annotations

import mmap
import os
from pathlib import Path
from typing import Any

_folder = Path(os.environ["PLANTED_HITS"])
# A line for each block, and for each option that is given
_numbers = {
    name: number
    for number, name in enumerate((_folder / "blocks").read_text().split())
}
_pages: dict[bytes, mmap.mmap] = {}


def _shared(name: str, size: int) -> mmap.mmap:
    with (_folder / name).open("ab") as file:
        file.truncate(size)
    with (_folder / name).open("r+b") as file:
        return mmap.mmap(file.fileno(), size)


_now = _shared(f"now-{os.environ.get('PYTEST_XDIST_WORKER', 'main')}", 16)


def hit(block: int) -> None:
    """The test that runs now runs this block."""
    test = _now[:16]
    page = _pages.get(test)
    if page is None:
        _pages.clear()
        page = _pages[test] = _shared(test.decode("ascii"), len(_numbers))
    page[block] = 1


def option(name: str, config: Any, written: str) -> bool:
    """The test that runs now may give this option; False, to go on."""
    number = _numbers.get(f"option:{name}")
    # A test without a host has a configuration of its own
    options = getattr(config, "fileconfig", None)
    if number is None or options is None:
        return False
    if options.has_option(config.get_name(), written):
        hit(number)
    return False
