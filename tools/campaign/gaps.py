"""The true gap at Z=0, and what it should be after a calibration.

Gaps are nozzle to plate, mm, over the point that was measured.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Optional

from simprinter.hosts.session import GcodeError
from tools.campaign.drawn.printers import Owned
from tools.kit.printer import Printer

Point = tuple[float, float]

# Beyond what a step of the motors and the noise explain (mm)
GAP_ERROR = 0.02
# Of what a Z motor stands higher, between nozzle and probe: both ends of a gantry of
# 420 mm, over 40 mm
LEAN = 0.2
# Where the toolhead stands while it is looked at (mm)
LOOKING_Z = 10.0
LOOK = f"""\
G90
G1 Z30 F1200
G1 X%.4f Y%.4f F9000
G1 Z{LOOKING_Z:g} F1200
M400"""
BACK = """\
G1 Z30 F1200
G1 X%.4f Y%.4f F9000
G1 Z%.4f F1200
M400"""

# Another client may measure meanwhile, and apply nothing
_RUN = re.compile("CALIBRATE_Z(?!_ACCURACY)")

# What the console shows of each calibration that has ended well
CALIBRATED = re.compile(r"Z-CALIBRATION: probe=\S+ - ")
CORRECTED = re.compile(r"AUTO_Z_CALIBRATE: .*probe_z_correction:")
LOADED = re.compile(r"AUTO_Z_LOAD_OFFSET: probe_z_correction: .*is \S+ now")
PUT_DOWN = re.compile(r"trigger=\S+ - z_offset=\S+ --> new offset=")
PUT_DOWN_FIXED = re.compile(r"trigger=\S+ - switch_height=\S+ --> new offset=")
# Of a gap that is not right, with or without its number
TOLD = re.compile(r"WARNING|not taken off|is wrong by|holds no more")
_POINT = re.compile(r"BED_POSITION=([-\d.]+),([-\d.]+)")
_ADJUST = re.compile(r"Z_ADJUST=([-\d.]+)")
_CHANGES = re.compile(r"AUTO_Z_SAVE_GCODE_OFFSET")
# An end_gcode that sets the very offset adds nothing, docs/z_calibration.md (mm)
OWN = 0.0006
# Features of Klipper that shift Z, beside a mesh
SHIFTING = frozenset({"tilt", "heat", "skew", "twist"})
_SAVES = re.compile(r"Z_CALIBRATION_SAVE_GCODE_OFFSET")


class Promise(NamedTuple):
    """What a command that has ended well makes of Z=0.

    gap: that is right over the point; told: mm that it may be off by, infinity
    where a warning came with it. since: seconds of the world from which it may
    have grown with a printer that drifts.
    """

    command: str
    point: Point
    gap: float
    told: float = 0.0
    since: float = 0.0


@dataclass(frozen=True)
class Kept:
    """A promise of z_calibration that its status calls valid.

    heat: mm of z_thermal_adjust when it was made. seen: what Z=0 depended on
    when the gap was looked at last.
    """

    promise: Promise
    heat: float
    seen: Any


class Gaps:
    """Looks at the gap after each calibration, and as long as one is valid.

    keep_clear: puts the ways of a script around what is in the way.
    """

    def __init__(
        self, printer: Printer, owned: Owned, keep_clear: Callable[[str], str]
    ) -> None:
        self.printer = printer
        self.owned = owned
        self.keep_clear = keep_clear
        self.kept: Optional[Kept] = None
        # There is a correction of this printer's probe
        self.is_corrected = False
        # What has become of the gap with baby steps that were taken over (mm)
        self.steps = 0.0

    def restarted(self) -> None:
        """What counts is in the configuration."""
        self.kept, self.is_corrected, self.steps = None, False, 0.0

    def _base(self) -> float:
        """Of a [z_calibration] without a word of Z_ADJUST and end_gcode."""
        probe = self.printer.scene.world.mag_probe
        assert probe is not None
        configured = self._configured("z_calibration", "switch_offset") or 0.0
        return probe.switch_offset - float(configured) + self.steps

    def _configured(self, section: str, option: str) -> Optional[str]:
        """As klippy has started with it, what was saved before included."""
        config = self.printer.status("configfile")["config"]
        return config.get(section, {}).get(option)

    def wrong(
        self,
        script: str,
        lines: Sequence[str],
        is_alone: bool = True,
        is_refused: bool = False,
        began: float = 0.0,
    ) -> Iterator[str]:
        """What is not as a step has promised, or as `valid` says.

        script: all that ran; lines: what the console has shown meanwhile.
        is_alone: nothing else has changed anything since. began: seconds of the
        world when the step did.
        """
        for promise in self._promises(script, lines):
            if promise.command == "CALIBRATE_Z":
                promise = promise._replace(since=began)
            gap = self.look(promise.point) if is_alone else None
            if gap is not None and self._is_broken(promise, gap):
                yield (
                    f"after {promise.command} the gap is {gap:.4f}, right is"
                    f" {promise.gap:.4f}, and nothing tells it"
                )
            if promise.command == "CALIBRATE_Z":
                seen = self._depends_on() if is_alone else None
                self.kept = Kept(promise, self._heat(), seen)
        if _CHANGES.search(script):
            self.is_corrected = False
        if _SAVES.search(script) and not is_alone:
            # Before the other client's command or after it, nobody knows
            self.kept, self.steps = None, math.nan
        elif _SAVES.search(script) and not is_refused:
            self._save()
        else:
            yield from self._not_valid()

    # What was promised

    def _promises(self, script: str, lines: Sequence[str]) -> Iterator[Promise]:
        def shows(pattern: re.Pattern) -> bool:
            return any(pattern.search(line) for line in lines)

        told = float("inf") if any(map(TOLD.search, lines)) else 0.0
        if shows(CALIBRATED):
            yield self._of_calibration(script, told)
        elif shows(CORRECTED) or (shows(LOADED) and self._can_load()):
            self.is_corrected = True
            place, gap = self._homed_at(), self._piezo_gap()
            if place is not None and shows(CORRECTED) and self._has_mesh():
                place = self._touched_at()
            if place is not None:
                yield Promise("a correction", place, gap, told)
        elif shows(PUT_DOWN) and "SAVE=1" not in script:
            membrane = self.printer.scene.world.membrane
            assert membrane is not None
            gap = membrane.thickness - membrane.press
            gap -= self.printer.scene.number("extra_probe membrane", "z_offset")
            # A button does not say whether the zero itself is to be saved
            if not self._pending():
                place = (membrane.x, membrane.y)
                yield Promise("EXTRA_PROBE_CALIBRATE", place, gap, told)
        elif shows(PUT_DOWN_FIXED) and "SAVE=1" not in script:
            place = self._under_fixed()
            if not self._pending():
                gap = self._fixed_gap(place)
                yield Promise("EXTRA_PROBE_CALIBRATE", place, gap, told)

    def _under_fixed(self) -> Point:
        """The point of the bed that a fixed switch's height is told of."""
        own = self._configured("extra_probe membrane", "bed_xy_position")
        x, y = (own or "").split(",")
        return float(x), float(y)

    def _fixed_gap(self, place: Point) -> float:
        """What its owner's switch_height makes of Z=0, which a plate may belie."""
        pin = self.printer.scene.world.pin
        assert pin is not None
        height = self.printer.scene.number(
            "extra_probe membrane", "switch_height"
        )
        truth = self.printer.machine.truth
        return truth.true_gap(*place, pin.z - height)

    def _of_calibration(self, script: str, told: float) -> Promise:
        status = self.printer.status("z_calibration")
        worth = (status.get("last_result") or {}).get("uncertainty")
        told += float(status.get("uncertainty") or worth or 0.0)
        if not worth:
            # A single touch, which does not know what the plate is like beside it
            told += 3.0 * self.owned.rough
        last = _RUN.split(script)[-1]
        point, adjust = _POINT.search(last), _ADJUST.search(last)
        place = self._bed_point()
        if point is not None:
            place = float(point.group(1)), float(point.group(2))
        if self.owned.mistake:
            place = self._probed_at() or place
        extra = float(adjust.group(1)) if adjust else 0.0
        measured = (status.get("last_result") or {}).get("offset")
        gap = self._base() + extra
        if measured is None or abs(measured + extra - self._asked()) > OWN:
            gap += self._asked()
        return Promise("CALIBRATE_Z", place, gap, told)

    def _probed_at(self) -> Optional[Point]:
        """Where the probe has really touched the bed at last."""
        probe = self.printer.scene.world.mag_probe
        touches = self.printer.machine.truth.touches
        found = [touch for touch in touches if touch.site == "probe_bed"]
        if probe is None or not found:
            return None
        return found[-1].x + probe.x_offset, found[-1].y + probe.y_offset

    def _bed_point(self) -> Point:
        own = self._configured("z_calibration", "bed_xy_position")
        if own is None:
            return self.printer.bed_point()
        x, y = own.split(",")
        return float(x), float(y)

    def _asked(self) -> float:
        """What the owner's own macros add to the offset (mm)."""
        options = {row[:2]: row[2] for row in self.owned.options}
        hook = options.get(("z_calibration", "end_gcode")) or ""
        found = re.fullmatch(r"SET_GCODE_OFFSET Z=(\S+)", hook)
        return float(found.group(1)) if found else 0.0

    def _can_load(self) -> bool:
        """Whether a correction is all that makes Z=0 right, docs/reliability.md."""
        is_plain = not (self.owned.names & SHIFTING or self._has_mesh())
        return self.is_corrected and is_plain

    def _has_mesh(self) -> bool:
        return any(self.printer.status("bed_mesh").get("mesh_matrix") or ())

    def _piezo_gap(self) -> float:
        scene = self.printer.scene
        section = scene.sections["auto_z_offset"] or {}
        depth = scene.piezo_depth(float(section.get("speed") or 0.0))
        return scene.number("auto_z_offset", "z_offset") - depth

    def _pending(self) -> list[str]:
        """Sections that SAVE_CONFIG would change, but for meshes."""
        status = self.printer.status("configfile")
        pending = status.get("save_config_pending_items") or {}
        return [name for name in pending if not name.startswith("bed_mesh")]

    def _homes_with_probe(self) -> bool:
        section = self.printer.scene.sections.get("stepper_z") or {}
        return section.get("endstop_pin") == "probe:z_virtual_endstop"

    def _homed_at(self) -> Optional[Point]:
        """The point of the bed that Z was homed over, for the nozzle."""
        spec = self.printer.scene.world
        probe = spec.mag_probe or spec.inductive
        home = (self.printer.scene.sections.get("safe_z_home") or {}).get(
            "home_xy_position"
        )
        if probe is None or home is None or not self._homes_with_probe():
            return None
        x, y = (float(number) for number in home.split(","))
        return x + probe.x_offset, y + probe.y_offset

    def _touched_at(self) -> Optional[Point]:
        """Where the nozzle has touched the plate: at the zero of a mesh."""
        touches = self.printer.machine.truth.touches
        found = [t for t in touches if t.site == "nozzle_bed"]
        return (found[-1].x, found[-1].y) if found else None

    # As long as it is valid

    def _save(self) -> None:
        """What is in force becomes what the next calibration is to find."""
        if self.kept is None:
            return
        promise = self.kept.promise
        gap = self.look(promise.point)
        if gap is None:
            self.kept, self.steps = None, math.nan
        else:
            # Saved are thousandths
            change = round(gap - promise.gap, 3)
            self.steps += change
            kept = promise._replace(gap=promise.gap + change)
            self.kept = Kept(kept, self.kept.heat, self._depends_on())

    def _not_valid(self) -> Iterator[str]:
        kept = self.kept
        if kept is None:
            return
        status = self.printer.statuses("z_calibration", "toolhead")
        if not self._is_valid(status["z_calibration"]):
            return
        if "z" not in status["toolhead"]["homed_axes"]:
            yield "z_calibration is valid, and Z is not homed"
            return
        seen = self._depends_on()
        if seen == kept.seen:
            return
        self.kept = Kept(kept.promise, kept.heat, seen)
        gap = self.look(kept.promise.point)
        # The frame of the simulated printer does not grow
        promise = kept.promise._replace(
            gap=kept.promise.gap - kept.heat + self._heat()
        )
        if gap is not None and self._is_broken(promise, gap):
            yield (
                f"z_calibration is valid, the gap is {gap:.4f}, and was to be"
                f" {promise.gap:.4f}"
            )

    @staticmethod
    def _is_valid(status: Mapping[str, Any]) -> bool:
        return bool(status.get("valid")) and not status.get("warnings")

    def _heat(self) -> float:
        status = self.printer.status("z_thermal_adjust")
        return float(status.get("current_z_adjust") or 0.0)

    def _depends_on(self) -> Any:
        """All that Z=0 depends on, but for heat."""
        status = self.printer.statuses("gcode_move", "toolhead", "bed_mesh")
        tip, gcode = self.printer.machine.tip(), status["gcode_move"]
        frame = tip.z - status["toolhead"]["position"][2]
        shift = gcode["position"][2] - gcode["gcode_position"][2]
        mesh = status["bed_mesh"].get("mesh_matrix")
        return round(shift, 4), round(frame, 2), mesh

    # Looking

    def _is_beyond_mesh(self, point: Point) -> bool:
        mesh = self.printer.status("bed_mesh")
        if not any(mesh.get("mesh_matrix") or ()):
            return False
        ends = zip(mesh["mesh_min"], point, mesh["mesh_max"])
        return not all(low <= at <= high for low, at, high in ends)

    def look(self, point: Point) -> Optional[float]:
        """The gap over a point; None where the toolhead cannot go there.

        The toolhead comes back. Nor where an adaptive mesh has ended: beyond its rim
        Klipper goes on as high as that, whatever the bed is there.
        """
        if self._is_beyond_mesh(point):
            return None
        session, machine = self.printer.session, self.printer.machine
        status = self.printer.status("gcode_move")
        back = tuple(status["gcode_position"][:3])
        try:
            session.run(self.keep_clear(LOOK % point))
            session.wait(0.5)
            gap = machine.gap_at_zero(LOOKING_Z, point)
            session.run(self.keep_clear(BACK % back))
        except GcodeError:
            # The probe may hang there by its owner's wish, and the dock be far
            gap = None
        finally:
            if not status["absolute_coordinates"]:
                session.run("G91")
        session.wait(0.5)
        return gap

    def _is_broken(self, promise: Promise, gap: float) -> bool:
        """Whether it is off by more than steps, noise, growth and lean explain."""
        rates = sum(map(abs, self.owned.drift))
        grown = rates * (self.printer.now() - promise.since)
        lean = LEAN * max(map(abs, self.owned.skew), default=0.0)
        most = GAP_ERROR + promise.told + grown + lean
        if self.owned.mistake:
            # Another point of the bed may have been touched than its owner thinks
            most += self.owned.uneven
        return abs(gap - promise.gap) > most
