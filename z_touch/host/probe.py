"""The printer's probe: what it adds, its session, and where its touches end.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import contextlib
from typing import (
    TYPE_CHECKING,
    Any,
    Dict,
    Iterator,
    NamedTuple,
    Sequence,
    Tuple,
)

from ..sampling import Sampling
from . import endstops

if TYPE_CHECKING:
    from .klippy import Config, Endstop
    from .printer import Host


class Probed(NamedTuple):
    """A touch of the probe: toolhead Z (mm) of the trigger.

    'twist' (mm) is what the host adds to that for a twisted X axis.
    """

    z: float
    twist: float


# Asks a person at each point, and forgets the twist that it knew
TWIST = "AXIS_TWIST_COMPENSATION_CALIBRATE"

# Of the fields of Sampling, in a probe's parameters and as its attributes
SAMPLING_NAMES = (
    ("samples", "sample_count"),
    ("samples_tolerance", "samples_tolerance"),
    ("samples_tolerance_retries", "samples_retries"),
    ("samples_result", "samples_result"),
    ("probe_speed", "speed"),
    ("sample_retract_dist", "sample_retract_dist"),
    ("lift_speed", "lift_speed"),
)


class ProbeSession:
    """The host's own probing, with its activation, from its begin to its end."""

    def __init__(self, probing: Probing, params: Dict[str, str]):
        self.probing = probing
        host, probe = probing.host, probing.probe
        self.gcmd = host.gcode.create_gcode_command("", "", params)
        self.has_sessions = hasattr(probe, "start_probe_session")
        if self.has_sessions:
            # Since 2024-06-10 (bec47e049)
            self.session = probe.start_probe_session(self.gcmd)
        else:
            self.session = probe
            probe.multi_probe_begin()

    def touch(self) -> Probed:
        """Touch once where the toolhead stands.  May pause."""
        host, probe = self.probing.host, self.probing.probe
        position = host.toolhead.get_position()
        host.motion.require_running()
        result = self.session.run_probe(self.gcmd)
        if hasattr(self.session, "pull_probed_results"):
            # Since 2024-06-14 (1591a51f7)
            result = self.session.pull_probed_results()[-1]
        if hasattr(result, "bed_z"):
            # A record since 2026-01-21 (2a1027ce4)
            twist = result.bed_z + probe.get_offsets()[2] - result.test_z
            return Probed(result.test_z, twist)
        twist = self.probing.host_twist(position)
        return Probed(result[2] - twist, twist)

    def end(self) -> None:
        """End the session; the host may stow or dock the probe.  May pause."""
        if self.has_sessions:
            self.session.end_probe_session()
        else:
            self.session.multi_probe_end()


