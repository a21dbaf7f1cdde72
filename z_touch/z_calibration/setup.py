"""Z_CALIBRATION_SETUP: from an empty section to the first result, by dialogs.

Each step does what the one before has announced, and asks for the next one; see
setup_steps.py for what they ask:

    pin -> off -> probe -> home                  hands: wires and polarity
    nozzle => attach -> switch -> bed -> look    toolhead: the places, by its buttons
    touch_nozzle => touch_switch => touch_bed    touches, slow
    gap (-> paper) -> save                       switch_offset, SAVE_CONFIG

What comes after => is done at once, and asked for only where it has failed.  Every
height is a toolhead Z, in mm, in the frame that the last homing defined; up is
positive.  Nothing is saved before the last step.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import math
from dataclasses import dataclass, field
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Iterator,
    List,
    NamedTuple,
    Optional,
    Tuple,
)

from .. import attached, command, dialog, options, touch
from ..errors import CalibrationError
from ..host.klippy import GCodeCommand
from ..setup_command import SetupCommand
from ..touch import Site
from ..wizard import (
    HAND_PATIENCE,
    LARGEST_JOG,
    SAVED,
    configured,
    head_at,
    jogged,
)
from . import checks, heights
from . import setup_judging as judging
from . import setup_steps as texts
from .setup_steps import STEPS
from .sites import LARGEST_SWITCH_DISTANCE, SiteFinder, Sites
from .switches import COME_DOWN, SWITCHES

if TYPE_CHECKING:
    from .module import ZCalibration
    from .run import CalibrationRun


# What is touched, in this order
SITES = ("nozzle", "switch", "bed")
# The site that a step touches
TOUCHED = {f"touch_{name}": name for name in SITES}
# Steps that use heights of before
NEED_HEIGHTS = ("touch_switch", "touch_bed", "gap", "paper")
# Where the toolhead goes when the first button is pressed; 'Again' of the look leads there
LEADS_TO = {
    "home": "nozzle",
    "nozzle": "switch",
    "attach": "switch",
    "switch": "bed",
    "bed": "look",
    "look": "look",
}

# What a hand has done to a switch, in the words of wizard.judge(), and what that says of
# the wiring
VERDICTS = {
    "early": "reads pressed before anything presses it",
    "nothing": f"was not pressed within {HAND_PATIENCE:.0f} seconds",
    "other": "did not change, but the other switch did: the pins are mixed up",
    "both": "changed together with the other switch: both are on one pin",
    "held": "was pressed and has not come back",
}

# So long (s) the toolhead stays over each place for somebody to look
LOOK_TIME = 4.0

# The nozzle comes down to so high (mm) above the highest bed that there may be, to
# meet the sheet of paper by small steps from there; no further (mm) aside is it over
# the sheet.
OVER_SHEET = 2.0
BESIDE_SHEET = 2.0


class Touched(NamedTuple):
    """One place that was touched.

    Its height (toolhead Z, mm), those of all samples, and what was odd, in words.
    """

    z: float
    samples: List[float]
    warnings: List[str]


@dataclass
class Found:
    """How far somebody has come, and what was found."""

    # The toolhead has got to where the step begins
    arrived: bool = True
    # The probe stays on the toolhead
    is_fixed: bool = False
    # A start_gcode has run since the last end_gcode
    is_fetched: bool = False
    # The probe was on the toolhead when that has got to a place, or was moved by hand
    is_attached: bool = False
    # Of the frame of the heights; None: not homed yet
    mark: Any = None
    # The user was told that the pin has moved since Z was homed on it
    is_pin_told: bool = False
    # Toolhead Z (mm) that the pin lies below; None: not known
    pin_below: Optional[float] = None
    # By their names: where the toolhead stands, and what was touched there
    sites: Dict[str, Site] = field(default_factory=dict)
    touched: Dict[str, Touched] = field(default_factory=dict)
    # The extruder that was active then
    extruder: str = ""
    # In mm, and the switch of the list that it is of; empty: it was measured
    switch_offset: float = 0.0
    switch_type: str = ""

    def contact(self) -> float:
        """Return where the nozzle would meet the bed if switch_offset were 0.

        The toolhead Z (mm) at which the probe triggers on the bed, less what the body
        hangs below the nozzle.
        """
        nozzle, switch, bed = (self.touched[name].z for name in SITES)
        return bed - (switch - nozzle)

    def height(self, name: str) -> Optional[float]:
        """Return the toolhead Z (mm) of a site; None: it was not touched yet."""
        return self.touched[name].z if name in self.touched else None

    def heights_before(self, name: str) -> List[float]:
        """Return those of the sites that are touched before this one."""
        before = [self.height(site) for site in SITES[: SITES.index(name)]]
        return [z for z in before if z is not None]


# The command, and the set-up that is under way
class Setup(SetupCommand):
    """Sets up the section, step by step."""

    def __init__(self, calibration: ZCalibration) -> None:
        """Register the command."""
        super().__init__(calibration.host, "Z_CALIBRATION_SETUP")
        self.calibration = calibration
        self.user_gcode = calibration.user_gcode
        self.datum = calibration.datum
        self.found = Found()
        command.register_commands(self.host, self)

    cmd_Z_CALIBRATION_SETUP_help = "Set up the Z calibration, step by step"

    def cmd_Z_CALIBRATION_SETUP(self, gcmd: GCodeCommand) -> None:
        """Begin, show again what is asked, or do what the answer says."""
        self.calibration.check_idle(gcmd)
        self.calibration.refuse_during_a_print(gcmd)
        self.run(gcmd)

    def begin(self, gcmd: GCodeCommand) -> None:
        """Ask the first step."""
        self.wizard.begin(STEPS)
        self.found = Found()

    def go_on(self, gcmd: GCodeCommand) -> None:
        """Do what the step has announced for this answer.

        Every method do_<step> does what the first button of the step says, and brings
        the toolhead to where the next step begins.
        """
        if self._takes_switch_offset(gcmd):
            self.come_to("save")
            return
        answer, step = self.wizard.answer(gcmd), self.wizard.asked()
        if answer == "SKIP":
            self.found.is_fixed = True
        self._check_heights()
        if answer == "BACK":
            if step.name == "paper":
                self._lift()
            self.come_to(step.back)
        elif answer == "SKIP":
            self.come_to("probe")
        elif answer == "AGAIN":
            self.come_to("look")
        elif answer:
            self.come_to(answer.lower())
        elif not self.found.arrived:
            self.come_to(step.name)
        else:
            getattr(self, f"do_{step.name}")(gcmd)

    def come_to(self, name: str) -> None:
        """Ask a step next, and bring the toolhead to where it begins.  May pause."""
        self.wizard.enter(name)
        self.found.arrived = False
        if name in SITES:
            self._go_to_site(name)
        elif name == "look":
            self._look_around()
        elif name == "paper":
            self._go_over_sheet()
        self.found.arrived = True

    @contextlib.contextmanager
    def running(self, gcmd: GCodeCommand) -> Iterator[None]:
        """Run a step, which meets no G-code offset and leaves none."""
        running = self.calibration.running(
            gcmd, "setup", 0, has_error_gcode=False
        )
        with running, self.host.gcode_state.without_offset():
            yield

    def _finder(self) -> SiteFinder:
        """Return what finds and checks sites by the settings in force."""
        return SiteFinder(self.host, self.calibration.settings)

    def _pin_moved(self) -> str:
        """Return what has moved the pin since Z was homed on it, in words.

        Empty: nothing has, or Z is not homed on it.
        """
        is_homed_on = self.calibration.settings.position_endstop is not None
        return self.calibration.homed.moved() if is_homed_on else ""

    def _step(self) -> str:
        return self.wizard.asked().name

    def abort(self, gcmd: GCodeCommand) -> None:
        """Leave the printer as it was before, as far as that is possible."""
        is_printing = self.host.print_state() or dialog.is_paused(self.host)
        self.wizard.close()
        with self.running(gcmd):
            self._leave(gcmd, bool(is_printing))
        self.wizard.tell_end()

    def _leave(self, gcmd: GCodeCommand, is_printing: bool) -> None:
        """Lift the toolhead, and put a probe away that was fetched.

        A print would go on where the toolhead was lifted to; of a printer that is not
        homed nothing can be moved.
        """
        if self.found.mark is None:
            return
        if self._is_homed() and not is_printing:
            self._lift()
            self._put_away()
        elif self.found.is_fetched:
            gcmd.respond_info(
                f"{self.host.section}: nothing was moved, as a print may be on, or"
                " the printer is not homed; the probe has to be off the toolhead; look,"
                " and put it away by hand"
            )

    ##################################################################
    # What is pressed by hand
    ##################################################################

    def do_pin(self, gcmd: GCodeCommand) -> None:
        """Watch somebody press the pin."""
        if self._is_homed():
            # After G28 the nozzle may stand on it
            self._lift()
        pin, probe = self.calibration.pin, self.host.probing.endstop()
        option = pin.section, pin.option
        self._watch(gcmd, pin.name, option, pin.endstop, probe)
        self.come_to("off")

    def do_off(self, gcmd: GCodeCommand) -> None:
        """See that the probe reads as it is: not attached."""
        self.found.is_fixed = False
        if self._is_attached():
            remedy = self._check_wiring(*self._probe_option())
            raise CalibrationError(
                "the probe reads as if it were attached: it is not wired as"
                f" normally closed, or the polarity is wrong; {remedy}"
            )
        self.come_to("probe")

    def do_probe(self, gcmd: GCodeCommand) -> None:
        """Watch somebody press the plunger of the probe."""
        probe, pin = self.host.probing.endstop(), self.calibration.pin.endstop
        self._watch(gcmd, "the probe", self._probe_option(), probe, pin)
        self.come_to("home")

    def _is_attached(self) -> bool:
        """Ask the probe's switch, which reads triggered where it is not."""
        probe = self.host.probing.endstop()
        return not probe.query_endstop(self.host.after_moves())

    def _probe_option(self) -> Tuple[str, str]:
        """Return section and option of the probe's MCU pin."""
        is_plain = "pin" in configured(self.host, "probe")
        return "probe" if is_plain else "dockable_probe", "pin"

    def _check_wiring(self, section: str, option: str) -> str:
        pin = configured(self.host, section).get(option, "")
        return (
            f"check '{option}: {pin}' in section '{section}' (the other polarity:"
            f" '{option}: {judging.inverted(pin)}')"
        )

    def _watch(
        self,
        gcmd: GCodeCommand,
        name: str,
        option: Tuple[str, str],
        endstop: Any,
        other: Any,
    ) -> None:
        """Wait until something is pressed by hand and let go.  Pauses.

        Raises CalibrationError where it was not 'endstop', or not only that; option:
        section and option of its MCU pin.
        """
        host = self.host
        host.toolhead.wait_moves()
        before = self.wizard.read_switches(endstop, other)
        asked = [
            text.format(switch=name, patience=HAND_PATIENCE)
            for text in texts.PRESS
        ]
        self.wizard.show_while_waiting("press it now", asked)
        gcmd.respond_info(f"{host.section}: watching {name} ...")
        verdict = self.wizard.watch(before, endstop, other)
        if verdict != "good":
            remedy = self._check_wiring(*option)
            if verdict == "early" and endstop is self.calibration.pin.endstop:
                remedy = (
                    "lift the nozzle by hand if it stands on the pin, and"
                    f" otherwise {remedy}"
                )
            if verdict == "nothing":
                # A user who was slow is not to turn a right polarity over
                remedy = f"press it again, or, if you did press it, {remedy}"
            raise CalibrationError(f"{name} {VERDICTS[verdict]}; {remedy}")
        gcmd.respond_info(f"{host.section}: {name} works")

    ##################################################################
    # The places
    ##################################################################

    def do_home(self, gcmd: GCodeCommand) -> None:
        """Home what is not homed, and go over the pin.

        Z again where the pin is elsewhere since: how low the toolhead may be moved by hand
        counts from it.
        """
        moved = self._is_homed() and self._pin_moved()
        if moved or not self._is_homed():
            on_pin = self.calibration.settings.position_endstop is not None
            if on_pin and not self.found.is_fixed and self._is_attached():
                raise CalibrationError(
                    "the probe is on the toolhead, and would hit the bed before the"
                    " nozzle meets the pin; put it away, or run G28 yourself"
                )
            self.host.gcode.run_script_from_command("G28 Z" if moved else "G28")
        command.check_homed(self.host)
        self.found.mark = self.datum.mark()
        self.come_to("nozzle")

    def do_nozzle(self, gcmd: GCodeCommand) -> None:
        """Keep the place of the nozzle, and fetch the probe."""
        self._take_site("nozzle")
        self.come_to("attach")
        self.do_attach(gcmd)

    def do_attach(self, gcmd: GCodeCommand) -> None:
        """Fetch the probe unless it is on the toolhead, and bring its body to the pin."""
        self._lift()
        if not self._is_attached():
            self._fetch()
            with self.user_gcode.holding_probe():
                self.user_gcode.before_switch(None)
                self.found.mark = self.datum.mark()
            if not self._is_attached():
                raise CalibrationError(
                    "the probe reads triggered: nothing has attached it; attach it"
                    " by hand, or correct what should have done so"
                )
        self.come_to("switch")

    def do_switch(self, gcmd: GCodeCommand) -> None:
        """Keep the place of the switch, and bring the probe over the bed."""
        self._take_site("switch")
        self.come_to("bed")

    def do_bed(self, gcmd: GCodeCommand) -> None:
        """Keep the place of the bed, and go over all places once more."""
        self._take_site("bed")
        self.come_to("look")

    def do_look(self, gcmd: GCodeCommand) -> None:
        """All places are right."""
        self.come_to("touch_nozzle")

    def _take_site(self, name: str) -> None:
        """Keep where the toolhead stands as a site, and lift it.

        Raises CalibrationError where that cannot be the site.
        """
        x, y = (round(a, 3) for a in self.host.toolhead.get_position()[:2])
        site = Site(name, x, y, f"The place of the {name}")
        self._check_site(site)
        if name == "nozzle":
            # The pin is no higher than the nozzle over it
            self.found.pin_below = self.host.motion.z()
        self._lift()
        self.found.sites[name] = site

    def _check_site(self, site: Site) -> None:
        finder, sites = self._finder(), self.found.sites
        if site.name == "nozzle":
            finder.check_nozzle(site)
        else:
            finder.check_reach(site)
        nozzle = sites.get("nozzle", site)
        apart = math.hypot(site.x - nozzle.x, site.y - nozzle.y)
        if site.name == "switch" and not 0.0 < apart <= LARGEST_SWITCH_DISTANCE:
            raise CalibrationError(
                f"the switch cannot be {apart:.1f} mm from the nozzle; move the toolhead"
                " until its body is over the pin"
            )
        if site.name == "bed":
            finder.check_apart(sites["switch"], site)
        # The host's own text, as the option is one of several modules
        options_of_dock = configured(self.host, "dockable_probe")
        judging.check_dock(site, options_of_dock.get("dock_position", ""))

    def _candidate(self, name: str) -> Optional[Site]:
        """Return the site that was found, or that the section names.

        None: nothing says where it is.
        """
        settings = self.calibration.settings
        if name in self.found.sites:
            return self.found.sites[name]
        if name == "nozzle":
            return settings.nozzle_xy_position
        if name == "switch":
            return self._switch_candidate()
        finder = self._finder()
        site = finder.bed_site(settings.bed_xy_position)
        if site is None:
            x, y = (sum(axis) / 2.0 for axis in self.host.axes.limits()[:2])
            site = self._with_probe("bed", (x, y), "The middle of the bed")
        return site

    def _switch_candidate(self) -> Optional[Site]:
        """Return the switch's site: about where the probe is, until somebody has looked."""
        nozzle = self.found.sites.get("nozzle")
        if self._step() == "nozzle":
            # The place that is taken next
            x, y = self.host.toolhead.get_position()[:2]
            nozzle = Site("nozzle", x, y, "")
        finder = self._finder()
        position = self.calibration.settings.switch_xy_position
        site = finder.switch_site(nozzle, position)
        if site is None and nozzle is not None:
            xy = nozzle.x, nozzle.y
            site = self._with_probe("switch", xy, "The body of the switch")
        return site

    def _is_at_plunger(self) -> bool:
        """Say whether only the probe's offset says where the switch is.

        Its plunger is about over the pin then.
        """
        settings = self.calibration.settings
        named = settings.switch_xy_position, settings.switch_xy_offsets
        return named == (None, None) and "switch" not in self.found.sites

    def _with_probe(
        self, name: str, xy: Tuple[float, float], origin: str
    ) -> Site:
        """Where the toolhead stands to have the probe at xy, as far as it reaches."""
        limits, offsets = self.host.axes.limits(), self.host.probing.offsets()
        x, y = (
            min(max(a - offset, low), high)
            for a, offset, (low, high) in zip(xy, offsets, limits)
        )
        return Site(name, x, y, origin)

    ##################################################################
    # Moves
    ##################################################################

    def _is_homed(self) -> bool:
        homed = self.host.toolhead_status()["homed_axes"]
        return all(axis in homed for axis in "xyz")

    def _lift(self) -> None:
        """Lift the toolhead to where it may travel, never down."""
        command.check_homed(self.host)
        self._first_run().lift()

    def _go(self, site: Site) -> None:
        """Lift the toolhead and move it over a site, around a dock that is known.

        Over the pin X first, as another pin is more often beside it than in front.
        """
        self._lift()
        speed = self.calibration.settings.speed
        everything = attached.of(self.host.printer)
        to_pin = site.name != "bed"
        everything.go_to(self.host, site.x, site.y, speed, to_pin)

    def _go_to_site(self, name: str) -> None:
        self.found.is_attached = self._is_attached()
        site = self._candidate(name)
        if site is None:
            self._lift()
            return
        self._finder().check_reach(site)
        self._go(site)

    def _look_around(self) -> None:
        """Move to all places, with time to look.  Pauses."""
        for name in SITES:
            self._go(self.found.sites[name])
            self.host.toolhead.wait_moves()
            self.host.say(f"Look: {texts.LOOKED_AT[name]}")
            self.host.toolhead.dwell(LOOK_TIME)
        self.host.toolhead.wait_moves()

    def jog(self, gcmd: GCodeCommand) -> None:
        """Move by the X, Y and Z of the command (mm).  Pauses."""
        found = self.found
        if not found.arrived:
            raise CalibrationError(
                "the toolhead has not got to this place yet; answer the question"
            )
        self._check_heights()
        found.is_attached = self._is_attached()
        is_paper = self._step() == "paper"
        if is_paper:
            self._check_sheet()
            self._check_over_sheet()
        command.check_homed(self.host)
        distances = self.wizard.distances(gcmd)
        start = self.host.toolhead.get_position()
        ends: List[Optional[float]] = [None, None, None]
        for number, axis in enumerate("XYZ"):
            if axis not in distances:
                continue
            at, distance = start[number], distances[axis]
            low, high = self.host.axes.limits()[number]
            if axis == "Z" and is_paper:
                low = judging.paper_floor(found.contact(), at, distance)
            elif axis == "Z":
                low = self._jog_floor()
            stops = axis == "Z" and not is_paper
            ends[number] = jogged(axis, at, distance, (low, high), stops=stops)
        settings = self.calibration.settings
        self.wizard.move(gcmd, ends, settings.speed, settings.on_pin.lift_speed)

    def _jog_floor(self) -> float:
        """Return how low (toolhead Z, mm) the toolhead may be moved by hand."""
        below = 0.0
        if self.found.is_attached or self._step() == "switch":
            # The plunger ends lower than where it triggers
            z_offset = self.calibration.settings.z_offset
            below = heights.reach_below(z_offset, judging.CLEAR_OF_PIN)
        return judging.jog_floor(self._pin_z(), below)

    def _lowest(self) -> str:
        """Say how low the buttons lead."""
        floor, pin_z = self._jog_floor(), self._pin_z()
        text = texts.LOWEST
        if pin_z is None:
            text = texts.LOWEST_OF_ANY
        elif floor > pin_z + judging.CLEAR_OF_PIN + 1e-6:
            text = texts.LOWEST_OF_PROBE
        return text.format(clear=judging.CLEAR_OF_PIN, floor=floor)

    def _pin_z(self) -> Optional[float]:
        """Return a toolhead Z (mm) that the pin is not above; None: not known."""
        nozzle_z = self.found.height("nozzle")
        if nozzle_z is not None:
            return nozzle_z
        homed_z: Optional[float] = self.calibration.settings.position_endstop
        if homed_z is None or self._pin_moved():
            return self.found.pin_below
        return homed_z

    ##################################################################
    # First touches
    ##################################################################

    def do_touch_nozzle(self, gcmd: GCodeCommand) -> None:
        """Touch the pin with the nozzle, then with the switch, then the bed."""
        found = self.found
        checks.check_carriages(self.host, self.calibration.settings)
        self._lift()
        found.touched = {}
        if not (found.is_fixed or found.is_fetched) and self._is_attached():
            # By the user
            self.user_gcode.before_attaching()
            found.is_fetched = True
        self._put_away()
        self._fetch()
        found.extruder = self.host.tools.active()
        with self.user_gcode.holding_probe():
            self._touch("nozzle")
        self.come_to("touch_switch")
        self._tell_floor("switch")
        self.do_touch_switch(gcmd)

    def do_touch_switch(self, gcmd: GCodeCommand) -> None:
        """Touch the pin with the body of the switch, then the bed with the probe."""
        with self.user_gcode.holding_probe():
            self._lift()
            # An earlier try may have fetched it
            if not (self.user_gcode.is_late and self._is_attached()):
                self.user_gcode.before_switch(self.found.mark)
            self._touch("switch")
        self.come_to("touch_bed")
        self._tell_floor("bed")
        self.do_touch_bed(gcmd)

    def do_touch_bed(self, gcmd: GCodeCommand) -> None:
        """Touch the bed with the probe, and put that away."""
        with self.user_gcode.holding_probe():
            self._touch("bed")
        self._put_away()
        self.come_to("gap")

    def _touch(self, name: str) -> None:
        """Touch a site, and lift the toolhead.  Pauses."""
        found, run = self.found, self._first_run()
        before = found.heights_before(name)
        with command.always(self.host, run.lift, "lifting"):
            if name == "nozzle":
                self.calibration.note_oozing(run)
                z = run.touch_nozzle()
            elif name == "switch":
                z = run.touch_switch(*before)
            else:
                z = run.touch_bed(*before)
            warnings = [warned.text for warned in run.warnings]
            touched = Touched(z, run.statistics.samples[name], warnings)
            found.touched[name] = touched
        if name == "switch" and touched.warnings:
            # The plunger was pressed, too: another place is needed
            raise CalibrationError("; ".join(touched.warnings))

    def _tell_floor(self, name: str) -> None:
        self.host.say(
            f"touching the {name}; without a trigger the touch ends at"
            f" z={self._floor(name):.2f}"
        )

    def _floor(self, name: str) -> float:
        """Return where a touch of a site ends at the latest (toolhead Z, mm)."""
        before = self.found.heights_before(name)
        run = self._first_run()
        if name == "nozzle":
            return run.nozzle_floor()
        if name == "switch":
            expected_z = heights.expect_switch(run.settings, before[0], None)
            return run.switch_floor(before[0], expected_z, None)
        return run.bed_floor(*before)

    def _first_run(self) -> CalibrationRun:
        """Return what touches the sites slowly, and knows nothing of earlier runs."""
        sites = Sites(*(self.found.sites.get(name) for name in SITES))
        settings = judging.slow_settings(self.calibration.settings)
        statistics = self.calibration.new_statistics(settings)
        run = self.calibration.new_run(settings, sites, statistics)
        run.rise_over(self._pin_z())
        return run

    def _travel_z(self) -> float:
        """Return the toolhead Z (mm) at which the toolhead moves over pin and bed."""
        return self._first_run().travel_z

    def _fetch(self) -> None:
        self.found.is_fetched = True
        self.user_gcode.start()
        self.found.mark = self.datum.mark()

    def _put_away(self) -> None:
        """Have the probe put away that was fetched; say where it was not."""
        if not self.found.is_fetched:
            return
        self.user_gcode.end()
        self.found.is_fetched = False
        left = self.user_gcode.probe_left(was_seen=True)
        if left:
            self.host.say(left)

    ##################################################################
    # What has happened since
    ##################################################################

    def _check_heights(self) -> None:
        """Raise CalibrationError where Z was homed again, or with another nozzle.

        Heights hold no more then; sites do. The last step only saves what was measured.
        """
        found, step = self.found, self._step()
        if found.mark is None or step == "save":
            return
        self._check_homed()
        moved = self.datum.moved_since(found.mark) or self._other_nozzle()
        if not moved:
            return
        found.touched, found.pin_below = {}, None
        found.mark = self.datum.mark()
        if step in NEED_HEIGHTS:
            self.come_to("touch_nozzle")
            raise CalibrationError(
                f"{moved}: the heights hold no more, the first touches begin again"
            )

    def _other_nozzle(self) -> str:
        """Say that another extruder is active, whose nozzle may be longer."""
        active, touched = self.host.tools.active(), self.found.extruder
        if not self.found.touched or active == touched:
            return ""
        return f"{active} is active, and the pin was touched with {touched}"

    def _check_homed(self) -> None:
        found, is_homed = self.found, self._is_homed()
        may_hang = not (is_homed or found.is_fixed)
        if may_hang and self._is_attached():
            raise CalibrationError(
                "not homed, and the probe is attached; put it away unless"
                " Z is homed with it, then home all axes (G28)"
            )
        moved = is_homed and self._pin_moved()
        was_told, found.is_pin_told = found.is_pin_told, bool(moved)
        # A G28 that levels in the end would be asked for again and again.
        if moved and not was_told:
            raise CalibrationError(
                f"{moved}, so the height of the pin is not known; home Z again"
                " (G28 Z) with the probe put away"
            )

    ##################################################################
    # How far the switch moves
    ##################################################################

    def do_gap(self, gcmd: GCodeCommand) -> None:
        """Bring the nozzle over a sheet of paper."""
        self._check_sheet()
        self.come_to("paper")

    def do_paper(self, gcmd: GCodeCommand) -> None:
        """Take the switch_offset from where the nozzle holds the sheet."""
        self._check_over_sheet()
        z = self.host.motion.z()
        self._use_switch_offset(judging.from_paper(self.found.contact(), z))
        self._lift()
        self.come_to("save")

    def _takes_switch_offset(self, gcmd: GCodeCommand) -> bool:
        """Take TYPE= or VALUE= of the command; return whether it has one of them."""
        name = options.param_word(gcmd, "TYPE").upper()
        value = options.param_number(
            gcmd, "VALUE", minval=0.0, maxval=judging.LARGEST_SWITCH_OFFSET
        )
        if name and name not in SWITCHES:
            known = ", ".join(SWITCHES)
            raise CalibrationError(
                f"TYPE={name}: none of {known}; give VALUE=mm"
            )
        value = SWITCHES.get(name, value)
        if value is None:
            return False
        if self._step() != "gap":
            raise CalibrationError("TYPE and VALUE belong to STEP=GAP")
        self._use_switch_offset(value, name)
        return True

    def _use_switch_offset(self, value: float, kind: str = "") -> None:
        """Keep a switch_offset (mm); kind: of the switch, where it is of the list."""
        z_offset = self.found.contact() - value
        low, high = self.calibration.settings.offset_margins
        if not low <= z_offset <= high:
            raise CalibrationError(
                f"with {value:.3f} mm Z=0 would move by {z_offset:.3f} mm, outside"
                f" the {low:.3f} to {high:.3f} that are allowed; home Z again (G28"
                " Z), then check the three places"
            )
        self.found.switch_offset, self.found.switch_type = value, kind

    def _over_sheet(self) -> Tuple[float, float, float]:
        """Return where the nozzle is over the point of the bed, and how high (mm)."""
        bed, offsets = self.found.sites["bed"], self.host.probing.offsets()
        x, y = bed.x + offsets[0], bed.y + offsets[1]
        site = Site("bed", x, y, "The nozzle over the sheet")
        touch.check_reach(self.host, site, "take the type of the switch")
        return x, y, self.found.contact() + OVER_SHEET

    def _go_over_sheet(self) -> None:
        x, y, z = self._over_sheet()
        self._go(Site("bed", x, y, ""))
        speed = self.calibration.settings.on_pin.lift_speed
        self.host.toolhead.manual_move([None, None, z], speed)

    def _check_sheet(self) -> None:
        """Raise CalibrationError where the nozzle cannot be lowered to the sheet."""
        self._over_sheet()
        if self._is_attached():
            raise CalibrationError(
                "the probe is attached, so the nozzle cannot reach the sheet;"
                " take it off, or take the type of the switch"
            )

    def _check_over_sheet(self) -> None:
        """Elsewhere the bed has another height, or the pin is below."""
        x, y = self._over_sheet()[:2]
        here = self.host.toolhead.get_position()
        if math.hypot(here[0] - x, here[1] - y) > BESIDE_SHEET:
            raise CalibrationError(
                "the nozzle has left the sheet; 'Back', then 'Paper'"
            )

    ##################################################################
    # The end
    ##################################################################

    def do_save(self, gcmd: GCodeCommand) -> None:
        """Write the values, and have klippy restart.

        What has failed is asked again: nothing is over before klippy restarts.
        """
        self.wizard.save(self._values())

    def _values(self) -> List[Tuple[str, str]]:
        """Return what differs from the section, as pairs of option and text."""
        found, settings = self.found, self.calibration.settings
        values = self._site_values()
        values.append(("switch_offset", f"{found.switch_offset:.3f}"))
        travel_z = self._travel_z()
        is_higher = travel_z > settings.safe_z_height or settings.unmeasured_pin
        if settings.position_endstop is None and is_higher:
            # CALIBRATE_Z does not know how high that pin is
            values.append(("safe_z_height", f"{travel_z + 0.05:.1f}"))
        count = judging.repeatability(self._samples())[1]
        samples = judging.proposed_samples(
            settings, self.host.axes.z_step(), count
        )
        if samples:
            values.append(("samples", samples))
        return values

    def _site_values(self) -> List[Tuple[str, str]]:
        """Return the sites that are others than those of the section."""
        settings, finder = self.calibration.settings, self._finder()
        sites, (x, y) = self.found.sites, self.host.probing.offsets()[:2]
        in_section = {
            "nozzle": settings.nozzle_xy_position,
            "switch": finder.switch_site(
                sites["nozzle"], settings.switch_xy_position
            ),
            "bed": finder.bed_site(settings.bed_xy_position),
        }
        values = []
        for name, old in in_section.items():
            site = sites[name]
            if old is not None and judging.is_near(old, site):
                continue
            if name == "bed":
                # The option is a point of the bed, the site one of the toolhead
                site = site._replace(x=site.x + x, y=site.y + y)
            values.append(
                (f"{name}_xy_position", f"{site.x:.3f}, {site.y:.3f}")
            )
        return values

    def _samples(self) -> List[List[float]]:
        """Return all touches (mm), by site."""
        touched = self.found.touched
        return [touched[name].samples for name in SITES if name in touched]

    ##################################################################
    # What is shown
    ##################################################################

    def ask(self, problem: str = "") -> None:
        """Show the dialog of the step; problem: why the last answer was not done."""
        late = self._late()
        widest = max(self._paper_room(), judging.SMALL_STEP)
        self.wizard.show(self.sentences(problem), widest, late)

    def _late(self) -> str:
        return "" if self.found.arrived else self._goal(self._step())

    def sentences(self, problem: str = "") -> List[str]:
        """Return what the dialog says; problem: why the last answer was not done."""
        back = self.wizard.asked().back
        notes = [f"'Back': {self._goal(back)}."] if back in SITES else []
        if self._is_homed():
            notes.append(head_at(self.host.toolhead.get_position()))
        return self.wizard.sentences(
            self._facts(), notes=notes, problem=problem, late=self._late()
        )

    def _facts(self) -> Dict[str, object]:
        """Return what the text of the step is filled in with."""
        step = self._step()
        facts: Dict[str, object] = {
            "patience": HAND_PATIENCE,
            "touches": judging.FIRST_TOUCHES,
            "come_down": COME_DOWN,
            "travel_z": self._travel_z(),
            "goal": self._goal(LEADS_TO.get(step, "")),
            "repeats": self._repeats(),
        }
        settings = self.calibration.settings
        is_fetched = settings.may_attach_late or "start_gcode" in settings.given
        facts.update(texts.BY_GCODE if is_fetched else texts.BY_HAND)
        if step in ("nozzle", "switch"):
            is_at_plunger = step == "switch" and self._is_at_plunger()
            facts["plunger"] = texts.AT_PLUNGER if is_at_plunger else ""
            facts["lowest"] = self._lowest()
        elif step in TOUCHED:
            facts["floor"] = self._floor(TOUCHED[step])
        elif step == "gap":
            facts["paper_z"] = self.found.contact() + OVER_SHEET
        elif step == "paper":
            is_high = judging.is_too_high(
                self.found.contact(), self.host.motion.z()
            )
            facts["sheet"] = texts.TOO_HIGH if is_high else texts.NEAR_SHEET
        elif step == "save":
            facts.update(self._save_facts())
        return facts

    def _save_facts(self) -> Dict[str, object]:
        switch_offset, kind = self.found.switch_offset, self.found.switch_type
        lines = [f"{option}: {text}" for option, text in self._values()]
        return {
            "values": "\n".join(lines),
            "by_hand": "\n".join(self.wizard.by_hand()),
            "of_a_list": judging.of_a_list(kind),
            "too_small": judging.too_small(switch_offset),
            "saving": SAVED,
        }

    def _repeats(self) -> str:
        """Say how well the last touches repeat; empty: before the first ones."""
        touched = self.found.touched
        if not touched:
            return ""
        name = [site for site in SITES if site in touched][-1]
        samples = touched[name].samples
        spread = max(samples) - min(samples)
        last = f"The {name} repeats within {spread:.4f} mm."
        if len(touched) < len(SITES):
            return last
        return (
            f"{last}\nAll in all: {judging.repeatability(self._samples())[0]}."
        )

    def _paper_room(self) -> float:
        """Return by how much (mm) the nozzle is above where it may hold the sheet.

        Elsewhere than at the step with the sheet: as much as any jog.
        """
        if self._step() != "paper":
            return LARGEST_JOG
        return judging.paper_room(self.found.contact(), self.host.motion.z())

    def _goal(self, name: str) -> str:
        """Say what the toolhead does to come to a step; empty: nothing."""
        text = f"the toolhead lifts to Z={self._travel_z():.1f}"
        if name == "paper":
            x, y, z = self._over_sheet()
            return f"{text}, moves to X={x:.1f} Y={y:.1f} and down to Z={z:.2f}"
        if name == "look":
            return (
                f"{text} and goes over all three places once more,"
                f" {LOOK_TIME:.0f} seconds each"
            )
        if name not in SITES:
            return ""
        site = self._candidate(name)
        if site is None:
            return text
        return f"{text} and moves to X={site.x:.1f} Y={site.y:.1f}"
