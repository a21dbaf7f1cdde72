"""Simulated machines made of [auto_z_offset] sections of real printers.

The configuration is the entry's: its [auto_z_offset] word for word, its probe,
the switch of its bed sensor, its axes, limits and bed mesh.  The machine behind
it is a healthy printer with a piezo bed: the probe senses the plate
SENSE_DISTANCE below the nozzle, whatever the file says of that, and the bed
sensor is on while its switch has the value with which prepare_gcode ends.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Optional

from tests.hostkit.hosts import Host
from tests.hostkit.z_calibration_corpus import (
    MESH_OPTIONS_LEFT_OUT,
    Entry,
    Options,
    Point,
    chosen,
    indented,
)
from tests.simprinter import SCENES, Scene
from tests.simprinter.world import AxisSwitchSpec, InductiveSpec

NAME = "auto_z_offset"

# What the probe really senses, mm
SENSE_DISTANCE = 1.27

# The scenes without and with the board that a pin's name begins with
SCENE_OF_BOARD = {"": "qidi", "U_1": "qidi_two_boards"}

# What makes the object 'probe'.  A file has [probe] beside another one where
# its owner takes turns: only the other one can be in use then.
PROBES = ("bltouch", "smart_effector", "probe")
# All but the pins
PROBE_OPTIONS = (
    "x_offset",
    "y_offset",
    "z_offset",
    "samples",
    "samples_result",
    "samples_tolerance",
    "samples_tolerance_retries",
    "sample_retract_dist",
    "speed",
    "lift_speed",
    "activate_gcode",
    "deactivate_gcode",
    "deactivate_on_each_sample",
    "probe_accel",
    "recovery_time",
)
PLACE = ("x_offset", "y_offset", "z_offset")
# Nothing on the board's pins follows a BLTouch's own movement
BLTOUCH_OPTIONS = {
    "control_pin": "PF1",
    "pin_up_reports_not_triggered": "False",
    "pin_up_touch_mode_reports_triggered": "False",
}

# Without position_endstop, see reads_position_endstop
Z_OPTIONS = (
    "endstop_pin",
    "position_min",
    "position_max",
    "homing_positive_dir",
    "homing_speed",
    "homing_retract_dist",
    "second_homing_speed",
)
PRINTER_OPTIONS = ("max_velocity", "max_accel", "max_z_velocity", "max_z_accel")
SWITCH_OPTIONS = ("pwm", "value", "shutdown_value")

MACROS = {
    f"gcode_macro {name}": {"gcode": "\n  G4 P10"}
    for name in ("probe_deploy", "probe_stow")
}

# An axis switch is that far (mm) beyond position_endstop.
SWITCH_MARGIN = 0.003

# A touch has that much (mm) more than it needs to brake. Newer hosts go at
# full speed for half of a move at least (min_cruise_ratio).
RESERVE = 0.1
RATIO = 0.5

_SET_PIN = re.compile(r"SET_PIN\s+PIN=bed_sensor\s+VALUE=(\d)")
_MODIFIERS = "^~!"


@dataclass(frozen=True)
class AutoMachine:
    """An entry's machine with its configuration.

    bed: the point that is measured. speeds: mm/s that a touch may have at its
    trigger: what it reaches from sample_retract_dist, and what the file wants.
    """

    entry: Entry
    scene: Scene
    bed: Point
    speeds: tuple[float, float]

    @property
    def is_limited(self) -> bool:
        """Whether the module says so of the speed."""
        printer = self.scene.sections["printer"] or {}
        ceiling = min(
            self.entry.number("speed", 5.0),
            float(printer["max_z_velocity"] or 0.0),
        )
        return self.speeds[1] < ceiling

    @property
    def gaps(self) -> tuple[float, float]:
        """True gap (mm) at Z=0 over `bed` that a right calibration leaves.

        Smallest and largest: the faster the touch, the deeper its trigger,
        from where z_offset is counted.
        """
        z_offset = self.entry.number("z_offset", 0.2)
        slow, fast = (self.scene.piezo_depth(speed) for speed in self.speeds)
        return z_offset - fast, z_offset - slow


def build(
    entry: Entry, host: Host, added: Optional[Mapping[str, str]] = None
) -> AutoMachine:
    """The entry's machine; added: options that its owner had to add."""
    if added:
        entry = replace(entry, options={**entry.options, **added})
    return _Builder(entry, host).build()


