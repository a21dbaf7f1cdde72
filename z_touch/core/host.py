# Everything that the modules want from the printer.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import, division

import collections
import contextlib
import functools

from .sampling import Sampling

# The section that configures the Z axis, and its options that matter (mm,
# mm/s, mm/s^2); position_endstop is None where the probe homes Z.
ZAxis = collections.namedtuple(
    "ZAxis",
    "section endstop_pin position_endstop position_min homing_speed"
    " second_homing_speed homing_retract_dist max_accel",
)

# A touch of the probe: toolhead Z (mm) of the trigger, and what the host adds
# to that for a twisted X axis.
Probed = collections.namedtuple("Probed", "z twist")

# What probing_move() and a state query need from an endstop object
ENDSTOP_METHODS = ("get_steppers", "home_start", "home_wait", "query_endstop")

# Sections that make the object 'probe', and their option for the pin
PROBE_PINS = (
    ("probe", "pin"),
    ("dockable_probe", "pin"),
    ("smart_effector", "pin"),
    ("bltouch", "sensor_pin"),
)


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


# [stepper_z], or with "kinematics: generic_cartesian" (since 2025-05-06,
# cc6736c3e) the [carriage ...] whose axis is z.  None: there is no Z axis
# of its own, as on a delta.
def find_z_section(config):
    if config.has_section("stepper_z"):
        return config.getsection("stepper_z")
    for carriage in config.get_prefix_sections("carriage "):
        name = carriage.get_name().split()[-1]
        if carriage.get("axis", name, note_valid=False) == "z":
            return carriage
    return None


# Read with the defaults that every host documents; note_valid=False leaves
# it to the host to claim these options.
def read_z_axis(config):
    section = find_z_section(config)
    if section is None:
        return None
    number = functools.partial(section.getfloat, note_valid=False)
    homing_speed = number("homing_speed", 5.0)
    printer = config.getsection("printer")
    return ZAxis(
        section=section.get_name(),
        endstop_pin=section.get("endstop_pin", "", note_valid=False),
        position_endstop=number("position_endstop", None),
        position_min=number("position_min", 0.0),
        homing_speed=homing_speed,
        second_homing_speed=number("second_homing_speed", homing_speed / 2.0),
        homing_retract_dist=number("homing_retract_dist", 5.0),
        max_accel=printer.getfloat(
            "max_z_accel", float("inf"), note_valid=False
        ),
    )


def is_endstop(candidate):
    methods = [getattr(candidate, name, None) for name in ENDSTOP_METHODS]
    return all(callable(m) for m in methods) and bool(candidate.get_steppers())


def bare_pin(pin):
    pin = pin.replace(" ", "").lstrip("^~!")
    return pin[len("mcu:") :] if pin.startswith("mcu:") else pin


# 'probe' of probe:z_virtual_endstop
def chip_of(pin):
    return pin.strip("^~! ").split(":")[0].strip() if ":" in pin else "mcu"


def check_z_axis(config, z_axis):
    if z_axis is None:
        printer = config.getsection("printer")
        kinematics = printer.get("kinematics", "none", note_valid=False)
        raise config.error(
            "Option 'kinematics: %s' in section 'printer' has no Z axis with an"
            " endstop of its own; %s cannot be used on this machine, remove"
            " section '%s'" % (kinematics, config.get_name(), config.get_name())
        )


# Hosts themselves tell a virtual endstop by this method
def is_virtual(endstop):
    return hasattr(endstop, "get_position_endstop")


