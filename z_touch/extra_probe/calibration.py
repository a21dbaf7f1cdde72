# EXTRA_PROBE_CALIBRATE: travel and ask, touch and ask again, apply.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections
import functools

from .. import attached as carrying
from .. import command as running
from .. import dialog, options
from .. import pin as z_pin
from .. import touch as touching
from ..datum import Datum, HomedDatum
from ..errors import CalibrationError
from ..sampling import summarize
from . import heights
from .finger import TRIGGERED, Finger
from .shifts import Shifts
from .switches import LOWER_FLOOR, TOO_LOW, Series

TRAVEL_SPEED = 50.0  # mm/s, in XY
SAME_POSITION = 0.1  # mm; a head further from where it was has been moved
SOFT_TEMPERATURE = 60.0  # C; here the plastic of a membrane begins to melt

# Without SAVE, with what has moved Z
UNTIL_HOMED = "%s: the offset will be right until the next G28 only."

# What waits for an answer: 'asks' for the "switch", or, with the height 'bed_z'
# that was measured, for its "removal".  'floor' and 'save' are those of the
# command, 'mark', 'xy' (mm) and 'extruder' where the head was when it began, and
# whose nozzle was active.
Question = collections.namedtuple(
    "Question", "floor save mark xy extruder asks bed_z"
)


