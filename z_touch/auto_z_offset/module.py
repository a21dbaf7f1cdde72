"""The object behind [auto_z_offset]: its commands and its status.

  settings   the options                      run       prepare, touch bed and probe
  heights    formula, expected, floors        sensor    the bed sensor
  expected   the correction, and what is      motors    current and acceleration of a touch
             known before a touch             shifts    what mesh and heat add
  checks     what the printer has to have     sites     where nozzle and probe stand
  twist      the probe's error along an axis

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
from typing import TYPE_CHECKING, Any, Dict, Iterator, List, Optional, Tuple

from .. import (
    __version__,
    attached,
    command,
    errors,
    options,
    touch,
    warming,
)
from ..errors import CalibrationError
from ..host import unknown_commands
from ..host.printer import Host
from ..host.toolhead import check_z_axis
from ..in_force import AppliedOffset
from ..progress import Notes
from ..sampling import Series, summarize
from ..texture import spread_tolerance
from ..warming import Warming
from . import checks, heights, shifts, twist
from .expected import Correction, Expectations
from .heights import Result
from .run import DIFFER, Run
from .sensor import BedSensor
from .settings import read_settings
from .sites import bed_site, probe_site

if TYPE_CHECKING:
    from ..host.klippy import Config, GCodeCommand, Handler
    from ..touch import Site
    from .settings import Settings


def formula(name: str, result: Result) -> str:
    """Return the numbers of one measurement, as the header of the door has them."""
    return (
        f"{name}: sensor={result.sensor:.3f} - (probe={result.probe:.3f} - probe"
        f" z_offset={result.probe_z_offset:.3f}) + z_offset={result.z_offset:.3f} -->"
        f" correction={result.correction:.6f}"
    )


class AutoZOffset:
    """The object behind [auto_z_offset].  Commands may pause, get_status() never does."""

    def __init__(self, config: Config):
        logging.info("auto_z_offset %s", __version__)
        self.host = Host(config)
        z_axis = check_z_axis(config, self.host.axes.z_axis)
        self.settings = read_settings(config, z_axis)
        # Of the section; printer and probe follow when klippy connects
        self.start_notes = list(self.settings.notes)
        self.notes = Notes(self.host, self._all_notes)
        self.sensor = BedSensor(config, self.host, self.settings.pin)
        self.correction = Correction(self.host, self.settings)
        self.expectations = Expectations(
            self.host, self.settings, self.correction
        )
        self.runner = command.Runner(self.host)
        self.progress = self.runner.watch
        attached.of(self.host.printer).watches.append(self.progress)
        # The G-code offset that was set last, and with which extruder
        self.applied = AppliedOffset(
            self.host,
            "AUTO_Z_LOAD_OFFSET",
            self.expectations.datum,
            self.expectations.moved_since,
        )
        self.applied_with = ""
        # Runs since klippy has started: the points of bed_spread are turned by it
        self.turn = 0
        # By how much the bed has moved in the last minute of AUTO_Z_WAIT (mm, up is
        # positive), None: not known
        self.movement: Optional[float] = None
        # Result of each cycle of the last command that measured both heights
        self.results: Tuple[Result, ...] = ()
        register = self.host.printer.register_event_handler
        register("klippy:connect", self.connect)
        # All sections have registered their commands then
        register("klippy:mcu_identify", self._watch_buttons)
        command.register_commands(self.host, self)

    ##################################################################
    # Set-up and status
    ##################################################################

    def connect(self) -> None:
        """Find probe and motors; a wrong set-up ends the start of klippy."""
        self.host.connect()
        try:
            checks.check_printer(self.host, self.settings)
        except CalibrationError as e:
            raise self.host.printer.config_error(str(e))
        self.sensor.connect()
        self.start_notes.append(self.correction.follow_probe())
        self.start_notes += checks.printer_notes(
            self.host, self.settings, self.sensor.motors
        )

    def _all_notes(self) -> List[str]:
        """Return what is told when klippy is ready: by then all commands are known, too."""
        unknown = unknown_commands.of(self.host.printer)
        notes = self.start_notes + unknown.notes(self.host.section)
        if self.correction.z is None:
            notes.append(checks.first_touch_note(self.host, self.settings))
        return notes

    def get_status(self, eventtime: float) -> Dict[str, Any]:
        """Return what macros and web interfaces read."""
        corrections = [result.correction for result in self.results]
        last = self.results[-1]._asdict() if self.results else {}
        spread = max(corrections) - min(corrections) if corrections else 0.0
        status: Dict[str, Any] = {
            "probe_z_correction": self.correction.z or 0.0,
            "last_z": self.expectations.sensor_z,
            "last_result": dict(last),
            "corrections": corrections,
            "spread": spread,
            "movement": self.movement,
            "notes": list(self.notes.texts),
        }
        status.update(self.progress.status())
        return status

    def _tell(self, text: str) -> None:
        """Show a line on the console; empty: nothing is to be told."""
        if text:
            self.host.say(text)

    ##################################################################
    # The buttons of the host, which know nothing of a correction
    ##################################################################

    def _watch_buttons(self) -> None:
        """Wrap them: nothing else tells that an offset is saved where it does not hold."""
        wrap = self.host.wrap_command
        wrap("Z_OFFSET_APPLY_PROBE", self._after_probe_button)
        wrap("Z_OFFSET_APPLY_ENDSTOP", self._after_endstop_button)
        self.applied.watch_states()

    def _after_probe_button(self, button: Handler, gcmd: GCodeCommand) -> None:
        button(gcmd)
        step = self._saved_step()
        if step is not None and abs(step) >= shifts.NO_SHIFT:
            self._tell(
                "Z_OFFSET_APPLY_PROBE moves the probe's Z=0, which"
                f" probe_z_correction is counted from: {step:.3f} mm of baby steps are"
                " gone after SAVE_CONFIG; run AUTO_Z_SAVE_GCODE_OFFSET, too"
            )

    def _after_endstop_button(
        self, button: Handler, gcmd: GCodeCommand
    ) -> None:
        button(gcmd)
        step = self._saved_step()
        if step is not None:
            self._tell(
                "Z_OFFSET_APPLY_ENDSTOP puts the correction into position_endstop:"
                " after SAVE_CONFIG a bed mesh of before makes the gap wrong by it, and"
                f" {step:.3f} mm of baby steps are gone; RESTART instead, and run"
                " AUTO_Z_SAVE_GCODE_OFFSET; or probe the mesh again"
            )

    def _saved_step(self) -> Optional[float]:
        """Return the baby steps (mm) in an offset that a button has saved; None: there is none.

        Tells what to do where Z is the bed sensor's.
        """
        z = self.host.gcode_state.z_offset()
        if not z:
            # The host saves nothing
            return None
        if self.expectations.was_sensor_frame():
            self._tell(
                f"AUTO_Z_HOME_Z sets Z anew, and the G-code Z offset of {z:.3f} has no"
                f" part in that; write z_offset: {self.settings.z_offset - z:.3f} into"
                f" section '{self.host.section}' for it"
            )
            return None
        return None if self.applied.z is None else z - self.applied.z

    ##################################################################
    # Around every command that touches
    ##################################################################

    @contextlib.contextmanager
    def measuring(
        self,
        gcmd: GCodeCommand,
        touches: int,
        with_probe: bool = False,
        settings: Optional[Settings] = None,
    ) -> Iterator[Run]:
        """Begin a command of so many touches; yields what touches.

        On any failure the toolhead is lifted, and nothing has changed.  'with_probe': that
        touches, too.  'settings' None: those of the section.
        """
        with self.runner.running(gcmd, "prepare_gcode", touches):
            accepts_change = options.param_flag(gcmd, "ACCEPT_CHANGE")
            self._check_may_measure()
            if with_probe:
                self._check_docks_by_itself()
            # What prepare_gcode takes for a height is one of the nozzle
            self._undo_g92()
            expectations = None if accepts_change else self.expectations
            run = Run(
                self.sensor,
                settings or self.settings,
                self.progress,
                expectations,
                self.turn,
            )
            self.turn += 1
            lifting = command.always(self.host, run.lift, "lifting")
            with self.expectations.learning(), lifting:
                yield run
            self.expectations.touched(run.sensor_z)

    def _undo_g92(self) -> None:
        self._tell(self.host.gcode_state.undo_g92())

    def _check_may_measure(self) -> None:
        """Raise CalibrationError where the nozzle must not go to the bed."""
        self._check_section()
        # Sensors that the original module powered in it would stay off
        if self.settings.lost_activate_gcode:
            raise CalibrationError(
                "activate_gcode is not run, the bed sensor may be off; move it"
                " into prepare_gcode"
            )
        command.check_no_print(self.host)
        command.check_no_manual_probe(self.host)
        # Before the toolhead moves: a hand may be near
        attached.of(self.host.printer).check_questions(self.host)
        command.check_homed(self.host)
        command.check_carriage_is_kept(self.host)

    def _check_section(self) -> None:
        """Raise CalibrationError for the section of the original module.

        A correction with the wrong sign of the air gap ends in the bed.
        """
        if self.settings.is_others:
            z_offset = self.settings.z_offset
            raise CalibrationError(
                "this section is that of the original module: it has"
                f" calibrated_z_offset, and 'z_offset: {z_offset:g}' as the Z of the"
                " trigger; here z_offset is the air gap, with the opposite sign; write"
                f" 'z_offset: {-z_offset:g}' and remove calibrated_z_offset, then"
                " RESTART and AUTO_Z_CALIBRATE"
            )

    def _check_docks_by_itself(self) -> None:
        """Raise CalibrationError where the probe would stay attached, or docked, all the time.

        The nozzle touches without it, and then it does.
        """
        carrier = attached.of(self.host.printer).carrier(self.host)
        if carrier is not None and not carrier.auto:
            raise CalibrationError(
                "auto_attach_detach is off, and both nozzle and probe have to"
                " touch; run SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=1 first"
            )

    ##################################################################
    # AUTO_Z_PROBE
    ##################################################################

    cmd_AUTO_Z_PROBE_help = (
        "Touch the bed with the nozzle where the toolhead is"
    )

    def cmd_AUTO_Z_PROBE(self, gcmd: GCodeCommand) -> None:
        """Touch the bed with the nozzle where the toolhead is."""
        with self.measuring(gcmd, self.settings.sampling.samples) as run:
            x, y = self.host.toolhead.get_position()[:2]
            run.prepare(touch.Site("bed", x, y, ""))
            z = run.touch_bed()
            run.check_left()
        gcmd.respond_info(
            f"AUTO_Z_PROBE: at X:{x:.3f} Y:{y:.3f} the bed sensor triggered at"
            f" z={z:.6f}"
        )

    ##################################################################
    # AUTO_Z_HOME_Z
    ##################################################################

    cmd_AUTO_Z_HOME_Z_help = "Set Z to z_offset where the bed sensor triggers"

    def cmd_AUTO_Z_HOME_Z(self, gcmd: GCodeCommand) -> None:
        """Set Z to z_offset where the bed sensor triggers."""
        z_offset = self.settings.z_offset
        with self.measuring(gcmd, self.settings.sampling.samples) as run:
            if not self.host.axes.z_datum():
                raise CalibrationError(
                    "the motors of Z move X or Y, too: on such a machine it is"
                    " not known later what Z was set to; home it with G28"
                )
            bed = bed_site(self.host, self.settings)
            run.prepare(bed, self.settings.bed_spread)
            self._check_gcode_offset()
            z = run.touch_bed()
            run.check_left()
            run.set_z(z)
            wrong = shifts.wrong_zero(self.host, bed, z_offset)
        self.expectations.homed_by_sensor()
        gcmd.respond_info(
            f"AUTO_Z_HOME_Z: the bed sensor triggered at z={z:.6f}, which is"
            f" z={z_offset:.6f} now"
        )
        self._tell(heights.inside_bed_after_homing(z_offset))
        self._tell(wrong)
        gcode_offset = self.host.gcode_state.z_offset()
        if gcode_offset:
            self._tell(
                f"the G-code Z offset of {gcode_offset:.3f} stays, on top of this"
            )

    def _check_gcode_offset(self) -> None:
        """Raise CalibrationError for one that was meant for the probe's Z=0.

        That is a correction above all.
        """
        gcode_offset = self.host.gcode_state.z_offset()
        z_offset = self.settings.z_offset
        if gcode_offset < 0.0 < z_offset - gcode_offset:
            raise CalibrationError(
                f"with the G-code Z offset of {gcode_offset:.3f} in force the nozzle"
                f" would be {z_offset - gcode_offset:.3f} mm inside the bed at Z=0; run"
                " SET_GCODE_OFFSET Z=0 first"
            )

    ##################################################################
    # AUTO_Z_MEASURE_OFFSET
    ##################################################################

    cmd_AUTO_Z_MEASURE_OFFSET_help = "Measure by how much the probe is wrong"

    def cmd_AUTO_Z_MEASURE_OFFSET(self, gcmd: GCodeCommand) -> None:
        """Measure by how much the probe is wrong; apply and save nothing."""
        touches = 2 * self.settings.sampling.samples
        with self.measuring(gcmd, touches, with_probe=True) as run:
            bed = bed_site(self.host, self.settings)
            run.prepare(bed, self.settings.bed_spread)
            result = run.cycle(probe_site(self.host, bed))
            self._tell(self.expectations.why_stale(result))
        self.results = (result,)
        gcmd.respond_info(formula("AUTO_Z_MEASURE_OFFSET", result))
        if self.correction.z is not None:
            self._tell(
                f"that is {result.correction - self.correction.z:+.3f} mm from the"
                f" probe_z_correction in force, {self.correction.z:.3f}"
            )
        self._tell(heights.inside_bed(result.z_offset))

    ##################################################################
    # AUTO_Z_CALIBRATE
    ##################################################################

    cmd_AUTO_Z_CALIBRATE_help = "Measure, apply and save the probe's correction"

    def cmd_AUTO_Z_CALIBRATE(self, gcmd: GCodeCommand) -> None:
        """Measure by how much the probe is wrong, apply that, and hand it to SAVE_CONFIG."""
        settings = self.settings
        touches = 2 * settings.sampling.samples * settings.offset_samples
        with self.measuring(gcmd, touches, with_probe=True) as run:
            bed = bed_site(self.host, settings)
            results = self._cycles_in_tries(run, bed)
            z = self._correction_of(results)
            # So that "move Z to 0, try a sheet of paper" is at this point
            run.go_to(bed)
            self._undo_g92()
            self._tell(shifts.wrong_gap(self.host, bed, results))
            self._apply_offset(z + self.host.probing.homed_bed_z())
        self.results = results
        self.correction.save(z)
        corrections = [result.correction for result in results]
        spread = max(corrections) - min(corrections)
        gcmd.respond_info(
            f"AUTO_Z_CALIBRATE: {settings.sampling.result} of {len(corrections)}, range"
            f" {spread:.6f}: probe_z_correction: {z:.6f}\n{options.SAVE_HINT}"
        )
        self._tell(heights.inside_bed(settings.z_offset))

    def _cycles_in_tries(self, run: Run, bed: Site) -> Tuple[Result, ...]:
        """Prepare, and return the results of all cycles; see _cycles().

        Where touches went wrong, all of that up to 'retries' times more.  Where nozzle and
        probe have agreed before, the bed is expected in the next try.
        """
        tries, number = self.settings.retries + 1, 1
        while True:
            run.prepare(bed, self.settings.bed_spread)
            # Here, as prepare_gcode may have homed
            self.expectations.check_frame()
            try:
                return self._cycles(run, bed)
            except errors.TouchedWrong as e:
                if number == tries:
                    raise
                number += 1
                self.progress.say(f"{e}; try {number} of {tries} begins")
                self.progress.begin_again()
            if run.agreed_z is not None:
                self.expectations.touched(run.agreed_z)

    def _cycles(self, run: Run, bed: Site) -> Tuple[Result, ...]:
        """Touch bed and probe over one point again and again; return the results that agree.

        Corrections are sampled as heights are, with a tolerance of their own.
        """
        settings = self.settings
        tolerance = spread_tolerance(
            settings.cycles_tolerance, settings.bed_spread
        )
        cycles = settings.sampling._replace(
            samples=settings.offset_samples, tolerance=tolerance
        )
        series = Series(cycles, DIFFER, "cycles_tolerance")
        results: List[Result] = []
        while not series.is_complete():
            result = run.cycle(probe_site(self.host, bed))
            stale = self.expectations.why_stale(result)
            if stale and self.host.axes.homes_with_probe():
                raise CalibrationError(stale)
            if stale:
                self.progress.say(stale)
            results.append(result)
            self.progress.say(formula("cycle", result))
            with errors.about("cycles", only=errors.SamplesDiffer):
                why_again = series.add(result.correction)
            if why_again:
                self.progress.say(f"cycles: {why_again}")
        return tuple(results[-len(series.samples) :])

    def _correction_of(self, results: Tuple[Result, ...]) -> float:
        """Return the correction of all cycles (mm), without outliers."""
        settings = self.settings
        corrections = [result.correction for result in results]
        # So far they may be apart and be all as good
        noise = spread_tolerance(
            settings.sampling.tolerance, settings.bed_spread
        )
        spread = max(corrections) - min(corrections)
        if spread > noise:
            self.progress.say(
                f"cycles: they differ by {spread:.4f} mm, and the touches of one by"
                f" {noise:.4f} at most: what is farther from the median is left out;"
                f" {DIFFER}"
            )
        counted = heights.without_outliers(corrections, noise)
        z = summarize(counted, settings.sampling.result)
        heights.check_correction(z)
        return z

    ##################################################################
    # AUTO_Z_WAIT
    ##################################################################

    cmd_AUTO_Z_WAIT_help = "Touch the bed each minute until it stands still"

    def cmd_AUTO_Z_WAIT(self, gcmd: GCodeCommand) -> None:
        """Touch the bed with the nozzle each minute until both stand still.

        Where they do not within MAX, that is shown, and a print goes on.
        """
        wanted = warming.wanted_of(gcmd)
        sampling = warming.sampling_of(
            self.settings.sampling, self.settings.sampling.tolerance
        )
        settings = dataclasses.replace(self.settings, sampling=sampling)
        touches = wanted.touches(sampling)
        with self.measuring(gcmd, touches, settings=settings) as run:
            bed = bed_site(self.host, settings)
            run.prepare(bed)
            seen = Warming(self.host, self.progress, wanted)
            while not seen.is_over():
                seen.wait()
                seen.add(run.touch_bed())
                self.movement = seen.movement
                run.check_left()
        gcmd.respond_info(f"AUTO_Z_WAIT: {seen.result()}")

    ##################################################################
    # AUTO_Z_TWIST
    ##################################################################

    cmd_AUTO_Z_TWIST_help = (
        "Measure the probe's error along X (AXIS=Y: along Y)"
    )

    def cmd_AUTO_Z_TWIST(self, gcmd: GCodeCommand) -> None:
        """Measure by how much the probe is wrong along an axis, and hand it to SAVE_CONFIG.

        As options of the host's axis_twist_compensation; correction and offset stay.
        """
        host, settings = self.host, twist.settings_of(self.settings)
        axis = twist.param_axis(gcmd)
        count = twist.param_count(gcmd)
        with host.as_command_error(gcmd):
            twist.check_host(host, axis)
            points = twist.points(host, settings, axis, count)
        touches = 2 * settings.sampling.samples * count
        with self.measuring(gcmd, touches, True, settings) as run:
            run.prepare(points[0], settings.bed_spread)
            corrections = []
            for number, bed in enumerate(points, 1):
                run.begin_at(bed)
                result = run.cycle(probe_site(host, bed))
                self.progress.say(formula(f"point {number} of {count}", result))
                corrections.append(result.correction)
            compensations = twist.compensations(corrections)
        saved = twist.save(host, axis, points, compensations)
        spread = max(corrections) - min(corrections)
        gcmd.respond_info(
            f"AUTO_Z_TWIST: the error of the probe differs by {spread:.3f} mm along"
            f" {axis}: {saved}\n{options.SAVE_HINT}"
        )
        self._tell(twist.AFTERWARDS)

    ##################################################################
    # Commands about the correction
    ##################################################################

    def _apply_offset(self, gcode_offset: float) -> None:
        """Set the G-code Z offset (mm)."""
        self.host.gcode_state.set_z_offset(gcode_offset)
        self._note_applied()

    def _note_applied(self) -> None:
        self.applied.note()
        self.applied_with = self.host.extruder()

    cmd_AUTO_Z_LOAD_OFFSET_help = "Apply the probe's correction"

    def cmd_AUTO_Z_LOAD_OFFSET(self, gcmd: GCodeCommand) -> None:
        """Set the probe's correction as the G-code Z offset."""
        with self.host.as_command_error(gcmd):
            self._check_section()
            self.expectations.check_frame()
        # It would shift what the offset makes right
        self._undo_g92()
        z = self.correction.z or 0.0
        bed_z = self.host.probing.homed_bed_z()
        self._apply_offset(z + bed_z)
        gcmd.respond_info(
            f"AUTO_Z_LOAD_OFFSET: probe_z_correction: {z:.6f}, the G-code Z offset is"
            f" {z + bed_z:.6f} now"
        )
        if bed_z:
            assert self.host.axes.z_axis is not None
            self._tell(
                f"{bed_z:.6f} more, as position_endstop of section"
                f" '{self.host.axes.z_axis.section}' and the probe's z_offset differ"
            )
        self._tell(self.expectations.levelled())
        self._tell(self.correction.unsure())
        self._tell(self.correction.other_heat())
        if self.host.transforms.mesh_heights() is not None:
            self._tell(shifts.wrong_mesh(self.host))
            self._tell(self._wrong_where_homed())
        if self.correction.z is None:
            self._tell(
                "there is no probe_z_correction yet; run AUTO_Z_CALIBRATE, then"
                " SAVE_CONFIG"
            )

    def _wrong_where_homed(self) -> str:
        """Return what the user is told of a mesh that is not zero where Z was homed."""
        homed = self.expectations.homed
        is_known = self.host.axes.homes_with_probe() and not homed.moved()
        if homed.at is None or not is_known:
            return ""
        return shifts.wrong_where_homed(self.host, homed.at)

    cmd_AUTO_Z_SAVE_GCODE_OFFSET_help = "Save the G-code Z offset in force"

    def cmd_AUTO_Z_SAVE_GCODE_OFFSET(self, gcmd: GCodeCommand) -> None:
        """Take the G-code Z offset in force, with its baby steps, for the correction."""
        before = self.correction.z or 0.0
        bed_z = self.host.probing.homed_bed_z()
        with self.host.as_command_error(gcmd):
            self.expectations.check_offset()
            z = self.host.gcode_state.z_offset() - bed_z
            self._check_savable(z)
            if not options.param_flag(gcmd, "FORCE"):
                self._check_steps(before + bed_z)
        self.correction.save(z)
        # Further steps count from here
        self._note_applied()
        gcmd.respond_info(
            f"AUTO_Z_SAVE_GCODE_OFFSET: probe_z_correction: {z:.6f} (was {before:.6f})\n"
            f"{options.SAVE_HINT}"
        )
        self._tell(self.expectations.levelled_steps())
        if abs(z - before) > heights.EXPECTED_MARGIN:
            self._tell(
                f"that is {abs(z - before):.3f} mm away from before; where Z was not"
                " homed with the probe, or AUTO_Z_LOAD_OFFSET not run after it, do both,"
                " then save again"
            )

    def _check_savable(self, z: float) -> None:
        """Raise CalibrationError for a correction (mm) that is none."""
        moved = self.host.gcode_state.moved_by_g92()
        if abs(moved) >= shifts.NO_SHIFT:
            # Baby steps may only have made good for it
            raise CalibrationError(
                f"G92 has moved Z=0 by {moved:.3f} mm, which is no part of the G-code"
                " offset; run AUTO_Z_LOAD_OFFSET, which undoes it, then move the"
                " nozzle in small steps"
            )
        # That is so of nan, too
        if not abs(z) <= heights.LARGEST_OFFSET:
            raise CalibrationError(
                f"a G-code Z offset of {z:.3f} is no correction of a probe; up to"
                f" {heights.LARGEST_OFFSET:g} mm can be saved; run AUTO_Z_LOAD_OFFSET,"
                " then move the nozzle in small steps"
            )

    def _check_steps(self, loaded: float) -> None:
        """Raise CalibrationError where the offset is not the correction with baby steps.

        'loaded' is what AUTO_Z_LOAD_OFFSET would set (mm).
        """
        active = self.host.extruder()
        if self.applied.z is not None and active != self.applied_with:
            # Its macros add what one tool differs from another by.
            raise CalibrationError(
                f"{active} is active, and the correction was applied with"
                f" {self.applied_with}: its macros may have changed the offset; activate"
                f" {self.applied_with} first, or add FORCE=1"
            )
        offset = self.host.gcode_state.z_offset()
        if self.correction.z is None:
            # There is nothing that steps count from
            heights.check_first(offset - loaded)
            return
        base = loaded if self.applied.z is None else self.applied.z
        heights.check_steps(offset, base)
