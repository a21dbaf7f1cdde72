# The object behind [z_calibration]: its commands, its status, and what they are
# made of.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#   settings      what the user configured
#   pin, sites    what is touched, and where the head stands for it
#   calibration   one run: nozzle, switch, bed
#   expected      what earlier runs say to it
#   hooks         the user's G-code around it
#   shifts        what Klipper's own features add to Z where the bed was measured
#   results       the last run that was applied, and whether it holds
#   interface     what the guide and the corrections may ask of all that
#   corrections   baby steps back into switch_offset
#   switches      what common ones have as switch_offset, at least
#   accuracy      how often to touch where the spread is the question
#   recorder      the history of all runs

import contextlib
import functools
import logging

from .. import __version__
from ..core import (
    carrying,
    errors,
    frame,
    notes,
    options,
    restoring,
    running,
    sampling,
)
from ..core.axes import check_z_axis
from ..core.host import Host
from ..history import recorder
from . import accuracy, checks, corrections, heights, pace, switches
from .calibration import Calibration
from .expected import NOTHING_EARLIER, Earlier
from .hooks import MOVED_IN_END, Hooks
from .interface import Interface
from .measuring import Run
from .pin import find_pin, read_pin
from .results import NOTHING, Results, height_of
from .settings import (
    complete,
    idle_params,
    param_accept_change,
    param_plate,
    param_switch_offset,
    param_touches,
    param_verbose,
    read_settings,
)
from .shifts import Shifts
from .sites import SiteFinder, Sites

# Less (mm) is rounding.
NO_CHANGE = 0.0000001

# How far (mm) last_z_offset may be rounded by an end_gcode that applies it itself
OWN_DIGITS = 0.0006

# What a plate or a material may need (mm) on top of what was measured
LARGEST_ADJUST = 0.5

# An offset of more than this (mm) is worth correcting in position_endstop.
LARGE_OFFSET = 0.2

# One that differs by no more (mm) from that of the last hint is not worth another
SAME_HINT = 0.05


# Whether end_gcode has set the offset itself, perhaps with something more, rather than
# what is to be added to it: a Z that is large, and nearer to it than to 0
def is_own(added, z_offset, is_set_anew):
    is_large = is_set_anew and abs(added) > LARGE_OFFSET
    apart = abs(added - z_offset)
    return apart <= OWN_DIGITS or (is_large and apart < abs(added))


