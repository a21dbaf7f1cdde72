"""A printer with [auto_z_offset]: its truth and its configuration."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass, field
from typing import Optional

from tests.campaign.drawn_machines import (
    GIVE,
    OTHER_BOARD_STOPS,
    Gantry,
    Plate,
    Sampling,
    with_gantry,
    with_options,
)
from tests.simprinter import SCENES, Scene
from tests.simprinter.world import (
    BedSensorSpec,
    DriftSpec,
    InductiveSpec,
    NoiseSpec,
)

_PLATE = 245.0
_DRIVER = {"run_current": "0.8", "sense_resistor": "0.110"}
MAX_Z_ACCEL = 500.0


@dataclass(frozen=True)
class Inductive:
    """The probe, mm. configured: its z_offset in the file."""

    x: float = 17.6
    y: float = 4.4
    distance: float = 1.2713
    configured: float = 0.0
    noise: NoiseSpec = NoiseSpec()


@dataclass(frozen=True)
class Piezo:
    """The sensor below the bed. is_switched: only while an output is on."""

    press: float = 0.04
    noise: NoiseSpec = NoiseSpec(latency=0.002)
    is_switched: bool = True


@dataclass(frozen=True)
class Homing:
    """mm/s and mm; at: what the probe homes over (None: what is measured)."""

    speed: float = 8.0
    second_speed: float = 5.0
    retract: float = 5.0
    at: Optional[tuple[float, float]] = None


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


@dataclass(frozen=True)
class PiezoPrinter:
    """A printer; the defaults are the qidi scene.

    bed: the point that is measured. other_board: the input that is on a board
    of its own, that many s away. offset: G-code Z offset of before.
    """

    gantry: Gantry = Gantry()
    plate: Plate = Plate(z=0.3137)
    bed: tuple[float, float] = (120.0, 127.0)
    inductive: Inductive = Inductive()
    piezo: Piezo = Piezo()
    homing: Homing = Homing()
    sampling: Sampling = Sampling(1, "average", 0.025, 1, 5.0, 3.0)
    options: Options = Options()
    drift: DriftSpec = field(default_factory=DriftSpec)
    other_board: str = ""
    board_latency: float = 0.002
    offset: float = 0.0
    mistake: str = ""
    seed: int = 0

    @property
    def probe_head(self) -> tuple[float, float]:
        """Where the head stands for the probe to see the measured point."""
        probe = self.inductive
        return self.bed[0] - probe.x, self.bed[1] - probe.y

    @property
    def homed_at(self) -> tuple[float, float]:
        """The point of the bed that Z is homed over, mm."""
        return self.homing.at or self.bed

    @property
    def sensor_accel(self) -> float:
        """What limits a touch of the sensor, mm/s^2."""
        return min(MAX_Z_ACCEL, self.options.probe_accel or MAX_Z_ACCEL)

    @property
    def correction(self) -> float:
        """The right one, mm, but for latency."""
        probe = self.inductive
        lower = probe.distance - probe.configured + self.piezo.press
        return self.options.z_offset - lower

    def scene(self) -> Scene:
        """The machine with a configuration without a mistake, on one board."""
        scene = with_gantry(self._with_sections(SCENES["qidi"]), self.gantry)
        scene = self._with_world(scene)
        if self.options.has_drivers:
            scene = _with_drivers(scene)
        else:
            scene = _without_drivers(scene)
        if not self.piezo.is_switched:
            scene = _without_switch(scene)
        return scene

    # The configuration

    def _with_sections(self, scene: Scene) -> Scene:
        homing, probe = self.homing, self.inductive
        scene = with_options(
            scene,
            "stepper_z",
            homing_speed=f"{homing.speed:g}",
            second_homing_speed=f"{homing.second_speed:g}",
            homing_retract_dist=f"{homing.retract:g}",
        )
        scene = with_options(
            scene,
            "probe",
            x_offset=f"{probe.x:g}",
            y_offset=f"{probe.y:g}",
            z_offset=f"{probe.configured:g}",
        )
        x, y = self.homed_at
        home = f"{x - probe.x:g}, {y - probe.y:g}"
        scene = with_options(scene, "safe_z_home", home_xy_position=home)
        return with_options(scene, "auto_z_offset", **self._calibration())

    def _calibration(self) -> dict[str, Optional[str]]:
        sampling, options = self.sampling, self.options
        texts: dict[str, Optional[str]] = {
            "bed_xy_position": "%g, %g" % self.bed,
            "z_offset": f"{options.z_offset:g}",
            "speed": f"{sampling.speed:g}",
            "probe_accel": f"{options.probe_accel:g}",
            "probe_hop": f"{options.probe_hop:g}",
            "offset_samples": f"{options.cycles}",
            "samples": f"{sampling.samples}",
            "samples_result": sampling.result,
            "sample_retract_dist": f"{sampling.retract:g}",
            "samples_tolerance": f"{sampling.tolerance:g}",
            "samples_tolerance_retries": f"{sampling.retries}",
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
        if self.piezo.is_switched:
            lines.append("SET_PIN PIN=bed_sensor VALUE=1")
        return "".join(f"\n  {line}" for line in lines)

    # The truth

    def _with_world(self, scene: Scene) -> Scene:
        probe, piezo, homing = self.inductive, self.piezo, self.homing
        fastest = max(homing.speed, homing.second_speed, self.sampling.speed)
        stopping = max(probe.noise.latency, piezo.noise.latency)
        stopping += OTHER_BOARD_STOPS if self.other_board else 0.0
        return scene.with_world(
            bed=self.plate.spec(_PLATE),
            inductive=InductiveSpec(
                probe.x, probe.y, probe.distance, probe.noise
            ),
            bed_sensor=BedSensorSpec(
                piezo.press, piezo.is_switched, piezo.noise
            ),
            drift=self.drift,
            overtravel=GIVE + fastest * stopping,
        )


def _motor_sections(scene: Scene) -> dict[str, str]:
    """Sections of Z motors, by the motor's name."""
    names = {
        name: name if name.startswith("stepper_") else name.split()[-1]
        for name in scene.sections
        if name.startswith(("stepper_z", "stepper my_z"))
    }
    return {
        name.replace("stepper_", "").replace("my_", ""): section
        for section, name in names.items()
    }


def _with_drivers(scene: Scene) -> Scene:
    sections = dict(scene.sections)
    for motor, section in _motor_sections(scene).items():
        uart = scene.wiring.motors[motor].uart
        sections[f"tmc2209 {section}"] = {"uart_pin": uart, **_DRIVER}
    return dataclasses.replace(scene, sections=sections)


def _without_drivers(scene: Scene) -> Scene:
    motors = {
        name: dataclasses.replace(motor, uart="")
        for name, motor in scene.wiring.motors.items()
    }
    wiring = dataclasses.replace(scene.wiring, motors=motors)
    return dataclasses.replace(scene, wiring=wiring)


def _without_switch(scene: Scene) -> Scene:
    """The sensor is always on."""
    wiring = dataclasses.replace(scene.wiring, outputs={})
    sections = {**scene.sections, "output_pin bed_sensor": None}
    return dataclasses.replace(scene, wiring=wiring, sections=sections)
