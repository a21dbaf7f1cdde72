# Values for SAVE_CONFIG, which writes no option that sits in an included file.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections
import glob
import io
import os
import re

from .errors import CalibrationError
from .options import SAVE_HINT, save

# Where an option is written: path and number of the line, and what it says
Place = collections.namedtuple("Place", "path line text")

# What has to be written by hand: where, in words; section, option and text
ByHand = collections.namedtuple("ByHand", "where section option text")

# What 'Save' of a set-up does
SAVED = "'Save' has SAVE_CONFIG write these into printer.cfg; Klipper restarts."
CHECKED_FIRST = (
    "'Save' looks whether all that is written there; Klipper restarts."
)

HEADER = re.compile(r"\[([^]]+)\]")
OPTION = re.compile(r"([^\s:=#;][^:=]*?)\s*[:=]([^#]*)")

# In front of what SAVE_CONFIG has written, at the end of printer.cfg
AUTOSAVED = "#*# "


# All Places of an option, in the order that klippy reads them.  'deep': "**" of an
# include stands for any depth of folders; 'saved': also what SAVE_CONFIG has
# written, which counts most.
def places(path, section, option, deep=False, saved=False, seen=()):
    all_places, inside = [], False
    try:
        with io.open(path, encoding="utf-8", errors="replace") as f:
            lines = f.read().splitlines()
    except OSError:
        return all_places
    for number, line in enumerate(lines, 1):
        if saved and line.startswith(AUTOSAVED):
            line = line[len(AUTOSAVED) :]
        header, given = HEADER.match(line), OPTION.match(line)
        if header is not None:
            name = header.group(1).strip()
            inside = name == section
            if name.startswith("include "):
                for other in included(path, name[len("include ") :], deep):
                    if other not in seen:
                        outer = tuple(seen) + (path,)
                        all_places += places(
                            other, section, option, deep, seen=outer
                        )
        elif inside and given and given.group(1).lower() == option:
            all_places.append(Place(path, number, given.group(2).strip()))
    return all_places


def included(path, pattern, deep):
    path = os.path.join(os.path.dirname(path), pattern.strip())
    names = glob.glob(path, recursive=deep)
    return [os.path.normpath(name) for name in sorted(names)]


# Whether two texts of an option mean the same
def is_same(text, other):
    try:
        first, second = [
            [float(part) for part in t.split(",")] for t in (text, other)
        ]
    except ValueError:
        return text.strip() == other.strip()
    return first == second


