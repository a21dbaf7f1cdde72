"""Named machines: those that files in machines/ describe, and others made of them.

A file is a printer.cfg, what the owner believes, or a world file of simprinter,
which is the truth.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Optional

from simprinter import scene as machine_scene
from simprinter.mcu.board import Crystal
from simprinter.plugin_printer import read_scene
from simprinter.scene import Options, Sections, heated
from simprinter.wiring import BoardSpec, Motor
from simprinter.world import AxisSwitchSpec, CarriageSpec, InductiveSpec
from simprinter.world.spec import SECOND

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


_FILES = Path(__file__).with_name("machines")


def machine(name: str) -> Scene:
    """The one that files of this name describe."""
    made = read_scene(_FILES / f"{name}.cfg", _FILES / f"{name}.toml")
    return Scene(**{**vars(made), "name": name})


# Its clock is slow, and its line takes as long as a USB line does: what it
# sees stops the motors of another one late
OTHER_BOARD = BoardSpec(
    Crystal(tick_ns=25, ppm=60, first_wrap=37), latency=0.002
)


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
    prepare = qidi.sections["auto_z_offset"]["prepare_gcode"]
    prepare = "".join(
        line
        for line in prepare.splitlines(keepends=True)
        if "SET_PIN" not in line
    ).rstrip()
    changes = {
        "probe": {"z_offset": "1.0"},
        "auto_z_offset": {"prepare_gcode": prepare},
    }
    sections = dict(_with(scene.sections, changes))
    del sections["tmc2209 stepper_z"], sections["output_pin bed_sensor"]
    assert qidi.world.bed_sensor is not None
    return replace(
        scene,
        wiring=replace(scene.wiring, motors=motors, outputs={}),
        sections=sections,
    ).with_world(bed_sensor=replace(qidi.world.bed_sensor, enable_output=False))


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


# How far the second nozzle of an IDEX hangs above the first, mm
SECOND_NOZZLE = -0.3


def idex(scene: Scene) -> Scene:
    """A cartesian scene with a second carriage, whose nozzle hangs lower.

    The probe stays on the first. Parked at X=290, nothing is below it.
    """
    end, motor = 290.0, Motor("PL0", "PL1", 0.0125, enable_pin="!PL2")
    switch = AxisSwitchSpec(f"{SECOND}_endstop", SECOND, end + 0.003)
    inputs = {**scene.wiring.inputs, switch.signal: "^PL3"}
    motors = {**scene.wiring.motors, SECOND: motor}
    section = {
        "axis": "x",
        "step_pin": motor.step_pin,
        "dir_pin": motor.dir_pin,
        "enable_pin": motor.enable_pin,
        "endstop_pin": inputs[switch.signal],
        "microsteps": "16",
        "rotation_distance": "40",
        "position_min": "0",
        "position_max": f"{end:g}",
        "position_endstop": f"{end:g}",
        "homing_speed": "50",
        "homing_retract_dist": "0",
        "safe_distance": "30",
    }
    return replace(
        scene,
        name=f"{scene.name}_idex",
        wiring=replace(scene.wiring, motors=motors, inputs=inputs),
        sections={**scene.sections, "dual_carriage": section},
    ).with_world(
        switches=(*scene.world.switches, switch),
        second_carriage=CarriageSpec(
            end - 10.0, z_offset=SECOND_NOZZLE, clearance=30.0
        ),
    )


def _scenes() -> tuple[Scene, ...]:
    voron, qidi, membrane = map(machine, ("voron", "qidi", "membrane"))
    z_steppers = {name: f"my_{name}" for name in ("z", "z1", "z2", "z3")}
    return (
        voron,
        _voron_two_boards(voron),
        _hybrid(voron),
        _corexz(voron),
        _generic(voron, "generic", **z_steppers),
        _separate_pin(voron),
        machine("cartesian"),
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
