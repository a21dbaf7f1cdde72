# DOCKABLE_PROBE_SETUP: where the dock is, found with the probe on the head.
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Each step is a command of its own, see texts.py: it does what the step
# before has announced, and asks for the next one.
#
#   on -> dock -> out -> approach -> insert     by the buttons, Here
#   fetch -> store                              slowly, with what was found
#   save                                        SAVE_CONFIG

from ..core import (
    carrying,
    dialogs,
    jogging,
    options,
    prints,
    running,
    saving,
)
from ..core.errors import CalibrationError
from . import checks, detour
from .detour import Position
from .sensors import ATTACHED, DOCKED, level
from .settings import DISTANCE, nearest_distance
from .texts import ORDER, STEPS

COMMAND = "DOCKABLE_PROBE_SETUP"
ABORT = COMMAND + " STEP=ABORT"

# mm/s by the buttons and between the places, and into the dock and out of it
JOG_SPEED = 20.0
SLOW_SPEED = 10.0

# A place nearer (mm) to the dock than this leaves no room to leave it.
LEAST_WAY = 15.0

# Which option each place is for, by the step that finds it
OPTION_OF = {
    "dock": "dock_position",
    "out": "detach_position",
    "approach": "approach_position",
    "insert": "insert_position",
}


def command(name, answer="", **params):
    words = [COMMAND, "STEP=" + name.upper()]
    words += ["ANSWER=" + answer] if answer else []
    return " ".join(words + ["%s=%s" % item for item in sorted(params.items())])


# As an option has it
def written(position):
    return ", ".join("%.3f" % (at,) for at in position if at is not None)


# The set-up that is under way: its step, and the places by their options
class State:
    def __init__(self):
        self.step = ORDER[0]
        self.positions = {}


