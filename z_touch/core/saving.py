# Values for SAVE_CONFIG, which writes no option that sits in an included file.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
from __future__ import absolute_import

import collections
import glob
import io
import os
import re

from .options import SAVE_HINT, save

# Where an option is written: path and number of the line
Place = collections.namedtuple("Place", "path line")

HEADER = re.compile(r"\[([^]]+)\]")
OPTION = re.compile(r"([^\s:=#;][^:=]*?)\s*[:=]")


# All Places of an option, in the order that klippy reads them.
def places(path, section, option, seen=()):
    found, inside = [], False
    try:
        with io.open(path, encoding="utf-8", errors="replace") as f:
            lines = f.read().splitlines()
    except (IOError, OSError):
        return found
    for number, line in enumerate(lines, 1):
        header, given = HEADER.match(line), OPTION.match(line)
        if header is not None:
            name = header.group(1).strip()
            inside = name == section
            if name.startswith("include "):
                for other in included(path, name[len("include ") :]):
                    if other not in seen:
                        deeper = tuple(seen) + (path,)
                        found += places(other, section, option, deeper)
        elif inside and given and given.group(1).lower() == option:
            found.append(Place(path, number))
    return found


def included(path, pattern):
    path = os.path.join(os.path.dirname(path), pattern.strip())
    return [os.path.normpath(name) for name in sorted(glob.glob(path))]


# Ready values for SAVE_CONFIG.
class Saver(object):
    def __init__(self, host):
        self.host = host
        self.printer = host.printer

    def _path(self):
        args = self.printer.get_start_args()
        return os.path.abspath(args["config_file"])

    # Line and file, in words; empty: it is nowhere
    def where(self, section, option):
        found = places(self._path(), section, option)
        return self._say(found[-1]) if found else ""

    def _say(self, place):
        name = os.path.relpath(place.path, os.path.dirname(self._path()))
        return "line %d of %s" % (place.line, name)

    # The same of an option that SAVE_CONFIG refuses to write: with one of them
    # it would write nothing at all.
    def obstacle(self, section, option):
        if self.host.saves_into_includes():
            return ""
        own = self._path()
        found = places(own, section, option)
        others = [place for place in found if place.path != own]
        return self._say(others[-1]) if others else ""

    # Whether SAVE_CONFIG will write it; the console is told either way.
    def save(self, section, option, text):
        obstacle = self.obstacle(section, option)
        say = self.host.gcode.respond_info
        if obstacle:
            say(
                "%s: SAVE_CONFIG cannot change %s: it is in %s, an included"
                " file. Write there '%s: %s', then RESTART"
                % (self.host.section, option, obstacle, option, text)
            )
            return False
        save(self.printer, section, option, text)
        say("%s: %s: %s\n%s" % (self.host.section, option, text, SAVE_HINT))
        return True
