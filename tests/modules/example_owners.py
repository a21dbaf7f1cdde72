"""Printers whose owners include the files of examples/z_calibration.

Each is a scene with what the examples do not bring: axes, homing, a probe and
its macros, levelling, a mesh.  Where things are is said here, not taken from the
files: their positions have to be right for these machines.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Optional

from simprinter import Scene, heated
from simprinter.world import (
    AxisSwitchSpec,
    BedSpec,
    DockSpec,
    MagProbeSpec,
    MeshSpec,
    PinSpec,
)
from tools.kit.scenes import SCENES

Point = tuple[float, float]
Sections = dict[str, Optional[dict[str, Optional[str]]]]

# Nobody has to wait for heaters here
POWER = 8.0  # C/s
# An example brings its own, or the printer homes as it is said here
BROUGHT = ("z_calibration", "safe_z_home")
CLEAN_NOZZLE = {
    "gcode": "\n  {% set nozzle = printer.extruder %}"
    "\n  RESPOND MSG='cleaned at {nozzle.temperature|int} C,"
    " target {nozzle.target|int}'"
}
SWITCHED = "\n  SET_PIN PIN=probe_magnet VALUE=%d\n  G4 P500"
# As the macros of a probe home
HOMING = """
  G90
  G1 Z10 F900
  G28 X Y
  G1 X{x:g} Y{y:g} F9000
  G28 Z
  G1 Z15 F900"""
# With the probe above the middle of the bed
PROBE_HOMING = """
  G90
  G1 Z10 F600
  G28 X Y
  ATTACH_PROBE
  G1 X152 Y125.25 F6000
  G28 Z
  G1 Z20 F600
  DOCK_PROBE"""
QUAD_GANTRY_LEVEL = {
    "gantry_corners": "\n  -60,-10\n  360,370",
    "points": "\n  50,25\n  50,225\n  250,225\n  250,25",
    "speed": "200",
    "horizontal_move_z": "15",
    "retries": "5",
    "retry_tolerance": "0.0075",
    "max_adjust": "10",
}
Z_TILT = {
    "z_positions": "\n  -50,18\n  150,348\n  350,18",
    "points": "\n  30,5\n  150,245\n  270,5",
    "speed": "200",
    "horizontal_move_z": "15",
    "retries": "5",
    "retry_tolerance": "0.0075",
}
# Height of the beds' planes at the pin, and of their middle above it, mm
PLANE, BUMP = 0.4, 0.06
FORWARD, RIGHT, UP = (0.0, -1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)


def lines_of(path: Path) -> str:
    """The lines of G-code that an example has in comments for PRINT_START."""
    _, heading, below = path.read_text(encoding="utf-8").partition(
        "# Lines for your own PRINT_START"
    )
    assert heading, path
    return "\n".join(re.findall(r"(?m)^#     (\S.*)$", below))


def print_start_of(path: Path) -> Sections:
    """A PRINT_START of these lines."""
    code = "".join(f"\n  {line}" for line in lines_of(path).splitlines())
    return {"gcode_macro PRINT_START": {"gcode": code}}


@dataclass(frozen=True)
class Owner:
    """A printer on which an example is used.

    bed: the point that CALIBRATE_Z is to touch. far: other points, of which a
    mesh knows the height.
    """

    scene: Scene
    bed: Point
    far: tuple[Point, ...] = ()


# Parts


def bed(size: float, pin: Point, slope_x: float, slope_y: float) -> BedSpec:
    """A square bed that is higher in the middle than at the rim.

    Three points a side show all of it. The pin stands as high over its plane
    as in the scenes, and askew with it.
    """
    rim = (0.0, 0.0, 0.0)
    last = size - 30.0
    return BedSpec(
        x_max=size,
        y_max=size,
        z0=PLANE - slope_x * pin[0] - slope_y * pin[1],
        slope_x=slope_x,
        slope_y=slope_y,
        mesh=MeshSpec(30.0, 30.0, last, last, (rim, (0.0, BUMP, 0.0), rim)),
    )


def dock(
    x: float,
    y: float,
    z: float,
    take: tuple[float, float, float] = FORWARD,
    leave: tuple[float, float, float] = RIGHT,
) -> DockSpec:
    """A dock, and the ways out of it with and without the probe."""
    return DockSpec(x, y, z, reach=5.0, approach=take, release=leave)


def probe_of(base: str, **changes: Any) -> MagProbeSpec:
    """The probe of a scene, in a dock."""
    probe = SCENES[base].world.mag_probe
    assert probe is not None
    in_dock = {"mode": "dock", "initial": "docked", "attach_time": 0.0}
    return replace(probe, **{**in_dock, **changes})


def axis(low: float, high: float, home: float) -> dict[str, Optional[str]]:
    """Options of a stepper that homes at one end."""
    return {
        "position_min": f"{low:g}",
        "position_max": f"{high:g}",
        "position_endstop": f"{home:g}",
    }


def switches(x: float, y: float, direction: int) -> tuple[AxisSwitchSpec, ...]:
    """Endstops of X and Y, a bit beyond where they are believed to be."""
    return tuple(
        AxisSwitchSpec(f"{n}_endstop", n, end + direction * 0.003, direction)
        for n, end in (("x", x), ("y", y))
    )


# Macros


def wrapped(command: str) -> dict[str, Optional[str]]:
    """A macro that attaches and docks the probe around a command."""
    code = f"\n  ATTACH_PROBE\n  _{command}\n  DOCK_PROBE"
    return {"rename_existing": f"_{command}", "gcode": code}


def _through(spot: DockSpec, way: tuple[float, ...]) -> dict[str, Any]:
    """Into the dock from where the probe is taken, out another way, aside.

    The G-code offset is away meanwhile, as in Klicky's macros.
    """
    x, y, z = (20.0 * share for share in spot.approach)
    out_x, out_y, out_z = (30.0 * share for share in way)
    code = (
        "\n  SAVE_GCODE_STATE NAME=probe"
        "\n  SET_GCODE_OFFSET Z=0"
        "\n  G90"
        f"\n  G1 Z{spot.z + z} F900"
        f"\n  G1 X{spot.x + x} Y{spot.y + y} F9000"
        f"\n  G1 X{spot.x} Y{spot.y} Z{spot.z} F3000"
        f"\n  G1 X{spot.x + out_x} Y{spot.y + out_y} Z{spot.z + out_z}"
        f"\n  G1 X{spot.x + x} Y{spot.y + y} F9000"
        "\n  M400"
        "\n  RESTORE_GCODE_STATE NAME=probe"
    )
    return {"gcode": code}


def dock_macros(spot: DockSpec) -> Sections:
    """The macros of a probe with a dock, of Klicky's names."""
    return {
        "gcode_macro ATTACH_PROBE": _through(spot, spot.approach),
        "gcode_macro DOCK_PROBE": _through(spot, spot.release),
        "gcode_macro DOCK_PROBE_UNLOCK": {"gcode": "\n  DOCK_PROBE"},
    }


