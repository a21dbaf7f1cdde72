"""Random printers with [z_calibration], and what CALIBRATE_Z has to do."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Optional

from hypothesis import strategies as st

from simprinter import Scene
from simprinter.world import (
    Bed,
    MagProbeSpec,
    NoiseSpec,
    PinSpec,
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
    Gantry,
    Homing,
    with_gantry,
    with_options,
    z_section,
)
from tools.campaign.gap_bounds import SIGMAS, Interval, may_differ, variance
from tools.kit.scenes import SCENES

# Behind the plate, mm
PIN_Y = 306.0
# Along the body from where the plunger is over the pin, mm
BESIDE_PLUNGER = 3.5
_PLATE = 300.0
# Of the Z axis, mm
_POSITION_MIN = -5.0

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


@dataclass(frozen=True)
class Options:
    """Of [z_calibration]; None: left out. mm and mm/s."""

    samples: Optional[int] = None
    probing_speed: Optional[float] = None
    probing_first_fast: bool = False
    safe_z_height: Optional[float] = None
    travel_margin: Optional[float] = None
    speed: Optional[float] = None


def _at(x: float, y: float) -> str:
    return f"{x:g}, {y:g}"


def _wrong_pin_sense(printer: ZCalibration, scene: Scene) -> Scene:
    if printer.pin.is_own:
        change = wrong_sense("z_calibration", "endstop_pin", "nozzle_endstop")
    else:
        change = wrong_sense("z", "endstop_pin", "z_endstop")
    return change(printer, scene)


def _no_probe(printer: ZCalibration, scene: Scene) -> Scene:
    templates = ("start_gcode", "before_switch_gcode", "end_gcode")
    without = dict.fromkeys(templates)
    return _docked(with_options(scene, "z_calibration", **without))


def _short_body(printer: ZCalibration, scene: Scene) -> Scene:
    assert scene.world.mag_probe is not None
    return scene.with_world(
        mag_probe=replace(scene.world.mag_probe, body_drop=0.6)
    )


_MISTAKES: dict[str, Mistake] = {
    "sites swapped": other(
        "z_calibration",
        nozzle_xy_position=lambda printer: _at(*printer.switch_head),
        switch_xy_position=lambda printer: _at(printer.pin.x, PIN_Y),
    ),
    "nozzle beside pin": other(
        "z_calibration",
        nozzle_xy_position=lambda printer: _at(printer.pin.x + 4.0, PIN_Y),
    ),
    "nozzle over bed": other(
        "z_calibration",
        nozzle_xy_position=lambda printer: _at(printer.pin.x, PIN_Y - 20.0),
    ),
    "body beside pin": other(
        "z_calibration",
        switch_xy_position=lambda printer: _at(
            printer.switch_head[0] + 8.0, printer.switch_head[1]
        ),
    ),
    "beside the bed": other(
        "z_calibration",
        bed_xy_position=lambda printer: _at(printer.bed[0], 305.0),
    ),
    "switch_offset too large": other(
        "z_calibration",
        switch_offset=lambda printer: f"{printer.probe.switch_offset + 3.0:g}",
    ),
    "low safe_z_height": other("z_calibration", safe_z_height="1"),
    "floor above the bed": other("z_calibration", position_min="0.4"),
    "endstop is the probe": other(
        "z", endstop_pin="probe:z_virtual_endstop", position_endstop=None
    ),
    "endstop far off": other(
        "z",
        position_endstop=lambda printer: f"{printer.pin.height + 2.5:g}",
    ),
    "no room above": other("z", position_max="9", **NOT_UP),
    "offsets of wrong sign": OFFSETS_OF_WRONG_SIGN,
    "probe normally open": wrong_sense("probe", "pin", "probe"),
    "endstop inverted": _wrong_pin_sense,
    "no probe": _no_probe,
    "sticky probe": sticky(
        "mag_probe", lambda printer: printer.sampling.retract
    ),
    "short body": _short_body,
}
# With the probe as endstop these are about something that is not there
_ABOUT_ENDSTOP = ("endstop is the probe", "endstop far off", "no probe")


@dataclass(frozen=True)
class ZCalibration(Drawn):
    """The voron scene."""

    gantry: Gantry = Gantry(z_motors=4)
    pin: Pin = Pin()
    probe: Probe = Probe()
    options: Options = Options()

    module = "z_calibration"
    command = "CALIBRATE_Z"
    final = ("body_pin", "probe_bed")
    mistakes = _MISTAKES

    @classmethod
    def printers(cls, kinematics: tuple[str, ...]) -> st.SearchStrategy:
        return drawn_like(
            cls(),
            kinematics,
            (4, 10.0),
            {
                "bed": st.tuples(*[around(150.0, 70.0, 230.0, 1.0)] * 2),
                "pin": _pins(),
                "probe": _probes(),
                "homing": st.builds(
                    Homing,
                    speed=around(8.0, 2.0, 12.0, 0.1),
                    second_speed=around(3.0, 1.0, 6.0, 0.1),
                    retract=around(3.0, 1.0, 5.0, 0.1),
                ),
            },
            _options(),
            ("z_endstop", "probe"),
        ).map(cls._possible)

    def _possible(self) -> ZCalibration:
        """The same without what contradicts itself."""
        if not self.pin.is_own:
            return self
        # Z is homed with the probe: it is there, and its length was measured
        probe = replace(self.probe, attached="always", z_offset=None)
        mistake = "" if self.mistake in _ABOUT_ENDSTOP else self.mistake
        return replace(self, probe=probe, mistake=mistake)

    @property
    def wanted_samples(self) -> int:
        """How often each place is touched, the bed, too."""
        return self.options.samples or self.sampling.samples

    @property
    def probe_head(self) -> tuple[float, float]:
        """Where the toolhead stands for the probe to touch the measured point."""
        return self.bed[0] - self.probe.x, self.bed[1] - self.probe.y

    @property
    def switch_head(self) -> tuple[float, float]:
        """Where it stands for the body, beside its plunger, to press the pin."""
        x, y = self.pin.x - self.probe.x, PIN_Y - self.probe.y
        return x + BESIDE_PLUNGER, y

    @property
    def board_signal(self) -> str:
        is_own = self.pin.is_own and self.other_board == "z_endstop"
        return "nozzle_endstop" if is_own else self.other_board

    # The configuration

    def healthy(self) -> Scene:
        scene = with_gantry(self._with_sections(SCENES["voron"]), self.gantry)
        scene = self._with_world(scene)
        if self.pin.is_own:
            scene = self._homed_with_probe(scene)
        if self.probe.attached != "always":
            template = {f"{self.probe.attached}_gcode": "ATTACH_PROBE"}
            scene = replace(scene, sections={**scene.sections, **_MACROS})
            scene = _docked(
                with_options(
                    scene, "z_calibration", end_gcode="DOCK_PROBE", **template
                )
            )
        return scene

    def _with_sections(self, scene: Scene) -> Scene:
        pin, probe, home = self.pin, self.probe, _at(self.pin.x, PIN_Y)
        z_offset = probe.z_offset
        if z_offset is None:
            z_offset = round(probe.trigger, 1)
        options = vars(self.options).items()
        changes: dict[str, dict[str, Optional[str]]] = {
            "stepper_z": {
                "position_endstop": f"{pin.height + pin.believed:.4f}",
                **self.homing.options(),
            },
            "probe": {
                "x_offset": f"{probe.x:g}",
                "y_offset": f"{probe.y:g}",
                "z_offset": f"{z_offset:g}",
                **self.sampling.options(),
            },
            "safe_z_home": {"home_xy_position": home},
            "z_calibration": {
                "nozzle_xy_position": home,
                "switch_xy_position": _at(*self.switch_head),
                "bed_xy_position": _at(*self.bed),
                "switch_offset": f"{probe.switch_offset - probe.configured:.4f}",
                **{name: f"{v:g}" for name, v in options if v is not None},
                "probing_first_fast": str(self.options.probing_first_fast),
            },
        }
        for name, texts in changes.items():
            scene = with_options(scene, name, **texts)
        return scene

    def _homed_with_probe(self, scene: Scene) -> Scene:
        """The pin has an input that only z_calibration knows."""
        inputs = dict(scene.wiring.inputs)
        pin = inputs["nozzle_endstop"] = inputs.pop("z_endstop")
        scene = replace(scene, wiring=replace(scene.wiring, inputs=inputs))
        scene = with_options(
            scene,
            z_section(scene),
            endstop_pin="probe:z_virtual_endstop",
            position_endstop=None,
        )
        home = _at(*self.probe_head)
        scene = with_options(scene, "safe_z_home", home_xy_position=home)
        # What the documentation asks for, as nobody knows this height
        hanging = self.probe.trigger + self.probe.pretravel
        clear = self.pin.height + hanging + 2.0
        safe_z = max(clear, self.options.safe_z_height or 0.0)
        scene = with_options(
            scene, "z_calibration", endstop_pin=pin, safe_z_height=f"{safe_z:g}"
        )
        assert scene.world.pin is not None
        return scene.with_world(
            pin=replace(scene.world.pin, signal="nozzle_endstop")
        )

    # The truth

    def _with_world(self, scene: Scene) -> Scene:
        pin, probe, homing = self.pin, self.probe, self.homing
        bed = self.plate.spec(_PLATE)
        quick = self.options.probing_speed or 0.0
        fastest = max(
            homing.speed, homing.second_speed, quick, self.sampling.speed
        )
        return scene.with_world(
            bed=bed,
            pin=PinSpec(
                pin.x,
                PIN_Y,
                Bed(bed).height(*self.bed) + pin.height,
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
            overtravel=self.overtravel(fastest, pin.noise, probe.noise),
        )

    # What a calibration has to do

    @property
    def sites(self) -> dict[str, tuple[tuple[float, float], int]]:
        wanted = self.wanted_samples
        return {
            "nozzle_pin": ((self.pin.x, PIN_Y), wanted),
            "body_pin": (self.switch_head, wanted),
            "probe_bed": (self.probe_head, wanted),
        }

    def place(self, touches: Sequence[Touch]) -> tuple[float, float]:
        """Where the probe has really touched the bed."""
        x, y = touches[-1].x, touches[-1].y
        return x + self.probe.x, y + self.probe.y

    def gaps(
        self, homing: Sequence[Touch], touches: Sequence[Touch], now: float
    ) -> Interval:
        exact = self.scene.formula_gap()
        pin, probe = self.pin.noise, self.probe.noise
        on_pin = pin.latency * self.homing.second_speed
        on_bed = probe.latency * self.sampling.speed
        retracts = {
            "nozzle_pin": self.homing.retract,
            "body_pin": self.homing.retract,
            "probe_bed": self.sampling.retract,
        }
        bound = self.bound(touches, retracts, now - touches[0].t)
        samples = {name: count for name, (_, count) in self.sites.items()}
        pin_variance = variance(pin, samples["body_pin"])
        bed_variance = variance(probe, samples["probe_bed"])
        bound += SIGMAS * math.sqrt(2.0 * pin_variance + bed_variance)
        bound += self.hidden(
            touches,
            [
                (name, probe if name == "probe_bed" else pin, count)
                for name, count in samples.items()
            ],
        )
        return Interval(exact - on_bed - on_pin, exact + on_pin, bound)

    def nominal(self, touch: Touch) -> float:
        pin, probe = self.scene.world.pin, self.scene.world.mag_probe
        assert pin is not None and probe is not None
        if touch.site == "nozzle_pin":
            return pin.z
        if touch.site == "body_pin":
            return pin.z + probe.body_drop
        x, y = touch.x + probe.x_offset, touch.y + probe.y_offset
        hanging = probe.body_drop + probe.switch_offset
        return self.surface.height(x, y) + hanging

    def excuses(self) -> list[str]:
        step = self.gantry.step
        noises = (self.pin.noise, self.probe.noise)
        if any(may_differ(noise, self.sampling, step) for noise in noises):
            return ["samples differ by"]
        return []

    def tolerated(self) -> dict[str, float]:
        reach = max(self.options.travel_margin or 1.0, 1.0)
        reach += abs(self.pin.believed)
        if self.pin.is_own:
            # Nobody knows its height: position_min is the only floor
            reach = self.pin.height - _POSITION_MIN + 1.0
        sites = ("nozzle_pin", "body_pin", "nozzle_bed", "body_bed")
        return dict.fromkeys(sites, reach)

    def clear_z(self) -> float:
        probe = self.scene.world.mag_probe
        assert probe is not None
        hanging = probe.body_drop + probe.switch_offset + probe.pretravel
        return self.surface.height(*self.bed) + hanging


def _docked(scene: Scene) -> Scene:
    """The probe in its dock, held by an output."""
    assert scene.world.mag_probe is not None
    probe = replace(
        scene.world.mag_probe,
        mode="output",
        initial="docked",
        attach_time=0.2,
    )
    wiring = replace(scene.wiring, outputs={"probe_attach": "PD0"})
    return replace(scene, wiring=wiring).with_world(mag_probe=probe)


def _pins() -> st.SearchStrategy:
    return st.builds(
        Pin,
        x=around(206.0, 50.0, 250.0, 1.0),
        height=around(1.5012, 0.3, 5.0, 0.0001),
        believed=around(0.0988, -0.5, 0.5, 0.0001),
        pretravel=often(0.0, around(0.0, 0.0, 0.5)),
        noise=noises(0.0, 0.002),
        is_own=st.sampled_from((False, False, False, True)),
    )


def _probes() -> st.SearchStrategy:
    return st.builds(
        Probe,
        x=around(-2.0, -40.0, 40.0, 0.5),
        y=around(24.75, 12.0, 35.0, 0.5),
        body=around(6.415, 2.5, 8.5, 0.001),
        switch_offset=around(0.5, 0.3, 1.0),
        configured=around(0.06, -0.1, 0.3),
        pretravel=around(0.3, 0.05, 0.6),
        # It does not matter, says the documentation
        z_offset=often(None, around(0.0, -1.0, 15.0, 0.1)),
        attached=st.sampled_from(("always", "start", "before_switch")),
        noise=noises(0.0, 0.002),
    )


def _options() -> st.SearchStrategy:
    return st.builds(
        Options,
        samples=often(None, st.integers(1, 3)),
        probing_speed=often(None, around(5.0, 1.0, 12.0, 0.5)),
        probing_first_fast=st.booleans(),
        safe_z_height=often(None, around(10.0, 3.0, 40.0, 0.5)),
        travel_margin=often(None, around(1.0, 0.5, 3.0, 0.1)),
        speed=often(None, around(50.0, 30.0, 200.0, 1.0)),
    )
