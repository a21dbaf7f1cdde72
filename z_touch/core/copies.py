# Whether what Python has loaded of this house is what is there, and of one copy.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Python keeps what it has loaded over a RESTART.  A door whose section is new in
# printer.cfg is then read from the disk as an update has left it, and would
# stand before rooms of that update and a core of before: what one of them
# expects of the other is missing in the middle of a command.  That is refused
# when the door is loaded.  What was loaded before goes on as it is, whatever
# becomes of the files.
from __future__ import absolute_import

import hashlib
import logging
import os
import sys

from .. import __version__

PACKAGE = __name__.rpartition(".core.")[0]

# As the host has found it, which may be a link
FOLDER = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))

SERVICE = "restart the Klipper service (RESTART is not enough)"

# The digest of each file of the house when it was loaded, by its path.  Of its
# content: git writes files anew on the way to another commit and back, and so
# does whoever copies the same release once more; size and time would call that
# another copy.  All of them are read in a few milliseconds.
_loaded = {}


# Where the source of a module is.  Python 2.7 names its bytecode.
def source(path):
    return os.path.splitext(os.path.abspath(path))[0] + ".py"


# None where there is no such file
def digest(path):
    try:
        with open(path, "rb") as file:
            return hashlib.sha256(file.read()).hexdigest()
    except (IOError, OSError):
        return None


# The sources of all modules below the folder that Python has loaded, also of a
# release whose files had other names
def sources_in_use():
    for name, module in list(sys.modules.items()):
        path = getattr(module, "__file__", None)
        if path and (name + ".").startswith(PACKAGE + "."):
            yield source(path)


# Files of the folder that were loaded and are not the same any more.  Those
# that are asked about for the first time have just been loaded.
def changed_since():
    changed = []
    for path in sorted(set(sources_in_use())):
        there = digest(path)
        if there is None or _loaded.setdefault(path, there) != there:
            changed.append(path)
    return changed


# Why a door, loaded from that file and of that version, must not be used with
# this folder; empty: it may.  Doors of later updates call this one, too, where
# it was loaded before: its name and its parameters are to stay.
def why_mixed(door, version):
    door = source(door)
    changed, there = changed_since(), digest(door)
    # Kalico of 2023-11-01 (d3f823a4c) to 2026-01-01 runs a plugin again at each
    # RESTART: if that is the same one, nothing new has come
    if _loaded.get(door, "") == there:
        return ""
    why = _why_changed(changed) or _why_apart(door) or _why_other(version)
    if not why:
        _loaded[door] = there
    return why


def _why_changed(changed):
    if not changed:
        return ""
    logging.info("z_touch: changed since loaded: %s", ", ".join(changed))
    return (
        "the folder z_touch was changed, as by an update, after Klipper had"
        " loaded it; %s" % (SERVICE,)
    )


def _why_apart(door):
    if not (os.path.islink(door) and os.path.islink(FOLDER)):
        return ""
    homes = [os.path.dirname(os.path.realpath(path)) for path in (door, FOLDER)]
    if homes[0] == homes[1]:
        return ""
    return (
        "this module is a link to %s, the folder z_touch in klippy/extras one"
        " to %s; run install.sh of the one that you want, then %s"
        % (homes[0], homes[1], SERVICE)
    )


def _why_other(version):
    if version == __version__:
        return ""
    return (
        "this module is of version %s, the folder z_touch in klippy/extras of"
        " version %s; run install.sh again, or copy both from one place, then"
        " %s" % (version, __version__, SERVICE)
    )
