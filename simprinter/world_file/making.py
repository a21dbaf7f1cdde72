"""Makes a world file from a printer.cfg, as far as that says what is there."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import NamedTuple, Optional

from ..printer_cfg import DELTA, PrinterCfg
from ..world.spec import SECOND, TOWERS
from .wiring import kinematics_of

# mm that the toolhead stands off an endstop at first: the way there proves nothing
_AWAY = 20.0
_AWAY_Z = 10.0
# mm that the bed is below a switch that Z homes on
_CLEAR = 0.5
# Sections whose hardware is not simulated, see LIMITS.md
_NOT_SIMULATED = re.compile(
    r"(adxl345|lis2dw|lis3dh|mpu9250|icm20948|resonance_tester|bltouch"
    r"|dotstar|pca9533|pca9632|display|tmc2130|tmc2240|tmc2660"
    r"|tmc5160"
    r"|load_cell|load_cell_probe|probe_eddy_current|hall_filament_width_sensor"
    r"|tsl1401cl_filament_width_sensor|mcp4018|ad5206|mcp4451|mcp4728"
    r"|replicape|sx1509|angle|palette2|aht10)\b.*"
)
_READ_OTHERWISE = re.compile(
    r"temperature_mcu|temperature_host|rpi_temperature|BME\w+|HTU21D|SI\w+"
    r"|SHT\w+|AHT\w+|LM75|DS18B20|MAX\w+",
    re.IGNORECASE,
)


class _Axis(NamedTuple):
    """What printer.cfg says of an axis, mm; at: None without a switch."""

    low: float
    high: float
    at: Optional[float]
    pin: Optional[str]
    is_up: bool


def made_from(cfg: PrinterCfg) -> str:
    """The text of a world file that fits. Raises PrinterCfgError.

    World frame: x, y and z as printer.cfg has them, if that is right: z = 0 is
    the surface of the bed.
    """
    kinematics_of(cfg)
    cfg.motors()
    is_delta = cfg.kinematics == DELTA
    axes = _axes_of_delta(cfg) if is_delta else _axes(cfg)
    ends = {name: _tower(cfg, name) for name in TOWERS} if is_delta else axes
    signals: dict[str, str] = {}
    others = {
        n: s for n, s in cfg.steppers().items() if n not in (*ends, SECOND)
    }
    parts = [
        _head(cfg),
        _left_out(cfg),
        _start(axes),
        _bed(axes),
        *_second_carriage(cfg, signals),
        *_switches(cfg, ends, signals),
        *_other_switches(cfg, others, axes, signals),
        *_probe(cfg, signals),
        _signals(signals),
    ]
    return "\n".join(part for part in parts if part)


def _axes(cfg: PrinterCfg) -> dict[str, _Axis]:
    return {axis: _axis(cfg, axis) for axis in "xyz"}


def _axes_of_delta(cfg: PrinterCfg) -> dict[str, _Axis]:
    """What the head of a delta does: no axis has a switch, Z is homed upwards."""
    radius = cfg.number("printer", "delta_radius")
    wide = cfg.number("printer", "print_radius", radius)
    low = cfg.number("printer", "minimum_z_position", 0.0)
    high = min(_tower(cfg, name).high for name in TOWERS)
    across = _Axis(-wide, wide, None, None, False)
    return {
        "x": across,
        "y": across,
        "z": _Axis(low, high, high, None, True),
    }


def _tower(cfg: PrinterCfg, name: str) -> _Axis:
    section = f"stepper_{name}"
    usual = cfg.number("stepper_a", "position_endstop")
    at = cfg.number(section, "position_endstop", usual)
    return _Axis(0.0, at, at, cfg.pin(section, "endstop_pin"), True)


def _second_carriage(cfg: PrinterCfg, signals: dict[str, str]) -> Iterator[str]:
    section = cfg.second_carriage
    if section is None:
        return
    axis = _axis_of(cfg, section)
    if axis.at is None or axis.pin is None:
        told = "give it a pin of a board: without, it cannot be homed"
        raise cfg.error(section, "endstop_pin", told)
    signals[f"{SECOND}_endstop"] = axis.pin
    x = axis.at - _AWAY if axis.is_up else axis.at + _AWAY
    yield f"""\
# The second carriage, with a nozzle of its own. How that hangs beside the first,
# and how near the two come to each other, is not known: a guess.
[second_carriage]
x_world_mm = {x:g}
y_from_first_nozzle_mm = 0
z_from_first_nozzle_mm = 0
nearest_to_first_nozzle_mm = 0

[[switches]]
signal = "{SECOND}_endstop"
axis = "{SECOND}"
trigger_world_mm = {axis.at:g}
direction = {1 if axis.is_up else -1}
"""


def _axis(cfg: PrinterCfg, axis: str) -> _Axis:
    return _axis_of(cfg, cfg.axis_section(axis))


def _axis_of(cfg: PrinterCfg, section: str) -> _Axis:
    high = cfg.number(section, "position_max")
    low = cfg.number(section, "position_min", 0.0)
    pin = cfg.pin(section, "endstop_pin")
    if pin is None:
        return _Axis(low, high, None, None, False)
    at = cfg.number(section, "position_endstop")
    told = (cfg.get(section, "homing_positive_dir") or "").lower()
    is_up = told in ("true", "1", "yes", "on") if told else at - low > high - at
    return _Axis(low, high, at, pin, is_up)


def _head(cfg: PrinterCfg) -> str:
    return f"""\
