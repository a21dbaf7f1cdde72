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
from __future__ import absolute_import

import contextlib
import functools
import logging

from ..core import running, templates
from ..core.errors import CalibrationError


# What the user wants to be done around the touches; each part says in its errors
# which option it is.
class Hooks(object):
    # 'gcode': templates.Templates; 'frame': of the heights; 'watch' is told what
    # happens.
    def __init__(self, host, gcode, frame, watch):
        self.host = host
        self.gcode = gcode
        self.frame = frame
        self.watch = watch

    @property
    def can_clean(self):
        return self.gcode.clean is not None

    # Before the first touch.  It may home; without that the printer is homed
    # already.
    def check_before_start(self):
        if not self.gcode.start_homes:
            running.check_homed(self.host)

    # User G-code may home, move, or turn the motors off
    def start(self):
        self.run_gcode("start")
        running.check_homed(self.host)

    # Between nozzle and switch, whose frame must be the one of 'mark'.
    def before_switch(self, mark):
        self.run_gcode("before_switch")
        moved = self.frame.moved_since(mark)
        if moved:
            raise CalibrationError(
                "%s in before_switch_gcode: nozzle and switch cannot be"
                " compared then; do it before CALIBRATE_Z" % (moved,)
            )
        running.check_homed(self.host)

    def clean(self):
        self.watch.enter("clean_gcode")
        mark = self.frame.mark()
        self.run_gcode("clean")
        moved = self.frame.moved_since(mark)
        if moved:
            raise CalibrationError(
                "%s in clean_gcode; do it before CALIBRATE_Z" % (moved,)
            )

    # After the last touch, and after a failure
    def end(self):
        self.run_gcode("end")

    # What is applied is a G-code Z offset (mm)
    def apply(self, z_offset):
        if self.gcode.offset is None:
            self.host.set_gcode_offset(z_offset)
            return
        self.run_gcode("offset", Z="%.6f" % (z_offset,))

    # After a failure, last of all; an error of its own must not hide 'error'.
    def failed(self, error):
        if self.gcode.error is None:
            return
        self.watch.enter("error_gcode")
        try:
            self.run_gcode("error", ERROR=error)
        except (self.host.printer.command_error, CalibrationError) as e:
            logging.exception("z_calibration: error_gcode failed, too")
            self.watch.say("after the error: %s" % (e,))

    def run_gcode(self, part, **params):
        template = getattr(self.gcode, part)
        templates.run_template(self.host, part + "_gcode", template, **params)

    # While this lasts a dockable_probe fetches and docks nothing by itself, as
    # it would around each session of the host's probing.
    @contextlib.contextmanager
    def holding_probe(self):
        dockable = self.host.printer.lookup_object("dockable_probe", None)
        if not getattr(dockable, "auto_attach_detach", False):
            yield
            return
        script = self.host.gcode.run_script_from_command
        line = "SET_DOCKABLE_PROBE AUTO_ATTACH_DETACH=%d"
        release = functools.partial(script, line % (1,))
        with running.always(self.host, release, "auto_attach_detach"):
            script(line % (0,))
            yield
