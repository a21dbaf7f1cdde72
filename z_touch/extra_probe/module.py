# The object behind [extra_probe], its settings, measurements and commands.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import contextlib
import functools
import logging

from .. import __version__
from ..core import (
    dialogs,
    endstops,
    errors,
    frame,
    host,
    options,
    running,
    sampling,
    templates,
    touching,
)

# The name of a section whose switch is [probe]
PROBE = "probe"

# Before a calibration was saved nobody knows where the bed is: a touch ends
# this far (mm) below Z=0.
UNSAVED_FLOOR = -1.0

# A bed this far (mm) from Z=0 was not touched: somebody pressed the switch.
LARGEST_OFFSET = 5.0

SAFE_Z = 10.0  # mm: room for a hand, and above a bed that is homed wrongly
TRAVEL_SPEED = 50.0  # mm/s, in XY
SAME_PLACE = 0.1  # mm; a head further from where it was has been moved
SOFT_TEMPERATURE = 60.0  # C; here the plastic of a membrane begins to melt
MAX_TEMPERATURE = 120.0  # C; a nozzle that is hotter is refused

DIFFER = "clean the nozzle, and check what it touches for play"
TOO_LOW = "begin higher up, or with a lower FLOOR"

# What the user configured: mm, mm/s, degrees C; None is not given.  'saved_z':
# what the last saved calibration made of Homing.z.
Settings = collections.namedtuple(
    "Settings",
    "thickness sampling position_min place safe_z max_temperature saved_z",
)

# Where Z gets its zero: the option, and its value in force (mm)
Homing = collections.namedtuple("Homing", "section option z")

# What waits for an answer: 'asks' for the "switch", or, with the offset 'bed_z',
# for its "removal".
Question = collections.namedtuple("Question", "floor save mark at asks bed_z")


def fail(text, *values):
    raise errors.CalibrationError(text % values)


# A saved calibration has put the bed at Z=0, give or take half the thickness,
# unless what Z is homed at was changed since.
def is_calibrated(settings, homing):
    if settings.saved_z is None or homing is None:
        return False
    return abs(settings.saved_z - homing.z) < settings.thickness / 2.0


# The lowest toolhead Z (mm) of a touch; 'own' comes with the command.
def floor(settings, homing, axis_min, own=None):
    if own is None:
        own = settings.position_min
    if own is None:
        calibrated = is_calibrated(settings, homing)
        own = settings.thickness / 2.0 if calibrated else UNSAVED_FLOOR
    return max(own, axis_min)


# What is left out is as every host has it in [probe]; where that is the switch
# itself, as it is there.
def read_settings(config):
    number = functools.partial(options.number, config)
    defaults, thickness = {}, 0.0
    if config.get_name().split()[-1] == PROBE:
        probe = config.getsection(PROBE)
        defaults = options.as_defaults(options.read_sampling(probe))
        thickness = options.number(probe, "z_offset", 0.0)
    place = options.pair(config, "xy_position")
    if place is not None:
        place = touching.option_site(config, "switch", "xy_position", place)
    return Settings(
        thickness=number("z_offset", thickness, minval=0.0),
        sampling=options.read_sampling(config, **defaults),
        position_min=number("position_min"),
        place=place,
        safe_z=number("safe_z_height", SAFE_Z, above=0.0),
        max_temperature=number("max_temperature", MAX_TEMPERATURE, above=0.0),
        saved_z=number("saved_homing_z"),
    )


