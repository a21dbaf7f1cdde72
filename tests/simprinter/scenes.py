"""Named machines: what they are made of and the printer.cfg that fits them.

A scene's world is the truth; its configuration is what the owner believes.
Both meet in the wiring: the same pin texts serve both.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Optional, Union

from .mcu.board import Crystal
from .wiring import MAIN, BoardSpec, Heater, Motor, Wiring
from .world import (
    AxisSwitchSpec,
    BedSensorSpec,
    BedSpec,
    InductiveSpec,
    MagProbeSpec,
    NoiseSpec,
    PinSpec,
    Pose,
    WorldSpec,
)

# Section name -> option -> value; a value of None leaves the option out
Sections = Mapping[str, Optional[Mapping[str, Optional[str]]]]


@dataclass(frozen=True)
class Scene:
    """A machine in its starting state.

    z_motors: (name, x, y) of every Z motor. start: where the nozzle tip is,
    world frame; near the endstops, as the way there proves nothing and takes
    time. z_skew: mm by which Z motors stand higher. Frame of the
    configuration: x and y are the world's; its z comes from
    homing on the pin, whose height it gives as position_endstop.
    """

    name: str
    kinematics: str
    z_motors: Sequence[tuple[str, float, float]]
    world: WorldSpec
    wiring: Wiring
    sections: Sections
    start: Pose
    z_skew: Mapping[str, float] = field(default_factory=dict)

    def config(
        self,
        serial: Union[str, Mapping[str, str]],
        changes: Optional[Sections] = None,
    ) -> str:
        """printer.cfg for boards on these serial devices, with changes.

        serial: the main board's, or each one's by its name. A change replaces
        or adds options; None as a value takes an option away, None as a
        section the section.
        """
        serials = {MAIN: serial} if isinstance(serial, str) else serial
        boards = {
            MAIN if name == MAIN else f"mcu {name}": {"serial": device}
            for name, device in serials.items()
        }
        merged: dict[str, dict[str, Optional[str]]] = {}
        for part in (self.sections, boards, changes or {}):
            for name, options in part.items():
                if options is None:
                    merged.pop(name, None)
                else:
                    merged.setdefault(name, {}).update(options)
        lines: list[str] = []
        for name, options in merged.items():
            lines.append(f"[{name}]")
            lines += [
                f"{key}: {value}"
                for key, value in options.items()
                if value is not None
            ]
            lines.append("")
        return "\n".join(lines)

    def with_world(self, **changes: object) -> Scene:
        """The same machine with another world."""
        return replace(self, world=replace(self.world, **changes))

    def formula_gap(self) -> float:
        """True gap at Z=0 that a perfect calibration leaves, mm.

        z_calibration's formula is exact where switch_offset is; what it is
        off shows up as gap: true minus configured.
        """
        probe = self.world.mag_probe
        assert probe is not None
        section = self.sections["z_calibration"]
        assert section is not None
        return probe.switch_offset - float(section["switch_offset"] or 0.0)

    def piezo_depth(self, speed: Optional[float] = None) -> float:
        """Mm below the plate at which a nozzle going down is reported.

        The sensor's latency makes it deeper the faster it goes: speed in
        mm/s at that moment (default: [auto_z_offset]'s).
        """
        sensor = self.world.bed_sensor
        assert sensor is not None
        if speed is None:
            section = self.sections["auto_z_offset"]
            assert section is not None
            speed = float(section["speed"] or 0.0)
        return sensor.press_depth + speed * sensor.noise.latency

    def piezo_gap(self) -> float:
        """True gap at Z=0 that a perfect AUTO_Z_CALIBRATE leaves, mm.

        The air gap that [auto_z_offset] asks for as z_offset is counted from
        where the sensor triggers.
        """
        section = self.sections["auto_z_offset"]
        assert section is not None
        return float(section["z_offset"] or 0.0) - self.piezo_depth()


_EXTRUDER = {
    "step_pin": "PG0",
    "dir_pin": "PG1",
    "enable_pin": "!PG2",
    "microsteps": "16",
    "rotation_distance": "22.6",
    "nozzle_diameter": "0.4",
    "filament_diameter": "1.75",
    "heater_pin": "PH0",
    "sensor_type": "beta3950",
    "sensor_pin": "PI0",
    "control": "watermark",
    "min_temp": "0",
    "max_temp": "300",
}
_BED = {
    "heater_pin": "PH1",
    "sensor_type": "beta3950",
    "sensor_pin": "PI1",
    "control": "watermark",
    "min_temp": "0",
    "max_temp": "130",
}
_THERMISTOR = {
    "temperature1": "25",
    "resistance1": "100000",
    "beta": "3950",
}
_HEATERS = {
    "extruder": Heater("PH0", "PI0"),
    "bed": Heater("PH1", "PI1", power=1.0, loss=0.005),
}


def heated(scene: Scene) -> Scene:
    """The same with sections for its hotend and its bed.

    The scenes are wired for them and do without: two thermometers make a fifth
    of all that happens while a printer calibrates.
    """
    heaters: Sections = {
        "thermistor beta3950": _THERMISTOR,
        "extruder": _EXTRUDER,
        "heater_bed": _BED,
    }
    return replace(scene, sections={**scene.sections, **heaters})


def _stepper(motor: Motor, **options: str) -> dict[str, Optional[str]]:
    """A stepper section for a motor of 200 steps and 16 microsteps."""
    return {
        "step_pin": motor.step_pin,
        "dir_pin": motor.dir_pin,
        "enable_pin": motor.enable_pin,
        "microsteps": "16",
        **options,
    }


def _with(sections: Sections, name: str, **options: Optional[str]) -> Sections:
    """The same with other options in one section."""
    return {**sections, name: {**(sections.get(name) or {}), **options}}


def _printer(kinematics: str) -> dict[str, Optional[str]]:
    return {
        "kinematics": kinematics,
        "max_velocity": "300",
        "max_accel": "3000",
        "max_z_velocity": "15",
        "max_z_accel": "350",
    }


def _voron() -> Scene:
    """CoreXY, four belted Z motors, Klicky-like probe, pin behind the bed."""
    belt = {"rotation_distance": "40", "gear_ratio": "80:16"}
    motors = {
        "x": Motor("PA0", "!PA1", 0.0125, enable_pin="!PA2"),
        "y": Motor("PA3", "!PA4", 0.0125, enable_pin="!PA5"),
        "z": Motor("PB0", "PB1", 0.0025, enable_pin="!PB2"),
        "z1": Motor("PB3", "!PB4", 0.0025, enable_pin="!PB5"),
        "z2": Motor("PB6", "PB7", 0.0025, enable_pin="!PB8"),
        "z3": Motor("PB9", "!PB10", 0.0025, enable_pin="!PB11"),
    }
    inputs = {
        "x_endstop": "^PC0",
        "y_endstop": "^PC1",
        "z_endstop": "^PC2",
        "probe": "^PC3",
    }
    belts = {"rotation_distance": "40"}
    return Scene(
        name="voron",
        kinematics="corexy",
        z_motors=[
            ("z", -60.0, -10.0),
            ("z1", -60.0, 370.0),
            ("z2", 360.0, 370.0),
            ("z3", 360.0, -10.0),
        ],
        world=WorldSpec(
            bed=BedSpec(x_max=300.0, y_max=300.0, z0=0.4),
            pin=PinSpec(206.0, 306.0, 1.9012, radius=2.5),
            switches=(
                AxisSwitchSpec("x_endstop", "x", 300.003),
                AxisSwitchSpec("y_endstop", "y", 310.003),
            ),
            mag_probe=MagProbeSpec(
                x_offset=-2.0,
                y_offset=24.75,
                body_drop=6.415,
                switch_offset=0.5,
            ),
        ),
        wiring=Wiring(motors, inputs, heaters=_HEATERS),
        sections={
            "mcu": {},
            "printer": _printer("corexy"),
            "stepper_x": _stepper(
                motors["x"],
                endstop_pin=inputs["x_endstop"],
                position_endstop="300",
                position_max="300",
                homing_speed="60",
                homing_retract_dist="0",
                **belts,
            ),
            "stepper_y": _stepper(
                motors["y"],
                endstop_pin=inputs["y_endstop"],
                position_endstop="310",
                position_max="310",
                homing_speed="60",
                homing_retract_dist="0",
                **belts,
            ),
            "stepper_z": _stepper(
                motors["z"],
                endstop_pin=inputs["z_endstop"],
                position_endstop="1.6",
                position_max="280",
                position_min="-5",
                homing_speed="8",
                second_homing_speed="3",
                homing_retract_dist="3",
                **belt,
            ),
            "stepper_z1": _stepper(motors["z1"], **belt),
            "stepper_z2": _stepper(motors["z2"], **belt),
            "stepper_z3": _stepper(motors["z3"], **belt),
            "probe": {
                "pin": inputs["probe"],
                "x_offset": "-2.0",
                "y_offset": "24.75",
                "z_offset": "6.9",
                "speed": "5",
                "samples": "3",
                "samples_result": "median",
                "sample_retract_dist": "2",
                "samples_tolerance": "0.01",
                "samples_tolerance_retries": "3",
                "lift_speed": "10",
            },
            "safe_z_home": {
                "home_xy_position": "206, 306",
                "speed": "100",
                "z_hop": "10",
            },
            "z_calibration": {
                "nozzle_xy_position": "206, 306",
                "switch_xy_position": "208, 281.25",
                "bed_xy_position": "150, 150",
                "switch_offset": "0.44",
            },
        },
        start=Pose(285.0, 295.0, 12.0),
    )


def _cartesian() -> Scene:
    """Cartesian, one lead screw with a TMC2209, probe held by an output.

    Its body would meet the bed while the nozzle is on the pin, so it is
    attached after that.
    """
    motors = {
        "x": Motor("PA0", "PA1", 0.0125, enable_pin="!PA2"),
        "y": Motor("PA3", "PA4", 0.0125, enable_pin="!PA5"),
        "z": Motor("PB0", "PB1", 0.0025, uart="PE0", enable_pin="!PB2"),
    }
    inputs = {
        "x_endstop": "^!PC0",
        "y_endstop": "^!PC1",
        "z_endstop": "^!PC2",
        "probe": "^PC3",
    }
    belt = {"rotation_distance": "40"}
    return Scene(
        name="cartesian",
        kinematics="cartesian",
        z_motors=[("z", 110.0, 110.0)],
        world=WorldSpec(
            bed=BedSpec(
                x_max=220.0, y_max=220.0, z0=-0.15, slope_x=4e-4, slope_y=-3e-4
            ),
            pin=PinSpec(226.0, 20.0, 0.3512, radius=2.5, pretravel=0.2),
            switches=(
                AxisSwitchSpec("x_endstop", "x", -8.003, -1),
                AxisSwitchSpec("y_endstop", "y", -4.003, -1),
            ),
            mag_probe=MagProbeSpec(
                x_offset=-28.0,
                y_offset=5.5,
                body_drop=1.28,
                switch_offset=0.7,
                mode="output",
                initial="docked",
                attach_time=0.2,
            ),
        ),
        wiring=Wiring(
            motors, inputs, outputs={"probe_attach": "PD0"}, heaters=_HEATERS
        ),
        sections={
            "mcu": {},
            "printer": _printer("cartesian"),
            "stepper_x": _stepper(
                motors["x"],
                endstop_pin=inputs["x_endstop"],
                position_endstop="-8",
                position_min="-8",
                position_max="258",
                homing_speed="50",
                homing_retract_dist="0",
                **belt,
            ),
            "stepper_y": _stepper(
                motors["y"],
                endstop_pin=inputs["y_endstop"],
                position_endstop="-4",
                position_min="-4",
                position_max="225",
                homing_speed="50",
                homing_retract_dist="0",
                **belt,
            ),
            "stepper_z": _stepper(
                motors["z"],
                endstop_pin=inputs["z_endstop"],
                position_endstop="0.5",
                position_max="250",
                position_min="-3",
                homing_speed="5",
                rotation_distance="8",
            ),
            "tmc2209 stepper_z": {
                "uart_pin": "PE0",
                "run_current": "0.8",
                "sense_resistor": "0.110",
            },
            "output_pin probe_magnet": {
                "pin": "PD0",
                "value": "0",
                "shutdown_value": "0",
            },
            "gcode_macro ATTACH_PROBE": {
                "gcode": "\n  SET_PIN PIN=probe_magnet VALUE=1\n  G4 P500"
            },
            "gcode_macro DOCK_PROBE": {
                "gcode": "\n  SET_PIN PIN=probe_magnet VALUE=0\n  G4 P500"
            },
            "probe": {
                "pin": inputs["probe"],
                "x_offset": "-28",
                "y_offset": "5.5",
                "z_offset": "2.0",
                "speed": "5",
                "samples": "2",
                "samples_tolerance": "0.02",
                "lift_speed": "8",
            },
            "safe_z_home": {"home_xy_position": "226, 20", "z_hop": "8"},
            "z_calibration": {
                "nozzle_xy_position": "226, 20",
                "switch_xy_position": "254, 14.5",
                "bed_xy_position": "110, 110",
                "switch_offset": "0.65",
                "before_switch_gcode": "ATTACH_PROBE",
                "end_gcode": "DOCK_PROBE",
            },
        },
        start=Pose(5.0, 8.0, 12.0),
    )


def _voron_two_boards() -> Scene:
    """The voron with its Z endstop on a board of its own, Z motors not.

    The other board has another clock, 60 ppm slow, and its line takes as long
    as a USB line does: what it sees stops the motors late.
    """
    voron = _voron()
    crystal = Crystal(tick_ns=25, ppm=60, first_wrap=37)
    z_endstop = "^zboard:PC2"
    return replace(
        voron,
        name="voron_two_boards",
        wiring=replace(
            voron.wiring,
            inputs={**voron.wiring.inputs, "z_endstop": z_endstop},
            boards={"zboard": BoardSpec(crystal, latency=0.002)},
        ),
        sections=_with(voron.sections, "stepper_z", endstop_pin=z_endstop),
    )


def _hybrid() -> Scene:
    """The voron as a hybrid CoreXY with two Z motors."""
    voron = _voron()
    motors = dict(voron.wiring.motors)
    sections = {**voron.sections, "printer": _printer("hybrid_corexy")}
    for name in ("z2", "z3"):
        del motors[name], sections[f"stepper_{name}"]
    return replace(
        voron,
        name="hybrid",
        kinematics="hybrid_corexy",
        z_motors=[("z", -60.0, 150.0), ("z1", 360.0, 150.0)],
        wiring=replace(voron.wiring, motors=motors),
        sections=sections,
    )


def _corexz() -> Scene:
    """The voron with a CoreXZ gantry: Z is moved by both belts.

    Finer microsteps, as the belts have no gears.
    """
    voron = _voron()
    step_dist = 40.0 / (200 * 64)
    motors = {name: voron.wiring.motors[name] for name in ("x", "y", "z")}
    sections = {**voron.sections, "printer": _printer("corexz")}
    for name in ("z1", "z2", "z3"):
        del sections[f"stepper_{name}"]
    for name in ("x", "z"):
        motors[name] = replace(motors[name], step_dist=step_dist)
        belt = {"rotation_distance": "40", "gear_ratio": None}
        sections = _with(sections, f"stepper_{name}", microsteps="64", **belt)
    return replace(
        voron,
        name="corexz",
        kinematics="corexz",
        z_motors=[("z", 150.0, 150.0)],
        wiring=replace(voron.wiring, motors=motors),
        sections=sections,
    )


_CARRIAGE_OPTIONS = (
    "endstop_pin",
    "position_endstop",
    "position_min",
    "position_max",
    "homing_speed",
    "second_homing_speed",
    "homing_retract_dist",
)


def on_carriages(sections: Sections, names: Mapping[str, str]) -> Sections:
    """The sections for a generic cartesian; names of the motors' steppers."""
    made = dict(sections)
    for motor, name in names.items():
        axis = motor[0]
        stepper = dict(made.pop(f"stepper_{motor}") or {})
        carriage = {
            option: stepper.pop(option)
            for option in _CARRIAGE_OPTIONS
            if option in stepper
        }
        if carriage:
            made[f"carriage {axis}"] = carriage
        made[f"stepper {name}"] = {**stepper, "carriages": axis}
    return made


def _generic() -> Scene:
    """The voron as a generic cartesian: four Z motors on one carriage.

    The world calls the same machine cartesian.
    """
    voron = _voron()
    sections = {**voron.sections, "printer": _printer("generic_cartesian")}
    names = {name: f"my_{name}" for name in voron.wiring.motors}
    return replace(
        voron,
        name="generic",
        kinematics="cartesian",
        sections=on_carriages(sections, names),
    )


def _separate_pin() -> Scene:
    """The voron homing Z with its probe; the pin has an input of its own.

    No section but z_calibration's knows that input.
    """
    voron = _voron()
    assert voron.world.pin is not None
    inputs = dict(voron.wiring.inputs)
    pin_input = inputs["nozzle_endstop"] = inputs.pop("z_endstop")
    sections = _with(
        voron.sections,
        "stepper_z",
        endstop_pin="probe:z_virtual_endstop",
        position_endstop=None,
    )
    # The probe over the middle of the bed
    sections = _with(sections, "safe_z_home", home_xy_position="152, 125.25")
    sections = _with(sections, "z_calibration", endstop_pin=pin_input)
    scene = replace(
        voron,
        name="separate_pin",
        wiring=replace(voron.wiring, inputs=inputs),
        sections=sections,
    )
    return scene.with_world(
        pin=replace(voron.world.pin, signal="nozzle_endstop")
    )


_PIEZO_PREPARE = """
  G90
  G0 Z3
  G91
  {off}M400
  {{% set i = 4 %}}
  {{% for iteration in range(i|int) %}}
    G1 Z0.6 F7000
    G1 Z-0.6 F7000
  {{% endfor %}}
  G1 Z3
  M400
  G90{on}"""
_SWITCHED_PREPARE = _PIEZO_PREPARE.format(
    off="SET_PIN PIN=bed_sensor VALUE=0\n  ",
    on="\n  SET_PIN PIN=bed_sensor VALUE=1",
)
_UNSWITCHED_PREPARE = _PIEZO_PREPARE.format(off="", on="")


def _qidi_printer(kinematics: str) -> dict[str, Optional[str]]:
    return {
        **_printer(kinematics),
        "max_z_velocity": "20",
        "max_z_accel": "500",
    }


def _elsewhere(board: str, pin: str) -> str:
    """The pin as it is called on another board; "" is the main one."""
    name = pin.lstrip("^~!")
    modifiers = pin[: len(pin) - len(name)]
    return f"{modifiers}{board}:{name}" if board and pin else pin


def _qidi(boards: Optional[Mapping[str, BoardSpec]] = None) -> Scene:
    """CoreXY, two Z lead screws with TMC2209, inductive probe, piezo bed.

    What a QIDI Q1 Pro is. Its owner has left the probe's z_offset at zero:
    it really senses the plate 1.2713 mm below the nozzle. The piezo bed
    triggers 0.04 mm below its surface and tells so 2 ms late, which at a
    steady 5 mm/s is another 0.01 mm: a touch at that speed reads 0.05 mm
    below the surface (see Scene.piezo_depth).

    boards: at most one, which then has everything but probe and heaters.
    """
    board = next(iter(boards or {}), "")

    def pin(text: str) -> str:
        return _elsewhere(board, text)

    def motor(
        step: str, direction: str, step_dist: float, enable: str, uart: str = ""
    ) -> Motor:
        return Motor(
            pin(step),
            pin(direction),
            step_dist,
            uart=pin(uart),
            enable_pin=pin(enable),
        )

    screw = {"rotation_distance": "8"}
    motors = {
        "x": motor("PA0", "!PA1", 0.0125, "!PA2"),
        "y": motor("PA3", "!PA4", 0.0125, "!PA5"),
        "z": motor("PB0", "PB1", 0.0025, "!PB2", uart="PE0"),
        "z1": motor("PB3", "!PB4", 0.0025, "!PB5", uart="PE1"),
    }
    inputs = {
        "x_endstop": pin("^PC2"),
        "y_endstop": pin("^PC3"),
        "probe": "^!PF0",
        "bed_sensor": pin("PC1"),
    }
    outputs = {"bed_sensor_enable": pin("!PA14")}
    belt = {"rotation_distance": "40"}
    return Scene(
        name="qidi",
        kinematics="corexy",
        z_motors=[("z", -30.0, 122.0), ("z1", 275.0, 122.0)],
        world=WorldSpec(
            bed=BedSpec(
                x_max=245.0, y_max=245.0, z0=0.3137, slope_x=1e-4, slope_y=-1e-4
            ),
            switches=(
                AxisSwitchSpec("x_endstop", "x", -5.503, -1),
                AxisSwitchSpec("y_endstop", "y", -4.503, -1),
            ),
            inductive=InductiveSpec(17.6, 4.4, sense_distance=1.2713),
            bed_sensor=BedSensorSpec(
                press_depth=0.04,
                enable_output=True,
                noise=NoiseSpec(latency=0.002),
            ),
        ),
        wiring=Wiring(
            motors,
            inputs,
            outputs,
            heaters=_HEATERS,
            boards=boards or {},
        ),
        sections={
            "mcu": {},
            "printer": _qidi_printer("corexy"),
            "stepper_x": _stepper(
                motors["x"],
                endstop_pin=inputs["x_endstop"],
                position_endstop="-5.5",
                position_min="-5.5",
                position_max="245",
                homing_speed="60",
                homing_retract_dist="0",
                **belt,
            ),
            "stepper_y": _stepper(
                motors["y"],
                endstop_pin=inputs["y_endstop"],
                position_endstop="-4.5",
                position_min="-4.5",
                position_max="258",
                homing_speed="60",
                homing_retract_dist="0",
                **belt,
            ),
            "stepper_z": _stepper(
                motors["z"],
                endstop_pin="probe:z_virtual_endstop",
                position_max="248",
                position_min="-4",
                homing_speed="8",
                second_homing_speed="5",
                homing_retract_dist="5",
                **screw,
            ),
            "stepper_z1": _stepper(motors["z1"], **screw),
            "tmc2209 stepper_z": {
                "uart_pin": motors["z"].uart,
                "run_current": "0.8",
                "sense_resistor": "0.110",
            },
            "tmc2209 stepper_z1": {
                "uart_pin": motors["z1"].uart,
                "run_current": "1.07",
                "sense_resistor": "0.110",
            },
            "output_pin bed_sensor": {
                "pin": outputs["bed_sensor_enable"],
                "value": "0",
                "shutdown_value": "0",
            },
            "probe": {
                "pin": inputs["probe"],
                "x_offset": "17.6",
                "y_offset": "4.4",
                "z_offset": "0.0",
                "speed": "10",
                "samples": "3",
                "sample_retract_dist": "4",
                "samples_tolerance": "0.05",
                "samples_tolerance_retries": "5",
            },
            # The probe over the middle of the axes
            "safe_z_home": {
                "home_xy_position": "102.15, 122.35",
                "speed": "100",
                "z_hop": "10",
            },
            "auto_z_offset": {
                "pin": inputs["bed_sensor"],
                "z_offset": "0.2",
                "speed": "5",
                "lift_speed": "20",
                "probe_accel": "50",
                "probe_hop": "5",
                "offset_samples": "3",
                "samples": "1",
                "sample_retract_dist": "3",
                "samples_tolerance": "0.025",
                "samples_tolerance_retries": "1",
                "prepare_gcode": _SWITCHED_PREPARE,
            },
        },
        start=Pose(5.0, 8.0, 12.0),
    )


def _qidi_two_boards() -> Scene:
    """The qidi as it is wired: all but tool head and heaters on "U_1".

    That board has another clock, 60 ppm slow, and its line takes as long as
    a USB line does: the inductive probe, on the main board, stops the Z
    motors late, the piezo bed at once.
    """
    crystal = Crystal(tick_ns=25, ppm=60, first_wrap=37)
    boards = {"U_1": BoardSpec(crystal, latency=0.002)}
    return replace(_qidi(boards), name="qidi_two_boards")


def _piezo_cartesian() -> Scene:
    """The qidi as a cartesian without TMC drivers: one lead screw.

    The piezo bed is always on. The owner believes in a z_offset of 1 mm for
    the probe, 0.2713 mm too little.
    """
    qidi = _qidi()
    names = ("x", "y", "z")
    motors = {
        name: replace(qidi.wiring.motors[name], uart="") for name in names
    }
    sections = {**qidi.sections, "printer": _qidi_printer("cartesian")}
    for name in ("stepper_z1", "tmc2209 stepper_z", "tmc2209 stepper_z1"):
        del sections[name]
    del sections["output_pin bed_sensor"]
    sections = _with(sections, "probe", z_offset="1.0")
    sections = _with(
        sections, "auto_z_offset", prepare_gcode=_UNSWITCHED_PREPARE
    )
    assert qidi.world.bed_sensor is not None
    sensor = replace(qidi.world.bed_sensor, enable_output=False)
    return replace(
        qidi,
        name="piezo_cartesian",
        kinematics="cartesian",
        z_motors=[("z", 122.0, 122.0)],
        wiring=replace(qidi.wiring, motors=motors, outputs={}),
        sections=sections,
    ).with_world(bed_sensor=sensor)


def _piezo_generic() -> Scene:
    """The qidi as a generic cartesian: two Z motors on one carriage.

    Their sections are [stepper left_z] and [stepper right_z], and so are
    those of their drivers. The world calls the same machine cartesian.
    """
    qidi = _qidi()
    names = {"x": "my_x", "y": "my_y", "z": "left_z", "z1": "right_z"}
    sections = {**qidi.sections, "printer": _qidi_printer("generic_cartesian")}
    for motor in ("z", "z1"):
        driver = sections.pop(f"tmc2209 stepper_{motor}")
        sections[f"tmc2209 stepper {names[motor]}"] = driver
    return replace(
        qidi,
        name="piezo_generic",
        kinematics="cartesian",
        sections=on_carriages(sections, names),
    )


SCENES = {
    scene.name: scene
    for scene in (
        _voron(),
        _voron_two_boards(),
        _hybrid(),
        _corexz(),
        _generic(),
        _separate_pin(),
        _cartesian(),
        _qidi(),
        _qidi_two_boards(),
        _piezo_cartesian(),
        _piezo_generic(),
    )
}
