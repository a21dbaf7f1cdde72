# What a module needs from the printer to be its probe.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from __future__ import absolute_import

import functools
import importlib
import logging

from ..core import options, sampling
from ..core.errors import SamplesDiffer

# How samples that differ are told
DIFFER = "clean the nozzle, check the probe for play"


# The endstop of a probe as the host's probing wants to see it.  'device' is
# told of everything that begins and ends: begin(is_homing), before_move(),
# after_move(moved, triggered), end(); way_down() is how far (mm) a homing move
# may go that begins now, or None.
class Facade(object):
    def __init__(self, device, endstop, z_offset):
        self.device = device
        self.z_offset = z_offset
        self.is_homing, self.trigger_time = False, 0.0
        self.endstop = endstop
        names = "get_mcu add_stepper get_steppers home_start query_endstop"
        for name in names.split():
            setattr(self, name, getattr(endstop, name))

    def home_wait(self, home_end_time):
        self.trigger_time = self.endstop.home_wait(home_end_time)
        return self.trigger_time

    def get_position_endstop(self):
        return self.z_offset

    # As a probe of hosts until 2024-06-10 (d4bae4dff), Kalico, QIDI; the
    # parameter is Kalico's
    def multi_probe_begin(self, always_restore_toolhead=False):
        self.device.begin(self.is_homing)

    def multi_probe_end(self):
        self.device.end()

    def probe_prepare(self, hmove):
        if self.is_homing:
            self.shorten(self.z_offset)
        self.device.before_move()

    def probe_finish(self, hmove):
        moved = hmove.check_no_movement() is None
        self.device.after_move(moved, self.trigger_time > 0.0)

    # Asked for since 2024-04-09 (acdf8bb10), by Kalico with 'gcmd' since
    # 2025-12-14 (e8182b7f0), as Kalico's own probes have it
    def probing_move(self, pos, speed, gcmd=None):
        homing = self.device.host.printer.lookup_object("homing")
        return homing.probing_move(self, pos, speed)

    # A homing move ends at 'end', wherever it is said to begin
    def shorten(self, end):
        way, toolhead = self.device.way_down(), self.device.host.toolhead
        if way is not None:
            place = toolhead.get_position()
            place[2] = end + way
            toolhead.set_position(place)

    # As a chip of pins
    def setup_pin(self, pin_type, pin_params):
        pins = self.device.host.printer.lookup_object("pins")
        if pin_type != "endstop" or pin_params["pin"] != "z_virtual_endstop":
            raise pins.error(
                "the probe is an endstop_pin only, as z_virtual_endstop"
            )
        if pin_params["invert"] or pin_params["pullup"]:
            raise pins.error("probe:z_virtual_endstop takes neither ! nor ^")
        return self


# The printer's object 'probe' where the host has no class for it that takes
# an endstop (since 2024-06-10, d4bae4dff).
class SessionProbe(object):
    def __init__(self, config, device, facade, module):
        self.device = device
        self.mcu_probe = facade
        names = "x_offset", "y_offset"
        x, y = [options.number(config, name, 0.0) for name in names]
        self.offsets = x, y, facade.z_offset
        self.sampling = options.read_sampling(config)
        self.drop_first = config.getboolean("drop_first_result", False)
        # Since 2025-12-20, 9ccb4d96e
        manual_probe = host_module("manual_probe")
        self.result_class = getattr(manual_probe, "ProbeResult", None)
        gcode = config.get_printer().lookup_object("gcode")
        self.nothing = gcode.create_gcode_command("", "", {})
        self.session = None
        # The commands of the host; the same since 2024-06-10 (8fc11b4a2)
        helper = module.ProbeCommandHelper(config, self, facade.query_endstop)
        self.get_status = helper.get_status

    def get_offsets(self, gcmd=None):
        return self.offsets

    def get_probe_params(self, gcmd=None):
        gcmd, own = gcmd or self.nothing, self.sampling
        number = functools.partial(options.param_number, gcmd)
        count = functools.partial(options.param_int, gcmd)
        return {
            "probe_speed": number("PROBE_SPEED", own.speed, above=0.0),
            "lift_speed": number("LIFT_SPEED", own.lift_speed, above=0.0),
            "samples": count("SAMPLES", own.samples, minval=1),
            "sample_retract_dist": number(
                "SAMPLE_RETRACT_DIST", own.retract_dist, above=0.0
            ),
            "samples_tolerance": number(
                "SAMPLES_TOLERANCE", own.tolerance, minval=0.0
            ),
            "samples_tolerance_retries": count(
                "SAMPLES_TOLERANCE_RETRIES", own.retries, minval=0
            ),
            "samples_result": gcmd.get("SAMPLES_RESULT", own.result),
        }

    def start_probe_session(self, gcmd):
        if self.session is not None:
            raise gcmd.error(
                "%s: a command that probes is under way; start another one"
                " when it has ended" % (self.device.host.section,)
            )
        # Homing comes here since 2026-05-25 (43baf9b83)
        self.device.begin(gcmd.get_command() == "G28")
        self.session = Session(self)
        return self.session

    def end_session(self):
        self.session = None
        self.device.end()

    # Of any command; what it has left open is ended
    def command_error(self):
        if self.session is not None:
            self.end_session()