def mesh(zero: Point, low: Point, high: Point) -> Sections:
    """Three points a side show all there is of these beds."""
    places = {
        "zero_reference_position": zero,
        "mesh_min": low,
        "mesh_max": high,
    }
    options = {name: f"{x:g}, {y:g}" for name, (x, y) in places.items()}
    own = {"probe_count": "3,3", "speed": "200", "horizontal_move_z": "15"}
    return {"bed_mesh": {**options, **own}}


def safe_z_home(x: float, y: float, hop: float = 10.0) -> Sections:
    """Z homed where the nozzle is above the pin."""
    options = {"home_xy_position": f"{x:g}, {y:g}", "z_hop": f"{hop:g}"}
    return {"safe_z_home": {**options}}


def homing(x: float, y: float) -> Sections:
    """A way to home that an example leaves to the macros of the probe."""
    code = HOMING.format(x=x, y=y)
    return {
        "homing_override": {"axes": "z", "set_position_z": "0", "gcode": code}
    }


# Machines

MESH_300 = mesh((150.0, 150.0), (30.0, 30.0), (270.0, 270.0))


def _machine(
    base: str,
    sections: Sections,
    z_motors: Optional[list[tuple[str, float, float]]] = None,
    **world: Any,
) -> Scene:
    """A scene with other sections and another world.

    z_motors: those that it keeps (default: all).
    """
    scene = heated(SCENES[base])
    merged = dict(scene.sections)
    for name in BROUGHT:
        del merged[name]
    sections = {
        "respond": {},
        "gcode_macro CLEAN_NOZZLE": CLEAN_NOZZLE,
        **sections,
    }
    for name, options in sections.items():
        merged[name] = {**(merged.get(name) or {}), **(options or {})}
    merged["probe"] = {**(merged["probe"] or {}), "samples": "2"}
    motors = dict(scene.wiring.motors)
    if z_motors is not None:
        kept = {name for name, _, _ in z_motors}
        for name in set(motors) - kept - {"x", "y"}:
            del motors[name], merged[f"stepper_{name}"]
    heaters = {
        name: replace(heater, power=POWER)
        for name, heater in scene.wiring.heaters.items()
    }
    return replace(
        scene,
        sections=merged,
        z_motors=z_motors or scene.z_motors,
        wiring=replace(scene.wiring, motors=motors, heaters=heaters),
    ).with_world(**world)


