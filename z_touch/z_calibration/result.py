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

from ..datum import MOTORS_OFF
from ..in_force import LARGEST_STEP
from .runs import Warned
from .steps import SAME_OFFSET, Steps, is_same

if TYPE_CHECKING:
    from ..datum import Datum, Mark
    from ..host.printer import Host
    from .growth import Growth
    from .heights import Result

# By less (mm) the bed mesh is as high as it was.
SAME_HEIGHT = 0.01

# Two prints do not begin within so many seconds
SAME_PRINT = 1.0

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
    # Where (X and Y, mm) the nozzle has touched the pin with the probe attached, None: it was not
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
    # The baby steps since
    steps: Steps = field(default_factory=lambda: Steps(0.0))
    # A nozzle that prints hotter than it was touched, which is in the offset; None: it is not
    growth: Optional[Growth] = None
    # When the print began that it was made in (eventtime), 0: in none
    print_began: float = 0.0
    # What a tool changer added to Z for that tool (mm), which was taken off
    tool_shift: float = 0.0
    # Height of bed mesh or bed tilt there, when it was applied; whether that is not known;
    # and what was set of what follows a temperature, see transforms.py
    height: float = 0.0
    guessed: bool = False
    heat: Dict[str, Any] = field(default_factory=dict)

    def replace(self, **changes: Any) -> LastRun:
        """Return the run with other values."""
        return dataclasses.replace(self, **changes)

    @property
    def grown(self) -> float:
        """What the offset is larger by (mm) as the nozzle will print hotter."""
        return self.growth.added if self.growth else 0.0

    def applied_at(self, celsius: float) -> float:
        """Return the offset (mm) that would be right for a nozzle as hot as that."""
        if self.growth is None:
            return self.applied
        return self.applied - self.grown + self.growth.longer(celsius)


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
        # What SET_GCODE_OFFSET Z=... has set (mm) in place of ours, with the steps since;
        # None: nothing
        self.replaced: Optional[Steps] = None

    def note(self, measured: Optional[LastRun]) -> None:
        """Show the run that is under way; None: it has not measured yet, or there is none."""
        self.measured = measured
        self.is_good = measured is not None

    def keep(self, last: LastRun) -> None:
        """Keep a run that has ended well."""
        self.last = self.of_tools[last.extruder] = last
        self.measured, self.is_good = None, True
        self.replaced = None

    ##################################################################
    # The G-code offset
    ##################################################################

    def settle(self) -> None:
        """Have baby steps count from what is in force, as the G-code has ended that set it.

        With another nozzle active by now it is what that G-code has made of ours before.
        """
        last = self.current()
        if last is None or last.steps.is_settled:
            return
        offset = self.host.gcode_state.z_offset()
        if self.other_tool(last):
            offset = last.steps.latest
        elif self.is_replaced():
            offset = last.applied
        last.steps.settle(offset)

    def note_offset(self, before: float, is_absolute: bool) -> bool:
        """Note what SET_GCODE_OFFSET has made of an offset (mm): a step, or another one.

        What the file of a print adds is no step.  Returns whether it has set ours again.
        """
        offset = self.host.gcode_state.z_offset()
        last = self.current(offset if is_absolute else before)
        if is_absolute:
            is_ours = last is not None and is_same(offset, last.applied)
            is_known = last is not None and last.steps.has(offset)
            self.replaced = None if is_ours or is_known else Steps(offset)
            if is_ours and last is not None:
                last.steps.begin()
            return is_ours
        if is_same(offset, before):
            return False
        if self.replaced is not None and self.replaced.has(before):
            self.replaced.add(offset)
        elif last is not None and not self.other_tool(last):
            if last.is_for_later and not last.steps.has(before):
                return False
            if self.host.runs_file():
                last.steps.move(before, offset)
            else:
                last.steps.add(offset)
        return False

    def is_replaced(self) -> bool:
        """Return whether SET_GCODE_OFFSET Z=... has set what is in force: no baby step."""
        offset = self.host.gcode_state.z_offset()
        return self.replaced is not None and self.replaced.has(offset)

    def correct(self, switch_offset: float) -> None:
        """Have the offset in force be that of the result with another switch_offset (mm)."""
        last = self.current()
        assert last is not None
        change = last.result.switch_offset - switch_offset
        result = last.result._replace(
            switch_offset=switch_offset, offset=last.result.offset + change
        )
        # What the G-code has added that has applied it is no part of it
        offset = self.host.gcode_state.z_offset()
        step = offset - last.steps.base
        steps = Steps(last.applied + step)
        steps.add(offset)
        steps.settle(offset)
        corrected = last.replace(
            result=result,
            z_offset=last.z_offset + step,
            applied=last.applied + step,
            steps=steps,
        )
        if self.last is last:
            self.last = corrected
        self.of_tools[last.extruder] = corrected
        self.replaced = None

    ##################################################################
    # Which result
    ##################################################################

    def current(self, offset: Optional[float] = None) -> Optional[LastRun]:
        """Return the result that should be in force: of the active nozzle, or the last one.

        Where a tool changer adds what its tools differ by, the last one is for all of them,
        unless the G-code offset (mm, None: that of now) is that of the tool's own.
        """
        own, last = self.of_tools.get(self.host.tools.active()), self.last
        if own is None or last is None or own is last:
            return own or last
        if not self._is_for_all(last):
            return own
        if offset is None:
            offset = self.host.gcode_state.z_offset()
        is_own = own.steps.has(offset) and not last.steps.has(offset)
        holds = not self.datum.moved_since(own.mark)
        return own if is_own and holds else last

    def _is_for_all(self, last: LastRun) -> bool:
        """Return whether a tool changer adds what its tools differ by."""
        shifts = [shift for _, shift in self.host.tools.of_changer()]
        return bool(shifts) and any([last.tool_shift, *shifts])

    def earlier(self, extruder: str) -> Tuple[Optional[Result], bool]:
        """Return the last good result with an extruder, and whether its heights hold."""
        last = self.of_tools.get(extruder)
        if last is None:
            return None, False
        return last.result, not self.datum.moved_since(last.mark)

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
        last = self.current()
        if last is None:
            return "not calibrated yet"
        for kind, reason in self._reasons(last, datum_besides):
            if reason and kind not in besides:
                return reason
        return ""

    def _reasons(
        self, last: LastRun, datum_besides: str
    ) -> Iterator[Tuple[str, str]]:
        yield DATUM, self.datum.moved_since(last.mark, datum_besides)
        yield MESH, self._other_height(last)
        yield HEAT, self._other_heat(last)
        yield TOOL, self.other_tool(last) or self._other_shift(last)
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
        moved = self.host.transforms.heat_moved(last.heat)
        if abs(moved) <= SAME_HEIGHT:
            return ""
        return (
            f"SET_Z_THERMAL_ADJUST has moved Z=0 by {moved:.3f} mm since CALIBRATE_Z; run"
            " it before that"
        )

    def other_tool(self, last: LastRun) -> str:
        """Return why another nozzle is active, in words; empty: it is not.

        Not where a tool changer adds what its tools differ by.
        """
        active = self.host.tools.active()
        if active == last.extruder or self._is_for_all(last):
            return ""
        return (
            f"{active} is active, and CALIBRATE_Z was run with {last.extruder}"
        )

    def _other_shift(self, last: LastRun) -> str:
        """Return why the tool changer shifts the same tool by something else, in words."""
        for name, shift in self.host.tools.of_changer():
            if name == last.extruder and abs(shift - last.tool_shift) > (
                SAME_HEIGHT
            ):
                return (
                    f"gcode_z_offset of section '{name}' is {shift:.3f} and was"
                    f" {last.tool_shift:.3f} at CALIBRATE_Z; run that again"
                )
        return ""

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

    def sudden_reason(self) -> Optional[str]:
        """Return why the result has ceased to hold, with its number; empty: it has not.

        Motors that are off end it as expected, after each print: None.  The start of a
        print may end the result of one before: that is told if no CALIBRATE_Z has come by
        the time it extrudes.  Baby steps, and an offset that is kept for later, are the
        user's.
        """
        last = self.current()
        moved = self.datum.moved_since(last.mark) if last else MOTORS_OFF
        if last is None or moved == MOTORS_OFF:
            return None
        if self.host.begins_print() and not self._is_of_this_print(last):
            return ""
        reason = self.invalid_reason((OFFSET,))
        if reason:
            return f"{reason}; the offset of CALIBRATE_Z was {last.applied:.3f}"
        if last.is_for_later or self._is_stepped(last):
            return ""
        return self._other_offset(last)

    def _is_of_this_print(self, last: LastRun) -> bool:
        """Return whether a run was made in the print that is under way."""
        return abs(self.host.print_began() - last.print_began) < SAME_PRINT

    def _is_stepped(self, last: LastRun) -> bool:
        """Return whether the offset in force differs by baby steps at most."""
        offset, base = self.host.gcode_state.z_offset(), last.steps.base
        is_near = abs(offset - base) <= LARGEST_STEP and bool(
            offset or not base
        )
        return last.steps.has(offset) and is_near

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
