"""Named machines: what they are made of and the printer.cfg that fits them.

A scene's world is the truth; its configuration is what the owner believes.
Both meet in the wiring: the same pin texts serve both.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple, Optional

from simprinter import scene as machine_scene
from simprinter.mcu.board import Crystal
from simprinter.scene import HEATERS, Options, Sections, heated, parse
from simprinter.wiring import BoardSpec, Motor, Wiring
from simprinter.world import (
    AxisSwitchSpec,
    BedSensorSpec,
    BedSpec,
    InductiveSpec,
    MagProbeSpec,
    MembraneSpec,
    NoiseSpec,
    PinSpec,
    Pose,
    WorldSpec,
)

__all__ = ["SCENES", "Options", "Scene", "Sections", "heated"]


@dataclass(frozen=True)
class Scene(machine_scene.Scene):
    """A machine that the modules of this repository are tried on.

    Frame of the configuration: x and y are the world's; its z comes from homing
    on the pin, whose height it gives as position_endstop.
    """

    def formula_gap(self) -> float:
        """True gap at Z=0 that a perfect calibration leaves, mm.

        z_calibration's formula is exact where switch_offset is; what it is
        off shows up as gap: true minus configured.
        """
        probe = self.world.mag_probe
        assert probe is not None
        return probe.switch_offset - self.number(
            "z_calibration", "switch_offset"
        )

    def piezo_depth(self, speed: Optional[float] = None) -> float:
        """Mm below the plate at which a nozzle going down is reported.

        The sensor's latency makes it deeper the faster it goes: speed in
        mm/s at that moment (default: [auto_z_offset]'s).
        """
        sensor = self.world.bed_sensor
        assert sensor is not None
        if speed is None:
            speed = self.number("auto_z_offset", "speed")
        return sensor.press_depth + speed * sensor.noise.latency

    def piezo_gap(self) -> float:
        """True gap at Z=0 that a perfect AUTO_Z_CALIBRATE leaves, mm.

        The air gap that [auto_z_offset] asks for as z_offset is counted from
        where the sensor triggers.
        """
        return self.number("auto_z_offset", "z_offset") - self.piezo_depth()


# What scenes are made of

_EVERY = """
[mcu]
[printer]
max_velocity: 300; max_accel: 3000; max_z_velocity: 15; max_z_accel: 350
"""
_BELT = {"rotation_distance": "40"}
_GEARED_BELT = {"rotation_distance": "40", "gear_ratio": "80:16"}
_SCREW = {"rotation_distance": "8"}
# Port and number of the first of a motor's pins: step, direction, enable
_MOTOR_PINS = {
    "x": ("PA", 0),
    "y": ("PA", 3),
    "z": ("PB", 0),
    "z1": ("PB", 3),
    "z2": ("PB", 6),
    "z3": ("PB", 9),
}
# Its clock is slow, and its line takes as long as a USB line does: what it
# sees stops the motors of another one late
OTHER_BOARD = BoardSpec(
    Crystal(tick_ns=25, ppm=60, first_wrap=37), latency=0.002
)


def _motors(names: str, uarts: int = 0) -> dict[str, Motor]:
    """Motors by name; `!`: turns the other way. uarts: so many Z have one."""
    motors = {}
    for text in names.split():
        name = text.lstrip("!")
        port, first = _MOTOR_PINS[name]
        is_z, number = name[0] == "z", int(name[1:] or 0)
        motors[name] = Motor(
            f"{port}{first}",
            f"{'!' * (text != name)}{port}{first + 1}",
            0.0025 if is_z else 0.0125,
            uart=f"PE{number}" if is_z and number < uarts else "",
            enable_pin=f"!{port}{first + 2}",
        )
    return motors


class _End(NamedTuple):
    """Of an axis: its endstop's pin and place, the other end, homing's mm/s."""

    pin: str
    at: float
    other: float
    speed: str

    def options(self) -> Options:
        """Of the stepper's section."""
        ends = {"position_max": f"{max(self.at, self.other):g}"}
        if self.other > self.at:
            ends["position_min"] = f"{self.at:g}"
        return {
            "endstop_pin": self.pin,
            "position_endstop": f"{self.at:g}",
            "homing_speed": self.speed,
            "homing_retract_dist": "0",
            **ends,
        }

    def switch(self, axis: str) -> AxisSwitchSpec:
        """3 um beyond where the motors stop."""
        direction = -1 if self.other > self.at else 1
        place = self.at + 0.003 * direction
        return AxisSwitchSpec(f"{axis}_endstop", axis, place, direction)


def _inputs(ends: Mapping[str, _End], **others: str) -> dict[str, str]:
    """Signals and their pins."""
    return {f"{axis}_endstop": end.pin for axis, end in ends.items()} | others


def _sections(
    kinematics: str,
    motors: Mapping[str, Motor],
    ends: Mapping[str, _End],
    z_drive: Options,
    own: str,
) -> Sections:
    """A printer.cfg: what its machine asks for, and sections of its own."""
    made = parse(_EVERY)
    for name, motor in motors.items():
        made[f"stepper_{name}"] = {
            "step_pin": motor.step_pin,
            "dir_pin": motor.dir_pin,
            "enable_pin": motor.enable_pin,
            "microsteps": "16",
            **(z_drive if name[0] == "z" else _BELT),
            **(ends[name].options() if name in ends else {}),
        }
    made["printer"] = {"kinematics": kinematics, **made["printer"]}
    return _with(made, parse(own))


def _with(
    sections: Sections, changes: Mapping[str, Options]
) -> dict[str, Options]:
    """The same with other options in some sections."""
    made = dict(sections)
    for name, options in changes.items():
        made[name] = {**(made.get(name) or {}), **options}
    return made


def on_board(
    scene: Scene, name: str, spec: BoardSpec, pins: Iterable[str]
) -> Scene:
    """The scene with these pins, as it spells them, on a board of their own."""
    moved = {}
    for pin in pins:
        bare = pin.lstrip("^~!")
        moved[pin] = f"{pin[: len(pin) - len(bare)]}{name}:{bare}"

    def there(part: Mapping) -> dict:
        return {key: moved.get(value, value) for key, value in part.items()}

    wiring = replace(
        scene.wiring,
        motors={
            key: Motor(**there(vars(motor)))
            for key, motor in scene.wiring.motors.items()
        },
        inputs=there(scene.wiring.inputs),
        outputs=there(scene.wiring.outputs),
        boards={name: spec},
    )
    sections = {
        section: None if options is None else there(options)
        for section, options in scene.sections.items()
    }
    return replace(scene, wiring=wiring, sections=sections)


def on_gantry(
    scene: Scene, name: str, kinematics: str, **z_motors: tuple[float, float]
) -> Scene:
    """Another scene: the same without Z motors but these (names of its own)."""
    kept = {"x", "y", *z_motors}
    gone = set(scene.wiring.motors) - kept
    motors = {k: motor for k, motor in scene.wiring.motors.items() if k in kept}
    sections = {
        section: options
        for section, options in scene.sections.items()
        if section.rpartition("_")[2] not in gone
    }
    return replace(
        scene,
        name=name,
        kinematics=kinematics,
        z_motors=[(z, x, y) for z, (x, y) in z_motors.items()],
        wiring=replace(scene.wiring, motors=motors),
        sections=_with(sections, {"printer": {"kinematics": kinematics}}),
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


def on_carriages(
    sections: Sections, names: Mapping[str, str]
) -> dict[str, Options]:
    """The sections for a generic cartesian; names of the motors' steppers."""
    made = _with(sections, {"printer": {"kinematics": "generic_cartesian"}})
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
        driver = f"tmc2209 stepper_{motor}"
        if driver in made:
            made[f"tmc2209 stepper {name}"] = made.pop(driver)
    return made


def _generic(scene: Scene, name: str, **steppers: str) -> Scene:
    """Another scene: the same as a generic cartesian, Z on one carriage.

    The world calls such a machine cartesian. steppers: names of Z's.
    """
    names = {"x": "my_x", "y": "my_y", **steppers}
    return replace(
        scene,
        name=name,
        kinematics="cartesian",
        sections=on_carriages(scene.sections, names),
    )


# Scenes


_VORON = """
[stepper_z]
endstop_pin: ^PC2; position_endstop: 1.6; position_max: 280; position_min: -5
homing_speed: 8; second_homing_speed: 3; homing_retract_dist: 3
[probe]
pin: ^PC3; x_offset: -2.0; y_offset: 24.75; z_offset: 6.9; speed: 5
samples: 3; samples_result: median; sample_retract_dist: 2; lift_speed: 10
samples_tolerance: 0.01; samples_tolerance_retries: 3
[safe_z_home]
home_xy_position: 206, 306; speed: 100; z_hop: 10
[z_calibration]
nozzle_xy_position: 206, 306; switch_xy_position: 211.5, 281.25
bed_xy_position: 150, 150; switch_offset: 0.44
"""


def _voron() -> Scene:
    """CoreXY, four belted Z motors, Klicky-like probe, pin behind the bed."""
    motors = _motors("!x !y z !z1 z2 !z3")
    ends = {
        "x": _End("^PC0", 300.0, 0.0, "60"),
        "y": _End("^PC1", 310.0, 0.0, "60"),
    }
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
            switches=tuple(end.switch(axis) for axis, end in ends.items()),
            mag_probe=MagProbeSpec(
                x_offset=-2.0,
                y_offset=24.75,
                body_drop=6.415,
                switch_offset=0.5,
            ),
        ),
        wiring=Wiring(
            motors,
            _inputs(ends, z_endstop="^PC2", probe="^PC3"),
            heaters=HEATERS,
        ),
        sections=_sections("corexy", motors, ends, _GEARED_BELT, _VORON),
        start=Pose(285.0, 295.0, 12.0),
    )


