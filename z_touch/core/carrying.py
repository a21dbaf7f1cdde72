# What hangs on the head now, of all sections that can put something there.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Whoever lowers the nozzle on its own account asks here first: what hangs below
# it would meet the bed before it does.  Whoever asks a person into the printer
# says so here, that nothing drives off by itself meanwhile.
#
# A carrier is what can have a probe on the head, a [dockable_probe]:
#
#   auto                    whether it goes to the dock by itself
#   state()                 ATTACHED, DOCKED or UNKNOWN, the head standing
#   reads()                 what that follows from, in words
#   dock_and_come_back()    docked, and the head just where it was; or an error
#   dock_pending()          docked now, where that was to happen in a while
#   mark()                  for is_put_on()
#   is_put_on(mark, was_docked)  whether since the mark was made its owner has put
#                           the probe on to stay; was_docked: where it was then
#   fetch()                 on the head afterwards, to stay; or an error
#   go_to(x, y, speed)      around the dock, and to the very place

from . import host_dock, touching
from .errors import CalibrationError

# Where the probe may be, as commands and status have it; UNKNOWN also where the
# pins contradict each other, so that it may hang there
ATTACHED, DOCKED, UNKNOWN = "ATTACHED", "DOCKED", "UNKNOWN"

# Among the printer's objects; a RESTART makes new ones.
NAME = "z_touch_carrying"


# The one Carrying of a printer
def of(printer):
    carrying = printer.lookup_object(NAME, None)
    if carrying is None:
        carrying = Carrying(printer)
        printer.add_object(NAME, carrying)
    return carrying


# One for a printer: each section tells it, and asks it, what is on the head
class Carrying:
    def __init__(self, printer):
        self.printer = printer
        # The carrier of our [dockable_probe]; None: there is none
        self.joined = None
        # The commands that answer a question, by the section that has asked it
        self.questions = {}
        # The running.Watch of each section that measures
        self.watches = []

    # While the configuration is read
    def join(self, carrier):
        self.joined = carrier

    # Whether a command is under way that measures, and knows what hangs there
    def is_measuring(self):
        return any(watch.phase != "idle" for watch in self.watches)

    # Whose probe may hang there; None: nobody tells.  A [probe] that macros fetch
    # is not asked: a pin that reads open may be anything.
    def carrier(self, host):
        return self.joined or host_dock.find(host)

    ######################################################################
    # Before the nozzle goes down
    ######################################################################

    # Nothing hangs below the nozzle afterwards, and the head is where it was;
    # otherwise raises CalibrationError, or the host's error.  'host' is the
    # host.Host of whoever asks.  A dock is left alone where its owner wants no
    # trips, unless 'regardless'.  'goes_on': whoever asks moves to its own place
    # next.
    def free_nozzle(self, host, regardless=False, goes_on=False):
        self.check_questions(host)
        carrier = self.carrier(host)
        if carrier is None:
            return
        state = carrier.state()
        if state == DOCKED:
            return
        if not (carrier.auto or regardless):
            raise CalibrationError(
                "the probe is %s (%s), and would meet the bed before the nozzle"
                " does; auto_attach_detach is off, so it is not docked by"
                " itself; run DETACH_PROBE" % (state, carrier.reads())
            )
        place = host.toolhead.get_position()[:2]
        carrier.dock_and_come_back()
        here = host.toolhead.get_position()[:2]
        moved = max(abs(a - b) for a, b in zip(place, here))
        if moved > touching.NO_TRAVEL and not goes_on:
            raise CalibrationError(
                "the probe was docked, and the head did not come back from"
                " X=%.3f Y=%.3f to X=%.3f Y=%.3f; move it to where it is to"
                " touch, and begin again" % tuple(here + place)
            )

    # What lies on the bed, or whose hand is there, nobody else knows.  'own': nor does
    # who asks now know of a question of the same section.  Raises CalibrationError.
    def check_questions(self, host, own=False):
        if host.print_state():
            # Whoever prints has cleared the bed: an answer comes no more.
            self.questions.clear()
        for section, answers in self.questions.items():
            if own or section != host.section:
                raise CalibrationError(
                    "section '%s' waits for an answer, and somebody's hand may"
                    " be near; answer with %s, or %s" % ((section,) + answers)
                )

    ######################################################################
    # A person is asked
    ######################################################################

    # 'answers' are two commands
    def asking(self, section, answers):
        self.questions[section] = answers

    def answered(self, section):
        self.questions.pop(section, None)

    # Whether a hand may be near the head
    def is_asking(self, host):
        return bool(self.questions) or host.probing.is_manual_probing()

    # Before a person is asked: what would happen in a while happens now.
    def settle(self, host):
        carrier = self.carrier(host)
        if carrier is not None:
            carrier.dock_pending()

    ######################################################################
    # From place to place
    ######################################################################

    # X and Y (mm), around the dock where there is one that is known; otherwise,
    # with 'x_first', along X and then along Y; always as high as the head is
    def go_to(self, host, x, y, speed, x_first=False):
        carrier = self.carrier(host)
        if carrier is not None:
            carrier.go_to(x, y, speed)
            return
        if x_first:
            start_y = host.toolhead.get_position()[1]
            touching.move_xy(host, x, start_y, speed)
        touching.move_xy(host, x, y, speed)
