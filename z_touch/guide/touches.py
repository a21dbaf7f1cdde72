# Homing, the probe and the first touches of Z_CALIBRATION_SETUP.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

from ..core import running
from ..core.errors import CalibrationError
from .head import PLACES


# How far somebody has come; nothing of it is saved before the last step.
class State(object):
    def __init__(self):
        self.step = "pin"
        # The head has got to where the step begins
        self.arrived = True
        # Of the frame of the heights
        self.mark = None
        # A start_gcode has run since the last end_gcode
        self.fetched = False
        # The probe stays on the head
        self.is_fixed = False
        # Toolhead Z (mm) that the pin lies below
        self.below = None
        # touching.Site, heights (mm) and samples, by name
        self.sites = {}
        self.heights = {}
        self.samples = {}
        self.switch_offset = None


class Touches(object):
    # 'module' is the object behind [z_calibration]
    def __init__(self, module, ways, hands):
        self.module = module
        self.host = module.host
        self.ways = ways
        self.hands = hands

    def is_homed(self):
        homed = self.host.toolhead_status()["homed_axes"]
        return all(axis in homed for axis in "xyz")

    def home(self, gcmd, state):
        if not self.is_homed():
            on_pin = self.module.settings.position_endstop is not None
            if on_pin and not state.is_fixed and self.hands.is_attached():
                raise CalibrationError(
                    "the probe is on the head, and would hit the bed before the"
                    " nozzle meets the pin; put it away, or run G28 yourself"
                )
            self.host.gcode.run_script_from_command("G28")
        running.check_homed(self.host)
        state.mark = self.module.frame.mark()

    def attach(self, gcmd, state):
        self.ways.lift(state)
        if self.hands.is_attached():
            return
        with self.module.hooks.holding_probe():
            self.fetch(state, "start_gcode", "before_switch_gcode")
        if not self.hands.is_attached():
            raise CalibrationError(
                "the probe reads triggered: neither start_gcode nor"
                " before_switch_gcode has attached it; attach it by hand, or"
                " correct them"
            )

    def fetch(self, state, *options):
        state.fetched = True
        for option in options:
            self.module.hooks.run_gcode(option)
        running.check_homed(self.host)
        state.mark = self.module.frame.mark()

    def put_away(self, state):
        if state.fetched:
            self.module.hooks.end()
            state.fetched = False

    def touch_nozzle(self, gcmd, state):
        self.ways.lift(state)
        state.heights, state.samples = {}, {}
        with self.module.hooks.holding_probe():
            self.put_away(state)
            self.fetch(state, "start_gcode")
            self.touch(state, "nozzle", lambda run: run.measure_nozzle())

    def touch_switch(self, gcmd, state):
        nozzle_z = state.heights["nozzle"]
        with self.module.hooks.holding_probe():
            self.ways.lift(state)
            # An earlier try may have fetched it
            late = self.module.settings.attach_after_nozzle
            if not (late and self.hands.is_attached()):
                self.module.hooks.before_switch(state.mark)
            self.touch(
                state, "switch", lambda run: run.measure_switch(nozzle_z)
            )

    def touch_bed(self, gcmd, state):
        z = [state.heights[name] for name in PLACES[:2]]
        with self.module.hooks.holding_probe():
            self.touch(state, "bed", lambda run: run.measure_bed(*z))
            self.put_away(state)

    def touch(self, state, name, measure):
        run = self.ways.run(state)
        with running.always(self.host, run.lift, "lifting"):
            state.heights[name] = measure(run)
        state.samples[name] = list(run.plan.samples[name])
        if name == "switch" and run.warnings:
            # The plunger was pressed, too: another place is needed
            raise CalibrationError("; ".join(run.warnings))

    # The printer as before.  A print would go on where the head was lifted to;
    # of a printer that is not homed nothing can be moved
    def leave(self, gcmd, state, is_printing):
        if state.mark is None:
            return
        if self.is_homed() and not is_printing:
            self.ways.lift(state)
            with self.module.hooks.holding_probe():
                self.put_away(state)
        elif state.fetched:
            gcmd.respond_info(
                "%s: printing or not homed, so nothing was moved; the probe may"
                " still be on the head" % (self.host.section,)
            )
