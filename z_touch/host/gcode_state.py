"""What G-code has set: the Z offset, what G92 has moved, and how coordinates are read.

  G1 Z -> + G-code offset, + what G92 has moved -> transforms -> toolhead Z

A larger offset holds the nozzle higher.  Commands are called by their own methods: a macro
of the same name may do anything.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Iterator, NamedTuple

from ..command import always

if TYPE_CHECKING:
    from .klippy import Status
    from .printer import Host

# G92 that has moved less (mm) is rounding
NO_SHIFT = 0.0000001


class Modes(NamedTuple):
    """Whether G1 has absolute coordinates, an absolute extruder, and its F (mm/min)."""

    absolute: bool
    absolute_extrude: bool
    speed: float


class GcodeState:
    """The object 'gcode_move' of the host."""

    def __init__(self, host: Host):
        self.host = host
        self.printer = host.printer

    def gcode_move(self) -> Any:
        """Return the host's object."""
        return self.printer.lookup_object("gcode_move")

    def _status(self) -> Status:
        status: Status = self.gcode_move().get_status(self.host.eventtime())
        return status

    def _call(self, name: str, **params: str) -> None:
        line = " ".join(
            [name, *[f"{key}{value}" for key, value in params.items()]]
        )
        gcmd = self.host.gcode.create_gcode_command(name, line, params)
        getattr(self.gcode_move(), "cmd_" + name)(gcmd)

    ##################################################################
    # The G-code offset and G92
    ##################################################################

    def z_offset(self) -> float:
        """Return the G-code Z offset in force (mm)."""
        offset: float = self._status()["homing_origin"][2]
        return offset

    def set_z_offset(self, z_offset: float, digits: int = 6) -> None:
        """Set the G-code Z offset (mm) in place of any other one; nothing moves."""
        if self.z_offset() == z_offset:
            return
        params = {"Z": f"{z_offset:.{digits}f}", "MOVE": "0"}
        name = "SET_GCODE_OFFSET"
        line = f"{name} Z={params['Z']} MOVE=0"
        gcmd = self.host.gcode.create_gcode_command(name, line, params)
        self.gcode_move().cmd_SET_GCODE_OFFSET(gcmd)

    @contextlib.contextmanager
    def without_offset(self) -> Iterator[None]:
        """Have no G-code Z offset while this lasts, and afterwards the one of before."""
        before = self.z_offset()
        with always(
            self.host,
            lambda: self.set_z_offset(before),
            "setting the offset back",
        ):
            self.set_z_offset(0.0)
            yield

    def z(self) -> float:
        """Return the Z of G-code (mm), the offset included and transforms taken off.

        It is where the nozzle would be without any transform.
        """
        z: float = self._status()["position"][2]
        return z

    def moved_by_g92(self) -> float:
        """Return how far G92 has moved Z=0 up (mm), which is no part of the offset."""
        status = self._status()
        moved: float = status["position"][2] - status["gcode_position"][2]
        offset: float = status["homing_origin"][2]
        return moved - offset

    def undo_g92(self) -> str:
        """Undo what G92 has moved in Z, as homing does.

        Returns what the user is told of it; empty: there was nothing.
        """
        moved = self.moved_by_g92()
        if abs(moved) < NO_SHIFT:
            return ""
        status = self._status()
        z = status["position"][2] - status["homing_origin"][2]
        self._call("G92", Z=f"{z:.6f}")
        return f"G92 had moved Z=0 by {moved:.3f} mm: undone, as G28 does"

    ##################################################################
    # Modes
    ##################################################################

    def modes(self) -> Modes:
        """Return how G-code reads coordinates now."""
        status = self._status()
        return Modes(
            status["absolute_coordinates"],
            status["absolute_extrude"],
            status["speed"],
        )

    def set_modes(self, modes: Modes) -> None:
        """Have G-code read coordinates in that way."""
        current = self.modes()
        if current.absolute != modes.absolute:
            self._call("G90" if modes.absolute else "G91")
        if current.absolute_extrude != modes.absolute_extrude:
            self._call("M82" if modes.absolute_extrude else "M83")
        if current.speed != modes.speed:
            self._call("G1", F=f"{modes.speed:.6f}")

    @contextlib.contextmanager
    def keeping_modes(self) -> Iterator[None]:
        """Have G-code read coordinates as now when this ends, whatever is set meanwhile."""
        modes = self.modes()
        with always(
            self.host, lambda: self.set_modes(modes), "setting the modes back"
        ):
            yield
