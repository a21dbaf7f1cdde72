# Questions to the user: a dialog in the web interfaces and on KlipperScreen,
# and two commands for those who see none.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# What the interfaces have in common, read from the lines of the console:
#
#   // action:prompt_begin HEADLINE
#   // action:prompt_text TEXT
#   // action:prompt_button_group_start
#   // action:prompt_button LABEL|G-CODE|COLOUR
#   // action:prompt_button_group_end
#   // action:prompt_footer_button LABEL|G-CODE|COLOUR
#   // action:prompt_show
#   // action:prompt_end
#
# The G-code of a button waits for the command that is running: a command asks,
# and ends; another one goes on.

from . import carrying
from .errors import CalibrationError

PREFIX = "// action:prompt_"


# Nothing in a text may end the line, or the part of a button that it is in.
def plain(text):
    return " ".join(str(text).split()).replace("|", "/")


# The lines of a dialog.  Buttons are (label, G-code, colour), those of a group
# stand in a row.  Each sentence is a text of its own; KlipperScreen shows only the
# last one, which has to say what the first button does.
def lines(headline, sentences, footer, groups=()):
    yield PREFIX + "begin " + plain(headline)
    for sentence in filter(None, map(plain, sentences)):
        yield PREFIX + "text " + sentence
    for group in groups:
        yield PREFIX + "button_group_start"
        for button in group:
            yield PREFIX + "button " + "|".join(button)
        yield PREFIX + "button_group_end"
    for button in footer:
        yield PREFIX + "footer_button " + "|".join(button)
    yield PREFIX + "show"


END = PREFIX + "end"


# 'command' is the G-code of the beginning and of both answers: it has %s for
# CALIBRATE, CONTINUE or ABORT.  'say' tells the console.
class Dialog:
    def __init__(self, host, say, command):
        self.host = host
        self.say = say
        self.begin = command % ("CALIBRATE",)
        self.go_on = command % ("CONTINUE",)
        self.abort = command % ("ABORT",)
        # What the asking command wants to know again; None: nothing is asked
        self.question = None

    # What the question asks for, in its word; empty: there is none
    def waits_for(self):
        return "" if self.question is None else self.question.asks

    # After close().  'question' has the word 'asks'.
    def ask(self, question, headline, sentences):
        self.say(" ".join([headline + "."] + sentences))
        self.say("then %s, or %s" % (self.go_on, self.abort))
        go_on = "%s QUESTION=%s" % (self.go_on, question.asks)
        footer = (
            ("Continue", go_on, "primary"),
            ("Abort", self.abort, "error"),
        )
        for line in lines(headline, sentences, footer):
            self.host.gcode.respond_raw(line)
        self.question = question
        answers = self.go_on, self.abort
        carrying.of(self.host.printer).asking(self.host.section, answers)

    def close(self):
        self.question = None
        carrying.of(self.host.printer).answered(self.host.section)
        self.host.gcode.respond_raw(END)

    # What was asked, which is over then
    def answered(self, gcmd):
        question = self.question
        self.close()
        if question is None:
            text = "%s: nothing was asked; begin with %s"
            raise gcmd.error(text % (self.host.section, self.begin))
        return question

    # What was asked, which CONTINUE ends.  Raises where nothing is asked.
    def continued(self, gcmd):
        self.check_asked(gcmd)
        return self.answered(gcmd)

    # A button that is pressed twice must not answer the question that comes next.
    def check_asked(self, gcmd):
        asked, waits_for = gcmd.get("QUESTION", "").strip(), self.waits_for()
        if waits_for and asked not in ("", waits_for):
            text = "%s: QUESTION=%s is not what is asked now, which is %s"
            raise gcmd.error(text % (self.host.section, asked, waits_for))


######################################################################
# A set-up: a row of questions, each step a command of its own
######################################################################

STOP = "Keep a hand on the emergency stop."
JOGS = "The buttons move the head; you may move it as you like, too."


# Raises where STEP= is not 'asked', the step of the set-up that is under way, and not
# its end.  None: there is no set-up; 'command' begins one.
def check_step(host, gcmd, name, asked, command):
    if asked is None:
        # The question may be one of before a restart
        host.gcode.respond_raw(END)
        text = (
            "%s: no set-up is under way, as a restart ends it, too, and nothing"
            " was saved; begin with %s"
        )
        raise gcmd.error(text % (host.section, command))
    if name not in (asked, "abort"):
        text = (
            "%s: STEP=%s is not what is asked now, which is STEP=%s; %s shows it"
            " again"
        )
        raise gcmd.error(text % (host.section, name, asked, command))


# Raises CalibrationError where none of the answers to a step has that word; 'answers'
# are (label, word, colour), 'more' words without a button there.
def check_answer(step, answer, answers, more=()):
    words = [word for label, word, colour in answers] + list(more)
    if answer not in words:
        raise CalibrationError(
            "ANSWER=%s is none of STEP=%s: %s"
            % (answer, step, ", ".join(word or "none" for word in words))
        )


# Where it is to be moved by the buttons, in words
def head_at(position):
    return "The head is at X=%.1f Y=%.1f Z=%.2f." % tuple(position[:3])


# After ABORT.  'saver': saving.Saver
def tell_end(host, saver):
    host.say("the set-up has ended, nothing was saved")
    if saver.is_waiting(host.section):
        host.say("earlier values still wait for SAVE_CONFIG")
