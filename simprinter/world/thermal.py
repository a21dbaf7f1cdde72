"""Thermal growth, mm, as a function of printer time in seconds."""

from __future__ import annotations

import math

from .spec import DriftSpec


class Drift:
    """How far each part has grown; signs as in DriftSpec."""

    __slots__ = ("_spec", "_total_rate", "active")

    def __init__(self, spec: DriftSpec) -> None:
        self._spec = spec
        rates = (spec.nozzle, spec.pin, spec.bed, spec.body)
        self._total_rate = sum(abs(rate) for rate in rates)
        self.active = self._total_rate > 0.0

    def elapsed(self, t: float) -> float:
        """Seconds of growth up to time t, at its first speed."""
        spec = self._spec
        elapsed = max(0.0, min(t, spec.stop) - spec.start)
        if math.isinf(spec.tau):
            return elapsed
        return spec.tau * -math.expm1(-elapsed / spec.tau)

    def bound(self, t: float) -> float:
        """No contact height has moved by more than this, mm."""
        return self._total_rate * self.elapsed(t) if self.active else 0.0

    def nozzle(self, t: float) -> float:
        """mm the tip hangs below the cold tip."""
        return self._spec.nozzle * self.elapsed(t) if self.active else 0.0

    def pin(self, t: float) -> float:
        """mm the pin has risen."""
        return self._spec.pin * self.elapsed(t) if self.active else 0.0

    def bed(self, t: float) -> float:
        """mm the plate has risen."""
        return self._spec.bed * self.elapsed(t) if self.active else 0.0

    def body(self, t: float) -> float:
        """mm the probe's body hangs lower."""
        return self._spec.body * self.elapsed(t) if self.active else 0.0
