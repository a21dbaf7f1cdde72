# Whether somebody prints: a dialog that moves the head has to know.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from . import dialogs

QUESTION = "is a print paused?"
TEXTS = (
    "%s.",
    "A paused print of OctoPrint, or one about to begin, looks the same.",
    "'No print' goes on as asked.",
)

PAUSED = (
    "a print is paused (PAUSE), and goes on from here; end it (CANCEL_PRINT),"
    " or CLEAR_PAUSE where there is none"
)


# As PAUSE has left it, whoever sends the print
def is_paused(host):
    pauser = host.printer.lookup_object("pause_resume", None)
    status = pauser.get_status(host.eventtime()) if pauser else {}
    return bool(status.get("is_paused"))


# Also of a print that no print_stats knows of; what moves because of a set-up itself
# is none.  What is kept hot may be: that a person is asked.
class Prints:
    def __init__(self, host):
        self.host = host
        # Until when own moves were queued (print time); None: there were none
        self.setup_time = None
        # Degrees C that heaters are to have, and nobody prints with: a person has
        # said so, or a command of the set-up has left them
        self.allowed_heat = {}

    # The moves up to here are of the set-up, and what it has heated
    def has_moved(self):
        self.setup_time = self._queued_time()
        self.allowed_heat = self._heat()

    # Whether there is a print, as far as anybody can know
    def may_be(self):
        is_known = self.host.print_state() or is_paused(self.host)
        return bool(is_known or self._moves_on() or self._unexpected_heat())

    # Whether a person is asked first.  The answer is the same command once more, with
    # PRINT=NONE; 'abort' is the other one.  'headline' has QUESTION.
    def asks(self, gcmd, abort, headline):
        if gcmd.get("PRINT", "").strip().upper() == "NONE":
            self.allowed_heat = self._heat()
        heat = self._unexpected_heat()
        if heat:
            self._ask(gcmd, heat, abort, headline)
        return bool(heat)

    def _ask(self, gcmd, heat, abort, headline):
        params = dict(gcmd.get_command_parameters(), PRINT="NONE")
        words = ["%s=%s" % item for item in sorted(params.items())]
        answers = (
            ("No print", " ".join([gcmd.get_command()] + words), "primary"),
            ("Abort", abort, "error"),
        )
        kept = ["%s is kept at %.0f degrees" % item for item in heat]
        texts = [text.replace("%s", ", ".join(kept)) for text in TEXTS]
        said = ["%s: %s" % answer[:2] for answer in answers]
        self.host.say("\n".join([headline] + texts + said))
        self.host.gcode.respond_raw(dialogs.END)
        for line in dialogs.lines(headline, texts, answers):
            self.host.gcode.respond_raw(line)

    # Raises the command's error
    def check_none(self, gcmd):
        host = self.host
        if host.print_state():
            raise gcmd.error("%s: not during a print" % (host.section,))
        if is_paused(host):
            raise gcmd.error("%s: %s" % (host.section, PAUSED))
        if self._moves_on():
            raise gcmd.error(
                "%s: the head moves with a nozzle hot enough to print, as in a"
                " print of OctoPrint; wait until it stands still, then again"
                % (host.section,)
            )

    # Stays where no new moves come; None: nobody knows it of those that have come
    def _queued_time(self):
        host = self.host
        queued, passed, is_empty = host.toolhead.check_busy(host.eventtime())
        return queued if is_empty else None

    def _is_own(self):
        return self.setup_time is not None and (
            self._queued_time() == self.setup_time
        )

    # Degrees C that nozzles and bed are to have, by heater
    def _heat(self):
        look_up, eventtime = (
            self.host.printer.lookup_object,
            self.host.eventtime(),
        )
        heaters, targets = look_up("heaters", None), {}
        names = (
            heaters.get_status(eventtime)["available_heaters"]
            if heaters
            else ()
        )
        for name in names:
            if name == "heater_bed" or name.startswith("extruder"):
                status = look_up(name).get_status(eventtime)
                targets[name] = status.get("target", 0.0)
        return targets

    def _unexpected_heat(self):
        heat, allowed_heat = self._heat(), self.allowed_heat
        return sorted(
            (name, target)
            for name, target in heat.items()
            if target > 0.0 and target != allowed_heat.get(name)
        )

    def _moves_on(self):
        return self._moves_hot() and not self._is_own()

    # The head moves, or has done so half a second ago, with a nozzle that is kept
    # hot enough to print.
    def _moves_hot(self):
        host, look_up = self.host, self.host.printer.lookup_object
        idle_timeout, name = look_up("idle_timeout", None), host.extruder()
        extruder = look_up(name, None) if name else None
        if idle_timeout is None or extruder is None:
            return False
        eventtime = host.eventtime()
        status = extruder.get_status(eventtime)
        is_hot = status.get("can_extrude") and status.get("target", 0.0) > 0.0
        state = idle_timeout.get_status(eventtime).get("state")
        return bool(is_hot and state == "Printing")
