"""Simulated machines made of [auto_z_offset] sections of real printers.

Word for word, with the probe, the switch of the bed sensor, axes, limits and
bed mesh of the entry.  The probe senses the plate SENSE_DISTANCE below the
nozzle, whatever the file says of that, and the bed sensor is on while its
switch has the value with which prepare_gcode ends.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Optional

from simprinter import Scene
from simprinter.hosts.hosts import Host
from simprinter.world import AxisSwitchSpec, InductiveSpec
from tools.kit.corpus import Entry, Options, Point, chosen, indented
from tools.kit.scenes import SCENES

# What the probe really senses, mm
SENSE_DISTANCE = 1.27

# The scenes without and with the board that a pin's name begins with
SCENE_OF_BOARD = {"": "qidi", "U_1": "qidi_two_boards"}

# What makes the object 'probe'.  A file has [probe] beside another one where
# its owner takes turns: only the other one can be in use then.
PROBES = ("bltouch", "smart_effector", "probe")
PLACE = "x_offset y_offset z_offset"
# All but the pins
PROBE_OPTIONS = f"""{PLACE} samples samples_result samples_tolerance
samples_tolerance_retries sample_retract_dist speed lift_speed activate_gcode
deactivate_gcode deactivate_on_each_sample probe_accel recovery_time"""
# Nothing on the board's pins follows a BLTouch's own movement
BLTOUCH_OPTIONS = {
    "control_pin": "PF1",
    "pin_up_reports_not_triggered": "False",
    "pin_up_touch_mode_reports_triggered": "False",
}
AXIS_OPTIONS = "position_min position_max position_endstop"
# Without position_endstop, see reads_position_endstop
Z_OPTIONS = """endstop_pin position_min position_max homing_positive_dir
homing_speed homing_retract_dist second_homing_speed"""
PRINTER_OPTIONS = "max_velocity max_accel max_z_velocity max_z_accel"

MACROS = {
    f"gcode_macro {name}": {"gcode": "\n  G4 P10"}
    for name in ("probe_deploy", "probe_stow")
}

# An axis switch is that far (mm) beyond position_endstop.
SWITCH_MARGIN = 0.003

# A touch has that much (mm) more than it needs to brake.
RESERVE = 0.1

_SWITCH = "output_pin bed_sensor"
_SET_PIN = re.compile(r"SET_PIN\s+PIN=bed_sensor\s+VALUE=(\d)")
_MODIFIERS = "^~!"


@dataclass(frozen=True)
class AutoMachine:
    """An entry's machine with its configuration.

    bed: the point that is measured. gap: true gap (mm) at Z=0 over it that a
    right calibration leaves: the faster the touch, the deeper its trigger, from
    where z_offset is counted. is_limited: whether the module says so of the
    speed.
    """

    entry: Entry
    scene: Scene
    bed: Point
    gap: float
    is_limited: bool


def build(
    entry: Entry, host: Host, added: Optional[Mapping[str, str]] = None
) -> AutoMachine:
    """The entry's machine; added: options that its owner had to add."""
    entry = replace(entry, options={**entry.options, **(added or {})})
    return _Builder(entry, host).build()


def reads_position_endstop(host: Host) -> bool:
    """Whether a host homes Z to position_endstop, not to the probe's z_offset.

    All others refuse the option beside a probe. Not this one: its
    smart_effector does not say where it triggers.
    """
    directory = host.directory / "base" / host.layout.module_dir
    extras = directory.parent / "extras"
    text = (extras / "smart_effector.py").read_text(encoding="utf-8")
    knows = ("get_position_endstop", "HomingViaProbeHelper")
    return not any(name in text for name in knows)


