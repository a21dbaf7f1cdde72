"""Simulated machines made of what real printers have in their configuration.

The configuration is the entry's: its [z_calibration], its probe, its axes, its
bed mesh.  The machine behind it is a healthy printer with a switch probe that
macros attach, whatever the file says of its length.  Only places are moved to
where that machine has its pin.
"""

from __future__ import annotations

import json
import math
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Optional

import pytest

from tests.hostkit.hosts import Host
from tests.hostkit.printer import Printer
from tests.simprinter import SCENES, Scene, heated
from tests.simprinter.world import (
    AxisSwitchSpec,
    BedSpec,
    MagProbeSpec,
    PinSpec,
    Pose,
)

_FILES = Path(__file__).resolve().parents[1] / "corpus"

Point = tuple[float, float]
Options = dict[str, Optional[str]]

# The Z axis of every machine, mm
MICROSTEP = 0.0025

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

VIRTUAL_ENDSTOP = "probe:z_virtual_endstop"
# Names a switch of its own, which is the Z endstop's here
OTHER_PIN, PIN_INPUT = "calibration_endstop_pin", "PC2"

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
)
AXIS_OPTIONS = ("position_min", "position_max", "position_endstop")
Z_OPTIONS = (
    *AXIS_OPTIONS,
    "homing_positive_dir",
    "homing_speed",
    "homing_retract_dist",
    "homing_retract_speed",
    "second_homing_speed",
)
PRINTER_OPTIONS = ("max_velocity", "max_accel")
# Not on every host; means nothing without a print
MESH_OPTIONS_LEFT_OUT = ("adaptive_margin",)
HOME_OPTIONS = ("speed", "z_hop", "z_hop_speed")

_SET_PIN = "\n  SET_PIN PIN=probe_magnet VALUE=%d\n  G4 P500"
ATTACH, DETACH = _SET_PIN % 1, _SET_PIN % 0

# What the macros of the field do.  Klicky's Dock_Probe_Unlock docks the probe
# even if a macro has locked it to the head.
MACROS = {
    "ATTACH_PROBE": ATTACH,
    "_ATTACH_PROBE": ATTACH,
    "_ATTACH_PROBE_ABL": ATTACH,
    "_PROBE_OUT": ATTACH,
    "M401": ATTACH,
    "DETACH_PROBE": DETACH,
    "DOCK_PROBE": DETACH,
    "_DOCK_PROBE": DETACH,
    "DOCK_PROBE_UNLOCK": DETACH,
    "PROBE_IN": DETACH,
    "M402": DETACH,
    "NOZZLE_BRUSH": "\n  G91\n  G1 X-10 F6000\n  G1 X10\n  G90",
    "_SET_Z_CURRENT": "\n  G4 P10",
}
_PLAIN_MOVES = ("G0", "G1")

# Homes as the users' homing_override does; {x} and {y} are the pin's.
_HOMING = """
  G90
  G1 Z10 F600
  G28 X Y
  G1 X{x:g} Y{y:g} F6000
  G28 Z
  G1 Z15 F600"""


@dataclass(frozen=True)
class Entry:
    """One [z_calibration] of a real printer, with the sections around it."""

    index: int
    options: Mapping[str, str]
    context: Mapping[str, Mapping[str, str]]

    def section(self, name: str) -> Mapping[str, str]:
        """A section of the context; empty where there is none."""
        return self.context.get(name, {})

    @property
    def probe(self) -> Mapping[str, str]:
        """What the file says of the probe."""
        return self.section("probe") or self.section("dockable_probe")

    @property
    def homes_with_probe(self) -> bool:
        """Whether its Z endstop is the probe."""
        return self.section("stepper_z").get("endstop_pin") == VIRTUAL_ENDSTOP

    @property
    def commands(self) -> dict[str, list[str]]:
        """Names of the commands in its templates, in order."""
        return {
            part: [
                line.split()[0].upper()
                for line in self.options.get(f"{part}_gcode", "").splitlines()
                if line.strip()
            ]
            for part in ("start", "before_switch", "end")
        }

    @property
    def attaches(self) -> bool:
        """Whether CALIBRATE_Z attaches the probe by itself."""
        commands = self.commands
        before = commands["start"] + commands["before_switch"]
        return any(MACROS.get(name) == ATTACH for name in before)

    def number(self, option: str, default: float) -> float:
        """An option of [z_calibration]; the default where it is none."""
        try:
            return float(self.options.get(option, ""))
        except ValueError:
            return default


