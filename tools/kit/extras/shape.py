# For make shape: SHAPE RUN="CALIBRATE_Z" runs G-code and notes what of some modules
# it runs through.  [shape] with "modules:", names of files and of folders.
# What has no name, such as a comprehension, is read where it stands.

import sys

import greenlet


class Shape:
    def __init__(self, config):
        self.modules = set(config.getlist("modules"))
        self.shapes = {}
        self.gcode = config.get_printer().lookup_object("gcode")
        self.gcode.register_command("SHAPE", self.cmd_SHAPE)

    def cmd_SHAPE(self, gcmd):
        script = gcmd.get("RUN")
        self.functions, self.calls, self.frames = set(), 0, 0
        self.command = greenlet.getcurrent()
        sys.setprofile(self.profile)
        try:
            self.gcode.run_script_from_command(script)
        finally:
            sys.setprofile(None)
        shape = {
            "functions": len(self.functions),
            "files": len({code.co_filename for code in self.functions}),
            "calls": self.calls,
            "frames": self.frames,
        }
        # Of a command that is run more than once, the longest run
        before = self.shapes.setdefault(script.split()[0], shape)
        before.update(max(before, shape, key=lambda one: one["functions"]))

    def profile(self, frame, event, arg):
        # A timer that is due meanwhile, such as that of a report, is no part of it
        if event != "call" or greenlet.getcurrent() is not self.command:
            return
        if self.is_theirs(frame):
            self.functions.add(frame.f_code)
            self.calls += 1
        elif is_probing_move(frame):
            self.frames = max(self.frames, self.frames_above(frame))

    def frames_above(self, frame):
        count = 0
        while frame is not None:
            count += self.is_theirs(frame)
            frame = frame.f_back
        return count

    def is_theirs(self, frame):
        module = frame.f_globals.get("__name__") or ""
        named = not frame.f_code.co_name.startswith("<")
        return named and not self.modules.isdisjoint(module.split("."))

    def get_status(self, eventtime):
        return {"shapes": self.shapes}


# Homing goes through the same function
def is_probing_move(frame):
    return frame.f_code.co_name == "homing_move" and frame.f_locals["probe_pos"]


def load_config(config):
    return Shape(config)