# The commands of a calibration, and the question that is open between them.
# 'switch' is what lies on the bed, 'runner' runs one command at a time, 'pin' is
# where Z is homed, see z_pin.
class Calibration:
    def __init__(self, host, runner, name, switch, pin):
        self.host = host
        self.runner = runner
        # Complete from connect() on
        self.settings = None
        self.switch = switch
        self.pin = pin
        self.frame = Datum(host)
        # What is saved counts from there on
        self.homed = HomedDatum(self.frame)
        command = "EXTRA_PROBE_%s PROBE=" + name
        self.dialog = dialog.Dialog(host, runner.watch.say, command)
        self.finger = Finger(host, switch, runner.watch.say)
        # Of the last one that was applied or saved; None: there is none
        self.last_offset = None
        running.register_commands(host, self, name)

    def connect(self, settings):
        self.settings = settings

    # The question that is open, in one word; empty: there is none
    def waits_for(self):
        return self.dialog.waits_for()

    # Raises CalibrationError while it is open.  Whoever prints has cleared the bed:
    # an answer comes no more.
    def check_answered(self):
        if self.waits_for() and not self.host.print_state():
            raise CalibrationError(
                "EXTRA_PROBE_CALIBRATE waits for an answer, and somebody's hand"
                " may be near; answer with %s, or %s"
                % (self.dialog.go_on, self.dialog.abort)
            )

    def run(self, gcmd, step, *args):
        work = functools.partial(step, gcmd, *args)
        self.runner.run(gcmd, work, "touch", 0)

    ##################################################################
    # The beginning: travel, and ask for the switch
    ##################################################################

    cmd_EXTRA_PROBE_CALIBRATE_help = "Set the Z offset with a switch on the bed"

    def cmd_EXTRA_PROBE_CALIBRATE(self, gcmd):
        self.finger.end()
        self.dialog.close()
        self.run(gcmd, self.begin)

    def begin(self, gcmd):
        save = options.param_int(gcmd, "SAVE", 0, minval=0, maxval=1)
        floor_param = options.param_number(gcmd, "FLOOR")
        self.check_printer()
        self.check_settings(save)
        warnings = self.check_temperature() + self.look_at_probe()
        # Before a hand comes near: later nothing drives to a dock by itself
        self.free_nozzle(goes_on=self.settings.xy_position is not None)
        self.travel()
        self.stand_still()
        floor, says = self.floor(floor_param)
        xy = self.host.toolhead.get_position()[:2]
        mark = self.frame.mark()
        tool = self.host.extruder()
        question = Question(floor, save, mark, xy, tool, "switch", None)
        sentences = ["Flat on the bed, the nozzle clean."] + warnings + says
        self.dialog.ask(question, "Lay the switch below the nozzle", sentences)
        if not self.is_bed_known(floor_param):
            self.finger.watch()

    def check_settings(self, save):
        if not self.settings.z_offset:
            raise CalibrationError(
                "z_offset is 0; set it to the thickness of the switch, in mm"
            )
        if save and self.host.axes.z_zero() is None:
            raise CalibrationError(
                "SAVE=1: nobody knows where Z gets its zero with '%s'; leave"
                " SAVE out" % (self.host.axes.z_axis.endstop_pin,)
            )
        moved = self.homed.moved()
        if save and moved:
            raise CalibrationError(
                "SAVE=1: %s, and what is saved counts from G28 on; run G28"
                " first, or leave SAVE out where that levels after homing Z"
                % (moved,)
            )

    def travel(self):
        settings, site = self.settings, self.settings.xy_position
        speed = settings.sampling.lift_speed
        touching.raise_to(self.host, settings.safe_z_height, speed)
        if site is not None:
            everything = carrying.of(self.host.printer)
            everything.go_to(self.host, site.x, site.y, TRAVEL_SPEED)

    # The lowest point of the touches, and what the user is told of it
    def floor(self, floor_param):
        settings, z_zero = self.settings, self.host.axes.z_zero()
        axis_min = self.host.axes.z_axis.position_min
        floor = heights.floor(
            settings,
            z_zero,
            axis_min,
            floor_param,
            is_proved=True,
            moved_by=self.homed.moved_by(),
        )
        pin_z = z_pin.floor(self.host, self.pin)
        floor = heights.above_pin(floor, pin_z)
        moved = self.homed.moved()
        says = []
        if moved:
            says.append(UNTIL_HOMED % (moved[0].upper() + moved[1:],))
        lowers = (
            "Continue lowers the nozzle; without a trigger it stops at z=%.3f."
        )
        if not self.is_bed_known(floor_param):
            says.append("Press it once with a finger: Continue waits for it.")
            lowers = (
                "Continue lowers the nozzle; without a trigger it stops at"
                " z=%.3f; no saved calibration holds, so that may be in the bed;"
                " watch, ready to stop."
            )
        if pin_z is not None:
            says.append("The head is over the pin of the Z endstop; move it.")
        says.append(lowers % (floor,))
        return floor, says

    # Whether somebody has said how low a touch may go, or a calibration was saved
    def is_bed_known(self, floor_param):
        settings = self.settings
        is_given = not (floor_param is None and settings.position_min is None)
        return is_given or heights.is_calibrated(
            settings, self.host.axes.z_zero(), self.homed.moved_by()
        )

    ##################################################################
    # The answers
    ##################################################################

    cmd_EXTRA_PROBE_ABORT_help = "End a calibration, everything as before"

    def cmd_EXTRA_PROBE_ABORT(self, gcmd):
        self.finger.end()
        self.dialog.answered(gcmd)
        self.runner.watch.say("the calibration ends, nothing was changed")

    cmd_EXTRA_PROBE_CONTINUE_help = "Go on with a calibration"

    # The question stays until the switch was pressed, unless that is in vain.
    def cmd_EXTRA_PROBE_CONTINUE(self, gcmd):
        self.dialog.check_asked(gcmd)
        try:
            self.finger.check()
        except CalibrationError as e:
            if self.is_open(self.dialog.question):
                raise gcmd.error("%s: %s" % (self.host.section, e))
        self.finger.end()
        question = self.dialog.continued(gcmd)
        step = self.touch if question.bed_z is None else self.apply
        self.run(gcmd, step, question)

    ##################################################################
    # The switch is there: touch it, and ask for its removal
    ##################################################################

    def touch(self, gcmd, question):
        self.check_frame(question)
        self.check_place(question)
        for warning in self.check_temperature():
            self.runner.watch.say(warning)
        # Meanwhile somebody may have fetched it again
        self.free_nozzle()
        self.come_down()
        trigger_z = self.measure(gcmd, question)
        bed_z = heights.bed_height(trigger_z, self.settings.z_offset)
        if question.save:
            self.corrected_zero(bed_z - self.shifts(question, bed_z).height())
        self.stand_still()
        sentences = [
            "Triggered at z=%.3f, so the bed is at z=%.3f."
            % (trigger_z, bed_z),
            "Continue makes that Z=0.",
        ]
        if heights.is_low(bed_z):
            sentences.append(
                "That is low; check that the switch is z_offset=%.3f mm thick."
                % (self.settings.z_offset,)
            )
        question = question._replace(asks="removal", bed_z=bed_z)
        self.dialog.ask(question, "Take the switch away", sentences)

    def free_nozzle(self, goes_on=False):
        everything = carrying.of(self.host.printer)
        everything.check_questions(self.host)
        if self.switch.is_below_nozzle:
            everything.free_nozzle(self.host, goes_on=goes_on)

    # To where the touches begin, with the switch watched on the way
    def come_down(self):
        host, sampling = self.host, self.settings.sampling
        safe_z, speed = self.settings.safe_z_height, sampling.lift_speed
        touching.raise_to(host, safe_z, speed)
        endstop = self.switch.endstop()
        if endstop.query_endstop(host.after_moves()):
            raise CalibrationError(TRIGGERED % (self.switch.query,))
        head = touching.Head(host, sampling, TOO_LOW)
        head.come_down(endstop, safe_z, speed)
        head.retract()

    # The toolhead Z (mm) at which the switch triggers
    def measure(self, gcmd, question):
        sampling = self.settings.sampling
        series = Series(
            self.host, self.switch, sampling, gcmd.respond_info, LOWER_FLOOR
        )
        triggers = series.measure(question.floor)
        self.check_frame(question)
        return summarize(triggers, sampling.result)

    ##################################################################
    # The switch is gone: apply what was measured, or hand it over
    ##################################################################

    def apply(self, gcmd, question):
        self.check_frame(question)
        bed_z, z_offset = question.bed_z, self.settings.z_offset
        shifts = self.shifts(question, bed_z)
        offset = bed_z - shifts.height()
        if question.save:
            self.save(gcmd, question, offset)
        say = self.runner.watch.say
        # It would shift what the offset makes right
        undone = self.host.gcode_state.undo_g92()
        if undone:
            say(undone)
        self.host.gcode_state.set_z_offset(0.0 if question.save else offset)
        self.last_offset = offset
        say(
            "trigger=%.6f - z_offset=%.3f --> new offset=%.6f"
            % (bed_z + z_offset, z_offset, bed_z)
        )
        for text in shifts.lines(offset):
            say(text)

    # Where the switch lies: shifts.Shifts
    def shifts(self, question, bed_z):
        point = tuple(question.xy) + (bed_z,)
        return Shifts(self.host, point, question.save)

    # What SAVE_CONFIG is to write
    def corrected_zero(self, bed_z):
        axis_limits = self.host.axes.limits()[2]
        return heights.corrected_zero(
            self.host.axes.z_zero(), bed_z, axis_limits
        )

    # 'offset' is what Z is to be lower by; with the whole of bed_z the bed would be
    # at Z=0, and that is what later floors count from.
    def save(self, gcmd, question, offset):
        section, option, z = self.corrected_zero(offset)
        text = "%.3f" % (z,)
        printer = self.host.printer
        options.save(printer, section, option, text)
        saved_z = "%.3f" % (z + offset - question.bed_z,)
        options.save(printer, self.host.section, "saved_homing_z", saved_z)
        gcmd.respond_info(
            "%s: %s: %s\n%s\nUntil then the G-code offset is 0."
            % (section, option, text, options.SAVE_HINT)
        )

    ##################################################################
    # What has to be so, before and after
    ##################################################################

    def check_printer(self):
        print_state = self.host.print_state()
        if print_state:
            raise CalibrationError(
                "a print is under way (%s); end it first" % (print_state,)
            )
        if dialog.is_paused(self.host):
            raise CalibrationError(dialog.PAUSED)
        running.check_no_manual_probe(self.host)
        running.check_homed(self.host)

    # Of a [probe] that macros fetch only the switch tells, where it is wired as
    # [z_calibration] needs it.  Returns warnings.
    def look_at_probe(self):
        printer = self.host.printer
        endstop = self.host.probing.endstop()
        is_wired = printer.lookup_object("z_calibration", None) is not None
        is_plain = carrying.of(printer).carrier(self.host) is None
        if not (is_wired and is_plain and endstop is not None):
            return []
        if endstop.query_endstop(self.host.after_moves()):
            return []
        return ["The probe reads open, as on the head; put it away first."]

    # Returns warnings
    def check_temperature(self):
        temperature = self.host.nozzle_temperature()
        limit = self.settings.max_temperature
        if temperature > limit:
            raise CalibrationError(
                "the nozzle has, or is to have, %.0f C, max_temperature is"
                " %.0f C; let it cool down" % (temperature, limit)
            )
        if temperature <= SOFT_TEMPERATURE:
            return []
        return [
            "The nozzle has, or is to have, %.0f C: a membrane may melt."
            % (temperature,)
        ]

    # Heights of another frame say nothing
    def check_frame(self, question):
        self.check_printer()
        self.check_unchanged(self.frame.moved_since(question.mark))
        if self.host.extruder() != question.extruder:
            self.check_unchanged("another extruder is active")

    # Whether an answer can lead on
    def is_open(self, question):
        try:
            self.check_frame(question)
        except CalibrationError:
            return False
        return True

    # Whoever has moved the head may have moved it off the switch
    def check_place(self, question):
        here = zip(self.host.toolhead.get_position(), question.xy)
        if max(abs(a - b) for a, b in here) > SAME_POSITION:
            self.check_unchanged("the head was moved")

    # 'what' has happened while the user was asked; empty: nothing
    def check_unchanged(self, what):
        if what:
            raise CalibrationError(
                "%s since the calibration began; begin again" % (what,)
            )

    # Before a hand comes near
    def stand_still(self):
        self.host.toolhead.wait_moves()
        if self.host.printer.is_shutdown():
            raise CalibrationError("ended by a shutdown of the printer")