# Ready values for SAVE_CONFIG.
class Saver:
    def __init__(self, host):
        self.host = host
        self.printer = host.printer

    def _path(self):
        args = self.printer.get_start_args()
        return os.path.abspath(args["config_file"])

    def _places(self, section, option, saved=False):
        deep = self.host.includes().is_deep
        return places(self._path(), section, option, deep, saved)

    # Line and file, in words; empty: it is nowhere
    def where(self, section, option):
        all_places = self._places(section, option)
        return self._say(all_places[-1]) if all_places else ""

    def _say(self, place):
        name = os.path.relpath(place.path, os.path.dirname(self._path()))
        return "line %d of %s" % (place.line, name)

    # Line and file, in words, of an option that SAVE_CONFIG refuses to write: with
    # one of them it would write nothing at all.  Empty: it can be written.
    def obstacle(self, section, option):
        printer_cfg, all_places = self._path(), self._places(section, option)
        if self.host.includes().is_written:
            reached = places(printer_cfg, section, option)
            all_places = [place for place in all_places if place not in reached]
        others = [place for place in all_places if place.path != printer_cfg]
        return self._say(others[-1]) if others else ""

    # Whether SAVE_CONFIG will write it; the console is told either way.
    def save(self, section, option, text):
        obstacle = self.obstacle(section, option)
        say = self.host.gcode.respond_info
        if obstacle:
            say(
                "%s: SAVE_CONFIG cannot change %s: it is in %s, an included"
                " file; write '%s: %s' there, then RESTART"
                % (self.host.section, option, obstacle, option, text)
            )
            return False
        save(self.printer, section, option, text)
        say("%s: %s: %s\n%s" % (self.host.section, option, text, SAVE_HINT))
        return True

    ######################################################################
    # A set-up that ends with SAVE_CONFIG
    ######################################################################

    # Whether the file says so already
    def is_written(self, section, option, text):
        all_places = self._places(section, option, saved=True)
        return bool(all_places) and is_same(all_places[-1].text, text)

    # What waits for SAVE_CONFIG, as (section, option, text)
    def _pending(self):
        configfile = self.printer.lookup_object("configfile")
        status = configfile.get_status(self.host.eventtime())
        pending = status.get("save_config_pending_items", {})
        return [
            (section, option, text)
            for section, options in sorted(pending.items())
            for option, text in sorted((options or {}).items())
        ]

    # What an option will be after the next SAVE_CONFIG, as text; None: nothing says
    # so.  What SAVE_CONFIG has written before is in what klippy has read.
    def given(self, section, option):
        for waiting in self._pending():
            if waiting[:2] == (section, option):
                return waiting[2]
        configfile = self.printer.lookup_object("configfile")
        status = configfile.get_status(self.host.eventtime())
        return status["config"].get(section, {}).get(option)

    # Whether anything of a section does
    def is_waiting(self, section):
        return any(value[0] == section for value in self._pending())

    # What of that makes SAVE_CONFIG refuse everything
    def _refused(self):
        return [v for v in self._pending() if self.obstacle(*v[:2])]

    # What of 'values', pairs of option and text, has to be written by hand, and
    # all of others that waits where SAVE_CONFIG refuses any: a restart forgets it.
    # Empty: SAVE_CONFIG writes all.
    def by_hand(self, section, values):
        values_here = [(section,) + tuple(value) for value in values]
        named, refused = [value[:2] for value in values_here], self._refused()
        missing = [v for v in values_here if refused or self.obstacle(*v[:2])]
        if refused:
            missing += [v for v in self._pending() if v[:2] not in named]
        return [
            ByHand(self._target(*value[:2]), *value)
            for value in missing
            if not self.is_written(*value)
        ]

    # What the last question of a set-up is filled in with: lines that are saved,
    # lines that have to be written by hand, and what 'Save' does then
    def facts(self, section, values):
        missing = self.by_hand(section, values)
        named = [(line.section, line.option) for line in missing]
        saved = [
            "%s: %s" % (option, text)
            for option, text in values
            if (section, option) not in named
        ]
        not_saved = [
            "SAVE_CONFIG cannot write this into %s; write it there:\n%s: %s"
            % (line.where, line.option, line.text)
            for line in missing
        ]
        if self.is_waiting(section) and not missing:
            not_saved.append(
                "If SAVE_CONFIG fails again, write these lines into section [%s]"
                " of printer.cfg." % (section,)
            )
        return {
            "values": "\n".join(saved),
            "not_saved": "\n".join(not_saved),
            "saving": CHECKED_FIRST if missing else SAVED,
        }

    def _target(self, section, option):
        where = self.where(section, option)
        return where or "section [%s] of printer.cfg" % (section,)

    # Has the values written, and klippy restart; returns when that is certain.
    # Raises CalibrationError where some have to be written by hand before, or the
    # error of SAVE_CONFIG.
    def finish(self, section, values):
        for where, _, option, text in self.by_hand(section, values):
            raise CalibrationError(
                "%s does not say '%s: %s' yet, and SAVE_CONFIG cannot write it;"
                " write it there" % (where, option, text)
            )
        run = self.host.gcode.run_script_from_command
        if self._refused():
            # All that waits is in the files
            run("RESTART")
            return
        for option, text in values:
            if not self.is_written(section, option, text):
                save(self.printer, section, option, text)
        run("SAVE_CONFIG" if self._pending() else "RESTART")
