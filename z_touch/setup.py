# Z_CALIBRATION_SETUP: from an empty section to the first result, by dialogs.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Each step is a command of its own, see setup_steps.py: it does what the step
# before has announced, and asks for the next one.
from __future__ import division

import functools

from . import options, running, saving
from . import setup_steps as steps
from .dialogs import END
from .errors import CalibrationError
from .setup_hands import Hands
from .setup_result import found, summary, values
from .setup_ways import OVER_SHEET, PLACES, Ways

# Where the head stands at a step
PLACE_OF = {prefix + name: name for name in PLACES for prefix in ("", "look_")}

# Heights that are known before a site is touched
TOUCHED = {"touch_nozzle": 0, "touch_switch": 1, "touch_bed": 2}


# How far somebody has come; nothing of it is saved before the last step.
class State(object):
    def __init__(self):
        self.step = "pin"
        # The head has got to where the step begins
        self.arrived = True
        self.mark = None
        # A start_gcode has run since the last end_gcode
        self.fetched = False
        # touching.Site, heights (mm) and samples, by name
        self.sites = {}
        self.heights = {}
        self.samples = {}
        self.switch_offset = None


class Setup(object):
    # 'module' as above
    def __init__(self, module):
        self.module = module
        self.host = module.host
        self.saver = saving.Saver(module.host)
        self.ways = Ways(module)
        self.hands = Hands(module, self.saver)
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
            raise gcmd.error(
                "%s: no set-up is under way, a restart ends it, too; nothing"
                " was saved. Begin with %s" % (self.host.name, steps.COMMAND)
            )
        if name == "abort":
            self.abort(gcmd)
            return
        if name != self.state.step:
            raise gcmd.error(
                "%s: STEP=%s is not what is asked now, which is STEP=%s; %s"
                " shows it again"
                % (self.host.name, name, self.state.step, steps.COMMAND)
            )
        self.check_not_printing(gcmd)
        self.answered(gcmd)

    def check_not_printing(self, gcmd):
        stats = self.host.printer.lookup_object("print_stats", None)
        status = stats.get_status(self.host.eventtime()) if stats else {}
        if status.get("state") in ("printing", "paused"):
            raise gcmd.error("%s: not during a print" % (self.host.name,))

    # A jog leaves the dialog as it is; after an error it says why
    def answered(self, gcmd):
        is_jog = any(gcmd.get(axis, "").strip() for axis in "XYZ")
        work = self.jog if is_jog else self.go_on
        try:
            self.module.runner.run(
                gcmd,
                functools.partial(self.kept_offset, work, gcmd),
                "setup",
                0,
            )
        except self.host.printer.command_error as e:
            if not self.host.printer.is_shutdown() and self.state is not None:
                self.ask(str(e))
            raise
        if self.state is not None and not is_jog:
            self.ask()

    # What start_gcode and end_gcode do to the G-code offset is undone
    def kept_offset(self, work, gcmd):
        before = self.host.gcode_offset()
        work(gcmd)
        if self.host.gcode_offset() != before:
            self.host.set_gcode_offset(before)

    def jog(self, gcmd):
        self.require_arrived()
        self.ways.jog(gcmd, self.state, self.hands.is_attached())

    def go_on(self, gcmd):
        state = self.state
        self.check_frame()
        if not state.arrived:
            self.enter(state.step)
            state.arrived = True
            return
        answer = gcmd.get("ANSWER", "").strip().upper()
        if state.step == "gap" and self.switch_type(gcmd):
            state.step = "save"
            return
        following = steps.follow(state.step, answer)
        do = getattr(self, "do_" + state.step, None)
        if do is not None and not answer:
            do(gcmd)
        if self.state is not None:
            state.step, state.arrived = following, False
            self.enter(following)
            state.arrived = True

    def require_arrived(self):
        if not self.state.arrived:
            raise CalibrationError(
                "the head has not got to this place yet; answer the question"
            )

    # Heights hold no more where Z was homed again; places do
    def check_frame(self):
        state = self.state
        if state.mark is None:
            return
        running.check_homed(self.host)
        moved = self.module.frame.moved_since(state.mark)
        state.mark = self.module.frame.mark()
        if moved and state.step in ("touch_switch", "touch_bed", "paper"):
            state.step, state.arrived = "touch_nozzle", True
            text = "%s: the heights hold no more, the first touches begin again"
            raise CalibrationError(text % (moved,))

    # What is shown

    def ask(self, problem=""):
        state = self.state
        late = "" if state.arrived else self.goal(state.step)
        shown, said = steps.ask(state.step, self.facts(), problem, late)
        self.host.gcode.respond_info("%s: %s" % (self.host.name, said))
        self.host.gcode.respond_raw(END)
        for line in shown:
            self.host.gcode.respond_raw(line)

    def facts(self):
        state, name = self.state, self.state.step
        back = steps.STEPS[name].back
        facts = {
            "patience": steps.PATIENCE,
            "travel_z": self.ways.travel_z(),
            "goal": self.goal(steps.after(name)),
            "back_goal": self.goal(back) if back in PLACES else "",
            "found": found(state),
            "floor": "",
            "paper_z": 0.0,
            "values": "",
            "not_saved": "",
        }
        if name.startswith("touch_"):
            z = [state.heights.get(site) for site in PLACES[:2]]
            floor = self.ways.run(state.sites).floor(*z[: TOUCHED[name]])
            facts["floor"] = "at Z=%.2f" % (floor,)
        if name in ("gap", "paper"):
            facts["paper_z"] = self.ways.contact(state) + OVER_SHEET
        if name == "save":
            facts.update(summary(self.ways, state, self.saver))
        return facts

    # The move that a step begins with, in words; empty: none
    def goal(self, name):
        if name not in PLACE_OF:
            return ""
        text = "the head lifts to Z=%.1f" % (self.ways.travel_z(),)
        site = self.ways.candidate(PLACE_OF[name], self.state)
        if site is None:
            return text
        return "%s and moves to X=%.1f Y=%.1f" % (text, site.x, site.y)

    # What the steps do

    # The head to where a step begins
    def enter(self, name):
        state = self.state
        if name == "paper":
            if self.hands.is_attached():
                raise CalibrationError(
                    "the probe is attached, the nozzle cannot reach the sheet;"
                    " take it off, or take the type of the switch"
                )
            x, y, z = self.ways.sheet(state)
            self.ways.go(x, y)
            speed = self.module.settings.pin.lift_speed
            self.host.toolhead.manual_move([None, None, z], speed)
        elif name in PLACE_OF:
            site = self.ways.candidate(PLACE_OF[name], state)
            if site is None:
                self.ways.lift()
                return
            self.ways.places().check_reach(site)
            self.ways.go(site.x, site.y)

    def do_pin(self, gcmd):
        self.hands.test_pin(gcmd)

    def do_off(self, gcmd):
        self.hands.test_off()

    def do_probe(self, gcmd):
        self.hands.test_probe(gcmd)

    def do_home(self, gcmd):
        homed = self.host.toolhead_status()["homed_axes"]
        if any(axis not in homed for axis in "xyz"):
            self.host.gcode.run_script_from_command("G28")
        running.check_homed(self.host)
        self.state.mark = self.module.frame.mark()

    def take_place(self, name):
        self.state.sites[name] = self.ways.here(name, self.state)

    def do_nozzle(self, gcmd):
        self.take_place("nozzle")
        self.ways.lift()

    def do_switch(self, gcmd):
        self.take_place("switch")

    def do_bed(self, gcmd):
        self.take_place("bed")

    def fetch(self, *parts):
        state, module = self.state, self.module
        state.fetched = True
        for part in parts:
            module.run_template(part)
        running.check_homed(self.host)
        state.mark = module.frame.mark()

    def put_away(self):
        if self.state.fetched:
            self.module.run_template("end")
            self.state.fetched = False
            running.check_homed(self.host)

    def do_attach(self, gcmd):
        self.ways.lift()
        if self.hands.is_attached():
            return
        with self.module.holding_probe():
            self.fetch("start", "before_switch")
        if not self.hands.is_attached():
            raise CalibrationError(
                "the probe reads triggered: neither start_gcode nor"
                " before_switch_gcode has attached it; attach it by hand, or"
                " correct them"
            )

    def do_touch_nozzle(self, gcmd):
        state = self.state
        self.ways.lift()
        state.heights, state.samples = {}, {}
        with self.module.holding_probe():
            self.put_away()
            self.fetch("start")
            self.touch("nozzle", lambda run: run.measure_nozzle())

    def do_touch_switch(self, gcmd):
        state, nozzle_z = self.state, self.state.heights["nozzle"]
        with self.module.holding_probe():
            self.ways.lift()
            self.module.attach_probe(state.mark)
            run = self.touch("switch", lambda run: run.measure_switch(nozzle_z))
        if run.warnings:
            raise CalibrationError("; ".join(run.warnings))

    def do_touch_bed(self, gcmd):
        z = [self.state.heights[name] for name in PLACES[:2]]
        with self.module.holding_probe():
            self.touch("bed", lambda run: run.measure_bed(*z))
            self.put_away()

    def touch(self, name, measure):
        run = self.ways.run(self.state.sites)
        with running.always(self.host, run.lift, "lifting"):
            self.state.heights[name] = measure(run)
        self.state.samples[name] = list(run.plan.samples[name])
        return run

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

    def do_paper(self, gcmd):
        contact = self.ways.contact(self.state)
        self.use_switch_offset(steps.from_paper(contact, self.host.z()))
        self.ways.lift()

    def do_save(self, gcmd):
        saved = [
            self.saver.save(self.host.name, option, text)
            for option, text in values(self.ways, self.state)
        ]
        self.close()
        if any(saved):
            self.host.gcode.run_script_from_command("SAVE_CONFIG")

    def close(self):
        self.state = None
        self.host.gcode.respond_raw(END)

    def abort(self, gcmd):
        state = self.state
        self.host.gcode.respond_raw(END)

        def leave(gcmd):
            if state.mark is not None:
                self.ways.lift()
                with self.module.holding_probe():
                    self.put_away()

        try:
            work = functools.partial(self.kept_offset, leave, gcmd)
            self.module.runner.run(gcmd, work, "setup", 0)
        finally:
            self.state = None
        gcmd.respond_info(
            "%s: the set-up has ended, nothing was saved" % (self.host.name,)
        )
