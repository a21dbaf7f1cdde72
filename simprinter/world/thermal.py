"""Thermal growth, mm, as a function of printer time in seconds.

That of the nozzle follows its heater besides.

Parts that a hand has exchanged for others are in it, too: as growth at once.
"""

from __future__ import annotations

import math
from typing import Optional

from .spec import DriftSpec, HotendSpec


class Drift:
    """How far each part has grown; signs as in DriftSpec."""

    __slots__ = (
        "_bed",
        "_cold",
        "_heated",
        "_hotend",
        "_longer",
        "_nozzle",
        "_slack",
        "_spec",
        "_total_rate",
        "active",
    )

    def __init__(
        self, spec: DriftSpec, hotend: Optional[HotendSpec] = None
    ) -> None:
        self._spec = spec
        self._hotend = hotend
        # Of the hotend: its first temperature, C; when it was told last, and by
        # how much the nozzle was longer then, mm
        self._cold: Optional[float] = None
        self._heated = self._longer = 0.0
        rates = (spec.nozzle, spec.pin, spec.bed, spec.body)
        self._total_rate = sum(abs(rate) for rate in rates)
        self.active = self._total_rate > 0.0
        # mm by which the parts of now differ from those at first, and by which
        # contacts may be elsewhere for that
        self._nozzle = self._bed = self._slack = 0.0

    def exchange_nozzle(self, lower: float) -> None:
        """Another one, which hangs so many mm lower than that at first."""
        self._nozzle = lower
        self.allow(abs(lower))

    def exchange_plate(self, higher: float) -> None:
        """Another one, so many mm higher than that at first."""
        self._bed = higher
        self.allow(abs(higher))

    def allow(self, mm: float) -> None:
        """Contacts may be elsewhere by that much more, from now on."""
        self._slack += mm
        self.active = self.active or self._slack > 0.0

    def heat(self, t: float, celsius: float) -> None:
        """The hotend has that temperature at time t, and had it since it was told last."""
        if self._hotend is None:
            return
        if self._cold is None:
            self._cold = celsius
        wanted = self._hotend.growth * (celsius - self._cold) / 100.0
        share = 1.0
        if self._hotend.lag:
            share = -math.expm1((self._heated - t) / self._hotend.lag)
        change = (wanted - self._longer) * share
        self._heated = t
        self._longer += change
        self.allow(abs(change))

    def elapsed(self, t: float) -> float:
        """Seconds of growth up to time t, at its first speed."""
        spec = self._spec
        elapsed = max(0.0, min(t, spec.stop) - spec.start)
        if math.isinf(spec.tau):
            return elapsed
        return spec.tau * -math.expm1(-elapsed / spec.tau)

    def bound(self, t: float) -> float:
        """No contact height has moved by more than this, mm."""
        if not self.active:
            return 0.0
        return self._slack + self._total_rate * self.elapsed(t)

    def nozzle(self, t: float) -> float:
        """mm the tip hangs below the cold tip."""
        if not self.active:
            return 0.0
        hot = self._nozzle + self._longer
        return hot + self._spec.nozzle * self.elapsed(t)

    def pin(self, t: float) -> float:
        """mm the pin has risen."""
        return self._spec.pin * self.elapsed(t) if self.active else 0.0

    def bed(self, t: float) -> float:
        """mm the plate has risen."""
        if not self.active:
            return 0.0
        return self._bed + self._spec.bed * self.elapsed(t)

    def body(self, t: float) -> float:
        """mm the probe's body hangs lower."""
        return self._spec.body * self.elapsed(t) if self.active else 0.0