# The command, and what it asks
class Setup:
    # 'section': module.DockableProbe
    def __init__(self, section):
        self.section = section
        self.host = section.host
        self.saver = saving.Saver(section.host)
        self.prints = prints.Prints(section.host)
        # None: no set-up is under way
        self.state = None
        running.register_commands(section.host, self)

    cmd_DOCKABLE_PROBE_SETUP_help = "Find where the dock is, step by step"

    def cmd_DOCKABLE_PROBE_SETUP(self, gcmd):
        name = gcmd.get("STEP", "").strip().lower()
        if name != "abort":
            self.prints.check_none(gcmd)
        if not name:
            self._begin(gcmd)
            return
        asked = self.state and self.state.step
        dialogs.check_step(self.host, gcmd, name, asked, COMMAND)
        if name == "abort":
            self._abort(gcmd)
        elif not self._asks_for_print(gcmd):
            self._answered(gcmd)

    # Begins a set-up, or shows again what one that is under way asks
    def _begin(self, gcmd):
        # Its end is an answer to all that is asked.
        self.state = self.state or State()
        if self._asks_for_print(gcmd):
            return
        # Later a hand is near.
        carrying.of(self.host.printer).settle(self.host)
        self._ask()

    # After a jog the dialog has the new place, after an error it says why.  For
    # longer work it closes: it would cover the emergency stop of a web interface.
    def _answered(self, gcmd):
        is_jog = any(gcmd.get(axis, "").strip() for axis in "XYZ")
        if not is_jog and self.state.step != "save":
            self.host.gcode.respond_raw(dialogs.END)
        try:
            try:
                (self._jog if is_jog else self._go_on)(gcmd)
            except CalibrationError as e:
                raise self.host.error("%s" % (e,))
        except self.host.printer.command_error as e:
            if not self.host.printer.is_shutdown() and self.state is not None:
                self._ask(str(e))
            raise
        finally:
            if not self.host.printer.is_shutdown():
                self.prints.has_moved()
        if self.state is not None:
            self._ask(is_quiet=is_jog)

    ######################################################################
    # Answers
    ######################################################################

    def _go_on(self, gcmd):
        name, state = self.state.step, self.state
        answer = gcmd.get("ANSWER", "").strip().upper()
        dialogs.check_answer(name, answer, STEPS[name].answers)
        if answer == "BACK":
            state.step = STEPS[name].back
            return
        work = {
            "on": self._check_on,
            "dock": self._take_dock,
            "out": self._take_out,
            "approach": self._take_approach,
            "insert": self._take_insert,
            "fetch": self._fetch,
            "store": self._store,
            "save": self._save,
        }
        work[name](answer)
        if self.state is not None:
            state.step = ORDER[ORDER.index(name) + 1]

    def _check_on(self, answer):
        self._require(ATTACHED, "put it on the head, or correct pin (!)")
        self._require_homed(
            "home first (G28 %s), if the probe is on with room below it"
        )

    def _take_dock(self, answer):
        sensors = self.section.sensors
        if not sensors.is_joined():
            # A sensor of the dock tells by now that it is there, too.
            wanted = ", ".join(
                "%s %s" % (sense.name, level(is_triggered))
                for sense, is_triggered in sensors.when_joined()
            )
            raise CalibrationError(
                "the probe is not on the head and in the dock at once (%s),"
                " expected %s; the magnets of both have to hold it"
                % (sensors.describe(), wanted)
            )
        settings, here = self.section.settings, self._here()
        if settings.dock_fixed_z:
            # That is no place of the head's, but how much higher it has to be there.
            here = here._replace(z=settings.dock_position.z)
        self.state.positions = {"dock_position": here}

    def _take_out(self, answer):
        self._require(
            DOCKED,
            "go back into the dock and leave it another way, or put it there by"
            " hand",
        )
        self._take("out")

    def _take_approach(self, answer):
        positions, here = self.state.positions, self._here()
        dock, detach = positions["dock_position"], positions["detach_position"]
        angle = detour.strip_angle(dock, dock.z, here, detach)
        strips = self.section.settings.detach_gcode is not None
        if angle < checks.SAME_WAY and not strips:
            raise CalibrationError(
                "this is the way out without the probe (%.0f degrees apart), on"
                " which it would not come along; choose another one, mostly at"
                " 90 degrees" % (angle,)
            )
        self._take("approach")
        positions["insert_position"] = here

    def _take_insert(self, answer):
        if answer == "HERE":
            self._take("insert")

    def _take(self, name):
        here, dock = self._here(), self.state.positions["dock_position"]
        apart = detour.distance(here, dock)
        is_above = None not in (here.z, dock.z) and here.z - dock.z >= LEAST_WAY
        if apart < LEAST_WAY and not is_above:
            raise CalibrationError(
                "this is %.1f mm from the dock; go at least %g mm away, better"
                " 40" % (apart, LEAST_WAY)
            )
        self.state.positions[OPTION_OF[name]] = here

    # 'remedy' takes the axes; raises CalibrationError
    def _require_homed(self, remedy):
        missing = [
            a for a in self._axes() if not self.section.moves.is_homed(a)
        ]
        if missing:
            axes = " ".join(missing).upper()
            raise CalibrationError(
                "not homed: %s; %s"
                % (axes.replace(" ", ", "), remedy % (axes,))
            )

    # With the probe where it has to be; raises CalibrationError
    def _require(self, state, remedy):
        sensors = self.section.sensors
        seen = sensors.look()
        if seen != state:
            raise CalibrationError(
                "the probe is %s (%s), and has to be %s; %s"
                % (seen, sensors.describe(), state, remedy)
            )

    ######################################################################
    # The trial
    ######################################################################

    # All of the dock's, by their options
    def _positions(self):
        found = self.state.positions
        return dict(found, extract_position=found["approach_position"])

    # The section's settings with what was found, and slow
    def _found(self):
        settings, positions = self.section.settings, self._positions()
        positions.update(
            safe_dock_distance=nearest_distance(positions),
            travel_speed=JOG_SPEED,
            attach_speed=SLOW_SPEED,
            detach_speed=SLOW_SPEED,
            is_placed=True,
        )
        return settings._replace(**positions)

    def _fetch(self, answer):
        self._require(DOCKED, "put it into the dock")
        with self.section.trying(self._found()):
            self.section.docking.fetch()

    def _store(self, answer):
        self._require(ATTACHED, "fetch it again (Back)")
        with self.section.trying(self._found()):
            self.section.docking.dock()

    ######################################################################
    # The head
    ######################################################################

    # What has to be homed, in letters
    def _axes(self):
        return "xy" if self.section.settings.dock_fixed_z else "xyz"

    # Where the motors are off a hand may have moved it.
    def _here(self):
        self._require_homed(
            "nobody knows where the head is; move it clear of the dock by hand, and"
            " home (G28 %s)"
        )
        place = self.section.moves.position()
        x, y, z = [None if at is None else round(at, 3) for at in place]
        return Position(x, y, None if self.section.settings.dock_fixed_z else z)

    # Moves by the X, Y and Z of the command (mm), up first
    def _jog(self, gcmd):
        if not STEPS[self.state.step].jogs:
            raise CalibrationError("the head stays where it is at this step")
        toolhead, limits = self.host.toolhead, self.host.axes.limits()
        start, end = toolhead.get_position(), [None, None, None]
        for number, axis in enumerate("XYZ"):
            distance = options.param_number(gcmd, axis)
            if distance is None:
                continue
            if axis.lower() not in self._axes():
                raise CalibrationError("%s stays as it is here" % (axis,))
            if not self.section.moves.is_homed(axis.lower()):
                raise CalibrationError("not homed: %s; home first" % (axis,))
            low, high = limits[number]
            if axis == "Z":
                low = max(low, self.section.settings.hang)
            end[number] = jogging.jogged(
                axis, start[number], distance, low, high
            )
        if end[2] is not None and end[2] > start[2]:
            toolhead.manual_move([None, None, end[2]], JOG_SPEED)
        toolhead.manual_move(end, JOG_SPEED)
        # Whoever looks decides on the next one.
        toolhead.wait_moves()
        gcmd.respond_info(
            "X=%.3f Y=%.3f Z=%.3f" % tuple(toolhead.get_position()[:3])
        )

    ######################################################################
    # What is shown, and the end
    ######################################################################

    def _headline(self, title):
        number = ORDER.index(self.state.step) + 1
        return "Step %d of %d: %s" % (number, len(ORDER), title)

    # What a print may be is asked first, in the step that it holds up
    def _asks_for_print(self, gcmd):
        headline = self._headline(prints.QUESTION)
        return self.prints.asks(gcmd, ABORT, headline)

    # 'is_quiet': the console has been told already
    def _ask(self, problem="", is_quiet=False):
        name = self.state.step
        headline = self._headline(STEPS[name].title)
        sentences = self._sentences(name, problem)
        answers = [
            (label, command(name, word), colour)
            for label, word, colour in STEPS[name].answers
        ] + [("Abort", ABORT, "error")]
        said = [headline] + sentences
        said += ["%s: %s" % (label, gcode) for label, gcode, _ in answers]
        if STEPS[name].jogs:
            said.append("move the head: %s" % (command(name, X="+1"),))
        if not is_quiet:
            self.host.say("\n".join(said))
        respond = self.host.gcode.respond_raw
        respond(dialogs.END)
        shown = dialogs.lines(
            headline, sentences, answers, self._jog_rows(name)
        )
        for line in shown:
            respond(line)
        carrying.of(self.host.printer).asking(
            self.host.section, (answers[0][1], ABORT)
        )

    def _sentences(self, name, problem):
        facts = self._facts()
        texts = [
            line
            for text in STEPS[name].text
            for line in (text % facts).split("\n")
            if line
        ]
        if STEPS[name].jogs:
            here = self.host.toolhead.get_position()
            texts.insert(-1, dialogs.head_at(here))
        if problem:
            texts.insert(0, "Not done: %s." % (problem.rstrip("."),))
        return texts

    # Rows of buttons that move the head
    def _jog_rows(self, name):
        if not STEPS[name].jogs:
            return
        for axis in self._axes().upper():
            for row in jogging.rows(axis, lambda **by: command(name, **by)):
                yield row

    def _facts(self):
        positions = self.state.positions
        facts = {
            name.split("_")[0]: written(positions.get(name, ()))
            for name in OPTION_OF.values()
        }
        facts.update(
            pins=self.section.sensors.describe(),
            axes=", ".join(self._axes().upper()),
            slow=SLOW_SPEED,
            values="",
            not_saved="",
            saving="",
        )
        if self.state.step == "save":
            facts.update(self.saver.facts(self.host.section, self._values()))
        return facts

    # What is to be written: those that are not as another one is anyway
    def _values(self):
        positions, given = self._positions(), self.saver.given
        values = [
            (name, written(positions[name]))
            for name in (
                "dock_position",
                "approach_position",
                "detach_position",
            )
        ]
        for name in ("extract_position", "insert_position"):
            place = positions[name]
            is_default = place == positions["approach_position"]
            if not is_default or given(self.host.section, name):
                values.append((name, written(place)))
        distance = given(self.host.section, DISTANCE.name)
        nearest = nearest_distance(positions)
        if distance is not None and float(distance) > nearest:
            # klippy would refuse it, and what is rounded up.
            text = "%.3f" % (nearest,)
            is_up = float(text) > nearest
            values.append(
                (DISTANCE.name, "%.3f" % (nearest - 0.001) if is_up else text)
            )
        return values

    # What has failed is asked again: nothing is over before klippy restarts.
    def _save(self, answer):
        self.saver.finish(self.host.section, self._values())
        self._close()

    def _close(self):
        self.state = None
        carrying.of(self.host.printer).answered(self.host.section)
        self.host.gcode.respond_raw(dialogs.END)

    def _abort(self, gcmd):
        self._close()
        dialogs.tell_end(self.host, self.saver)