class _Builder:
    """Makes one AutoMachine."""

    def __init__(self, entry: Entry, host: Host) -> None:
        self.entry = entry
        self.host = host
        pin = entry.options.get("pin", "").lstrip(_MODIFIERS)
        self.board = pin.partition(":")[0] if ":" in pin else ""
        self.qidi = SCENES[SCENE_OF_BOARD[self.board]]
        self.probe = next((n for n in PROBES if n in entry.context), "probe")
        self.axes = {axis: self.axis(axis) for axis in "xyz"}
        self.bed = self.middle("x"), self.middle("y")
        self.place = {
            **chosen(self.scene_section("probe"), PLACE),
            **chosen(entry.section(self.probe), PLACE),
        }
        self.offsets = [float(self.place[f"{axis}_offset"]) for axis in "xy"]

    def build(self) -> AutoMachine:
        """Put it together."""
        switch = self.true_switch()
        probe_pin = self.probe_pin()
        wiring = replace(
            self.qidi.wiring,
            inputs={**self.qidi.wiring.inputs, "probe": probe_pin},
            outputs={"bed_sensor_enable": switch} if switch else {},
        )
        printer = {
            **self.scene_section("printer"),
            **chosen(self.entry.section("printer"), PRINTER_OPTIONS),
        }
        calibration = {k: indented(v) for k, v in self.entry.options.items()}
        mesh = self.entry.mesh()
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
                self.probe: self.probe_section(probe_pin),
                _SWITCH: self.switch(),
                **({"bed_mesh": mesh} if mesh else {}),
                **MACROS,
                "auto_z_offset": calibration,
            },
        )
        scene = self.with_true_world(scene, bool(switch))
        speed, ceiling = self.speeds(printer)
        gap = self.entry.number("z_offset", 0.2) - scene.piezo_depth(speed)
        return AutoMachine(self.entry, scene, self.bed, gap, speed < ceiling)

    def scene_section(self, name: str) -> dict[str, str]:
        """A section of the scene."""
        section = self.qidi.sections[name] or {}
        return {key: text for key, text in section.items() if text is not None}

    def speeds(self, printer: Mapping[str, str]) -> Point:
        """That of a touch, and what it would be with room to brake, mm/s."""
        ceiling = self.entry.number("speed", 5.0)
        ceiling = min(ceiling, float(printer["max_z_velocity"]))
        accel = float(printer["max_z_accel"])
        accel = min(accel, self.entry.number("probe_accel", 0.0) or accel)
        # It has to stop within a millimetre below the bed
        return min(ceiling, (2.0 * accel * (1.0 - RESERVE)) ** 0.5), ceiling

    # The sections around it

    def axis(self, name: str) -> dict[str, str]:
        """The section of an axis."""
        section, names = f"stepper_{name}", AXIS_OPTIONS
        if name == "z":
            names = Z_OPTIONS
            if self.probe == "smart_effector" and reads_position_endstop(
                self.host
            ):
                names += " position_endstop"
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
        x, y = (at - offset for at, offset in zip(self.bed, self.offsets))
        home = f"{x:g}, {y:g}"
        return {**self.scene_section("safe_z_home"), "home_xy_position": home}

    def probe_pin(self) -> str:
        """The scene's pin with the entry's modifiers."""
        options = self.entry.section(self.probe)
        pin = self.qidi.wiring.inputs["probe"]
        entry_pin = options.get("pin") or options.get("sensor_pin") or pin
        return _modifiers(entry_pin) + pin.lstrip(_MODIFIERS)

    def probe_section(self, pin: str) -> Options:
        """The entry's probe."""
        own = chosen(self.entry.section(self.probe), PROBE_OPTIONS)
        options = {**self.place, **own}
        if self.probe == "bltouch":
            return {**options, "sensor_pin": pin, **BLTOUCH_OPTIONS}
        return {**options, "pin": pin}

    def switch(self) -> Optional[Options]:
        """The output pin's section, as the entry has it."""
        section = self.entry.section(_SWITCH)
        if not section:
            return None
        pin = _modifiers(section["pin"]) + self.switch_name()
        return {**chosen(section, "pwm value shutdown_value"), "pin": pin}

    def switch_name(self) -> str:
        """The output pin on the scene's board."""
        pin = self.entry.section(_SWITCH)["pin"].lstrip(_MODIFIERS)
        name = pin.rpartition(":")[2]
        return f"{self.board}:{name}" if self.board else name

    def true_switch(self) -> str:
        """The same as the sensor has it; empty: it is always on."""
        gcode = self.entry.options.get("prepare_gcode", "")
        values = _SET_PIN.findall(gcode)
        if not values:
            return ""
        modifiers = _modifiers(self.entry.section(_SWITCH)["pin"])
        if values[-1] == "0":
            modifiers = "" if modifiers else "!"
        return modifiers + self.switch_name()

    def with_true_world(self, scene: Scene, switched: bool) -> Scene:
        """The machine as it really is."""
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
            inductive=InductiveSpec(*self.offsets, SENSE_DISTANCE),
            bed_sensor=replace(sensor, enable_output=switched),
        )


def _modifiers(pin: str) -> str:
    """What stands before a pin's name."""
    return pin[: len(pin) - len(pin.lstrip(_MODIFIERS))]
