# Z_CALIBRATION_SETUP: from an empty section to the first result, by dialogs.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Each step is a command of its own, see steps.py: it does what the step before
# has announced, and asks for the next one.
#
#   pin -> off -> probe -> home                 hands: wires and polarity
#   nozzle => attach -> switch -> bed -> look   head: the sites, by its buttons
#   touch_nozzle => touch_switch => touch_bed   touches, slow
#   gap (-> paper) -> save                      switch_offset, SAVE_CONFIG
#
# What comes after => is done at once, and asked for only where it has failed.

import functools

from ..core import carrying, dialogs, options, prints, running, saving
from ..core.errors import CalibrationError
from ..z_calibration.switches import SWITCHES
from . import steps, texts
from .hands import Hands
from .head import FIRST_TOUCHES, LOOK_TIME, OVER_SHEET, GuidedHead
from .state import SITES, State, SwitchOffset
from .summary import Summary, repeats
from .touches import Touches

# Which site a step touches
TOUCHED = {"touch_" + name: name for name in SITES}

# What of the facts not every step has
FACTS = (
    "here",
    "lowest",
    "plunger",
    "sheet",
    "values",
    "not_saved",
    "saving",
    "too_small",
    "floor",
    "paper_z",
)

# Told before the touches of a site
TOUCHES = "touching the %s; where nothing is met, a touch ends at z=%.2f"

# Steps that use heights of before
NEED_HEIGHTS = ("touch_switch", "touch_bed", "gap", "paper")


