"""The commands that are measured, each on its standard machine."""

from __future__ import annotations

import configparser
import math
from collections.abc import Callable
from typing import NamedTuple, Union

from simprinter import Scene, heated
from simprinter.world.bed import Bed
from tools.bench.lower_bounds import (
    Limits,
    Plan,
    Route,
    Stop,
    move_seconds,
    z_seconds,
)
from tools.kit.auto_z_offset import POINT
from tools.kit.docks import DOCK_SCENES, HANG
from tools.kit.product import pace
from tools.kit.scenes import SCENES, Sections

# Enough for its standard deviation, and as many as PROBE_ACCURACY takes
ACCURACY_SAMPLES = 10

# A macro that runs prepare_gcode alone
PREPARE = "BENCH_PREPARE"


class Command(NamedTuple):
    """A command of a module on a machine with changes to its printer.cfg.

    sites: all that it has to touch, as the truth calls them. plan: what its
    lower bound is made of. prepare: a macro with what it runs of the user's
    before it touches anything.
    """

    name: str
    script: str
    module: str
    scene: Scene
    changes: Sections
    sites: tuple[str, ...]
    plan: Callable[[Scene, Sections], Union[Plan, Route]]
    prepare: str = ""


def _read(scene: Scene, changes: Sections) -> configparser.ConfigParser:
    config = configparser.ConfigParser(delimiters=(":",), interpolation=None)
    config.read_string(scene.config("", changes))
    return config


def _pair(text: str) -> tuple[float, float]:
    x, y = map(float, text.split(","))
    return x, y


def _limits(config: configparser.ConfigParser) -> Limits:
    section = config["printer"]
    names = ("max_velocity", "max_accel", "max_z_velocity", "max_z_accel")
    return Limits(*(section.getfloat(name) for name in names))


# z_calibration

STANDARD: Sections = {
    "z_calibration": {
        "safe_z_height": "15",
        "samples": "3",
    },
    # Of the pin only: on the bed the probe's own are used
    "stepper_z": {"second_homing_speed": "2", "homing_retract_dist": "2"},
    "probe": {"samples": "3", "speed": "5", "lift_speed": "10"},
}


def calibrate_plan(scene: Scene, changes: Sections) -> Plan:
    """What CALIBRATE_Z has to do: nozzle and switch on the pin, then the bed.

    Of the options with a default, the standard machine's are understood.
    """
    config = _read(scene, changes)
    own = config["z_calibration"]
    # As fast as its user moves Z elsewhere
    z_speed = max(
        config["probe"].getfloat("lift_speed"),
        config["stepper_z"].getfloat("homing_speed"),
    )
    stops = [
        stop._replace(
            approach_speed=own.getfloat("probing_speed", z_speed),
            lift_speed=own.getfloat("lift_speed", z_speed),
            retract=own.getfloat("probing_retract_dist", pace.SHORTEST_LIFT),
        )
        for stop in (*_pin_stops(config, scene), _bed_stop(config, scene))
    ]
    plan = _pin_plan(config, tuple(stops))
    return plan._replace(travel_speed=own.getfloat("speed", 100.0))


def accuracy_plan(scene: Scene, changes: Sections) -> Plan:
    """What PROBE_Z_ACCURACY has to do: only the nozzle, but more often."""
    config = _read(scene, changes)
    nozzle = _pin_stops(config, scene)[0]
    return _pin_plan(config, (nozzle._replace(samples=ACCURACY_SAMPLES),))


def _pin_plan(
    config: configparser.ConfigParser, stops: tuple[Stop, ...]
) -> Plan:
    own = config["z_calibration"]
    return Plan(
        stops,
        end_z=own.getfloat("safe_z_height"),
        travel_speed=own.getfloat("speed", 50.0),
        limits=_limits(config),
    )


def _approach(config: configparser.ConfigParser) -> tuple[float, float]:
    """Height (mm) and speed (mm/s) at which the way down to a touch begins."""
    own = config["z_calibration"]
    homing_speed = config["stepper_z"].getfloat("homing_speed")
    speed = own.getfloat("probing_speed", homing_speed)
    return own.getfloat("safe_z_height"), speed