# One command that probes
class Session(object):
    def __init__(self, probe):
        self.probe = probe
        self.host = probe.device.host
        self.results = []

    # Returns the result, too: until 2024-06-14 (1591a51f7)
    def run_probe(self, gcmd):
        params = self.probe.get_probe_params(gcmd)
        wanted = sampling.Sampling(
            samples=params["samples"],
            tolerance=params["samples_tolerance"],
            retries=params["samples_tolerance_retries"],
            result=params["samples_result"],
            speed=params["probe_speed"],
            retract_dist=params["sample_retract_dist"],
            lift_speed=params["lift_speed"],
        )
        # Homing takes one sample only
        if self.probe.drop_first and gcmd.get_command() != "G28":
            self.touch(gcmd, wanted.speed)
            self.retract(wanted)
        taken = []

        def touch():
            if taken:
                self.retract(wanted)
            taken.append(self.touch(gcmd, wanted.speed))
            return taken[-1][2]

        try:
            heights = sampling.collect(touch, wanted, gcmd.respond_info, DIFFER)
        except SamplesDiffer as e:
            raise gcmd.error("%s: %s" % (self.host.section, e))
        z = sampling.summarize(heights, wanted.result)
        self.results.append(self.moved(taken[-1], z - heights[-1]))
        return self.results[-1]

    def touch(self, gcmd, speed):
        homing = gcmd.get_command() == "G28"
        if not homing and "z" not in self.host.toolhead_status()["homed_axes"]:
            raise gcmd.error("Must home before probe")
        facade, floor = self.probe.mcu_probe, self.probe.device.floor(homing)
        self.host.require_running()
        if homing:
            facade.shorten(floor)
        place = self.host.toolhead.get_position()
        place[2] = min(floor, place[2])
        result = self.result(list(facade.probing_move(place, speed)))
        if not homing:
            text = "probe at %.3f,%.3f is z=%.6f"
            gcmd.respond_info(text % tuple(result[:3]))
        return result

    # Records since 2026-01-21 (2a1027ce4): where the bed is, where the head
    # was.  The event is for axis_twist_compensation, since 2024-06-20
    # (e780049a7).
    def result(self, place):
        x, y, z = self.probe.offsets
        if self.probe.result_class is None:
            place = place[:3]
            self.host.printer.send_event("probe:update_results", place)
            return place
        bed = (place[0] + x, place[1] + y, place[2] - z)
        results = [self.probe.result_class(*(bed + tuple(place[:3])))]
        self.host.printer.send_event("probe:update_results", results)
        return results[0]

    def moved(self, result, dz):
        if self.probe.result_class is None:
            return [result[0], result[1], result[2] + dz]
        return result._replace(
            bed_z=result.bed_z + dz, test_z=result.test_z + dz
        )

    def retract(self, wanted):
        z = self.host.z() + wanted.retract_dist
        self.host.toolhead.manual_move([None, None, z], wanted.lift_speed)

    def pull_probed_results(self):
        results, self.results = self.results, []
        return results

    def end_probe_session(self):
        if self.probe.session is not self:
            raise self.host.printer.command_error(
                "%s: the probe session has ended already" % (self.host.section,)
            )
        self.probe.end_session()


# The module of the host that is called so; it is a neighbour of the folder z_touch,
# whatever the package is called.
def host_module(name):
    return importlib.import_module("%s.%s" % (__name__.rsplit(".", 3)[0], name))


