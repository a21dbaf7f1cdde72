"""Set-ups by dialogs: steps as data, what is shown of them, jogging, saving.

A set-up is a row of questions, each a Step.  One command asks a question and ends,
the same command with STEP=<name> answers it.  Its parameters:

    ANSWER=<word>     another answer than the first button's
    X=, Y=, Z=<mm>    move the toolhead by so much instead of answering
    WIDTH=<mm>        the jog buttons move by so much from now on
    JOG=1, JOG=0      show the jog buttons, or the answers, where a dialog has no
                      room for both
    STEP=ABORT        end the set-up, nothing is saved

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Dict, List, Mapping, Optional, Sequence, Tuple

from . import attached, dialog, options
from .dialog import Button
from .errors import CalibrationError
from .host.klippy import Endstop, GCodeCommand
from .host.printer import Host

# Buttons of a dialog, at most: on the small screen of a printer more of them hide the
# sentences
MOST_BUTTONS = 8

# By how much (mm) the buttons move the toolhead; more than the largest is refused.
WIDTHS = (10.0, 1.0, 0.1)
LARGEST_JOG = 10.0

# Seconds to press something by hand, and how often a switch is looked at meanwhile
HAND_PATIENCE = 20.0
READ_INTERVAL = 0.1

# Sentences of dialogs
STOP = "Keep a hand on the emergency stop."
JOGS = "The buttons move the toolhead; you may move it as you like, too."
PAD = "'Move' shows buttons that move the toolhead; you may move it as you like, too."
DONE = "'Done' shows the answers; nothing moves."
SAVED = "'Save' has SAVE_CONFIG write these into printer.cfg; Klipper restarts."


@dataclass(frozen=True)
class Answer:
    """A button that answers a step, or moves on from it.

    parameter, word: what the button adds to the command; no word: nothing.
    """

    label: str
    word: str = ""
    colour: str = "primary"
    parameter: str = "ANSWER"


@dataclass(frozen=True)
class Step:
    """A question of a set-up.

    name: STEP= of its command. number: counts what a person has to press; steps that
    follow by themselves share one. text: a sentence a line, filled in from facts; the
    last one says what the first button does, and is all that KlipperScreen shows.
    go_on: label of the first button. more: further answers, in the footer. choices:
    further ones above it, in a row. back: the step that 'Back' leads to; empty: it is
    the first one. axes: those that have jog buttons. widths: what these move by (mm),
    widest first; width: at first.
    """

    name: str
    number: int
    title: str
    text: Tuple[str, ...]
    go_on: str
    more: Tuple[Answer, ...] = ()
    choices: Tuple[Answer, ...] = ()
    back: str = ""
    axes: str = ""
    widths: Tuple[float, ...] = WIDTHS
    width: float = WIDTHS[0]

    def answers(self) -> List[Answer]:
        """Return the buttons of the footer, but for the one that ends the set-up."""
        answers = [Answer(self.go_on), *self.more]
        if self.back:
            answers.append(Answer("Back", "BACK", "warning"))
        return answers


# The set-up of a section that is under way, and its dialogs
class Wizard:
    """Knows which step of a set-up is asked, and shows it.

    step: what is asked; None: no set-up is under way. The section that is set
    up does what the answers say.
    """

    def __init__(
        self,
        host: Host,
        command: str,
        *,
        parameter: str = "STEP",
        abort: str = "",
    ) -> None:
        """Begin with no set-up under way.

        command: the one that answers, abort: the one that ends, where it is another.
        parameter: what names the step in the command of a button.
        """
        self.host = host
        self.command = command
        self.parameter = parameter
        self.abort = abort or f"{command} {parameter}=ABORT"
        self.steps: Dict[str, Step] = {}
        self.step: Optional[Step] = None
        # What a jog button moves by (mm)
        self.width = WIDTHS[0]
        # Where the answers do not fit beside the jog buttons, these are shown
        self.is_jogging = False
        # SAVE_CONFIG was run in this set-up, and has refused
        self.is_refused = False

    ##################################################################
    # Which step is asked
    ##################################################################

    def begin(self, steps: Sequence[Step]) -> None:
        """Ask the first of these steps next."""
        self.steps = {step.name: step for step in steps}
        self.is_refused = False
        self.enter(steps[0].name)

    def enter(self, name: str) -> None:
        """Ask a step next."""
        self.step = self.steps[name]
        self.width = self.step.width
        self.is_jogging = True

    def close(self) -> None:
        """Ask nothing any more: the set-up is over."""
        self.step = None
        attached.of(self.host.printer).answered(self.host.section)
        self.hide()

    def hide(self) -> None:
        """Close the dialog; the question stays."""
        self.host.gcode.respond_raw(dialog.END)

    def check_no_print(self, gcmd: GCodeCommand) -> None:
        """Raise the command's error while a print is under way or paused."""
        section = self.host.section
        if self.host.print_state():
            raise gcmd.error(f"{section}: not during a print")
        if dialog.is_paused(self.host):
            raise gcmd.error(f"{section}: {dialog.PAUSED}")

    def check_asked(self, gcmd: GCodeCommand, name: str) -> None:
        """Raise the command's error where STEP= is neither asked nor the end.

        A button that is pressed twice must not answer the question that comes next.
        """
        section = self.host.section
        if self.step is None:
            # The dialog may be one of before a restart
            self.hide()
            raise gcmd.error(
                f"{section}: no set-up is under way, as a restart ends it, too,"
                f" and nothing was saved; begin with {self.command}"
            )
        if name not in (self.step.name, "abort"):
            raise gcmd.error(
                f"{section}: STEP={name} is not what is asked now, which is"
                f" STEP={self.step.name}; {self.command} shows it again"
            )

    def answer(self, gcmd: GCodeCommand) -> str:
        """Return the word of ANSWER=; empty: the first button was pressed.

        Raises CalibrationError where the step has no such answer.
        """
        step = self.asked()
        answers = [*step.answers(), *step.choices]
        words = [a.word for a in answers if a.parameter == "ANSWER"]
        word = options.param_word(gcmd, "ANSWER").upper()
        if word not in words:
            named = ", ".join(word or "none" for word in words)
            raise CalibrationError(
                f"ANSWER={word} is none of STEP={step.name}: {named}"
            )
        return word

    def asked(self) -> Step:
        """Return the step that is asked; a set-up has to be under way."""
        assert self.step is not None
        return self.step

    ##################################################################
    # Jogging
    ##################################################################

    def turns_page(self, gcmd: GCodeCommand) -> bool:
        """Do what WIDTH= or JOG= says; return whether the command has one of them.

        Nothing moves.  Raises the command's error where the value is wrong.
        """
        widths = self.asked().widths
        width = options.param_number(gcmd, "WIDTH")
        if width is not None:
            if width not in widths:
                named = ", ".join(f"{w:g}" for w in widths)
                raise gcmd.error(
                    f"{self.host.section}: WIDTH={width:g} is none of {named}"
                )
            self.width = width
        jogging = options.param_int(gcmd, "JOG", minval=0, maxval=1)
        if jogging is not None:
            self.is_jogging = bool(jogging)
        return width is not None or jogging is not None

    def is_jog(self, gcmd: GCodeCommand) -> bool:
        """Say whether the command moves the toolhead instead of answering."""
        return any(gcmd.get(axis, "").strip() for axis in "XYZ")

    def distances(self, gcmd: GCodeCommand) -> Dict[str, float]:
        """Return by how much (mm) each axis is to move that the command names.

        Raises CalibrationError where one stays as it is at this step.
        """
        distances = {}
        for axis in "XYZ":
            distance = options.param_number(gcmd, axis)
            if distance is None:
                continue
            if axis not in self.asked().axes:
                raise CalibrationError(f"{axis} stays as it is here")
            distances[axis] = distance
        return distances

    def move(
        self,
        gcmd: GCodeCommand,
        ends: Sequence[Optional[float]],
        speed: float,
        z_speed: float,
    ) -> None:
        """Move to where a jog ends, up first, and say where that is.  Pauses.

        ends: toolhead X, Y and Z (mm); None: the axis stays. speed, z_speed: of a
        move with and without X or Y (mm/s).
        """
        toolhead = self.host.toolhead
        x, y, z = ends
        is_flat = (x, y) == (None, None)
        if z is not None and z > toolhead.get_position()[2]:
            toolhead.manual_move([None, None, z], z_speed)
        toolhead.manual_move([x, y, z], z_speed if is_flat else speed)
        # The user looks before the next one
        toolhead.wait_moves()
        x, y, z = toolhead.get_position()[:3]
        gcmd.respond_info(f"X={x:.3f} Y={y:.3f} Z={z:.3f}")

    ##################################################################
    # What is shown
    ##################################################################

    def gcode(self, parameter: str = "", value: str = "") -> str:
        """Return the command that answers the step, with a parameter."""
        step = self.asked().name.upper()
        gcode = f"{self.command} {self.parameter}={step}"
        return f"{gcode} {parameter}={value}" if value else gcode

    def headline(self, title: str = "") -> str:
        """Return the number of the step, and its title or another one."""
        step, last = self.asked(), max(s.number for s in self.steps.values())
        return f"Step {step.number} of {last}: {title or step.title}"

    def sentences(
        self,
        facts: Mapping[str, object],
        *,
        notes: Sequence[str] = (),
        problem: str = "",
        late: str = "",
    ) -> List[str]:
        """Return what the step says.

        facts: what its text is filled in with. notes: sentences before the last one.
        problem: why the last answer was not done. late: what the toolhead has to do
        before the step can be answered.
        """
        step = self.asked()
        filled = [text.format_map(facts) for text in step.text]
        texts = [line for text in filled for line in text.split("\n") if line]
        if late:
            texts = [
                "The toolhead is not there yet.",
                f"'{step.go_on}': {late}, then this is asked again.",
            ]
        texts[-1:-1] = filter(None, notes)
        if problem:
            problem = problem.rstrip(". ")
            texts.insert(0, f"Not done: {problem}.")
        return texts

    def show(
        self, texts: Sequence[str], widest: float = LARGEST_JOG, late: str = ""
    ) -> None:
        """Show the dialog of the step, with what it says: see sentences().

        widest: jog buttons move by no more (mm). late: as there; nothing is jogged
        before.
        """
        step, texts = self.asked(), list(texts)
        footer = [self._button(answer) for answer in step.answers()]
        footer.append(Button("Abort", self.abort, "error"))
        rows = [[self._button(choice) for choice in step.choices]]
        jogs = [] if late else self._jog_rows(widest)
        if jogs and sum(map(len, [footer, *rows, *jogs])) <= MOST_BUTTONS:
            texts.insert(-1, JOGS)
            rows = jogs + rows
        elif jogs and self.is_jogging:
            # What begins with the name of a button is about an answer
            texts = [text for text in texts if not text.startswith("'")]
            texts += [JOGS, DONE]
            footer, rows = [self._page("Done", "0", "primary")], jogs
        elif jogs:
            texts.insert(-1, PAD)
            footer.insert(1, self._page("Move", "1", "warning"))
        self._draw(self.headline(), texts, footer, rows)

    def show_while_waiting(self, title: str, texts: Sequence[str]) -> None:
        """Show a dialog while a command waits for hands: all answers come too early."""
        abort = Button("Abort", self.abort, "error")
        self._draw(self.headline(title), texts, [abort], [])

    def read_switches(
        self, endstop: Endstop, other: Optional[Endstop] = None
    ) -> Tuple[bool, bool]:
        """Return whether a switch and the other one read triggered, after all moves.

        False for no other.  Pauses.
        """
        print_time = self.host.after_moves()
        this = bool(endstop.query_endstop(print_time))
        return this, other is not None and bool(other.query_endstop(print_time))

    def watch(
        self,
        before: Tuple[bool, bool],
        endstop: Endstop,
        other: Optional[Endstop] = None,
    ) -> str:
        """Wait until a hand has pressed a switch and let go; return judge()'s word.

        before: what read_switches() said before the hand was asked for, as a hand can be
        there at once.  It waits HAND_PATIENCE at most. other: a switch that has to stay
        as it is.  Pauses.
        """
        host, reactor = self.host, self.host.printer.get_reactor()
        deadline = host.eventtime() + HAND_PATIENCE
        readings = [before]
        while True:
            readings.append(self.read_switches(endstop, other))
            verdict = judge(readings)
            if verdict in ("good", "early") or host.eventtime() >= deadline:
                return verdict
            reactor.pause(host.eventtime() + READ_INTERVAL)

    def tell(self) -> None:
        """Write on the console how to go on without dialogs."""
        step = self.asked()
        self.host.say(
            f"{self.headline()}; {step.go_on}: {self.gcode()}; all that it asks:"
            f" {self.command}"
        )

    def tell_all(self, texts: Sequence[str]) -> None:
        """Write on the console what the dialog says, and the commands to type."""
        step = self.asked()
        buttons = [self._button(a) for a in (*step.answers(), *step.choices)]
        buttons.append(Button("Abort", self.abort))
        told = [self.headline(), *texts]
        told += [f"{button.label}: {button.gcode}" for button in buttons]
        if step.axes:
            moved = self.gcode(step.axes[0], f"+{step.widths[-2]:g}")
            told.append(f"move the toolhead: {moved}")
        self.host.say("\n".join(told))

    def _button(self, answer: Answer) -> Button:
        gcode = self.gcode(answer.parameter, answer.word)
        return Button(answer.label, gcode, answer.colour)

    def _page(self, label: str, jog: str, colour: str) -> Button:
        return Button(label, self.gcode("JOG", jog), colour)

    def _jog_rows(self, widest: float) -> List[List[Button]]:
        """Return a row for each axis, and one that changes by how much they move."""
        step = self.asked()
        if not step.axes:
            return []
        widths = [width for width in step.widths if width <= widest + 1e-6]
        if self.width not in widths:
            self.width = widths[0]
        moves = f"-{self.width:g}", f"+{self.width:g}"
        rows = [
            [Button(f"{axis}{by} mm", self.gcode(axis, by)) for by in moves]
            for axis in step.axes
        ]
        other = widths[(widths.index(self.width) + 1) % len(widths)]
        label = f"Steps of {other:g} mm"
        rows.append([Button(label, self.gcode("WIDTH", f"{other:g}"))])
        return rows

    def _draw(
        self,
        headline: str,
        texts: Sequence[str],
        footer: Sequence[Button],
        rows: Sequence[Sequence[Button]],
    ) -> None:
        # What an older KlipperScreen shows stays until it is closed
        self.hide()
        for line in dialog.lines(
            headline, texts, footer, list(filter(None, rows))
        ):
            self.host.gcode.respond_raw(line)
        # A hand may be near the toolhead
        answers = self.command, self.abort
        attached.of(self.host.printer).asking(self.host.section, answers)

    ##################################################################
    # The end
    ##################################################################

    def save(self, values: Sequence[Tuple[str, str]]) -> None:
        """Hand options and their texts to SAVE_CONFIG, run it, and close.  May pause.

        Raises the host's error where it refuses: it has written nothing then, and
        the lines to paste are on the console.
        """
        host, section = self.host, self.host.section
        for option, text in values:
            options.save(host.printer, section, option, text)
        try:
            host.gcode.run_script_from_command("SAVE_CONFIG")
        except host.printer.command_error:
            if not host.printer.is_shutdown():
                self.is_refused = True
                lines = [f"{option}: {text}" for option, text in values]
                host.say("\n".join([*self.by_hand(), f"[{section}]", *lines]))
            raise
        # Klippy is about to restart
        self.close()

    def by_hand(self) -> List[str]:
        """Return what to do after SAVE_CONFIG has refused; empty: it has not."""
        if not self.is_refused:
            return []
        section = self.host.section
        others = [name for name in pending(self.host) if name != section]
        texts = [
            f"SAVE_CONFIG has written nothing; write the lines into section"
            f" [{section}], in the file that has it, then RESTART."
        ]
        if others:
            named = ", ".join(others)
            texts.append(f"RESTART forgets what waits for sections {named}.")
        return texts

    def tell_end(self) -> None:
        """Say that the set-up has ended before it has saved anything."""
        self.host.say("the set-up has ended, nothing was saved")
        if self.host.section in pending(self.host):
            self.host.say("earlier values still wait for SAVE_CONFIG")


