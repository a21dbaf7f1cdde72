"""A simulated printer that real klippy drives; see README.md and LIMITS.md."""

from __future__ import annotations

from .clock import RealClock, VirtualClock
from .faults import Fault, FaultError, Faults
from .machine import Machine
from .places import build_directory
from .scene import Scene, heated

__version__ = "0.1.0"

__all__ = [
    "Fault",
    "FaultError",
    "Faults",
    "Machine",
    "RealClock",
    "Scene",
    "VirtualClock",
    "build_directory",
    "heated",
]