def load(name: str = "z_calibration") -> list[Entry]:
    """All entries of one file, in its order."""
    text = (_FILES / f"{name}.json").read_text(encoding="utf-8")
    return [
        Entry(index, entry["options"], entry.get("context", {}))
        for index, entry in enumerate(json.loads(text))
    ]


def spread(entries: Iterable[Entry], hosts: Sequence[Host]) -> list:
    """Each entry with its host; with CORPUS=all with every host."""
    everywhere = os.environ.get("CORPUS") == "all"
    return [
        pytest.param(entry, host, id=f"{entry.index:03d}-{host.name}")
        for entry in entries
        for number, host in enumerate(hosts)
        if everywhere or entry.index % len(hosts) == number
    ]


def some(entries: Sequence[Entry], share: int) -> Sequence[Entry]:
    """One of `share` entries; all of them with CORPUS=all."""
    return entries if os.environ.get("CORPUS") == "all" else entries[::share]


def refusal(host: Host, scene: Scene) -> str:
    """What a klippy that does not start says."""
    with Printer(host, scene) as printer:
        state, message = printer.session.start()
        assert "Internal error" not in message
    assert state == "error", (state, message)
    return message


@dataclass(frozen=True)
class Axis:
    """What the file says of X or Y, mm."""

    low: float
    high: float
    endstop: float

    @property
    def direction(self) -> int:
        """Of homing, as Klipper finds it out by itself."""
        return 1 if self.endstop > (self.low + self.high) / 2.0 else -1

    def near_endstop(self) -> float:
        """Where homing is short."""
        return self.endstop - self.direction * 12.0

    def shared(self, offset: float) -> tuple[float, float]:
        """What nozzle and probe can both reach."""
        return max(self.low, self.low + offset), min(
            self.high, self.high + offset
        )


@dataclass(frozen=True)
class Places:
    """Where things are, mm: the pin, the head's place with the switch over
    it, the point of the bed to ask for, the one that is touched, and the bed.
    """

    pin: Point
    switch: Point
    bed: Point
    touched: Point
    plate: tuple[Point, Point]


@dataclass(frozen=True)
class CorpusMachine:
    """An entry's machine with its configuration, and how to calibrate it.

    params: of CALIBRATE_Z, what the file leaves open. gap: true gap (mm) at
    Z=0 over `places.touched` that a right calibration leaves.
    """

    entry: Entry
    scene: Scene
    places: Places
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
        if self.entry.attaches:
            return ""
        return "G90\nG1 Z30 F900\nSET_PIN PIN=probe_magnet VALUE=1\nG4 P500"

    def with_virtual_endstop(self) -> CorpusMachine:
        """The same with the Z endstop that the file has: the probe."""
        sections = {
            **self.scene.sections,
            "stepper_z": {
                **(self.scene.sections["stepper_z"] or {}),
                "endstop_pin": VIRTUAL_ENDSTOP,
                "position_endstop": None,
            },
        }
        return replace(self, scene=replace(self.scene, sections=sections))


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


def chosen(options: Mapping[str, str], names: tuple[str, ...]) -> Options:
    """Some of the options, as values for a file."""
    return {
        name: indented(options[name]) for name in names if options.get(name)
    }


def indented(text: str) -> str:
    """A value with its further lines indented."""
    return text.replace("\n", "\n  ")