def _pin_stops(
    config: configparser.ConfigParser, scene: Scene
) -> tuple[Stop, Stop]:
    own, probe = config["z_calibration"], config["probe"]
    true_probe = scene.world.mag_probe
    assert true_probe is not None
    sampling = (
        own.getint("samples", probe.getint("samples")),
        config["stepper_z"].getfloat("second_homing_speed"),
        config["stepper_z"].getfloat("homing_retract_dist"),
        own.getfloat("lift_speed", probe.getfloat("lift_speed")),
        _limits(config).z_accel,
    )
    # Homing makes position_endstop of the height at which the pin triggers
    pin_z = config["stepper_z"].getfloat("position_endstop")
    body_z = pin_z + true_probe.body_drop
    nozzle = _pair(own["nozzle_xy_position"])
    switch = _pair(own["switch_xy_position"])
    way = _approach(config)
    return (
        Stop("nozzle", *nozzle, pin_z, *way, *sampling),
        Stop("switch", *switch, body_z, *way, *sampling),
    )


def _bed_stop(config: configparser.ConfigParser, scene: Scene) -> Stop:
    probe, world = config["probe"], scene.world
    pin, true_probe = world.pin, world.mag_probe
    assert pin is not None
    assert true_probe is not None
    x, y = _pair(config["z_calibration"]["bed_xy_position"])
    x -= probe.getfloat("x_offset")
    y -= probe.getfloat("y_offset")
    z = config["stepper_z"].getfloat("position_endstop") - pin.z
    z += true_probe.body_drop + true_probe.switch_offset
    z += Bed(world.bed).height(x + true_probe.x_offset, y + true_probe.y_offset)
    return Stop(
        "bed",
        x,
        y,
        z,
        *_approach(config),
        probe.getint("samples"),
        probe.getfloat("speed"),
        probe.getfloat("sample_retract_dist"),
        probe.getfloat("lift_speed"),
        _limits(config).z_accel,
    )


# auto_z_offset

PREPARED: Sections = {
    f"gcode_macro {PREPARE}": {
        "gcode": SCENES["qidi"].sections["auto_z_offset"]["prepare_gcode"]
    }
}


# So far (mm) above a trigger whose height is known a touch begins
KNOWN_TOUCH = 2.0


def cycles_plan(scene: Scene, changes: Sections) -> Plan:
    """What AUTO_Z_CALIBRATE has to do: bed sensor and probe in turn.

    One touch of each in a cycle, down from the travel height at `lift_speed` to
    KNOWN_TOUCH above the trigger, but the first one of the nozzle, of which
    nothing is known, at `speed` all the way. There is no option for the speed of
    travel, which is the fastest of the printer. At the end the nozzle stands
    over the point that was measured, for a sheet of paper.
    """
    config = _read(scene, changes)
    own, probe = config["auto_z_offset"], config["probe"]
    limits = _limits(config)
    true_probe = scene.world.inductive
    assert true_probe is not None
    # Z is homed with the probe: it triggers at its z_offset
    probe_z = probe.getfloat("z_offset")
    sensor_z = probe_z - true_probe.sense_distance - scene.piezo_depth()
    hop = own.getfloat("probe_hop")
    travel_z = sensor_z + hop
    slow = own.getfloat("probe_accel")
    x_offset, y_offset = probe.getfloat("x_offset"), probe.getfloat("y_offset")
    beside = POINT[0] - x_offset, POINT[1] - y_offset
    lift_speed = own.getfloat("lift_speed")
    one = (lift_speed, 1, own.getfloat("speed"))

    first = max(probe_z, 0.0) + hop
    sensor = Stop(
        *("sensor", *POINT, sensor_z, travel_z, *one),
        *(KNOWN_TOUCH, lift_speed, slow),
    )
    probe_stop = Stop(
        *("probe", *beside, probe_z, travel_z, *one),
        *(KNOWN_TOUCH, lift_speed, limits.z_accel),
    )
    stops = [sensor, probe_stop] * own.getint("offset_samples")
    stops[0] = sensor._replace(travel_z=first, retract=first - sensor_z)
    return Plan(stops, travel_z, limits.velocity, limits, end=POINT)


# dockable_probe

# Where Z is homed, and the toolhead begins: 100 mm from the dock
BESIDE_DOCK = (50.0, 208.0)
DOCKED: Sections = {
    "dockable_probe": {"samples": "1", "travel_speed": "100"},
    "safe_z_home": {
        "home_xy_position": "%g, %g" % BESIDE_DOCK,
        "z_hop": "10",
    },
}


