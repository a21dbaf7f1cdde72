"""A printer with [z_calibration]: its truth and its configuration."""

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
    z_section,
)
from tests.simprinter import SCENES, Scene
from tests.simprinter.world import (
    Bed,
    DriftSpec,
    MagProbeSpec,
    NoiseSpec,
    PinSpec,
)

# Behind the plate, mm
PIN_Y = 306.0
_PLATE = 300.0

_SET_PIN = "\n  SET_PIN PIN=probe_magnet VALUE=%d\n  G4 P500"
_MACROS = {
    "output_pin probe_magnet": {"pin": "PD0", "value": "0"},
    "gcode_macro ATTACH_PROBE": {"gcode": _SET_PIN % 1},
    "gcode_macro DOCK_PROBE": {"gcode": _SET_PIN % 0},
}


@dataclass(frozen=True)
class Pin:
    """What nozzle and probe press.

    height: mm of its trigger above the bed's measured point. believed: mm by
    which position_endstop is larger. is_own: Z is homed with the probe.
    """

    x: float = 206.0
    height: float = 1.5012
    believed: float = 0.0988
    pretravel: float = 0.0
    noise: NoiseSpec = NoiseSpec()
    is_own: bool = False


@dataclass(frozen=True)
class Probe:
    """The switch probe, mm; see MagProbeSpec.

    configured: by how much its switch_offset is larger than in the file.
    z_offset: what the file says; None: about the truth. attached: "always",
    "start" or "before_switch", by the template of that name.
    """

    x: float = -2.0
    y: float = 24.75
    body: float = 6.415
    switch_offset: float = 0.5
    configured: float = 0.06
    pretravel: float = 0.3
    z_offset: Optional[float] = None
    attached: str = "always"
    noise: NoiseSpec = NoiseSpec()

    @property
    def trigger(self) -> float:
        """How far below the nozzle it triggers, mm."""
        return self.body + self.switch_offset

    @property
    def length(self) -> float:
        """How far its free plunger hangs below the nozzle, mm."""
        return self.trigger + self.pretravel


@dataclass(frozen=True)
class Homing:
    """mm/s and mm."""

    speed: float = 8.0
    second_speed: float = 3.0
    retract: float = 3.0


@dataclass(frozen=True)
class Options:
    """Of [z_calibration]; None: left out. mm and mm/s."""

    samples: Optional[int] = None
    probing_speed: Optional[float] = None
    first_fast: bool = False
    safe_z_height: Optional[float] = None
    travel_margin: Optional[float] = None
    speed: Optional[float] = None


