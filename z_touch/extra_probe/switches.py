# What [extra_probe] touches: a switch on a pin of its own, or [probe]; and a
# series of touches with either.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import contextlib
import functools

from .. import command as running
from .. import templates
from .. import touch as touching
from ..errors import CalibrationError
from ..sampling import collect
from .settings import read_switch_settings

# What to do about samples that differ
DIFFER = "clean the nozzle, and check what it touches for play"
# What to do about a head that is below the floor of a touch
TOO_LOW = "begin higher up, or with a lower FLOOR"
# What to do where the bed may be lower than a touch of EXTRA_PROBE goes, and one of
# EXTRA_PROBE_CALIBRATE
FIND_BED = "find it with EXTRA_PROBE_CALIBRATE, or set position_min"
LOWER_FLOOR = "begin again with a lower FLOOR, ready to stop"


######################################################################
# Switches
######################################################################


# A switch on a pin of its own, and the G-code around its touches.
class PinSwitch:
    # A probe that hangs on the head would meet the bed before the nozzle does.
    is_below_nozzle = True

    # 'query' is the command that shows what the pin reads.
    def __init__(self, config, host, query):
        self.host = host
        self.query = query
        self.settings = read_switch_settings(config)
        remedy = (
            "give the pin of the switch, or call the section 'extra_probe"
            " probe' where [probe] is the switch"
        )
        self._endstop = host.endstops.make(config, "pin", remedy)

    def endstop(self):
        return self._endstop

    # A series of touches; yields the function that makes one and returns its
    # height.  'top' is where the head has to be lifted to before a switch is
    # put away, which this one is not; 'lower' is what to do where the bed may be
    # below the floor.
    @contextlib.contextmanager
    def series(self, head, floor, top, lower):
        with self._active(not self.settings.deactivate_on_each_sample):
            yield functools.partial(self._touch, head, floor, lower)

    def _touch(self, head, floor, lower):
        with self._active(self.settings.deactivate_on_each_sample):
            try:
                return head.touch(self._endstop, floor, head.sampling.speed)
            except CalibrationError as e:
                hint = (
                    "press it by hand and look with %s, or where the bed may be"
                    " lower %s" % (self.query, lower)
                )
                raise e.advised(hint)

    @contextlib.contextmanager
    def _active(self, is_wanted):
        if not is_wanted:
            yield
            return
        before, after = "activate_gcode", "deactivate_gcode"
        end = functools.partial(
            self._run, after, self.settings.deactivate_gcode
        )
        with running.always(self.host, end, after):
            self._run(before, self.settings.activate_gcode)
            yield

    # The user's G-code around a touch, which must leave the head where it is
    def _run(self, name, template):
        before = self.host.toolhead.get_position()[:3]
        templates.run_template(self.host, name, template)
        running.check_homed(self.host)
        if self.host.toolhead.get_position()[:3] != before:
            raise CalibrationError(
                "the head moved in %s; move it before the command" % (name,)
            )


# [probe] is the switch: the host's own probing touches, and runs its G-code.
class ProbeSwitch:
    query = "QUERY_PROBE"
    # The host fetches it where it has a dock.
    is_below_nozzle = False

    def __init__(self, host):
        self.host = host

    def endstop(self):
        return self.host.probing.endstop()

    # As that of PinSwitch; the host may put the probe away at its end, so the
    # head is lifted to 'top' before.  What to do is the same anywhere.
    @contextlib.contextmanager
    def series(self, head, floor, top, unused_lower):
        speed = "%.6f" % (head.sampling.speed,)
        session = touching.probing(head, floor, top, PROBE_SPEED=speed)
        with session as probe_once:
            yield functools.partial(self._touch, head, floor, probe_once)

    def _touch(self, head, floor, probe_once):
        if probe_once is None:
            # A host unknown to us: its probing would go on to position_min
            return head.touch(self.endstop(), floor, head.sampling.speed)
        head.check_above(floor)
        try:
            return head.probe(probe_once).z
        except CalibrationError as e:
            raise e.advised(touching.CHECK_PROBE)


######################################################################
# Touching
######################################################################


# One series of touches where the head is.  'respond_info' tells the user; 'lower':
# see PinSwitch.series()
class Series:
    def __init__(self, host, switch, sampling, respond_info, lower):
        self.host = host
        self.switch = switch
        self.sampling = sampling
        self.respond_info = respond_info
        self.lower = lower
        self.head = touching.Head(host, sampling, TOO_LOW)
        # Where the head is lifted to at the end
        self.end_z = host.motion.z()

    # The heights (toolhead Z, mm) of the touches, none of which goes below
    # 'floor'.  The head ends where it began or, if it is to 'stay', where the
    # last touch has ended; after a failure always where it began.
    def measure(self, floor, stay=False):
        with running.always(self.host, self._lift, "lifting"):
            series = self.switch.series(
                self.head, floor, self.end_z, self.lower
            )
            with series as touch:
                heights = collect(
                    functools.partial(self._sample, touch),
                    self.sampling,
                    self._retry,
                    DIFFER,
                )
            if stay:
                self.end_z = floor
        return heights

    def _lift(self):
        self.head.lift(self.end_z)

    def _sample(self, touch):
        self.head.retract()
        x, y = self.host.toolhead.get_position()[:2]
        z = touch()
        self.respond_info("probe at %.3f,%.3f is z=%.6f" % (x, y, z))
        return z

    # In the words of PROBE, which macros and people may look for
    def _retry(self, unused_why):
        self.respond_info("Probe samples exceed tolerance. Retrying...")