# A pin of its own, and the G-code around its touches
class OwnSwitch(object):
    def __init__(self, config, machine, query):
        self.host = machine
        self.query = query
        remedy = "give the pin of the switch; where [probe] is the switch,"
        remedy += " the section has to be called 'extra_probe probe'"
        self._endstop = machine.endstops.make(config, "pin", remedy)
        load = functools.partial(templates.load_template, config)
        self.activate = load("activate_gcode", "")
        self.deactivate = load("deactivate_gcode", "")
        self.each = config.getboolean("deactivate_on_each_sample", True)

    def endstop(self):
        return self._endstop

    # A series of touches; yields the function that makes one.  'top': where a
    # switch that is put away at the end of the series has to be lifted to.
    @contextlib.contextmanager
    def series(self, head, lowest, top):
        with self._active(not self.each):
            yield functools.partial(self._touch, head, lowest)

    def _touch(self, head, lowest):
        with self._active(self.each):
            try:
                return head.touch(self._endstop, lowest, head.sampling.speed)
            except errors.CalibrationError as e:
                hint = "press it by hand and look with %s" % (self.query,)
                raise e.advised(hint)

    @contextlib.contextmanager
    def _active(self, is_wanted):
        if not is_wanted:
            yield
            return
        end = functools.partial(self._run, self.deactivate, "deactivate_gcode")
        with running.always(self.host, end, "deactivate_gcode"):
            self._run(self.activate, "activate_gcode")
            yield

    def _run(self, template, name):
        before = self.host.toolhead.get_position()[:3]
        templates.run_template(self.host, name, template)
        running.check_homed(self.host)
        if self.host.toolhead.get_position()[:3] != before:
            fail("the head moved in %s", name)


# [probe] is the switch: the host's own probing touches
class HostSwitch(object):
    query = "QUERY_PROBE"

    def __init__(self, machine):
        self.host = machine

    def endstop(self):
        return self.host.probing.endstop()

    @contextlib.contextmanager
    def series(self, head, lowest, top):
        speed = "%.6f" % (head.sampling.speed,)
        with touching.probing(head, lowest, top, PROBE_SPEED=speed) as once:
            yield functools.partial(self._touch, head, lowest, once)

    def _touch(self, head, lowest, probe_once):
        if probe_once is None:
            # A host unknown to us: its probing would go on to position_min
            return head.touch(self.endstop(), lowest, head.sampling.speed)
        head.check_above(lowest)
        return head.probe(probe_once).z


