# What the host's own probing wants to see of a probe, made of ours.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# The host's commands (PROBE, BED_MESH_CALIBRATE, G28 with the probe) ask the
# printer's object 'probe' to touch.  What that object is made of differs:
#
#   host                            'probe' is
#   since 2024-06-10 (d4bae4dff)    our SessionProbe, around a Facade
#   before, Kalico, QIDI            the host's PrinterProbe, around a Facade
#
# The Facade is an endstop to both.  Behind it is a device, prober.Prober, which
# is told of everything that begins and ends.

import importlib
import logging

from .. import options, sampling
from ..errors import SamplesDiffer
from ..host.probe import SAMPLING_NAMES

# What to do about samples that differ
DIFFER = "clean the nozzle and check the probe for play"


######################################################################
# The endstop of the probe
######################################################################


# The endstop of the probe as the host's probing wants to see it, and the chip
# of pins whose z_virtual_endstop it is.  'device' has
#   begin(is_homing), end()             around a command that probes
#   before_move(), after_move(moved,    around each probing move
#   triggered)
#   floor(is_homing)                    the lowest toolhead Z of a touch
#   floor_everywhere(is_raised)         the same for a host that asks once
#   raised(z)                           a target as high as it has to be here
#   homing_reach()                      how far (mm) below z_offset the homing
#                                       move may go that comes next, or None
class Facade:
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

    # Toolhead Z of the trigger, by which homing sets Z
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
        pos[2] = self.device.raised(pos[2])
        return homing.probing_move(self, pos, speed)

    # A homing move goes down to 'end' (toolhead Z) from wherever Z is said to
    # be: Z is set so that it ends no deeper than it may.
    def shorten(self, end):
        reach, toolhead = self.device.homing_reach(), self.device.host.toolhead
        if reach is not None:
            position = toolhead.get_position()
            position[2] = end + reach
            toolhead.set_position(position)

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


######################################################################
# Sessions
######################################################################


# The printer's object 'probe' where the host has no class for it that takes
# an endstop (since 2024-06-10, d4bae4dff)
class SessionProbe:
    # 'settings': settings.Settings; 'module': the host's module 'probe'
    def __init__(self, config, facade, settings, module):
        self.device = facade.device
        self.mcu_probe = facade
        self.settings = settings
        # Since 2025-12-20, 9ccb4d96e
        manual_probe = host_module("manual_probe")
        self.result_class = getattr(manual_probe, "ProbeResult", None)
        gcode = config.get_printer().lookup_object("gcode")
        # In place of a command: no parameter is given
        self.no_command = gcode.create_gcode_command("", "", {})
        # The command that probes, None where none does
        self.session = None
        # The commands of the host; the same since 2024-06-10 (8fc11b4a2)
        helper = module.ProbeCommandHelper(config, self, facade.query_endstop)
        self.get_status = helper.get_status

    # X, Y and Z (mm) from the nozzle to the probe
    def get_offsets(self, gcmd=None):
        settings = self.settings
        return settings.x_offset, settings.y_offset, settings.z_offset

    def sampling(self, gcmd):
        return options.param_sampling(gcmd, self.settings.sampling)

    def get_probe_params(self, gcmd=None):
        names = [name for name, _ in SAMPLING_NAMES]
        return dict(zip(names, self.sampling(gcmd or self.no_command)))

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

    # Records since 2026-01-21 (2a1027ce4): where the bed is, where the head
    # was.  The event is for axis_twist_compensation, since 2024-06-20
    # (e780049a7).
    def result(self, trigger):
        head = list(trigger[:3])
        if self.result_class is None:
            # Whoever hears of it may change it
            self.device.host.printer.send_event("probe:update_results", head)
            return head
        x, y, z = self.get_offsets()
        bed = [head[0] + x, head[1] + y, head[2] - z]
        results = [self.result_class(*(bed + head))]
        self.device.host.printer.send_event("probe:update_results", results)
        return results[0]

    # What it adds there to the height of the bed (mm), of a touch in no session
    def twist(self, position):
        result = self.result(position)
        if self.result_class is None:
            return result[2] - position[2]
        return result.bed_z + self.settings.z_offset - result.test_z

    def end_session(self):
        self.session = None
        self.device.end()

    # Of any command; what it has left open is ended
    def command_error(self):
        if self.session is not None:
            self.end_session()