def _voron_two_boards(voron: Scene) -> Scene:
    """The voron with its Z endstop on a board of its own, Z motors not."""
    scene = replace(voron, name="voron_two_boards")
    return on_board(scene, "zboard", OTHER_BOARD, ["^PC2"])


def _hybrid(voron: Scene) -> Scene:
    """The voron as a hybrid CoreXY with two Z motors."""
    z_motors = {"z": (-60.0, 150.0), "z1": (360.0, 150.0)}
    return on_gantry(voron, "hybrid", "hybrid_corexy", **z_motors)


def _corexz(voron: Scene) -> Scene:
    """The voron with a CoreXZ gantry: Z is moved by both belts.

    Finer microsteps, as the belts have no gears.
    """
    scene = on_gantry(voron, "corexz", "corexz", z=(150.0, 150.0))
    motors = dict(scene.wiring.motors)
    for name in ("x", "z"):
        motors[name] = replace(motors[name], step_dist=40.0 / (200 * 64))
    belt = {"microsteps": "64", "rotation_distance": "40", "gear_ratio": None}
    return replace(
        scene,
        wiring=replace(scene.wiring, motors=motors),
        sections=_with(scene.sections, {"stepper_x": belt, "stepper_z": belt}),
    )


def _separate_pin(voron: Scene) -> Scene:
    """The voron homing Z with its probe; the pin has an input of its own.

    No section but z_calibration's knows that input.
    """
    assert voron.world.pin is not None
    inputs = dict(voron.wiring.inputs)
    pin_input = inputs["nozzle_endstop"] = inputs.pop("z_endstop")
    changes: dict[str, Options] = {
        "stepper_z": {
            "endstop_pin": "probe:z_virtual_endstop",
            "position_endstop": None,
        },
        # The probe over the middle of the bed
        "safe_z_home": {"home_xy_position": "152, 125.25"},
        "z_calibration": {"endstop_pin": pin_input},
    }
    return replace(
        voron,
        name="separate_pin",
        wiring=replace(voron.wiring, inputs=inputs),
        sections=_with(voron.sections, changes),
    ).with_world(pin=replace(voron.world.pin, signal="nozzle_endstop"))


