"""Which nozzle is active: that of an extruder, of a tool changer's tool, of a carriage.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Tuple,
)

if TYPE_CHECKING:
    from .printer import Host

# Modes of a carriage, idex_modes.py
PRIMARY, INACTIVE = "PRIMARY", "INACTIVE"


class Carriage(NamedTuple):
    """A carriage of an IDEX: its name, its axis (0: X), where it stands and is homed (mm).

    'is_first' is the carriage of its axis that is active after homing.
    """

    name: str
    is_first: bool
    axis: int
    mode: str
    position: float
    end: float


class Tools:
    """The nozzles of the printer."""

    def __init__(self, host: Host):
        self.host = host
        self.printer = host.printer

    def active(self) -> str:
        """Return which nozzle is active, empty: the printer has none.

        That is the section of its extruder, of a tool changer's tool; with another carriage
        than the first that one's name besides: a macro need not activate its extruder.
        """
        for name, _ in self.of_changer():
            return name
        parts = [self.host.extruder() or "the nozzle", *self._other_carriages()]
        return " with ".join(parts)

    def of_changer(self) -> Iterator[Tuple[str, float]]:
        """Yield the section of each active tool, and by how much (mm) it shifts Z.

        Of klipper-toolchanger since 2025-12-26, below the G-code offset: a larger one holds
        the nozzle higher.  Before, it was a part of that, and other plugins have sections of
        that name, too.
        """
        changer = self.printer.lookup_object("toolchanger", None)
        if not hasattr(changer, "gcode_transform"):
            return
        for name, tool in self.printer.lookup_objects("tool"):
            get_status = getattr(tool, "get_status", None)
            status = get_status(self.host.eventtime()) if get_status else {}
            shift = status.get("gcode_z_offset")
            if status.get("active") and isinstance(shift, (int, float)):
                yield name, shift

    ##################################################################
    # Carriages
    ##################################################################

    def _modes(self) -> Dict[str, str]:
        """Return the mode of each carriage by name, the first ones of all axes first."""
        dual = self.printer.lookup_object("dual_carriage", None)
        status = dual.get_status(self.host.eventtime()) if dual else {}
        numbered = {
            name: mode
            for name, mode in status.items()
            if name.startswith("carriage_")
        }
        # By names of their own, where there are more, since 2025-05-06 (cc6736c3e)
        return numbered or dict(status.get("carriages", {}))

    def _other_carriages(self) -> List[str]:
        modes, firsts = self._modes(), self._firsts()
        return [
            name
            for name, mode in modes.items()
            if mode == PRIMARY and name not in firsts
        ]

    def _firsts(self) -> List[str]:
        """Return the first carriage of each axis by name, which homing leaves active."""
        names = list(self._modes())
        return names[: (len(names) + 1) // 2]

    def lost_by_probing(self) -> Optional[str]:
        """Return the active carriage whose place the host loses at each touch, None: of none.

        Before 2024-02-07 (b7f7b8a34) Klipper takes it to be where the first one is, and
        drives it into its end with the next move.
        """
        dual = self.printer.lookup_object("dual_carriage", None)
        if dual is None or hasattr(dual, "get_primary_rail"):
            return None
        return next(iter(self._other_carriages()), None)

    def carriages(self) -> List[Carriage]:
        """Return the carriages of an IDEX, none: the printer is not one."""
        dual = self.printer.lookup_object("dual_carriage", None)
        if dual is None:
            return []
        # By name since 2025-05-06 (cc6736c3e)
        by_name: Any = getattr(dual, "dc_rails", None)
        rails = list(by_name.values() if by_name else dual.dc)
        firsts = self._firsts()
        here, found = self.host.toolhead.get_position(), []
        for (name, mode), carriage in zip(self._modes().items(), rails):
            rail = getattr(carriage, "rail", None) or carriage.get_rail()
            position = carriage.get_axis_position(here)
            end = rail.get_homing_info().position_endstop
            is_first = name in firsts
            found.append(
                Carriage(name, is_first, carriage.axis, mode, position, end)
            )
        return found
