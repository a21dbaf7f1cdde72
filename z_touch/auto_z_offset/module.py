# The object behind [auto_z_offset]: commands, status, and how its parts are put
# together.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import functools
import logging

from .. import __version__, options
from .. import attached as carrying
from .. import command as running
from .. import in_force as restoring
from .. import progress as notes
from .. import touch as touching
from ..errors import CalibrationError
from ..host import unknown_commands
from ..host.printer import Host
from ..host.toolhead import check_z_axis
from . import checks, heights, shifts
from .cycles import Cycles, formula
from .expected import Correction, Expectations
from .measuring import BedSensor, Run
from .settings import read_settings, settings_notes
from .sites import bed_site, probe_site


# The object behind [auto_z_offset].
class AutoZOffset:
    def __init__(self, config):
        logging.info("auto_z_offset %s", __version__)
        self.printer = config.get_printer()
        self.host = Host(config)
        check_z_axis(config, self.host.axes.z_axis)
        self.settings = read_settings(config, self.host.axes.z_axis)
        # Of the section; printer and probe follow when klippy connects
        self.start_notes = settings_notes(self.settings)
        self.notes = notes.Notes(self.host, self.all_notes)
        self.sensor = BedSensor(config, self.host, self.settings.pin)
        self.correction = Correction(self.host, self.settings)
        self.expectations = Expectations(
            self.host, self.settings, self.correction
        )
        self.runner = running.Runner(self.host)
        carrying.of(self.host.printer).watches.append(self.runner.watch)
        # The G-code offset (mm) that was set last, and with which extruder; None: not
        # since klippy has started
        self.applied = self.applied_with = None
        # Result of each cycle of the last command that measured both heights
        self.results = ()
        register = self.printer.register_event_handler
        register("klippy:connect", self.connect)
        # All sections have registered their commands then
        register("klippy:mcu_identify", self.watch_buttons)
        running.register_commands(self.host, self)

    ##################################################################
    # Set-up
    ##################################################################

    def connect(self):
        self.host.connect()
        try:
            checks.check_printer(self.host, self.settings)
        except CalibrationError as e:
            raise self.printer.config_error(str(e))
        self.sensor.connect()
        self.start_notes.append(self.correction.follow_probe())
        self.start_notes += checks.printer_notes(
            self.host, self.settings, self.sensor.motors
        )

    # What is told when klippy is ready: by then all commands are known, too
    def all_notes(self):
        unknown = unknown_commands.of(self.printer)
        notes = self.start_notes + unknown.notes(self.host.section)
        if self.correction.z is None:
            notes.append(checks.first_touch_note(self.host, self.settings))
        return notes

    # The buttons of the host, which know nothing of a correction
    def watch_buttons(self):
        for button, says in (
            ("Z_OFFSET_APPLY_PROBE", self.of_probe_button),
            ("Z_OFFSET_APPLY_ENDSTOP", self.of_endstop_button),
        ):
            after = functools.partial(self.after_button, says)
            self.host.wrap_command(button, after)
        restoring.watch(self.host, "AUTO_Z_LOAD_OFFSET", lambda: self.applied)

    def after_button(self, says, command, gcmd):
        command(gcmd)
        z = self.host.gcode_state.z_offset()
        if not z:
            # The host saves nothing
            return
        if self.expectations.was_sensor_frame():
            self.tell(self.of_sensor(z))
        elif self.applied is not None:
            self.tell(says(z - self.applied))

    def of_sensor(self, z):
        return (
            "AUTO_Z_HOME_Z sets Z anew, and the G-code Z offset of %.3f has no part"
            " in that; write z_offset: %.3f into section '%s' for it"
            % (z, self.settings.z_offset - z, self.host.section)
        )

    def of_probe_button(self, step):
        if abs(step) < shifts.NO_SHIFT:
            return ""
        return (
            "Z_OFFSET_APPLY_PROBE moves the probe's Z=0, which"
            " probe_z_correction is counted from: %.3f mm of baby steps are"
            " gone after SAVE_CONFIG; run AUTO_Z_SAVE_GCODE_OFFSET, too"
            % (step,)
        )

    def of_endstop_button(self, step):
        return (
            "Z_OFFSET_APPLY_ENDSTOP puts the correction into position_endstop:"
            " after SAVE_CONFIG a bed mesh of before makes the gap wrong by it, and"
            " %.3f mm of baby steps are gone; RESTART instead, and run"
            " AUTO_Z_SAVE_GCODE_OFFSET; or probe the mesh again" % (step,)
        )

    # Empty: nothing is to be told
    def tell(self, text):
        if text:
            self.host.say(text)

    ##################################################################
    # Status
    ##################################################################

    def get_status(self, eventtime):
        corrections = [result.correction for result in self.results]
        last = self.results[-1]._asdict() if self.results else {}
        spread = max(corrections) - min(corrections) if corrections else 0.0
        status = {
            "probe_z_correction": self.correction.z or 0.0,
            "last_z": self.expectations.sensor_z,
            "last_result": dict(last),
            "corrections": corrections,
            "spread": spread,
            "notes": list(self.notes.texts),
        }
        status.update(self.runner.watch.status())
        return status

    ##################################################################
    # Commands that measure
    ##################################################################

    # Runs what a command does with the machine: 'work' gets a Run and returns
    # what the command stores or says.  On any failure the head is lifted, and
    # nothing has changed.  'with_probe': it touches, too.
    def measure(self, gcmd, touches, work, with_probe=False):
        begin = functools.partial(self.begin, gcmd, work, with_probe)
        return self.runner.run(gcmd, begin, "prepare_gcode", touches)

    def begin(self, gcmd, work, with_probe):
        accepts_change = options.param_int(
            gcmd, "ACCEPT_CHANGE", 0, minval=0, maxval=1
        )
        self.check_may_measure()
        if with_probe:
            self.check_both()
        # What prepare_gcode takes for a height is one of the nozzle
        self.undo_g92()
        expectations = None if accepts_change else self.expectations
        watch = self.runner.watch
        run = Run(self.sensor, self.settings, watch, expectations)
        with running.always(self.host, run.travel.lift, "lifting"):
            value = work(run)
        self.expectations.touched(run.bed.sensor_z)
        return value

    def undo_g92(self):
        self.tell(self.host.gcode_state.undo_g92())

    def check_may_measure(self):
        self.check_section()
        # Sensors that the original module powered in it would stay off
        if self.settings.lost_activate_gcode:
            raise CalibrationError(
                "activate_gcode is not run, the bed sensor may be off; move it"
                " into prepare_gcode"
            )
        running.check_no_pause(self.host)
        running.check_no_manual_probe(self.host)
        # Before the head moves: a hand may be near
        carrying.of(self.printer).check_questions(self.host)
        running.check_homed(self.host)

    # A correction with the wrong sign of the air gap ends in the bed.
    def check_section(self):
        if self.settings.is_others:
            z_offset = self.settings.z_offset
            raise CalibrationError(
                "this section is that of the original module: it has"
                " calibrated_z_offset, and 'z_offset: %g' as the Z of the"
                " trigger; here z_offset is the air gap, with the opposite"
                " sign; write 'z_offset: %g' and remove calibrated_z_offset,"
                " then RESTART and AUTO_Z_CALIBRATE" % (z_offset, -z_offset)
            )

    # The nozzle touches without the probe, and then the probe
    def check_both(self):
        carrier = carrying.of(self.printer).carrier(self.host)
        if carrier is not None and not carrier.auto:
            raise CalibrationError(
                "auto_attach_detach is off, and both nozzle and probe have to"
                " touch; run SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=1 first"
            )

    # AUTO_Z_PROBE
    cmd_AUTO_Z_PROBE_help = "Touch the bed with the nozzle where the head is"

    def cmd_AUTO_Z_PROBE(self, gcmd):
        touches = self.settings.sampling.samples
        x, y, z = self.measure(gcmd, touches, self.probe_here)
        gcmd.respond_info(
            "AUTO_Z_PROBE: at X:%.3f Y:%.3f the bed sensor triggered at"
            " z=%.6f" % (x, y, z)
        )

    def probe_here(self, run):
        x, y = self.host.toolhead.get_position()[:2]
        run.prepare(touching.Site("bed", x, y, ""))
        return x, y, run.measure_sensor_alone()

    # AUTO_Z_HOME_Z
    cmd_AUTO_Z_HOME_Z_help = "Set Z to z_offset where the bed sensor triggers"

    def cmd_AUTO_Z_HOME_Z(self, gcmd):
        touches = self.settings.sampling.samples
        z, wrong = self.measure(gcmd, touches, self.home_z)
        self.expectations.homed_by_sensor()
        z_offset = self.settings.z_offset
        gcmd.respond_info(
            "AUTO_Z_HOME_Z: the bed sensor triggered at z=%.6f, which is"
            " z=%.6f now" % (z, z_offset)
        )
        self.tell(heights.inside_bed_after_homing(z_offset))
        self.tell(wrong)
        gcode_offset = self.host.gcode_state.z_offset()
        if gcode_offset:
            text = "the G-code Z offset of %.3f stays, on top of this"
            self.tell(text % (gcode_offset,))

    def home_z(self, run):
        if not self.host.axes.z_datum():
            raise CalibrationError(
                "the motors of Z move X or Y, too: on such a machine nobody"
                " would know later what Z was set to; home it with G28"
            )
        bed = bed_site(self.host, self.settings)
        run.prepare(bed, self.settings.bed_spread)
        self.check_gcode_offset()
        z = run.measure_sensor_alone()
        run.set_z(z)
        return z, shifts.wrong_zero(self.host, bed, self.settings.z_offset)

    # One that was meant for the probe's Z, a correction above all
    def check_gcode_offset(self):
        gcode_offset = self.host.gcode_state.z_offset()
        z_offset = self.settings.z_offset
        if gcode_offset < 0.0 < z_offset - gcode_offset:
            raise CalibrationError(
                "with the G-code Z offset of %.3f in force the nozzle would be"
                " %.3f mm inside the bed at Z=0; run SET_GCODE_OFFSET Z=0 first"
                % (gcode_offset, z_offset - gcode_offset)
            )

    # AUTO_Z_MEASURE_OFFSET
    cmd_AUTO_Z_MEASURE_OFFSET_help = "Measure by how much the probe is wrong"

    def cmd_AUTO_Z_MEASURE_OFFSET(self, gcmd):
        touches = 2 * self.settings.sampling.samples
        result = self.measure(gcmd, touches, self.measure_once, with_probe=True)
        self.results = (result,)
        gcmd.respond_info(formula("AUTO_Z_MEASURE_OFFSET", result))
        self.tell(heights.inside_bed(result.z_offset))

    def measure_once(self, run):
        bed = bed_site(self.host, self.settings)
        run.prepare(bed, self.settings.bed_spread)
        result = run.measure(probe_site(self.host, bed))
        self.tell(self.expectations.why_stale(result))
        return result

    # AUTO_Z_CALIBRATE
    cmd_AUTO_Z_CALIBRATE_help = "Measure, apply and save the probe's correction"

    def cmd_AUTO_Z_CALIBRATE(self, gcmd):
        settings = self.settings
        touches = 2 * settings.sampling.samples * settings.offset_samples
        self.results, z = self.measure(
            gcmd, touches, self.calibrate, with_probe=True
        )
        self.correction.save(z)
        corrections = [result.correction for result in self.results]
        gcmd.respond_info(
            "AUTO_Z_CALIBRATE: %s of %d, range %.6f: probe_z_correction:"
            " %.6f\n%s"
            % (
                settings.sampling.result,
                len(corrections),
                max(corrections) - min(corrections),
                z,
                options.SAVE_HINT,
            )
        )
        self.tell(heights.inside_bed(settings.z_offset))

    def calibrate(self, run):
        bed = bed_site(self.host, self.settings)
        run.prepare(bed, self.settings.bed_spread)
        # Here, as prepare_gcode may have homed
        self.expectations.check_frame()
        cycles = Cycles(run, self.settings, self.expectations, bed)
        results, z = cycles.measure()
        # So that "move Z to 0, try a sheet of paper" is at this point
        run.travel.go_to(bed)
        self.undo_g92()
        self.tell(shifts.wrong_gap(self.host, bed, results))
        self.apply_offset(z + self.host.probing.homed_bed_z())
        return results, z

    ##################################################################
    # Commands about the correction
    ##################################################################

    # As a user would: a macro of that name takes part
    def apply_offset(self, gcode_offset):
        script = "SET_GCODE_OFFSET Z=%.6f MOVE=0" % (gcode_offset,)
        self.host.gcode.run_script_from_command(script)
        self.note_applied()

    def note_applied(self):
        self.applied = self.host.gcode_state.z_offset()
        self.applied_with = self.host.extruder()

    # Raises the error of a command, with what 'check' says
    def check(self, check):
        try:
            check()
        except CalibrationError as e:
            raise self.host.error(str(e))

    # AUTO_Z_LOAD_OFFSET
    cmd_AUTO_Z_LOAD_OFFSET_help = "Apply the probe's correction"

    def cmd_AUTO_Z_LOAD_OFFSET(self, gcmd):
        self.check(self.check_section)
        self.check(self.expectations.check_frame)
        # It would shift what the offset makes right
        self.undo_g92()
        z = self.correction.z or 0.0
        bed_z = self.host.probing.homed_bed_z()
        self.apply_offset(z + bed_z)
        gcmd.respond_info(
            "AUTO_Z_LOAD_OFFSET: probe_z_correction: %.6f, the G-code Z offset"
            " is %.6f now" % (z, z + bed_z)
        )
        if bed_z:
            self.tell(
                "%.6f more, as position_endstop of section '%s' and the"
                " probe's z_offset differ"
                % (bed_z, self.host.axes.z_axis.section)
            )
        self.tell(self.expectations.levelled())
        self.tell(self.correction.unsure())
        if self.host.transforms.mesh_heights() is not None:
            self.tell(shifts.wrong_mesh(self.host))
        if self.correction.z is None:
            self.tell(
                "there is no probe_z_correction yet; run AUTO_Z_CALIBRATE, then"
                " SAVE_CONFIG"
            )

    # AUTO_Z_SAVE_GCODE_OFFSET
    cmd_AUTO_Z_SAVE_GCODE_OFFSET_help = "Save the G-code Z offset in force"

    def cmd_AUTO_Z_SAVE_GCODE_OFFSET(self, gcmd):
        self.check(self.expectations.check_offset)
        moved = self.host.gcode_state.moved_by_g92()
        if abs(moved) >= shifts.NO_SHIFT:
            # Baby steps may only have made good for it
            raise self.host.error(
                "G92 has moved Z=0 by %.3f mm, which is no part of the G-code"
                " offset; run AUTO_Z_LOAD_OFFSET, which undoes it, then move the"
                " nozzle in small steps" % (moved,)
            )
        before = self.correction.z or 0.0
        bed_z = self.host.probing.homed_bed_z()
        z = self.host.gcode_state.z_offset() - bed_z
        if abs(z) > heights.LARGEST_OFFSET:
            raise self.host.error(
                "a G-code Z offset of %.3f is no correction of a probe; up to"
                " %g mm can be saved; run AUTO_Z_LOAD_OFFSET, then move the"
                " nozzle in small steps" % (z, heights.LARGEST_OFFSET)
            )
        force = options.param_int(gcmd, "FORCE", 0, minval=0, maxval=1)
        if not force:
            self.check(functools.partial(self.check_steps, before + bed_z))
        self.correction.save(z)
        # Further steps count from here
        self.note_applied()
        gcmd.respond_info(
            "AUTO_Z_SAVE_GCODE_OFFSET: probe_z_correction: %.6f (was %.6f)\n%s"
            % (z, before, options.SAVE_HINT)
        )
        self.tell(self.expectations.levelled_steps())
        if abs(z - before) > heights.EXPECTED_MARGIN:
            self.tell(
                "that is %.3f mm away from before; where Z was not homed with"
                " the probe, or AUTO_Z_LOAD_OFFSET not run after it, do both,"
                " then save again" % (abs(z - before),)
            )

    # 'loaded': what AUTO_Z_LOAD_OFFSET would set, mm
    def check_steps(self, loaded):
        active = self.host.extruder()
        if self.applied is not None and active != self.applied_with:
            # Its macros add what one tool differs from another by.
            raise CalibrationError(
                "%s is active, and the correction was applied with %s: what the"
                " offset differs by is no baby step; activate %s first, or add"
                " FORCE=1" % (active, self.applied_with, self.applied_with)
            )
        if self.correction.z is None:
            # There is nothing that steps count from
            heights.check_first(self.host.gcode_state.z_offset() - loaded)
            return
        base = loaded if self.applied is None else self.applied
        heights.check_steps(self.host.gcode_state.z_offset(), base)