def probe_of(entry: Entry) -> str:
    """The section of the probe that is in use."""
    return next((name for name in PROBES if name in entry.context), "probe")


def reads_position_endstop(entry: Entry, host: Host) -> bool:
    """Whether a host homes Z to position_endstop, not to the probe's z_offset.

    All others refuse the option beside a probe. Not this one: its
    smart_effector does not say where it triggers.
    """
    if probe_of(entry) != "smart_effector":
        return False
    directory = host.directory / "base" / host.layout.module_dir
    extras = directory.parent / "extras"
    text = (extras / "smart_effector.py").read_text(encoding="utf-8")
    knows = ("get_position_endstop", "HomingViaProbeHelper")
    return not any(name in text for name in knows)


def touch_speeds(
    entry: Entry, printer: Mapping[str, str]
) -> tuple[float, float]:
    """See AutoMachine; printer: the section."""
    asked = min(entry.number("speed", 5.0), float(printer["max_z_velocity"]))
    accel = float(printer["max_z_accel"])
    accel = min(accel, entry.number("probe_accel", 0.0) or accel)
    # It has to stop within a millimetre below the bed
    asked = min(asked, (2.0 * accel * (1.0 - RESERVE)) ** 0.5)
    retract = entry.number("sample_retract_dist", 3.0)
    way = retract + asked * asked / (2.0 * accel) + RESERVE
    return min(asked, (RATIO * accel * way) ** 0.5), asked


def last_value(entry: Entry) -> Optional[str]:
    """Of the sensor's switch in prepare_gcode; None: there is none."""
    values = _SET_PIN.findall(entry.options.get("prepare_gcode", ""))
    return values[-1] if values else None


