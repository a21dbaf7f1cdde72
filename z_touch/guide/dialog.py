# Z_CALIBRATION_SETUP: from an empty section to the first result, by dialogs.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Each step is a command of its own, see setup_steps.py: it does what the step
# before has announced, and asks for the next one.
from __future__ import absolute_import, division

import functools

from ..core import options, running, saving
from ..core.dialogs import END
from ..core.errors import CalibrationError
from . import steps
from .hands import Hands
from .head import FIRST_TOUCHES, OVER_SHEET, PLACES, Ways
from .summary import found, summary, values
from .touches import State, Touches

# Where the head stands at a step
PLACE_OF = {prefix + name: name for name in PLACES for prefix in ("", "look_")}

# Steps that use heights of before
NEED_HEIGHTS = ("touch_switch", "touch_bed", "gap", "paper")

# Heights that are known before a site is touched
TOUCHED = {"touch_nozzle": 0, "touch_switch": 1, "touch_bed": 2}


# 'module' is the object behind [z_calibration].
class Setup(object):
    def __init__(self, module):
        self.module = module
        self.host = module.host
        self.saver = saving.Saver(module.host)
        self.ways = Ways(module)
        self.hands = Hands(module, self.saver)
        self.touches = Touches(module, self.ways, self.hands)
        # None: no set-up is under way
        self.state = None
        running.register_commands(module.host, self)

    cmd_Z_CALIBRATION_SETUP_help = "Set up the Z calibration, step by step"

    def cmd_Z_CALIBRATION_SETUP(self, gcmd):
        self.module.runner.check_idle(gcmd)
        name = gcmd.get("STEP", "").strip().lower()
        if not name:
            self.check_not_printing(gcmd)
            self.state = self.state or State()
            self.ask()
            return
        if self.state is None:
            # It may be one of before a restart
            self.host.gcode.respond_raw(END)
            raise gcmd.error(
                "%s: no set-up is under way, a restart ends it, too; nothing"
                " was saved. Begin with %s" % (self.host.section, steps.COMMAND)
            )
        if name == "abort":
            self.abort(gcmd)
            return
        if name != self.state.step:
            raise gcmd.error(
                "%s: STEP=%s is not what is asked now, which is STEP=%s; %s"
                " shows it again"
                % (self.host.section, name, self.state.step, steps.COMMAND)
            )
        self.check_not_printing(gcmd)
        self.answered(gcmd)

    def check_not_printing(self, gcmd):
        if self.host.print_state():
            raise gcmd.error("%s: not during a print" % (self.host.section,))

    # A jog leaves the dialog as it is; after an error it says why.  For longer
    # work it closes: it would cover the emergency stop of a web interface.
    def answered(self, gcmd):
        is_jog = any(gcmd.get(axis, "").strip() for axis in "XYZ")
        work = self.jog if is_jog else self.go_on
        if not is_jog:
            self.host.gcode.respond_raw(END)
        try:
            self.run(gcmd, functools.partial(work, gcmd, self.state))
        except self.host.printer.command_error as e:
            if not self.host.printer.is_shutdown() and self.state is not None:
                self.ask(str(e))
            raise
        if self.state is not None and not is_jog:
            self.ask()

    # What start_gcode and end_gcode do to the G-code offset is undone
    def run(self, gcmd, work):
        def keep_offset():
            before = self.host.gcode_offset()
            work()
            if self.host.gcode_offset() != before:
                self.host.set_gcode_offset(before)

        self.module.runner.run(gcmd, keep_offset, "setup", 0)

    def jog(self, gcmd, state):
        if not state.arrived:
            raise CalibrationError(
                "the head has not got to this place yet; answer the question"
            )
        self.check_heights(state)
        self.ways.jog(gcmd, state, self.hands.is_attached())

    def go_on(self, gcmd, state):
        if self.switch_type(gcmd):
            state.step = "save"
            return
        answer = gcmd.get("ANSWER", "").strip().upper()
        following = steps.follow(state.step, answer)
        if state.step == "off":
            state.is_fixed = answer == "SKIP"
        self.check_heights(state)
        if not (state.arrived or answer):
            self.enter(state.step)
            state.arrived = True
            return
        if not answer:
            self.work_of(state.step)(gcmd, state)
        elif state.step == "paper":
            self.ways.lift(state)
        if self.state is not None:
            state.step, state.arrived = following, False
            self.enter(following)
            state.arrived = True

    def work_of(self, name):
        touches, ways = self.touches, self.ways
        return {
            "pin": self.test_pin,
            "off": self.hands.test_off,
            "probe": self.hands.test_probe,
            "home": touches.home,
            "nozzle": ways.take_place,
            "attach": touches.attach,
            "switch": ways.take_place,
            "bed": ways.take_place,
            "touch_nozzle": touches.touch_nozzle,
            "touch_switch": touches.touch_switch,
            "touch_bed": touches.touch_bed,
            "gap": self.check_sheet,
            "paper": self.measure_paper,
            "save": self.save,
        }.get(name, lambda gcmd, state: None)

    # They hold no more where Z was homed again; places do
    def check_heights(self, state):
        if state.mark is None:
            return
        if not self.touches.is_homed() and self.hands.is_attached():
            raise CalibrationError(
                "not homed, and the probe is on the head: unless Z is homed with"
                " it, put it away first; then home all axes (G28)"
            )
        if state.step not in NEED_HEIGHTS:
            return
        moved = self.module.frame.moved_since(state.mark)
        if moved:
            state.step, state.arrived = "touch_nozzle", True
            text = "%s: the heights hold no more, the first touches begin again"
            raise CalibrationError(text % (moved,))

    # What is shown

    def ask(self, problem=""):
        state = self.state
        late = "" if state.arrived else self.goal(state.step)
        shown, said = steps.ask(state.step, self.facts(), problem, late)
        self.host.gcode.respond_info("%s: %s" % (self.host.section, said))
        self.host.gcode.respond_raw(END)
        for line in shown:
            self.host.gcode.respond_raw(line)

    def facts(self):
        state, name = self.state, self.state.step
        back = steps.STEPS[name].back
        facts = {
            "patience": steps.HAND_PATIENCE,
            "travel_z": self.ways.travel_z(state),
            "goal": "" if name == "gap" else self.goal(steps.after(name)),
            "back_goal": self.goal(back) if back in PLACES else "",
            "found": found(state),
            "floor": 0.0,
            "touches": FIRST_TOUCHES,
            "paper_z": 0.0,
            "values": "",
            "not_saved": "",
        }
        if name.startswith("touch_"):
            z = [state.heights.get(site) for site in PLACES[:2]]
            run = self.ways.run(state)
            facts["floor"] = run.floor(*z[: TOUCHED[name]])
        if name in ("gap", "paper"):
            facts["paper_z"] = self.ways.contact(state) + OVER_SHEET
        if name == "save":
            facts.update(summary(self.ways, state, self.saver))
        return facts

    # The move that a step begins with, in words; empty: none
    def goal(self, name):
        text = "the head lifts to Z=%.1f" % (self.ways.travel_z(self.state),)
        if name == "paper":
            goal = self.ways.sheet(self.state)
            return "%s, moves to X=%.1f Y=%.1f and down to Z=%.2f" % (
                (text,) + goal
            )
        if name not in PLACE_OF:
            return ""
        site = self.ways.candidate(PLACE_OF[name], self.state)
        if site is None:
            return text
        return "%s and moves to X=%.1f Y=%.1f" % (text, site.x, site.y)

    # What the steps do

    # The head to where a step begins
    def enter(self, name):
        state = self.state
        if name == "paper":
            x, y, z = self.ways.sheet(state)
            self.ways.go(state, x, y, False)
            speed = self.module.settings.pin.lift_speed
            self.host.toolhead.manual_move([None, None, z], speed)
        elif name in PLACE_OF:
            site = self.ways.candidate(PLACE_OF[name], state)
            if site is None:
                self.ways.lift(state)
                return
            self.ways.places().check_reach(site)
            self.ways.go(state, site.x, site.y, site.name != "bed")

    # After G28 the nozzle may stand on it
    def test_pin(self, gcmd, state):
        if self.touches.is_homed():
            self.ways.lift(state)
        self.hands.test_pin(gcmd, state)

    def check_sheet(self, gcmd, state):
        self.ways.sheet(state)
        if self.hands.is_attached():
            raise CalibrationError(
                "the probe is attached, the nozzle cannot reach the sheet; take"
                " it off, or take the type of the switch"
            )

    # Whether the switch_offset was told
    def switch_type(self, gcmd):
        name = gcmd.get("TYPE", "").strip().upper()
        highest = steps.LARGEST_SWITCH_OFFSET
        value = options.param_number(gcmd, "VALUE", minval=0.0, maxval=highest)
        if name and name not in steps.SWITCHES:
            raise CalibrationError(
                "TYPE=%s: none of %s; give VALUE=mm"
                % (name, ", ".join(steps.SWITCHES))
            )
        value = steps.SWITCHES.get(name, value)
        if value is not None:
            if self.state.step != "gap":
                raise CalibrationError("TYPE and VALUE belong to STEP=GAP")
            self.use_switch_offset(value)
        return value is not None

    def use_switch_offset(self, value):
        z_offset = self.ways.contact(self.state) - value
        low, high = self.module.settings.offset_margins
        if not low <= z_offset <= high:
            raise CalibrationError(
                "with switch_offset=%.3f the offset is %.3f, outside"
                " offset_margins %.3f to %.3f; home Z again (G28 Z), check the"
                " three places and position_endstop"
                % (value, z_offset, low, high)
            )
        self.state.switch_offset = value

    def measure_paper(self, gcmd, state):
        contact = self.ways.contact(state)
        self.use_switch_offset(steps.from_paper(contact, self.host.z()))
        self.ways.lift(state)

    def save(self, gcmd, state):
        saved = [
            self.saver.save(self.host.section, option, text)
            for option, text in values(self.ways, state)
        ]
        self.close()
        if any(saved):
            self.host.gcode.run_script_from_command("SAVE_CONFIG")

    def close(self):
        self.state = None
        self.host.gcode.respond_raw(END)

    def abort(self, gcmd):
        state = self.state
        self.close()
        leave, busy = self.touches.leave, bool(self.host.print_state())
        work = functools.partial(leave, gcmd, state, busy)
        self.run(gcmd, work)
        gcmd.respond_info(
            "%s: the set-up has ended, nothing was saved" % (self.host.section,)
        )
