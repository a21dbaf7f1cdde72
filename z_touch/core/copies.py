# Whether the files that Python has loaded are those on disk, and of one copy.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Python keeps what it has loaded over a RESTART.  A module whose section is new
# is then loaded from the disk of now, beside rooms of before an update.
from __future__ import absolute_import

import os

from .. import __version__

# As the host has found it, which may be a link
FOLDER = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))

SERVICE = "restart the Klipper service (RESTART is not enough)"


# Size and time of each source file below the folder, by its path there
def stamps(folder):
    noted = {}
    for parent, _folders, names in os.walk(folder):
        for name in names:
            if name.endswith(".py"):
                path = os.path.join(parent, name)
                status = os.stat(path)
                noted[os.path.relpath(path, folder)] = (
                    status.st_size,
                    status.st_mtime,
                )
    return noted


# When the first of the modules was loaded
LOADED = stamps(FOLDER)


# Why a module that is being loaded from 'door' does not belong to this folder;
# empty: it does.
def why_mixed(door, version):
    if version != __version__:
        return (
            "this module is of version %s, the folder z_touch in klippy/extras of"
            " version %s; run install.sh again, or copy both from one place,"
            " then %s" % (version, __version__, SERVICE)
        )
    door = os.path.splitext(os.path.abspath(door))[0] + ".py"
    homes = [os.path.dirname(os.path.realpath(path)) for path in (door, FOLDER)]
    if os.path.islink(door) and os.path.islink(FOLDER) and len(set(homes)) > 1:
        return (
            "this module is a link to %s, the folder z_touch in klippy/extras one"
            " to %s; run install.sh of the one that you want, then %s"
            % (homes[0], homes[1], SERVICE)
        )
    if stamps(FOLDER) != LOADED:
        return (
            "the folder z_touch was changed by an update since Klipper has loaded"
            " it; %s, or run install.sh again" % (SERVICE,)
        )
    return ""
