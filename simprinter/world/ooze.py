"""Plastic below the nozzle, mm, as touches and time leave it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Optional

from .spec import OozeSpec

# Share that a touch leaves of what a hand has smeared on
KEPT = 0.7


class Ooze:
    """How far it hangs below the tip; nothing without a spec or a hand."""

    __slots__ = ("_height", "_since", "_spec", "highest")

    def __init__(self, spec: Optional[OozeSpec]) -> None:
        self._spec = spec
        self.highest = 0.0 if spec is None else spec.height
        self._height = self.highest
        self._since = 0.0

    def height(self, t: float) -> float:
        """At time t, which is not before the last change."""
        if self._spec is None:
            return self._height
        grown = self._spec.rate * max(0.0, t - self._since)
        return min(self.highest, self._height + grown)

    def flatten(self, t: float) -> None:
        """A touch of something hard has just ended."""
        kept = KEPT if self._spec is None else self._spec.kept
        self._set(t, self.height(t) * kept)

    def smear(self, t: float, height: float) -> None:
        """A hand leaves so much of it at time t; 0: wipes it off."""
        self.highest = max(self.highest, height)
        self._set(t, height)

    def observe(self, t: float, pose: Sequence[float]) -> None:
        """The toolhead is at `pose`, perhaps at the brush."""
        spec = self._spec
        if spec is None or not spec.radius:
            return
        if math.hypot(pose[0] - spec.x, pose[1] - spec.y) <= spec.radius:
            self._set(t, 0.0)

    def _set(self, t: float, height: float) -> None:
        self._height, self._since = height, t
