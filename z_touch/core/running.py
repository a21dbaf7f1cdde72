# One command under way: what it is doing, what it changed for a while, and
# what its failure leaves behind.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import contextlib
import logging

from .errors import CalibrationError


# Run 'action' when the block is left, on every path.  Its own error counts
# only if there is no earlier one.
@contextlib.contextmanager
def always(host, action, what):
    failed = True
    try:
        yield
        failed = False
    finally:
        try:
            if not host.printer.is_shutdown():
                action()
        except (host.printer.command_error, CalibrationError):
            if not failed:
                raise
            logging.exception("%s: %s failed, too", host.section, what)
        except Exception as e:
            # Of the host, such as moving after a board was lost: the
            # printer has to end, but the first error is what is told
            if not failed:
                raise
            logging.exception("%s: %s failed, too", host.section, what)
            text = "%s: %s failed after another error: %s"
            host.printer.invoke_shutdown(text % (host.section, what, e))


# Each cmd_NAME of a module is the command NAME, cmd_NAME_help its description.
# 'probe': of several modules the one that PROBE=... means.
def register_commands(host, module, probe=None):
    attributes = dir(module)
    for attribute in attributes:
        help_attribute = attribute + "_help"
        if not attribute.startswith("cmd_") or help_attribute not in attributes:
            continue
        name, handler = attribute[4:], getattr(module, attribute)
        text = getattr(module, help_attribute)
        if probe is None:
            host.gcode.register_command(name, handler, desc=text)
            continue
        register = host.gcode.register_mux_command
        register(name, "PROBE", probe, handler, desc=text)


def check_homed(host):
    homed = host.toolhead_status()["homed_axes"]
    missing = [axis.upper() for axis in "xyz" if axis not in homed]
    if missing:
        raise CalibrationError(
            "not homed: %s; home all axes (G28) first" % (", ".join(missing),)
        )


# What is printed stands where the head would go.
def check_no_pause(host):
    if host.print_state() == "paused":
        raise CalibrationError(
            "a print is paused, and the head would go across it; end it first"
            " (CANCEL_PRINT)"
        )


def check_no_manual_probe(host):
    helper = host.probing.manual_helper()
    if helper:
        raise CalibrationError(
            "%s is under way; end it with ACCEPT or ABORT first" % (helper,)
        )


# What a run is doing, for get_status() and the console.
class Watch:
    def __init__(self, name, respond_info):
        self.name = name
        self.is_verbose = False
        self.begin(respond_info, "idle", 0)

    def begin(self, respond_info, phase, wanted):
        self.respond_info = respond_info
        self.phase = phase
        self.done = 0
        self.wanted = wanted

    def enter(self, phase):
        self.phase = phase

    # Whether single touches are told, too
    def be_verbose(self, is_verbose):
        self.is_verbose = is_verbose

    # How many touches there will be, where that is known later
    def expect(self, wanted):
        self.wanted = wanted

    # Samples that are taken again do not count twice
    def touched(self):
        self.done = min(self.done + 1, self.wanted)

    def say(self, msg):
        self.respond_info("%s: %s" % (self.name, msg))

    # For klippy.log, and with VERBOSE=1 for the console
    def detail(self, msg):
        if self.is_verbose:
            # The console is logged
            self.say(msg)
        else:
            logging.info("%s: %s", self.name, msg)

    def status(self):
        progress = self.done / self.wanted if self.wanted else 0.0
        return {"phase": self.phase, "progress": progress}


# Runs the commands of a module, one at a time.
class Runner:
    def __init__(self, host):
        self.host = host
        self.watch = Watch(host.section, host.gcode.respond_info)

    # Returns what work() does.  After any error of it the G-code offset is as
    # it was, and failed(error) is called; what a CalibrationError says becomes
    # the command's error.  'wanted' is the number of touches.
    def run(self, gcmd, work, phase, wanted, failed=None):
        self.check_idle(gcmd)
        before = self.host.gcode_offset.z()
        self.watch.begin(gcmd.respond_info, phase, wanted)
        try:
            return work()
        except CalibrationError as e:
            self._undo(before, e, failed)
            raise gcmd.error("%s: %s" % (self.host.section, e))
        except self.host.printer.command_error as e:
            self._undo(before, e, failed)
            raise
        finally:
            self.watch.begin(self.host.gcode.respond_info, "idle", 0)

    # From a template of its own it would never end
    def check_idle(self, gcmd):
        if self.watch.phase != "idle":
            raise gcmd.error(
                "%s: a measurement is under way (%s); start another one when"
                " it has ended" % (self.host.section, self.watch.phase)
            )

    # Whatever the user's G-code has done to it, the offset is as before.
    def _undo(self, offset, error, failed):
        if self.host.printer.is_shutdown():
            return
        self.host.gcode_offset.replace(offset)
        if failed is not None:
            failed(error)
