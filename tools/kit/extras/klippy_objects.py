"""For tests: which names of docs/klippy.csv the objects of this host have.

The section [klippy_objects] has "names: FILE", a list of [object, name] in JSON.  Those that
are there are in its status, as `present`.
"""

from __future__ import annotations

import json
import os
import sys


def has(thing, name, eventtime):
    """Say whether an object has a name: a.b, or status.key of its get_status()."""
    first, _, rest = name.partition(".")
    if not name:
        return True
    if first == "status":
        return rest in thing.get_status(eventtime)
    if not hasattr(thing, first):
        return False
    return not rest or has(getattr(thing, first), rest, eventtime)


class KlippyObjects:
    """Looks all of them up when klippy is ready."""

    def __init__(self, config):
        self.config = config
        self.printer = config.get_printer()
        with open(config.get("names")) as file:
            self.names = json.load(file)
        macros = self.printer.load_object(config, "gcode_macro")
        self.template = macros.load_template(config, "text", "G4 P1")
        self.present = []
        self.printer.register_event_handler("klippy:ready", self.look)

    def look(self):
        eventtime = self.printer.get_reactor().monotonic()
        objects = dict(self.objects())
        for name, attribute in self.names:
            if name == "event":
                found = attribute in self.sources()
            else:
                thing = objects.get(name)
                if thing is None:
                    thing = self.printer.lookup_object(name, None)
                found = thing is not None and has(thing, attribute, eventtime)
            if found:
                self.present.append([name, attribute])

    def objects(self):
        """Yield what is no object of the printer by that name."""
        printer, look_up = self.printer, self.printer.lookup_object
        gcode, toolhead = look_up("gcode"), look_up("toolhead")
        probe, homing = look_up("probe"), look_up("homing")
        kinematics = toolhead.get_kinematics()
        stepper = kinematics.get_steppers()[0]
        gcmd = gcode.create_gcode_command("PROBE", "PROBE", {})
        yield "printer", printer
        yield "reactor", printer.get_reactor()
        yield "config", self.config
        yield "command", gcmd
        yield "mutex", gcode.get_mutex()
        yield "template", self.template
        yield "kinematics", kinematics
        yield "stepper", stepper
        yield "rail", kinematics.rails[0]
        yield "endstop", look_up("query_endstops").endstops[0][0]
        enabling = look_up("stepper_enable")
        yield "enable line", enabling.lookup_enable(stepper.get_name())
        yield "homing state", sys.modules[type(homing).__module__].Homing
        yield "module probe", sys.modules[type(probe).__module__]
        for callback in gcode.output_callbacks:
            if hasattr(getattr(callback, "__self__", None), "clients"):
                yield "console output", callback.__self__
        manual = look_up("manual_probe")
        yield "module manual_probe", sys.modules[type(manual).__module__]
        mesh = look_up("bed_mesh", None)
        if mesh is not None:
            yield "mesh in force", sys.modules[type(mesh).__module__].ZMesh
        for _name, adjuster in printer.lookup_objects("z_thermal_adjust"):
            yield "z_thermal_adjust", adjuster
        if not hasattr(probe, "start_probe_session"):
            yield "probe session", probe
            return
        session = probe.start_probe_session(gcmd)
        yield "probe session", session
        session.end_probe_session()

    def sources(self):
        """Return all sources of klippy."""
        folder = os.path.dirname(sys.modules["__main__"].__file__)
        texts = []
        for path, _, files in os.walk(folder):
            if "z_touch" in path:
                continue
            for name in files:
                if name.endswith(".py"):
                    with open(os.path.join(path, name), errors="replace") as f:
                        texts.append(f.read())
        return "\n".join(texts)

    def get_status(self, eventtime):
        return {"present": self.present}


def load_config(config):
    return KlippyObjects(config)
