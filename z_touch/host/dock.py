"""A [dockable_probe] of the host's own, as attached.py wants it.

Kalico has one since 2023-08-27 (b3e67e92b), made of a plugin for Klipper that has the same
methods.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Optional

if TYPE_CHECKING:
    from .printer import Host

# What get_probe_state() answers; it may be 0.1 s old.
STATES = {1: "ATTACHED", 2: "DOCKED"}
OLD_ANSWER = 0.11


def find(host: Host) -> Optional[HostDock]:
    """Return the host's dockable probe, None where it has none.

    It is looked up at each use, as its section may stand behind the one that asks.
    """
    dockable = host.printer.lookup_object("dockable_probe", None)
    if not hasattr(dockable, "get_probe_state"):
        return None
    return HostDock(host, dockable)


class HostDock:
    """A dockable probe that fetches and docks by itself; see attached.Carrier."""

    def __init__(self, host: Host, dockable: Any):
        self.host = host
        self.dockable = dockable

    @property
    def auto(self) -> bool:
        """Whether it goes to the dock by itself."""
        return bool(self.dockable.auto_attach_detach)

    def _raise_to(self, z: float) -> None:
        toolhead = self.host.toolhead
        is_homed = "z" in self.host.toolhead_status()["homed_axes"]
        if self.host.motion.z() < z and is_homed:
            toolhead.manual_move([None, None, z], self.dockable.lift_speed)

    def state(self) -> str:
        """Return ATTACHED, DOCKED or UNKNOWN.  May pause.

        A probe that is pressed looks as if it were docked: it is lifted first.
        """
        host, dockable = self.host, self.dockable
        z = host.motion.z()
        self._raise_to(dockable.position_endstop + dockable.sample_retract_dist)
        host.toolhead.wait_moves()
        reactor = host.printer.get_reactor()
        reactor.pause(reactor.monotonic() + OLD_ANSWER)
        state = STATES.get(dockable.get_probe_state(), "UNKNOWN")
        if state == "DOCKED" and host.motion.z() != z:
            host.toolhead.manual_move([None, None, z], dockable.lift_speed)
        return state

    def reads(self) -> str:
        """Return where a user sees the state."""
        return "QUERY_DOCKABLE_PROBE"

    def dock_and_come_back(self) -> None:
        """Dock the probe and come back.  May pause.

        Its way to the dock is as high as the toolhead is; back it may stop short of the
        place, or stay beside the dock.
        """
        host, dockable = self.host, self.dockable
        x, y, z = host.toolhead.get_position()[:3]
        host.gcode.run_script_from_command("DETACH_PROBE")
        self.go_to(x, y, dockable.travel_speed)
        if host.motion.z() != z:
            host.toolhead.manual_move([None, None, z], dockable.lift_speed)

    def mark(self) -> object:
        """Return nothing: it does not say whether it was fetched to stay."""
        return None

    def is_put_on(self, _mark: object, was_docked: bool) -> bool:
        """Return whether it was docked and is no more."""
        return was_docked and self.state() != "DOCKED"

    def fetch(self) -> None:
        """Attach the probe.  May pause."""
        if self.state() != "ATTACHED":
            self.host.gcode.run_script_from_command("ATTACH_PROBE")

    def dock_pending(self) -> None:
        """Do nothing: it docks at once, or not at all."""

    def go_to(self, x: float, y: float, speed: float) -> None:
        """Move to X and Y (mm) around the dock."""
        self.host.gcode.run_script_from_command(
            f"MOVE_AVOIDING_DOCK X={x:.6f} Y={y:.6f} SPEED={speed:.6f}"
        )
        if tuple(self.host.toolhead.get_position()[:2]) != (x, y):
            self.host.toolhead.manual_move([x, y], speed)