class Probing:
    """The object 'probe' of the host, whichever section has made it."""

    def __init__(self, config: Config, host: Host):
        self.host = host
        # None: a section that is not known here, or none
        self.section = endstops.find_probe_section(config)
        self.printer = host.printer
        self._puts_away = config.has_section("probe") and bool(
            config.getsection("probe").get("deactivate_gcode", "").strip()
        )
        # Exists from klippy:connect on; None: the printer has none
        self.probe: Any = None

    def connect(self) -> None:
        """Look the probe up; it exists at klippy:connect."""
        self.probe = self.printer.lookup_object("probe", None)

    def offsets(self) -> Sequence[float]:
        """Return X, Y and Z (mm) from the nozzle to the probe."""
        offsets: Sequence[float] = self.probe.get_offsets()
        return offsets

    def z_offset(self) -> float:
        """Return the probe's z_offset (mm), 0 where there is none."""
        get_offsets = getattr(self.probe, "get_offsets", None)
        return get_offsets()[2] if get_offsets else 0.0

    def homed_bed_z(self) -> float:
        """Return where (toolhead Z, mm) the probe sees the bed right after G28.

        At 0, except where position_endstop counts, see Axes.probe_homes_to().
        """
        homed_z = self.host.axes.probe_homes_to()
        return 0.0 if homed_z is None else homed_z - self.offsets()[2]

    def homed_probe_z(self) -> float:
        """Return where (toolhead Z, mm) the probe triggers there."""
        return self.homed_bed_z() + self.offsets()[2]

    def endstop(self) -> Any:
        """Return the switch of the probe, None where it has none.

        'mcu_probe' is an endstop itself (moving it runs activate_gcode) until 2026-05-25
        (43baf9b83); since then the endstop is inside it.  Looked up at each use: QIDI's
        hosts exchange its methods at run time.
        """
        outer = getattr(self.probe, "mcu_probe", None)
        for candidate in (outer, getattr(outer, "mcu_endstop", None)):
            if endstops.is_endstop(candidate):
                return candidate
        return None

    def bare_endstop(self) -> Any:
        """Return the switch of the probe whose moves run no G-code of the user.

        Until 2026-05-25 (43baf9b83) the host runs activate_gcode and deactivate_gcode of
        [probe] around a move of any kind that endstop() stops, and the probe need not be
        where it was then.
        """
        outer = self.endstop()
        inner = getattr(outer, "mcu_endstop", None)
        home_start = getattr(outer, "home_start", None)
        # A dock or QIDI's hosts have one of their own
        is_same = home_start and home_start == getattr(inner, "home_start", 0)
        return inner if is_same else outer

    def has_deactivate_gcode(self) -> bool:
        """Return whether the host may put the probe away after its own probing.

        By deactivate_gcode of [probe]; dockable ones are asked where they are.
        """
        return self._puts_away

    def puts_away_each_time(self) -> bool:
        """Return whether it may do so after each touch."""
        wrapper = getattr(self.probe, "mcu_probe", None)
        each: bool = getattr(wrapper, "stow_on_each_sample", False)
        return self._puts_away and each

    def reads_triggered(self, print_time: float) -> bool:
        """Return whether the probe's switch reads triggered at a print time.  May pause."""
        endstop: Endstop = self.endstop()
        return bool(endstop.query_endstop(print_time))

    def sampling(self) -> Sampling:
        """Return how the section of the probe samples."""
        probe = self.probe
        if hasattr(probe, "get_probe_params"):
            params = probe.get_probe_params()
            return Sampling(*[params[new] for new, old in SAMPLING_NAMES])
        # Until 2024-06-10 (6ea5b94d1), Kalico, QIDI
        return Sampling(*[getattr(probe, old) for new, old in SAMPLING_NAMES])

    def start(self, params: Dict[str, str]) -> ProbeSession:
        """Begin a session of the host's own probing, with parameters as PROBE takes them."""
        return ProbeSession(self, params)

    def twist(self) -> float:
        """Return what the host adds to the height of the bed here (mm), outside a session.

        Only our dockable_probe says it; what other probes have for results is not known.
        """
        twist_at = getattr(self.probe, "twist", None)
        return twist_at(self.host.toolhead.get_position()) if twist_at else 0.0

    def host_twist(self, position: Sequence[float]) -> float:
        """Return what axis_twist_compensation adds (mm) where results are lists."""
        twist = self.printer.lookup_object("axis_twist_compensation", None)
        # Until 2024-06-20 (e780049a7), Kalico
        if hasattr(twist, "get_z_compensation_value"):
            value: float = twist.get_z_compensation_value(position)
            return value
        probed = [*position[:2], 0.0]
        self.printer.send_event("probe:update_results", probed)
        return probed[2]

    def homes_with_twist(self) -> bool:
        """Return whether G28 with the probe takes the twist into account.

        Since 2026-05-25 (43baf9b83).
        """
        homing = self.printer.lookup_object("homing")
        return hasattr(homing, "check_probe_first_home")

    def homed_z(self, probed: Probed) -> float:
        """Return the height (toolhead Z, mm) of a touch as G28, or a mesh, sees it."""
        if self.host.axes.homes_with_probe() and not self.homes_with_twist():
            return probed.z
        return probed.z + probed.twist

    @contextlib.contextmanager
    def floor(self, floor: float) -> Iterator[bool]:
        """Have the host's own probing end at a floor (toolhead Z, mm) while this lasts.

        Otherwise it ends at the position_min that it has read from the configuration, and
        no host has a method to say so.  Yields whether this one could be told.
        """
        owner, name = self.limit()
        if owner is None:
            yield False
            return
        before = getattr(owner, name)
        setattr(owner, name, floor)
        try:
            yield True
        finally:
            setattr(owner, name, before)

    def limit(self) -> Tuple[Any, str]:
        """Return the object and attribute that hold the lower end of the host's probing.

        Public attributes, but no method sets them.  (None, ""): this host is not known.
        """
        probe = self.probe
        session = getattr(probe, "probe_session", None)
        device = getattr(probe, "mcu_probe", None)
        inner = getattr(device, "probe_wrapper", None)
        for owner, name in (
            # Since 2026-05-25 (43baf9b83); 'inner' of a smart_effector
            (getattr(device, "homing_helper", None), "z_min_position"),
            (getattr(inner, "homing_helper", None), "z_min_position"),
            # Since 2025-04-18 (1f5783a25; its parent f3a1c914a)
            (getattr(probe, "homing_helper", None), "z_min_position"),
            (getattr(session, "homing_helper", None), "z_min_position"),
            # Since 2024-06-10 (6ea5b94d1)
            (session, "z_position"),
            # Before, Kalico, QIDI
            (probe, "z_position"),
        ):
            if hasattr(owner, name):
                return owner, name
        return None, ""

    def attaches_by_itself(self) -> bool:
        """Return whether a [dockable_probe] fetches and docks the probe around sessions."""
        dockable = self.printer.lookup_object("dockable_probe", None)
        return bool(getattr(dockable, "auto_attach_detach", False))

    def lifts_outside_session(self) -> bool:
        """Return whether the toolhead may be lifted after a probing move of our own.

        Kalico's dockable_probe does so where no session is around that move.
        """
        return self.printer.lookup_object("dockable_probe", None) is not None

    def can_end_at_floor(self) -> bool:
        """Return whether every touch of this probe can end at a floor.

        In the host's own probing, or because its switch may be touched without that.
        """
        if self.limit()[0] is not None:
            return True
        lookup = self.printer.lookup_object
        special = [lookup(name, None) for name in ("bltouch", "smart_effector")]
        return special == [None, None] and self.endstop() is not None

    def manual_helper(self) -> str:
        """Return what has a person go on with ACCEPT, in words; empty: nothing.

        Its next step starts where it left the toolhead.
        """
        manual = self.printer.lookup_object("manual_probe", None)
        screws = self.printer.lookup_object("bed_screws", None)
        is_waiting = "ACCEPT" in self.host.gcode.ready_gcode_handlers
        # Older hosts stay active where the move to the next screw has failed.
        if is_waiting and self._is_active(screws):
            return "BED_SCREWS_ADJUST"
        return "a manual probe" if self._is_active(manual) else ""

    def _is_active(self, helper: Any) -> bool:
        get_status = getattr(helper, "get_status", None)
        if get_status is None:
            return False
        return bool(get_status(self.host.eventtime())["is_active"])

    def is_manual_probing(self) -> bool:
        """Return whether a person is asked by the host to go on with ACCEPT."""
        return bool(self.manual_helper())
