"""What AUTO_Z_CALIBRATE on a drawn printer has to do."""

from __future__ import annotations

import math
from collections.abc import Sequence

from tests.campaign.auto_z_offset_mistakes import scene_of
from tests.campaign.auto_z_offset_printer import MAX_Z_ACCEL, PiezoPrinter
from tests.campaign.drawn_machines import Sampling
from tests.campaign.gap_bounds import (
    DIGIT,
    MEDIAN,
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
from tests.simprinter.world import Bed, NoiseSpec, Touch

# Within so much (mm) of the trigger the head must be able to stop
_BRAKING = 0.9
# From here on (mm) the probe may be said to see the bed elsewhere
_STALE = 0.1
# Of the Z axis, mm
_POSITION_MIN = -4.0
# The head clears the bed by so much (mm) at least: SMALLEST_HOP but for what
# the probe's z_offset may be off
_CLEAR = 1.0


class PiezoCase:
    """A drawn printer's calibration: what is touched, and what is right."""

    module = "auto_z_offset"
    command = "AUTO_Z_CALIBRATE"
    final = ("nozzle_bed", "inductive_bed")

    def __init__(self, drawn: PiezoPrinter) -> None:
        self.drawn = drawn
        self.scene = scene_of(drawn)
        self._bed = Bed(self.scene.world.bed)

    @property
    def sites(self) -> dict[str, tuple[tuple[float, float], int]]:
        """Where the head is to touch each, and how often at least."""
        drawn = self.drawn
        wanted = drawn.sampling.samples * drawn.options.cycles
        return {
            "nozzle_bed": (drawn.bed, wanted),
            "inductive_bed": (drawn.probe_head, wanted),
        }

    def place(self, touches: Sequence[Touch]) -> tuple[float, float]:
        """The point of the bed that Z was homed over: the probe's zero."""
        return self.drawn.homed_at

    def gaps(
        self, homing: Sequence[Touch], touches: Sequence[Touch], now: float
    ) -> Interval:
        """What is right at time now (s), after homing and these touches."""
        drawn, sampling = self.drawn, self.drawn.sampling
        slow = self._sensor_speed(sampling.least_speed(drawn.sensor_accel))
        fast = self._sensor_speed(sampling.speed)
        late = self._probe_lateness()
        exact = drawn.options.z_offset + self._unseen(touches)
        retracts = dict.fromkeys(self.sites, sampling.retract)
        frame = frame_bound(drawn.gantry, touches, retracts)
        # A cycle's share of it is in the correction as well
        bound = frame * (1.0 + 1.0 / drawn.options.cycles)
        bound += seen_bound(drawn.gantry) + DIGIT
        # Homing made the frame
        bound += drift_bound(drawn.drift, now - homing[0].t)
        bound += self._noise() + self._outliers([*homing, *touches])
        return Interval(
            exact - self.scene.piezo_depth(fast) - late,
            exact - self.scene.piezo_depth(slow) + late,
            bound,
        )

    def _sensor_speed(self, speed: float) -> float:
        """Not more than the head can brake from, mm/s."""
        return min(speed, math.sqrt(2.0 * self.drawn.sensor_accel * _BRAKING))

    def _probe_lateness(self) -> float:
        """Mm by which homing and measuring may differ, as speeds do."""
        drawn = self.drawn
        homing = Sampling(
            speed=drawn.homing.second_speed, retract=drawn.homing.retract
        )
        speeds = [
            speed
            for sampling in (homing, drawn.sampling)
            for speed in (sampling.speed, sampling.least_speed(MAX_Z_ACCEL))
        ]
        return drawn.inductive.noise.latency * (max(speeds) - min(speeds))

    def _unseen(self, touches: Sequence[Touch]) -> float:
        """How much higher (mm) the bed is below the nozzle than where the
        probe was: offsets that are wrong.
        """
        probe = self.drawn.inductive
        seen = [t for t in touches if t.site == "inductive_bed"][-1]
        probed = self._bed.height(seen.x + probe.x, seen.y + probe.y)
        return self._bed.height(*self.drawn.bed) - probed

    def _noise(self) -> float:
        drawn, samples = self.drawn, self.drawn.sampling.samples
        probe, sensor = drawn.inductive.noise, drawn.piezo.noise
        pair = variance(sensor, samples) + variance(probe, samples)
        # Z is homed by one touch of the probe
        total = MEDIAN * pair / drawn.options.cycles + probe.sigma**2
        return SIGMAS * math.sqrt(total)

    def _outliers(self, touches: Sequence[Touch]) -> float:
        drawn, sampling = self.drawn, self.drawn.sampling
        noises = {
            "nozzle_bed": drawn.piezo.noise,
            "inductive_bed": drawn.inductive.noise,
        }
        hidden = 0.0
        for name, noise in noises.items():
            here = [touch for touch in touches if touch.site == name]
            if not has_outlier(here, noise, self._nominal):
                continue
            hidden += hidden_outlier(
                noise, sampling, sampling.samples, drawn.gantry.step
            )
            if name == "inductive_bed":
                hidden += abs(noise.outlier_size)
        return hidden

    def _nominal(self, touch: Touch) -> float:
        """Pose.z at which it triggers without noise or drift, mm."""
        drawn = self.drawn
        if touch.site == "nozzle_bed":
            return self._bed.height(touch.x, touch.y) - drawn.piezo.press
        probe = drawn.inductive
        x, y = touch.x + probe.x, touch.y + probe.y
        return self._bed.height(x, y) + probe.distance

    def excuses(self) -> tuple[str, ...]:
        """Words of reasons for which a healthy printer may be refused."""
        found = []
        if self._may_differ():
            found.append("samples differ by")
        if self._may_be_stale():
            found.append("the probe sees the bed at")
        return tuple(found)

    def _may_be_stale(self) -> bool:
        """Whether the probe may see another height than where Z was homed."""
        drawn = self.drawn
        noise = drawn.inductive.noise
        homed, bed = drawn.homed_at, drawn.bed
        higher = abs(self._bed.height(*homed) - self._bed.height(*bed))
        if homed != bed:
            # At most the whole skew
            higher += max(map(abs, drawn.gantry.skew), default=0.0)
        higher += 2.0 * SIGMAS * noise.sigma + 2.0 * drawn.gantry.step
        if noise.outlier_chance:
            higher += abs(noise.outlier_size)
        return higher + self._probe_lateness() > _STALE

    def _may_differ(self) -> bool:
        drawn, sampling = self.drawn, self.drawn.sampling
        probe, sensor = drawn.inductive.noise, drawn.piezo.noise
        slow = sampling.least_speed(drawn.sensor_accel)
        late = sensor.latency * (sampling.speed - slow)
        both = NoiseSpec(
            sigma=sensor.sigma + probe.sigma,
            outlier_chance=max(sensor.outlier_chance, probe.outlier_chance),
            outlier_size=max(abs(n.outlier_size) for n in (sensor, probe)),
        )
        # A cycle is the difference of two heights
        return may_differ(both, sampling, 2.0 * drawn.gantry.step, late)

    def tolerated(self) -> dict[str, float]:
        """Mm beyond the trigger that the floor leaves to a dead touch."""
        probe = self.drawn.inductive
        bed = probe.configured - probe.distance
        return {"nozzle_bed": bed - _POSITION_MIN}

    def clear_z(self) -> float:
        """Pose.z (mm) from which the nozzle does not touch the bed."""
        return self._bed.height(*self.drawn.bed) + _CLEAR
