"""The object behind [dockable_probe]: its commands and its status.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, List

from .. import __version__, command, options, progress
from ..attached import ATTACHED, DOCKED, UNKNOWN
from ..host import unknown_commands
from ..host.gcode_moves import GcodeMoves
from ..host.own_probe import Installed
from ..host.printer import Host
from . import checks, path
from .carrier import Carrier
from .dock import IF_DOCKED, Dock, Underway
from .height import Height
from .homing import BeforeHoming
from .host_commands import HostCommands
from .known import Known
from .low_moves import LowMoves
from .path import Position
from .probe import DockedProbe
from .sensors import Sensors
from .settings import read_settings
from .setup import Setup

if TYPE_CHECKING:
    from ..host.klippy import Config, GCodeCommand, Status

# As Kalico's own counts them
STATES = (UNKNOWN, ATTACHED, DOCKED)


class DockableProbe:
    """The commands of [dockable_probe].  What moves may pause."""

    def __init__(self, config: Config):
        logging.info("dockable_probe %s", __version__)
        checks.check_only_probe(config)
        self.host = Host(config)
        checks.check_kinematics(config, self.host.axes.z_axis)
        self.old_names = options.OldNames(config)
        self.settings = read_settings(config, self.host, self.old_names)
        checks.check_positions(config, self.settings, self.old_names.notes)
        self.notes = progress.Notes(self.host, self.start_notes)

        self.known = Known()
        self.sensors = Sensors(config, self.host, self.settings, self.known)
        self.height = Height(self.host)
        self.dock = Dock(
            self.host,
            self.settings,
            self.sensors,
            self.known,
            self.height,
            Underway(),
        )
        self.moves = self.dock.moves
        self.probe = DockedProbe(self.dock, self.settings)
        self.installed = Installed(
            config,
            self.host,
            self.probe,
            self.sensors.pin.endstop,
            self.settings,
        )
        is_lifted = checks.is_lifted_elsewhere(config)
        self.before_homing = BeforeHoming(self.probe, self.installed, is_lifted)
        self.low_moves = LowMoves(self.probe, Carrier(self.probe))
        GcodeMoves(self.host, self.low_moves)
        self.host_commands = HostCommands(
            self.probe, self.installed, self.low_moves
        )
        register = self.host.printer.register_event_handler
        register("klippy:connect", self.connect)
        command.register_commands(self.host, self)
        Setup(self)

    ######################################################################
    # What the host tells and asks
    ######################################################################

    def connect(self) -> None:
        """Look whether the positions fit the printer; raises the error of a configuration."""
        self.host.connect()
        self.height.watch_motors()
        limits = self.host.axes.limits()
        try:
            checks.check_reach(self.settings, limits)
            if self.installed.is_z_endstop():
                xy = checks.check_homing(self.settings, limits)
                self.probe.homing.xy = xy
        except checks.Misfit as e:
            raise self.host.printer.config_error(
                f"Option '{e.name}' in section '{self.host.section}': {e.problem}"
            )

    def start_notes(self) -> List[str]:
        """Return what the user is told when klippy is ready."""
        notes = self.old_names.notes + self.installed.notes
        settings, dock = self.settings, self.settings.dock_position
        is_known = settings.mesh is not None and settings.is_placed
        if is_known and path.is_within(dock[:2], settings.mesh or ()):
            notes.append(
                f"dock_position ({dock.x:g}, {dock.y:g}) lies where the toolhead goes"
                " while the bed mesh is probed; make the mesh smaller, or move the"
                " dock"
            )
        unknown = unknown_commands.of(self.host.printer)
        notes += unknown.notes(self.host.section)
        return notes + self._homing_notes()

    def _homing_notes(self) -> List[str]:
        """Return where homing goes across the dock after a restart."""
        settings, ends = self.settings, self.host.axes.xy_ends()
        x, y, _z = settings.detach_position
        is_left_there = settings.is_placed and not settings.restore_toolhead
        zone = self.moves.zone
        if not is_left_there or path.is_clear_for_homing((x, y), ends, zone):
            return []
        return [
            f"restore_toolhead: False leaves the toolhead at detach_position ({x:g},"
            f" {y:g}), from where homing X and Y after a restart goes across the"
            " dock; set it to True, or choose a detach_position on the other side"
        ]

    def detach_probe(self) -> None:
        """Dock the probe before Z is homed, the toolhead then where it was.

        Of this name for Kalico's safe_z_home, since 2026-02-24 (9500bd614).
        """
        self.probe.dock_and_come_back()

    @property
    def detach_dockable_before_z_home(self) -> bool:
        """Whether it is docked then; of this name for Kalico's safe_z_home."""
        return self.before_homing.docks_before_z()

    @property
    def auto_attach_detach(self) -> bool:
        """Whether commands go to the dock by themselves; z_calibration asks."""
        return self.probe.keeping.auto

    def get_status(self, eventtime: float) -> Status:
        """Return what macros read."""
        status = dict(self.installed.get_status(eventtime))
        # Kalico's numbers under Kalico's name
        status["last_status"] = STATES.index(self.sensors.last_state)
        status["last_status_name"] = self.sensors.last_state
        status["auto_attach_detach"] = self.probe.keeping.auto
        status["notes"] = list(self.notes.texts)
        return status

    ######################################################################
    # Commands: where the probe is
    ######################################################################

    cmd_GET_PROBE_STATUS_help = "Tell where the probe is"

    def cmd_GET_PROBE_STATUS(self, gcmd: GCodeCommand) -> None:
        """Tell where the probe is, and what the pins read."""
        state = self.sensors.look()
        gcmd.respond_info(f"Probe Status: {state}")
        self.host.say(self.sensors.describe())
        if state == DOCKED and self.sensors.is_doubtful():
            self.host.say(
                "it was not seen docked: it may be on the toolhead, its wire"
                f" broken; {IF_DOCKED}"
            )

    cmd_QUERY_DOCKABLE_PROBE_help = cmd_GET_PROBE_STATUS_help
    cmd_QUERY_DOCKABLE_PROBE = cmd_GET_PROBE_STATUS

    cmd_SET_PROBE_STATUS_help = "Tell where you have put the probe by hand"

    def cmd_SET_PROBE_STATUS(self, gcmd: GCodeCommand) -> None:
        """Note where the user has put the probe; an error if the pins say otherwise."""
        state, states = gcmd.get("STATE").upper(), (ATTACHED, DOCKED, UNKNOWN)
        if state not in states:
            raise options.param_error(gcmd, "STATE", ", ".join(states))
        self.host_commands.end_asking_again()
        seen = self.sensors.look()
        if state not in (UNKNOWN, seen):
            raise self.host.error(
                f"STATE={state}, but the probe is {seen}"
                f" ({self.sensors.describe()}); put it there first"
            )
        self.known.be_told(state)
        self.probe.keeping.hold(state == ATTACHED)

    cmd_SET_DOCKABLE_PROBE_help = "Switch going to the dock by itself on or off"

    def cmd_SET_DOCKABLE_PROBE(self, gcmd: GCodeCommand) -> None:
        """Switch going to the dock by itself on or off."""
        self.host_commands.end_asking_again()
        name, keeping = "AUTO_ATTACH_DETACH", self.probe.keeping
        keeping.set_auto(options.param_flag(gcmd, name, keeping.auto))

    ######################################################################
    # Commands: trips to the dock, and their parts
    ######################################################################

    cmd_ATTACH_PROBE_help = "Fetch the probe"

    def cmd_ATTACH_PROBE(self, gcmd: GCodeCommand) -> None:
        """Fetch the probe, to stay."""
        self.host_commands.end_asking_again()
        with self.host.as_command_error(gcmd):
            # The nozzle is lowered onto the paper next
            command.check_no_manual_probe(self.host)
        self.dock.check_no_print()
        self.low_moves.is_led = False
        # Until it was fetched it is not to stay
        self.probe.keeping.hold(False)
        goal = self.moves.position()
        if self.sensors.is_proven(ATTACHED):
            # It is told that it will be used, wherever it was
            self.dock.activate()
        self.dock.fetch(goal if self.settings.restore_toolhead else None)
        self.probe.keeping.hold(True)

    cmd_DETACH_PROBE_help = "Dock the probe"

    def cmd_DETACH_PROBE(self, _gcmd: GCodeCommand) -> None:
        """Dock the probe."""
        self.probe.keeping.hold(False)
        if not self.probe.dock_and_return():
            # It is told that it was used, wherever it is
            self.dock.deactivate()

    cmd_MOVE_TO_APPROACH_PROBE_help = "Move to approach_position"

    def cmd_MOVE_TO_APPROACH_PROBE(self, _gcmd: GCodeCommand) -> None:
        """Move to approach_position."""
        self.dock.approach()

    cmd_MOVE_TO_DOCK_PROBE_help = "Move into the dock"

    def cmd_MOVE_TO_DOCK_PROBE(self, _gcmd: GCodeCommand) -> None:
        """Move into the dock."""
        self.dock.enter()

    cmd_MOVE_TO_EXTRACT_PROBE_help = "Move out of the dock, with the probe"

    def cmd_MOVE_TO_EXTRACT_PROBE(self, _gcmd: GCodeCommand) -> None:
        """Move out of the dock, with the probe."""
        self.dock.extract()

    cmd_MOVE_TO_INSERT_PROBE_help = "Move to insert_position"

    def cmd_MOVE_TO_INSERT_PROBE(self, _gcmd: GCodeCommand) -> None:
        """Move to insert_position."""
        self.dock.insert()

    cmd_MOVE_TO_DETACH_PROBE_help = "Move out of the dock, without the probe"

    def cmd_MOVE_TO_DETACH_PROBE(self, _gcmd: GCodeCommand) -> None:
        """Move out of the dock, without the probe."""
        self.dock.detach()

    cmd_MOVE_AVOIDING_DOCK_help = "Move to X and Y around the dock"

    def cmd_MOVE_AVOIDING_DOCK(self, gcmd: GCodeCommand) -> None:
        """Move to X and Y around the dock."""
        self.moves.require_homed("xy")
        start = self.moves.position()
        x = options.param_number(gcmd, "X", start.x)
        y = options.param_number(gcmd, "Y", start.y)
        speed = options.param_number(
            gcmd, "SPEED", self.settings.travel_speed, above=0.0
        )
        self.dock.around(Position(x, y, None), speed)
