"""Load a module as klippy does, and print what that took.

    python loading.py time|memory MAIN PROBE MODULE

Run by the Python of a host: klippy's program MAIN and the module PROBE of its
[probe] are loaded before, as they are in any printer that has one. Prints
seconds, or bytes that are kept, those of modules of the standard library that
nobody has loaded before included.
"""

from __future__ import annotations

import gc
import importlib
import sys
import time
import tracemalloc

# Nothing in a module is as large (bytes), but Python's table of all names is,
# which grows by leaps: it would count for the module that meets one
LEAP = 100000


def seconds(module: str) -> float:
    """Time of loading it."""
    began = time.perf_counter()
    importlib.import_module(module)
    return time.perf_counter() - began


def memory(module: str) -> float:
    """Bytes that it keeps."""
    gc.collect()
    tracemalloc.start()
    importlib.import_module(module)
    gc.collect()
    sizes = [trace.size for trace in tracemalloc.take_snapshot().traces]
    return float(sum(size for size in sizes if size < LEAP))


def main(what: str, before: list[str], module: str) -> None:
    """Load `before`, measure the module."""
    for name in before:
        importlib.import_module(name)
    measured = {"time": seconds, "memory": memory}[what](module)
    print(measured)  # noqa: T201


if __name__ == "__main__":
    # Klippy's own directories come first, not the one of this file
    sys.path.pop(0)
    main(sys.argv[1], sys.argv[2:-1], sys.argv[-1])
