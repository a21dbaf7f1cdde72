"""Simulated machines made of [z_calibration] sections of real printers.

With the probe, axes and bed mesh of the entry.  The machine has a switch probe
that macros attach, whatever the file says of its length.  Only places are moved
to where that machine has its pin.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Optional

from simprinter import Scene, heated
from simprinter.hosts.hosts import Host
from simprinter.world import (
    AxisSwitchSpec,
    BedSpec,
    MagProbeSpec,
    PinSpec,
    Pose,
)
from tools.kit.corpus import Entry, Options, Point, chosen, indented
from tools.kit.scenes import SCENES, Sections

# The true probe where the file does not say (mm)
BODY = 6.4
SWITCH_OFFSET = 0.5
PROBE_PLACE = (-2.0, 24.75)

# A smaller distance (mm) of probe and nozzle is no switch beside the nozzle:
# the file has another probe.  The switch is then at PROBE_PLACE.
SMALLEST_DISTANCE = 8.0

# Where Z is homed if the file does not say (mm), and how far it is off: the
# offset of a perfect switch_offset.
POSITION_ENDSTOP = "1.6"
OFFSET = 0.0988

# A pin is that far from the end of the axis, the bed from the pin (mm).
PIN_MARGIN = 1.0
BED_MARGIN = 8.0

# An offset this close (mm) to a margin is for nobody to rely on.
MARGIN_RESERVE = 0.05

# SWITCH_OFFSET as a parameter, mm
PARAM_SWITCH_OFFSET = 0.44

# Names a switch of its own, which is the Z endstop's here
OTHER_PIN, PIN_INPUT = "calibration_endstop_pin", "PC2"

PROBE_OPTIONS = """x_offset y_offset z_offset samples samples_result
samples_tolerance samples_tolerance_retries sample_retract_dist speed
lift_speed"""
Z_OPTIONS = """position_min position_max position_endstop homing_positive_dir
homing_speed homing_retract_dist homing_retract_speed second_homing_speed"""

# What the macros of the field do.  Klicky's Dock_Probe_Unlock docks the probe
# even if a macro has locked it to the toolhead.
_SET_PIN = "\n  SET_PIN PIN=probe_magnet VALUE=%d\n  G4 P500"
ATTACHING = """ATTACH_PROBE _ATTACH_PROBE _ATTACH_PROBE_ABL _PROBE_OUT
M401"""
DETACHING = """DETACH_PROBE DOCK_PROBE _DOCK_PROBE DOCK_PROBE_UNLOCK PROBE_IN
M402"""
MACROS = {
    **dict.fromkeys(ATTACHING.split(), _SET_PIN % 1),
    **dict.fromkeys(DETACHING.split(), _SET_PIN % 0),
    "NOZZLE_BRUSH": "\n  G91\n  G1 X-10 F6000\n  G1 X10\n  G90",
    "_SET_Z_CURRENT": "\n  G4 P10",
}
MAGNET = {
    "output_pin probe_magnet": {
        "pin": "PD0",
        "value": "0",
        "shutdown_value": "0",
    }
}

# Homes as the users' homing_override does; {x} and {y} are the pin's.
_HOMING = """
  G90
  G1 Z10 F600
  G28 X Y
  G1 X{x:g} Y{y:g} F6000
  G28 Z
  G1 Z15 F600"""


@dataclass(frozen=True)
class CorpusMachine:
    """An entry's machine with its configuration, and how to calibrate it.

    Places in mm: the pin, the toolhead's place with the switch over it, and the
    point of the bed that is touched. params: of CALIBRATE_Z, what the file
    leaves open. gap: true gap (mm) at Z=0 over that point that a right
    calibration leaves.
    """

    entry: Entry
    scene: Scene
    pin: Point
    switch: Point
    touched: Point
    params: Mapping[str, str]
    gap: float

    @property
    def command(self) -> str:
        """CALIBRATE_Z with its parameters."""
        return " ".join(
            ["CALIBRATE_Z", *(f"{k}={v}" for k, v in self.params.items())]
        )

    @property
    def preparation(self) -> str:
        """What the user does between homing and the command."""
        commands = commands_of(self.entry, "start", "before_switch")
        if commands & set(ATTACHING.split()):
            return ""
        return "G90\nG1 Z30 F900\nSET_PIN PIN=probe_magnet VALUE=1\nG4 P500"


def probe_of(entry: Entry) -> Mapping[str, str]:
    """What the file says of the probe."""
    return entry.section("probe") or entry.section("dockable_probe")


def commands_of(entry: Entry, *templates: str) -> set[str]:
    """Names of the commands in some of its templates."""
    texts = [entry.options.get(f"{name}_gcode", "") for name in templates]
    lines = [line.split() for line in "\n".join(texts).splitlines()]
    return {words[0].upper() for words in lines if words}


def knows_index(host: Host) -> bool:
    """Whether a host's bed mesh still has a relative_reference_index."""
    klippy = (host.directory / "base" / host.layout.module_dir).parent
    text = (klippy / "extras" / "bed_mesh.py").read_text(encoding="utf-8")
    return "'relative_reference_index'" in text


