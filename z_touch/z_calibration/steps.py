"""Baby steps: which G-code offset they count from, and which ones they have led to.

A user judges the first layer, and raises or lowers the nozzle by SET_GCODE_OFFSET
Z_ADJUST=...  What is in force when the G-code has ended that applied an offset is the base,
as that may have added something for a plate:

  applied -> Z_ADJUST of the macro -> base -> Z_ADJUST of the user -> in force

An offset that is none of these was set by SET_GCODE_OFFSET Z=..., or brought back by a
saved state, as RESUME does: it is no baby step.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import List, Optional

# Offsets that differ by less (mm) are the same, but for their digits: a macro that sets one
# again writes three of them
SAME_OFFSET = 0.0006


def is_same(one: float, other: float) -> bool:
    """Return whether two offsets (mm) are the same."""
    return abs(one - other) < SAME_OFFSET


class Steps:
    """The offsets (mm) that an applied one has become since."""

    def __init__(self, applied: float):
        self.applied = applied
        # What steps count from; None: the G-code is under way that has applied it
        self._base: Optional[float] = None
        # Those that Z_ADJUST has led to
        self._known: List[float] = [applied]

    @property
    def base(self) -> float:
        """What baby steps count from."""
        return self.applied if self._base is None else self._base

    @property
    def is_settled(self) -> bool:
        """Whether the G-code has ended that has applied it."""
        return self._base is not None

    def begin(self) -> None:
        """Begin anew, as the offset is set again."""
        self._base, self._known = None, [self.applied]

    def settle(self, offset: float) -> None:
        """Count from the offset in force; from the applied one where that was lost."""
        self._base = offset if self.has(offset) else self.applied
        self._known = [self._base]

    def add(self, offset: float) -> None:
        """Note that Z_ADJUST has led to an offset."""
        self._known.append(offset)

    @property
    def latest(self) -> float:
        """The last one that Z_ADJUST has led to."""
        return self._known[-1]

    def move(self, before: float, offset: float) -> None:
        """Count from elsewhere, as the file of a print has added something."""
        if self._base is not None:
            self._base += offset - before
        self._known.append(offset)

    def has(self, offset: float) -> bool:
        """Return whether an offset comes of the applied one, by nothing but Z_ADJUST."""
        return any(is_same(offset, known) for known in self._known)
