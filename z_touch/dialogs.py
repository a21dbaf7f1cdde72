# Questions to the user: a dialog in the web interfaces and on KlipperScreen,
# and two commands for those who see none.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# What the interfaces have in common, read from the lines of the console:
#
#   // action:prompt_begin HEADLINE
#   // action:prompt_text TEXT
#   // action:prompt_footer_button LABEL|G-CODE|COLOUR
#   // action:prompt_show
#   // action:prompt_end
#
# The G-code of a button waits for the command that is running: a command asks,
# and ends; another one goes on.
PREFIX = "// action:prompt_"


# Nothing in a text may end the line, or the part of a button that it is in.
def plain(text):
    return " ".join(str(text).split()).replace("|", "/")


# 'command': the G-code of both answers, with %s for CONTINUE or ABORT.  'say'
# tells the console.
class Dialog(object):
    def __init__(self, host, say, command):
        self.host = host
        self.say = say
        self.go_on = command % ("CONTINUE",)
        self.abort = command % ("ABORT",)
        # What the asking command wants to know again; None: nothing is asked
        self.question = None

    # After answered(): KlipperScreen shows nothing new while a dialog is open,
    # and only the last text.
    def ask(self, question, headline, sentences):
        self.say(" ".join([headline + "."] + sentences))
        self.say("then %s, or %s" % (self.go_on, self.abort))
        self._send("begin " + plain(headline))
        self._send("text " + plain(" ".join(sentences)))
        for label, gcode, colour in (
            ("Continue", self.go_on, "primary"),
            ("Abort", self.abort, "error"),
        ):
            self._send("footer_button %s|%s|%s" % (label, gcode, colour))
        self._send("show")
        self.question = question

    # What was asked, which is over then; None: nothing
    def answered(self):
        question, self.question = self.question, None
        self._send("end")
        return question

    def _send(self, text):
        self.host.gcode.respond_raw(PREFIX + text)
