"""How long a thread keeps klippy's main thread from the interpreter.

In lines of Python that it runs: time depends on the machine, and on what else
that does.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from types import FrameType
from typing import Any

# About a millisecond
AT_A_STRETCH = 10_000


class Stretches:
    """What is run between two pauses; lines: of each stretch."""

    def __init__(self) -> None:
        self.lines: list[int] = []
        self._count = 0

    def _trace(self, _frame: FrameType, event: str, _arg: Any) -> Any:
        self._count += event == "line"
        return self._trace

    def pause(self) -> None:
        """The end of a stretch."""
        self.lines.append(self._count)
        self._count = 0

    def count(self, call: Callable[..., Any], *args: Any) -> Any:
        """What the call returns; its end is that of a stretch, too."""
        before = sys.gettrace()
        sys.settrace(self._trace)
        try:
            return call(*args)
        finally:
            sys.settrace(before)
            self.pause()
