"""A simulated printer that real klippy drives; see LIMITS.md."""

from .clock import RealClock, VirtualClock
from .faults import Fault, Faults
from .machine import Machine, build_directory
from .scenes import SCENES, Scene, heated

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
