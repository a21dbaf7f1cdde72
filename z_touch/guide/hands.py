# What is pressed by hand in Z_CALIBRATION_SETUP: the pin, the probe.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from ..core.errors import CalibrationError
from . import steps

# How often (s) a switch is looked at
LOOK_INTERVAL = 0.1

# What a hand has done, see steps.judge(), and what that says of the wiring
VERDICTS = {
    "early": "reads pressed before anything presses it",
    "nothing": "was not pressed within %d seconds" % (steps.HAND_PATIENCE,),
    "other": "did not change, but the other switch did: the pins are mixed up",
    "both": "changed together with the other switch: both are on one pin",
    "held": "was pressed and has not come back",
}


# Of a pin that reads pressed: after G28 the nozzle may stand on it
LIFT_OFF = "lift the nozzle by hand if it stands on the pin, and otherwise %s"


# Of one that has not changed
PRESS_AGAIN = "press it again, or, if you did press it, %s"


# Watches the two switches while a hand presses one of them.
class Hands:
    # 'section': interface.Interface; 'saver': saving.Saver, which knows where an
    # option is written
    def __init__(self, section, saver):
        self.section = section
        self.host = section.host
        self.saver = saver

    # By the probe's switch, which reads triggered where it is not
    def is_attached(self):
        probe = self.host.probing.endstop()
        return not probe.query_endstop(self.host.after_moves())

    def test_pin(self, gcmd, state):
        pin, probe = self.section.pin(), self.host.probing.endstop()
        option = pin.section, pin.option
        self.watch(gcmd, state, pin.name, option, pin.endstop, probe)

    def test_off(self, gcmd, state):
        if self.is_attached():
            raise CalibrationError(
                "the probe reads as if it were attached: it is not wired as"
                " normally closed, or the polarity is wrong; check %s"
                % (self.remedy(*self.probe_option()),)
            )

    def test_probe(self, gcmd, state):
        probe, pin = self.host.probing.endstop(), self.section.pin().endstop
        option = self.probe_option()
        self.watch(gcmd, state, "the probe", option, probe, pin)

    # Section and option of the probe's pin
    def probe_option(self):
        probe = self.configured().get("probe", {})
        return "probe" if "pin" in probe else "dockable_probe", "pin"

    # What printer.cfg has: texts by section and option
    def configured(self):
        configfile = self.host.printer.lookup_object("configfile")
        return configfile.get_status(self.host.eventtime())["config"]

    def remedy(self, section, option):
        pin = self.configured().get(section, {}).get(option, "")
        written = self.saver.where(section, option)
        text = "'%s: %s' in section '%s' (%s; the other polarity: '%s: %s')"
        other = steps.inverted(pin)
        return text % (option, pin, section, written, option, other)

    # Until something is pressed by hand and let go.  Raises CalibrationError
    # where it was not 'endstop', or not only that; 'option' is that of its pin.
    def watch(self, gcmd, state, name, option, endstop, other):
        host = self.host
        host.toolhead.wait_moves()
        for line in steps.while_watching(state.step, name):
            host.gcode.respond_raw(line)
        gcmd.respond_info("%s: watching %s ..." % (host.section, name))
        verdict = self.look_until(
            host.eventtime() + steps.HAND_PATIENCE, endstop, other
        )
        if verdict != "good":
            remedy = "check %s" % (self.remedy(*option),)
            if verdict == "early" and endstop is self.section.pin().endstop:
                remedy = LIFT_OFF % (remedy,)
            if verdict == "nothing":
                # Whoever was slow is not to turn a right polarity over
                remedy = PRESS_AGAIN % (remedy,)
            raise CalibrationError(
                "%s %s; %s" % (name, VERDICTS[verdict], remedy)
            )
        gcmd.respond_info("%s: %s works" % (host.section, name))

    # The verdict of steps.judge(), at the latest at an eventtime
    def look_until(self, deadline, endstop, other):
        reactor, host = self.host.printer.get_reactor(), self.host
        readings = []
        while True:
            print_time = host.after_moves()
            pair = [e.query_endstop(print_time) for e in (endstop, other)]
            readings.append(tuple(map(bool, pair)))
            verdict = steps.judge(readings)
            if verdict in ("good", "early") or host.eventtime() >= deadline:
                return verdict
            reactor.pause(host.eventtime() + LOOK_INTERVAL)