# The only place that knows in which respects hosts differ about probes; the
# difference is always asked of the object, never of a version number.
class ProbeHost(object):
    def __init__(self, host):
        self.host = host
        self.printer = host.printer
        self.facade = self.probe = None
        # What the user is told
        self.notes = []

    # Makes the printer's 'probe' of a device with this endstop, see Facade.
    def install(self, config, device, endstop, z_offset):
        register = self.printer.register_event_handler
        self.facade = Facade(device, endstop, z_offset)
        # Before the host's own, that it knows what the session is for
        register("homing:home_rails_begin", self._homing_begins)
        register("gcode:command_error", self._homing_ends)
        module = host_module("probe")
        if hasattr(module, "ProbeCommandHelper"):
            self._install_session_probe(config, device, module)
        else:
            # Until 2024-06-10 (d4bae4dff), Kalico, QIDI
            self.probe = module.PrinterProbe(config, self.facade)
            self.probe.z_position = max(self.probe.z_position, device.floor())
            knows = hasattr(self.probe, "drop_first_result")
            if not knows and config.getboolean("drop_first_result", False):
                self.notes.append("drop_first_result needs a newer Klipper")
        register("homing:home_rails_end", self._homing_ends)
        self.host.endstops.stops_z(self.facade)
        try:
            self.printer.add_object("probe", self.probe)
        except self.printer.config_error:
            raise config.error(
                "Section '%s': there is a [probe] (or another section that is"
                " one) already, and a printer has one probe; remove the other"
                % (config.get_name(),)
            )

    def _install_session_probe(self, config, device, module):
        facade = self.facade
        self.probe = SessionProbe(config, device, facade, module)
        self.printer.lookup_object("pins").register_chip("probe", facade)
        register = self.printer.register_event_handler
        # Homing comes in these events until 2026-05-25 (43baf9b83)
        register("homing:home_rails_begin", self._rails_begin)
        register("homing:home_rails_end", self._rails_end)
        register("homing:homing_move_begin", self._move_begins)
        register("homing:homing_move_end", self._move_ends)
        register("gcode:command_error", self._command_error)

    # Whether Z is homed with the probe
    def is_z_endstop(self):
        return self.is_among(self._rails())

    def _rails(self):
        kinematics = self.host.toolhead.get_kinematics()
        rails = list(getattr(kinematics, "rails", []))
        # generic_cartesian, since 2025-05-06 (cc6736c3e)
        for carriage in getattr(kinematics, "carriages", {}).values():
            rails.append(carriage.get_rail())
        return rails

    def is_among(self, rails):
        found = [es for rail in rails for es, name in rail.get_endstops()]
        return self.facade in found

    def _homing_begins(self, homing_state, rails):
        self.facade.is_homing = self.is_among(rails)

    def _homing_ends(self, *unused):
        self.facade.is_homing = False

    def _rails_begin(self, homing_state, rails):
        if self.is_among(rails):
            self.facade.multi_probe_begin()
            self.probe.session = Session(self.probe)

    def _rails_end(self, homing_state, rails):
        if self.is_among(rails) and self.probe.session is not None:
            self.probe.end_session()

    def _move_begins(self, hmove):
        if self.facade in hmove.get_mcu_endstops():
            self.facade.probe_prepare(hmove)

    def _move_ends(self, hmove):
        if self.facade in hmove.get_mcu_endstops():
            self.facade.probe_finish(hmove)

    # It must not hide the one that it is sent for
    def _command_error(self):
        try:
            self.probe.command_error()
        except self.printer.command_error:
            logging.exception("%s: ending the session", self.host.section)

    # Z up by a distance (mm) where nobody knows where it is, and still nobody
    # does then.
    def hop(self, distance, speed):
        toolhead = self.host.toolhead
        kinematics = toolhead.get_kinematics()
        # Axes have letters since 2025-01 (4aa550837), numbers before
        named = hasattr(kinematics, "clear_homing_state")
        place = toolhead.get_position()
        place[2] = 0.0
        toolhead.set_position(place, homing_axes="z" if named else (2,))
        try:
            toolhead.manual_move([None, None, distance], speed)
        finally:
            if named:
                kinematics.clear_homing_state("z")
            elif hasattr(kinematics, "note_z_not_homed"):
                kinematics.note_z_not_homed()
