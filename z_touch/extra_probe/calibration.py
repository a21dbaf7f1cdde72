"""EXTRA_PROBE_CALIBRATE: travel and ask, touch and ask again, apply.

  EXTRA_PROBE_CALIBRATE   travels, and asks for the switch below the nozzle
  EXTRA_PROBE_CONTINUE    where the bed is not known yet: waits until a finger has
                          pressed the switch, and asks for the hand to be taken away
  EXTRA_PROBE_CONTINUE    touches it, and asks for its removal
  EXTRA_PROBE_CONTINUE    sets the G-code Z offset, or hands a value to SAVE_CONFIG
  EXTRA_PROBE_ABORT       ends it instead of either

A switch that stays where it is needs no hand: EXTRA_PROBE_CALIBRATE does it all.

Every height is a toolhead Z in mm.  The commands may pause.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, List, Optional, Sequence, Tuple

from .. import attached, command, dialog, options, pin, touch
from ..datum import Datum, HomedDatum
from ..errors import CalibrationError
from ..host.toolhead import ENDSTOP_OPTION
from ..in_force import AppliedOffset
from ..sampling import summarize
from ..wizard import HAND_PATIENCE, STOP, Step, Wizard
from . import fixed, heights
from .settings import MAX_TEMPERATURE, TRAVEL_SPEED
from .shifts import SMALLEST_PART, Shifts
from .switches import FIND_SWITCH, LOWER_FLOOR, TOO_LOW, Series

if TYPE_CHECKING:
    from ..datum import Mark
    from ..host.klippy import GCodeCommand, Handler
    from ..host.printer import Host
    from ..host.toolhead import ZAxis, ZZero
    from .settings import Settings
    from .switches import Switch

# What is asked in turn; the sentences are those of the moment
LAY = Step("switch", 1, "Lay the switch on the bed", (), "Continue")
HAND = Step("hand", 2, "Take your hand away", (), "Continue")
TAKE_AWAY = Step("removal", 3, "Take the switch away", (), "Continue")
# Where the bed is known, no finger has to press the switch
STEPS = (LAY, HAND, TAKE_AWAY)
STEPS_ON_KNOWN_BED = (LAY, dataclasses.replace(TAKE_AWAY, number=2))

# What saves baby steps into an option counts from the value with which klippy has started
BUTTONS = {
    ENDSTOP_OPTION: "Z_OFFSET_APPLY_ENDSTOP",
    "z_offset": "Z_OFFSET_APPLY_PROBE",
}

SAME_POSITION = 0.1  # mm; a toolhead further from where it was has been moved
SOFT_TEMPERATURE = 60.0  # C; here the plastic of a membrane begins to melt


@dataclass(frozen=True)
class Question:
    """What waits for an answer.

    'floor' (toolhead Z) and 'save' are those of the command, 'mark', 'xy' (mm) and 'extruder'
    say where Z=0 and the toolhead were when it began, and whose nozzle was active.
    is_bed_known: the touch ends above the bed, or where the user has said so.  bed_z is the
    toolhead Z of the bed; None: it was not measured yet.
    """

    floor: float
    save: bool
    mark: Mark
    xy: Tuple[float, float]
    extruder: str
    is_bed_known: bool
    bed_z: Optional[float] = None

    def replace(self, **changes: Any) -> Question:
        """Return the question with other values."""
        return dataclasses.replace(self, **changes)


class Calibration:
    """The commands of a calibration, and the question that is open between them.

    'switch' is what lies on the bed, 'runner' runs one command at a time, z_pin is where Z is
    homed, None: not known.
    """

    def __init__(
        self,
        host: Host,
        runner: command.Runner,
        switch: Switch,
        z_axis: ZAxis,
        z_pin: Optional[pin.Pin],
    ):
        self.host = host
        self.runner = runner
        self.switch = switch
        self.z_axis = z_axis
        self.z_pin = z_pin
        # From connect() on
        self.settings: Settings
        self.datum = Datum(host)
        # What is saved counts from there on
        self.homed = HomedDatum(self.datum)
        name = host.section.split()[-1]
        self.begin = f"EXTRA_PROBE_CALIBRATE PROBE={name}"
        self.wizard = Wizard(
            host,
            f"EXTRA_PROBE_CONTINUE PROBE={name}",
            parameter="QUESTION",
            abort=f"EXTRA_PROBE_ABORT PROBE={name}",
        )
        # What the step that is asked wants to know again; None: nothing is asked
        self.question: Optional[Question] = None
        # Of the last one that was applied or saved (mm); None: there is none
        self.last_offset: Optional[float] = None
        # The offset in force is right with any G28, not only with the Z=0 that it was made for
        self.is_for_g28 = True
        self.applied = AppliedOffset(
            host, self.begin, self.datum, self._moved_since
        )
        # What waits for SAVE_CONFIG; None: nothing
        self.unsaved: Optional[ZZero] = None
        # All sections have registered their commands then
        register = host.printer.register_event_handler
        register("klippy:mcu_identify", self._watch_buttons)
        command.register_commands(host, self, name)

    def connect(self, settings: Settings) -> None:
        """Take the settings, which are complete."""
        self.settings = settings

    def waits_for(self) -> str:
        """Return what is asked for, in one word; empty: nothing."""
        return self.wizard.step.name if self.wizard.step else ""

    def check_answered(self) -> None:
        """Raise CalibrationError while a question is open.

        In a print the user has cleared the bed: an answer comes no more.
        """
        if self.waits_for() and not self.host.print_state():
            raise CalibrationError(
                "EXTRA_PROBE_CALIBRATE waits for an answer, and somebody's hand"
                f" may be near; answer with {self.wizard.command}, or"
                f" {self.wizard.abort}"
            )

    ##################################################################
    # The beginning: travel, and ask for the switch
    ##################################################################

    cmd_EXTRA_PROBE_CALIBRATE_help = "Set the Z offset with a switch on the bed"

    def cmd_EXTRA_PROBE_CALIBRATE(self, gcmd: GCodeCommand) -> None:
        """Travel to where the switch is to lie, and ask for it; or touch one that is fixed."""
        if self.settings.fixed:
            with self.runner.running(gcmd, "touch", 0):
                save = options.param_flag(gcmd, "SAVE")
                self._calibrate_fixed(save, options.param_number(gcmd, "FLOOR"))
            return
        self._close()
        with self.runner.running(gcmd, "touch", 0):
            save = options.param_flag(gcmd, "SAVE")
            floor_param: Optional[float] = options.param_number(gcmd, "FLOOR")
            self._check_printer()
            self._check_settings(save)
            warnings = [*self._check_temperature(), *self._look_at_probe()]
            # Before a hand comes near: later nothing drives to a dock by itself
            goes_on = self.settings.xy_position is not None
            self.switch.free_nozzle(goes_on)
            self._travel()
            self._stand_still()
            floor = self._floor(floor_param)
            is_bed_known = self._is_bed_known(floor_param)
            x, y = self.host.toolhead.get_position()[:2]
            mark, extruder = self.datum.mark(), self.host.extruder()
            self.question = Question(
                floor, save, mark, (x, y), extruder, is_bed_known
            )
            self.wizard.begin(STEPS_ON_KNOWN_BED if is_bed_known else STEPS)
            self._ask_for_switch(self.question, warnings)

    def _check_settings(self, save: bool) -> None:
        """Raise CalibrationError where the switch is not known, or what to save."""
        settings = self.settings
        if settings.fixed and settings.switch_height is None:
            raise CalibrationError(fixed.NO_HEIGHT)
        if not settings.fixed and not settings.z_offset:
            raise CalibrationError(
                "z_offset is 0; set it to the thickness of the switch, in mm"
            )
        if not save:
            return
        z_zero = self.host.axes.z_zero()
        if z_zero is None:
            raise CalibrationError(
                "SAVE=1: it is not known where Z gets its zero with"
                f" '{self.z_axis.endstop_pin}'; leave SAVE out"
            )
        if settings.fixed and z_zero.option == "z_offset":
            # The probe's height above the bed is the same wherever Z=0 is
            return
        moved = self.homed.moved()
        if moved:
            raise CalibrationError(
                f"SAVE=1: {moved}, and what is saved counts from G28 on; run G28"
                " first, or leave SAVE out where that levels after homing Z"
            )

    def _look_at_probe(self) -> List[str]:
        """Return the warning that a [probe] seems to be on the toolhead, if it does.

        Of one that macros fetch only its switch tells, where it is wired as [z_calibration]
        needs it.
        """
        printer = self.host.printer
        endstop = self.host.probing.endstop()
        is_wired = printer.lookup_object("z_calibration", None) is not None
        is_plain = attached.of(printer).carrier(self.host) is None
        if not (is_wired and is_plain and endstop is not None):
            return []
        if endstop.query_endstop(self.host.after_moves()):
            return []
        return ["The probe reads open, as on the toolhead; put it away first."]

    def _travel(self) -> None:
        """Lift to safe_z_height, and go to xy_position, if there is one."""
        self._lift()
        site = self.settings.xy_position
        if site is not None:
            everything = attached.of(self.host.printer)
            everything.go_to(self.host, site.x, site.y, TRAVEL_SPEED)

    def _lift(self) -> None:
        """Lift to safe_z_height, never down."""
        speed = self.settings.sampling.lift_speed
        touch.raise_to(self.host, self.settings.safe_z_height, speed)

    def _floor(self, floor_param: Optional[float]) -> float:
        """Return the lowest toolhead Z of the touches, where a hand has laid the switch."""
        floor = heights.floor(
            self.settings,
            self.host.axes.z_zero(),
            self.z_axis.position_min,
            floor_param,
            is_proved=True,
            moved_by=self.homed.moved_by(),
        )
        return heights.above_pin(floor, pin.floor(self.host, self.z_pin))

    def _is_bed_known(self, floor_param: Optional[float]) -> bool:
        """Return whether the user has said how low a touch may go, or where the bed is."""
        settings = self.settings
        if floor_param is not None or settings.position_min is not None:
            return True
        return heights.is_calibrated(
            settings, self.host.axes.z_zero(), self.homed.moved_by()
        )

    def _ask_for_switch(
        self, question: Question, warnings: Sequence[str] = ()
    ) -> None:
        """Ask for the switch below the nozzle."""
        sentences = [
            "Flat and right below the nozzle, which is clean.",
            *warnings,
        ]
        moved = self.homed.moved()
        if moved:
            reason = moved[0].upper() + moved[1:]
            sentences.append(
                f"{reason}: the offset will be right until the next G28 only."
            )
        if pin.is_over_pin(self.host, self.z_pin):
            sentences.append(
                "The toolhead is over the pin of the Z endstop; move it."
            )
        if question.is_bed_known:
            sentences.append(_lowers(question))
        else:
            sentences.append(
                "Continue waits until you press the switch once with a finger."
            )
        self._ask(sentences)

    ##################################################################
    # A switch that stays where it is: touch it, touch the bed, apply
    ##################################################################

    def _calibrate_fixed(self, save: bool, floor: Optional[float]) -> None:
        """Touch the switch with the nozzle and the bed with the probe, and apply the result.

        It may be done in a print, before the first layer.  'floor' is FLOOR of the command,
        None: not given.
        """
        self._check_ready()
        self._check_settings(save)
        if save and self.host.print_state():
            raise CalibrationError(
                "SAVE=1 would print with a G-code Z offset of 0; leave it out in a print"
            )
        self._check_temperature()
        self.switch.free_nozzle(goes_on=True)
        self._travel()
        self._come_down()
        trigger_z = self._touch_switch(self._floor(floor), FIND_SWITCH)
        switch_height = self.settings.switch_height
        # The command was refused without one
        assert switch_height is not None
        bed_z = heights.bed_below_fixed(trigger_z, switch_height)
        probe_z = fixed.touch_bed(self.host, self.settings, bed_z)
        warning = fixed.check_height(self.host, probe_z, bed_z)
        self._apply_fixed(save, bed_z, probe_z)
        if warning:
            self.host.say(warning)

    def _apply_fixed(self, save: bool, bed_z: float, probe_z: float) -> None:
        """Set the G-code Z offset, or hand a value to SAVE_CONFIG with an offset of 0."""
        x, y = fixed.bed_point(self.host, self.settings)
        place = "which the probe has touched"
        shifts = Shifts(self.host, (x, y, bed_z), save, place)
        offset = bed_z - shifts.height()
        z_zero = self.host.axes.z_zero()
        if save and z_zero is not None:
            if z_zero.option == "z_offset":
                # The probe's height above the bed, however well G28 has homed
                offset = z_zero.z - (probe_z - bed_z)
            self._save(offset)
        self._set_offset(offset, save)
        self._tell(bed_z, shifts, offset)

    ##################################################################
    # The questions and their answers
    ##################################################################

    def _ask(self, sentences: List[str]) -> None:
        """Show the step that is asked, as a dialog and on the console."""
        title = self.wizard.asked().title
        self.host.say(" ".join([f"{title}.", *sentences]))
        self.host.say(f"then {self.wizard.command}, or {self.wizard.abort}")
        self.wizard.show(sentences)

    def _check_asked(self, gcmd: GCodeCommand) -> None:
        """Raise the command's error where QUESTION= is not what is asked.

        A button that is pressed twice must not answer the question that comes next.
        """
        asked = options.param_word(gcmd, "QUESTION").lower()
        waits_for = self.waits_for()
        if waits_for and asked not in ("", waits_for):
            raise gcmd.error(
                f"{self.host.section}: QUESTION={asked} is not what is asked"
                f" now, which is {waits_for}"
            )

    def _close(self) -> None:
        """Ask nothing any more."""
        self.question = None
        self.wizard.close()

    def _answered(self, gcmd: GCodeCommand) -> Question:
        """Close the dialog, and return what its step wants to know again.

        Raises the command's error where nothing is asked.
        """
        question = self.question
        # The dialog may be one of before a restart
        self._close()
        if question is None:
            raise gcmd.error(
                f"{self.host.section}: nothing was asked; begin with {self.begin}"
            )
        return question

    cmd_EXTRA_PROBE_ABORT_help = "End a calibration, everything as before"

    def cmd_EXTRA_PROBE_ABORT(self, gcmd: GCodeCommand) -> None:
        """End the calibration; nothing was changed."""
        self._answered(gcmd)
        self.host.say("the calibration ends, nothing was changed")

    cmd_EXTRA_PROBE_CONTINUE_help = "Go on with a calibration"

    def cmd_EXTRA_PROBE_CONTINUE(self, gcmd: GCodeCommand) -> None:
        """Wait for a finger, or touch the switch that was laid, or apply what was measured."""
        self._check_asked(gcmd)
        asked = self.wizard.step
        question = self._answered(gcmd)
        with self.runner.running(gcmd, "touch", 0):
            if asked is LAY and not question.is_bed_known:
                self._watch_and_ask(question)
            elif question.bed_z is None:
                self._touch_and_ask(question)
            else:
                self._apply(question, question.bed_z)

    ##################################################################
    # The switch is there: a finger shows that it works
    ##################################################################

    def _watch_and_ask(self, question: Question) -> None:
        """Wait until a finger has pressed the switch, and ask for the hand to be taken away.

        The question stays until it was pressed.
        """
        self._check_unchanged(question)
        self.question = question
        self.wizard.enter(LAY.name)
        endstop = self.switch.endstop()
        try:
            before = self.wizard.read_switches(endstop)
            self._ask_for_finger()
            verdict = self.wizard.watch(before, endstop)
            self._stand_still()
        except Exception:
            self._close()
            raise
        if verdict == "good":
            self.wizard.enter(HAND.name)
            works = "The switch was pressed, and works."
            self._ask([works, STOP, _lowers(question)])
            return
        self._ask_for_switch(question)
        if verdict == "early":
            raise CalibrationError(triggered_early(self.switch))
        held = "is pressed still" if verdict == "held" else "was not pressed"
        raise CalibrationError(
            f"the switch {held} after {HAND_PATIENCE:.0f} seconds; Continue, then press"
            " it once with a finger and let go, or look with"
            f" {self.switch.query} if that changes nothing"
        )

    def _ask_for_finger(self) -> None:
        """Ask the user to press the switch, in a dialog and on the console."""
        self.wizard.show_while_waiting(
            "press it now",
            [
                "Press the switch once with a finger now and let go, within"
                f" {HAND_PATIENCE:.0f} seconds. Abort is done after that."
            ],
        )
        self.host.say(
            f"press the switch once with a finger now, within {HAND_PATIENCE:.0f}"
            " seconds"
        )

    ##################################################################
    # The switch is there: touch it, and ask for its removal
    ##################################################################

    def _touch_and_ask(self, question: Question) -> None:
        """Touch the switch below the nozzle, and ask for its removal."""
        self._check_unchanged(question)
        self._check_place(question)
        for warning in self._check_temperature():
            self.host.say(warning)
        # Meanwhile the user may have fetched it again
        self.switch.free_nozzle()
        self._come_down()
        trigger_z = self._touch_switch(question.floor, LOWER_FLOOR)
        self._check_unchanged(question)
        z_offset = self.settings.z_offset
        bed_z = heights.bed_height(trigger_z, z_offset)
        if question.save:
            # Refused before a hand takes the switch away
            shifts = self._shifts(question, bed_z)
            self._corrected_zero(bed_z - shifts.height())
        self._stand_still()
        sentences = [
            f"Triggered at z={trigger_z:.3f}, so the bed is at z={bed_z:.3f}.",
            "Continue makes that Z=0.",
        ]
        if heights.is_low(bed_z):
            sentences.append(
                f"That is low; check that the switch is z_offset={z_offset:.3f} mm"
                " thick."
            )
        self.question = question.replace(bed_z=bed_z)
        self.wizard.enter(TAKE_AWAY.name)
        self._ask(sentences)

    def _touch_switch(self, floor: float, find_bed: str) -> float:
        """Touch the switch below the nozzle; return the height of its trigger."""
        sampling = self.settings.sampling
        series = Series(self.host, self.switch, sampling, find_bed, TOO_LOW)
        return summarize(series.measure(floor), sampling.result)

    def _come_down(self) -> None:
        """Come down to where the touches begin, with the switch watched on the way."""
        host, sampling = self.host, self.settings.sampling
        safe_z, speed = self.settings.safe_z_height, sampling.lift_speed
        touch.raise_to(host, safe_z, speed)
        endstop = self.switch.endstop()
        if endstop.query_endstop(host.after_moves()):
            raise CalibrationError(triggered_early(self.switch))
        head = touch.Head(host, sampling, TOO_LOW)
        head.come_down(endstop, safe_z, speed)
        head.retract()

    ##################################################################
    # The switch is gone: apply what was measured, or hand it over
    ##################################################################

    def _apply(self, question: Question, bed_z: float) -> None:
        """Set the G-code Z offset, or hand a value to SAVE_CONFIG with an offset of 0."""
        self._check_unchanged(question)
        shifts = self._shifts(question, bed_z)
        offset = bed_z - shifts.height()
        if question.save:
            saved_z = self._save(offset)
            # With the whole of bed_z the bed would be at Z=0, and that is what later floors
            # count from
            text = f"{saved_z + offset - bed_z:.3f}"
            section = self.host.section
            options.save(self.host.printer, section, "saved_homing_z", text)
        self._set_offset(offset, question.save)
        self._tell(bed_z, shifts, offset)

    def _set_offset(self, offset: float, save: bool) -> None:
        """Set the G-code Z offset (mm): to 0 where it is saved instead."""
        # G92 would shift what the offset makes right
        undone = self.host.gcode_state.undo_g92()
        if undone:
            self.host.say(undone)
        self.host.gcode_state.set_z_offset(0.0 if save else offset)
        self.last_offset = offset
        self.is_for_g28 = not self.homed.moved()
        self.applied.note()

    def _moved_since(self, mark: Mark) -> str:
        """Return what has moved Z=0 since an offset was set, in words; empty: nothing."""
        if self.is_for_g28:
            return self.homed.moved_since(mark)
        return self.datum.moved_since(mark)

    def _tell(self, bed_z: float, shifts: Shifts, offset: float) -> None:
        """Say where the bed is, and what has become of the offset (mm)."""
        name, height = "z_offset", self.settings.z_offset
        if self.settings.switch_height is not None:
            name, height = "switch_height", self.settings.switch_height
        self.host.say(
            f"trigger={bed_z + height:.6f} - {name}={height:.3f} -->"
            f" new offset={bed_z:.6f}"
        )
        for text in shifts.lines(offset):
            self.host.say(text)

    def _shifts(self, question: Question, bed_z: float) -> Shifts:
        """Return what Klipper's own features add where the switch lies."""
        point = (*question.xy, bed_z)
        return Shifts(self.host, point, question.save, "where the switch lay")

    def _corrected_zero(self, offset: float) -> ZZero:
        """Return what SAVE_CONFIG is to write for Z to be lower by 'offset' (mm)."""
        z_zero = self.host.axes.z_zero()
        # The command was refused without one
        assert z_zero is not None
        axis_limits = self.host.axes.limits()[2]
        return heights.corrected_zero(z_zero, offset, axis_limits)

    def _save(self, offset: float) -> float:
        """Hand over what Z is homed at, for Z to be lower by 'offset' (mm); return it."""
        self.unsaved = self._corrected_zero(offset)
        section, option, z = self.unsaved
        text = f"{z:.3f}"
        options.save(self.host.printer, section, option, text)
        self.host.gcode.respond_info(
            f"{section}: {option}: {text}\n{options.SAVE_HINT}\n"
            "Until then the G-code offset is 0."
        )
        return z

    ##################################################################
    # The buttons of the host, which know nothing of a calibration
    ##################################################################

    def _watch_buttons(self) -> None:
        """Wrap them: nothing else tells that they put another value over what waits."""
        wrap = self.host.wrap_command
        wrap(BUTTONS[ENDSTOP_OPTION], self._apply_endstop)
        wrap(BUTTONS["z_offset"], self._apply_probe)
        self.applied.watch_states()

    def _apply_endstop(self, button: Handler, gcmd: GCodeCommand) -> None:
        self._around_button(ENDSTOP_OPTION, button, gcmd)

    def _apply_probe(self, button: Handler, gcmd: GCodeCommand) -> None:
        self._around_button("z_offset", button, gcmd)

    def _around_button(
        self, option: str, button: Handler, gcmd: GCodeCommand
    ) -> None:
        """Refuse what would lose our value, which SAVE_CONFIG is to write; tell what is lost."""
        name, offset = BUTTONS[option], self.host.gcode_state.z_offset()
        waits = self.unsaved
        if offset and waits is not None and waits.option == option:
            raise self.host.error(
                f"{waits.option}: {waits.z:.3f} of section '{waits.section}' waits for"
                f" SAVE_CONFIG, and {name} would put another one in its place that counts"
                " from the old one; run SAVE_CONFIG and G28 first, then adjust and save"
                " again"
            )
        button(gcmd)
        ours, height = self.applied.z, self.settings.switch_height
        if not ours or height is None or abs(offset - ours) < SMALLEST_PART:
            return
        step = offset - ours
        self.host.say(
            f"{self.begin} measures without the {step:.3f} mm of baby steps that {name}"
            f" saves; for them write switch_height: {height - step:.3f} into section"
            f" '{self.host.section}'"
        )

    ##################################################################
    # What has to be so, before and after
    ##################################################################

    def _check_printer(self) -> None:
        """Raise CalibrationError where the printer prints, waits or is not homed."""
        print_state = self.host.print_state()
        if print_state:
            raise CalibrationError(
                f"a print is under way ({print_state}); end it first"
            )
        self._check_ready()

    def _check_ready(self) -> None:
        """Raise CalibrationError where the printer waits or is not homed."""
        if dialog.is_paused(self.host):
            raise CalibrationError(dialog.PAUSED)
        command.check_no_manual_probe(self.host)
        command.check_homed(self.host)
        command.check_carriage_is_kept(self.host)

    def _check_temperature(self) -> List[str]:
        """Return the warning that the nozzle is hot; raise CalibrationError if too hot."""
        temperature = self.host.nozzle_temperature()
        limit = self.settings.max_temperature
        if limit is None and not self.settings.fixed:
            limit = MAX_TEMPERATURE
        if limit is not None and temperature > limit:
            raise CalibrationError(
                f"the nozzle has, or is to have, {temperature:.0f} C, max_temperature"
                f" is {limit:.0f} C; let it cool down"
            )
        if temperature <= SOFT_TEMPERATURE:
            return []
        return [
            f"The nozzle has, or is to have, {temperature:.0f} C: a membrane may melt."
        ]

    def _check_unchanged(self, question: Question) -> None:
        """Raise CalibrationError where heights of before the question say nothing now."""
        self._check_printer()
        moved = self.datum.moved_since(question.mark)
        if moved:
            raise _changed(moved)
        if self.host.extruder() != question.extruder:
            raise _changed("another extruder is active")

    def _check_place(self, question: Question) -> None:
        """Raise CalibrationError where the toolhead may have been moved off the switch."""
        here = zip(self.host.toolhead.get_position(), question.xy)
        if max(abs(a - b) for a, b in here) > SAME_POSITION:
            raise _changed("the toolhead was moved")

    def _stand_still(self) -> None:
        """Wait for the end of all moves, before a hand comes near."""
        self.host.toolhead.wait_moves()
        if self.host.printer.is_shutdown():
            raise CalibrationError("ended by a shutdown of the printer")


def triggered_early(switch: Switch) -> str:
    """Return what to do about a switch that reads triggered too early."""
    return (
        "the switch reads triggered before it is touched; check it with"
        f" {switch.query}, and whether pin needs a '!'"
    )


def _lowers(question: Question) -> str:
    """Return what the user is told of the lowest point of the touch that comes next."""
    inside = "" if question.is_bed_known else ", which can be inside the bed"
    return (
        "Continue lowers the nozzle. If the switch does not answer, it stops at"
        f" Z={question.floor:.3f}{inside}."
    )


def _changed(what: str) -> CalibrationError:
    """Return the error for what has happened while the user was asked."""
    return CalibrationError(f"{what} since the calibration began; begin again")
