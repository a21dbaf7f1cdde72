"""The last calibration that was applied, and whether it still holds.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import (
    TYPE_CHECKING,
    Any,
    Container,
    Dict,
    Iterator,
    Optional,
    Tuple,
)

from ..in_force import LARGEST_STEP
from .runs import Warned

if TYPE_CHECKING:
    from ..datum import Datum, Mark
    from ..host.printer import Host
    from .heights import Result

# By less (mm) the bed mesh is as high as it was.
SAME_HEIGHT = 0.01

# Offsets that differ by less (mm) are the same, but for their digits in G-code.
SAME_OFFSET = 0.000002

# What a result may not hold for any more
DATUM, MESH, HEAT, TOOL, G92, OFFSET = [
    "datum",
    "mesh",
    "heat",
    "tool",
    "g92",
    "offset",
]


@dataclass(frozen=True)
class LastRun:
    """A run that has measured (mm)."""

    result: Result
    # Where Z=0 was when it was measured
    mark: Mark
    # What was odd
    warnings: Tuple[Warned, ...]
    # What the offset may be off by (95 %), None: not known
    uncertainty: Optional[float]
    # What Z_ADJUST added
    z_adjust: float
    # X, Y of the bed that was measured
    point: Tuple[float, float]
    # What the host adds to the height of the bed there
    twist: float
    # Whose nozzle it was
    extruder: str
    # Where (X and Y, mm) the nozzle has met the pin with the probe attached, None: it was not
    proved_at: Optional[Tuple[float, float]] = None
    # What something that is not known adds to Z over pin and bed
    unknown_shift: float = 0.0
    # The G-code offset that came of it: what was measured, less what Klipper's own
    # features add there, with Z_ADJUST
    z_offset: float = 0.0
    # The one that was set: the same, unless offset_gcode has made another one of it
    applied: float = 0.0
    # offset_gcode keeps it for later
    is_for_later: bool = False
    # Those that were in force before, which a saved state may bring back
    earlier_offsets: Tuple[float, ...] = ()
    # Height of bed mesh or bed tilt there, when it was applied; whether that is not known;
    # and what was set of what follows a temperature, see transforms.py
    height: float = 0.0
    guessed: bool = False
    heat: Dict[str, Any] = field(default_factory=dict)

    def replace(self, **changes: Any) -> LastRun:
        """Return the run with other values."""
        return dataclasses.replace(self, **changes)


def bed_seen(host: Host, last: LastRun) -> float:
    """Return where the host's probe sees the bed at the point of a run (toolhead Z, mm)."""
    return last.result.probe + last.twist - host.probing.z_offset()


def height_of(host: Host, last: LastRun) -> float:
    """Return the height (mm) of bed mesh or bed tilt there."""
    x, y = last.point
    return host.transforms.height(x, y, bed_z=bed_seen(host, last))


