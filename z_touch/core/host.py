# The printer as the sections want it: its parts, objects, clocks and console.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from .axes import Axes
from .endstops import Endstops
from .features import Features
from .gcode_offset import GcodeOffset
from .motion import Motion
from .probing import Probing

# Whether "**" in the pattern of an include means folders in folders, and whether
# SAVE_CONFIG writes into what "*" finds
Includes = collections.namedtuple("Includes", "is_deep is_written")


# The host, klippy, as one section sees it.  In this file and in those of its parts it is
# known in which respects hosts differ; the difference is always asked of the object,
# never of a version number.
class Host:
    def __init__(self, config):
        self.printer = config.get_printer()
        # In front of every line the user is shown
        self.section = config.get_name()
        self.gcode = self.printer.lookup_object("gcode")
        # It exists from klippy:connect on, and to our parts a little earlier
        self.toolhead = None
        self.axes = Axes(config, self)
        self.motion = Motion(self)
        self.gcode_offset = GcodeOffset(self)
        self.endstops = Endstops(config, self)
        self.probing = Probing(config, self)
        self.features = Features(self)

    def connect(self):
        self.find_toolhead()
        self.probing.connect()

    def find_toolhead(self):
        self.toolhead = self.printer.lookup_object("toolhead")

    ##################################################################
    # State
    ##################################################################

    def eventtime(self):
        return self.printer.get_reactor().monotonic()

    # The print time of the end of the last queued move
    def after_moves(self):
        queued, passed, is_empty = self.toolhead.check_busy(self.eventtime())
        if is_empty and queued <= passed:
            return passed
        return self.toolhead.get_last_move_time()

    # The print time that is passing: right after a touch, when nothing moves,
    # this spares the wait
    def print_time(self):
        mcu = self.printer.lookup_object("mcu")
        return mcu.estimated_print_time(self.eventtime())

    # Whether a print has begun and not ended: its state ("printing", "paused"),
    # or empty
    def print_state(self):
        stats = self.printer.lookup_object("print_stats", None)
        status = stats.get_status(self.eventtime()) if stats else {}
        state = status.get("state", "")
        return state if state in ("printing", "paused") else ""

    # Klippy writes what it would send into a file, as in its own tests: no switch
    # answers then, and nothing moves.
    def is_file_output(self):
        return self.printer.lookup_object("mcu").is_fileoutput()

    # What Kalico does with includes: "**" stands for any depth of folders since
    # 2024-04-10 (c906c80a0), but for its SAVE_CONFIG, which writes options that sit
    # in included files since 2024-02-17 (09b9319ca), where it is told to
    def includes(self):
        danger = self.printer.lookup_object("danger_options", None)
        is_written = getattr(danger, "autosave_includes", False)
        return Includes(danger is not None, bool(is_written))

    def toolhead_status(self):
        return self.toolhead.get_status(self.eventtime())

    # The section of the extruder that is active; empty: the printer has none
    def extruder(self):
        return self.toolhead_status().get("extruder") or ""

    # Of klipper-toolchanger (94756df, 2026-04-07): the sections of active tools, and by how
    # much (mm) they shift Z.  Other plugins have sections of that name, too.
    def active_tools(self):
        for name, tool in self.printer.lookup_objects("tool"):
            get_status = getattr(tool, "get_status", None)
            status = get_status(self.eventtime()) if get_status else {}
            shift = status.get("gcode_z_offset")
            if status.get("active") and isinstance(shift, (int, float)):
                yield name, shift

    # Degrees C that the nozzle has or is to have, whichever is more
    def nozzle_temperature(self):
        name = self.extruder()
        extruder = name and self.printer.lookup_object(name, None)
        status = extruder.get_status(self.eventtime()) if extruder else {}
        return max(status.get("temperature", 0.0), status.get("target", 0.0))

    ##################################################################
    # Words for the user, on the console and as the error of a command
    ##################################################################

    def say(self, text):
        self.gcode.respond_info("%s: %s" % (self.section, text))

    def error(self, text):
        return self.printer.command_error("%s: %s" % (self.section, text))

    # Puts around(command, gcmd) in the place of a command of the host, which
    # command(gcmd) runs, as a macro with rename_existing does.  A host without that
    # command stays so.
    def wrap_command(self, name, around):
        command = self.gcode.register_command(name, None)
        if command is not None:
            # Kalico would take the words about a partial for its help
            def wrapped(gcmd):
                around(command, gcmd)

            self.gcode.register_command(name, wrapped)

    # The clients of the API that listen to the console.  No host says so; each
    # keeps them where its output goes to.
    def listeners(self):
        outputs = [
            getattr(callback, "__self__", None)
            for callback in getattr(self.gcode, "output_callbacks", ())
        ]
        return [c for out in outputs for c in getattr(out, "clients", ())]

    # A warning of the configuration, for whoever asks the host for these: web
    # interfaces show them until the next start.
    def warn(self, text):
        configfile = self.printer.lookup_object("configfile")
        text = "%s: %s" % (self.section, text)
        if hasattr(configfile, "warn"):
            # Kalico, whose runtime_warning() drops what others have told before
            configfile.warn("runtime_warning", text)
        elif hasattr(configfile, "runtime_warning"):
            # Since 2024-03-13 (0291a1554)
            configfile.runtime_warning(text)