# The machine behind {cfg.name}, as far as that file tells.
# World frame: mm, x to the right, y to the back, z up. x, y and z are those of
# printer.cfg, and z = 0 is the bed. What a comment calls a guess, measure.
# All keys: `simprinter world --schema`.
"""


def _left_out(cfg: PrinterCfg) -> str:
    names = [n for n in cfg.sections if _is_not_simulated(cfg, n)]
    if not names:
        return ""
    lines = "".join(f'    "{name}",\n' for name in names)
    return f"""\
# Their hardware is not simulated: klippy is started without these.
leave_out_sections = [
{lines}]
"""


def _is_not_simulated(cfg: PrinterCfg, section: str) -> bool:
    if _NOT_SIMULATED.fullmatch(section):
        return True
    kind = cfg.get(section, "sensor_type") or ""
    is_thermometer = section.startswith(("temperature_", "thermistor "))
    return is_thermometer and _READ_OTHERWISE.fullmatch(kind) is not None


def _start(axes: dict[str, _Axis]) -> str:
    places = []
    for name, axis in axes.items():
        away = _AWAY_Z if name == "z" else _AWAY
        if axis.at is None:
            place = away if name == "z" else (axis.low + axis.high) / 2.0
        else:
            place = axis.at - away if axis.is_up else axis.at + away
        places.append(f"{name}_world_mm = {place:g}")
    lines = "\n".join(places)
    return f"""\
# Where the nozzle is when the printer is switched on: near its endstops.
[start]
{lines}
"""


def _bed(axes: dict[str, _Axis]) -> str:
    x, y, z = axes["x"], axes["y"], axes["z"]
    height, note = 0.0, ""
    if z.at is not None and not z.is_up and z.at < _CLEAR:
        height = z.at - _CLEAR
        note = (
            f"# Z homes on a switch at {z.at:g}: so that homing over it does no"
            f" harm, it is {_CLEAR:g} mm\n# lower, which is a guess.\n"
        )
    return f"""\
# printer.cfg does not say how large the bed is, how it lies, or what shape it
# has. A guess: it is as large as the toolhead goes, level and flat.
{note}\
[bed]
x_min_world_mm = {_edge(x):g}
x_max_world_mm = {x.high:g}
y_min_world_mm = {_edge(y):g}
y_max_world_mm = {y.high:g}
z_world_mm = {height:g}
slope_x_mm_per_mm = 0.0
slope_y_mm_per_mm = 0.0
"""


def _edge(axis: _Axis) -> float:
    """Beyond zero is no bed, but where zero is in the middle."""
    return axis.low if axis.low == -axis.high else max(0.0, axis.low)


def _switches(
    cfg: PrinterCfg, axes: dict[str, _Axis], signals: dict[str, str]
) -> Iterator[str]:
    for name, axis in axes.items():
        if axis.pin is None:
            yield (
                f"# [{cfg.axis_section(name)}] has no switch of its own that is"
                " simulated.\n"
            )
            continue
        signals[f"{name}_endstop"] = axis.pin
        note = "Noise and a hard stop are not known."
        if name == "z":
            note += (
                "\n# Where the nozzle presses a pin beside the bed, [z_pin] says"
                " where that is;\n# then take these lines away."
            )
        yield f"# Where position_endstop says. {note}\n{_switch(name, axis)}"


def _other_switches(
    cfg: PrinterCfg,
    steppers: dict[str, str],
    axes: dict[str, _Axis],
    signals: dict[str, str],
) -> Iterator[str]:
    """Of a second motor of an axis, which may have a switch of its own."""
    for name, section in steppers.items():
        pin, axis = cfg.pin(section, "endstop_pin"), axes[name[0]]
        if pin is not None and axis.at is not None:
            signals[f"{name}_endstop"] = pin
            yield (
                f"# As that of {name[0]}: a motor that stands elsewhere is not"
                f" known.\n{_switch(name, axis)}"
            )


def _switch(name: str, axis: _Axis) -> str:
    return f"""\
[[switches]]
signal = "{name}_endstop"
axis = "{name[0]}"
trigger_world_mm = {axis.at:g}
direction = {1 if axis.is_up else -1}
"""


def _probe(cfg: PrinterCfg, signals: dict[str, str]) -> Iterator[str]:
    pin = cfg.pin("probe", "pin")
    if pin is None:
        yield "# printer.cfg has no [probe] with a pin of its own.\n"
        return
    x, y, z = (cfg.number("probe", f"{axis}_offset", 0.0) for axis in "xyz")
    if z <= 0.0:
        signals["bed_sensor"] = pin
        yield """\
# z_offset is not above zero, so the nozzle itself is the probe. How far it
# presses the bed is not known: a guess.
[bed_sensor]
press_mm = 0.05
"""
        return
    signals["probe"] = pin
    yield f"""\
# Whether the probe touches is not known: this one does not. One with a plunger
# is a [switch_probe], and may be kept in a [dock]. Its noise is a guess.
[inductive_probe]
x_from_nozzle_mm = {x:g}
y_from_nozzle_mm = {y:g}
trigger_nozzle_above_bed_mm = {z:g}
noise.sigma_mm = 0.0014
"""


def _signals(signals: dict[str, str]) -> str:
    lines: Iterable[str] = (f'{k} = "{pin}"' for k, pin in signals.items())
    text = "".join(f"{line}\n" for line in lines)
    return f"# As printer.cfg spells the pins.\n[signals]\n{text}"
