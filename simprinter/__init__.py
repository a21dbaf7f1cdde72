"""A simulated printer that real klippy drives; see README.md and LIMITS.md."""

from __future__ import annotations

from typing import Any

from .clock import RealClock, VirtualClock
from .faults import Fault, Faults
from .machine import Machine
from .places import build_directory
from .scene import Scene, heated

__version__ = "0.1.0"

__all__ = [
    "SCENES",
    "Fault",
    "Faults",
    "Machine",
    "RealClock",
    "Scene",
    "VirtualClock",
    "build_directory",
    "heated",
]


def __getattr__(name: str) -> Any:
    """The machines of this repository's tests, which no package has."""
    if name == "SCENES":
        from .scenes import SCENES

        return SCENES
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
