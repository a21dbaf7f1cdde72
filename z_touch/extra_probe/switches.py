"""What [extra_probe] touches: a switch on a pin of its own, or [probe]; and a series of touches.

Every height is a toolhead Z in mm.  All methods that move, or run the user's G-code, may
pause.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import TYPE_CHECKING, Any, Iterator, List, Optional, Union

from .. import attached, command, templates, touch
from ..errors import CalibrationError, NoTrigger, SamplesDiffer
from ..sampling import why_differ
from .settings import read_switch_settings

if TYPE_CHECKING:
    from ..host.klippy import Config, Endstop, Template
    from ..host.printer import Host
    from ..host.probe import ProbeSession
    from ..sampling import Sampling

# What to do about samples that differ
DIFFER = "clean the nozzle, and check what it touches for play"
# What to do about a toolhead that is below the floor of a touch
HIGHER_UP = "begin higher up"
TOO_LOW = f"{HIGHER_UP}, or with a lower FLOOR"
# What to do where what is touched may be lower than a touch of EXTRA_PROBE goes, and one of
# EXTRA_PROBE_CALIBRATE; and the same of a switch that stays where it is
FIND_BED = (
    "where the bed may be lower find it with EXTRA_PROBE_CALIBRATE, or set"
    " position_min"
)
LOWER_FLOOR = (
    "where the bed may be lower begin again with a lower FLOOR, ready to stop"
)
FIND_SWITCH = (
    "check xy_position and switch_height, or where the switch may be lower set"
    " position_min"
)


class PinSwitch:
    """A switch on a pin of its own, and the G-code around its touches.

    'query' is the command that shows what the pin reads.
    """

    def __init__(self, config: Config, host: Host, query: str):
        self.host = host
        self.query = query
        self.settings = read_switch_settings(config)
        remedy = (
            "give the pin of the switch, or call the section 'extra_probe"
            " probe' where [probe] is the switch"
        )
        self._endstop = host.endstops.make(config, "pin", remedy)

    def endstop(self) -> Endstop:
        """Return what stops a touch."""
        return self._endstop

    def free_nozzle(self, goes_on: bool = False) -> None:
        """Have no probe below the nozzle, which would meet the bed before it does.

        Raises CalibrationError, or the host's error; 'goes_on': the toolhead moves to its own
        place next.
        """
        everything = attached.of(self.host.printer)
        everything.free_nozzle(self.host, goes_on=goes_on)

    @contextlib.contextmanager
    def series(
        self, head: touch.Head, floor: float, end_z: float
    ) -> Iterator[None]:
        """Run the user's G-code around a series of touches, if once for all of them."""
        if self.settings.deactivate_on_each_sample:
            yield
            return
        with self._active():
            yield

    def touch_once(
        self, head: touch.Head, floor: float, find_bed: str
    ) -> float:
        """Return the height of one touch of a series, which ends at 'floor' at the latest.

        'find_bed' is what to do where that may be lower.  Raises CalibrationError.
        """
        if not self.settings.deactivate_on_each_sample:
            return self._touch_active(head, floor, find_bed)
        with self._active():
            return self._touch_active(head, floor, find_bed)

    def _touch_active(
        self, head: touch.Head, floor: float, find_bed: str
    ) -> float:
        head.check_above(floor)
        try:
            return head.touch(self._endstop, floor, head.sampling.speed)
        except NoTrigger as e:
            raise e.advised(
                f"press it by hand and look with {self.query}, or {find_bed}"
            )
        except CalibrationError as e:
            raise e.advised(
                f"look with {self.query} while nothing presses it: where it reads"
                " triggered then, pin needs another '!', or its wire is broken"
            )

    @contextlib.contextmanager
    def _active(self) -> Iterator[None]:
        """Run activate_gcode, and deactivate_gcode on every path."""
        with command.always(self.host, self._deactivate, "deactivate_gcode"):
            self._run("activate_gcode", self.settings.activate_gcode)
            attached.of(self.host.printer).check_docked(
                self.host, "activate_gcode"
            )
            yield

    def _deactivate(self) -> None:
        self._run("deactivate_gcode", self.settings.deactivate_gcode)

    def _run(self, name: str, template: Template) -> None:
        """Run the user's G-code around a touch, which must leave the toolhead where it is."""
        before = self.host.toolhead.get_position()[:3]
        was_homed = self.host.is_homed("xyz")
        # A G91 does not outlive the template, also when it fails before its G90
        with self.host.gcode_state.keeping_modes():
            templates.run_template(self.host, name, template)
        command.check_homed(self.host, name if was_homed else "")
        if self.host.toolhead.get_position()[:3] != before:
            raise CalibrationError(
                f"the toolhead moved in {name}; move it before the command"
            )