@dataclass(frozen=True)
class ZPrinter:
    """A printer; the defaults are the voron scene.

    bed: the point that is measured. other_board: the input that is on a board
    of its own, that many s away. offset: G-code Z offset of before.
    """

    gantry: Gantry = Gantry(z_motors=4)
    plate: Plate = Plate()
    bed: tuple[float, float] = (150.0, 150.0)
    pin: Pin = Pin()
    probe: Probe = Probe()
    homing: Homing = Homing()
    sampling: Sampling = Sampling()
    options: Options = Options()
    drift: DriftSpec = field(default_factory=DriftSpec)
    other_board: str = ""
    board_latency: float = 0.002
    offset: float = 0.0
    mistake: str = ""
    seed: int = 0

    @property
    def pin_samples(self) -> int:
        """How often nozzle and body touch the pin."""
        return self.options.samples or self.sampling.samples

    @property
    def probe_head(self) -> tuple[float, float]:
        """Where the head stands for the probe to touch the measured point."""
        return self.bed[0] - self.probe.x, self.bed[1] - self.probe.y

    @property
    def switch_head(self) -> tuple[float, float]:
        """Where it stands for the body to press the pin."""
        return self.pin.x - self.probe.x, PIN_Y - self.probe.y

    @property
    def fastest(self) -> float:
        """Speed (mm/s) at which anything is touched at most."""
        homing = self.homing
        quick = self.options.probing_speed or 0.0
        return max(
            homing.speed, homing.second_speed, quick, self.sampling.speed
        )

    @property
    def pin_z(self) -> float:
        """Where the pin triggers, mm in the world frame."""
        bed = Bed(self.plate.spec(_PLATE))
        return bed.height(*self.bed) + self.pin.height

    def scene(self) -> Scene:
        """The machine with a configuration without a mistake, on one board."""
        scene = with_gantry(self._with_sections(SCENES["voron"]), self.gantry)
        scene = self._with_world(scene)
        if self.pin.is_own:
            scene = self._homed_with_probe(scene)
        if self.probe.attached != "always":
            scene = self._with_macros(scene)
        return scene

    # The configuration

    def _with_sections(self, scene: Scene) -> Scene:
        homing, sampling, probe = self.homing, self.sampling, self.probe
        z_offset = probe.z_offset
        if z_offset is None:
            z_offset = round(probe.trigger, 1)
        scene = with_options(
            scene,
            "stepper_z",
            position_endstop=f"{self.pin.height + self.pin.believed:.4f}",
            homing_speed=f"{homing.speed:g}",
            second_homing_speed=f"{homing.second_speed:g}",
            homing_retract_dist=f"{homing.retract:g}",
        )
        scene = with_options(
            scene,
            "probe",
            x_offset=f"{probe.x:g}",
            y_offset=f"{probe.y:g}",
            z_offset=f"{z_offset:g}",
            speed=f"{sampling.speed:g}",
            samples=f"{sampling.samples}",
            samples_result=sampling.result,
            sample_retract_dist=f"{sampling.retract:g}",
            samples_tolerance=f"{sampling.tolerance:g}",
            samples_tolerance_retries=f"{sampling.retries}",
        )
        home = f"{self.pin.x:g}, {PIN_Y:g}"
        scene = with_options(scene, "safe_z_home", home_xy_position=home)
        return with_options(scene, "z_calibration", **self._calibration())

    def _calibration(self) -> dict[str, Optional[str]]:
        probe, options = self.probe, self.options
        texts = {
            "nozzle_xy_position": f"{self.pin.x:g}, {PIN_Y:g}",
            "switch_xy_position": "%g, %g" % self.switch_head,
            "bed_xy_position": "%g, %g" % self.bed,
            "switch_offset": f"{probe.switch_offset - probe.configured:.4f}",
            "probing_first_fast": f"{options.first_fast}",
        }
        names = (
            "samples",
            "probing_speed",
            "safe_z_height",
            "travel_margin",
            "speed",
        )
        values = {name: getattr(options, name) for name in names}
        given = {n: f"{v:g}" for n, v in values.items() if v is not None}
        return {**texts, **given}

    def _homed_with_probe(self, scene: Scene) -> Scene:
        """The pin has an input that only z_calibration knows."""
        inputs = dict(scene.wiring.inputs)
        pin = inputs["nozzle_endstop"] = inputs.pop("z_endstop")
        wiring = dataclasses.replace(scene.wiring, inputs=inputs)
        scene = dataclasses.replace(scene, wiring=wiring)
        scene = with_options(
            scene,
            z_section(scene),
            endstop_pin="probe:z_virtual_endstop",
            position_endstop=None,
        )
        home = "%g, %g" % self.probe_head
        scene = with_options(scene, "safe_z_home", home_xy_position=home)
        # What the documentation asks for, as nobody knows this height
        clear = self.pin.height + self.probe.length + 2.0
        safe_z = max(clear, self.options.safe_z_height or 0.0)
        scene = with_options(
            scene, "z_calibration", endstop_pin=pin, safe_z_height=f"{safe_z:g}"
        )
        assert scene.world.pin is not None
        return scene.with_world(
            pin=dataclasses.replace(scene.world.pin, signal="nozzle_endstop")
        )

    def _with_macros(self, scene: Scene) -> Scene:
        """The probe is fetched and put away by templates."""
        wiring = dataclasses.replace(
            scene.wiring, outputs={"probe_attach": "PD0"}
        )
        scene = dataclasses.replace(
            scene, wiring=wiring, sections={**scene.sections, **_MACROS}
        )
        template = {f"{self.probe.attached}_gcode": "ATTACH_PROBE"}
        return docked(
            with_options(
                scene, "z_calibration", end_gcode="DOCK_PROBE", **template
            )
        )

    # The truth

    def _with_world(self, scene: Scene) -> Scene:
        pin, probe = self.pin, self.probe
        noise = max(pin.noise.latency, probe.noise.latency)
        stopping = noise + (OTHER_BOARD_STOPS if self.other_board else 0.0)
        return scene.with_world(
            bed=self.plate.spec(_PLATE),
            pin=PinSpec(
                pin.x,
                PIN_Y,
                self.pin_z,
                radius=2.5,
                pretravel=pin.pretravel,
                noise=pin.noise,
            ),
            mag_probe=MagProbeSpec(
                probe.x,
                probe.y,
                probe.body,
                probe.switch_offset,
                pretravel=probe.pretravel,
                noise=probe.noise,
            ),
            drift=self.drift,
            overtravel=GIVE + self.fastest * stopping,
        )


def docked(scene: Scene) -> Scene:
    """The probe in its dock, held by an output."""
    assert scene.world.mag_probe is not None
    return scene.with_world(
        mag_probe=dataclasses.replace(
            scene.world.mag_probe,
            mode="output",
            initial="docked",
            attach_time=0.2,
        )
    )
