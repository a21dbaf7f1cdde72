"""Shows a printer's console, and what its machine touches, as it happens."""

from __future__ import annotations

from collections.abc import Callable

from .world import Touch, Truth


class Shown:
    """Takes part in a simulation like an API client that only listens."""

    def __init__(
        self,
        lines: list[str],
        show: Callable[[str], None],
        truth: Truth | None = None,
    ):
        """lines: the console, which grows. show: takes each new line.

        truth: of the machine, where its contacts are to be shown, too.
        """
        self._lines = lines
        self._shown = len(lines)
        self._show = show
        self._touches = [] if truth is None else truth.touches
        self._touched = len(self._touches)

    def fileno(self) -> int:
        """There is nothing to wait for."""
        return -1

    def pump(self) -> bool:
        """Show what is new. Nobody else has to be told."""
        for touch in self._touches[self._touched :]:
            self._show(told(touch))
        self._touched = len(self._touches)
        for line in self._lines[self._shown :]:
            self._show(line)
        self._shown = len(self._lines)
        return False

    def settled(self) -> bool:
        """Never holds up the time."""
        return True


def told(touch: Touch) -> str:
    """One contact: when (s), what, where (world frame, mm)."""
    return (
        f"[{touch.t:9.3f} s] contact {touch.site} at x={touch.x:.3f}"
        f" y={touch.y:.3f} trigger={touch.trigger_z:.4f}"
    )
