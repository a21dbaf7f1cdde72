# The probe: what touches with it, where its touches end, and what it adds.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections
import contextlib
import functools

from . import endstops
from .sampling import Sampling

# A touch of the probe: toolhead Z (mm) of the trigger, and what the host adds
# to that for a twisted X axis.
Probed = collections.namedtuple("Probed", "z twist")

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


# The object 'probe' of the host, whichever section has made it.
class Probing:
    # 'host': host.Host
    def __init__(self, config, host):
        self.host = host
        # The name of the section that makes it; None: one that we do not know
        self.section = endstops.find_probe_section(config)
        self.printer = host.printer
        # Exists from klippy:connect on; None: the printer has none
        self.probe = None

    def connect(self):
        self.probe = self.printer.lookup_object("probe", None)

    # X, Y and Z (mm) from the nozzle to the probe
    def offsets(self):
        return self.probe.get_offsets()

    # The z_offset (mm) of the probe; 0 where there is none, or where what is
    # called so has no offsets
    def z_offset(self):
        get_offsets = getattr(self.probe, "get_offsets", None)
        return get_offsets()[2] if get_offsets else 0.0

    # Where (toolhead Z, mm) the probe sees the bed right after G28: at 0, except
    # where position_endstop counts.
    def homed_bed_z(self):
        homed_z = self.host.axes.probe_homes_to()
        return 0.0 if homed_z is None else homed_z - self.offsets()[2]

    # Where (toolhead Z, mm) it triggers there
    def homed_probe_z(self):
        return self.homed_bed_z() + self.offsets()[2]

    # The switch of the probe, None where it has none.  'mcu_probe' is an
    # endstop itself (moving it runs activate_gcode) until 2026-05-25
    # (43baf9b83); since then the endstop is inside it.  Looked up at each use:
    # QIDI's hosts exchange its methods at run time.
    def endstop(self):
        outer = getattr(self.probe, "mcu_probe", None)
        for candidate in (outer, getattr(outer, "mcu_endstop", None)):
            if endstops.is_endstop(candidate):
                return candidate
        return None

    # The probe's own settings
    def sampling(self):
        probe = self.probe
        if hasattr(probe, "get_probe_params"):
            params = probe.get_probe_params()
            return Sampling(*[params[new] for new, old in SAMPLING_NAMES])
        # Until 2024-06-10 (6ea5b94d1), Kalico, QIDI
        return Sampling(*[getattr(probe, old) for new, old in SAMPLING_NAMES])

    # A function that touches once, with the probe's own activation, and one
    # that ends the session.  'params' as PROBE takes them.
    def start(self, params):
        gcmd = self.host.gcode.create_gcode_command("", "", params)
        if hasattr(self.probe, "start_probe_session"):
            # Since 2024-06-10 (bec47e049)
            session = self.probe.start_probe_session(gcmd)
            end = session.end_probe_session
        else:
            session = self.probe
            session.multi_probe_begin()
            end = session.multi_probe_end
        return functools.partial(self._probe_once, session, gcmd), end

    def _probe_once(self, session, gcmd):
        position = self.host.toolhead.get_position()
        self.host.motion.require_running()
        result = session.run_probe(gcmd)
        if hasattr(session, "pull_probed_results"):
            # Since 2024-06-14 (1591a51f7)
            result = session.pull_probed_results()[-1]
        if hasattr(result, "bed_z"):
            # A record since 2026-01-21 (2a1027ce4)
            twist = result.bed_z + self.probe.get_offsets()[2] - result.test_z
            return Probed(result.test_z, twist)
        twist = self._twist(position)
        return Probed(result[2] - twist, twist)

    # What the host adds to the height of the bed below the head (mm), where nobody has
    # touched in a session of its own.  Only our dockable_probe says it; what other
    # probes have for results nobody knows.
    def twist(self):
        twist_at = getattr(self.probe, "twist", lambda position: 0.0)
        return twist_at(self.host.toolhead.get_position())

    # What axis_twist_compensation adds where results are lists
    def _twist(self, position):
        twist = self.printer.lookup_object("axis_twist_compensation", None)
        # Until 2024-06-20 (e780049a7), Kalico
        if hasattr(twist, "get_z_compensation_value"):
            return twist.get_z_compensation_value(position)
        probed = list(position[:2]) + [0.0]
        self.printer.send_event("probe:update_results", probed)
        return probed[2]

    # Whether G28 with the probe takes the twist into account: since
    # 2026-05-25 (43baf9b83)
    def homes_with_twist(self):
        homing = self.printer.lookup_object("homing")
        return hasattr(homing, "check_probe_first_home")

    # While this lasts the host's own probing ends at 'floor', not at the
    # position_min it has read from the configuration.  Yields whether this
    # host could be told.
    @contextlib.contextmanager
    def floor(self, floor):
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

    # Public attributes, but nobody offers a method: where each host keeps
    # the lower end of its probing move.  (None, ""): nobody knows.
    def limit(self):
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

    # Whether a [dockable_probe], ours or Kalico's, fetches and docks the probe
    # around each session
    def attaches_by_itself(self):
        dockable = self.printer.lookup_object("dockable_probe", None)
        return bool(getattr(dockable, "auto_attach_detach", False))

    # Whether the head may be lifted after a move down to the probe's switch that no
    # session is around: Kalico's dockable_probe does so.
    def lifts_outside_session(self):
        return self.printer.lookup_object("dockable_probe", None) is not None

    # Whether every touch of this probe can end at a floor: in the host's own
    # probing, or because its switch may be touched without that
    def can_end_at_floor(self):
        if self.limit()[0] is not None:
            return True
        special = ("bltouch", "smart_effector")
        lookup = functools.partial(self.printer.lookup_object, default=None)
        is_plain = [lookup(name) for name in special] == [None, None]
        return is_plain and self.endstop() is not None

    # What has a person go on with ACCEPT, in words; its next step starts where it
    # left the head.  Empty: nothing.
    def manual_helper(self):
        manual = self.printer.lookup_object("manual_probe", None)
        screws = self.printer.lookup_object("bed_screws", None)
        is_waiting = "ACCEPT" in self.host.gcode.ready_gcode_handlers
        # Older hosts stay active where the move to the next screw has failed.
        if is_waiting and self._is_active(screws):
            return "BED_SCREWS_ADJUST"
        is_probing = self._is_active(manual)
        if not hasattr(manual, "get_status"):
            # Until 2022-07-20 (282d1113e)
            is_probing = is_waiting
        return "a manual probe" if is_probing else ""

    def _is_active(self, helper):
        get_status = getattr(helper, "get_status", None)
        return (
            bool(get_status) and get_status(self.host.eventtime())["is_active"]
        )

    def is_manual_probing(self):
        return bool(self.manual_helper())
