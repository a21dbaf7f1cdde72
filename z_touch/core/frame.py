# What moved the frame that heights are measured in.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
HOMED_OR_SET = "Z was homed again or set"
LEVELLED = "the Z motors were levelled"
MOTORS_OFF = "the motors were turned off"
NOT_HOMED = "Z is not homed"

# Every probing move may shift the frame by a part of a microstep; what adds
# up to less than this (mm) is neither homing nor levelling.
DATUM_NOISE = 0.02


# What happened to the frame since a mark was set
class Frame:
    def __init__(self, host):
        self.host = host
        # What happened, in words
        self.noted = []
        # Of the last time Z was set
        self.datum = []
        self.is_levelling = False
        register = host.printer.register_event_handler
        register("toolhead:set_position", self._set)
        register("homing:home_rails_end", self._homed)
        register("stepper_enable:motor_off", self._off)
        register("klippy:ready", self._watch_motors)
        register("klippy:connect", self._watch_levelling)

    def _watch_levelling(self):
        self.host.axes.wrap_levelling(self._around_levelling)

    # SET_STEPPER_ENABLE turns one off without an event
    def _watch_motors(self):
        self.host.axes.watch_z_enabling(self._switched)

    def mark(self):
        return len(self.noted), self.host.axes.z_datum()

    # Why heights of before do not hold; empty: they do.  'besides' counts as
    # nothing.
    def moved_since(self, mark, besides=None):
        count, datum = mark
        if besides != MOTORS_OFF and not self.is_homed():
            return self._last(count) or NOT_HOMED
        motors = self._motors(datum)
        noted = self._last(count, besides)
        return motors if motors == LEVELLED else noted or motors

    # The last that was noted since then; empty: nothing
    def _last(self, count, besides=None):
        noted = [what for what in self.noted[count:] if what != besides]
        return noted[-1] if noted else ""

    # SET_KINEMATIC_POSITION forgets it without an event
    def is_homed(self):
        return "z" in self.host.toolhead_status()["homed_axes"]

    # Whether Z was homed or set; a motor that was off has set nothing
    def was_set_since(self, mark):
        return any(what != MOTORS_OFF for what in self.noted[mark[0] :])

    # By how much (mm) the motor that has moved most is elsewhere now
    def moved_by(self, mark):
        return max([abs(shift) for shift in self._shifts(mark[1])] or [0.0])

    # Homing sets Z somewhere else at first, on every host; it may come back
    # to where it was.
    def _set(self):
        if self.host.toolhead is None:
            return
        before, self.datum = self.datum, self.host.axes.z_datum()
        is_homed = self._motors(before) == HOMED_OR_SET
        if is_homed and not self.is_levelling:
            self._note(HOMED_OR_SET)

    # [z_tilt] also makes Z=0 where the probe sees the bed; with [quad_gantry_level]
    # the middle stays as high, whatever the probe says.
    def _around_levelling(self, adjust, *args):
        before, self.is_levelling = self.host.axes.z_datum(), True
        try:
            return adjust(*args)
        finally:
            self.is_levelling = False
            shifts = self._shifts(before)
            if abs(sum(shifts)) > DATUM_NOISE * len(shifts):
                self._note(HOMED_OR_SET)

    # Not sent where Z is homed with the probe since 2026-05-25 (5cbebdc3c)
    def _homed(self, homing_state, rails):
        if 2 in homing_state.get_axes():
            self._note("Z was homed again")

    # With a print time until 2026; nobody needs it
    def _off(self, *unused):
        self._note(MOTORS_OFF)

    def _switched(self, print_time, is_on):
        if not is_on:
            self._note(MOTORS_OFF)

    def _note(self, what):
        self.noted.append(what)

    def _motors(self, datum):
        shifts = self._shifts(datum)
        if not shifts or max(map(abs, shifts)) <= DATUM_NOISE:
            return ""
        if max(shifts) - min(shifts) > DATUM_NOISE:
            return LEVELLED
        return HOMED_OR_SET

    # By how much (mm) each motor is elsewhere since
    def _shifts(self, datum):
        return [a - b for a, b in zip(self.host.axes.z_datum(), datum)]


# The frame that G28 has left: only there a height says what Z is to be homed at.
class HomedFrame:
    def __init__(self, frame):
        self.host = frame.host
        self.frame = frame
        # None: nobody has homed Z with it
        self.mark = None
        # How many of these commands have begun: one may have others in it
        self.begun = 0
        # All sections have registered their commands then, and no macro has
        # taken the place of one.
        register = self.host.printer.register_event_handler
        register("klippy:mcu_identify", self._watch)

    def _watch(self):
        self.host.wrap_command("G28", self._around_homing)

    # In a [homing_override] anything may follow, which is no homing.
    def _around_homing(self, command, gcmd):
        self.begun += 1
        own, noted = self.begun, len(self.frame.noted)
        command(gcmd)
        if self.begun == own and len(self.frame.noted) > noted:
            self.mark = self.frame.mark()

    # What has moved it since, in words; empty: nothing has, or the motors do not
    # tell
    def moved(self):
        if self.moved_by() <= DATUM_NOISE:
            return ""
        if self.mark is None:
            return "Z was not homed with G28"
        return "%s since G28" % (self.frame.moved_since(self.mark),)

    # By how much (mm)
    def moved_by(self):
        if not self.host.axes.z_datum():
            return 0.0
        if self.mark is None or MOTORS_OFF in self.frame.noted[self.mark[0] :]:
            # Nobody knows how far
            return float("inf")
        return self.frame.moved_by(self.mark)