######################################################################
# What is saved
######################################################################


def pending(host: Host) -> Dict[str, Dict[str, str]]:
    """Return what waits for SAVE_CONFIG, text by option, by section."""
    status = _configfile(host).get("save_config_pending_items") or {}
    return {section: dict(items or {}) for section, items in status.items()}


def configured(host: Host, section: str) -> Dict[str, str]:
    """Return what klippy has read of a section, text by option."""
    return dict(_configfile(host)["config"].get(section, {}))


def given(host: Host, section: str, option: str) -> Optional[str]:
    """Return what an option will be after the next SAVE_CONFIG; None: not given."""
    waiting = pending(host).get(section, {})
    return waiting.get(option, configured(host, section).get(option))


def _configfile(host: Host) -> Dict[str, Dict[str, Dict[str, str]]]:
    status: Dict[str, Dict[str, Dict[str, str]]] = host.printer.lookup_object(
        "configfile"
    ).get_status(host.eventtime())
    return status


######################################################################
# What a hand has done: pure
######################################################################


def judge(readings: Sequence[Tuple[bool, bool]]) -> str:
    """Return what a hand has done to a switch, in one word.

    "good" is pressed and let go, "held" is pressed still, "early" was pressed from the
    beginning; the other switch changed with it: "both", or instead of it: "other".
    readings: whether it and the other switch read triggered; the first pair is of
    before anything was pressed.
    """
    (this_before, other_before), *readings = readings
    if this_before:
        return "early"
    pressed = [this for this, other in readings]
    has_other = any(other != other_before for this, other in readings)
    if True not in pressed:
        return "other" if has_other else "nothing"
    if has_other:
        return "both"
    return "good" if not pressed[-1] else "held"


######################################################################
# Where a jog ends: pure
######################################################################


def head_at(position: Sequence[float]) -> str:
    """Say where the toolhead is (mm), for a dialog."""
    x, y, z = position[:3]
    return f"The toolhead is at X={x:.1f} Y={y:.1f} Z={z:.2f}."


def jogged(
    axis: str,
    start: float,
    distance: float,
    limits: Tuple[float, float],
    *,
    stops: bool = False,
) -> float:
    """Return where a jog ends (mm), which begins at start.

    Raises CalibrationError where it would lead beyond the limits. One that stops ends
    at the lower limit, as long as there is any way to it. From beyond a limit it may
    lead back.
    """
    if abs(distance) > LARGEST_JOG:
        raise CalibrationError(
            f"{axis}={distance:g}: the toolhead is moved by {LARGEST_JOG:g} mm at"
            " most; take smaller steps"
        )
    low, high = limits
    end = start + distance
    if stops and start > low + 1e-6:
        end = max(end, low)
    low, high = min(low, start), max(high, start)
    if not low - 1e-6 <= end <= high + 1e-6:
        raise CalibrationError(
            f"{axis}={distance:g} would lead to {end:.3f}, outside {low:.3f} to"
            f" {high:.3f}; move it by less"
        )
    return end
