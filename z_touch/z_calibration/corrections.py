# How switch_offset is corrected: by baby steps, or by where the nozzle was moved
# to.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# A larger switch_offset moves the nozzle closer to the bed, a larger G-code
# offset moves it away:
#
#   new switch_offset = old - change of the G-code offset

import collections
import functools

from ..core import frame, options, restoring, running, saving
from ..core.baby_steps import LARGEST_STEP, NO_STEP
from ..core.errors import CalibrationError
from .settings import param_switch_offset

# What the web interfaces send when their user saves the Z offset
BUTTONS = ("Z_OFFSET_APPLY_ENDSTOP", "Z_OFFSET_APPLY_PROBE")

######################################################################
# Maths
######################################################################

# What baby steps are counted from: the G-code offset that CALIBRATE_Z, or a
# correction since, has left, and the switch_offset that belongs to it (mm)
Base = collections.namedtuple("Base", "offset switch_offset")


# The height (toolhead Z, mm) that the user has moved the nozzle's Z=0 to is the
# offset that is right; what it differs by from z_offset belongs to switch_offset.
def corrected_switch_offset(switch_offset, z, z_offset):
    return switch_offset - (z - z_offset)


# Returns the new switch_offset (mm), and how it was calculated.  'z_offset': the
# G-code offset (mm) with the baby steps; 'force': an unlikely one is right.
# Raises CalibrationError.
def check_steps(base, z_offset, force):
    change = z_offset - base.offset
    new = corrected_switch_offset(base.switch_offset, z_offset, base.offset)
    text = (
        "switch_offset=%.3f - (G-code offset=%.3f - %.3f of CALIBRATE_Z)"
        " --> new switch_offset=%.3f" % (base[1], z_offset, base[0], new)
    )
    if new < 0.0:
        raise CalibrationError(
            "%s, which cannot be negative: the pin does not press the switch"
            " body, or the G-code offset is none of CALIBRATE_Z; check"
            " switch_xy_position, then run CALIBRATE_Z again" % (text,)
        )
    if force:
        return new, text
    if not z_offset:
        raise CalibrationError(
            "the G-code offset is 0, not that of CALIBRATE_Z with baby steps:"
            " something has reset it; set it again with SET_GCODE_OFFSET, or"
            " add FORCE=1 if 0 is right"
        )
    if abs(change) > LARGEST_STEP:
        raise CalibrationError(
            "%s: a change of more than %g mm is none of baby steps; check the"
            " probe, or add FORCE=1" % (text, LARGEST_STEP)
        )
    return new, text


######################################################################
# Commands and buttons
######################################################################