# The object behind [z_calibration]
class ZCalibration:
    def __init__(self, config):
        logging.info("z_calibration %s", __version__)
        self.host = Host(config)
        check_z_axis(config, self.host.axes.z_axis)
        self.frame = frame.Frame(self.host)
        # There the pin is where Z was homed on it
        self.homed = frame.HomedFrame(self.frame)
        self.runner = running.Runner(self.host)
        carrying.of(self.host.printer).watches.append(self.runner.watch)
        old_names = options.OldNames(config)
        self.settings = read_settings(config, self.host.axes.z_axis, old_names)
        # None: the Z endstop, which exists when klippy connects
        self.pin = read_pin(config, self.host, old_names)
        self.recorder = recorder.Recorder(
            self.host, self.settings, __version__, self.history_read
        )
        self.hooks = Hooks(
            self.host, self.settings, self.frame, self.runner.watch
        )
        self.results = Results(self.host, self.frame)
        read_notes = functools.partial(self.start_notes, old_names)
        self.notes = notes.Notes(self.host, read_notes)
        register = self.host.printer.register_event_handler
        register("klippy:connect", self.connect)
        # All sections have registered their commands then
        register("klippy:mcu_identify", self.watch_offset)
        running.register_commands(self.host, self)
        running.register_commands(self.host, self.recorder)
        # A SET_GCODE_OFFSET with Z has run since end_gcode began
        self.is_set_anew = False
        # The offset (mm) that the user was last hinted at; None: not
        self.hinted = None
        # The run that is under way believes no heights of earlier runs
        self.accepts_change = False
        # For the guide and the corrections
        self.interface = Interface(self)
        corrections.Corrections(self.interface)

    ##################################################################
    # Set-up and status
    ##################################################################

    # A wrong set-up ends the start of klippy
    def connect(self):
        host = self.host
        host.connect()
        if self.pin is None:
            self.pin = find_pin(host)
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
        except errors.CalibrationError as e:
            raise host.printer.config_error(str(e))

    # Who sets the offset to something else than it is, in a macro, too
    def watch_offset(self):
        self.host.wrap_command("SET_GCODE_OFFSET", self.around_offset)

    def around_offset(self, command, gcmd):
        self.is_set_anew |= gcmd.get("Z", None) is not None
        command(gcmd)

    # What the user is told when klippy is ready
    def start_notes(self, old_names):
        return old_names.notes + list(checks.notes(self.host, self.settings))

    # The runs of before are known: how low the first one may go
    def history_read(self):
        if self.recorder.last_good() is None:
            note = checks.margins_note(self.settings)
            self.notes.add([note] if note else [])

    def get_status(self, eventtime):
        status = self.results.status()
        status["history"] = self.recorder.status()
        status["notes"] = list(self.notes.texts)
        status.update(self.runner.watch.status())
        return status

    # From now on (mm)
    def use_switch_offset(self, switch_offset):
        self.settings = self.settings._replace(switch_offset=switch_offset)

    ##################################################################
    # One run
    ##################################################################

    # A Calibration; 'plan': adaptive.Plan of its touches; 'tells': each place is told
    # when it is done
    def new_calibration(self, settings, sites, plan, tells=True):
        watch, nozzle_at = self.runner.watch, self.recorder.nozzle_at()
        if nozzle_at is not None:
            self.pin.places.note(*nozzle_at)
        run = Run(self.host, settings, self.pin, plan, watch, self.homed, tells)
        return Calibration(run, sites)

    # A site, as X and Y (mm), if the probe was on the head there; None: it may meet the
    # bed
    def nozzle_at(self, site):
        is_met = self.pin.places.is_met_at(site.x, site.y)
        return (site.x, site.y) if is_met else None

    # Returns what work() does, see running.Runner.  G-code has the same modes in each
    # template and afterwards.
    def run(self, gcmd, work, phase, wanted, failed=None):
        # A template of a run that is under way must not end what that keeps
        self.runner.check_idle(gcmd)
        self.check_nobody_asked(gcmd)
        try:
            with self.hooks.keeping_modes():
                return self.runner.run(gcmd, work, phase, wanted, failed)
        finally:
            self.runner.watch.be_verbose(False)

    # Before anything moves, templates included: of a run that has not begun neither
    # end_gcode nor error_gcode has to undo anything.  'own': what begins is no part of
    # the set-up, which may have its sheet of paper on the bed.
    def check_nobody_asked(self, gcmd, own=False):
        try:
            running.check_no_pause(self.host)
            running.check_no_manual_probe(self.host)
            carrying.of(self.host.printer).check_questions(self.host, own)
        except errors.CalibrationError as e:
            raise gcmd.error("%s: %s" % (self.host.section, e))

    # Runs a command that applies nothing: its templates meet no G-code offset, and
    # what they make of it is undone.  See running.Runner for what it is given.
    def run_without_offset(self, gcmd, work, phase, wanted, failed=None):
        def work_without():
            with self.host.features.without_offset():
                return work()

        return self.run(gcmd, work_without, phase, wanted, failed)

    # What is around the touches of a run.  'departure': by how much (mm) a
    # switch - nozzle departs from earlier runs; None: they are not asked
    @contextlib.contextmanager
    def prepared(self, calibration, departure=None):
        self.hooks.check_before_start()
        dock = running.always(self.host, self.put_away, "end_gcode")
        lift = running.always(self.host, calibration.lift, "lifting")
        with dock, lift:
            self.hooks.start()
            with self.hooks.holding_probe():
                calibration.know(self.earlier(departure))
                yield

    # After the last touch, and after a failure
    def put_away(self):
        self.runner.watch.enter("end_gcode")
        self.hooks.end()

    # What the next run knows before it begins
    def earlier(self, departure=None):
        if self.accepts_change:
            return NOTHING_EARLIER._replace(departure=departure)
        last, holds = self.results.earlier(self.host.extruder())
        good = self.recorder.last_good()
        kept = None if good is None else heights.kept_of(**good)
        return Earlier(last, holds, departure, kept)

    # Returns the heights.Result, None where the nozzle is dirty.  'why': it was found
    # to be so, and is cleaned first.
    def measure(self, calibration, clean=None, why=""):
        mark = self.frame.mark()
        attach = functools.partial(self.hooks.before_switch, mark)
        return calibration.measure(attach, clean, why)

    def clean_nozzle(self, why):
        self.recorder.note_cleaning(why)
        self.hooks.clean()

    # Of CALIBRATE_Z and CALIBRATE_Z_ACCURACY; 'error' is what they end with
    def failed(self, error):
        self.recorder.refused(error)
        measured = self.results.measured
        self.results.note(None)
        if measured is not None:
            text = "the measured offset %.6f was not applied"
            self.runner.watch.say(text % (measured.result.offset,))
        self.hooks.failed(error)

    ##################################################################
    # CALIBRATE_Z
    ##################################################################

    cmd_CALIBRATE_Z_help = "Measure nozzle, switch and bed, set the Z offset"

    def cmd_CALIBRATE_Z(self, gcmd):
        self.runner.check_idle(gcmd)
        self.results.begin()
        self.check_nobody_asked(gcmd, own=True)
        try:
            checks.check_tool_offset(self.host)
        except errors.CalibrationError as e:
            raise gcmd.error("%s: %s" % (self.host.section, e))
        settings = param_touches(gcmd, self.settings)
        for name in idle_params(gcmd, settings):
            text = "%s is ignored with 'samples: auto'"
            self.runner.watch.say(text % (name,))
        plan = self.recorder.begin(
            settings.counting, settings.bed_spread, param_plate(gcmd)
        )
        impossible = settings.counting.impossible(plan.step)
        if impossible and settings.counting is not self.settings.counting:
            # By SAMPLES=auto: nothing was said of it at start
            self.runner.watch.say(impossible)
        wanted = 2 * plan.expected(settings.pin) + plan.expected(settings.probe)
        work = functools.partial(self.calibrate_and_apply, gcmd, settings)
        accepts_change = param_accept_change(gcmd)
        self.runner.watch.be_verbose(param_verbose(gcmd))
        self.accepts_change = accepts_change
        try:
            last = self.run(gcmd, work, "start_gcode", wanted, self.failed)
        finally:
            self.results.note(None)
            self.accepts_change = False
        before = self.results.last.result
        self.results.keep(last)
        self.report(gcmd, last)
        self.remind(last.result.switch_offset, before)
        self.recorder.good(last)

    # Returns the results.Last
    def calibrate_and_apply(self, gcmd, settings):
        features = self.host.features
        with features.without_offset():
            last, added = self.calibrate(gcmd, settings)
        shifts = Shifts(self.host, last)
        z_offset = shifts.offset()
        if is_own(added, z_offset, self.is_set_anew):
            # end_gcode has applied last_z_offset by itself
            added -= z_offset
            added = added if abs(added) > OWN_DIGITS else 0.0
        for _, told in shifts.lines():
            self.runner.watch.say(told.text)
        self.hooks.undo_g92()
        # What the offset was made for; an offset_gcode may load a mesh, or clear it
        height = height_of(self.host, last)
        is_guessed = features.is_mesh_guessed(*last.point)
        applied = self.apply(z_offset + added)
        if abs(added) >= NO_CHANGE:
            text = "end_gcode changed the G-code Z offset by %.6f: it is %.6f"
            self.runner.watch.say(text % (added, z_offset + added))
        return last._replace(
            z_offset=z_offset + added,
            applied=applied,
            height=height,
            guessed=is_guessed,
            heat=features.heat_settings(),
            states=restoring.saved(self.host),
            warnings=last.warnings + shifts.warnings(),
        )

    # Returns the G-code offset (mm) that came of it.  An offset_gcode begins with 0, so
    # that it is seen whether it sets anything.
    def apply(self, z_offset):
        before = self.host.gcode_offset.z()
        self.host.gcode_offset.replace(0.0)
        self.is_set_anew = False
        is_kept = self.hooks.apply(z_offset)
        after = self.host.gcode_offset.z()
        if not is_kept and abs(after - z_offset) > OWN_DIGITS:
            raise errors.CalibrationError(
                "offset_gcode has left a G-code Z offset of %.6f instead of %.6f;"
                " check its macros for a misspelt name, or write"
                " Z_CALIBRATION_KEEP_OFFSET into one that makes another offset of"
                " it, or keeps it for later" % (after, z_offset)
            )
        if is_kept and not (after or self.is_set_anew):
            self.host.gcode_offset.replace(before)
            return z_offset
        return after

    cmd_Z_CALIBRATION_KEEP_OFFSET_help = (
        "In offset_gcode: it keeps the offset, or makes another one of it"
    )

    # Without it an offset_gcode that sets another offset than was measured, or none
    # as its macro is misspelt, is an error.
    def cmd_Z_CALIBRATION_KEEP_OFFSET(self, gcmd):
        if not self.hooks.keep_offset():
            raise gcmd.error(
                "%s: Z_CALIBRATION_KEEP_OFFSET belongs into offset_gcode, or a"
                " macro that it runs" % (self.host.section,)
            )

    # Returns the results.Last, not applied yet, and what end_gcode has added to the
    # G-code offset (mm).  That runs before the offset is applied: the way to the
    # dock does not shift with the offset, and a probe that could not be put away
    # leaves everything as it was.
    def calibrate(self, gcmd, settings):
        settings = settings._replace(
            switch_offset=param_switch_offset(gcmd, settings.switch_offset)
        )
        z_adjust = options.param_number(
            gcmd, "Z_ADJUST", 0.0, minval=-LARGEST_ADJUST, maxval=LARGEST_ADJUST
        )
        lift_speed = self.host.probing.sampling().lift_speed
        settings = pace.of_run(settings, *self.host.axes.z_pace(lift_speed))
        finder = SiteFinder(self.host, settings)
        sites, before = finder.of_command(gcmd), self.host.gcode_offset.z()
        calibration = self.new_calibration(settings, sites, self.recorder.plan)
        calibrated = self.calibrate_once(calibration, finder, z_adjust)
        if calibrated is None:
            why = calibration.geometry.dirt()
            text = "%s: cleaning the nozzle, then everything once more"
            self.runner.watch.say(text % (why,))
            self.host.gcode_offset.replace(before)
            plan = self.recorder.begin_again()
            calibration = self.new_calibration(settings, sites, plan)
            calibrated = self.calibrate_once(calibration, finder, z_adjust, why)
        return calibrated

    # Measures all sites once.  None where the nozzle has to be cleaned first; the
    # probe is put away then.
    def calibrate_once(self, calibration, finder, z_adjust, why=""):
        clean = self.clean_nozzle if self.hooks.can_clean else None
        with self.prepared(calibration, self.recorder.departure):
            # start_gcode may have fetched another tool
            checks.check_tool_offset(self.host)
            result = self.measure(calibration, clean, why)
            if result is None:
                return None
            last = NOTHING._replace(
                result=result,
                mark=self.frame.mark(),
                warnings=calibration.run.warnings,
                uncertainty=calibration.uncertainty(),
                z_adjust=z_adjust,
                nozzle_at=self.nozzle_at(calibration.sites.nozzle),
                point=finder.bed_point(calibration.sites.bed),
                twist=calibration.run.twist,
                extruder=self.host.extruder(),
            )
            margins = calibration.settings.offset_margins
            heights.check_offset(result, margins, self.host.axes.z_zero())
            z_offset = Shifts(self.host, last).offset()
            self.results.note(last._replace(z_offset=z_offset))
            at_end = self.host.gcode_offset.z()
            self.is_set_anew = False
        added = self.host.gcode_offset.z() - at_end
        running.check_homed(self.host)
        if self.frame.moved_since(last.mark) == frame.LEVELLED:
            raise errors.CalibrationError(MOVED_IN_END % (frame.LEVELLED,))
        return last, added

    # What the user is told at the end
    def report(self, gcmd, last):
        result = last.result
        moved = self.results.why_outdated()
        if moved:
            self.runner.watch.say(
                "%s after measuring, in end_gcode or offset_gcode: the offset"
                " holds no more" % (moved,)
            )
        gcmd.respond_info(
            "Z-CALIBRATION: probe=%.3f - (switch=%.3f - nozzle=%.3f"
            " + switch_offset=%.3f) --> new offset=%.6f" % result
        )
        if last.uncertainty is not None:
            gcmd.respond_info(
                "Z-CALIBRATION: --> new offset=%.6f +-%.3f"
                % (result.offset, last.uncertainty)
            )
        if last.z_adjust:
            gcmd.respond_info(
                "Z-CALIBRATION: with Z_ADJUST=%.3f the offset is %.6f"
                % (last.z_adjust, result.offset + last.z_adjust)
            )
        if abs(last.z_offset - result.offset - last.z_adjust) >= NO_CHANGE:
            text = "Z-CALIBRATION: --> G-code Z offset %.6f"
            gcmd.respond_info(text % (last.z_offset,))
        self.hint(gcmd, result.offset)

    # What makes a large offset (mm) smaller: once, until it is another one
    def hint(self, gcmd, z_offset):
        homed_z = self.settings.position_endstop
        if homed_z is None or abs(z_offset) <= LARGE_OFFSET:
            self.hinted = None
            return
        before, self.hinted = self.hinted, z_offset
        if before is not None and abs(z_offset - before) <= SAME_HINT:
            self.hinted = before
        elif z_offset > 0.0:
            gcmd.respond_info(
                "HINT: z position_endstop=%.3f - offset=%.6f --> possible z"
                " position_endstop=%.3f"
                % (homed_z, z_offset, homed_z - z_offset)
            )
        else:
            # A number would bring the nozzle closer to a bed that only seems so low
            gcmd.respond_info(
                "HINT: the bed is %.3f mm lower than position_endstop=%.3f says;"
                " check that the plate is on and how the probe is seated"
                % (-z_offset, homed_z)
            )

    # Of a switch_offset that the set-up has taken from a list
    def remind(self, switch_offset, before):
        runs = self.recorder.runs()
        text = switches.reminder(switch_offset, runs, before)
        if text:
            self.runner.watch.say(text)

    ##################################################################
    # CALIBRATE_Z_ACCURACY
    ##################################################################

    cmd_CALIBRATE_Z_ACCURACY_help = "Repeat whole calibrations, apply nothing"

    def cmd_CALIBRATE_Z_ACCURACY(self, gcmd):
        params = accuracy.CycleParams(gcmd, self.settings)
        work = functools.partial(self.measure_cycles, gcmd, params)
        self.runner.check_idle(gcmd)
        self.check_nobody_asked(gcmd, own=True)
        self.runner.watch.be_verbose(param_verbose(gcmd))
        self.recorder.begin(params.settings.counting)
        cycles = self.run_without_offset(
            gcmd, work, "start_gcode", params.touches(), self.failed
        )
        self.recorder.tell_cycles(gcmd, cycles)

    # Returns a cycles.Cycle for each
    def measure_cycles(self, gcmd, params):
        settings = params.with_switch_offset(gcmd)
        sites = SiteFinder(self.host, settings).of_command(gcmd)
        cycles = []
        while len(cycles) < params.cycles:
            if params.home:
                self.hooks.attachment.check_homing(self.host.axes)
                self.host.gcode.run_script_from_command("G28 Z")
            plan = self.recorder.plan
            calibration = self.new_calibration(settings, sites, plan, False)
            with self.prepared(calibration):
                if not params.attach:
                    self.check_stays_attached(calibration)
                for _ in range(1 if params.attach else params.cycles):
                    result = self.measure(calibration)
                    cycles.append(self.recorder.cycle(settings.switch_offset))
                    self.runner.watch.say(
                        "cycle %d: nozzle at z=%.3f, switch at z=%.3f, bed at"
                        " z=%.3f, offset=%.3f"
                        % (
                            len(cycles),
                            result.nozzle,
                            result.switch,
                            result.probe,
                            result.offset,
                        )
                    )
        return cycles

    def check_stays_attached(self, calibration):
        try:
            calibration.check_probe_attached()
        except errors.CalibrationError:
            raise errors.CalibrationError(
                "ATTACH=0 needs the probe on the head all the time, and it is"
                " not attached; attach it in start_gcode, not in"
                " before_switch_gcode"
            )

    ##################################################################
    # PROBE_Z_ACCURACY
    ##################################################################

    cmd_PROBE_Z_ACCURACY_help = "Touch the Z endstop with the nozzle repeatedly"

    def cmd_PROBE_Z_ACCURACY(self, gcmd):
        work = functools.partial(self.measure_accuracy, gcmd)
        self.runner.check_idle(gcmd)
        self.check_nobody_asked(gcmd, own=True)
        self.runner.watch.be_verbose(param_verbose(gcmd))
        samples = self.run_without_offset(gcmd, work, "nozzle", 0)
        gcmd.respond_info(
            "probe z accuracy results: maximum %.6f, minimum %.6f, range"
            " %.6f, average %.6f, median %.6f, standard deviation %.6f"
            % sampling.accuracy(samples)
        )

    # Returns the heights of the samples (mm)
    def measure_accuracy(self, gcmd):
        settings = accuracy.for_nozzle(gcmd, self.settings)
        nozzle = SiteFinder(self.host, settings).nozzle_of_command(gcmd)
        running.check_homed(self.host)
        self.hooks.attachment.begin()
        self.hooks.attachment.free_nozzle()
        plan = self.recorder.make_plan(settings.counting)
        sites = Sites(nozzle, None, None)
        calibration = self.new_calibration(settings, sites, plan, False)
        calibration.know(self.earlier())
        gcmd.respond_info(
            "PROBE_Z_ACCURACY at X:%(x).3f Y:%(y).3f (samples=%(samples)d"
            " retract=%(retract_dist).3f speed=%(speed).1f"
            " lift_speed=%(lift_speed).1f)"
            % dict(settings.pin._asdict(), x=nozzle.x, y=nozzle.y)
        )
        self.runner.watch.expect(settings.pin.samples)
        with running.always(self.host, calibration.lift, "lifting"):
            return calibration.sample_nozzle()