# The object behind [extra_probe NAME]
class ExtraProbe(object):
    def __init__(self, config):
        logging.info("%s: version %s", config.get_name(), __version__)
        self.name = config.get_name().split()[-1]
        self.host = host.Host(config)
        host.check_z_axis(config, self.host.z_axis)
        self.runner = running.Runner(self.host)
        self.settings = read_settings(config)
        # What makes the object 'probe', if its section is one that we know
        known = [s for s, _ in endstops.PROBE_PINS if config.has_section(s)]
        self.probe_section = known[0] if known else None
        # None: nobody knows, or klippy has not connected yet
        self.homing = None
        self.last_query = False
        self.last_z_result = self.probe_z_offset = 0.0
        self.calibration = Calibration(self)
        if self.name == PROBE:
            self.switch = HostSwitch(self.host)
        else:
            query = "QUERY_EXTRA_PROBE PROBE=" + self.name
            self.switch = OwnSwitch(config, self.host, query)
            running.register_commands(self.host, self, self.name)
        register = self.host.printer.register_event_handler
        register("klippy:connect", self.connect)

    def connect(self):
        machine = self.host
        machine.connect()
        if hasattr(machine.probing.probe, "get_offsets"):
            self.probe_z_offset = machine.probing.offsets()[2]
        self.homing = self.find_homing()
        try:
            high, safe_z = machine.axis_limits()[2][1], self.settings.safe_z
            if safe_z > high:
                text = "Option 'safe_z_height: %g' in section '%s' is above the"
                fail(
                    text + " %.3f of Z; lower it", safe_z, machine.section, high
                )
            if self.name == PROBE:
                self.check_probe()
            if self.settings.place is not None:
                remedy = "choose a point that it can reach"
                touching.check_reach(machine, self.settings.place, remedy)
        except errors.CalibrationError as e:
            raise machine.printer.config_error(str(e))
        where = "The switch of section '%s'" % (machine.section,)
        machine.endstops.check_stops_z(self.switch.endstop(), where)

    def find_homing(self):
        axis = self.host.z_axis
        homing = Homing(axis.section, "position_endstop", axis.position_endstop)
        if endstops.chip_of(axis.endstop_pin) == "probe":
            homing = Homing(self.probe_section, "z_offset", self.probe_z_offset)
        return None if None in homing else homing

    # [probe] has to be a switch that the nozzle presses
    def check_probe(self):
        text = "Section '%s' stands for [probe], which "
        if self.host.probing.endstop() is None:
            fail(text + "is missing or no switch on a pin", self.host.section)
        if endstops.chip_of(self.host.z_axis.endstop_pin) == "probe":
            text += "homes Z, and so finds nothing new; give the switch that"
            text += " the nozzle presses a section 'extra_probe NAME'"
            fail(text, self.host.section)
        if any(self.host.probing.offsets()[:2]):
            text += "has an x_offset or y_offset: the nozzle does not press it"
            fail(text, self.host.section)

    def get_status(self, eventtime):
        return {
            "name": self.name,
            "last_query": self.last_query,
            "last_z_result": self.last_z_result,
            "default_probe_z_offset": self.probe_z_offset,
            "last_offset": self.calibration.last_offset,
            "waits_for": self.calibration.dialog.waits_for(),
        }

    def floor(self, own=None):
        axis_min = self.host.z_axis.position_min
        return floor(self.settings, self.homing, axis_min, own)

    # The heights of a series of touches.  The head ends where it began, or,
    # if told to 'stay', where the last touch ended, unless one has failed.
    def measure(self, gcmd, samples, lowest, stay=False):
        def retry(unused):
            gcmd.respond_info("Probe samples exceed tolerance. Retrying...")

        head, rest = touching.Head(self.host, samples, TOO_LOW), [self.host.z()]
        with running.always(self.host, lambda: head.lift(rest[0]), "lifting"):
            with self.switch.series(head, lowest, rest[0]) as touch:
                sample = functools.partial(self.sample, gcmd, head, touch)
                heights = sampling.collect(sample, samples, retry, DIFFER)
            if stay:
                rest[0] = lowest
        return heights

    def sample(self, gcmd, head, touch):
        head.retract()
        x, y = self.host.toolhead.get_position()[:2]
        z = touch()
        gcmd.respond_info("probe at %.3f,%.3f is z=%.6f" % (x, y, z))
        return z

    def run(self, gcmd, *work):
        return self.runner.run(gcmd, functools.partial(*work), "touch", 0)

    cmd_EXTRA_PROBE_help = "Probe Z-height at current XY position"

    def cmd_EXTRA_PROBE(self, gcmd):
        samples = options.param_sampling(gcmd, self.settings.sampling)
        lowest = self.floor()
        heights = self.run(gcmd, self.measure, gcmd, samples, lowest, True)
        self.last_z_result = sampling.summarize(heights, samples.result)
        gcmd.respond_info("Result is z=%.6f" % (self.last_z_result,))

    cmd_EXTRA_PROBE_ACCURACY_help = "Probe Z-height accuracy at current XY"

    def cmd_EXTRA_PROBE_ACCURACY(self, gcmd):
        own = self.settings.sampling._replace(samples=10)
        # The spread is what is asked for
        samples = options.param_sampling(gcmd, own)
        samples = samples._replace(tolerance=float("inf"))
        place = tuple(self.host.toolhead.get_position()[:3])
        text = "EXTRA_PROBE_ACCURACY at X:%.3f Y:%.3f Z:%.3f"
        text += " (samples=%d retract=%.3f speed=%.1f lift_speed=%.1f)"
        values = samples.samples, samples.retract_dist, samples.speed
        gcmd.respond_info(text % (place + values + (samples.lift_speed,)))
        heights = self.run(gcmd, self.measure, gcmd, samples, self.floor())
        text = "probe accuracy results: maximum %.6f, minimum %.6f, range %.6f,"
        text += " average %.6f, median %.6f, standard deviation %.6f"
        gcmd.respond_info(text % sampling.accuracy(heights))

    cmd_QUERY_EXTRA_PROBE_help = "Return the status of the extra probe"

    def cmd_QUERY_EXTRA_PROBE(self, gcmd):
        endstop = self.switch.endstop()
        self.last_query = bool(endstop.query_endstop(self.host.after_moves()))
        state = "TRIGGERED" if self.last_query else "open"
        gcmd.respond_info("extra probe %s: %s" % (self.name, state))


