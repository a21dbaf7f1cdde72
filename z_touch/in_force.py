"""What a result was made for, against what is in force now.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Callable, Optional

from .datum import MOTORS_OFF

if TYPE_CHECKING:
    from .datum import Datum, Mark
    from .host.klippy import GCodeCommand, Handler
    from .host.printer import Host

# RESUME sends it, too
COMMAND = "RESTORE_GCODE_STATE"

# A change of the G-code Z offset of more than this (mm) is no baby step, but another offset
# or a typing error.
LARGEST_STEP = 0.5

# Offsets that differ by less (mm) are the same: the rest is rounding.
NO_STEP = 0.0000005


# How often (s) it is looked whether a result is still in force
LOOK_INTERVAL = 2.0


class InForce:
    """Shows once, on the console, when a result has ceased to hold.

    reason() says why, without pausing; empty: it holds; None: it cannot hold any more, which
    is not worth a line.  settle(), if given, is called when the G-code has ended that applied
    it.
    """

    def __init__(
        self,
        host: Host,
        reason: Callable[[], Optional[str]],
        settle: Optional[Callable[[], None]] = None,
    ):
        self.host = host
        self.reason = reason
        self.settle = settle
        # Older hosts call a timer again that waits
        self.is_looking = False
        self.timer = host.printer.get_reactor().register_timer(
            self._look, host.printer.get_reactor().NEVER
        )

    def begin(self) -> None:
        """Look from now on, as a result was applied: first when its G-code has ended."""
        reactor = self.host.printer.get_reactor()
        reactor.update_timer(self.timer, reactor.NOW)

    def _look(self, eventtime: float) -> float:
        """Look between two commands.  May pause."""
        never = self.host.printer.get_reactor().NEVER
        if self.is_looking:
            return never
        self.is_looking = True
        try:
            return self._next_look()
        finally:
            self.is_looking = False

    def _next_look(self) -> float:
        """Look, and return when to do so again."""
        # Between two commands, as delayed_gcode does: a mesh is cleared before it is probed,
        # and tool changers set an offset of 0 for a moment
        with self.host.gcode.get_mutex():
            if self.host.printer.is_shutdown():
                return self.host.printer.get_reactor().NEVER
            if self.settle is not None:
                self.settle()
            reason = self.reason()
        if reason:
            self.host.say(reason)
        if reason is None or reason:
            return self.host.printer.get_reactor().NEVER
        return self.host.eventtime() + LOOK_INTERVAL


class AppliedOffset:
    """The G-code Z offset that a command has set: shown where it has gone, or Z=0 from it.

    'command' sets it again.  Baby steps are the user's, a print that begins may set it
    later, and where Z is not homed there is nothing that it holds for.
    """

    def __init__(
        self,
        host: Host,
        command: str,
        datum: Datum,
        moved: Callable[[Mark], str],
    ):
        """Take moved(mark), which says what has moved Z=0 so that the offset does not hold."""
        self.host = host
        self.command = command
        self.datum = datum
        self.moved = moved
        # As it was set (mm), and where Z=0 was; None: not since klippy has started
        self.z: Optional[float] = None
        self.mark: Optional[Mark] = None
        # That it has gone with a state
        self.is_shown = False
        self.in_force = InForce(host, self._why_gone)

    def note(self) -> None:
        """Note that it was set, and is in force now."""
        self.z, self.is_shown = self.host.gcode_state.z_offset(), False
        self.mark = self.datum.mark()
        self.in_force.begin()

    def _why_gone(self) -> Optional[str]:
        offset, ours = self.host.gcode_state.z_offset(), self.z
        if self.is_shown:
            return None
        if not self.host.is_homed("z"):
            # As at the end of a print, where macros set 0 and turn the motors off
            return ""
        if not ours or self.mark is None or self.host.begins_print():
            return ""
        if offset and abs(offset - ours) <= LARGEST_STEP:
            return self._why_moved(ours, self.mark)
        return (
            f"the G-code Z offset is {offset:.3f}, and {self.command} has set"
            f" {ours:.3f}: something has set another one since, such as a macro with"
            f" SET_GCODE_OFFSET; {self.command} sets it again"
        )

    def _why_moved(self, ours: float, mark: Mark) -> str:
        """Return why an offset (mm) does not hold that was set at a mark; empty: it does."""
        moved = self.moved(mark)
        # Before homing nothing is printed
        if moved in ("", MOTORS_OFF):
            return ""
        return (
            f"{moved}; the offset of {self.command} was {ours:.3f}; run G28, then"
            f" {self.command} again"
        )

    def watch_states(self) -> None:
        """Show at once when it has gone with a state, also within baby steps of it.

        While klippy starts.  A baby step that is taken back so is none that has gone:
        Klipper's RESUME does that.
        """
        self.host.wrap_command(COMMAND, self._around_state)

    def _around_state(self, command: Handler, gcmd: GCodeCommand) -> None:
        """Run the command; say when our offset has gone with it."""
        before, ours = self.host.gcode_state.z_offset(), self.z
        command(gcmd)
        after = self.host.gcode_state.z_offset()
        if ours is None or abs(after - before) < NO_STEP:
            return
        is_gone = abs(after - ours) >= NO_STEP
        if is_gone and abs(before - ours) <= LARGEST_STEP:
            self.is_shown = True
            name = gcmd.get("NAME", "default")
            self.host.say(
                f"G-code state {name} has brought back the G-code Z offset {after:.3f};"
                f" it was {before:.3f}, from {self.command}; set that again, and save"
                " such a state after it"
            )