def _without_output(scene: Scene) -> Scene:
    """The same without the output that holds the probe."""
    sections = {**scene.sections, "output_pin probe_magnet": None}
    wiring = replace(scene.wiring, outputs={})
    return replace(scene, sections=sections, wiring=wiring)


def voron24() -> Owner:
    """The voron with a gantry that hangs askew, and Klicky's macros.

    Levelling and mesh attach and dock the probe by themselves.
    """
    spot = dock(20.0, 305.0, 25.0)
    scene = _machine(
        "voron",
        {
            **dock_macros(spot),
            **homing(206.0, 306.0),
            **MESH_300,
            "quad_gantry_level": QUAD_GANTRY_LEVEL,
            "gcode_macro QUAD_GANTRY_LEVEL": wrapped("QUAD_GANTRY_LEVEL"),
            "gcode_macro BED_MESH_CALIBRATE": wrapped("BED_MESH_CALIBRATE"),
        },
        bed=bed(300.0, (206.0, 306.0), 0.003, 0.009),
        mag_probe=probe_of("voron"),
        dock=spot,
    )
    return Owner(scene, (150.0, 150.0), ((30.0, 30.0), (270.0, 150.0)))


def trident() -> Owner:
    """Three Z motors; bed and pin stand askew to the gantry."""
    spot = dock(20.0, 300.0, 25.0)
    scene = _machine(
        "voron",
        {
            **dock_macros(spot),
            **safe_z_home(173.0, 300.5),
            **MESH_300,
            "stepper_y": axis(0.0, 306.0, 306.0),
            "probe": {"x_offset": "-2", "y_offset": "24", "z_offset": "6.5"},
            "z_tilt": Z_TILT,
        },
        [("z", -50.0, 18.0), ("z1", 150.0, 348.0), ("z2", 350.0, 18.0)],
        bed=replace(bed(300.0, (173.0, 300.5), -0.003, 0.009), y_max=295.0),
        pin=PinSpec(173.0, 300.5, 2.1, radius=2.5),
        switches=switches(300.0, 306.0, 1),
        mag_probe=probe_of("voron", y_offset=24.0, body_drop=6.2),
        dock=spot,
    )
    return Owner(scene, (150.0, 150.0), ((30.0, 30.0), (270.0, 150.0)))


