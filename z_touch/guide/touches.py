# Homing, the probe and the first touches of Z_CALIBRATION_SETUP.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from ..core import running
from ..core.errors import CalibrationError


# Homes, fetches the probe, touches each site, and leaves the printer as before.
class Touches:
    # 'section': interface.Interface; 'head': head.GuidedHead; 'hands': hands.Hands
    def __init__(self, section, head, hands):
        self.section = section
        self.host = section.host
        self.head = head
        self.hands = hands

    def is_homed(self):
        homed = self.host.toolhead_status()["homed_axes"]
        return all(axis in homed for axis in "xyz")

    # Again where the pin is elsewhere since: how low the head may be moved by hand
    # counts from it.
    def home(self, gcmd, state):
        moved = self.is_homed() and self.section.pin_moved()
        if moved or not self.is_homed():
            on_pin = self.section.settings().position_endstop is not None
            if on_pin and not state.probe.is_fixed and self.hands.is_attached():
                raise CalibrationError(
                    "the probe is on the head, and would hit the bed before the"
                    " nozzle meets the pin; put it away, or run G28 yourself"
                )
            self.host.gcode.run_script_from_command("G28 Z" if moved else "G28")
        running.check_homed(self.host)
        state.mark = self.section.mark()

    ##################################################################
    # The probe
    ##################################################################

    # Unless it is on the head already
    def attach(self, gcmd, state):
        self.head.lift(state)
        if self.hands.is_attached():
            return
        self.fetch(state)
        with self.section.holding_probe():
            self.section.fetch_late(None)
            state.mark = self.section.mark()
        if not self.hands.is_attached():
            raise CalibrationError(
                "the probe reads triggered: nothing has attached it; attach it by"
                " hand, or correct what should have done so"
            )

    def fetch(self, state):
        state.probe.is_fetched = True
        self.section.fetch()
        state.mark = self.section.mark()

    def put_away(self, state):
        if state.probe.is_fetched:
            self.section.put_away()
            state.probe.is_fetched = False

    # The printer as before.  A print would go on where the head was lifted to;
    # of a printer that is not homed nothing can be moved.
    def leave(self, gcmd, state, is_printing):
        if state.mark is None:
            return
        if self.is_homed() and not is_printing:
            self.head.lift(state)
            self.put_away(state)
        elif state.probe.is_fetched:
            gcmd.respond_info(
                "%s: nothing was moved, as a print may be on, or the printer is"
                " not homed; the probe has to be off the head; look, and put it"
                " away by hand" % (self.host.section,)
            )

    ##################################################################
    # First touches
    ##################################################################

    def touch_nozzle(self, gcmd, state):
        self.head.lift(state)
        state.touched = {}
        # Whoever has put it on
        is_left_on = not state.probe.is_fixed and self.hands.is_attached()
        state.probe.is_fetched = state.probe.is_fetched or is_left_on
        self.put_away(state)
        self.fetch(state)
        state.extruder = self.host.extruder()
        with self.section.holding_probe():
            self.touch(state, "nozzle")

    def touch_switch(self, gcmd, state):
        with self.section.holding_probe():
            self.head.lift(state)
            # An earlier try may have fetched it
            if not (self.section.is_late() and self.hands.is_attached()):
                self.section.fetch_late(state.mark)
            self.touch(state, "switch")

    def touch_bed(self, gcmd, state):
        with self.section.holding_probe():
            self.touch(state, "bed")
        self.put_away(state)

    # Touches a site, and lifts the head
    def touch(self, state, name):
        first_touches = self.head.first_touches(state)
        before = state.heights_before(name)
        with running.always(self.host, first_touches.lift, "lifting"):
            touched = first_touches.touch(name, *before)
            state.touched[name] = touched
        if name == "switch" and touched.warnings:
            # The plunger was pressed, too: another place is needed
            raise CalibrationError("; ".join(touched.warnings))
