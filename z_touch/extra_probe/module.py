"""The object behind [extra_probe NAME]: its commands and its status.

  settings     the options
  switches     what is touched, and a series of touches
  heights      the bed below the switch, and how low a touch may go
  fixed        a switch that stays where it is: what the probe touches besides
  calibration  EXTRA_PROBE_CALIBRATE, and the answers to what it asks
  shifts       what Klipper's own features add to Z where the switch lay

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Any, Dict, List

from .. import __version__, attached, command, options, pin, touch
from ..errors import CalibrationError
from ..host import unknown_commands
from ..host.printer import Host
from ..host.toolhead import check_z_axis
from ..progress import Notes
from ..sampling import accuracy, summarize
from . import fixed, heights
from .calibration import Calibration
from .settings import PROBE, complete, read_settings
from .switches import (
    FIND_BED,
    FIND_SWITCH,
    HIGHER_UP,
    PinSwitch,
    ProbeSwitch,
    Series,
)

if TYPE_CHECKING:
    from ..host.klippy import Config, GCodeCommand
    from .switches import Switch

# Touches of EXTRA_PROBE_ACCURACY, where it is not told how many
ACCURACY_SAMPLES = 10


class ExtraProbe:
    """The object behind [extra_probe NAME].  Commands may pause, get_status() never does."""

    def __init__(self, config: Config):
        logging.info("%s: version %s", config.get_name(), __version__)
        self.name = config.get_name().split()[-1]
        self.host = Host(config)
        self.z_axis = check_z_axis(config, self.host.axes.z_axis)
        self.notes = Notes(self.host, self.start_notes)
        self.runner = command.Runner(self.host)
        attached.of(self.host.printer).watches.append(self.runner.watch)
        self.settings = read_settings(config)
        self.z_pin = pin.read_pin(config, self.z_axis)
        self.mesh_area = pin.mesh_area(config)
        # For get_status(): what the pin read, and mm
        self.last_query = False
        self.last_z_result = 0.0
        self.probe_z_offset = 0.0
        self.switch: Switch
        if self.name == PROBE:
            # Its commands are those of the host: PROBE, QUERY_PROBE
            self.switch = ProbeSwitch(self.host)
        else:
            query = "QUERY_EXTRA_PROBE PROBE=" + self.name
            self.switch = PinSwitch(config, self.host, query)
            command.register_commands(self.host, self, self.name)
        self.calibration = Calibration(
            self.host, self.runner, self.switch, self.z_axis, self.z_pin
        )
        register = self.host.printer.register_event_handler
        register("klippy:connect", self.connect)

    ##################################################################
    # Set-up and status
    ##################################################################

    def start_notes(self) -> List[str]:
        """Return what the user is told when klippy is ready."""
        notes = unknown_commands.of(self.host.printer).notes(self.host.section)
        if self.settings.fixed and self.settings.switch_height is None:
            notes = [*notes, fixed.NO_HEIGHT]
        return notes

    def connect(self) -> None:
        """Complete the settings; a wrong set-up ends the start of klippy."""
        host = self.host
        host.connect()
        self.probe_z_offset = host.probing.z_offset()
        try:
            self._check_safe_z()
            if self.name == PROBE:
                self._check_probe()
                self.settings = complete(
                    self.settings, host.probing.sampling(), self.probe_z_offset
                )
            site = self.settings.xy_position
            if site is not None:
                touch.check_reach(host, site, touch.CHOOSE_ANOTHER)
            self._check_fixed()
        except CalibrationError as e:
            raise host.printer.config_error(str(e))
        self.calibration.connect(self.settings)
        where = f"The switch of section '{host.section}'"
        host.endstops.check_stops_z(self.switch.endstop(), where)

    def _check_safe_z(self) -> None:
        """Raise CalibrationError where safe_z_height is above the axis."""
        high = self.host.axes.limits()[2][1]
        safe_z = self.settings.safe_z_height
        if safe_z > high:
            raise CalibrationError(
                f"Option 'safe_z_height: {safe_z:g}' in section '{self.host.section}'"
                f" is above the {high:.3f} of Z; lower it"
            )

    def _check_fixed(self) -> None:
        """Raise CalibrationError where 'fixed' does not fit the rest."""
        settings, section = self.settings, self.host.section
        if settings.fixed and self.name == PROBE:
            raise CalibrationError(
                f"Option 'fixed: True' in section '{section}': [probe] is the switch"
                " there, and nothing is left to touch the bed; remove it"
            )
        if settings.fixed:
            axis_min = self.z_axis.position_min
            fixed.check(self.host, settings, axis_min, self.mesh_area)
        elif settings.switch_height is not None:
            raise CalibrationError(
                f"Option 'switch_height: {settings.switch_height:g}' in section"
                f" '{section}' is for a switch that stays where it is; add 'fixed: True',"
                " or remove it"
            )

    def _check_probe(self) -> None:
        """Raise CalibrationError unless [probe] is a switch that the nozzle presses."""
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
                f"Section '{self.host.section}' stands for [probe], which {why}"
            )

    def get_status(self, eventtime: float) -> Dict[str, Any]:
        """Return what macros and web interfaces read."""
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

    cmd_EXTRA_PROBE_help = "Probe Z-height at current XY position"

    def cmd_EXTRA_PROBE(self, gcmd: GCodeCommand) -> None:
        """Touch where the toolhead is, show the toolhead Z of the trigger, and stay there."""
        sampling = options.param_sampling(gcmd, self.settings.sampling)
        with self.runner.running(gcmd, "touch", 0):
            self._check_ready()
            self.switch.free_nozzle()
            series = Series(
                self.host, self.switch, sampling, self._find_bed(), HIGHER_UP
            )
            triggers = series.measure(self._floor(), stay=True)
        self.last_z_result = summarize(triggers, sampling.result)
        gcmd.respond_info(f"Result is z={self.last_z_result:.6f}")

    cmd_EXTRA_PROBE_ACCURACY_help = "Probe Z-height accuracy at current XY"

    def cmd_EXTRA_PROBE_ACCURACY(self, gcmd: GCodeCommand) -> None:
        """Touch several times where the toolhead is, and show how far they are apart."""
        sampling = self.settings.sampling._replace(samples=ACCURACY_SAMPLES)
        sampling = options.param_sampling(gcmd, sampling)
        # The spread is what is asked for
        sampling = sampling._replace(tolerance=float("inf"))
        x, y, z = self.host.toolhead.get_position()[:3]
        gcmd.respond_info(
            f"EXTRA_PROBE_ACCURACY at X:{x:.3f} Y:{y:.3f} Z:{z:.3f}"
            f" (samples={sampling.samples} retract={sampling.retract_dist:.3f}"
            f" speed={sampling.speed:.1f} lift_speed={sampling.lift_speed:.1f})"
        )
        with self.runner.running(gcmd, "touch", 0):
            self._check_ready()
            self.switch.free_nozzle()
            series = Series(
                self.host, self.switch, sampling, self._find_bed(), HIGHER_UP
            )
            triggers = series.measure(self._floor())
        found = accuracy(triggers)
        gcmd.respond_info(
            f"probe accuracy results: maximum {found.maximum:.6f}, minimum"
            f" {found.minimum:.6f}, range {found.range:.6f}, average"
            f" {found.average:.6f}, median {found.median:.6f}, standard deviation"
            f" {found.deviation:.6f}"
        )

    cmd_QUERY_EXTRA_PROBE_help = "Return the status of the extra probe"

    def cmd_QUERY_EXTRA_PROBE(self, gcmd: GCodeCommand) -> None:
        """Show what the switch reads."""
        endstop = self.switch.endstop()
        self.last_query = bool(endstop.query_endstop(self.host.after_moves()))
        state = "TRIGGERED" if self.last_query else "open"
        gcmd.respond_info(f"extra probe {self.name}: {state}")

    ##################################################################
    # Before a touch
    ##################################################################

    def _check_ready(self) -> None:
        """Raise CalibrationError where a person is asked, or the bed is not known any more.

        A saved calibration has promised that a switch which is not there does no harm: where
        Z=0 is elsewhere by now, it is not known how low that is.
        """
        command.check_no_manual_probe(self.host)
        command.check_carriage_is_kept(self.host)
        self.calibration.check_answered()
        settings, homed = self.settings, self.calibration.homed
        z_zero = self.host.axes.z_zero()
        if settings.fixed and settings.xy_position is not None:
            fixed.check_place(self.host, settings.xy_position)
            return
        if settings.position_min is not None:
            return
        if not heights.is_calibrated(settings, z_zero):
            return
        if not heights.is_calibrated(settings, z_zero, homed.moved_by()):
            raise CalibrationError(
                f"{homed.moved()}, and the saved calibration does not tell any more"
                " where the bed is; run G28 first, or set position_min"
            )

    def _find_bed(self) -> str:
        """Return what to do where what is touched may be lower than the floor."""
        return FIND_SWITCH if self.settings.fixed else FIND_BED

    def _floor(self) -> float:
        """Return the lowest toolhead Z of a touch here; say where the switch cannot lie."""
        floor = heights.floor(
            self.settings,
            self.host.axes.z_zero(),
            self.z_axis.position_min,
        )
        pin_z = pin.floor(self.host, self.z_pin)
        floor = heights.above_pin(floor, pin_z)
        if pin_z is not None:
            self.host.say(
                "the toolhead is over the pin of the Z endstop: without a trigger the touch"
                f" ends at z={floor:.3f}; move it over the bed"
            )
        return floor
