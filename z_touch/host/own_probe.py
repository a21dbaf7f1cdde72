"""A probe of ours as the printer's object 'probe', which the host's commands ask to touch.

PROBE, BED_MESH_CALIBRATE and G28 with the probe want an object with methods of the host's
own.  What that is made of differs:

  host                            'probe' is
  since 2024-06-10 (d4bae4dff)    our OwnProbe, around a Facade
  before, Kalico, QIDI            the host's PrinterProbe, around a Facade

The host's newer helpers are not used: they would have to be imported, and change each year.
The Facade is an endstop to both.  Behind it is a Device, which is told of everything that
begins and ends.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import importlib
import logging
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    List,
    Optional,
    Protocol,
    Sequence,
    Tuple,
)

from .. import options, sampling
from ..errors import SamplesDiffer
from .probe import SAMPLING_NAMES

if TYPE_CHECKING:
    from ..sampling import Sampling
    from .klippy import Config, GCodeCommand, Status
    from .printer import Host

# What to do about samples that differ
DIFFER = "clean the nozzle and check the probe for play"


class ProbeOptions(Protocol):
    """What the section of a probe says (mm)."""

    @property
    def x_offset(self) -> float:
        """X from the nozzle to the probe."""

    @property
    def y_offset(self) -> float:
        """Y from the nozzle to the probe."""

    @property
    def z_offset(self) -> float:
        """How far it triggers below the nozzle."""

    @property
    def sampling(self) -> Sampling:
        """How a point is touched."""

    @property
    def drop_first_result(self) -> bool:
        """Whether one touch before the samples does not count."""


class Device(Protocol):
    """What a probe does around the host's touches; heights are toolhead Z (mm)."""

    def begin(self, is_homing: bool) -> None:
        """Do what a command needs that probes.  May pause."""

    def end(self) -> None:
        """Do what has to follow such a command, also a failed one.  May pause."""

    def before_move(self) -> None:
        """Look whether a probing move may begin.  May pause."""

    def after_move(self, moved: bool, triggered: bool) -> None:
        """Look at the probe after a probing move.  May pause."""

    def floor(self, is_homing: bool) -> float:
        """Return the lowest end of a touch."""

    def floor_everywhere(self, is_raised: bool) -> float:
        """Return the same for a host that asks once.

        'is_raised': it has each target raised, see raised().
        """

    def raised(self, z: float) -> float:
        """Return a target as high as it has to be where the toolhead stands."""

    def homing_reach(self) -> Optional[float]:
        """Return how far (mm) below z_offset the homing move may go that comes next.

        None: nothing tells how high the toolhead is.
        """


######################################################################
# The endstop of the probe
######################################################################


class Facade:
    """The endstop of the probe as the host's probing wants to see it.

    It is the chip of pins, too, whose z_virtual_endstop it is.
    """

    def __init__(
        self, host: Host, device: Device, endstop: Any, z_offset: float
    ):
        self.host = host
        self.device = device
        self.z_offset = z_offset
        self.is_homing, self.trigger_time = False, 0.0
        self.endstop = endstop
        self.get_mcu = endstop.get_mcu
        self.add_stepper = endstop.add_stepper
        self.get_steppers = endstop.get_steppers
        self.home_start = endstop.home_start
        self.query_endstop = endstop.query_endstop

    def home_wait(self, home_end_time: float) -> float:
        """Wait for the end of a move; return the print time of the trigger, 0: none."""
        self.trigger_time = self.endstop.home_wait(home_end_time)
        return self.trigger_time

    def get_position_endstop(self) -> float:
        """Return the toolhead Z (mm) of the trigger, by which homing sets Z."""
        return self.z_offset

    # As a probe of hosts until 2024-06-10 (d4bae4dff), Kalico, QIDI; the parameter is
    # Kalico's

    def multi_probe_begin(self, always_restore_toolhead: bool = False) -> None:
        """Begin a command that probes."""
        self.device.begin(self.is_homing)

    def multi_probe_end(self) -> None:
        """End it."""
        self.device.end()

    def probe_prepare(self, hmove: Any) -> None:
        """Begin a probing move."""
        if self.is_homing:
            self.shorten(self.z_offset)
        self.device.before_move()

    def probe_finish(self, hmove: Any) -> None:
        """End it."""
        moved = hmove.check_no_movement() is None
        self.device.after_move(moved, self.trigger_time > 0.0)

    def probing_move(
        self,
        pos: List[float],
        speed: float,
        gcmd: Optional[GCodeCommand] = None,
    ) -> Sequence[float]:
        """Move down until it triggers.

        Asked for since 2024-04-09 (acdf8bb10), by Kalico with 'gcmd' since 2025-12-14
        (e8182b7f0), as Kalico's own probes have it.
        """
        homing = self.host.printer.lookup_object("homing")
        pos[2] = self.device.raised(pos[2])
        trigger: Sequence[float] = homing.probing_move(self, pos, speed)
        return trigger

    def shorten(self, end: float) -> None:
        """Have a homing move end no deeper than it may.

        It goes down to 'end' (toolhead Z, mm) from wherever Z is said to be, so Z is set.
        """
        reach, toolhead = self.device.homing_reach(), self.host.toolhead
        if reach is not None:
            position = toolhead.get_position()
            position[2] = end + reach
            toolhead.set_position(position)

    def setup_pin(self, pin_type: str, pin_params: Dict[str, Any]) -> Facade:
        """Return itself as probe:z_virtual_endstop, as a chip of pins does."""
        pins = self.host.printer.lookup_object("pins")
        if pin_type != "endstop" or pin_params["pin"] != "z_virtual_endstop":
            raise pins.error(
                "the probe is an endstop_pin only, as z_virtual_endstop"
            )
        if pin_params["invert"] or pin_params["pullup"]:
            raise pins.error("probe:z_virtual_endstop takes neither ! nor ^")
        return self


