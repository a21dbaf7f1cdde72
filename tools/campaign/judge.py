"""Tries a random printer: the gap is right, or there is a refusal."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple, Optional

from simprinter.hosts.hosts import Host
from simprinter.hosts.session import GcodeError
from simprinter.world import Touch
from tools.campaign.drawn import Drawn
from tools.kit.printer import Printer

# Where (mm) the gap is looked at: above any probe
_LOOKING_Z = 25.0
# A place is met by so much (mm): half a step of both belts
_PLACE = 0.02

_NUMBER = re.compile(r"-?\d+(\.\d+)?")


class Verdict(NamedTuple):
    """How it went.

    refused: the reason; empty if it was right. error, bound: of the true gap,
    mm. penetration: of the nozzle into the bed, mm.
    """

    refused: str = ""
    error: float = 0.0
    bound: float = 0.0
    penetration: float = 0.0


class WrongError(AssertionError):
    """A wrong gap, or a failure that is not one of the kinds allowed."""


def require(good: bool, text: str) -> None:
    """Raise WrongError unless it is good."""
    if not good:
        raise WrongError(text)


def shape(reason: str) -> str:
    """A reason without its numbers, short."""
    return _NUMBER.sub("#", reason.splitlines()[0])[:100]


# Trying it out


class Trial:
    """One drawn printer on one host."""

    def __init__(self, printer: Printer, drawn: Drawn) -> None:
        self.printer = printer
        self.drawn = drawn

    def run(self) -> Verdict:
        """Start, home, calibrate. Raises WrongError."""
        printer, drawn = self.printer, self.drawn
        state, message = printer.session.start()
        if state != "ready":
            return self._refused_at_start(state, message)
        if drawn.mistake:
            for site, depth in self.drawn.tolerated().items():
                printer.machine.tolerate(site, depth)
        try:
            printer.run(f"G28\nSET_GCODE_OFFSET Z={drawn.offset:g}")
        except GcodeError as error:
            require(bool(drawn.mistake), f"does not home: {error}")
            self._require_ready(str(error))
            return self._verdict(refused=f"G28: {error}")
        printer.session.wait(0.5)
        return self._calibrate()

    def _calibrate(self) -> Verdict:
        printer = self.printer
        first = len(printer.machine.truth.touches)
        before = self._state()
        z = printer.machine.tip().z
        try:
            printer.run(self.drawn.command)
        except GcodeError as error:
            self._check_refusal(str(error), before, z)
            return self._verdict(refused=str(error))
        after = self._state()
        for name in ("max_accel", "currents", "homed"):
            require(after[name] == before[name], f"{name} is {after[name]}")
        touches = self._touches(first)
        self._check_touches(touches)
        return self._check_gap(self._homing(first), touches)

    def _homing(self, first: int) -> list[Touch]:
        """Of homing Z."""
        touches = self.printer.machine.truth.touches[:first]
        return [t for t in touches if t.site not in ("x_endstop", "y_endstop")]

    def _touches(self, first: int) -> list[Touch]:
        """Of the calibration; an inductive probe sees the bed as well while
        the nozzle goes there.
        """
        wanted = self.drawn.sites
        return [
            touch
            for touch in self.printer.machine.truth.touches[first:]
            if not touch.site.endswith("endstop")
            and (
                touch.site != "inductive_bed"
                or not _is_at(touch, wanted["nozzle_bed"][0])
            )
        ]

    def _state(self) -> dict[str, object]:
        """What a calibration must leave, or a refusal."""
        printer = self.printer
        toolhead = printer.status("toolhead")
        return {
            "offset": printer.offset(),
            "max_accel": toolhead["max_accel"],
            "homed": toolhead["homed_axes"],
            "currents": {
                name: driver.current()[1:]
                for name, driver in printer.machine.drivers.items()
            },
        }

    def _verdict(self, **parts: object) -> Verdict:
        deepest = self.printer.machine.truth.deepest_in_bed()
        return Verdict(penetration=deepest, **parts)

    # Refusals

    def _refused_at_start(self, state: str, message: str) -> Verdict:
        """A mistake may be told of before anything moves."""
        require(state == "error", f"klippy is {state}: {message}")
        require("nternal error" not in message, message)
        named = re.search(r"[Ss]ection '", message) is not None
        require(named, f"names no section: {message}")
        require(bool(self.drawn.mistake), f"does not start: {message}")
        require(not self.printer.machine.truth.touches, "touched something")
        return Verdict(refused=f"start: {message}")

    def _require_ready(self, reason: str) -> None:
        state, message = self.printer.session.state()
        require(state == "ready", f"{state}: {message}, after {reason}")
        require("nternal error" not in reason, reason)

    def _check_refusal(
        self, reason: str, before: dict[str, object], z: float
    ) -> None:
        """before and z: what was in force, and where the tip stood."""
        self._require_ready(reason)
        after = self._state()
        require(after == before, f"left {after} of {before}, after {reason}")
        # What lifts the toolhead is queued still
        self.printer.run("M400")
        self.printer.session.wait(0.5)
        end = self.printer.machine.tip().z
        clear = min(z, self.drawn.clear_z())
        require(
            end >= clear - self.drawn.gantry.step,
            f"the toolhead was left at {end:.4f}, not lifted, after {reason}",
        )
        excused = any(words in reason for words in self.drawn.excuses())
        require(
            bool(self.drawn.mistake) or excused,
            f"a healthy printer was refused: {reason}",
        )

    # Success

    def _check_touches(self, touches: Sequence[Touch]) -> None:
        """Each site was touched where it has to be, and often enough."""
        sites = self.drawn.sites
        found = [touch.site for touch in touches]
        require(set(found) == set(sites), f"touched {found}")
        last = tuple(name for name, _ in groupby(found))[-2:]
        require(last == self.drawn.final, f"touched {last} at last")
        for name, (place, wanted) in sites.items():
            here = [touch for touch in touches if touch.site == name]
            text = f"touched {name} {len(here)} times, not {wanted}"
            require(len(here) >= wanted, text)
            if not self.drawn.mistake:
                away = [touch for touch in here if not _is_at(touch, place)]
                require(not away, f"{name}: not at {place}: {away}")

    def _check_gap(
        self, homing: Sequence[Touch], touches: Sequence[Touch]
    ) -> Verdict:
        gap = self._gap(self.drawn.place(touches))
        machine = self.printer.machine
        now = machine.rig.seconds(machine.simulation.clock.now())
        right = self.drawn.gaps(homing, touches, now)
        error = right.error(gap)
        text = "the true gap is %.4f, right is %.4f to %.4f, bound %.4f"
        text %= (gap, right.low, right.high, right.bound)
        require(abs(error) <= right.bound, text)
        return self._verdict(error=error, bound=right.bound)

    def _gap(self, place: tuple[float, float]) -> float:
        """The true gap at G-code Z=0 over a place, mm."""
        printer = self.printer
        limits = printer.status("toolhead")
        ends = zip(place, limits["axis_minimum"], limits["axis_maximum"])
        script = f"G90\nG1 Z{_LOOKING_Z:g} F900\n"
        if all(low <= where <= high for where, low, high in ends):
            script += "G1 X%.4f Y%.4f F6000\n" % place
        printer.run(script + "M400")
        printer.session.wait(0.5)
        return printer.machine.gap_at_zero(_LOOKING_Z, place)


def _is_at(touch: Touch, place: tuple[float, float]) -> bool:
    return math.hypot(touch.x - place[0], touch.y - place[1]) <= _PLACE


def try_out(
    drawn: Drawn, host: Host, modules: Optional[Mapping[str, Path]] = None
) -> Verdict:
    """The drawn printer on a host. Raises AssertionError if it is wrong.

    modules: by their name (default: the repository's).
    """
    scene, seed = drawn.scene, drawn.seed
    with Printer(host, scene, seed=seed, modules=modules) as printer:
        return Trial(printer, drawn).run()