class _Builder:
    """Makes one CorpusMachine."""

    def __init__(self, entry: Entry, host: Host, body: float) -> None:
        self.entry = entry
        self.host = host
        self.body = body
        self.params: dict[str, str] = {}
        self.offset = self.configured_place()
        self.true_offset = self.offset
        if math.hypot(*self.offset) < SMALLEST_DISTANCE:
            self.true_offset = PROBE_PLACE
        self.axes = self.axis("x"), self.axis("y")
        self.places = self.find_places()

    def build(self) -> CorpusMachine:
        """Put it together."""
        calibration = self.calibration()
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
            start=Pose(*(axis.near_endstop() for axis in self.axes), 12.0),
        )
        return CorpusMachine(
            self.entry,
            self.with_true_world(scene, true),
            self.places,
            self.params,
            true - configured,
        )

    # Places

    def configured_place(self) -> Point:
        """The probe's offsets in X and Y as the file has them."""
        probe = self.entry.probe
        x, y = PROBE_PLACE
        return float(probe.get("x_offset", x)), float(probe.get("y_offset", y))

    def axis(self, name: str) -> Axis:
        """X or Y."""
        options = self.entry.section(f"stepper_{name}")
        high = float(options.get("position_max", {"x": 300, "y": 310}[name]))
        return Axis(
            low=float(options.get("position_min", 0.0)),
            high=high,
            endstop=float(options.get("position_endstop", high)),
        )

    def find_places(self) -> Places:
        """The pin beside the bed, where the body does not meet the bed while
        the nozzle is on the pin.
        """
        pin, plate = self.pin_and_plate()
        switch = pin[0] - self.true_offset[0], pin[1] - self.true_offset[1]
        bed = self.bed_point(plate)
        return Places(pin, switch, bed, self.where_touched(bed), plate)

    def pin_and_plate(self) -> tuple[Point, tuple[Point, Point]]:
        """The pin on the side to which the probe hangs, and two corners."""
        x, y = self.true_offset
        side = 0 if abs(x) > abs(y) else 1
        pin: list[float] = []
        plate: list[tuple[float, float]] = []
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
        """Where the probe really is if the head goes for a point."""
        return (
            bed[0] - self.offset[0] + self.true_offset[0],
            bed[1] - self.offset[1] + self.true_offset[1],
        )

    def bed_point(self, plate: tuple[Point, Point]) -> Point:
        """The point of the bed that the file asks for, if it can be."""
        wanted = self.wanted_bed_point()
        if wanted is not None and self.can_touch(wanted, plate):
            return wanted
        points = [axis.shared(o) for axis, o in zip(self.axes, self.offset)]
        x, y = (
            (max(low, first) + min(high, last)) / 2.0
            for (low, high), first, last in zip(points, *plate)
        )
        assert self.can_touch((x, y), plate), (x, y)
        return x, y

    def can_touch(self, bed: Point, plate: tuple[Point, Point]) -> bool:
        """Whether a point is on the plate and in the probe's reach."""
        (x_min, y_min), (x_max, y_max) = plate
        x, y = self.where_touched(bed)
        head = bed[0] - self.offset[0], bed[1] - self.offset[1]
        return (
            x_min < x < x_max
            and y_min < y < y_max
            and all(a.low <= h <= a.high for a, h in zip(self.axes, head))
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

    def calibration(self) -> Options:
        """The entry's options with places that fit the machine.

        What it leaves open and nobody else knows becomes a parameter.
        """
        options = dict(self.entry.options)
        if OTHER_PIN in options:
            options[OTHER_PIN] = f"^{PIN_INPUT}"
        places = {
            "nozzle": self.places.pin,
            "switch": self.places.switch,
            "bed": self.places.bed,
        }
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
        if name == "switch" and "switch_xy_offsets" in options:
            offsets = -self.true_offset[0], -self.true_offset[1]
            options["switch_xy_offsets"] = _same_form(
                options["switch_xy_offsets"], offsets
            )
            return True
        return False

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
        low, high = self.margins()
        offset = OFFSET + SWITCH_OFFSET - configured
        if low + MARGIN_RESERVE < offset < high - MARGIN_RESERVE:
            return SWITCH_OFFSET
        return configured

    def margins(self) -> tuple[float, float]:
        """What the offset has to lie within, mm."""
        pair = _pair(self.entry.options.get("offset_margins", ""))
        if pair is not None:
            return pair
        size = self.entry.number("max_deviation", 1.0)
        return -size, size

    # The sections around it

    def machine_sections(
        self, switch_offset: float
    ) -> dict[str, Optional[Options]]:
        """What the entry's context says of the machine."""
        voron = SCENES["voron"].sections
        context = self.entry.section
        return {
            "printer": {
                **(voron["printer"] or {}),
                **chosen(context("printer"), PRINTER_OPTIONS),
            },
            "probe": {
                **(voron["probe"] or {}),
                "z_offset": f"{self.body + switch_offset:.3f}",
                **chosen(self.entry.probe, PROBE_OPTIONS),
            },
            **{f"stepper_{name}": self.stepper(name) for name in "xyz"},
            **self.homing(),
            **self.mesh(),
            "output_pin probe_magnet": {
                "pin": "PD0",
                "value": "0",
                "shutdown_value": "0",
            },
        }

    def stepper(self, name: str) -> Options:
        """The section of an axis."""
        section = f"stepper_{name}"
        scene = dict(SCENES["voron"].sections[section] or {})
        options = self.entry.section(section)
        if name == "z":
            return {**scene, **chosen(options, Z_OPTIONS)}
        axis = self.axes["xy".index(name)]
        return {
            **scene,
            "position_min": f"{axis.low:g}",
            "position_max": f"{axis.high:g}",
            "position_endstop": f"{axis.endstop:g}",
        }

    def homing(self) -> dict[str, Optional[Options]]:
        """The entry's safe_z_home with a place that fits, or a macro."""
        x, y = self.places.pin
        home = self.entry.section("safe_z_home")
        if home:
            options = chosen(home, HOME_OPTIONS)
            options["home_xy_position"] = _same_form(
                home["home_xy_position"], (x, y)
            )
            return {"safe_z_home": options}
        override = {
            "axes": "xyz",
            "set_position_z": "0",
            "gcode": _HOMING.format(x=x, y=y),
        }
        return {"safe_z_home": None, "homing_override": override}

    def mesh(self) -> dict[str, Options]:
        """The entry's bed mesh with a zero that the host knows."""
        mesh = self.entry.section("bed_mesh")
        if not mesh:
            return {}
        names = [name for name in mesh if name not in MESH_OPTIONS_LEFT_OUT]
        options = chosen(mesh, tuple(names))
        index = "relative_reference_index"
        if index in options and not knows_index(self.host):
            # What its owner has to do on an update
            del options[index]
            options["zero_reference_position"] = "%g,%g" % self.places.bed
        return {"bed_mesh": options}

    def macros(self) -> dict[str, Options]:
        """A macro for each that the entry's templates name."""
        names = {n for part in self.entry.commands.values() for n in part}
        return {
            f"gcode_macro {name}": {"gcode": MACROS[name]}
            for name in sorted(names.difference(_PLAIN_MOVES))
        }

    # The truth

    def with_true_world(self, scene: Scene, switch_offset: float) -> Scene:
        """The machine as it really is."""
        (x_min, y_min), (x_max, y_max) = self.places.plate
        bed = BedSpec(x_min, y_min, x_max, y_max, 0.4, 3e-4, -2e-4)
        x, y = self.places.touched
        surface = bed.z0 + bed.slope_x * x + bed.slope_y * y
        options = scene.sections["stepper_z"] or {}
        homed = float(options["position_endstop"] or POSITION_ENDSTOP)
        return scene.with_world(
            bed=bed,
            pin=PinSpec(*self.places.pin, surface + homed - OFFSET, 2.5),
            switches=tuple(
                AxisSwitchSpec(
                    f"{name}_endstop",
                    name,
                    axis.endstop + axis.direction * 0.003,
                    axis.direction,
                )
                for name, axis in zip("xy", self.axes)
            ),
            mag_probe=MagProbeSpec(
                *self.true_offset,
                body_drop=self.body,
                switch_offset=switch_offset,
                mode="output",
                initial="docked",
                attach_time=0.2,
            ),
        )
