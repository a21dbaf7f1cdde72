"""DOCKABLE_PROBE_SETUP: where the dock is, found with the probe on the toolhead.

Each step does what the one before has announced, and asks for the next one; see
setup_steps.py for what they ask:

    on -> dock -> out -> approach -> insert     by the buttons, Here
    fetch -> store                              slowly, with what was found
    save                                        SAVE_CONFIG

Positions are those of the toolhead (mm), in the frame that the last homing defined.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Dict, List, Optional, Sequence, Tuple

from .. import attached, command
from ..attached import ATTACHED, DOCKED
from ..errors import CalibrationError
from ..host.klippy import GCodeCommand
from ..setup_command import SetupCommand
from ..wizard import SAVED, given, head_at, jogged
from . import path
from .path import Position
from .sensors import level
from .settings import DISTANCE, SAME_WAY, nearest_distance
from .setup_steps import STEPS

if TYPE_CHECKING:
    from .dock import Dock
    from .module import DockableProbe

# mm/s by the buttons and between the places, and into the dock and out of it
JOG_SPEED = 20.0
SLOW_SPEED = 10.0

# A place nearer (mm) to the dock than this leaves no room to leave it.
LEAST_WAY = 15.0


# The command, and the set-up that is under way
class Setup(SetupCommand):
    """Finds where the dock is, step by step."""

    def __init__(self, section: DockableProbe) -> None:
        """Register the command."""
        super().__init__(section.host, "DOCKABLE_PROBE_SETUP")
        self.section = section
        # The places that were found, by their options
        self.found: Dict[str, Position] = {}
        command.register_commands(section.host, self)

    cmd_DOCKABLE_PROBE_SETUP_help = "Find where the dock is, step by step"

    def cmd_DOCKABLE_PROBE_SETUP(self, gcmd: GCodeCommand) -> None:
        """Begin, show again what is asked, or do what the answer says."""
        self.run(gcmd)

    def begin(self, gcmd: GCodeCommand) -> None:
        """Ask the first step, unless a person is asked something else."""
        with self.host.as_command_error(gcmd):
            command.check_no_manual_probe(self.host)
            attached.of(self.host.printer).check_questions(self.host)
        # A probe that was put on by hand: the set-up may be aborted
        self.section.sensors.look()
        axes = self._axes()
        self.wizard.begin(
            [replace(step, axes=axes if step.axes else "") for step in STEPS]
        )
        self.found = {}

    def go_on(self, gcmd: GCodeCommand) -> None:
        """Do what the step has announced for this answer, and ask the next one.

        Every method do_<step> does what the first button of the step says.
        """
        answer, step = self.wizard.answer(gcmd), self.wizard.asked()
        if answer == "BACK":
            self.wizard.enter(step.back)
        elif answer == "HERE":
            self._take("insert_position")
            self.wizard.enter("fetch")
        else:
            getattr(self, f"do_{step.name}")()

    ##################################################################
    # The places
    ##################################################################

    def do_on(self) -> None:
        """Look whether the probe is on the toolhead, and the axes are homed."""
        self._require(ATTACHED, "put it on the toolhead, or correct pin (!)")
        missing = self._not_homed()
        if missing:
            raise CalibrationError(
                f"not homed: {', '.join(missing)}; home first (G28"
                f" {' '.join(missing)}), if the probe is on with room below it"
            )
        self.wizard.enter("dock")

    def do_dock(self) -> None:
        """Keep the place of the dock, where the probe is held by both."""
        sensors = self.section.sensors
        if not sensors.is_joined():
            # A sensor of the dock tells by now that it is there, too.
            wanted = ", ".join(
                f"{sense.name} {level(is_triggered)}"
                for sense, is_triggered in sensors.when_joined()
            )
            raise CalibrationError(
                "the probe is not on the toolhead and in the dock at once"
                f" ({sensors.describe()}), expected {wanted}; the magnets of both"
                " have to hold it"
            )
        settings, here = self.section.settings, self._here()
        if settings.dock_fixed_z:
            # That is no place of the toolhead's, but how much higher it has to be there.
            here = here._replace(z=settings.dock_position.z)
        self.found = {"dock_position": here}
        self.wizard.enter("out")

    def do_out(self) -> None:
        """Keep the way out on which the dock has held the probe back."""
        self._require(
            DOCKED,
            "go back into the dock and leave it another way, or put it there by"
            " hand",
        )
        self._take("detach_position")
        self.wizard.enter("approach")

    def do_approach(self) -> None:
        """Keep where the way into the dock begins, which is the way out, too."""
        found, here = self.found, self._here()
        dock, detach = found["dock_position"], found["detach_position"]
        angle = path.strip_angle(dock, dock.z, here, detach)
        settings = self.section.settings
        # A Z of detach_position is not kept here
        strips = settings.strippers and settings.strip_z is None
        if angle < SAME_WAY and not strips:
            raise CalibrationError(
                f"this is the way out without the probe ({angle:.0f} degrees apart),"
                " on which it would not come along; choose another one, mostly at"
                " 90 degrees"
            )
        self._take("approach_position")
        found["insert_position"] = here
        self.wizard.enter("insert")

    def do_insert(self) -> None:
        """Keep the way in for both: the dock is entered the same way with the probe."""
        self.wizard.enter("fetch")

    def _take(self, option: str) -> None:
        """Keep where the toolhead is; raises CalibrationError too near to the dock."""
        here, dock = self._here(), self.found["dock_position"]
        apart = path.distance(here, dock)
        is_above = (
            here.z is not None
            and dock.z is not None
            and here.z - dock.z >= LEAST_WAY
        )
        if apart < LEAST_WAY and not is_above:
            raise CalibrationError(
                f"this is {apart:.1f} mm from the dock; go at least"
                f" {LEAST_WAY:g} mm away, better 40"
            )
        self.found[option] = here

    def _here(self) -> Position:
        """Return where the toolhead is.

        Raises CalibrationError where the motors are off: a hand may have moved it.
        """
        missing = self._not_homed()
        if missing:
            raise CalibrationError(
                f"not homed: {', '.join(missing)}, and it is not known where the toolhead"
                " is; move it clear of the dock by hand, and home (G28"
                f" {' '.join(missing)})"
            )
        place = self.section.moves.position()
        x, y = round(place.x, 3), round(place.y, 3)
        if self.section.settings.dock_fixed_z or place.z is None:
            return Position(x, y, None)
        return Position(x, y, round(place.z, 3))

    def _axes(self) -> str:
        """Return the axes that have to be homed, and that lead to the dock."""
        return "XY" if self.section.settings.dock_fixed_z else "XYZ"

    def _not_homed(self) -> List[str]:
        is_homed = self.host.is_homed
        return [axis for axis in self._axes() if not is_homed(axis.lower())]

    def _require(self, state: str, remedy: str) -> None:
        """Raise CalibrationError where the probe is not in that state."""
        sensors = self.section.sensors
        seen = sensors.look()
        if seen != state:
            raise CalibrationError(
                f"the probe is {seen} ({sensors.describe()}), and has to be"
                f" {state}; {remedy}"
            )

    ##################################################################
    # The trial
    ##################################################################

    def do_fetch(self) -> None:
        """Fetch the probe with what was found, slowly.  Pauses."""
        self._require(DOCKED, "put it into the dock")
        self._trial().fetch()
        self.wizard.enter("store")

    def do_store(self) -> None:
        """Dock the probe with what was found, slowly.  Pauses."""
        self._require(ATTACHED, "fetch it again (Back)")
        self._trial().dock()
        self.wizard.enter("save")

    def _positions(self) -> Dict[str, Position]:
        """Return all of the dock's, by their options."""
        extract = self.found["approach_position"]
        return {**self.found, "extract_position": extract}

    def _trial(self) -> Dock:
        """Return the dock where it was found, and slow.

        Macros over the parts of a trip may be for a place of before.
        """
        positions = self._positions()
        return self.section.dock.at_other_place(
            self.section.settings.replace(
                safe_dock_distance=nearest_distance(positions),
                travel_speed=JOG_SPEED,
                attach_speed=SLOW_SPEED,
                detach_speed=SLOW_SPEED,
                is_placed=True,
                strip_z=None,
                macros=(),
                **positions,
            )
        )

    ##################################################################
    # The toolhead
    ##################################################################

    def jog(self, gcmd: GCodeCommand) -> None:
        """Move by the X, Y and Z of the command (mm).  Pauses."""
        distances = self.wizard.distances(gcmd)
        start = self.host.toolhead.get_position()
        ends: List[Optional[float]] = [None, None, None]
        for number, axis in enumerate("XYZ"):
            if axis not in distances:
                continue
            if not self.host.is_homed(axis.lower()):
                raise CalibrationError(f"not homed: {axis}; home first")
            low, high = self.host.axes.limits()[number]
            if axis == "Z":
                low = max(low, self.section.settings.length)
            at, distance = start[number], distances[axis]
            ends[number] = jogged(axis, at, distance, (low, high))
        self.wizard.move(gcmd, ends, JOG_SPEED, JOG_SPEED)

    ##################################################################
    # What is shown, and the end
    ##################################################################

    def ask(self, problem: str = "") -> None:
        """Show the dialog of the step; problem: why the last answer was not done."""
        self.section.low_moves.is_led = True
        self.wizard.show(self.sentences(problem))

    def sentences(self, problem: str = "") -> List[str]:
        """Return what the dialog says; problem: why the last answer was not done."""
        notes = []
        if self.wizard.asked().axes:
            notes.append(head_at(self.host.toolhead.get_position()))
        return self.wizard.sentences(
            self._facts(), notes=notes, problem=problem
        )

    def _facts(self) -> Dict[str, object]:
        """Return what the text of the step is filled in with."""
        facts: Dict[str, object] = {
            option.split("_")[0]: written(position)
            for option, position in self.found.items()
        }
        facts.update(
            pins=self.section.sensors.describe(),
            axes=", ".join(self._axes()),
            slow=SLOW_SPEED,
        )
        if self.wizard.asked().name == "save":
            lines = [f"{option}: {text}" for option, text in self._values()]
            facts.update(
                values="\n".join(lines),
                by_hand="\n".join(self.wizard.by_hand()),
                saving=SAVED,
            )
        return facts

    def do_save(self) -> None:
        """Write the values, and have klippy restart.

        What has failed is asked again: nothing is over before klippy restarts.
        """
        self.wizard.save(self._values())

    def _values(self) -> List[Tuple[str, str]]:
        """Return what is to be written, as pairs of option and text.

        Not those that are as another one is anyway.
        """
        positions, section = self._positions(), self.host.section
        values = [
            (name, written(positions[name]))
            for name in (
                "dock_position",
                "approach_position",
                "detach_position",
            )
        ]
        for name in ("extract_position", "insert_position"):
            place = positions[name]
            is_default = place == positions["approach_position"]
            if not is_default or given(self.host, section, name):
                values.append((name, written(place)))
        distance = given(self.host, section, DISTANCE)
        nearest = nearest_distance(positions)
        if distance is not None and float(distance) > nearest:
            # klippy would refuse it, and what is rounded up.
            text = f"{nearest:.3f}"
            is_up = float(text) > nearest
            values.append(
                (DISTANCE, f"{nearest - 0.001:.3f}" if is_up else text)
            )
        return values


def written(position: Sequence[Optional[float]]) -> str:
    """Return a position as an option has it."""
    return ", ".join(f"{at:.3f}" for at in position if at is not None)
