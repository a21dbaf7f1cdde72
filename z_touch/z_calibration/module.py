"""The object behind [z_calibration]: its commands and its status.

  settings       the options, and parameters of commands
  run, place     the touches of one run: nozzle, switch, bed
  heights        the formula, what is expected, floors and travel heights
  statistics     how often to touch, and what the offset may be off by
  user_gcode     the user's G-code around it, and who attaches the probe
  shifts         what Klipper's own features add to Z where the bed was measured
  result         the last run that was applied, and whether it still holds
  switch_offset  baby steps back into switch_offset
  accuracy       parameters and figures of the accuracy commands
  warming        waiting until pin and nozzle stand still
  growth         how much longer a hot nozzle is
  run_log        the runs of before, and the file that keeps them

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
from statistics import fmean
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Iterator,
    List,
    Optional,
    Tuple,
)

from .. import __version__, attached, command, options
from ..datum import LEVELLED, Datum, HomedDatum
from ..errors import CalibrationError, TouchedWrong
from ..host import unknown_commands
from ..host.printer import Host
from ..host.toolhead import check_z_axis
from ..in_force import InForce
from ..progress import Notes
from ..sampling import accuracy as accuracy_of
from . import accuracy, checks, heights, run_log, switches
from .growth import NozzleGrowth, growth_of, with_extruder_temp
from .pin import PressedPin, find_pin, read_pin
from .report_process import ReportProcess
from .result import LastRun, Results, height_of
from .run import CalibrationRun, Earlier
from .runs import PROBE, SITES, Cycle, offsets, uncertainty
from .settings import (
    Settings,
    complete,
    idle_params,
    read_settings,
    with_pace,
    with_switch_offset,
    with_touches,
)
from .setup import Setup
from .shifts import Shifts
from .sites import SiteFinder, Sites
from .statistics import RunStatistics, impossible
from .steps import SAME_OFFSET, Steps
from .switch_offset import SwitchOffset
from .user_gcode import UserGcode
from .warming import WaitForWarming

if TYPE_CHECKING:
    from ..host.klippy import Config, GCodeCommand
    from .heights import Result

# Less (mm) is rounding.
NO_CHANGE = 0.0000001

# The G-code offset (mm) that offset_gcode begins with: 0, but for its digits
UNSET = 0.000000001

UNDO_G92 = (
    "run G28 before CALIBRATE_Z, or RESTART where that homes Z with the probe"
)

# What a plate or a material may need (mm) on top of what was measured
LARGEST_ADJUST = 0.5

# An offset of more than this (mm) is worth correcting in position_endstop.
LARGE_OFFSET = 0.2

# One that differs by no more (mm) from that of the last hint is not worth another
SAME_HINT = 0.05


class ZCalibration:
    """The object behind [z_calibration].  Commands may pause, get_status() never does."""

    def __init__(self, config: Config):
        logging.info("z_calibration %s", __version__)
        self.host = Host(config)
        z_axis = check_z_axis(config, self.host.axes.z_axis)
        self.datum = Datum(self.host)
        # There the pin is where Z was homed on it
        self.homed = HomedDatum(self.datum)
        self.runner = command.Runner(self.host)
        self.progress = self.runner.watch
        attached.of(self.host.printer).watches.append(self.progress)
        old_names = options.OldNames(config)
        self.settings = read_settings(config, z_axis, old_names)
        self.config_notes = old_names.notes
        # None: the Z endstop, which exists when klippy connects
        self.own_pin = read_pin(config, self.host, old_names)
        self.pin: PressedPin
        self.run_log = run_log.RunLog(self.host, self.settings, __version__)
        self.report_process = ReportProcess(self.host, self.run_log)
        self.user_gcode = UserGcode(
            self.host, self.settings, self.datum, self.progress
        )
        self.results = Results(self.host, self.datum)
        self.in_force = InForce(
            self.host, self.results.sudden_reason, self.results.settle
        )
        self.notes = Notes(self.host, self.start_notes)
        # The offset (mm) that the user was last hinted at; None: not
        self.hinted: Optional[float] = None
        # Of the run that is under way: its touches, when it began (eventtime), and why
        # the nozzle was cleaned
        self.statistics: RunStatistics
        self.began = 0.0
        self.bed_spread = 0.0
        self.cleaned = ""
        # The height of the nozzle and switch - nozzle (mm) of the try before; None: there was
        # none, or it was not measured
        self.tried: Tuple[Optional[float], Optional[float]] = (None, None)
        # Where (X and Y, mm) the pin was touched with the probe attached, also by homing Z
        self.proved: List[Tuple[float, float]] = []
        register = self.host.printer.register_event_handler
        register("klippy:connect", self.connect)
        register("homing:home_rails_end", self._z_homed)
        command.register_commands(self.host, self)
        command.register_commands(self.host, self.report_process)
        SwitchOffset(self)
        self.warming = WaitForWarming(self)
        NozzleGrowth(self)
        Setup(self)

    ##################################################################
    # Set-up and status
    ##################################################################

    def connect(self) -> None:
        """Complete the settings; a wrong set-up ends the start of klippy."""
        host = self.host
        host.connect()
        self.pin = self.own_pin or find_pin(host)
        host.endstops.check_stops_z(self.pin.endstop, self.pin.origin)
        checks.check_probe(host)
        self.settings = complete(
            self.settings,
            host.probing.sampling(),
            host.probing.offsets()[2],
            host.axes.limits()[2][1],
        )
        try:
            checks.check_settings(host, self.settings)
        except CalibrationError as e:
            raise host.printer.config_error(str(e))

    def _z_homed(self, homing_state: Any, _rails: Any) -> None:
        """Note where homing Z has touched the pin with the probe attached.

        Without the probe it is not known where that would be, and one that is pressed touches
        the bed there; both read triggered.  May pause: it is called within G28, and after
        that a macro may have docked the probe.
        """
        if 2 not in homing_state.get_axes() or self.own_pin is not None:
            return
        x, y = self.host.toolhead.get_position()[:2]
        if (x, y) in self.proved:
            return
        try:
            is_off = self.host.probing.reads_triggered(self.host.print_time())
        except self.host.printer.command_error:
            logging.exception("z_calibration: the probe does not answer")
            return
        if not is_off:
            self.proved.append((x, y))

    def start_notes(self) -> List[str]:
        """Return what the user is told when klippy is ready, empty texts among it."""
        texts = [*self.config_notes, *checks.notes(self.host, self.settings)]
        texts += unknown_commands.of(self.host.printer).notes(self.host.section)
        texts += self.run_log.notes
        if self.run_log.last_good(self.host.tools.active()) is None:
            # How low the first run may go
            texts.append(checks.margins_note(self.settings))
        return texts

    def get_status(self, eventtime: float) -> Dict[str, Any]:
        """Return what macros and web interfaces read."""
        status = self.results.status()
        status["history"] = self.run_log.status
        status["notes"] = list(self.notes.texts)
        status["movement"] = self.warming.movement
        status.update(self.progress.status())
        return status

    def use_switch_offset(self, switch_offset: float) -> None:
        """Calculate with another switch_offset (mm) from now on."""
        self.settings = self.settings.replace(switch_offset=switch_offset)

    def use_nozzle_growth(self, nozzle_growth: float) -> None:
        """Calculate with another nozzle_growth (mm per 100 C) from now on."""
        self.settings = self.settings.replace(nozzle_growth=nozzle_growth)

    ##################################################################
    # Around every command that touches
    ##################################################################

    def check_idle(self, gcmd: GCodeCommand) -> None:
        """Raise the command's error while another one is under way."""
        self.runner.check_idle(gcmd)

    def refuse_during_a_print(
        self, gcmd: GCodeCommand, own: bool = False
    ) -> None:
        """Raise the command's error while a person is asked, or a print goes on from here.

        Before anything moves, templates included: of a run that has not begun neither
        end_gcode nor error_gcode has to undo anything.  'own': what begins is no part of
        the set-up, which may have its sheet of paper on the bed.
        """
        with self.host.as_command_error(gcmd):
            command.check_no_print(self.host)
            command.check_no_manual_probe(self.host)
            attached.of(self.host.printer).check_questions(self.host, own)

    @contextlib.contextmanager
    def running(
        self, gcmd: GCodeCommand, phase: str, wanted: int, has_error_gcode: bool
    ) -> Iterator[None]:
        """Run a command: one at a time, G-code read the same way in each template.

        After any error the G-code offset is as before, and, with 'has_error_gcode', the run
        is kept as refused and error_gcode runs.  'wanted' is the number of touches.
        """
        self.check_idle(gcmd)
        failed = self._failed if has_error_gcode else None
        is_verbose = options.param_flag(gcmd, "VERBOSE")
        # error_gcode, which runs at the end of the second, leaves no G91 behind
        modes = self.user_gcode.keeping_modes()
        with modes, self.runner.running(gcmd, phase, wanted, failed):
            self.progress.be_verbose(is_verbose)
            try:
                yield
            finally:
                self.progress.be_verbose(False)

    def _failed(self, error: Exception) -> None:
        """Keep a run that was refused, and run error_gcode."""
        measured = self.results.measured
        self._keep_refused(error)
        if measured is not None:
            self.progress.say(
                f"the measured offset {measured.result.offset:.6f} was not applied"
            )
        self.user_gcode.failed(error)

    def _keep_refused(self, error: Exception) -> None:
        """Keep the run, or the try, as refused; what it has measured is not applied."""
        self._keep_run(reason=" ".join(str(error).split()))
        self.results.note(None)

    @contextlib.contextmanager
    def templates_around(self, run: CalibrationRun) -> Iterator[None]:
        """Run start_gcode and end_gcode around the touches of a run.

        end_gcode runs after a failure, too, with the toolhead lifted.  A probe that the run
        has seen attached, and that is attached still, is a warning: it would meet the bed
        before the nozzle does.
        """
        self.user_gcode.check_before_start()
        ending = command.always(self.host, self.user_gcode.end, "end_gcode")
        lifting = command.always(self.host, run.lift, "lifting")
        try:
            with ending, lifting:
                self.user_gcode.start()
                with self.user_gcode.holding_probe():
                    yield
        except CalibrationError as e:
            e.left(self._why_left(run))
            raise
        except self.host.printer.command_error:
            left = self._why_left(run)
            if left:
                self.progress.say(left)
            raise
        left = self.user_gcode.probe_left(run.was_attached)
        if left:
            run.warn(PROBE, left)

    def note_oozing(self, run: CalibrationRun) -> None:
        """Say before the first touch that the nozzle is too hot to be measured."""
        oozing = run.oozing()
        if oozing:
            self.progress.say(oozing)

    def _why_left(self, run: CalibrationRun) -> str:
        """Return why the probe should not be where it is after a failure, or nothing.

        Looking for it must not hide the error.
        """
        try:
            return self.user_gcode.probe_left(run.was_attached)
        except (self.host.printer.command_error, CalibrationError):
            logging.exception("z_calibration: the probe is not looked at")
            return ""

    def begin_statistics(self, settings: Settings) -> None:
        """Begin a run that will be kept: what earlier ones say of its touches."""
        self.statistics = self.new_statistics(settings)
        self.bed_spread = settings.bed_spread
        self.began = self.host.eventtime()
        self.cleaned, self.tried = "", (None, None)

    def new_statistics(self, settings: Settings) -> RunStatistics:
        """Return what earlier runs say of the touches of a run."""
        rough = ("bed",) if settings.bed_spread else ()
        return RunStatistics(
            self.host.axes.z_step(),
            self.run_log.spreads(settings.bed_spread),
            settings.target,
            rough,
            self.run_log.next_turn() if settings.bed_spread else 0,
        )

    def new_run(
        self,
        settings: Settings,
        sites: Sites,
        statistics: RunStatistics,
        reports_places: bool = True,
    ) -> CalibrationRun:
        """Return a run that knows nothing of earlier ones."""
        return CalibrationRun(
            self.host,
            settings,
            sites,
            self.pin,
            statistics,
            self.progress,
            self.homed,
            self.proved,
            reports_places,
        )

    def earlier(self) -> Earlier:
        """Return what the next run knows before it begins."""
        extruder = self.host.tools.active()
        last, holds = self.results.earlier(extruder)
        good = self.run_log.last_good(extruder)
        kept, proved_at = None, self.run_log.nozzle_at()
        if proved_at is not None and proved_at not in self.proved:
            self.proved.append(proved_at)
        if good is not None:
            nozzle, switch, bed = [good.z(site) for site in SITES]
            kept = heights.kept_of(nozzle, switch, bed, good.switch_offset)
        if kept is not None and holds:
            # The same plate lies there: another one comes with a print, which homes
            lower = min(kept.lower, self.settings.travel_margin)
            kept = kept._replace(lower=lower)
        return Earlier(last, holds, kept)

    @contextlib.contextmanager
    def nozzle_run(
        self, gcmd: GCodeCommand, settings: Settings
    ) -> Iterator[CalibrationRun]:
        """Begin a run of the nozzle alone, without the templates around a calibration.

        A dockable_probe is docked first.  At the end, and after a failure, the toolhead is
        lifted.
        """
        nozzle = SiteFinder(self.host, settings).nozzle_of_command(gcmd)
        command.check_homed(self.host)
        checks.check_carriages(self.host, settings)
        with self.host.gcode_state.without_offset():
            self.user_gcode.before_attaching()
            self.user_gcode.free_nozzle()
            run = self.new_run(
                settings,
                Sites(nozzle, None, None),
                self.new_statistics(settings),
                False,
            )
            run.know(self.earlier())
            with command.always(self.host, run.lift, "lifting"):
                yield run

    def touch_all(
        self, run: CalibrationRun, cleaner: Optional[UserGcode] = None
    ) -> Optional[Result]:
        """Touch nozzle, switch and bed; return the result.

        None where switch - nozzle departs from earlier runs, and 'cleaner' can clean the
        nozzle, which may be why; without a cleaner they are not asked.
        """
        settings = run.settings
        if not settings.may_attach_late:
            # Nothing will attach it later: say so before anything is touched
            run.check_probe_attached()
        mark = self.datum.mark()
        run.nozzle = nozzle_z = run.touch_nozzle(cleaner)
        run.lift()
        self.progress.enter("before_switch_gcode")
        self.user_gcode.before_switch(mark)
        switch_z = run.touch_switch(nozzle_z)
        run.body = body = switch_z - nozzle_z
        if cleaner is not None and not run.is_another_probe(body):
            run.departure = self._departure(body)
            if run.departure and cleaner.can_clean and not run.cleaned:
                return None
        run.warn_of_body(body)
        probe_z = run.touch_bed(nozzle_z, switch_z)
        assert settings.switch_offset is not None
        return heights.result_of(
            probe_z, switch_z, nozzle_z, settings.switch_offset
        )

    def _departure(self, body: float) -> float:
        """Return by how much (mm) switch - nozzle departs from runs that were as hot."""
        now = run_log.temperatures(self.host, self.host.eventtime())
        return self.run_log.departure(body, self.host.tools.active(), now)

    ##################################################################
    # CALIBRATE_Z
    ##################################################################

    cmd_CALIBRATE_Z_help = "Measure nozzle, switch and bed, set the Z offset"

    def cmd_CALIBRATE_Z(self, gcmd: GCodeCommand) -> None:
        """Measure nozzle, switch and bed, and set the G-code Z offset."""
        self.check_idle(gcmd)
        self.results.note(None)
        self.refuse_during_a_print(gcmd, own=True)
        settings = with_touches(self.settings, gcmd)
        self._report_idle(gcmd, settings)
        accepts_change = options.param_flag(gcmd, "ACCEPT_CHANGE")
        self.begin_statistics(settings)
        expected = self.statistics.expected_touches
        wanted = 2 * expected(settings.on_pin) + expected(settings.on_bed)
        with self.running(gcmd, "start_gcode", wanted, has_error_gcode=True):
            settings = with_switch_offset(settings, gcmd)
            settings = with_extruder_temp(self.host, settings, gcmd)
            z_adjust: float = options.param_number(
                gcmd,
                "Z_ADJUST",
                0.0,
                minval=-LARGEST_ADJUST,
                maxval=LARGEST_ADJUST,
            )
            lift_speed = self.host.probing.sampling().lift_speed
            settings = with_pace(settings, *self.host.axes.z_pace(lift_speed))
            sites = SiteFinder(self.host, settings).of_command(gcmd)
            before = self.host.gcode_state.z_offset()
            last = self._measure_in_tries(
                settings, sites, z_adjust, accepts_change
            )
            self._check_offset_left(before)
            last = self._apply(last, before)
        earlier = self.results.last
        self.results.keep(last)
        self.in_force.begin()
        self._report(gcmd, last, earlier)
        self._keep(last)

    def _report_idle(self, gcmd: GCodeCommand, settings: Settings) -> None:
        """Show which parameters count for nothing, and a target that no run can keep."""
        for name in idle_params(settings, gcmd):
            self.progress.say(f"{name} is ignored with 'samples: auto'")
        text = impossible(settings.target, self.host.axes.z_step())
        if text and not self.settings.is_auto:
            # By SAMPLES=auto: nothing was said of it at start
            self.progress.say(text)

    def _measure_in_tries(
        self,
        settings: Settings,
        sites: Sites,
        z_adjust: float,
        accepts_change: bool,
    ) -> LastRun:
        """Measure, and where touches went wrong up to 'retries' times more; see _measure().

        Each try that failed is kept as refused.  end_gcode has put the probe away by then; one
        that is still attached ends the tries, and so does a print that was cancelled.
        """
        tries, number, dirt = settings.retries + 1, 1, ""
        print_state = self.host.print_state()
        while True:
            try:
                return self._measure(
                    settings, sites, z_adjust, accepts_change, dirt
                )
            except TouchedWrong as e:
                if number == tries or e.afterwards or not e.is_cleaned_up:
                    raise
                if self.host.print_state() != print_state:
                    raise
                # Before it is kept: its touches make the next try no noisier
                statistics, tried = self.new_statistics(settings), self.tried
                self._keep_refused(e)
                number += 1
                self.progress.say(f"{e}; try {number} of {tries} begins")
                self.progress.begin_again()
            self.begin_statistics(settings)
            self.statistics, self.tried = statistics, tried
            if self.user_gcode.can_clean:
                dirt = "the try before has failed"

    def _measure(
        self,
        settings: Settings,
        sites: Sites,
        z_adjust: float,
        accepts_change: bool,
        dirt: str,
    ) -> LastRun:
        """Measure all places, all of them once more after cleaning the nozzle.

        'dirt' is why it is cleaned before the first touch, empty: it is not.

        Returns the run, which is not applied yet.  end_gcode has run before: the way to the
        dock does not shift with the offset, and a probe that could not be docked leaves
        everything as it was.
        """
        last = None
        while last is None:
            # end_gcode of the first time may have restored that of before
            self.host.gcode_state.set_z_offset(0.0)
            run = self.new_run(settings, sites, self.statistics)
            with self.templates_around(run):
                self.note_oozing(run)
                earlier = Earlier() if accepts_change else self.earlier()
                nozzle, body = self.tried
                run.know(dataclasses.replace(earlier, nozzle=nozzle, body=body))
                # start_gcode may have fetched another tool, with an offset of its own
                self.host.gcode_state.set_z_offset(0.0)
                checks.check_carriages(self.host, settings)
                self.user_gcode.check_g92(UNDO_G92)
                try:
                    if dirt:
                        run.clean(self.user_gcode, dirt)
                    result = self.touch_all(run, self.user_gcode)
                finally:
                    self.cleaned = run.cleaned
                    # A try without a trigger leaves the heights of the one before it
                    self.tried = (
                        nozzle if run.nozzle is None else run.nozzle,
                        body if run.body is None else run.body,
                    )
                if result is not None:
                    last = self._last_run(run, result, z_adjust)
                    self.results.note(last)
                # Nor does one of the other templates count, which macros may set
                self.host.gcode_state.set_z_offset(0.0)
            if last is not None:
                last = last.replace(warnings=tuple(run.warnings))
            else:
                dirt = run.why_departed()
                self.progress.say(
                    f"{dirt}: cleaning the nozzle, then everything once more"
                )
                self.statistics = self.new_statistics(settings)
        command.check_homed(self.host, "end_gcode")
        if self.datum.moved_since(last.mark) == LEVELLED:
            raise CalibrationError(
                f"{LEVELLED} in end_gcode: the offset does not hold then; do it before"
                " CALIBRATE_Z"
            )
        return last

    def _last_run(
        self, run: CalibrationRun, result: Result, z_adjust: float
    ) -> LastRun:
        """Return what a run has measured; raises where the offset is outside its margins."""
        margins = run.settings.offset_margins
        heights.check_offset(result, margins, self.host.axes.z_zero())
        bed = run.sites.bed
        assert bed is not None
        last = LastRun(
            result=result,
            mark=self.datum.mark(),
            warnings=tuple(run.warnings),
            uncertainty=run.uncertainty(),
            z_adjust=z_adjust,
            point=SiteFinder(self.host, run.settings).bed_point(bed),
            twist=run.twist,
            extruder=self.host.tools.active(),
            proved_at=run.proved_at,
            unknown_shift=run.unknown_over_pin or 0.0,
            print_began=self.host.print_began(),
            tool_shift=sum(shift for _, shift in self.host.tools.of_changer()),
            growth=growth_of(run),
        )
        return last.replace(z_offset=Shifts(self.host, last).offset())

    def _check_offset_left(self, before: float) -> None:
        """Raise CalibrationError where end_gcode has left an offset of its own (mm).

        It may have restored a state, with the offset of before the run.
        """
        left = self.host.gcode_state.z_offset()
        if min(abs(left), abs(left - before)) <= SAME_OFFSET:
            return
        raise CalibrationError(
            f"end_gcode has left a G-code Z offset of {left:.6f}, and CALIBRATE_Z sets"
            " the one that it has measured; add what you want more by Z_ADJUST, or in"
            " offset_gcode"
        )

    def _apply(self, last: LastRun, before: float) -> LastRun:
        """Set the offset, and return the run with it; 'before' is that of before the run."""
        shifts = Shifts(self.host, last)
        z_offset = shifts.offset()
        for _, warned in shifts.lines():
            self.progress.say(warned.text)
        self.user_gcode.check_g92(
            "take it out of clean_gcode, before_switch_gcode or end_gcode"
        )
        # What the offset was made for; an offset_gcode may load a mesh, or clear it
        last = last.replace(
            z_offset=z_offset,
            height=height_of(self.host, last),
            guessed=self.host.transforms.is_mesh_guessed(*last.point),
            heat=self.host.transforms.heat_settings(),
            warnings=(*last.warnings, *shifts.warnings()),
        )
        # By less than G-code has digits it is seen whether offset_gcode sets it
        self.host.gcode_state.set_z_offset(UNSET, digits=10)
        marked = self.host.gcode_state.z_offset()
        is_kept = self.user_gcode.apply(z_offset)
        after = self.host.gcode_state.z_offset()
        if is_kept and after == marked:
            # For later
            self.host.gcode_state.set_z_offset(before)
            return last.replace(
                applied=z_offset, is_for_later=True, steps=Steps(z_offset)
            )
        if not is_kept and abs(after - z_offset) > SAME_OFFSET:
            raise CalibrationError(
                f"offset_gcode has left a G-code Z offset of {after:.6f} instead of"
                f" {z_offset:.6f}; check its macros for a misspelt name, or write"
                " Z_CALIBRATION_KEEP_OFFSET into one that makes another offset of"
                " it, or keeps it for later"
            )
        return last.replace(applied=after, steps=Steps(after))

    cmd_Z_CALIBRATION_KEEP_OFFSET_help = (
        "In offset_gcode: it keeps the offset, or makes another one of it"
    )

    def cmd_Z_CALIBRATION_KEEP_OFFSET(self, gcmd: GCodeCommand) -> None:
        """Say in offset_gcode that another offset than was measured is meant.

        Without it that is an error, as of a macro that is misspelt.
        """
        if not self.user_gcode.keep_offset():
            raise gcmd.error(
                f"{self.host.section}: Z_CALIBRATION_KEEP_OFFSET belongs into"
                " offset_gcode, or a macro that it runs"
            )

    def _report(
        self, gcmd: GCodeCommand, last: LastRun, earlier: Optional[LastRun]
    ) -> None:
        """Show the result."""
        result = last.result
        moved = self.datum.moved_since(last.mark)
        if moved:
            self.progress.say(
                f"{moved} after measuring, in end_gcode or offset_gcode: the offset"
                " holds no more"
            )
        gcmd.respond_info(
            f"Z-CALIBRATION: probe={result.probe:.3f} - (switch={result.switch:.3f} -"
            f" nozzle={result.nozzle:.3f} + switch_offset={result.switch_offset:.3f})"
            f" --> new offset={result.offset:.6f}"
        )
        text = f"offset {last.z_offset:.3f}"
        if last.uncertainty is not None:
            text += f" +-{last.uncertainty:.3f}"
        text += " mm"
        if last.z_adjust:
            text += f", with Z_ADJUST={last.z_adjust:.3f}"
        if last.growth:
            text += (
                f", with {last.grown:+.3f} mm as the nozzle prints at"
                f" {last.growth.printing:.0f} C and was touched at"
                f" {last.growth.touched:.0f} C"
            )
        elif self.settings.nozzle_growth:
            text += ", without nozzle_growth, as EXTRUDER_TEMP was not given"
        taken = result.offset + last.z_adjust + last.grown - last.z_offset
        if abs(taken) >= NO_CHANGE:
            text += f", {taken:.3f} mm taken off"
        gcmd.respond_info(f"Z-CALIBRATION: {text}")
        self._hint(gcmd, result.offset)
        reminder = switches.reminder(
            result.switch_offset,
            self.run_log.runs,
            earlier.result if earlier else None,
        )
        if reminder:
            self.progress.say(reminder)

    def _hint(self, gcmd: GCodeCommand, z_offset: float) -> None:
        """Show what makes a large offset (mm) smaller: once, until it is another one."""
        homed_z = self.settings.position_endstop
        if homed_z is None or abs(z_offset) <= LARGE_OFFSET:
            self.hinted = None
            return
        if self.hinted is not None and abs(z_offset - self.hinted) <= SAME_HINT:
            return
        self.hinted = z_offset
        if z_offset > 0.0:
            gcmd.respond_info(
                f"HINT: z position_endstop={homed_z:.3f} - offset={z_offset:.6f} -->"
                f" possible z position_endstop={homed_z - z_offset:.3f}"
            )
        else:
            # A number would bring the nozzle closer to a bed that only seems so low
            gcmd.respond_info(
                f"HINT: the bed is {-z_offset:.3f} mm lower than"
                f" position_endstop={homed_z:.3f} says; check that the plate is on and"
                " how the probe is seated"
            )

    def _keep_run(self, **fields: Any) -> None:
        """Keep the run under way in the history, refused without 'ok'.

        Whatever goes wrong with that ends no command, and hides no error.
        """
        try:
            run = self.run_log.measured(
                self.statistics, self.began, self.bed_spread
            )
            self.run_log.append(
                dataclasses.replace(run, cleaned=self.cleaned, **fields)
            )
        except Exception:
            logging.exception("z_calibration: this run is not kept")

    def _keep(self, last: LastRun) -> None:
        """Keep a good run in the history."""
        may_be_off = last.uncertainty
        self._keep_run(
            ok=True,
            offset=round(last.result.offset, 6),
            uncertainty=may_be_off and round(may_be_off, 6),
            switch_offset=last.result.switch_offset,
            z_adjust=last.z_adjust,
            nozzle_at=last.proved_at,
            warnings=last.warnings,
        )

    ##################################################################
    # CALIBRATE_Z_ACCURACY
    ##################################################################

    cmd_CALIBRATE_Z_ACCURACY_help = "Repeat whole calibrations, apply nothing"

    def cmd_CALIBRATE_Z_ACCURACY(self, gcmd: GCodeCommand) -> None:
        """Repeat whole calibrations, and show how their heights vary; apply nothing."""
        params = accuracy.cycle_params(gcmd)
        settings = accuracy.of_cycles(self.settings)
        self.check_idle(gcmd)
        self.refuse_during_a_print(gcmd, own=True)
        self.begin_statistics(settings)
        touches = 2 * settings.on_pin.samples + settings.on_bed.samples
        wanted = params.cycles * touches
        cycles: List[Cycle] = []
        with self.running(gcmd, "start_gcode", wanted, has_error_gcode=True):
            settings = with_switch_offset(settings, gcmd)
            sites = SiteFinder(self.host, settings).of_command(gcmd)
            with self.host.gcode_state.without_offset():
                while len(cycles) < params.cycles:
                    self._measure_cycles(settings, sites, params, cycles)
        self._report_cycles(gcmd, cycles, settings)
        self.report_process.judge_cycles()

    def _measure_cycles(
        self,
        settings: Settings,
        sites: Sites,
        params: accuracy.CycleParams,
        cycles: List[Cycle],
    ) -> None:
        """Measure one cycle, or with ATTACH=0 all of them, and add it to the others."""
        if params.home:
            self.user_gcode.check_homing()
            self.host.gcode.run_script_from_command("G28 Z")
        run = self.new_run(settings, sites, self.statistics, False)
        with self.templates_around(run):
            checks.check_carriages(self.host, settings)
            if not cycles:
                self.note_oozing(run)
            run.know(self.earlier())
            if not params.attach:
                self._check_stays_attached(run)
            for cycle in range(1 if params.attach else params.cycles):
                if cycle:
                    self.user_gcode.attach_again()
                result = self.touch_all(run)
                assert result is not None
                cycles.append(self._cycle())
                self.progress.say(
                    f"cycle {len(cycles)}: nozzle at z={result.nozzle:.3f}, switch at"
                    f" z={result.switch:.3f}, bed at z={result.probe:.3f},"
                    f" offset={result.offset:.3f}"
                )

    def _check_stays_attached(self, run: CalibrationRun) -> None:
        try:
            run.check_probe_attached()
        except CalibrationError:
            raise CalibrationError(
                "ATTACH=0 needs the probe on the toolhead all the time, and it is"
                " not attached; attach it in start_gcode, not in"
                " before_switch_gcode"
            )

    def _cycle(self) -> Cycle:
        """Return the touches of the cycle that has just ended."""
        nozzle, switch, bed = [
            tuple(round(z, 6) for z in self.statistics.samples[site])
            for site in SITES
        ]
        seconds = round(self.host.eventtime() - self.began, 2)
        return Cycle(seconds, nozzle, switch, bed)

    def _report_cycles(
        self, gcmd: GCodeCommand, cycles: List[Cycle], settings: Settings
    ) -> None:
        """Show the figures of all cycles, and keep them in the history."""
        step, switch_offset = self.statistics.step, settings.switch_offset
        assert switch_offset is not None
        seconds = cycles[-1].time / len(cycles)
        for line in accuracy.figures(cycles, switch_offset, step, seconds):
            gcmd.respond_info(f"CALIBRATE_Z_ACCURACY: {line}")
        of_cycles = offsets(cycles, switch_offset)
        self._keep_run(
            ok=True,
            offset=round(fmean(of_cycles), 6),
            uncertainty=round(uncertainty(of_cycles, step), 6),
            switch_offset=switch_offset,
            cycles=tuple(cycles),
            step=step,
        )

    ##################################################################
    # PROBE_Z_ACCURACY
    ##################################################################

    cmd_PROBE_Z_ACCURACY_help = "Touch the Z endstop with the nozzle repeatedly"

    def cmd_PROBE_Z_ACCURACY(self, gcmd: GCodeCommand) -> None:
        """Touch the pin with the nozzle repeatedly, and show how its height varies."""
        self.check_idle(gcmd)
        self.refuse_during_a_print(gcmd, own=True)
        with self.running(gcmd, "nozzle", 0, has_error_gcode=False):
            settings = accuracy.of_nozzle(self.settings, gcmd)
            with self.nozzle_run(gcmd, settings) as run:
                self._touch_repeatedly(gcmd, run)
        figures = accuracy_of(run.statistics.samples["nozzle"])
        gcmd.respond_info(
            f"probe z accuracy results: maximum {figures.maximum:.6f}, minimum"
            f" {figures.minimum:.6f}, range {figures.range:.6f}, average"
            f" {figures.average:.6f}, median {figures.median:.6f}, standard deviation"
            f" {figures.deviation:.6f}"
        )

    def _touch_repeatedly(
        self, gcmd: GCodeCommand, run: CalibrationRun
    ) -> None:
        """Touch the pin with the nozzle so often."""
        nozzle, sampling = run.sites.nozzle, run.settings.on_pin
        assert nozzle is not None
        gcmd.respond_info(
            f"PROBE_Z_ACCURACY at X:{nozzle.x:.3f} Y:{nozzle.y:.3f}"
            f" (samples={sampling.samples} retract={sampling.retract_dist:.3f}"
            f" speed={sampling.speed:.1f} lift_speed={sampling.lift_speed:.1f})"
        )
        self.progress.expect(sampling.samples)
        self.note_oozing(run)
        run.sample_nozzle()