# The command, and the set-up that is under way.
class Setup:
    # 'section': z_calibration's interface.Interface
    def __init__(self, section):
        self.section = section
        self.host = section.host
        saver = self.saver = saving.Saver(section.host)
        self.prints = prints.Prints(section.host)
        self.head = GuidedHead(section)
        self.hands = Hands(section, saver)
        self.touches = Touches(section, self.head, self.hands)
        self.summary = Summary(section, self.head, saver)
        # None: no set-up is under way
        self.state = None
        running.register_commands(section.host, self)

    cmd_Z_CALIBRATION_SETUP_help = "Set up the Z calibration, step by step"

    def cmd_Z_CALIBRATION_SETUP(self, gcmd):
        self.section.check_idle(gcmd)
        self.section.check_nobody_asked(gcmd)
        name = gcmd.get("STEP", "").strip().lower()
        if not name:
            self.begin(gcmd)
            return
        asked = self.state and self.state.step
        dialogs.check_step(self.host, gcmd, name, asked, steps.COMMAND)
        if name == "abort":
            self.abort(gcmd)
            return
        self.prints.check_none(gcmd)
        if not self.asks_for_print(gcmd):
            self.answered(gcmd)

    # Begins a set-up, or shows again what one that is under way asks
    def begin(self, gcmd):
        self.prints.check_none(gcmd)
        # Its end is an answer to all that is asked
        self.state = self.state or State()
        if self.asks_for_print(gcmd):
            return
        # Later a hand is near.
        carrying.of(self.host.printer).settle(self.host)
        self.ask()

    # What a print may be is asked first, in the step that it holds up
    def asks_for_print(self, gcmd):
        headline = steps.headline(self.state.step, prints.QUESTION)
        return self.prints.asks(gcmd, steps.ABORT, headline)

    # After a jog the dialog has the new place, after an error it says why.  For
    # longer work it closes: it would cover the emergency stop of a web interface.
    def answered(self, gcmd):
        is_jog = any(gcmd.get(axis, "").strip() for axis in "XYZ")
        work = self.jog if is_jog else self.go_on
        if not is_jog and self.state.step != "save":
            self.host.gcode.respond_raw(dialogs.END)
        try:
            answer = functools.partial(work, gcmd, self.state)
            self.section.run_command(gcmd, answer, "setup")
        except self.host.printer.command_error as e:
            if not self.host.printer.is_shutdown() and self.state is not None:
                self.ask(str(e))
            raise
        finally:
            if not self.host.printer.is_shutdown():
                self.prints.has_moved()
        if self.state is not None:
            self.ask(is_quiet=is_jog)

    ##################################################################
    # Answers
    ##################################################################

    def jog(self, gcmd, state):
        if not state.arrived:
            raise CalibrationError(
                "the head has not got to this place yet; answer the question"
            )
        self.check_heights(state)
        state.probe.is_attached = self.hands.is_attached()
        if state.step == "paper":
            self.check_sheet(gcmd, state)
            self.head.check_over_sheet(state)
        self.head.jog(gcmd, state, state.probe.is_attached)

    # Does what was announced, then moves the head to where the next step begins
    def go_on(self, gcmd, state):
        if self.switch_type(gcmd):
            state.step = "save"
            return
        answer = gcmd.get("ANSWER", "").strip().upper()
        following = steps.follow(state.step, answer)
        if state.step == "off":
            state.probe.is_fixed = answer == "SKIP"
        self.check_heights(state)
        if not (state.arrived or answer):
            self.arrive(gcmd, state)
            return
        if not answer:
            self.work_of(state.step)(gcmd, state)
        elif state.step == "paper":
            self.head.lift(state)
        if self.state is not None:
            state.step, state.arrived = following, False
            self.arrive(gcmd, state)

    # The head to where a step begins; what needs no other question is done at once
    def arrive(self, gcmd, state):
        self.enter(state.step)
        state.arrived = True
        if state.step in steps.CHAINED:
            self.work_of(state.step)(gcmd, state)
            state.step, state.arrived = steps.after(state.step), False
            self.arrive(gcmd, state)

    # work(gcmd, state) of a step; most only ask
    def work_of(self, name):
        touches, head = self.touches, self.head
        return {
            "pin": self.test_pin,
            "off": self.hands.test_off,
            "probe": self.hands.test_probe,
            "home": touches.home,
            "nozzle": head.take_site,
            "attach": touches.attach,
            "switch": head.take_site,
            "bed": head.take_site,
            "touch_nozzle": touches.touch_nozzle,
            "touch_switch": touches.touch_switch,
            "touch_bed": touches.touch_bed,
            "gap": self.check_sheet,
            "paper": self.measure_paper,
            "save": self.save,
        }.get(name, lambda gcmd, state: None)

    # Heights hold no more where Z was homed again, or with another nozzle; sites do.
    # The last step only saves what was measured.
    def check_heights(self, state):
        if state.mark is None or state.step == "save":
            return
        self.check_homed(state)
        moved = self.section.moved_since(state.mark) or self.other_nozzle(state)
        if not moved:
            return
        state.touched, state.pin_below = {}, None
        state.mark = self.section.mark()
        if state.step in NEED_HEIGHTS:
            state.step, state.arrived = "touch_nozzle", True
            text = "%s: the heights hold no more, the first touches begin again"
            raise CalibrationError(text % (moved,))

    # That may be longer than the one that was touched; empty: it is the same
    def other_nozzle(self, state):
        active = self.host.extruder()
        if not state.touched or active == state.extruder:
            return ""
        return "%s is active, and the pin was touched with %s" % (
            active,
            state.extruder,
        )

    def check_homed(self, state):
        is_homed = self.touches.is_homed()
        may_hang = not (is_homed or state.probe.is_fixed)
        if may_hang and self.hands.is_attached():
            raise CalibrationError(
                "not homed, and the probe is on the head; put it away unless"
                " Z is homed with it, then home all axes (G28)"
            )
        moved = is_homed and self.section.pin_moved()
        was_told, state.is_pin_told = state.is_pin_told, bool(moved)
        # A G28 that levels in the end would be asked for again and again.
        if moved and not was_told:
            raise CalibrationError(
                "%s, and nobody knows how high the pin is; home Z again (G28 Z),"
                " the probe off the head" % (moved,)
            )

    ##################################################################
    # What is shown
    ##################################################################

    # 'is_quiet': the console has been told already
    def ask(self, problem="", is_quiet=False):
        state = self.state
        late = "" if state.arrived else self.goal(state.step)
        shown, said = steps.ask(state.step, self.facts(), problem, late)
        if not is_quiet:
            self.host.say(said)
        self.host.gcode.respond_raw(dialogs.END)
        for line in shown:
            self.host.gcode.respond_raw(line)
        # A hand may be near the head.
        answers = steps.COMMAND, steps.ABORT
        carrying.of(self.host.printer).asking(self.host.section, answers)

    # What the texts of the steps are filled in with
    def facts(self):
        state, name = self.state, self.state.step
        back = steps.STEPS[name].back
        kind = state.switch_offset.kind if state.switch_offset else ""
        facts = dict.fromkeys(FACTS, "")
        is_by_hand = not self.section.is_fetched()
        facts.update(texts.BY_HAND if is_by_hand else texts.BY_GCODE)
        facts.update(
            patience=steps.HAND_PATIENCE,
            travel_z=self.head.travel_z(state),
            goal="" if name == "gap" else self.goal(steps.next_asked(name)),
            back_goal=self.goal(back) if back in SITES else "",
            look_goal=self.goal("look"),
            repeats=repeats(state),
            touches=FIRST_TOUCHES,
            come_down=steps.COME_DOWN,
            of_a_list=steps.of_a_list(kind),
            room=0.0,
        )
        if self.touches.is_homed():
            facts["here"] = dialogs.head_at(self.head.position())
        if name in TOUCHED:
            facts["floor"] = self.floor(TOUCHED[name])
        self.add_facts(name, facts)
        return facts

    # What only one step needs
    def add_facts(self, name, facts):
        state = self.state
        if name in ("nozzle", "switch"):
            facts["lowest"] = self.head.lowest(state)
        if name == "switch" and self.head.is_at_plunger(state):
            facts["plunger"] = texts.AT_PLUNGER
        if name in ("gap", "paper"):
            facts["paper_z"] = state.contact() + OVER_SHEET
        if name == "paper":
            z = self.host.motion.z()
            is_too_high = steps.is_too_high(state.contact(), z)
            facts["room"] = steps.paper_room(state.contact(), z)
            facts["sheet"] = texts.TOO_HIGH if is_too_high else texts.NEAR_SHEET
        if name == "save":
            facts.update(self.summary.facts(state))
            facts["too_small"] = steps.too_small(state.switch_offset.value)

    # Where a touch of a site ends at the latest (toolhead Z, mm)
    def floor(self, name):
        before = self.state.heights_before(name)
        return self.head.first_touches(self.state).floor(*before)

    # The move that a step begins with, in words; empty: none
    def goal(self, name):
        text = "the head lifts to Z=%.1f" % (self.head.travel_z(self.state),)
        if name == "paper":
            goal = self.head.over_sheet(self.state)
            return "%s, moves to X=%.1f Y=%.1f and down to Z=%.2f" % (
                (text,) + goal
            )
        if name == "look":
            text += " and goes over all three places once more, %d seconds each"
            return text % (LOOK_TIME,)
        if name not in SITES:
            return ""
        site = self.head.candidate(name, self.state)
        if site is None:
            return text
        return "%s and moves to X=%.1f Y=%.1f" % (text, site.x, site.y)

    ##################################################################
    # What the steps do
    ##################################################################

    # The head to where a step begins
    def enter(self, name):
        state = self.state
        if name == "paper":
            self.head.go_over_sheet(state)
        elif name == "look":
            self.head.look_around(state)
        elif name in TOUCHED and name in steps.CHAINED:
            self.host.say(TOUCHES % (TOUCHED[name], self.floor(TOUCHED[name])))
        elif name in SITES:
            self.go_to_site(name, state)

    def go_to_site(self, name, state):
        state.probe.is_attached = self.hands.is_attached()
        site = self.head.candidate(name, state)
        if site is None:
            self.head.lift(state)
            return
        self.section.site_finder().check_reach(site)
        self.head.go(state, site.x, site.y, name != "bed")

    # After G28 the nozzle may stand on it
    def test_pin(self, gcmd, state):
        if self.touches.is_homed():
            self.head.lift(state)
        self.hands.test_pin(gcmd, state)

    def check_sheet(self, gcmd, state):
        self.head.over_sheet(state)
        if self.hands.is_attached():
            raise CalibrationError(
                "the probe is attached, so the nozzle cannot reach the sheet;"
                " take it off, or take the type of the switch"
            )

    # Whether the switch_offset was told
    def switch_type(self, gcmd):
        name = gcmd.get("TYPE", "").strip().upper()
        highest = steps.LARGEST_SWITCH_OFFSET
        value = options.param_number(gcmd, "VALUE", minval=0.0, maxval=highest)
        if name and name not in SWITCHES:
            raise CalibrationError(
                "TYPE=%s: none of %s; give VALUE=mm"
                % (name, ", ".join(SWITCHES))
            )
        value = SWITCHES.get(name, value)
        if value is not None:
            if self.state.step != "gap":
                raise CalibrationError("TYPE and VALUE belong to STEP=GAP")
            self.use_switch_offset(value, name)
        return value is not None

    # 'kind': of the switch, where it is the value (mm) of the list
    def use_switch_offset(self, value, kind=""):
        z_offset = self.state.contact() - value
        low, high = self.section.settings().offset_margins
        if not low <= z_offset <= high:
            raise CalibrationError(
                "with %.3f mm Z=0 would move by %.3f mm, outside the %.3f to"
                " %.3f that are allowed; home Z again (G28 Z), then check the"
                " three places" % (value, z_offset, low, high)
            )
        self.state.switch_offset = SwitchOffset(value, kind)

    def measure_paper(self, gcmd, state):
        self.head.check_over_sheet(state)
        contact = state.contact()
        self.use_switch_offset(steps.from_paper(contact, self.host.motion.z()))
        self.head.lift(state)

    ##################################################################
    # The end
    ##################################################################

    # What has failed is asked again: nothing is over before klippy restarts.
    def save(self, gcmd, state):
        self.summary.save(state)
        self.close()

    def close(self):
        self.state = None
        carrying.of(self.host.printer).answered(self.host.section)
        self.host.gcode.respond_raw(dialogs.END)

    def abort(self, gcmd):
        state, is_printing = self.state, self.prints.may_be()
        self.close()
        leave = self.touches.leave
        work = functools.partial(leave, gcmd, state, is_printing)
        self.section.run_command(gcmd, work, "setup")
        dialogs.tell_end(self.host, self.saver)