######################################################################
# The object 'probe', and its session
######################################################################


class OwnProbe:
    """The printer's object 'probe' where the host has no class that takes an endstop.

    That is since 2024-06-10 (d4bae4dff).  It is its own session, too: one command probes at
    a time.
    """

    def __init__(
        self,
        config: Config,
        facade: Facade,
        settings: ProbeOptions,
        module: Any,
    ):
        self.host = facade.host
        self.device = facade.device
        self.mcu_probe = facade
        self.settings = settings
        # Since 2025-12-20 (9ccb4d96e)
        manual_probe = host_module("manual_probe")
        self.result_class: Any = getattr(manual_probe, "ProbeResult", None)
        gcode = config.get_printer().lookup_object("gcode")
        # In place of a command: no parameter is given
        self.no_command = gcode.create_gcode_command("", "", {})
        # Whether a command probes, and its results since they were pulled last
        self.is_under_way = False
        self.results: List[Any] = []
        # The commands of the host; the same since 2024-06-10 (8fc11b4a2)
        helper = module.ProbeCommandHelper(config, self, facade.query_endstop)
        self.get_status = helper.get_status

    def get_offsets(
        self, gcmd: Optional[GCodeCommand] = None
    ) -> Tuple[float, float, float]:
        """Return X, Y and Z (mm) from the nozzle to the probe."""
        settings = self.settings
        return settings.x_offset, settings.y_offset, settings.z_offset

    def _sampling(self, gcmd: GCodeCommand) -> Sampling:
        return options.param_sampling(gcmd, self.settings.sampling)

    def get_probe_params(
        self, gcmd: Optional[GCodeCommand] = None
    ) -> Dict[str, Any]:
        """Return how a command samples, as the host names it."""
        names = [name for name, _ in SAMPLING_NAMES]
        return dict(zip(names, self._sampling(gcmd or self.no_command)))

    ##################################################################
    # A session
    ##################################################################

    def start_probe_session(self, gcmd: GCodeCommand) -> OwnProbe:
        """Begin a command that probes.  May pause."""
        if self.is_under_way:
            raise gcmd.error(
                f"{self.host.section}: a command that probes is under way; start"
                " another one when it has ended"
            )
        # Homing comes here since 2026-05-25 (43baf9b83)
        self.device.begin(gcmd.get_command() == "G28")
        self.begin_session()
        return self

    def begin_session(self) -> None:
        """Note that a command probes from now on."""
        self.is_under_way, self.results = True, []

    def end_probe_session(self) -> None:
        """End it, unless it has ended already.  May pause."""
        if self.is_under_way:
            self.is_under_way = False
            self.device.end()

    def pull_probed_results(self) -> List[Any]:
        """Return the results since the last call."""
        results, self.results = self.results, []
        return results

    def run_probe(self, gcmd: GCodeCommand) -> Any:
        """Touch a point.  May pause.

        Returns the result, too: until 2024-06-14 (1591a51f7).
        """
        wanted = self._sampling(gcmd)
        # Homing takes one sample only
        is_homing = gcmd.get_command() == "G28"
        if self.settings.drop_first_result and not is_homing:
            self._touch(gcmd, wanted.speed)
            self._retract(wanted)
        touches: List[Any] = []

        def touch() -> float:
            """Touch once more; return the toolhead Z (mm) of the trigger."""
            if touches:
                self._retract(wanted)
            touches.append(self._touch(gcmd, wanted.speed))
            z: float = touches[-1][2]
            return z

        try:
            heights = sampling.collect(touch, wanted, gcmd.respond_info, DIFFER)
        except SamplesDiffer as e:
            raise gcmd.error(f"{self.host.section}: {e}")
        z = sampling.summarize(heights, wanted.result)
        result = self._shifted(touches[-1], z - heights[-1])
        self.results.append(result)
        return result

    def _touch(self, gcmd: GCodeCommand, speed: float) -> Any:
        """Touch once, and return that as the host has results."""
        is_homing = gcmd.get_command() == "G28"
        if not is_homing and not self.host.is_homed("z"):
            raise gcmd.error("Must home before probe")
        facade = self.mcu_probe
        floor = self.device.floor(is_homing)
        self.host.motion.require_running()
        if is_homing:
            facade.shorten(floor)
        target = self.host.toolhead.get_position()
        target[2] = min(floor, target[2])
        result = self._result(facade.probing_move(target, speed))
        if not is_homing:
            x, y, z = result[:3]
            gcmd.respond_info(f"probe at {x:.3f},{y:.3f} is z={z:.6f}")
        return result

    def _retract(self, wanted: Sampling) -> None:
        z = self.host.motion.z() + wanted.retract_dist
        self.host.toolhead.manual_move([None, None, z], wanted.lift_speed)

    def _result(self, trigger: Sequence[float]) -> Any:
        """Return a result: where the bed is, where the toolhead was.

        Records since 2026-01-21 (2a1027ce4).  The event is for axis_twist_compensation, since
        2024-06-20 (e780049a7).
        """
        head = list(trigger[:3])
        if self.result_class is None:
            # What receives the event may change it
            self.host.printer.send_event("probe:update_results", head)
            return head
        x, y, z = self.get_offsets()
        bed = [head[0] + x, head[1] + y, head[2] - z]
        results = [self.result_class(*bed, *head)]
        self.host.printer.send_event("probe:update_results", results)
        return results[0]

    def _shifted(self, result: Any, dz: float) -> Any:
        """Return a result by so much (mm) higher."""
        if self.result_class is None:
            return [result[0], result[1], result[2] + dz]
        return result._replace(
            bed_z=result.bed_z + dz, test_z=result.test_z + dz
        )

    def twist(self, position: Sequence[float]) -> float:
        """Return what it adds there to the height of the bed (mm), outside a session."""
        result = self._result(position)
        if self.result_class is None:
            added: float = result[2] - position[2]
        else:
            added = result.bed_z + self.settings.z_offset - result.test_z
        return added