# One command that probes
class Session:
    def __init__(self, probe):
        self.probe = probe
        self.host = probe.device.host
        # Since they were pulled last
        self.results = []

    # Touches a point.  Returns the result, too: until 2024-06-14 (1591a51f7)
    def run_probe(self, gcmd):
        wanted = self.probe.sampling(gcmd)
        # Homing takes one sample only
        is_homing = gcmd.get_command() == "G28"
        if self.probe.settings.drop_first_result and not is_homing:
            self._touch(gcmd, wanted.speed)
            self._retract(wanted)
        touches = []

        def touch():
            if touches:
                self._retract(wanted)
            touches.append(self._touch(gcmd, wanted.speed))
            return touches[-1][2]

        try:
            heights = sampling.collect(touch, wanted, gcmd.respond_info, DIFFER)
        except SamplesDiffer as e:
            raise gcmd.error("%s: %s" % (self.host.section, e))
        z = sampling.summarize(heights, wanted.result)
        result = self._shifted(touches[-1], z - heights[-1])
        self.results.append(result)
        return result

    def pull_probed_results(self):
        results, self.results = self.results, []
        return results

    def end_probe_session(self):
        if self.probe.session is not self:
            raise self.host.error("the probe session has ended already")
        self.probe.end_session()

    # One touch, as the host has results
    def _touch(self, gcmd, speed):
        is_homing = gcmd.get_command() == "G28"
        homed_axes = self.host.toolhead_status()["homed_axes"]
        if not is_homing and "z" not in homed_axes:
            raise gcmd.error("Must home before probe")
        facade = self.probe.mcu_probe
        floor = self.probe.device.floor(is_homing)
        self.host.motion.require_running()
        if is_homing:
            facade.shorten(floor)
        target = self.host.toolhead.get_position()
        target[2] = min(floor, target[2])
        result = self.probe.result(facade.probing_move(target, speed))
        if not is_homing:
            text = "probe at %.3f,%.3f is z=%.6f"
            gcmd.respond_info(text % tuple(result[:3]))
        return result

    # A result by so much (mm) higher
    def _shifted(self, result, dz):
        if self.probe.result_class is None:
            return [result[0], result[1], result[2] + dz]
        return result._replace(
            bed_z=result.bed_z + dz, test_z=result.test_z + dz
        )

    def _retract(self, wanted):
        z = self.host.motion.z() + wanted.retract_dist
        self.host.toolhead.manual_move([None, None, z], wanted.lift_speed)


######################################################################
# The printer's object 'probe'
######################################################################


# The module of the host that is called so; it is a neighbour of the folder
# z_touch, whatever the package is called.
def host_module(name):
    return importlib.import_module("%s.%s" % (__name__.rsplit(".", 3)[0], name))


# The printer's 'probe' on any host.  Here it is known in which respects hosts
# differ about probes; the difference is always asked of the object, never of a
# version.
class VirtualProbe:
    def __init__(self, host):
        self.host = host
        self.printer = host.printer
        self.facade = self.probe = None
        # What the user is told when klippy is ready
        self.notes = []

    # Makes the printer's 'probe' of a device with this endstop, see Facade.
    def install(self, config, device, endstop, settings):
        register = self.printer.register_event_handler
        # Hosts would speak of chips of pins and objects that are there twice.
        if self.printer.lookup_object("probe", None) is not None:
            raise config.error(
                "Section '%s': there is a [probe] (or another section that is"
                " one) already, and a printer has one probe; remove the other"
                % (config.get_name(),)
            )
        self.facade = Facade(device, endstop, settings.z_offset)
        # Before the host's own, that it knows what the session is for
        register("homing:home_rails_begin", self._homing_begins)
        register("gcode:command_error", self._homing_ends)
        module = host_module("probe")
        if hasattr(module, "ProbeCommandHelper"):
            self._install_session_probe(config, settings, module)
        else:
            self._install_host_probe(config, settings, module)
        register("homing:home_rails_end", self._homing_ends)
        self.host.endstops.stops_z(self.facade)
        self.printer.add_object("probe", self.probe)

    # Until 2024-06-10 (d4bae4dff), Kalico, QIDI
    def _install_host_probe(self, config, settings, module):
        self.probe = module.PrinterProbe(config, self.facade)
        # The wrapper of its own pin moves by itself where it asks ours for that
        moves = hasattr(module.ProbeEndstopWrapper, "probing_move")
        floor = self.facade.device.floor_everywhere(moves)
        self.probe.z_position = max(self.probe.z_position, floor)
        can_drop = hasattr(self.probe, "drop_first_result")
        if settings.drop_first_result and not can_drop:
            self.notes.append("drop_first_result needs a newer Klipper")

    def _install_session_probe(self, config, settings, module):
        self.probe = SessionProbe(config, self.facade, settings, module)
        pins = self.printer.lookup_object("pins")
        pins.register_chip("probe", self.facade)
        register = self.printer.register_event_handler
        # Homing comes in these events until 2026-05-25 (43baf9b83)
        register("homing:home_rails_begin", self._rails_begin)
        register("homing:home_rails_end", self._rails_end)
        register("homing:homing_move_begin", self._move_begins)
        register("homing:homing_move_end", self._move_ends)
        register("gcode:command_error", self._command_error)

    def get_status(self, eventtime):
        return self.probe.get_status(eventtime)

    # Whether that METHOD of levelling and of a mesh may be a person with paper: to
    # hosts without sessions whatever they do not know is.
    def is_by_paper(self, method):
        if isinstance(self.probe, SessionProbe):
            return method == "manual"
        return method != "automatic"

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
        pairs = [pair for rail in rails for pair in rail.get_endstops()]
        return self.facade in [endstop for endstop, _ in pairs]

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
