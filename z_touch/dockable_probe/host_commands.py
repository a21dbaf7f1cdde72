"""The host's commands that are wrapped, and why.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .. import attached
from ..attached import DOCKED
from ..host.probe import TWIST

if TYPE_CHECKING:
    from ..host.klippy import GCodeCommand, Handler
    from ..host.own_probe import Installed
    from .low_moves import LowMoves
    from .probe import DockedProbe

# After these a person lowers the nozzle with TESTZ, or onto a sheet of paper
BY_HAND = ("MANUAL_PROBE", "Z_ENDSTOP_CALIBRATE")
# After this one, too, straight at the first screw
SCREWS = "BED_SCREWS_ADJUST"
# After these a person does so if they have METHOD=MANUAL
BY_METHOD = (
    "BED_MESH_CALIBRATE",
    "BED_TILT_CALIBRATE",
    "DELTA_CALIBRATE",
    "QUAD_GANTRY_LEVEL",
    "SCREWS_TILT_CALCULATE",
    "Z_TILT_ADJUST",
    # Of Kalico's [z_tilt_ng]
    "Z_TILT_AUTODETECT",
    "Z_TILT_CALIBRATE",
)
# This one probes, and then asks for the paper; so does TWIST, at each ACCEPT again
CALIBRATE = "PROBE_CALIBRATE"
PROBING = ("PROBE", "PROBE_ACCURACY")
ENDS = ("M18", "M84", "SAVE_CONFIG")


class HostCommands:
    """Wraps commands of the host.

    G28: a toolhead in the dock leaves it first, and so does the probe where its dock has a
    height that homing_override may set to anything; afterwards it is looked for, as G-code
    may go down from then on.  Those with a paper stage (MANUAL_PROBE
    ... and METHOD=MANUAL): the nozzle is lowered next, and TESTZ is no move of G-code.  M18,
    M84 and SAVE_CONFIG: a docking that is to come in a second would never come, and klippy
    would start with the probe attached.  PROBE and PROBE_ACCURACY: no host tells when a
    command that asks again and again has ended, and until then each touch docks at once.
    """

    def __init__(
        self, probe: DockedProbe, installed: Installed, low_moves: LowMoves
    ):
        self.host = probe.host
        self.probe = probe
        self.installed = installed
        self.low_moves = low_moves
        self.attached = attached.of(self.host.printer)
        # All sections have registered their commands then, and no macro has taken the place
        # of one
        register = self.host.printer.register_event_handler
        register("klippy:mcu_identify", self._wrap)

    def _wrap(self) -> None:
        wrap = self.host.wrap_command
        wrap("G28", self._home)
        for name in BY_HAND:
            wrap(name, self._ask)
        wrap(SCREWS, self._ask_elsewhere)
        for name in BY_METHOD:
            wrap(name, self._ask_by_method)
        wrap(CALIBRATE, self._calibrate)
        wrap(TWIST, self._calibrate_twist)
        for name in PROBING:
            wrap(name, self._probe)
        for name in ENDS:
            wrap(name, self._end)

    def end_asking_again(self) -> None:
        """Note that the command has ended that asks again and again, if it has.

        Between its points a person is asked, and the user's G-code on the way to the dock is
        part of one.
        """
        is_asking = self.host.probing.is_manual_probing()
        if not (is_asking or self.probe.dock.underway.is_any()):
            self.probe.keeping.at_once = False

    ######################################################################
    # Homing
    ######################################################################

    def _home(self, command: Handler, gcmd: GCodeCommand) -> None:
        self.end_asking_again()
        axes = [
            number
            for number, axis in enumerate("XYZ")
            if gcmd.get(axis, None) is not None
        ] or [0, 1, 2]
        if 2 in axes and self.installed.is_z_endstop():
            # Others go to where Z is homed, before the probe is asked for
            self.probe.check_may_fetch()
        self.probe.dock.leave(axes)
        if 2 in axes:
            self.low_moves.is_led = False
            self.low_moves.let_down_at = None
            self._dock_where_height_counts()
        outer, self.low_moves.is_homing = self.low_moves.is_homing, True
        try:
            command(gcmd)
        finally:
            self.low_moves.is_homing = outer
        if not self.probe.known.is_guarded():
            # It may have been on the toolhead when klippy started
            self.probe.sensors.look()

    def _dock_where_height_counts(self) -> None:
        """Dock the probe where the way to the dock goes by Z.

        A [homing_override] may set that to anything before it homes.
        """
        probe, settings = self.probe, self.probe.settings
        is_known = settings.is_placed and self.host.is_homed("xyz")
        is_wanted = settings.detach_dockable_before_z_home is not False
        if settings.dock_fixed_z or not (is_known and is_wanted):
            return
        if probe.keeping.auto and probe.sensors.look() != DOCKED:
            probe.dock_and_come_back()

    ######################################################################
    # Paper
    ######################################################################

    def _ask(self, command: Handler, gcmd: GCodeCommand) -> None:
        self.end_asking_again()
        with self.host.as_command_error(gcmd):
            self.attached.free_nozzle(self.host)
        command(gcmd)

    def _ask_elsewhere(self, command: Handler, gcmd: GCodeCommand) -> None:
        """Run a command that goes straight to its first point."""
        self.probe.dock.leave()
        self._ask(command, gcmd)

    def _ask_by_method(self, command: Handler, gcmd: GCodeCommand) -> None:
        method = gcmd.get("METHOD", "automatic").strip().lower()
        if self.installed.is_by_paper(method):
            self._ask_elsewhere(command, gcmd)
            return
        self.end_asking_again()
        command(gcmd)

    def _calibrate(self, command: Handler, gcmd: GCodeCommand) -> None:
        """Run PROBE_CALIBRATE: the probe is docked when it has touched, whatever holds it."""
        self.end_asking_again()
        keeping = self.probe.keeping
        # What is refused changes nothing: another one may be asking
        outer, keeping.at_once = keeping.at_once, True
        try:
            command(gcmd)
        finally:
            keeping.at_once = outer

    def _calibrate_twist(self, command: Handler, gcmd: GCodeCommand) -> None:
        """Run the calibration of a twist, which goes on so at each ACCEPT."""
        self.end_asking_again()
        keeping = self.probe.keeping
        if not keeping.auto:
            # Docked for the paper it could not be fetched for the next point
            raise self.host.error(
                "auto_attach_detach is off, and the probe has to be fetched and"
                " docked at each point; run SET_DOCKABLE_PROBE"
                " AUTO_ATTACH_DETACH=1 first"
            )
        # It goes straight to its first point, before the probe is fetched
        self.probe.dock.leave()
        outer, keeping.at_once = keeping.at_once, True
        try:
            command(gcmd)
        except Exception:
            keeping.at_once = outer
            raise

    ######################################################################
    # Others
    ######################################################################

    def _probe(self, command: Handler, gcmd: GCodeCommand) -> None:
        self.end_asking_again()
        command(gcmd)

    def _end(self, command: Handler, gcmd: GCodeCommand) -> None:
        self.end_asking_again()
        # Back where the toolhead was, not beside the dock: homing would go across
        self.probe.keeping.end(self.probe.dock_and_come_back)
        command(gcmd)