# The only place that knows in which respects hosts differ; the difference is
# always asked of the object, never of a version number.
class Host(object):
    def __init__(self, config):
        self.printer = config.get_printer()
        # In front of every line the user is shown
        self.name = config.get_name()
        self.gcode = self.printer.lookup_object("gcode")
        self.query_endstops = self.printer.load_object(config, "query_endstops")
        self.z_axis = read_z_axis(config)
        # They exist from klippy:connect on
        self.toolhead = self.probe = self.mcu = None

    def connect(self):
        self.mcu = self.printer.lookup_object("mcu")
        self.toolhead = self.printer.lookup_object("toolhead")
        self.probe = self.printer.lookup_object("probe", None)

    # Endstops

    # An endstop of our own that stops the Z motors.  A pin that something
    # else uses, too, is an error of the host.
    def make_endstop(self, config, option, remedy):
        pin, what = config.get(option), ""
        if not pin.strip("^~! ") or chip_of(pin) in ("probe", self.name):
            what = "is no pin"
        for name, other in PROBE_PINS:
            if config.has_section(name) and name != self.name:
                section = config.getsection(name)
                used = section.get(other, "", note_valid=False)
                if used and bare_pin(used) == bare_pin(pin):
                    what = "is the pin of section '%s'" % (name,)
        pins = self.printer.lookup_object("pins")
        try:
            endstop = None if what else pins.setup_pin("endstop", pin)
        except pins.error as e:
            what = "cannot be used: %s" % (e,)
        if what:
            raise config.error(
                "Option '%s: %s' in section '%s' %s; %s"
                % (option, pin, self.name, what, remedy)
            )
        self.query_endstops.register_endstop(endstop, self.name)

        def add_z_steppers():
            # They exist since the toolhead was loaded, just before this event
            self.toolhead = self.printer.lookup_object("toolhead")
            for stepper in self.z_steppers():
                endstop.add_stepper(stepper)

        register = self.printer.register_event_handler
        register("klippy:mcu_identify", add_z_steppers)
        return endstop

    def z_steppers(self):
        steppers = self.toolhead.get_kinematics().get_steppers()
        return [s for s in steppers if s.is_active_axis("z")]

    # Registered as "z" until 2025-05-06 (cc6736c3e) and on Kalico, since then
    # under the name of the section.  None: there is none
    def find_z_endstop(self):
        section = self.z_axis.section
        names = (section, section.split()[-1].replace("stepper_", ""))
        for endstop, name in self.query_endstops.endstops:
            if name in names:
                return endstop
        return None

    # An endstop stops only its own motors.  With none at all, hosts since
    # 2025-05-06 (cc6736c3e) make the whole move without any endstop.
    def check_stops_z(self, endstop, where):
        stopped = [s.get_name() for s in endstop.get_steppers()]
        moving = [s.get_name() for s in self.z_steppers()]
        missing = [name for name in moving if name not in stopped]
        if missing:
            raise self.printer.config_error(
                "%s does not stop these Z motors: %s; remove the endstop_pin"
                " of their own" % (where, ", ".join(missing))
            )

    # Probe

    # The switch of the probe, None where it has none.  'mcu_probe' is an
    # endstop itself (moving it runs activate_gcode) until 2026-05-25
    # (43baf9b83); since then the endstop is inside it.  Looked up at each use:
    # QIDI's hosts exchange its methods at run time.
    def probe_endstop(self):
        outer = getattr(self.probe, "mcu_probe", None)
        for candidate in (outer, getattr(outer, "mcu_endstop", None)):
            if is_endstop(candidate):
                return candidate
        return None

    # The probe's own settings
    def probe_sampling(self):
        probe = self.probe
        if hasattr(probe, "get_probe_params"):
            params = probe.get_probe_params()
            return Sampling(*[params[new] for new, old in SAMPLING_NAMES])
        # Until 2024-06-10 (6ea5b94d1), Kalico, QIDI
        return Sampling(*[getattr(probe, old) for new, old in SAMPLING_NAMES])

    # A function that touches once, with the probe's own activation, and one
    # that ends the session.  'params' as PROBE takes them.
    def start_probing(self, params):
        gcmd = self.gcode.create_gcode_command("", "", params)
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
        place = self.toolhead.get_position()
        self.require_running()
        result = session.run_probe(gcmd)
        if hasattr(session, "pull_probed_results"):
            # Since 2024-06-14 (1591a51f7)
            result = session.pull_probed_results()[-1]
        if hasattr(result, "bed_z"):
            # A record since 2026-01-21 (2a1027ce4)
            twist = result.bed_z + self.probe.get_offsets()[2] - result.test_z
            return Probed(result.test_z, twist)
        twist = self._twist(place)
        return Probed(result[2] - twist, twist)

    # What axis_twist_compensation adds where results are lists
    def _twist(self, place):
        twist = self.printer.lookup_object("axis_twist_compensation", None)
        # Until 2024-06-20 (e780049a7), Kalico
        if hasattr(twist, "get_z_compensation_value"):
            return twist.get_z_compensation_value(place)
        probed = list(place[:2]) + [0.0]
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
    def probe_floor(self, floor):
        owner, name = self.probe_limit()
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
    def probe_limit(self):
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

    # Somebody else measures; its next step starts where it left the head
    def is_manual_probing(self):
        manual = self.printer.lookup_object("manual_probe", None)
        if hasattr(manual, "get_status"):
            return manual.get_status(self.eventtime())["is_active"]
        # Until 2022-07-20 (282d1113e)
        return "ACCEPT" in self.gcode.ready_gcode_handlers

    # The point of the bed mesh that is its zero, or None
    def mesh_zero(self):
        mesh = self.printer.lookup_object("bed_mesh", None)
        calibrate = getattr(mesh, "bmc", None)
        # A part of its own since 2024-06-19 (f2df011c6)
        for owner in (getattr(calibrate, "probe_mgr", None), calibrate):
            if getattr(owner, "zero_ref_pos", None) is not None:
                return tuple(owner.zero_ref_pos)[:2]
        return None

    # State

    def eventtime(self):
        return self.printer.get_reactor().monotonic()

    # The print time of the end of the last queued move
    def after_moves(self):
        print_time, now, is_empty = self.toolhead.check_busy(self.eventtime())
        if is_empty and print_time <= now:
            return now
        return self.toolhead.get_last_move_time()

    # The print time right after a touch, when nothing moves: spares the wait
    def now(self):
        return self.mcu.estimated_print_time(self.eventtime())

    # Where the motors of Z stand, apart from where the host believes Z is:
    # the difference (mm) changes only when Z is homed, set or levelled.
    # Empty where X or Y share these motors.
    def z_datum(self):
        steppers = self.z_steppers()
        if any(s.is_active_axis(axis) for s in steppers for axis in "xy"):
            return []
        return [
            s.get_mcu_position() * s.get_step_dist()
            - s.get_commanded_position()
            for s in steppers
        ]

    def toolhead_status(self):
        return self.toolhead.get_status(self.eventtime())

    # Degrees C that the nozzle has or is to have, whichever is more
    def nozzle_temperature(self):
        name = self.toolhead_status().get("extruder")
        extruder = name and self.printer.lookup_object(name, None)
        status = extruder.get_status(self.eventtime()) if extruder else {}
        return max(status.get("temperature", 0.0), status.get("target", 0.0))

    # (low, high) of X, Y and Z (mm)
    def axis_limits(self):
        status = self.toolhead_status()
        return list(zip(status["axis_minimum"], status["axis_maximum"]))[:3]

    # The G-code Z offset (mm)
    def gcode_offset(self):
        gcode_move = self.printer.lookup_object("gcode_move")
        return gcode_move.get_status(self.eventtime())["homing_origin"][2]

    # Absolute, so that it replaces any earlier offset.  The command's own
    # method: a macro of that name may add to it, store it or move.
    def set_gcode_offset(self, z_offset):
        params = {"Z": "%.6f" % (z_offset,), "MOVE": "0"}
        line = "SET_GCODE_OFFSET Z=%s MOVE=0" % (params["Z"],)
        gcmd = self.gcode.create_gcode_command("SET_GCODE_OFFSET", line, params)
        self.printer.lookup_object("gcode_move").cmd_SET_GCODE_OFFSET(gcmd)

    # Motion; toolhead coordinates (mm), mm/s

    def z(self):
        return self.toolhead.get_position()[2]

    # A probing move first waits for the moves before it, and hosts may wait for
    # ever for its trigger where the printer was shut down meanwhile; whoever
    # sends FIRMWARE_RESTART then waits with them.  So wait here, and look.
    def require_running(self):
        self.toolhead.flush_step_generation()
        if self.printer.is_shutdown():
            raise self.printer.command_error(
                "Touch not begun due to printer shutdown"
            )

    # Down to z or to where the endstop triggers; returns the toolhead Z of the
    # trigger.  The head stops a little lower and stays there.
    def probing_move(self, endstop, z, speed):
        self.require_running()
        target = self.toolhead.get_position()
        target[2] = z
        # A method of the host since 2021-03-29 (862d3f963)
        homing = self.printer.lookup_object("homing")
        return homing.probing_move(endstop, target, speed)[2]
