"""Whether the probe stays attached between two commands, or is docked, at once or later.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Callable, Optional

from .. import attached

if TYPE_CHECKING:
    from ..host.printer import Host

# With allow_delayed_detach the probe is docked so long (s) after its last use.
DETACH_DELAY = 1.0

# After these the motors may be off, and the boards may have forgotten their pins.
ENDED_BY = (
    "stepper_enable:motor_off",
    "gcode:request_restart",
    "klippy:shutdown",
    "klippy:disconnect",
)


class Keeping:
    """What becomes of the probe when a command has used it.

    auto: commands fetch and dock it by themselves.  is_held: ATTACH_PROBE has attached it to
    stay, times_held how often.  at_once: it is docked at the end of each session, whatever
    else, as the nozzle is lowered next.
    """

    def __init__(self, host: Host, auto: bool, dock: Callable[[], Any]):
        """'dock' docks the probe and goes back; it may pause."""
        self.host = host
        self.auto = auto
        self.is_held, self.times_held = False, 0
        self.at_once = False
        self._dock = dock
        # A mark of the docking that is to come, None: none is
        self._mark: Optional[object] = None
        for event in ENDED_BY:
            host.printer.register_event_handler(event, self.cancel)

    def hold(self, is_held: bool) -> None:
        """Note whether it is attached to stay; a docking that was to come is called off."""
        self.cancel()
        self.is_held = is_held
        self.times_held += is_held

    def lose(self) -> None:
        """Note that it was found in its dock, however it came there."""
        self.is_held = False

    def set_auto(self, auto: bool) -> None:
        """Switch going to the dock by itself on or off."""
        self.auto = auto
        if not auto:
            self.cancel()

    def lets_go(self) -> bool:
        """Return whether it is docked when a command has used it."""
        return self.auto and not self.is_held

    ##################################################################
    # Docking that is to come
    ##################################################################

    def is_pending(self) -> bool:
        """Return whether a docking is to come."""
        return self._mark is not None

    def cancel(self, *_unused: Any) -> None:
        """Call it off; some events come with a print time."""
        self._mark = None

    def start(self) -> None:
        """Dock it in a while, unless another command needs the probe before."""
        self._mark = object()
        self._wait(self._mark)

    def hurry(self) -> None:
        """Dock it now, where that is to come.  May pause."""
        if self._mark is not None:
            self._mark = None
            self._dock()

    def end(self, dock: Callable[[], Any]) -> None:
        """Dock it now by 'dock', where that is to come; an error is shown.  May pause."""
        if self._mark is not None:
            self._mark = None
            self._show_error(dock)

    def _wait(self, mark: object) -> None:
        def due(_eventtime: float) -> None:
            """Dock the probe now; a callback of the reactor.  May pause."""
            self._due(mark)

        reactor = self.host.printer.get_reactor()
        reactor.register_callback(due, reactor.monotonic() + DETACH_DELAY)

    def _due(self, mark: object) -> None:
        with self.host.gcode.get_mutex():
            if self._mark is not mark:
                return
            if attached.of(self.host.printer).is_asking(self.host):
                # A hand may be near the toolhead
                self._wait(mark)
                return
            self._show_error(self.hurry)

    def _show_error(self, dock: Callable[[], Any]) -> None:
        # There is no command that an error could be of
        try:
            dock()
        except self.host.printer.command_error as e:
            self.host.gcode.respond_raw(f"!! {e}")