# A calibration: travel and ask, touch and ask again, apply.
class Calibration(object):
    def __init__(self, probe):
        self.probe = probe
        self.host = probe.host
        self.frame = frame.Frame(probe.host)
        self.say = probe.runner.watch.say
        command = "EXTRA_PROBE_%s PROBE=" + probe.name
        self.dialog = dialogs.Dialog(self.host, self.say, command)
        # Of the last one that was applied or saved; None: there is none
        self.last_offset = None
        running.register_commands(self.host, self, probe.name)

    cmd_EXTRA_PROBE_CALIBRATE_help = "Set the Z offset with a switch on the bed"

    def cmd_EXTRA_PROBE_CALIBRATE(self, gcmd):
        self.dialog.close()
        self.probe.run(gcmd, self.begin, gcmd)

    def begin(self, gcmd):
        settings, machine = self.probe.settings, self.host
        save = options.param_int(gcmd, "SAVE", 0, minval=0, maxval=1)
        own = options.param_number(gcmd, "FLOOR")
        self.check_printer()
        if not settings.thickness:
            fail("set z_offset to the thickness of the switch, in mm")
        if save and self.probe.homing is None:
            pin = machine.z_axis.endstop_pin
            fail("SAVE=1: nobody knows where Z gets its zero with '%s'", pin)
        warnings = self.check_temperature()
        speed = settings.sampling.lift_speed
        touching.raise_to(machine, settings.safe_z, speed)
        if settings.place is not None:
            x, y = settings.place.x, settings.place.y
            touching.move_xy(machine, x, y, TRAVEL_SPEED)
        self.stand_still()
        lowest, place = self.probe.floor(own), machine.toolhead.get_position()
        sentences = ["Flat on the bed, the nozzle clean."]
        sentences += self.tell_floor(lowest, own) + warnings
        mark = self.frame.mark()
        question = Question(lowest, save, mark, place[:2], "switch", None)
        self.dialog.ask(question, "Lay the switch below the nozzle", sentences)

    def tell_floor(self, lowest, own):
        told = ["Without a trigger the nozzle stops at z=%.3f." % (lowest,)]
        settings = self.probe.settings
        is_told = own is not None or settings.position_min is not None
        if not (is_told or is_calibrated(settings, self.probe.homing)):
            text = "No calibration was saved yet, so that may be in the bed:"
            told.append(text + " watch, ready to stop.")
        return told

    def check_printer(self):
        stats = self.host.printer.lookup_object("print_stats", None)
        status = stats and stats.get_status(self.host.eventtime())
        if status and status["state"] in ("printing", "paused"):
            fail("a print is under way (%s); end it first", status["state"])
        if self.host.probing.is_manual_probing():
            fail("end the manual probe first, with ACCEPT or ABORT")
        running.check_homed(self.host)

    # Returns warnings
    def check_temperature(self):
        hot = self.host.nozzle_temperature()
        limit = self.probe.settings.max_temperature
        if hot > limit:
            text = "the nozzle has, or is to have, %.0f C, max_temperature is"
            fail(text + " %.0f C; let it cool down", hot, limit)
        text = "The nozzle has, or is to have, %.0f C: a membrane may melt."
        return [text % (hot,)] if hot > SOFT_TEMPERATURE else []

    cmd_EXTRA_PROBE_ABORT_help = "End a calibration, everything as before"

    def cmd_EXTRA_PROBE_ABORT(self, gcmd):
        self.dialog.answered(gcmd)
        self.say("the calibration ends, nothing was changed")

    cmd_EXTRA_PROBE_CONTINUE_help = "Go on with a calibration"

    def cmd_EXTRA_PROBE_CONTINUE(self, gcmd):
        question = self.dialog.continued(gcmd)
        step = self.touch if question.bed_z is None else self.apply
        self.probe.run(gcmd, step, gcmd, question)

    def touch(self, gcmd, question):
        settings, machine = self.probe.settings, self.host
        self.check_frame(question)
        self.check_place(question)
        for warning in self.check_temperature():
            self.say(warning)
        switch, samples = self.probe.switch, settings.sampling
        touching.raise_to(machine, settings.safe_z, samples.lift_speed)
        if switch.endstop().query_endstop(machine.after_moves()):
            text = "the switch reads triggered before it is touched; check it"
            fail(text + " with %s, and whether pin needs a '!'", switch.query)
        head = touching.Head(machine, samples, TOO_LOW)
        head.come_down(switch.endstop(), settings.safe_z, samples.lift_speed)
        head.retract()
        heights = self.probe.measure(gcmd, samples, question.floor)
        self.check_frame(question)
        trigger = sampling.summarize(heights, samples.result)
        bed_z = trigger - settings.thickness
        if abs(bed_z) > LARGEST_OFFSET:
            text = "triggered at z=%.3f, the bed would be over %g mm from Z=0;"
            text += " was it pressed by hand? If not, home Z nearer to it first"
            fail(text, trigger, LARGEST_OFFSET)
        if question.save:
            self.corrected(bed_z)
        self.stand_still()
        text = "Triggered at z=%.3f, so the bed is at z=%.3f. Continue makes"
        sentences = [(text + " that Z=0.") % (trigger, bed_z)]
        question = question._replace(asks="removal", bed_z=bed_z)
        self.dialog.ask(question, "Take the switch away", sentences)

    def check_frame(self, question):
        self.check_printer()
        moved = self.frame.moved_since(question.mark)
        if moved:
            fail("%s since the calibration began; begin again", moved)

    # Before a hand comes near
    def stand_still(self):
        self.host.toolhead.wait_moves()
        if self.host.printer.is_shutdown():
            fail("ended by a shutdown of the printer")

    def check_place(self, question):
        here = zip(self.host.toolhead.get_position(), question.at)
        if max(abs(a - b) for a, b in here) > SAME_PLACE:
            fail("the head was moved since the calibration began; begin again")

    def apply(self, gcmd, question):
        self.check_frame(question)
        bed_z, thickness = question.bed_z, self.probe.settings.thickness
        if question.save:
            self.save(gcmd, bed_z)
        self.host.set_gcode_offset(0.0 if question.save else bed_z)
        self.last_offset = bed_z
        text = "trigger=%.6f - z_offset=%.3f --> new offset=%.6f"
        self.say(text % (bed_z + thickness, thickness, bed_z))

    # What SAVE_CONFIG is to write.  Outside its axis klippy would not start.
    def corrected(self, bed_z):
        homing, limits = self.probe.homing, self.host.axis_limits()[2]
        homing = homing._replace(z=round(homing.z - bed_z, 3))
        if not limits[0] <= homing.z <= limits[1]:
            text = "%s: %s would be %.3f, outside the %.3f to %.3f of Z; widen"
            text += " position_min or position_max, or do without SAVE=1"
            fail(text, *(homing + limits))
        return homing

    def save(self, gcmd, bed_z):
        section, option, z = self.corrected(bed_z)
        new = "%.3f" % (z,)
        options.save(self.host.printer, section, option, new)
        options.save(
            self.host.printer, self.host.section, "saved_homing_z", new
        )
        text = "%s: %s: %s\n%s\nUntil then the G-code offset is 0."
        gcmd.respond_info(text % (section, option, new, options.SAVE_HINT))