# The commands that correct switch_offset, and the buttons that may do so.
class Corrections:
    # 'section': interface.Interface
    def __init__(self, section):
        self.section = section
        self.host = section.host
        self.saver = saving.Saver(section.host)
        self.hinted = False
        # A switch_offset that counts, and was not handed to SAVE_CONFIG
        self.unsaved = None
        register = self.host.printer.register_event_handler
        # The G-code offsets (mm) that saved states have brought back since the
        # results.Last of 'restored_since', by their names
        self.restored, self.restored_since = {}, None
        register("klippy:connect", self.take_buttons)
        register("klippy:mcu_identify", self.watch_states)
        running.register_commands(self.host, self)

    # The commands of the host: whoever sends them is asked first
    def take_buttons(self):
        gcode = self.host.gcode
        for name in BUTTONS:
            handler = gcode.register_command(name, None)
            if handler is not None:
                press = functools.partial(self.press, name, handler)
                text = gcode.gcode_help.get(name)
                gcode.register_command(name, press, desc=text)

    def watch_states(self):
        restoring.watch(
            self.host, "CALIBRATE_Z", self.applied, self.note_restored
        )

    # What the last run has applied (mm), None: there was none, or Z was homed since
    def applied(self):
        return None if self.why_not() else self.section.last().applied

    # One that was saved since has the baby steps of then.
    def note_restored(self, name, z_offset):
        last = self.section.last()
        if last.states.get(name) is not restoring.saved(self.host)[name]:
            return
        if self.restored_since is not last:
            self.restored, self.restored_since = {}, last
        self.restored[name] = z_offset

    # A button was pressed; 'handler' is the host's own command
    def press(self, name, handler, gcmd):
        reason, keeps = self.why_not(), self.section.settings().save_button
        if keeps and not reason:
            self.answer(gcmd, self.save_steps, True, False)
            return
        change = self.host.gcode_offset.z() - self.current().offset
        handler(gcmd)
        if keeps:
            text = (
                "%s: %s: %s saves as ever, and nothing goes into switch_offset;"
                " next time save as long as the result of CALIBRATE_Z holds"
            )
            gcmd.respond_info(text % (self.host.section, reason, name))
        elif self.hinted or reason or self.other_tool():
            return
        elif abs(change) > NO_STEP:
            self.hinted = True
            gcmd.respond_info(
                "%s: CALIBRATE_Z measures anew what %s saves: the baby step of"
                " %.3f is gone then; keep it with"
                " Z_CALIBRATION_SAVE_GCODE_OFFSET, or with this button and"
                " 'save_button: switch_offset' in section '%s'"
                % (self.host.section, name, change, self.host.section)
            )

    # Calls work(gcmd, *args); what a CalibrationError says becomes the error of the
    # command.
    def answer(self, gcmd, work, *args):
        self.section.check_idle(gcmd)
        try:
            work(gcmd, *args)
        except CalibrationError as e:
            raise gcmd.error("z_calibration: %s" % (e,))

    # Why there is nothing that baby steps could be counted from; empty: there
    # is.  After a print the motors may be off.
    def why_not(self):
        return self.section.why_no_steps(frame.MOTORS_OFF)

    # The Base of the last run, or of its last correction
    def current(self):
        last = self.section.last()
        return Base(last.applied, last.result and last.result.switch_offset)

    ##################################################################
    # Z_CALIBRATION_SAVE_GCODE_OFFSET
    ##################################################################

    cmd_Z_CALIBRATION_SAVE_GCODE_OFFSET_help = (
        "Take baby steps over into switch_offset"
    )

    def cmd_Z_CALIBRATION_SAVE_GCODE_OFFSET(self, gcmd):
        is_saved = bool(options.param_int(gcmd, "SAVE", 1))
        force = bool(options.param_int(gcmd, "FORCE", 0))
        self.answer(gcmd, self.save_steps, is_saved, force)

    # Raises CalibrationError where there is nothing to count from
    def save_steps(self, gcmd, is_saved, force):
        reason = self.why_not()
        if reason:
            raise CalibrationError(
                "%s; baby steps count from the last CALIBRATE_Z; run it, then"
                " correct the first layer" % (reason,)
            )
        self.check_tool()
        base, z_offset = self.current(), self.host.gcode_offset.z()
        if abs(z_offset - base.offset) < NO_STEP:
            text = "%s: nothing was changed with baby steps since CALIBRATE_Z"
            gcmd.respond_info(text % (self.host.section,))
            self.keep(is_saved)
            return
        if z_offset and not force:
            self.check_restored(z_offset)
        new, text = check_steps(base, z_offset, force)
        new = round(new, 3)
        self.section.correct(new, z_offset)
        gcmd.respond_info("%s: %s" % (self.host.section, text))
        self.unsaved = new
        self.keep(is_saved)

    # The extruder that is active, unless CALIBRATE_Z was run with it: that has an
    # offset of its own.
    def other_tool(self):
        active = self.host.extruder()
        return "" if active == self.section.last().extruder else active

    def check_tool(self):
        other, calibrated = self.other_tool(), self.section.last().extruder
        if other:
            raise CalibrationError(
                "%s is active, and CALIBRATE_Z was run with %s: what the offset"
                " differs by is no baby step; activate %s first"
                % (other, calibrated, calibrated)
            )

    # One that came back, such as with RESUME, is no baby step away from that of
    # CALIBRATE_Z, or of the last correction.
    def check_restored(self, z_offset):
        if self.restored_since is not self.section.last():
            return
        for name, kept in sorted(self.restored.items()):
            if abs(kept - z_offset) < NO_STEP:
                raise CalibrationError(
                    "the G-code offset %.3f is that of G-code state %s, which has"
                    " brought it back: nothing to count from; run CALIBRATE_Z"
                    " again, or add FORCE=1 if it is of baby steps"
                    % (z_offset, name)
                )

    # Where the mesh ends before the nozzle, G-code Z holds the height of its rim.
    def check_mesh_here(self):
        x, y = self.host.toolhead.get_position()[:2]
        if self.host.features.is_beyond_mesh(x, y):
            raise CalibrationError(
                "the bed mesh ends before X%.1f Y%.1f, and what it takes off Z there"
                " nobody has measured; move over the mesh, or BED_MESH_CLEAR and"
                " CALIBRATE_Z again" % (x, y)
            )

    # Hands it to SAVE_CONFIG, if that is wanted
    def keep(self, is_saved):
        if is_saved and self.unsaved is not None:
            text = "%.3f" % (self.unsaved,)
            if self.saver.save(self.host.section, "switch_offset", text):
                self.unsaved = None

    ##################################################################
    # CALCULATE_SWITCH_OFFSET
    ##################################################################

    cmd_CALCULATE_SWITCH_OFFSET_help = (
        "Calculate switch_offset with the nozzle moved to where Z=0 should be"
    )

    def cmd_CALCULATE_SWITCH_OFFSET(self, gcmd):
        self.answer(gcmd, self.calculate)

    # The nozzle stands where the user wants Z=0 to be: by G-code, without what other
    # features shift there
    def calculate(self, gcmd):
        last, reason = self.section.last(), self.section.why_not_right()
        if reason:
            raise CalibrationError(
                "%s; run CALIBRATE_Z first, then move the nozzle to where Z=0"
                " should be" % (reason,)
            )
        self.check_tool()
        self.check_mesh_here()
        old = param_switch_offset(gcmd, last.result.switch_offset)
        z, z_offset = self.host.features.z(), last.applied
        new = corrected_switch_offset(old, z, z_offset)
        text = (
            "switch_offset=%.3f - (current_z=%.3f - z_offset=%.3f)"
            " --> new switch_offset=%.3f" % (old, z, z_offset, new)
        )
        if new < 0.0:
            raise CalibrationError(
                "%s, which cannot be negative: the nozzle is still too far from"
                " the bed, or the pin does not press the switch body; lower the"
                " nozzle, or correct switch_xy_position" % (text,)
            )
        gcmd.respond_info("%s: %s" % (self.host.section, text))
        if options.param_int(gcmd, "SAVE", 0):
            # What counted before is none of it any more, wherever the owner writes it
            self.unsaved = None
            self.saver.save(self.host.section, "switch_offset", "%.3f" % (new,))