def build(entry: Entry, host: Host, body: float = BODY) -> CorpusMachine:
    """The entry's machine for a host; its probe's body hangs `body` mm."""
    return _Builder(entry, host, body).build()


def _pair(text: str) -> Optional[Point]:
    """Two numbers, or None."""
    try:
        x, y = (float(part) for part in text.split(","))
    except ValueError:
        return None
    return x, y


def _same_form(text: str, values: Point) -> str:
    """The text with other numbers in it, blanks and all."""
    numbers = iter(values)
    return re.sub(r"[-+.\d]+", lambda match: f"{next(numbers):g}", text)


@dataclass(frozen=True)
class _Axis:
    """What the file says of X or Y, mm."""

    low: float
    high: float
    endstop: float

    @property
    def direction(self) -> int:
        """Of homing, as Klipper finds it out by itself."""
        return 1 if self.endstop > (self.low + self.high) / 2.0 else -1

    def shared(self, offset: float) -> Point:
        """What nozzle and probe can both reach."""
        low, high = self.low + offset, self.high + offset
        return max(self.low, low), min(self.high, high)


class _Builder:
    """Makes one CorpusMachine."""

    def __init__(self, entry: Entry, host: Host, body: float) -> None:
        self.entry = entry
        self.host = host
        self.body = body
        self.params: dict[str, str] = {}
        probe, (x, y) = probe_of(entry), PROBE_PLACE
        x, y = float(probe.get("x_offset", x)), float(probe.get("y_offset", y))
        self.offset = x, y
        self.true_offset = self.offset
        if math.hypot(x, y) < SMALLEST_DISTANCE:
            self.true_offset = PROBE_PLACE
        self.axes = self.axis("x", 300.0), self.axis("y", 310.0)
        self.pin, self.plate = self.pin_and_plate()
        self.bed = self.bed_point()

    def build(self) -> CorpusMachine:
        """Put it together."""
        x, y = self.true_offset
        switch = self.pin[0] - x, self.pin[1] - y
        calibration = self.calibration(switch)
        shared = {"pins": PIN_INPUT} if OTHER_PIN in calibration else None
        configured = self.configured_switch_offset()
        true = self.true_switch_offset(configured)
        voron = heated(SCENES["voron"])
        scene = replace(
            voron,
            name=f"corpus_{self.entry.index:03d}",
            wiring=replace(voron.wiring, outputs={"probe_attach": "PD0"}),
            sections={
                **voron.sections,
                **self.machine_sections(true),
                **self.macros(),
                "z_calibration": calibration,
                "duplicate_pin_override": shared,
            },
            start=Pose(
                *(a.endstop - 12.0 * a.direction for a in self.axes), 12.0
            ),
        )
        return CorpusMachine(
            self.entry,
            self.with_true_world(scene, true),
            self.pin,
            switch,
            self.where_touched(self.bed),
            self.params,
            true - configured,
        )

    # Places

    def axis(self, name: str, high: float) -> _Axis:
        """X or Y; high: where the file does not say."""
        options = self.entry.section(f"stepper_{name}")
        high = float(options.get("position_max", high))
        low = float(options.get("position_min", 0.0))
        return _Axis(low, high, float(options.get("position_endstop", high)))

    def pin_and_plate(self) -> tuple[Point, tuple[Point, Point]]:
        """The pin on the side to which the probe hangs, and two corners.

        It is beside the bed, where the body does not meet the bed while the
        nozzle is on the pin.
        """
        x, y = self.true_offset
        side = 0 if abs(x) > abs(y) else 1
        pin: list[float] = []
        plate: list[Point] = []
        for i, (axis, offset) in enumerate(zip(self.axes, self.true_offset)):
            first, last = axis.shared(offset)
            if i != side:
                pin.append(round((first + last) / 2.0, 1))
                plate.append((axis.low, axis.high))
            elif offset > 0.0:
                pin.append(last - PIN_MARGIN)
                plate.append((axis.low, pin[i] - BED_MARGIN))
            else:
                pin.append(first + PIN_MARGIN)
                plate.append((pin[i] + BED_MARGIN, axis.high))
        (x_min, x_max), (y_min, y_max) = plate
        return (pin[0], pin[1]), ((x_min, y_min), (x_max, y_max))

    def where_touched(self, bed: Point) -> Point:
        """Where the probe really is if the toolhead goes for a point."""
        return (
            bed[0] - self.offset[0] + self.true_offset[0],
            bed[1] - self.offset[1] + self.true_offset[1],
        )

    def bed_point(self) -> Point:
        """The point of the bed that the file asks for, if it can be."""
        wanted = self.wanted_bed_point()
        if wanted is not None and self.can_touch(wanted):
            return wanted
        points = [axis.shared(o) for axis, o in zip(self.axes, self.offset)]
        x, y = (
            (max(low, first) + min(high, last)) / 2.0
            for (low, high), first, last in zip(points, *self.plate)
        )
        assert self.can_touch((x, y)), (x, y)
        return x, y

    def can_touch(self, bed: Point) -> bool:
        """Whether a point is on the plate and in the probe's reach."""
        head = bed[0] - self.offset[0], bed[1] - self.offset[1]
        return all(
            low < at < high and axis.low <= h <= axis.high
            for low, at, high, h, axis in zip(
                self.plate[0],
                self.where_touched(bed),
                self.plate[1],
                head,
                self.axes,
            )
        )

    def wanted_bed_point(self) -> Optional[Point]:
        """As the module is to find it: own option, old one, mesh."""
        options = self.entry.options
        if "bed_xy_position" in options:
            return _pair(options["bed_xy_position"])
        if "probe_bed_x" in options:
            return float(options["probe_bed_x"]), float(options["probe_bed_y"])
        mesh = self.entry.section("bed_mesh")
        if "zero_reference_position" in mesh:
            return _pair(mesh["zero_reference_position"])
        if "relative_reference_index" in mesh:
            return self.mesh_point(mesh)
        return None

    def mesh_point(self, mesh: Mapping[str, str]) -> Point:
        """Where a mesh of old has its point of reference."""
        index = int(mesh["relative_reference_index"])
        counts = [int(n) for n in mesh["probe_count"].split(",")]
        columns, rows = counts[0], counts[-1]
        first, last = _pair(mesh["mesh_min"]), _pair(mesh["mesh_max"])
        assert first is not None and last is not None
        # Rows go back and forth; distances are cut to 0.01 mm
        row, column = divmod(index, columns)
        dx, dy = (
            math.floor((b - a) / (n - 1) * 100) / 100
            for a, b, n in zip(first, last, (columns, rows))
        )
        if row % 2:
            column = columns - 1 - column
        return round(first[0] + column * dx, 3), round(first[1] + row * dy, 3)

    # The section z_calibration

    def calibration(self, switch: Point) -> Options:
        """The entry's options with places that fit the machine.

        What it leaves open and nobody else knows becomes a parameter.
        """
        options = dict(self.entry.options)
        if OTHER_PIN in options:
            options[OTHER_PIN] = f"^{PIN_INPUT}"
        places = {"nozzle": self.pin, "switch": switch, "bed": self.bed}
        for name, place in places.items():
            if not self.place(options, name, place) and not self.known(name):
                self.params[f"{name.upper()}_POSITION"] = "%g,%g" % place
        return {
            name: indented(text)
            for name, text in options.items()
            # What is left of a conflict's mark is no line of a file
            if "=" not in name
        }

    def place(self, options: dict[str, str], name: str, place: Point) -> bool:
        """Move a place in the options; whether it is in there."""
        new = f"{name}_xy_position"
        if new in options:
            if _pair(options[new]) is not None:
                options[new] = _same_form(options[new], place)
            return True
        old = [f"probe_{name}_x", f"probe_{name}_y"]
        if set(old) <= set(options):
            options.update(zip(old, ("%g" % value for value in place)))
            return True
        distance = f"{name}_xy_offsets"
        if distance in options:
            offsets = -self.true_offset[0], -self.true_offset[1]
            options[distance] = _same_form(options[distance], offsets)
        return distance in options

    def known(self, name: str) -> bool:
        """Whether another section has this place."""
        if name == "nozzle":
            return "safe_z_home" in self.entry.context
        mesh = self.entry.section("bed_mesh")
        zeros = {"zero_reference_position", "relative_reference_index"}
        return name == "bed" and not zeros.isdisjoint(mesh)

    def configured_switch_offset(self) -> float:
        """What the file says, or the parameter."""
        if "switch_offset" not in self.entry.options:
            self.params["SWITCH_OFFSET"] = f"{PARAM_SWITCH_OFFSET:g}"
        return self.entry.number("switch_offset", PARAM_SWITCH_OFFSET)

    def true_switch_offset(self, configured: float) -> float:
        """The usual one, or the file's where its margins exclude that."""
        size = self.entry.number("max_deviation", 1.0)
        margins = _pair(self.entry.options.get("offset_margins", ""))
        low, high = margins or (-size, size)
        offset = OFFSET + SWITCH_OFFSET - configured
        if low + MARGIN_RESERVE < offset < high - MARGIN_RESERVE:
            return SWITCH_OFFSET
        return configured

    # The sections around it

    def machine_sections(self, switch_offset: float) -> Sections:
        """What the entry's context says of the machine."""
        z_offset = {"z_offset": f"{self.body + switch_offset:.3f}"}
        own = {
            "printer": chosen(
                self.entry.section("printer"), "max_velocity max_accel"
            ),
            "probe": {
                **z_offset,
                **chosen(probe_of(self.entry), PROBE_OPTIONS),
            },
            "stepper_z": chosen(self.entry.section("stepper_z"), Z_OPTIONS),
        }
        for name, axis in zip("xy", self.axes):
            own[f"stepper_{name}"] = {
                "position_min": f"{axis.low:g}",
                "position_max": f"{axis.high:g}",
                "position_endstop": f"{axis.endstop:g}",
            }
        voron = SCENES["voron"].sections
        sections = {k: {**(voron[k] or {}), **v} for k, v in own.items()}
        return {**sections, **self.homing(), **self.mesh(), **MAGNET}

    def homing(self) -> Sections:
        """The entry's safe_z_home with a place that fits, or a macro."""
        x, y = self.pin
        home = self.entry.section("safe_z_home")
        if home:
            options = chosen(home, "speed z_hop z_hop_speed")
            place = _same_form(home["home_xy_position"], (x, y))
            return {"safe_z_home": {**options, "home_xy_position": place}}
        override = {
            "axes": "xyz",
            "set_position_z": "0",
            "gcode": _HOMING.format(x=x, y=y),
        }
        return {"safe_z_home": None, "homing_override": override}

    def mesh(self) -> Sections:
        """The entry's bed mesh with a zero that the host knows."""
        options = self.entry.mesh()
        index = "relative_reference_index"
        if index in options and not knows_index(self.host):
            # What its owner has to do on an update
            del options[index]
            options["zero_reference_position"] = "%g,%g" % self.bed
        return {"bed_mesh": options} if options else {}

    def macros(self) -> Sections:
        """A macro for each that the entry's templates name."""
        names = commands_of(self.entry, "start", "before_switch", "end")
        return {
            f"gcode_macro {name}": {"gcode": MACROS[name]}
            for name in sorted(names - {"G0", "G1"})
        }

    # The truth

    def with_true_world(self, scene: Scene, switch_offset: float) -> Scene:
        """The machine as it really is."""
        (x_min, y_min), (x_max, y_max) = self.plate
        bed = BedSpec(x_min, y_min, x_max, y_max, 0.4, 3e-4, -2e-4)
        x, y = self.where_touched(self.bed)
        surface = bed.z0 + bed.slope_x * x + bed.slope_y * y
        options = scene.sections["stepper_z"] or {}
        homed = float(options["position_endstop"] or POSITION_ENDSTOP)
        switches = tuple(
            AxisSwitchSpec(
                f"{name}_endstop",
                name,
                axis.endstop + axis.direction * 0.003,
                axis.direction,
            )
            for name, axis in zip("xy", self.axes)
        )
        probe = MagProbeSpec(
            *self.true_offset,
            body_drop=self.body,
            switch_offset=switch_offset,
            mode="output",
            initial="docked",
            attach_time=0.2,
        )
        return scene.with_world(
            bed=bed,
            pin=PinSpec(*self.pin, surface + homed - OFFSET, 2.5),
            switches=switches,
            mag_probe=probe,
        )