class ProbeSwitch:
    """[probe] is the switch: the host's own probing touches, and runs its G-code."""

    query = "QUERY_PROBE"

    def __init__(self, host: Host):
        self.host = host
        # Of the series that is under way; None: the host, which is not known here, cannot be
        # told where a touch is to end
        self.session: Optional[ProbeSession] = None

    def endstop(self) -> Any:
        """Return what stops a touch; None: [probe] is missing, or no switch on a pin."""
        return self.host.probing.endstop()

    def free_nozzle(self, goes_on: bool = False) -> None:
        """Leave the probe to the host, which fetches it where it has a dock.

        Raises CalibrationError while a section waits for an answer.
        """
        attached.of(self.host.printer).check_questions(self.host)

    @contextlib.contextmanager
    def series(
        self, head: touch.Head, floor: float, end_z: float
    ) -> Iterator[None]:
        """Begin a session of the host's probing, for touches that end at 'floor'.

        The host may put the probe away at its end, so the toolhead is lifted to end_z before.
        """
        speed = f"{head.sampling.speed:.6f}"
        session = touch.probing(head, floor, end_z, PROBE_SPEED=speed)
        with session as self.session:
            yield

    def touch_once(
        self, head: touch.Head, floor: float, find_bed: str
    ) -> float:
        """Return the height of one touch of a series, which ends at 'floor' at the latest.

        What to do about a failure is the same wherever the bed is.  Raises CalibrationError.
        """
        if self.session is None:
            # Its own probing would go on to position_min
            return head.touch(self.endstop(), floor, head.sampling.speed)
        head.check_above(floor)
        try:
            return head.probe(self.session).z
        except CalibrationError as e:
            raise e.advised(touch.CHECK_PROBE)


Switch = Union[PinSwitch, ProbeSwitch]


class Series:
    """One series of touches where the toolhead is.

    'find_bed' is what to do where the bed may be lower than the touches go, 'too_low' where
    the toolhead is that already.
    """

    def __init__(
        self,
        host: Host,
        switch: Switch,
        sampling: Sampling,
        find_bed: str,
        too_low: str,
    ):
        self.host = host
        self.switch = switch
        self.sampling = sampling
        self.find_bed = find_bed
        self.head = touch.Head(host, sampling, too_low)
        # Where the toolhead is lifted to at the end
        self.end_z = host.motion.z()

    def measure(self, floor: float, stay: bool = False) -> List[float]:
        """Return the heights of the touches, none of which goes below 'floor'.

        The toolhead ends where it began or, if it is to 'stay', where the last touch has
        ended; after a failure always where it began.  Raises CalibrationError.
        """
        with command.always(self.host, self._lift, "lifting"):
            with self.switch.series(self.head, floor, self.end_z):
                heights = self._touch_all(floor)
            if stay:
                self.end_z = floor
        return heights

    def _lift(self) -> None:
        self.head.lift(self.end_z)

    def _touch_all(self, floor: float) -> List[float]:
        """Touch until the wanted number of samples agrees; start again where one does not."""
        retries_left = self.sampling.retries
        samples: List[float] = []
        while len(samples) < self.sampling.samples:
            samples.append(self._sample(floor))
            why = why_differ(samples, self.sampling.tolerance)
            if not why:
                continue
            if not retries_left:
                raise SamplesDiffer(f"{why}{DIFFER}")
            # In the words of PROBE, which macros and people may look for
            self.host.gcode.respond_info(
                "Probe samples exceed tolerance. Retrying..."
            )
            retries_left -= 1
            samples = []
        return samples

    def _sample(self, floor: float) -> float:
        """Return the height of one touch, and show it."""
        self.head.retract()
        x, y = self.host.toolhead.get_position()[:2]
        z = self.switch.touch_once(self.head, floor, self.find_bed)
        self.host.gcode.respond_info(f"probe at {x:.3f},{y:.3f} is z={z:.6f}")
        return z
