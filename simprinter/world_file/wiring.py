"""Puts a printer.cfg and a world file together to a machine."""

from __future__ import annotations

import re
from dataclasses import replace

from ..printer_cfg import DELTA, GENERIC, PrinterCfg
from ..scene import Scene
from ..wiring import BoardSpec, Heater, Motor, Wiring
from ..world import WorldSpec, make_kinematics
from ..world.spec import SECOND, TOWERS
from .reading import Extra, WorldFile

_PLAIN = (
    "cartesian",
    "corexy",
    "corexz",
    "hybrid_corexy",
    "hybrid_corexz",
    DELTA,
)
# A slow axis or a limit changes nothing of how motors move the toolhead
_LIMITED = re.compile(r"limited_(cartesian|corexy|corexz)")
# The order in which klippy numbers the motors at the corners of a gantry, as
# (index of the corner for x, for y): front left, back left, back right, front
# right
_CORNERS = ((0, 0), (0, 1), (1, 1), (1, 0))
_HEATED = re.compile(r"extruder\d*|heater_bed|heater_generic .*")
_THERMOMETER = re.compile(r"temperature_(sensor|fan) .*")
# The bed is heavy
_BED = {"power": 1.0, "loss": 0.005}


def scene_of(cfg: PrinterCfg, world: WorldFile) -> Scene:
    """The machine, with the configuration that klippy is to get.

    Raises WorldFileError or PrinterCfgError where they do not fit together.
    """
    _require_wired(world)
    _require_carriages(cfg, world)
    motors = _motors(cfg, world)
    return Scene(
        name=cfg.name,
        kinematics=kinematics_of(cfg),
        z_motors=_z_motors(cfg, world, motors),
        world=_with_towers(cfg, world),
        wiring=Wiring(
            motors,
            dict(world.signals),
            dict(world.outputs),
            _heaters(cfg, world),
            _boards(cfg, world),
        ),
        sections=cfg.for_klippy(world.left_out),
        start=world.start,
        z_skew={
            name: world.motors[section]["higher_at_start_mm"]
            for name, section in cfg.steppers().items()
            if "higher_at_start_mm" in world.motors.get(section, {})
        },
    )


def kinematics_of(cfg: PrinterCfg) -> str:
    """What the world calls it. Raises PrinterCfgError for one it has not."""
    name = cfg.kinematics
    if name == GENERIC:
        return cfg.moved_like()
    limited = _LIMITED.fullmatch(name)
    if limited is None and name not in _PLAIN:
        known = ", ".join((*_PLAIN, GENERIC))
        told = f"of machines only {known} are simulated"
        raise cfg.error("printer", "kinematics", told)
    return limited[1] if limited else name


def _with_towers(cfg: PrinterCfg, world: WorldFile) -> WorldSpec:
    """The world, with a delta's towers as printer.cfg has them unless told.

    Raises WorldFileError where it has what is of no such machine.
    """
    spec, is_delta = world.spec, cfg.kinematics == DELTA
    if spec.towers and not is_delta:
        told = f"kinematics is {cfg.kinematics} in printer.cfg; leave them out"
        raise world.refuse("[towers]", len(spec.towers), told)
    axes = TOWERS if is_delta else ("x", "y", "z", SECOND)
    for switch in spec.switches:
        if switch.axis not in axes:
            told = f"this machine has the axes {', '.join(axes)}"
            raise world.refuse("[switches] axis", switch.axis, told)
    return replace(spec, towers=spec.towers or cfg.towers())


def _require_carriages(cfg: PrinterCfg, world: WorldFile) -> None:
    """Both files have a second carriage, or neither."""
    section, second = cfg.second_carriage, world.spec.second_carriage
    if section in world.left_out:
        section = None
    if section is not None and second is None:
        told = f"is missing; printer.cfg has [{section}], so say where it is"
        raise world.refuse("[second_carriage] x_world_mm", "", told)
    if second is not None and section is None:
        told = "printer.cfg has no [dual_carriage]; leave it out"
        raise world.refuse("[second_carriage] x_world_mm", second.x, told)