_CARTESIAN = """
[stepper_z]
endstop_pin: ^!PC2; position_endstop: 0.5; position_max: 250; position_min: -3
homing_speed: 5
[tmc2209 stepper_z]
uart_pin: PE0; run_current: 0.8; sense_resistor: 0.110
[output_pin probe_magnet]
pin: PD0; value: 0; shutdown_value: 0
[probe]
pin: ^PC3; x_offset: -28; y_offset: 5.5; z_offset: 2.0; speed: 5
samples: 2; samples_tolerance: 0.02; lift_speed: 8
[safe_z_home]
home_xy_position: 226, 20; z_hop: 8
[z_calibration]
nozzle_xy_position: 226, 20; switch_xy_position: 254, 18
bed_xy_position: 110, 110; switch_offset: 0.65
before_switch_gcode: ATTACH_PROBE; end_gcode: DOCK_PROBE
"""


def _cartesian() -> Scene:
    """Cartesian, one lead screw with a TMC2209, probe held by an output.

    Its body would meet the bed while the nozzle is on the pin, so it is
    attached after that.
    """
    motors = _motors("x y z", uarts=1)
    ends = {
        "x": _End("^!PC0", -8.0, 258.0, "50"),
        "y": _End("^!PC1", -4.0, 225.0, "50"),
    }
    set_pin = "\n  SET_PIN PIN=probe_magnet VALUE=%d\n  G4 P500"
    return Scene(
        name="cartesian",
        kinematics="cartesian",
        z_motors=[("z", 110.0, 110.0)],
        world=WorldSpec(
            bed=BedSpec(
                x_max=220.0, y_max=220.0, z0=-0.15, slope_x=4e-4, slope_y=-3e-4
            ),
            pin=PinSpec(226.0, 20.0, 0.3512, radius=2.5, pretravel=0.2),
            switches=tuple(end.switch(axis) for axis, end in ends.items()),
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
            motors,
            _inputs(ends, z_endstop="^!PC2", probe="^PC3"),
            outputs={"probe_attach": "PD0"},
            heaters=HEATERS,
        ),
        sections=_with(
            _sections("cartesian", motors, ends, _SCREW, _CARTESIAN),
            {
                "gcode_macro ATTACH_PROBE": {"gcode": set_pin % 1},
                "gcode_macro DOCK_PROBE": {"gcode": set_pin % 0},
            },
        ),
        start=Pose(5.0, 8.0, 12.0),
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


# The probe homes over the middle of the axes
_QIDI = """
[printer]
max_z_velocity: 20; max_z_accel: 500
[stepper_z]
endstop_pin: probe:z_virtual_endstop; position_max: 248; position_min: -4
homing_speed: 8; second_homing_speed: 5; homing_retract_dist: 5
[tmc2209 stepper_z]
uart_pin: PE0; run_current: 0.8; sense_resistor: 0.110
[tmc2209 stepper_z1]
uart_pin: PE1; run_current: 1.07; sense_resistor: 0.110
[output_pin bed_sensor]
pin: !PA14; value: 0; shutdown_value: 0
[probe]
pin: ^!PF0; x_offset: 17.6; y_offset: 4.4; z_offset: 0.0; speed: 10
samples: 3; sample_retract_dist: 4
samples_tolerance: 0.05; samples_tolerance_retries: 5
[safe_z_home]
home_xy_position: 102.15, 122.35; speed: 100; z_hop: 10
[auto_z_offset]
pin: PC1; z_offset: 0.2; speed: 5; lift_speed: 20
probe_accel: 50; probe_hop: 5; offset_samples: 3
samples: 1; sample_retract_dist: 3
samples_tolerance: 0.025; samples_tolerance_retries: 1
"""


def _qidi() -> Scene:
    """CoreXY, two Z lead screws with TMC2209, inductive probe, piezo bed.

    What a QIDI Q1 Pro is. Its owner has left the probe's z_offset at zero:
    it really senses the plate 1.2713 mm below the nozzle. The piezo bed
    triggers 0.04 mm below its surface and tells so 2 ms late, which at a
    steady 5 mm/s is another 0.01 mm: a touch at that speed reads 0.05 mm
    below the surface (see Scene.piezo_depth).
    """
    motors = _motors("!x !y z !z1", uarts=2)
    ends = {
        "x": _End("^PC2", -5.5, 245.0, "60"),
        "y": _End("^PC3", -4.5, 258.0, "60"),
    }
    return Scene(
        name="qidi",
        kinematics="corexy",
        z_motors=[("z", -30.0, 122.0), ("z1", 275.0, 122.0)],
        world=WorldSpec(
            bed=BedSpec(
                x_max=245.0, y_max=245.0, z0=0.3137, slope_x=1e-4, slope_y=-1e-4
            ),
            switches=tuple(end.switch(axis) for axis, end in ends.items()),
            inductive=InductiveSpec(17.6, 4.4, sense_distance=1.2713),
            bed_sensor=BedSensorSpec(
                press_depth=0.04,
                enable_output=True,
                noise=NoiseSpec(latency=0.002),
            ),
        ),
        wiring=Wiring(
            motors,
            _inputs(ends, probe="^!PF0", bed_sensor="PC1"),
            {"bed_sensor_enable": "!PA14"},
            heaters=HEATERS,
        ),
        sections=_with(
            _sections("corexy", motors, ends, _SCREW, _QIDI),
            {"auto_z_offset": {"prepare_gcode": _SWITCHED_PREPARE}},
        ),
        start=Pose(5.0, 8.0, 12.0),
    )


def _qidi_two_boards(qidi: Scene) -> Scene:
    """The qidi as it is wired: all but tool head and heaters on "U_1".

    The inductive probe, on the main board, stops the Z motors late, the piezo
    bed at once.
    """
    wiring = qidi.wiring
    pins = {pin for motor in wiring.motors.values() for pin in motor.pins()}
    pins |= {*wiring.inputs.values(), *wiring.outputs.values()}
    pins.remove(wiring.inputs["probe"])
    scene = replace(qidi, name="qidi_two_boards")
    return on_board(scene, "U_1", OTHER_BOARD, pins)


def _piezo_cartesian(qidi: Scene) -> Scene:
    """The qidi as a cartesian without TMC drivers: one lead screw.

    The piezo bed is always on. The owner believes in a z_offset of 1 mm for
    the probe, 0.2713 mm too little.
    """
    scene = on_gantry(qidi, "piezo_cartesian", "cartesian", z=(122.0, 122.0))
    motors = {
        name: replace(motor, uart="")
        for name, motor in scene.wiring.motors.items()
    }
    changes = {
        "probe": {"z_offset": "1.0"},
        "auto_z_offset": {"prepare_gcode": _UNSWITCHED_PREPARE},
    }
    sections = dict(_with(scene.sections, changes))
    del sections["tmc2209 stepper_z"], sections["output_pin bed_sensor"]
    assert qidi.world.bed_sensor is not None
    return replace(
        scene,
        wiring=replace(scene.wiring, motors=motors, outputs={}),
        sections=sections,
    ).with_world(bed_sensor=replace(qidi.world.bed_sensor, enable_output=False))


_MEMBRANE = """
[stepper_z]
endstop_pin: ^PC2; position_endstop: 0; position_max: 250; position_min: -3
homing_speed: 5
[extra_probe membrane]
pin: ^!PF5; z_offset: 0.25; xy_position: 30, 20; speed: 3; lift_speed: 10
samples: 3; samples_result: median; sample_retract_dist: 2.0
samples_tolerance: 0.025; samples_tolerance_retries: 3
"""


def _membrane() -> Scene:
    """A cartesian with a membrane switch that somebody lays on the bed.

    Z is homed beside the bed, on a switch that the axis runs into when the
    nozzle is 0.45 mm below the bed; the owner has yet to find out and calls
    it 0. The membrane, 0.3 mm thick, triggers 0.25 mm above the bed.
    """
    motors = _motors("x y z")
    ends = {
        "x": _End("^PC0", -13.0, 220.0, "50"),
        "y": _End("^PC1", -7.0, 220.0, "50"),
    }
    z0 = 0.2137
    return Scene(
        name="membrane",
        kinematics="cartesian",
        z_motors=[("z", 110.0, 110.0)],
        world=WorldSpec(
            bed=BedSpec(
                x_max=220.0, y_max=220.0, z0=z0, slope_x=1e-4, slope_y=-1e-4
            ),
            switches=(
                *(end.switch(axis) for axis, end in ends.items()),
                AxisSwitchSpec("z_endstop", "z", z0 - 0.45, -1),
            ),
            membrane=MembraneSpec(
                30.0, 20.0, thickness=0.3, press=0.05, radius=9.0, laid=False
            ),
        ),
        wiring=Wiring(
            motors,
            _inputs(ends, z_endstop="^PC2", membrane="^!PF5"),
            heaters=HEATERS,
        ),
        sections=_sections("cartesian", motors, ends, _SCREW, _MEMBRANE),
        start=Pose(-8.0, -2.0, 12.0),
    )


def _membrane_two_boards(membrane: Scene) -> Scene:
    """The same with the membrane on a board of its own."""
    scene = replace(membrane, name="membrane_two_boards")
    return on_board(scene, "loadcell", OTHER_BOARD, ["^!PF5"])


def _membrane_and_probe(membrane: Scene) -> Scene:
    """The same with Z homed by a probe, such as a CR-Touch.

    It senses the bed 2.2713 mm below the nozzle; the owner says 2 mm.
    """
    inputs = {**membrane.wiring.inputs, "probe": "^PF0"}
    del inputs["z_endstop"]
    changes: dict[str, Options] = {
        "stepper_z": {
            "endstop_pin": "probe:z_virtual_endstop",
            "position_endstop": None,
        },
        "safe_z_home": {"home_xy_position": "92, 105", "z_hop": "10"},
        "probe": {
            "pin": inputs["probe"],
            "x_offset": "17.6",
            "y_offset": "4.4",
            "z_offset": "2.0",
            "speed": "5",
        },
    }
    return replace(
        membrane,
        name="membrane_and_probe",
        wiring=replace(membrane.wiring, inputs=inputs),
        sections=_with(membrane.sections, changes),
    ).with_world(
        switches=membrane.world.switches[:2],
        inductive=InductiveSpec(17.6, 4.4, sense_distance=2.2713),
    )


def _scenes() -> tuple[Scene, ...]:
    voron, qidi, membrane = _voron(), _qidi(), _membrane()
    z_steppers = {name: f"my_{name}" for name in ("z", "z1", "z2", "z3")}
    return (
        voron,
        _voron_two_boards(voron),
        _hybrid(voron),
        _corexz(voron),
        _generic(voron, "generic", **z_steppers),
        _separate_pin(voron),
        _cartesian(),
        qidi,
        _qidi_two_boards(qidi),
        _piezo_cartesian(qidi),
        _generic(qidi, "piezo_generic", z="left_z", z1="right_z"),
        membrane,
        _membrane_two_boards(membrane),
        _membrane_and_probe(membrane),
        _generic(membrane, "membrane_generic", z="my_z"),
    )


SCENES = {scene.name: scene for scene in _scenes()}


def servo(normally_open: bool = False) -> Scene:
    """The voron with a probe that an output swings out."""
    voron = SCENES["voron"]
    probe = replace(
        voron.world.mag_probe,
        mode="output",
        initial="docked",
        attach_time=0.05,
        normally_open=normally_open,
    )
    wiring = replace(voron.wiring, outputs={"probe_attach": "PD0"})
    return replace(voron, wiring=wiring).with_world(mag_probe=probe)
