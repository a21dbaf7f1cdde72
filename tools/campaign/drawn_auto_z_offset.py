"""Random printers with [auto_z_offset], and what AUTO_Z_CALIBRATE has to do."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Optional

from hypothesis import strategies as st

from simprinter import Scene
from simprinter.world import (
    BedSensorSpec,
    InductiveSpec,
    NoiseSpec,
    Touch,
)
from tools.campaign.drawing import around, drawn_like, noises, often
from tools.campaign.drawn import (
    NOT_UP,
    OFFSETS_OF_WRONG_SIGN,
    Drawn,
    Mistake,
    other,
    sticky,
    wrong_sense,
)
from tools.campaign.drawn_machines import (
    Homing,
    Plate,
    Sampling,
    with_gantry,
    with_options,
)
from tools.campaign.gap_bounds import (
    MEDIAN,
    SIGMAS,
    Interval,
    frame_bound,
    may_differ,
    variance,
)
from tools.kit.scenes import SCENES

_PLATE = 245.0
_DRIVER = {"run_current": "0.8", "sense_resistor": "0.110"}
_MAX_Z_ACCEL = 500.0
# Within so much (mm) of the trigger the toolhead must be able to stop
_BRAKING = 0.9
# From here on (mm) the probe may be said to see the bed elsewhere
_STALE = 0.1
# Of the Z axis, mm
_POSITION_MIN = -4.0
# The toolhead clears the bed by so much (mm) at least: SMALLEST_HOP but for what
# the probe's z_offset may be off
_CLEAR = 1.0


@dataclass(frozen=True)
class Probe:
    """An inductive one, mm. configured: its z_offset in the file."""

    x: float = 17.6
    y: float = 4.4
    distance: float = 1.2713
    configured: float = 0.0
    noise: NoiseSpec = NoiseSpec()


@dataclass(frozen=True)
class Sensor:
    """Below the bed. is_switched: only while an output is on."""

    press: float = 0.04
    noise: NoiseSpec = NoiseSpec(latency=0.002)
    is_switched: bool = True


@dataclass(frozen=True)
class Options:
    """Of [auto_z_offset]; None: left out. mm, mm/s^2.

    saved: by how much a saved correction is too large; None: there is none.
    """

    z_offset: float = 0.2
    probe_hop: float = 5.0
    probe_accel: float = 50.0
    cycles: int = 3
    current_factor: Optional[float] = None
    has_drivers: bool = True
    shakes: bool = True
    saved: Optional[float] = None


_MISTAKES: dict[str, Mistake] = {
    "offsets of wrong sign": OFFSETS_OF_WRONG_SIGN,
    "sensor inverted": wrong_sense("auto_z_offset", "pin", "bed_sensor"),
    "sensor off": other("auto_z_offset", prepare_gcode=""),
    # Nothing is wired to it
    "another pin": other("auto_z_offset", pin="PC9"),
    "probe inverted": wrong_sense("probe", "pin", "probe"),
    "beside the bed": other(
        "auto_z_offset",
        bed_xy_position=lambda printer: f"{printer.bed[0]:g}, 250",
    ),
    "no room above": other("z", position_max="6", **NOT_UP),
    # Above where the sensor triggers
    "floor above the bed": other(
        "auto_z_offset",
        probe_z_min=lambda printer: (
            f"{printer.correction - printer.options.z_offset + 0.3:g}"
        ),
    ),
    "sticky sensor": sticky(
        "bed_sensor", lambda printer: printer.options.probe_hop
    ),
    "another correction saved": other(
        "auto_z_offset",
        probe_z_correction=lambda printer: f"{printer.correction + 2.0:.6f}",
    ),
}


@dataclass(frozen=True)
class AutoZOffset(Drawn):
    """The qidi scene. homed_over: by the probe; None: what is measured."""

    plate: Plate = Plate(z=0.3137)
    bed: tuple[float, float] = (120.0, 127.0)
    probe: Probe = Probe()
    sensor: Sensor = Sensor()
    homing: Homing = Homing(second_speed=5.0, retract=5.0)
    homed_over: Optional[tuple[float, float]] = None
    sampling: Sampling = Sampling(1, "average", 0.025, 1, 5.0, 3.0)
    options: Options = Options()

    module = "auto_z_offset"
    command = "AUTO_Z_CALIBRATE"
    final = ("nozzle_bed", "inductive_bed")
    mistakes = _MISTAKES

    @classmethod
    def printers(cls, kinematics: tuple[str, ...]) -> st.SearchStrategy:
        middle = around(120.0, 80.0, 170.0, 1.0)
        return drawn_like(
            cls(),
            kinematics,
            (3, 10.0),
            {
                "bed": st.tuples(middle, around(127.0, 80.0, 170.0, 1.0)),
                "probe": _probes(),
                "sensor": _sensors(),
                "homing": st.builds(
                    Homing,
                    speed=around(8.0, 2.0, 12.0, 0.1),
                    second_speed=around(5.0, 1.0, 8.0, 0.1),
                    retract=around(5.0, 4.0, 6.0, 0.1),
                ),
                "homed_over": often(None, st.tuples(middle, middle)),
            },
            _options(),
            ("bed_sensor", "probe"),
        ).map(cls._possible)

    def _possible(self) -> AutoZOffset:
        """The same without what contradicts itself.

        The toolhead stops 4 mm above Z=0 in prepare_gcode, so the bed has to be
        lower; and within reach of position_min.
        """
        probe, mistake = self.probe, self.mistake
        highest = min(probe.configured, round(probe.distance + 1.0, 1))
        if mistake == "sensor off" and not self.sensor.is_switched:
            mistake = ""
        probe = replace(probe, configured=highest)
        return replace(self, probe=probe, mistake=mistake)

    @property
    def probe_head(self) -> tuple[float, float]:
        """Where the toolhead stands for the probe to see the measured point."""
        return self.bed[0] - self.probe.x, self.bed[1] - self.probe.y

    @property
    def homed_at(self) -> tuple[float, float]:
        """The point of the bed that Z is homed over, mm."""
        return self.homed_over or self.bed

    @property
    def sensor_accel(self) -> float:
        """What limits a touch of the sensor, mm/s^2."""
        return min(_MAX_Z_ACCEL, self.options.probe_accel or _MAX_Z_ACCEL)

    @property
    def correction(self) -> float:
        """The right one, mm, but for latency."""
        probe = self.probe
        lower = probe.distance - probe.configured + self.sensor.press
        return self.options.z_offset - lower

    # The configuration

    def healthy(self) -> Scene:
        scene = with_gantry(self._with_sections(SCENES["qidi"]), self.gantry)
        scene = self._with_drivers(self._with_world(scene))
        if not self.sensor.is_switched:
            wiring = replace(scene.wiring, outputs={})
            sections = {**scene.sections, "output_pin bed_sensor": None}
            scene = replace(scene, wiring=wiring, sections=sections)
        return scene

    def _with_sections(self, scene: Scene) -> Scene:
        probe, (x, y) = self.probe, self.homed_at
        changes: dict[str, Mapping[str, Optional[str]]] = {
            "stepper_z": self.homing.options(),
            "probe": {
                "x_offset": f"{probe.x:g}",
                "y_offset": f"{probe.y:g}",
                "z_offset": f"{probe.configured:g}",
            },
            "safe_z_home": {
                "home_xy_position": f"{x - probe.x:g}, {y - probe.y:g}"
            },
            "auto_z_offset": self._calibration(),
        }
        for name, texts in changes.items():
            scene = with_options(scene, name, **texts)
        return scene

    def _calibration(self) -> dict[str, Optional[str]]:
        options = self.options
        texts = {
            "bed_xy_position": "%g, %g" % self.bed,
            "z_offset": f"{options.z_offset:g}",
            "probe_accel": f"{options.probe_accel:g}",
            "probe_hop": f"{options.probe_hop:g}",
            "offset_samples": f"{options.cycles}",
            **self.sampling.options(),
            "prepare_gcode": self._preparation(),
        }
        if options.current_factor is not None:
            texts["z_current_factor"] = f"{options.current_factor:g}"
        if options.saved is not None:
            correction = self.correction + options.saved
            texts["probe_z_correction"] = f"{correction:.6f}"
        return texts

    def _preparation(self) -> str:
        lines = ["G90", "G0 Z4 F900", "M400"]
        if self.options.shakes:
            lines += ["G91", "G1 Z0.6 F7000", "G1 Z-0.6 F7000", "M400", "G90"]
        if self.sensor.is_switched:
            lines.append("SET_PIN PIN=bed_sensor VALUE=1")
        return "".join(f"\n  {line}" for line in lines)

    def _with_drivers(self, scene: Scene) -> Scene:
        """With them, or without."""
        motors, sections = dict(scene.wiring.motors), dict(scene.sections)
        for section in scene.sections:
            if section.startswith(("stepper_z", "stepper my_z")):
                # [stepper_z1] or [stepper my_z1]: its motor is z1
                uart = motors[section.rpartition("_")[2]].uart
                sections[f"tmc2209 {section}"] = {"uart_pin": uart, **_DRIVER}
        if self.options.has_drivers:
            return replace(scene, sections=sections)
        motors = {name: replace(m, uart="") for name, m in motors.items()}
        return replace(scene, wiring=replace(scene.wiring, motors=motors))

    # The truth

    def _with_world(self, scene: Scene) -> Scene:
        probe, sensor, homing = self.probe, self.sensor, self.homing
        fastest = max(homing.speed, homing.second_speed, self.sampling.speed)
        return scene.with_world(
            bed=self.plate.spec(_PLATE),
            inductive=InductiveSpec(
                probe.x, probe.y, probe.distance, probe.noise
            ),
            bed_sensor=BedSensorSpec(
                sensor.press, sensor.is_switched, sensor.noise
            ),
            drift=self.drift,
            overtravel=self.overtravel(fastest, probe.noise, sensor.noise),
        )

    # What a calibration has to do

    @property
    def sites(self) -> dict[str, tuple[tuple[float, float], int]]:
        wanted = self.sampling.samples * self.options.cycles
        return {
            "nozzle_bed": (self.bed, wanted),
            "inductive_bed": (self.probe_head, wanted),
        }

    def place(self, touches: Sequence[Touch]) -> tuple[float, float]:
        """The point of the bed that Z was homed over: the probe's zero."""
        return self.homed_at

    def gaps(
        self, homing: Sequence[Touch], touches: Sequence[Touch], now: float
    ) -> Interval:
        sampling, cycles = self.sampling, self.options.cycles
        probe, sensor = self.probe.noise, self.sensor.noise
        slow = self._sensor_speed(sampling.least_speed(self.sensor_accel))
        fast = self._sensor_speed(sampling.speed)
        late = self._probe_lateness()
        exact = self.options.z_offset + self._unseen(touches)
        retracts = dict.fromkeys(self.sites, sampling.retract)
        # Homing made the frame
        bound = self.bound(touches, retracts, now - homing[0].t)
        # A cycle's share of it is in the correction as well
        bound += frame_bound(self.gantry, touches, retracts) / cycles
        pair = variance(sensor, sampling.samples)
        pair += variance(probe, sampling.samples)
        # Z is homed by one touch of the probe
        bound += SIGMAS * math.sqrt(MEDIAN * pair / cycles + probe.sigma**2)
        bound += self.hidden(
            [*homing, *touches],
            [
                ("nozzle_bed", sensor, sampling.samples),
                ("inductive_bed", probe, sampling.samples),
                ("inductive_bed", probe, 1),
            ],
        )
        return Interval(
            exact - self.scene.piezo_depth(fast) - late,
            exact - self.scene.piezo_depth(slow) + late,
            bound,
        )

    def _sensor_speed(self, speed: float) -> float:
        """Not more than the toolhead can brake from, mm/s."""
        return min(speed, math.sqrt(2.0 * self.sensor_accel * _BRAKING))

    def _probe_lateness(self) -> float:
        """Mm by which homing and measuring may differ, as speeds do."""
        homing = Sampling(
            speed=self.homing.second_speed, retract=self.homing.retract
        )
        speeds = [
            speed
            for sampling in (homing, self.sampling)
            for speed in (sampling.speed, sampling.least_speed(_MAX_Z_ACCEL))
        ]
        return self.probe.noise.latency * (max(speeds) - min(speeds))

    def _unseen(self, touches: Sequence[Touch]) -> float:
        """How much higher (mm) the bed is below the nozzle than where the
        probe was: offsets that are wrong.
        """
        probe, height = self.probe, self.surface.height
        seen = [t for t in touches if t.site == "inductive_bed"][-1]
        return height(*self.bed) - height(seen.x + probe.x, seen.y + probe.y)

    def nominal(self, touch: Touch) -> float:
        if touch.site == "nozzle_bed":
            return self.surface.height(touch.x, touch.y) - self.sensor.press
        probe = self.probe
        x, y = touch.x + probe.x, touch.y + probe.y
        return self.surface.height(x, y) + probe.distance

    def excuses(self) -> list[str]:
        reasons = {
            "samples differ by": self._may_differ(),
            "the probe sees the bed at": self._may_be_stale(),
        }
        return [words for words, may_be in reasons.items() if may_be]

    def _may_be_stale(self) -> bool:
        """Whether the probe may see another height than where Z was homed."""
        noise, height = self.probe.noise, self.surface.height
        homed, bed = self.homed_at, self.bed
        higher = abs(height(*homed) - height(*bed))
        if homed != bed:
            # At most the whole skew
            higher += max(map(abs, self.gantry.skew), default=0.0)
        higher += 2.0 * SIGMAS * noise.sigma + 2.0 * self.gantry.step
        if noise.outlier_chance:
            higher += abs(noise.outlier_size)
        return higher + self._probe_lateness() > _STALE

    def _may_differ(self) -> bool:
        sampling = self.sampling
        probe, sensor = self.probe.noise, self.sensor.noise
        slow = sampling.least_speed(self.sensor_accel)
        late = sensor.latency * (sampling.speed - slow)
        both = NoiseSpec(
            sigma=sensor.sigma + probe.sigma,
            outlier_chance=max(sensor.outlier_chance, probe.outlier_chance),
            outlier_size=max(abs(n.outlier_size) for n in (sensor, probe)),
        )
        # A cycle is the difference of two heights
        return may_differ(both, sampling, 2.0 * self.gantry.step, late)

    def tolerated(self) -> dict[str, float]:
        bed = self.probe.configured - self.probe.distance
        return {"nozzle_bed": bed - _POSITION_MIN}

    def clear_z(self) -> float:
        return self.surface.height(*self.bed) + _CLEAR


def _probes() -> st.SearchStrategy:
    return st.builds(
        Probe,
        x=around(17.6, -30.0, 30.0, 0.5),
        y=around(4.4, -30.0, 30.0, 0.5),
        distance=around(1.2713, 0.6, 3.0, 0.0001),
        configured=around(0.0, 0.0, 3.0, 0.1),
        noise=noises(0.0, 0.002),
    )


def _sensors() -> st.SearchStrategy:
    return st.builds(
        Sensor,
        press=around(0.04, 0.0, 0.3, 0.001),
        noise=noises(0.002, 0.005),
        is_switched=st.sampled_from((True, False)),
    )


def _options() -> st.SearchStrategy:
    return st.builds(
        Options,
        z_offset=around(0.2, -0.1, 0.5),
        probe_hop=around(5.0, 4.0, 8.0, 0.1),
        probe_accel=st.sampled_from((50.0, 0.0, 20.0, 200.0, 500.0)),
        cycles=around(3, 1, 3, 1).map(int),
        current_factor=st.sampled_from((None, 1.0, 0.5, 0.1)),
        has_drivers=st.sampled_from((True, False)),
        shakes=st.sampled_from((True, False)),
        saved=often(None, around(0.0, -0.8, 0.8)),
    )
