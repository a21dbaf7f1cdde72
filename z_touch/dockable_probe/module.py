# The object behind [dockable_probe]: its commands, its status, and how its
# parts are put together.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import contextlib
import functools
import logging

from .. import __version__, options
from .. import command as running
from .. import progress as notes
from ..errors import CalibrationError
from ..host import printer as host
from ..host import unknown_commands
from . import checks, detour
from .carrier import Carrier
from .docking import DOCK, FETCH, IF_DOCKED, Docking
from .gcode_moves import GcodeMoves
from .homing import BeforeHoming
from .moves import Moves
from .prober import Prober
from .sensors import ATTACHED, DOCKED, UNKNOWN, Sensors
from .settings import read_settings
from .setup import Setup
from .virtual_probe import VirtualProbe

# As Kalico's own counts them
STATES = (UNKNOWN, ATTACHED, DOCKED)


# The object behind [dockable_probe]
class DockableProbe:
    def __init__(self, config):
        logging.info("dockable_probe %s", __version__)
        checks.check_only_probe(config)
        self.host = host.Host(config)
        checks.check_kinematics(config, self.host.axes.z_axis)
        old_names = options.OldNames(config)
        settings = read_settings(config, self.host, old_names)
        checks.check_positions(config, settings, old_names.notes)
        read_notes = functools.partial(self.start_notes, old_names)
        self.notes = notes.Notes(self.host, read_notes)
        self.settings = settings
        self.sensors = Sensors(config, self.host, settings)
        self.moves = Moves(self.host, settings)
        self.docking = Docking(settings, self.sensors, self.moves)
        self.prober = Prober(self.docking, settings)
        self.virtual_probe = VirtualProbe(self.host)
        carrier = Carrier(self.prober, self.virtual_probe.is_by_paper)
        GcodeMoves(self.prober, carrier)
        self.virtual_probe.install(
            config, self.prober, self.sensors.pin.endstop, settings
        )
        self.before_homing = BeforeHoming(
            self.prober,
            self.virtual_probe.is_z_endstop,
            checks.is_lifted_elsewhere(config),
        )
        register = self.host.printer.register_event_handler
        register("klippy:connect", self.connect)
        running.register_commands(self.host, self)
        Setup(self)

    # Another dock for a while, as it is tried before it is saved
    @contextlib.contextmanager
    def trying(self, settings):
        before = self.settings
        try:
            self._use(settings)
            yield
        finally:
            self._use(before)

    def _use(self, settings):
        self.settings = settings
        for part in (self.moves, self.docking, self.prober):
            part.use(settings)

    ######################################################################
    # What the host tells
    ######################################################################

    def connect(self):
        self.host.connect()
        # Of one motor alone nobody tells that it is off, but its enable line.
        self.host.axes.watch_z_enabling(
            lambda print_time, is_on: is_on or self.moves.forget()
        )
        limits = self.host.axes.limits()
        try:
            checks.check_reach(self.settings, limits)
            if self.virtual_probe.is_z_endstop():
                self.prober.homing.home_over(
                    checks.check_homing(self.settings, limits)
                )
        except checks.Misfit as e:
            raise self.host.printer.config_error(
                "Option '%s' in section '%s': %s"
                % (e.name, self.host.section, e.problem)
            )

    # What the user is told when klippy is ready
    def start_notes(self, old_names):
        notes = old_names.notes + self.virtual_probe.notes
        dock, mesh = self.settings.dock_position[:2], self.settings.mesh
        is_known = mesh is not None and self.settings.is_placed
        if is_known and detour.is_within(dock, mesh):
            notes.append(
                "dock_position (%g, %g) lies where the head goes while the bed"
                " mesh is probed; make the mesh smaller, or move the dock"
                % dock
            )
        notes += unknown_commands.of(self.host.printer).notes(self.host.section)
        return notes + self.homing_notes()

    # After a restart, or with motors that were off, nobody knows where the head is
    def homing_notes(self):
        place, ends = self.settings.detach_position, self.host.axes.xy_ends()
        is_left_there = (
            self.settings.is_placed and not self.settings.restore_toolhead
        )
        if not is_left_there or detour.is_clear_for_homing(
            place, ends, self.moves.zone
        ):
            return []
        return [
            "restore_toolhead: False leaves the head at detach_position (%g, %g),"
            " from where homing X and Y after a restart goes across the dock; set"
            " it to True, or choose a detach_position on the other side"
            % place[:2]
        ]

    # Before Z is homed: the head ends where it was.  Of this name for Kalico's
    # safe_z_home, since 2026-02-24 (9500bd614)
    def detach_probe(self):
        self.prober.dock_and_come_back()

    # Of this name for Kalico's safe_z_home
    @property
    def detach_dockable_before_z_home(self):
        return self.before_homing.docks_before_z()

    # For z_calibration, which holds the probe for a while
    @property
    def auto_attach_detach(self):
        return self.prober.holder.auto

    def get_status(self, eventtime):
        status = dict(self.virtual_probe.get_status(eventtime))
        # Kalico's numbers under Kalico's name
        status["last_status"] = STATES.index(self.sensors.last_state)
        status["last_status_name"] = self.sensors.last_state
        status["auto_attach_detach"] = self.prober.holder.auto
        status["notes"] = list(self.notes.texts)
        return status

    ######################################################################
    # Commands: where the probe is
    ######################################################################

    cmd_GET_PROBE_STATUS_help = "Tell where the probe is"

    def cmd_GET_PROBE_STATUS(self, gcmd):
        state = self.sensors.look()
        gcmd.respond_info("Probe Status: %s" % (state,))
        self.host.say(self.sensors.describe())
        if state == DOCKED and self.sensors.is_doubtful():
            self.host.say(
                "nobody has seen it docked: it may hang on the head, its wire"
                " broken; " + IF_DOCKED
            )

    cmd_QUERY_DOCKABLE_PROBE_help = cmd_GET_PROBE_STATUS_help
    cmd_QUERY_DOCKABLE_PROBE = cmd_GET_PROBE_STATUS

    cmd_SET_PROBE_STATUS_help = "Tell where you have put the probe by hand"

    def cmd_SET_PROBE_STATUS(self, gcmd):
        state, states = gcmd.get("STATE").upper(), (ATTACHED, DOCKED, UNKNOWN)
        if state not in states:
            raise options.param_error(gcmd, "STATE", ", ".join(states))
        seen = self.sensors.look()
        if state not in (UNKNOWN, seen):
            raise self.host.error(
                "STATE=%s, but the probe is %s (%s); put it there first"
                % (state, seen, self.sensors.describe())
            )
        self.sensors.be_told(state)
        self.prober.holder.hold(state == ATTACHED)

    cmd_SET_DOCKABLE_PROBE_help = "Switch going to the dock by itself on or off"

    def cmd_SET_DOCKABLE_PROBE(self, gcmd):
        name, auto = "AUTO_ATTACH_DETACH", self.prober.holder.auto
        auto = options.param_int(gcmd, name, auto, minval=0, maxval=1)
        self.prober.holder.set_auto(bool(auto))

    ######################################################################
    # Commands: trips to the dock, and their parts
    ######################################################################

    cmd_ATTACH_PROBE_help = "Fetch the probe"

    def cmd_ATTACH_PROBE(self, gcmd):
        try:
            # The nozzle is lowered onto the paper next.
            running.check_no_manual_probe(self.host)
        except CalibrationError as e:
            raise self.host.error(str(e))
        # Until it was fetched nobody holds it.
        self.prober.holder.hold(False)
        goal = self.moves.position()
        if self.sensors.confirm() == self.sensors.proven == ATTACHED:
            # It is told that it will be used, wherever it was.
            self.docking.activate()
        self.docking.fetch(goal if self.settings.restore_toolhead else None)
        self.prober.holder.hold(True)

    cmd_DETACH_PROBE_help = "Dock the probe"

    def cmd_DETACH_PROBE(self, gcmd):
        self.prober.holder.hold(False)
        if not self.prober.dock_and_return(self.moves.position()):
            # It is told that it was used, wherever it is.
            self.docking.deactivate()

    cmd_MOVE_TO_APPROACH_PROBE_help = "Move to approach_position"

    def cmd_MOVE_TO_APPROACH_PROBE(self, gcmd):
        self.moves.go_beside(self.settings.approach_position)

    cmd_MOVE_TO_DOCK_PROBE_help = "Move into the dock"

    def cmd_MOVE_TO_DOCK_PROBE(self, gcmd):
        settings, moves = self.settings, self.moves
        beside = settings.approach_position
        # From where the head stands, where that is before the dock already
        if not moves.is_at(beside) and (
            moves.is_at(settings.insert_position)
            or self.sensors.look() == ATTACHED
        ):
            beside = settings.insert_position
        self.docking.go_in(beside)

    cmd_MOVE_TO_EXTRACT_PROBE_help = "Move out of the dock, with the probe"

    def cmd_MOVE_TO_EXTRACT_PROBE(self, gcmd):
        settings = self.settings
        self.docking.go_out(
            FETCH, settings.extract_position, settings.attach_speed
        )

    cmd_MOVE_TO_INSERT_PROBE_help = "Move to insert_position"

    def cmd_MOVE_TO_INSERT_PROBE(self, gcmd):
        self.moves.go_beside(self.settings.insert_position)

    cmd_MOVE_TO_DETACH_PROBE_help = "Move out of the dock, without the probe"

    def cmd_MOVE_TO_DETACH_PROBE(self, gcmd):
        settings = self.settings
        self.docking.go_out(
            DOCK, settings.detach_position, settings.detach_speed
        )

    cmd_MOVE_AVOIDING_DOCK_help = "Move to X and Y around the dock"

    def cmd_MOVE_AVOIDING_DOCK(self, gcmd):
        self.moves.require_homed("xy")
        number = functools.partial(options.param_number, gcmd)
        start = self.moves.position()
        goal = detour.Position(number("X", start.x), number("Y", start.y), None)
        speed = number("SPEED", self.settings.travel_speed, above=0.0)
        with self.docking.putting_away():
            self.moves.travel_beside(goal, speed)
