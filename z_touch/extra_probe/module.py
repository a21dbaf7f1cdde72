# The object behind [extra_probe NAME]: commands, status, and how its parts are
# put together.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import functools
import logging

from .. import __version__, options
from .. import attached as carrying
from .. import command as running
from .. import pin as z_pin
from .. import touch as touching
from ..errors import CalibrationError
from ..host import unknown_commands
from ..host.printer import Host
from ..host.toolhead import check_z_axis
from ..progress import Notes
from ..sampling import accuracy, summarize
from . import heights
from .calibration import Calibration
from .settings import PROBE, complete, read_settings
from .switches import FIND_BED, PinSwitch, ProbeSwitch, Series

# What is told where the switch cannot lie
OVER_PIN = (
    "the head is over the pin of the Z endstop: without a trigger the touch ends at"
    " z=%.3f; move it over the bed"
)

# Touches of EXTRA_PROBE_ACCURACY, where it is not told how many
ACCURACY_SAMPLES = 10


# The object behind [extra_probe NAME].
class ExtraProbe:
    def __init__(self, config):
        logging.info("%s: version %s", config.get_name(), __version__)
        self.name = config.get_name().split()[-1]
        self.host = Host(config)
        check_z_axis(config, self.host.axes.z_axis)
        self.notes = Notes(self.host, self.start_notes)
        self.runner = running.Runner(self.host)
        carrying.of(self.host.printer).watches.append(self.runner.watch)
        self.settings = read_settings(config)
        self.z_pin = z_pin.read_pin(config, self.host.axes.z_axis)
        # For get_status(): mm, and what the pin read
        self.last_query = False
        self.last_z_result = self.probe_z_offset = 0.0
        if self.name == PROBE:
            # Its commands are those of the host: PROBE, QUERY_PROBE
            self.switch = ProbeSwitch(self.host)
        else:
            query = "QUERY_EXTRA_PROBE PROBE=" + self.name
            self.switch = PinSwitch(config, self.host, query)
            running.register_commands(self.host, self, self.name)
        self.calibration = Calibration(
            self.host,
            self.runner,
            self.name,
            self.switch,
            self.z_pin,
        )
        register = self.host.printer.register_event_handler
        register("klippy:connect", self.connect)

    ##################################################################
    # Set-up
    ##################################################################

    # What is told when klippy is ready
    def start_notes(self):
        unknown = unknown_commands.of(self.host.printer)
        return unknown.notes(self.host.section)

    def connect(self):
        host = self.host
        host.connect()
        self.probe_z_offset = host.probing.z_offset()
        try:
            self.check_safe_z()
            if self.name == PROBE:
                self.check_probe()
                self.settings = complete(
                    self.settings, host.probing.sampling(), self.probe_z_offset
                )
            if self.settings.xy_position is not None:
                site, remedy = (
                    self.settings.xy_position,
                    touching.CHOOSE_ANOTHER,
                )
                touching.check_reach(host, site, remedy)
        except CalibrationError as e:
            raise host.printer.config_error(str(e))
        self.calibration.connect(self.settings)
        where = "The switch of section '%s'" % (host.section,)
        host.endstops.check_stops_z(self.switch.endstop(), where)

    def check_safe_z(self):
        high = self.host.axes.limits()[2][1]
        safe_z = self.settings.safe_z_height
        if safe_z > high:
            raise CalibrationError(
                "Option 'safe_z_height: %g' in section '%s' is above the %.3f"
                " of Z; lower it" % (safe_z, self.host.section, high)
            )

    # [probe] has to be a switch that the nozzle presses.
    def check_probe(self):
        why = ""
        if self.host.probing.endstop() is None:
            why = "is missing or no switch on a pin"
        elif self.host.axes.homes_with_probe():
            why = (
                "homes Z, and so finds nothing new; give the switch that the"
                " nozzle presses a section 'extra_probe NAME'"
            )
        elif any(self.host.probing.offsets()[:2]):
            why = "has an x_offset or y_offset: the nozzle does not press it"
        if why:
            raise CalibrationError(
                "Section '%s' stands for [probe], which %s"
                % (self.host.section, why)
            )

    ##################################################################
    # Status
    ##################################################################

    def get_status(self, eventtime):
        return {
            "name": self.name,
            "last_query": self.last_query,
            "last_z_result": self.last_z_result,
            "default_probe_z_offset": self.probe_z_offset,
            "last_offset": self.calibration.last_offset,
            "waits_for": self.calibration.waits_for(),
        }

    ##################################################################
    # Commands
    ##################################################################

    # The heights of a series of touches; 'stay' as in Series.measure()
    def measure(self, gcmd, sampling, stay=False):
        host = self.host
        axis_min = host.axes.z_axis.position_min
        floor = heights.floor(self.settings, host.axes.z_zero(), axis_min)
        pin_z = z_pin.floor(host, self.z_pin)
        floor = heights.above_pin(floor, pin_z)
        if pin_z is not None:
            host.say(OVER_PIN % (floor,))
        series = Series(
            host, self.switch, sampling, gcmd.respond_info, FIND_BED
        )
        return series.measure(floor, stay)

    # A saved calibration has promised that a switch which is not there does no
    # harm: where Z is elsewhere by now, nobody knows how low that is.
    def check_homed_frame(self):
        settings, z_zero = self.settings, self.host.axes.z_zero()
        homed = self.calibration.homed
        is_calibrated = functools.partial(
            heights.is_calibrated, settings, z_zero
        )
        is_lost = is_calibrated() and not is_calibrated(homed.moved_by())
        if is_lost and settings.position_min is None:
            raise CalibrationError(
                "%s, and the saved calibration does not tell any more where the"
                " bed is; run G28 first, or set position_min" % (homed.moved(),)
            )

    def run(self, gcmd, sampling, stay=False):
        def work():
            running.check_no_manual_probe(self.host)
            self.calibration.check_answered()
            self.check_homed_frame()
            self.calibration.free_nozzle()
            return self.measure(gcmd, sampling, stay)

        return self.runner.run(gcmd, work, "touch", 0)

    cmd_EXTRA_PROBE_help = "Probe Z-height at current XY position"

    def cmd_EXTRA_PROBE(self, gcmd):
        sampling = options.param_sampling(gcmd, self.settings.sampling)
        triggers = self.run(gcmd, sampling, stay=True)
        self.last_z_result = summarize(triggers, sampling.result)
        gcmd.respond_info("Result is z=%.6f" % (self.last_z_result,))

    cmd_EXTRA_PROBE_ACCURACY_help = "Probe Z-height accuracy at current XY"

    def cmd_EXTRA_PROBE_ACCURACY(self, gcmd):
        sampling = options.param_sampling(
            gcmd, self.settings.sampling._replace(samples=ACCURACY_SAMPLES)
        )
        # The spread is what is asked for
        sampling = sampling._replace(tolerance=float("inf"))
        speeds = sampling.speed, sampling.lift_speed
        xyz = tuple(self.host.toolhead.get_position()[:3])
        gcmd.respond_info(
            "EXTRA_PROBE_ACCURACY at X:%.3f Y:%.3f Z:%.3f (samples=%d"
            " retract=%.3f speed=%.1f lift_speed=%.1f)"
            % (xyz + (sampling.samples, sampling.retract_dist) + speeds)
        )
        triggers = self.run(gcmd, sampling)
        gcmd.respond_info(
            "probe accuracy results: maximum %.6f, minimum %.6f, range %.6f,"
            " average %.6f, median %.6f, standard deviation %.6f"
            % accuracy(triggers)
        )

    cmd_QUERY_EXTRA_PROBE_help = "Return the status of the extra probe"

    def cmd_QUERY_EXTRA_PROBE(self, gcmd):
        endstop = self.switch.endstop()
        self.last_query = bool(endstop.query_endstop(self.host.after_moves()))
        state = "TRIGGERED" if self.last_query else "open"
        gcmd.respond_info("extra probe %s: %s" % (self.name, state))