class _Builder:
    """Makes one AutoMachine."""

    def __init__(self, entry: Entry, host: Host) -> None:
        self.entry = entry
        self.host = host
        pin = entry.options.get("pin", "").lstrip(_MODIFIERS)
        self.board = pin.partition(":")[0] if ":" in pin else ""
        self.qidi = SCENES[SCENE_OF_BOARD[self.board]]
        self.axes = {axis: self.axis(axis) for axis in "xyz"}
        self.bed = self.middle("x"), self.middle("y")
        self.probe = probe_of(entry)
        self.place = {
            **chosen(self.scene_section("probe"), PLACE),
            **chosen(entry.section(self.probe), PLACE),
        }

    def build(self) -> AutoMachine:
        """Put it together."""
        switch = self.switch_pin()
        wiring = replace(
            self.qidi.wiring,
            inputs={**self.qidi.wiring.inputs, "probe": self.probe_pin()},
            outputs={"bed_sensor_enable": switch} if switch else {},
        )
        printer = {
            **self.scene_section("printer"),
            **chosen(self.entry.section("printer"), PRINTER_OPTIONS),
        }
        scene = replace(
            self.qidi,
            name=f"auto_corpus_{self.entry.index:03d}",
            wiring=wiring,
            sections={
                **self.qidi.sections,
                "printer": printer,
                **{f"stepper_{axis}": self.axes[axis] for axis in "xyz"},
                "safe_z_home": self.safe_z_home(),
                "probe": None,
                self.probe: self.probe_section(),
                **self.switch(),
                **self.mesh(),
                **MACROS,
                NAME: self.calibration(),
            },
        )
        scene = self.with_true_world(scene, bool(switch))
        speeds = touch_speeds(self.entry, printer)
        return AutoMachine(self.entry, scene, self.bed, speeds)

    def scene_section(self, name: str) -> dict[str, str]:
        """A section of the scene."""
        section = self.qidi.sections[name] or {}
        return {key: text for key, text in section.items() if text is not None}

    # The section auto_z_offset

    def calibration(self) -> Options:
        """The entry's options; the scene's board has pins of that name."""
        return {k: indented(text) for k, text in self.entry.options.items()}

    # The sections around it

    def axis(self, name: str) -> dict[str, str]:
        """The section of an axis."""
        section = f"stepper_{name}"
        names = Z_OPTIONS
        if name != "z":
            names = ("position_min", "position_max", "position_endstop")
        elif reads_position_endstop(self.entry, self.host):
            names = (*Z_OPTIONS, "position_endstop")
        return {
            **self.scene_section(section),
            **chosen(self.entry.section(section), names),
        }

    def middle(self, name: str) -> float:
        """Of an axis, mm."""
        axis = self.axes[name]
        return (float(axis["position_min"]) + float(axis["position_max"])) / 2.0

    def safe_z_home(self) -> Options:
        """The probe over the point that is measured."""
        x, y = self.bed
        x_offset, y_offset, _ = map(float, self.place.values())
        return {
            **self.scene_section("safe_z_home"),
            "home_xy_position": f"{x - x_offset:g}, {y - y_offset:g}",
        }

    def probe_pin(self) -> str:
        """The scene's pin with the entry's modifiers."""
        options = self.entry.section(self.probe)
        pin = self.qidi.wiring.inputs["probe"]
        entry_pin = options.get("pin") or options.get("sensor_pin") or pin
        return _modifiers(entry_pin) + pin.lstrip(_MODIFIERS)

    def probe_section(self) -> Options:
        """The entry's probe."""
        options = {
            **self.place,
            **chosen(self.entry.section(self.probe), PROBE_OPTIONS),
        }
        if self.probe == "bltouch":
            return {**options, "sensor_pin": self.probe_pin()} | BLTOUCH_OPTIONS
        return {**options, "pin": self.probe_pin()}

    def switch_options(self) -> Mapping[str, str]:
        """Of the entry's output pin for the bed sensor."""
        return self.entry.section("output_pin bed_sensor")

    def switch(self) -> dict[str, Optional[Options]]:
        """The output pin's section, as the entry has it."""
        section = self.switch_options()
        if not section:
            return {"output_pin bed_sensor": None}
        options = chosen(section, SWITCH_OPTIONS)
        return {
            "output_pin bed_sensor": {
                **options,
                "pin": _modifiers(section["pin"]) + self.switch_name(),
            }
        }

    def switch_name(self) -> str:
        """The output pin on the scene's board."""
        name = self.switch_options()["pin"].lstrip(_MODIFIERS)
        name = name.rpartition(":")[2]
        return f"{self.board}:{name}" if self.board else name

    def switch_pin(self) -> str:
        """The same as the sensor has it; empty: it is always on."""
        last = last_value(self.entry)
        if last is None:
            return ""
        modifiers = _modifiers(self.switch_options()["pin"])
        if last == "0":
            modifiers = "" if modifiers else "!"
        return modifiers + self.switch_name()

    def mesh(self) -> dict[str, Options]:
        """The entry's bed mesh."""
        mesh = self.entry.section("bed_mesh")
        names = [name for name in mesh if name not in MESH_OPTIONS_LEFT_OUT]
        return {"bed_mesh": chosen(mesh, tuple(names))} if mesh else {}

    # The truth

    def with_true_world(self, scene: Scene, switched: bool) -> Scene:
        """The machine as it really is."""
        x_offset, y_offset, _ = map(float, self.place.values())
        sensor = scene.world.bed_sensor
        assert sensor is not None
        return scene.with_world(
            switches=tuple(
                AxisSwitchSpec(
                    f"{axis}_endstop",
                    axis,
                    float(self.axes[axis]["position_endstop"]) - SWITCH_MARGIN,
                    -1,
                )
                for axis in "xy"
            ),
            inductive=InductiveSpec(x_offset, y_offset, SENSE_DISTANCE),
            bed_sensor=replace(sensor, enable_output=switched),
        )


def _modifiers(pin: str) -> str:
    """What stands before a pin's name."""
    return pin[: len(pin) - len(pin.lstrip(_MODIFIERS))]