def _require_wired(world: WorldFile) -> None:
    """Each signal has a pin, no pin has two, and nothing else has one."""
    driven = set(world.spec.signals())
    for signal in sorted(driven - set(world.signals)):
        told = f'add {signal} = "PIN", as printer.cfg spells it'
        raise world.refuse(f"[signals] {signal}", "", f"is missing; {told}")
    pins: dict[str, str] = {}
    for signal, pin in world.signals.items():
        key = f"[signals] {signal}"
        if signal not in driven:
            told = f"nothing drives it; the parts of this world have {sorted(driven)}"
            raise world.refuse(key, pin, told)
        other = pins.setdefault(pin.lstrip("^~!"), signal)
        if other != signal:
            told = f"that is the pin of {other}, too; give each its own"
            raise world.refuse(key, pin, told)


def _motors(cfg: PrinterCfg, world: WorldFile) -> dict[str, Motor]:
    motors = cfg.motors()
    if world.spec.second_carriage is None:
        motors.pop(SECOND, None)
    names = {s: n for n, s in cfg.steppers().items() if n in motors}
    for section, extra in world.motors.items():
        if section not in names:
            raise world.refuse(
                f"[motors.{section}]", dict(extra), f"have {[*names]}"
            )
        name = names[section]
        if "microstep_mm" in extra:
            step = extra["microstep_mm"]
            motors[name] = replace(motors[name], step_dist=step)
    return motors


def _z_motors(
    cfg: PrinterCfg, world: WorldFile, motors: dict[str, Motor]
) -> list[tuple[str, float, float]]:
    """Each Z motor with the place where it holds the gantry or the bed."""
    if cfg.kinematics == DELTA:
        return []
    names = sorted(name for name in motors if name[0] == "z")
    sections = cfg.steppers()
    places = dict(zip(names, _places(cfg, len(names))))
    for name in names:
        extra = world.motors.get(sections[name], {})
        x, y = places[name]
        places[name] = (
            extra.get("x_world_mm", x),
            extra.get("y_world_mm", y),
        )
    made = [(name, *places[name]) for name in names]
    try:
        second = world.spec.second_carriage
        make_kinematics(kinematics_of(cfg), made, second=second)
    except ValueError as error:
        told = f"of the motors of this machine: {error}"
        raise cfg.error("printer", "kinematics", told) from None
    return made


def _places(cfg: PrinterCfg, count: int) -> list[tuple[float, float]]:
    """By the tilt's section; where there is none the gantry stays level."""
    for section in ("z_tilt", "z_tilt_ng"):
        found = points(cfg.get(section, "z_positions"))
        if len(found) == count:
            return found
    corners = points(cfg.get("quad_gantry_level", "gantry_corners"))
    if len(corners) == 2 and count == 4:
        return [(corners[i][0], corners[j][1]) for i, j in _CORNERS]
    return [(0.0, 0.0)] * count


def points(text: str | None) -> list[tuple[float, float]]:
    """Pairs of numbers, one a line."""
    number = r"(-?[\d.]+)"
    found = re.findall(rf"{number}\s*,\s*{number}", text or "")
    return [(float(x), float(y)) for x, y in found]


def _heaters(cfg: PrinterCfg, world: WorldFile) -> dict[str, Heater]:
    heaters = {}
    for section in cfg.sections:
        if section in world.left_out:
            continue
        is_heated = _HEATED.fullmatch(section) is not None
        if not is_heated and not _THERMOMETER.fullmatch(section):
            continue
        sensor = cfg.pin(section, "sensor_pin")
        pin = cfg.pin(section, "heater_pin") if is_heated else ""
        if sensor is None or pin is None:
            continue
        heaters[section] = _heater(
            section,
            {
                "pin": pin,
                "sensor_pin": sensor,
                **world.heaters.get(section, {}),
            },
        )
    for section, extra in world.heaters.items():
        if section not in heaters:
            if "sensor_pin" not in extra:
                told = (
                    f"have {sorted(heaters)}; give one that printer.cfg does"
                    " not have its sensor_pin"
                )
                raise world.refuse(f"[heaters.{section}]", dict(extra), told)
            heaters[section] = _heater(section, {"pin": "", **extra})
    return heaters


def _heater(section: str, extra: Extra) -> Heater:
    usual = _BED if section == "heater_bed" else {}
    return Heater(**{**usual, **extra})


def _boards(cfg: PrinterCfg, world: WorldFile) -> dict[str, BoardSpec]:
    boards = {name: BoardSpec() for name in cfg.boards()}
    for name, extra in world.boards.items():
        if name not in boards:
            told = f"have {sorted(boards)}"
            raise world.refuse(f"[boards.{name}]", dict(extra), told)
        boards[name] = BoardSpec(**extra)
    return boards
