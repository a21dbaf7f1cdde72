# The user's G-code around the touches of a calibration.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
#   start_gcode -> nozzle -> before_switch_gcode -> switch -> bed -> end_gcode
#                    |                                                   |
#                clean_gcode, once                                  offset_gcode
#
# end_gcode runs after every failure, too, then error_gcode.  None of them can
# begin a measurement.

import contextlib
import functools
import logging
import re

from ..core import running, templates
from ..core.errors import CalibrationError
from .attachment import Attachment

# What the user is told where his G-code has moved the frame of the heights
# Less (mm) is rounding.
NO_SHIFT = 0.0000001

BEFORE = "do it before CALIBRATE_Z"
MOVED_IN_CLEAN = "%s in clean_gcode; " + BEFORE
MOVED_IN_BEFORE_SWITCH = (
    "%s in before_switch_gcode: nozzle and switch cannot be compared then; "
    + BEFORE
)
MOVED_IN_END = "%s in end_gcode: the offset does not hold then; " + BEFORE

######################################################################
# What stands in the G-code
######################################################################


# What the settings say of the user's G-code, as far as its text tells: whether
# start_gcode homes, and whether anything stands in before_switch_gcode
def read_texts(config):
    start, before_switch = [
        config.get(name, "") for name in ("start_gcode", "before_switch_gcode")
    ]
    return {
        "start_homes": homes(start, read_macros(config)),
        "may_attach_late": bool(before_switch.strip())
        or config.has_section("dockable_probe"),
    }


# The texts of the user's macros by their names
def read_macros(config):
    return {
        section.get_name().upper().split()[-1]: section.get(
            "gcode", "", note_valid=False
        ).upper()
        for section in config.get_prefix_sections("gcode_macro ")
    }


# Whether some G28 stands in the G-code, or in macros that it calls
def homes(gcode, macros):
    todo, seen = [gcode.upper()], set()
    while todo:
        words = set(re.findall(r"[A-Z0-9_]+", todo.pop())) - seen
        if "G28" in words:
            return True
        seen |= words
        todo += [macros[word] for word in words if word in macros]
    return False


######################################################################
# Running it
######################################################################


# What the user wants to be done around the touches; each part says in its errors
# which option it is.
class Hooks:
    # 'settings' have the templates; 'frame': of the heights; 'watch' is told what
    # happens.
    def __init__(self, host, settings, frame, watch):
        self.host = host
        self.settings = settings
        self.frame = frame
        self.watch = watch
        self.attachment = Attachment(host)
        # How G-code reads coordinates where each of them begins; None: as it does
        # by then
        self.modes = None
        # offset_gcode is under way, and has said that it keeps the offset
        self.is_applying = self.is_kept = False

    # While this lasts G-code reads coordinates as it does now wherever a template
    # begins, and when it ends: one that fails between its G91 and G90 makes no
    # other one drive off.
    @contextlib.contextmanager
    def keeping_modes(self):
        self.modes = self.host.features.modes()
        try:
            yield
        finally:
            self.host.features.set_modes(self.modes)
            self.modes = None

    @property
    def can_clean(self):
        return self.settings.clean_gcode is not None

    # Before the first touch.  It may home; without that the printer is homed
    # already.
    def check_before_start(self):
        if not self.settings.start_homes:
            running.check_homed(self.host)

    # User G-code may home, move, or turn the motors off.  What hangs on the head
    # afterwards is there because start_gcode has put it there.
    def start(self):
        # What the templates take for a height is one of the nozzle
        self.undo_g92()
        self.attachment.begin()
        self.run_gcode("start_gcode")
        running.check_homed(self.host)
        self.attachment.free_nozzle()

    # Between nozzle and switch, whose frame must be the one of 'mark'; None: nothing
    # was measured yet.
    def before_switch(self, mark=None):
        run = functools.partial(self.run_gcode, "before_switch_gcode")
        self.attachment.come_late(run, self.settings.may_attach_late)
        if mark is not None:
            self.check_frame(mark, MOVED_IN_BEFORE_SWITCH)
        running.check_homed(self.host)

    def undo_g92(self):
        undone = self.host.features.undo_g92(NO_SHIFT)
        if undone:
            self.watch.say(undone)

    def clean(self):
        self.watch.enter("clean_gcode")
        mark = self.frame.mark()
        self.run_gcode("clean_gcode")
        self.check_frame(mark, MOVED_IN_CLEAN)

    # Raises CalibrationError where the frame has moved since a mark
    def check_frame(self, mark, text):
        moved = self.frame.moved_since(mark)
        if moved:
            raise CalibrationError(text % (moved,))

    # After the last touch, and after a failure
    def end(self):
        put_away = self.attachment.put_away
        with running.always(self.host, put_away, "docking the probe"):
            self.run_gcode("end_gcode")

    # What is applied is a G-code Z offset (mm).  Returns whether offset_gcode has said
    # that it keeps it, or makes another one of it.
    def apply(self, z_offset):
        if self.settings.offset_gcode is None:
            self.host.gcode_offset.set(z_offset)
            return False
        self.is_applying, self.is_kept = True, False
        try:
            self.run_gcode("offset_gcode", Z="%.6f" % (z_offset,))
        finally:
            self.is_applying = False
        return self.is_kept

    # Whoever runs now says so; returns whether that is offset_gcode
    def keep_offset(self):
        self.is_kept = self.is_applying
        return self.is_applying

    # After a failure, last of all; an error of its own must not hide 'error'.
    def failed(self, error):
        if self.settings.error_gcode is None:
            return
        self.watch.enter("error_gcode")
        try:
            self.run_gcode("error_gcode", ERROR=error)
        except (self.host.printer.command_error, CalibrationError) as e:
            logging.exception("z_calibration: error_gcode failed, too")
            self.watch.say("after the error: %s" % (e,))

    # Runs the template of an option
    def run_gcode(self, option, **params):
        if self.modes is not None:
            self.host.features.set_modes(self.modes)
        template = getattr(self.settings, option)
        templates.run_template(self.host, option, template, **params)

    # While this lasts a dockable_probe fetches and docks nothing by itself, as
    # it would around each session of the host's probing.
    @contextlib.contextmanager
    def holding_probe(self):
        if not self.host.probing.attaches_by_itself():
            yield
            return
        script = self.host.gcode.run_script_from_command
        line = "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=%d"
        release = functools.partial(script, line % (1,))
        with running.always(self.host, release, "auto_attach_detach"):
            script(line % (0,))
            yield