def late_probe() -> Owner:
    """CoreXY without levelling or mesh.

    The body would meet the bed while the nozzle is on the pin.
    """
    spot = dock(20.0, 215.0, 20.0)
    scene = _machine(
        "cartesian",
        {
            **dock_macros(spot),
            **homing(226.0, 210.0),
            "printer": {"kinematics": "corexy"},
            "probe": {"z_offset": "4.7"},
        },
        pin=PinSpec(226.0, 210.0, 0.3512, radius=2.5, pretravel=0.2),
        mag_probe=probe_of("cartesian", body_drop=4.0),
        dock=spot,
    )
    scene = replace(_without_output(scene), kinematics="corexy")
    return Owner(scene, (110.0, 110.0))


def euclid() -> Owner:
    """One Z motor, and the dock at the front left; the example has macros."""
    scene = _machine(
        "voron",
        {
            **safe_z_home(206.0, 306.0, 15.0),
            **MESH_300,
            "stepper_x": axis(-2.0, 300.0, 300.0),
            "stepper_y": axis(-2.0, 310.0, 310.0),
            "probe": {"x_offset": "2", "y_offset": "25", "z_offset": "9.5"},
        },
        [("z", 150.0, 150.0)],
        bed=bed(300.0, (206.0, 306.0), 2e-4, -3e-4),
        mag_probe=probe_of("voron", x_offset=2.0, y_offset=25.0, body_drop=9.1),
        dock=dock(0.0, 0.0, 15.0, take=(0.0, 1.0, 0.0)),
    )
    return Owner(scene, (150.0, 150.0), ((30.0, 30.0), (270.0, 150.0)))


def cartesian() -> Owner:
    """The dock is at the left, and lifting the toolhead leaves the probe in it."""
    spot = dock(-6.0, 118.0, 20.0, take=RIGHT, leave=UP)
    scene = _machine(
        "cartesian",
        {
            **dock_macros(spot),
            **safe_z_home(244.0, 118.0),
            **mesh((118.0, 118.0), (30.0, 20.0), (215.0, 215.0)),
            "stepper_x": axis(-8.0, 250.0, -8.0),
            "stepper_y": axis(-4.0, 235.0, -4.0),
            "stepper_z": {"position_endstop": "1.7"},
            "probe": {"x_offset": "26", "y_offset": "0", "z_offset": "5"},
        },
        bed=bed(235.0, (244.0, 118.0), 2e-4, -3e-4),
        pin=PinSpec(244.0, 118.0, 2.1, radius=2.5, pretravel=0.2),
        mag_probe=probe_of(
            "cartesian", x_offset=26.0, y_offset=0.0, body_drop=4.3
        ),
        dock=spot,
    )
    far = (30.0, 20.0), (215.0, 215.0)
    return Owner(_without_output(scene), (118.0, 118.0), far)


def separate_pin() -> Owner:
    """The voron that homes Z with its probe, which an output attaches."""
    scene = _machine(
        "separate_pin",
        {
            "homing_override": {
                "axes": "xyz",
                "set_position_z": "0",
                "gcode": PROBE_HOMING,
            },
            **MESH_300,
            "gcode_macro ATTACH_PROBE": {"gcode": SWITCHED % 1},
            "gcode_macro DOCK_PROBE": {"gcode": SWITCHED % 0},
            "output_pin probe_magnet": {"pin": "PD0"},
            "quad_gantry_level": QUAD_GANTRY_LEVEL,
        },
        bed=bed(300.0, (206.0, 306.0), 0.001, 0.001),
        mag_probe=probe_of("voron", mode="output", attach_time=0.2),
    )
    wiring = replace(
        scene.wiring,
        inputs={**scene.wiring.inputs, "nozzle_endstop": "^PG10"},
        outputs={"probe_attach": "PD0"},
    )
    scene = replace(scene, wiring=wiring)
    return Owner(scene, (150.0, 150.0), ((30.0, 30.0), (270.0, 150.0)))


OWNERS = {
    "voron24_klicky": voron24(),
    "trident_z_tilt": trident(),
    "voron_late_probe": late_probe(),
    "euclid": euclid(),
    "cartesian_switch": cartesian(),
    "separate_pin": separate_pin(),
}