def _trip(
    config: configparser.ConfigParser, ends: tuple[tuple[float, float], ...]
) -> list[float]:
    """Seconds to the dock and away from it, and there again to dock.

    ends: where it begins, and where the probe is used (mm).
    """
    own, limits = config["dockable_probe"], _limits(config)
    dock, approach, detach = (
        _pair(own[f"{name}_position"])
        for name in ("dock", "approach", "detach")
    )
    travel, fetch = own.getfloat("travel_speed"), own.getfloat("attach_speed")
    strip, found = own.getfloat("detach_speed"), []
    for way in (
        ((ends[0], approach, travel), (approach, dock, fetch))
        + ((dock, approach, fetch), (approach, ends[1], travel)),
        ((ends[1], approach, travel), (approach, dock, fetch))
        + ((dock, detach, strip), (detach, ends[0], travel)),
    ):
        seconds = math.fsum(
            move_seconds(math.dist(a, b), speed, limits.accel)
            for a, b, speed in way
        )
        found.append(seconds)
    return found


def trip_plan(scene: Scene, changes: Sections) -> Route:
    """What ATTACH_PROBE and DETACH_PROBE have to do, and the way back."""
    config = _read(scene, changes)
    return Route(sum(_trip(config, (BESIDE_DOCK, BESIDE_DOCK))))


def mesh_plan(scene: Scene, changes: Sections) -> Route:
    """What G28 and a mesh have to do, without X and Y of G28.

    Two trips to the dock; homing Z twice; down and up again at each point.
    """
    config = _read(scene, changes)
    limits, mesh, own = (
        _limits(config),
        config["bed_mesh"],
        config["dockable_probe"],
    )
    low, high = _pair(mesh["mesh_min"]), _pair(mesh["mesh_max"])
    columns, rows = map(int, _pair(mesh["probe_count"]))
    x, y = own.getfloat("x_offset"), own.getfloat("y_offset")
    first, last = (low[0] - x, low[1] - y), (high[0] - x, high[1] - y)
    trips = _trip(config, (BESIDE_DOCK, BESIDE_DOCK))
    trips += _trip(config, (BESIDE_DOCK, first))[:1]
    trips += _trip(config, (last, first))[1:]
    step = (high[0] - low[0]) / (columns - 1), (high[1] - low[1]) / (rows - 1)
    moves = [step[0]] * (columns - 1) * rows + [step[1]] * (rows - 1)
    speed, lift = mesh.getfloat("speed"), own.getfloat("lift_speed")
    drop = mesh.getfloat("horizontal_move_z") - HANG
    z, back = config["stepper_z"], config["stepper_z"].getfloat
    retract = z.getfloat("homing_retract_dist")

    def down(distance: float, speed: float) -> float:
        return z_seconds(limits, distance, speed, limits.z_accel, stops=False)

    def up(distance: float, speed: float) -> float:
        return z_seconds(limits, distance, speed, limits.z_accel)

    touches = columns * rows
    return Route(
        sum(trips)
        + down(retract, back("second_homing_speed"))
        + up(retract, back("homing_speed"))
        + sum(move_seconds(mm, speed, limits.accel) for mm in moves)
        + touches * down(drop, own.getfloat("speed"))
        + (touches - 1) * up(drop, lift)
    )


CALIBRATE_Z = Command(
    "CALIBRATE_Z",
    "CALIBRATE_Z",
    "z_calibration",
    heated(SCENES["voron"]),
    STANDARD,
    ("nozzle_pin", "body_pin", "probe_bed"),
    calibrate_plan,
)
PROBE_Z_ACCURACY = Command(
    "PROBE_Z_ACCURACY",
    f"PROBE_Z_ACCURACY SAMPLES={ACCURACY_SAMPLES}",
    "z_calibration",
    heated(SCENES["voron"]),
    STANDARD,
    ("nozzle_pin",),
    accuracy_plan,
)
AUTO_Z_CALIBRATE = Command(
    "AUTO_Z_CALIBRATE",
    "AUTO_Z_CALIBRATE",
    "auto_z_offset",
    heated(SCENES["qidi"]),
    PREPARED,
    ("nozzle_bed", "inductive_bed"),
    cycles_plan,
    PREPARE,
)
ATTACH_AND_DETACH = Command(
    "ATTACH_PROBE, DETACH_PROBE",
    "ATTACH_PROBE\nDETACH_PROBE",
    "dockable_probe",
    DOCK_SCENES["dock_gantry"],
    DOCKED,
    (),
    trip_plan,
)
HOME_AND_MESH = Command(
    "G28, BED_MESH_CALIBRATE",
    "G28\nBED_MESH_CALIBRATE\nBED_MESH_CLEAR",
    "dockable_probe",
    DOCK_SCENES["dock_gantry"],
    DOCKED,
    ("probe_bed",),
    mesh_plan,
)
COMMANDS = (
    CALIBRATE_Z,
    PROBE_Z_ACCURACY,
    AUTO_Z_CALIBRATE,
    ATTACH_AND_DETACH,
    HOME_AND_MESH,
)