######################################################################
# On any host
######################################################################


def host_module(name: str) -> Any:
    """Return a module of the host, a neighbour of the folder z_touch."""
    package = __name__.rsplit(".", 3)[0]
    return importlib.import_module(f"{package}.{name}")


class Installed:
    """The printer's 'probe' on any host.

    Which object that is depends on what the host has, never on a version.
    """

    def __init__(
        self,
        config: Config,
        host: Host,
        device: Device,
        endstop: Any,
        settings: ProbeOptions,
    ):
        """Make the printer's 'probe' of a device with this endstop."""
        self.host = host
        self.printer = host.printer
        # What the user is told when klippy is ready
        self.notes: List[str] = []
        # Hosts would speak of chips of pins and objects that are there twice
        if self.printer.lookup_object("probe", None) is not None:
            raise config.error(
                f"Section '{config.get_name()}': there is a [probe] (or another"
                " section that is one) already, and a printer has one probe; remove"
                " the other"
            )
        self.facade = Facade(host, device, endstop, settings.z_offset)
        register = self.printer.register_event_handler
        # Before the host's own, that it knows what the session is for
        register("homing:home_rails_begin", self._homing_begins)
        register("gcode:command_error", self._homing_ends)
        module = host_module("probe")
        # None: the host's own class is the probe, and it keeps the sessions
        self.own: Optional[OwnProbe] = None
        self.probe: Any
        if hasattr(module, "ProbeCommandHelper"):
            self.own = OwnProbe(config, self.facade, settings, module)
            self.probe = self.own
            self._serve_sessions()
        else:
            self.probe = self._host_probe(config, settings, module)
        register("homing:home_rails_end", self._homing_ends)
        host.endstops.stops_z(self.facade)
        self.printer.add_object("probe", self.probe)

    def _host_probe(
        self, config: Config, settings: ProbeOptions, module: Any
    ) -> Any:
        """Return the host's PrinterProbe: until 2024-06-10 (d4bae4dff), Kalico, QIDI."""
        probe = module.PrinterProbe(config, self.facade)
        # The wrapper of its own pin moves by itself where it asks ours for that
        moves = hasattr(module.ProbeEndstopWrapper, "probing_move")
        floor = self.facade.device.floor_everywhere(moves)
        # It has read position_min, and no method says how deep its touches may go
        probe.z_position = max(probe.z_position, floor)
        can_drop = hasattr(probe, "drop_first_result")
        if settings.drop_first_result and not can_drop:
            self.notes.append("drop_first_result needs a newer Klipper")
        return probe

    def _serve_sessions(self) -> None:
        pins = self.printer.lookup_object("pins")
        pins.register_chip("probe", self.facade)
        register = self.printer.register_event_handler
        # Homing comes in these events until 2026-05-25 (43baf9b83)
        register("homing:home_rails_begin", self._rails_begin)
        register("homing:home_rails_end", self._rails_end)
        register("homing:homing_move_begin", self._move_begins)
        register("homing:homing_move_end", self._move_ends)
        register("gcode:command_error", self._command_error)

    def get_status(self, eventtime: float) -> Status:
        """Return what macros read of a probe."""
        status: Status = self.probe.get_status(eventtime)
        return status

    def is_by_paper(self, method: str) -> bool:
        """Return whether that METHOD of levelling or a mesh may be a person with paper.

        To hosts without sessions whatever they do not know is.
        """
        if self.own is not None:
            return method == "manual"
        return method != "automatic"

    def is_z_endstop(self) -> bool:
        """Return whether Z is homed with the probe."""
        kinematics = self.host.toolhead.get_kinematics()
        rails = list(getattr(kinematics, "rails", []))
        # generic_cartesian, since 2025-05-06 (cc6736c3e)
        for carriage in getattr(kinematics, "carriages", {}).values():
            rails.append(carriage.get_rail())
        return self._is_among(rails)

    def _is_among(self, rails: Sequence[Any]) -> bool:
        pairs = [pair for rail in rails for pair in rail.get_endstops()]
        return self.facade in [endstop for endstop, _ in pairs]

    def _homing_begins(self, _homing_state: Any, rails: Sequence[Any]) -> None:
        self.facade.is_homing = self._is_among(rails)

    def _homing_ends(self, *_unused: Any) -> None:
        self.facade.is_homing = False

    def _rails_begin(self, _homing_state: Any, rails: Sequence[Any]) -> None:
        if self.own is not None and self._is_among(rails):
            self.facade.multi_probe_begin()
            self.own.begin_session()

    def _rails_end(self, _homing_state: Any, rails: Sequence[Any]) -> None:
        if self.own is not None and self._is_among(rails):
            self.own.end_probe_session()

    def _move_begins(self, hmove: Any) -> None:
        if self.facade in hmove.get_mcu_endstops():
            self.facade.probe_prepare(hmove)

    def _move_ends(self, hmove: Any) -> None:
        if self.facade in hmove.get_mcu_endstops():
            self.facade.probe_finish(hmove)

    def _command_error(self) -> None:
        """End the session of a command that has failed, whose error is not to be hidden."""
        assert self.own is not None
        try:
            self.own.end_probe_session()
        except self.printer.command_error:
            logging.exception("%s: ending the session", self.host.section)
