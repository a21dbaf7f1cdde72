# What is pressed by hand in Z_CALIBRATION_SETUP.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

from ..core.errors import CalibrationError
from . import steps

# How often (s) a switch is looked at
LOOK_INTERVAL = 0.1

VERDICTS = {
    "early": "reads pressed before anything presses it",
    "nothing": "did not change",
    "other": "did not change, but the other switch did: the pins are mixed up",
    "both": "changed together with the other switch: both are on one pin",
    "held": "was pressed and has not come back",
}


class Hands(object):
    # 'module' is the object behind [z_calibration]
    def __init__(self, module, saver):
        self.module = module
        self.host = module.host
        self.saver = saver

    def is_attached(self):
        probe, now = self.host.probing.endstop(), self.host.after_moves()
        return not probe.query_endstop(now)

    def test_pin(self, gcmd, state):
        pin, probe = self.module.pin, self.host.probing.endstop()
        written = pin.section, pin.option
        self.watch(gcmd, pin.name, written, pin.endstop, probe)

    def test_off(self, gcmd, state):
        if self.is_attached():
            raise CalibrationError(
                "the probe reads as if it were attached: it is not wired as"
                " normally closed, or the polarity is wrong: %s"
                % (self.remedy(*self.probe_option()),)
            )

    def test_probe(self, gcmd, state):
        probe, pin = self.host.probing.endstop(), self.module.pin.endstop
        self.watch(gcmd, "the probe", self.probe_option(), probe, pin)

    def probe_option(self):
        own = self.configured()
        name = "probe" if "pin" in own.get("probe", {}) else "dockable_probe"
        return name, "pin"

    def configured(self):
        configfile = self.host.printer.lookup_object("configfile")
        return configfile.get_status(self.host.eventtime())["config"]

    def remedy(self, section, option):
        pin = self.configured().get(section, {}).get(option, "")
        return (
            "'%s: %s' in section '%s' (%s); the other polarity is '%s: %s'"
            % (
                option,
                pin,
                section,
                self.saver.where(section, option),
                option,
                steps.inverted(pin),
            )
        )

    # Until something is pressed by hand and let go
    def watch(self, gcmd, name, option, endstop, other):
        reactor, host = self.host.printer.get_reactor(), self.host
        end, readings = host.eventtime() + steps.HAND_PATIENCE, []
        host.toolhead.wait_moves()
        for line in steps.while_watching(name):
            host.gcode.respond_raw(line)
        gcmd.respond_info("%s: watching %s ..." % (host.section, name))
        while True:
            now = host.after_moves()
            readings.append(
                (
                    bool(endstop.query_endstop(now)),
                    bool(other.query_endstop(now)),
                )
            )
            verdict = steps.judge(readings)
            if verdict in ("good", "early"):
                break
            if host.eventtime() >= end:
                break
            reactor.pause(host.eventtime() + LOOK_INTERVAL)
        if verdict != "good":
            text = "%s %s; check %s" % (
                name,
                VERDICTS[verdict],
                self.remedy(*option),
            )
            raise CalibrationError(text)
        gcmd.respond_info("%s: %s works" % (host.section, name))