class Results:
    """What macros read of results, and what the next run knows of the last one."""

    def __init__(self, host: Host, datum: Datum):
        self.host = host
        self.datum = datum
        self.last: Optional[LastRun] = None
        # The last one with each extruder, by its name: another nozzle is longer
        self.of_tools: Dict[str, LastRun] = {}
        # The run that is under way, as soon as it has measured: end_gcode may read it.
        self.measured: Optional[LastRun] = None
        # The last run has ended well, or the one under way has measured well
        self.is_good = False

    def note(self, measured: Optional[LastRun]) -> None:
        """Show the run that is under way; None: it has not measured yet, or there is none."""
        self.measured = measured
        self.is_good = measured is not None

    def keep(self, last: LastRun) -> None:
        """Keep a run that has ended well."""
        self.last = self.of_tools[last.extruder] = last
        self.measured, self.is_good = None, True

    def earlier(self, extruder: str) -> Tuple[Optional[Result], bool]:
        """Return the last good result with an extruder, and whether its heights hold."""
        last = self.of_tools.get(extruder)
        if last is None:
            return None, False
        return last.result, not self.datum.moved_since(last.mark)

    def correct(self, switch_offset: float, z_offset: float) -> None:
        """Have the offset in force (mm) be that of the last run with another switch_offset."""
        last = self.last
        assert last is not None
        change = last.result.switch_offset - switch_offset
        corrected = last.result._replace(
            switch_offset=switch_offset, offset=last.result.offset + change
        )
        # What offset_gcode adds is no part of it
        added = last.applied - last.z_offset
        self.last = self.of_tools[last.extruder] = last.replace(
            result=corrected,
            z_offset=z_offset - added,
            applied=z_offset,
            earlier_offsets=(*last.earlier_offsets, last.applied),
        )

    ##################################################################
    # Whether it holds
    ##################################################################

    def invalid_reason(
        self, besides: Container[str] = (), datum_besides: str = ""
    ) -> str:
        """Return why the last result does not hold, empty: it does.

        'besides' are kinds, see the top, that are not looked at; 'datum_besides' of the words
        of datum.py.  Never pauses.
        """
        if self.last is None:
            return "not calibrated yet"
        for kind, reason in self._reasons(self.last, datum_besides):
            if reason and kind not in besides:
                return reason
        return ""

    def _reasons(
        self, last: LastRun, datum_besides: str
    ) -> Iterator[Tuple[str, str]]:
        yield DATUM, self.datum.moved_since(last.mark, datum_besides)
        yield MESH, self._other_height(last)
        yield HEAT, self._other_heat(last)
        yield TOOL, self.other_tool(last)
        yield G92, self._moved_by_g92()
        yield OFFSET, self._other_offset(last)

    def _other_height(self, last: LastRun) -> str:
        transforms, (x, y) = self.host.transforms, last.point
        if transforms.is_mesh_guessed(x, y) and not last.guessed:
            return (
                f"bed_mesh ends before {x:.1f}, {y:.1f}, where CALIBRATE_Z has measured,"
                f" and its zero is elsewhere; set {transforms.mesh_zero_option()} of"
                " section 'bed_mesh' there"
            )
        height = height_of(self.host, last)
        if abs(height - last.height) <= SAME_HEIGHT:
            return ""
        return (
            f"{transforms.mesh_name()} is {height:.3f} mm at {x:.1f}, {y:.1f} and was"
            f" {last.height:.3f} mm there after CALIBRATE_Z; run that when the mesh is"
            " loaded"
        )

    def _other_heat(self, last: LastRun) -> str:
        if self.host.transforms.heat_settings() == last.heat:
            return ""
        return (
            "SET_Z_THERMAL_ADJUST has moved Z=0 since CALIBRATE_Z; run it before"
            " that"
        )

    def other_tool(self, last: LastRun) -> str:
        """Return why another nozzle is active, in words; empty: it is not."""
        active = self.host.extruder()
        if active == last.extruder:
            return ""
        return (
            f"{active} is active, and CALIBRATE_Z was run with {last.extruder}"
        )

    def _moved_by_g92(self) -> str:
        moved = self.host.gcode_state.moved_by_g92()
        if abs(moved) < SAME_OFFSET:
            return ""
        return f"G92 has moved Z=0 by {moved:.3f} mm; G28 undoes that"

    def _other_offset(self, last: LastRun) -> str:
        """Return why another G-code offset is in force.

        Where offset_gcode makes another one of what was measured, or sets it later, either
        will do.
        """
        offset = self.host.gcode_state.z_offset()
        apart = min(abs(offset - z) for z in (last.applied, last.z_offset))
        if apart < SAME_OFFSET:
            return ""
        return (
            f"the G-code Z offset is {offset:.3f}, that of CALIBRATE_Z is"
            f" {last.applied:.3f}: changed by baby steps, SET_GCODE_OFFSET, RESUME or"
            " RESTORE_GCODE_STATE"
        )

    def is_brought_back(self, offset: float) -> bool:
        """Return whether a saved state has brought back a G-code offset (mm) of before.

        That is one of before the last run, or before a correction, such as with RESUME.  It is
        not seen which state was restored: it is one that holds just that offset.
        """
        last = self.last
        if last is None or abs(offset - last.applied) < SAME_OFFSET:
            return False
        saved = self.host.gcode_state.saved_offsets(with_pause=True)
        return any(abs(offset - z) < SAME_OFFSET for z in saved) and any(
            abs(offset - z) < SAME_OFFSET for z in last.earlier_offsets
        )

    def sudden_reason(self) -> Optional[str]:
        """Return why the result has ceased to hold without the user's doing; empty: it has not.

        Homing, levelling and motors that are off end it as expected, for good: None.  Another
        tool, baby steps and an offset that is kept for later are the user's.
        """
        last = self.last
        if last is None or self.invalid_reason((MESH, HEAT, TOOL, G92, OFFSET)):
            return None
        reason = self.invalid_reason((DATUM, TOOL, OFFSET))
        if reason or last.is_for_later or self.other_tool(last):
            return reason
        offset = self.host.gcode_state.z_offset()
        is_step = offset and abs(offset - last.applied) <= LARGEST_STEP
        if is_step and not self.is_brought_back(offset):
            return ""
        return self._other_offset(last)

    ##################################################################
    # Status
    ##################################################################

    def status(self) -> Dict[str, Any]:
        """Return the fields of get_status().

        'last_query' and 'last_z_offset' as upstream has them; for end_gcode the heights are
        of the run that is under way.
        """
        last, shown = self.last, self.measured or self.last
        reason = "not applied yet" if self.measured else self.invalid_reason()
        is_measured = not self.measured and not self.invalid_reason((OFFSET,))
        return {
            "last_query": self.is_good,
            "last_z_offset": shown.z_offset if shown else 0.0,
            "last_result": dict(shown.result._asdict()) if shown else {},
            "measured": is_measured,
            "valid": not reason,
            "reason": reason,
            "warnings": [w.text for w in last.warnings] if last else [],
            "uncertainty": last.uncertainty if last else None,
            "z_adjust": last.z_adjust if last else 0.0,
            "applied": last.applied if last else 0.0,
        }
