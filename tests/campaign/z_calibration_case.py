"""What CALIBRATE_Z on a drawn printer has to do."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tests.campaign.gap_bounds import (
    DIGIT,
    SIGMAS,
    Interval,
    drift_bound,
    frame_bound,
    has_outlier,
    hidden_outlier,
    may_differ,
    seen_bound,
    variance,
)
from tests.campaign.z_calibration_mistakes import scene_of
from tests.campaign.z_calibration_printer import PIN_Y, ZPrinter
from tests.simprinter.world import Bed, Touch

# Of the Z axis, mm
_POSITION_MIN = -5.0


class ZCase:
    """A drawn printer's calibration: what is touched, and what is right."""

    module = "z_calibration"
    command = "CALIBRATE_Z"
    final = ("body_pin", "probe_bed")

    def __init__(self, drawn: ZPrinter) -> None:
        self.drawn = drawn
        self.scene = scene_of(drawn)
        self._bed = Bed(self.scene.world.bed)

    @property
    def sites(self) -> dict[str, tuple[tuple[float, float], int]]:
        """Where the head is to touch each, and how often at least."""
        drawn = self.drawn
        wanted = drawn.pin_samples
        return {
            "nozzle_pin": ((drawn.pin.x, PIN_Y), wanted),
            "body_pin": (drawn.switch_head, wanted),
            "probe_bed": (drawn.probe_head, drawn.sampling.samples),
        }

    def place(self, touches: Sequence[Touch]) -> tuple[float, float]:
        """The point of the bed that was really measured, mm."""
        x, y = touches[-1].x, touches[-1].y
        return x + self.drawn.probe.x, y + self.drawn.probe.y

    def gaps(
        self, homing: Sequence[Touch], touches: Sequence[Touch], now: float
    ) -> Interval:
        """What is right at time now (s), after homing and these touches."""
        drawn, exact = self.drawn, self.scene.formula_gap()
        on_pin = drawn.pin.noise.latency * drawn.homing.second_speed
        on_bed = drawn.probe.noise.latency * drawn.sampling.speed
        retracts = {
            "nozzle_pin": drawn.homing.retract,
            "body_pin": drawn.homing.retract,
            "probe_bed": drawn.sampling.retract,
        }
        bound = seen_bound(drawn.gantry) + DIGIT
        bound += frame_bound(drawn.gantry, touches, retracts)
        bound += drift_bound(drawn.drift, now - touches[0].t)
        bound += self._noise() + self._outliers(touches)
        return Interval(exact - on_bed - on_pin, exact + on_pin, bound)

    def _noise(self) -> float:
        drawn = self.drawn
        on_pin = variance(drawn.pin.noise, drawn.pin_samples)
        on_bed = variance(drawn.probe.noise, drawn.sampling.samples)
        return SIGMAS * math.sqrt(2.0 * on_pin + on_bed)

    def _outliers(self, touches: Sequence[Touch]) -> float:
        drawn, hidden = self.drawn, 0.0
        for name, (_, samples) in self.sites.items():
            of_bed = name == "probe_bed"
            noise = drawn.probe.noise if of_bed else drawn.pin.noise
            here = [touch for touch in touches if touch.site == name]
            if has_outlier(here, noise, self._nominal):
                hidden += hidden_outlier(
                    noise, drawn.sampling, samples, drawn.gantry.step
                )
        return hidden

    def _nominal(self, touch: Touch) -> float:
        """Pose.z at which it triggers without noise or drift, mm."""
        pin, probe = self.scene.world.pin, self.scene.world.mag_probe
        assert pin is not None and probe is not None
        if touch.site == "nozzle_pin":
            return pin.z
        if touch.site == "body_pin":
            return pin.z + probe.body_drop
        x, y = touch.x + probe.x_offset, touch.y + probe.y_offset
        return self._bed.height(x, y) + probe.body_drop + probe.switch_offset

    def excuses(self) -> tuple[str, ...]:
        """Words of reasons for which a healthy printer may be refused."""
        drawn = self.drawn
        noises = (drawn.pin.noise, drawn.probe.noise)
        step = drawn.gantry.step
        if any(may_differ(noise, drawn.sampling, step) for noise in noises):
            return ("samples differ by",)
        return ()

    def tolerated(self) -> dict[str, float]:
        """Mm beyond the trigger that the floors leave to a dead touch."""
        drawn = self.drawn
        reach = max(drawn.options.travel_margin or 1.0, 1.0)
        reach += abs(drawn.pin.believed)
        if drawn.pin.is_own:
            # Nobody knows its height: position_min is the only floor
            reach = drawn.pin.height - _POSITION_MIN + 1.0
        sites = ("nozzle_pin", "body_pin", "nozzle_bed", "body_bed")
        return dict.fromkeys(sites, reach)

    def clear_z(self) -> float:
        """Pose.z (mm) from which the probe touches nothing on the bed."""
        probe = self.scene.world.mag_probe
        assert probe is not None
        hanging = probe.body_drop + probe.switch_offset + probe.pretravel
        return self._bed.height(*self.drawn.bed) + hanging
