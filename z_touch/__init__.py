"""The house behind the four modules, which are its doors.

This folder stands in klippy/extras on every host.  A folder here has the name of its config
section: z_calibration, auto_z_offset, dockable_probe, extra_probe.  What they share:

host         what klippy offers; the only place where it is known how hosts differ
touch        travel, come down to a floor, touch          sampling    samples, median
datum        is Z=0 still where it was                    in_force    and what was set
attached     which probe is on the toolhead               pin         the Z pin
command      around every command                         templates   the user's G-code
options      options as fields, parameters of commands    progress    phase, notes
dialog       questions to a person                        wizard      set-ups by dialogs
setup_command   what the commands of both set-ups do
errors       what ends a measurement                      texture     points of a rough plate
report       a program of its own: picture, trend, verdict, text to attach

Nothing is imported later than with its door, so what runs is what was loaded, whatever an
update does to the files.

Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
"""

from __future__ import annotations

import os

__version__ = "1.0.0"

# As the host has found it, which may be a link
FOLDER = os.path.dirname(os.path.abspath(__file__))


def why_apart(door: str, version: str) -> str:
    """Say why a door (its file, its version) does not go with this folder.

    Empty: it does.  A part of another version, or of another clone, lacks what the
    rest expects of it, in the middle of a command.
    """
    restart = "restart the Klipper service (RESTART is not enough)"
    if version != __version__:
        return (
            f"this module is of version {version}, the folder z_touch in klippy/extras"
            f" of version {__version__}; run install.sh again, or copy both from one"
            f" place, then {restart}"
        )
    if not (os.path.islink(door) and os.path.islink(FOLDER)):
        return ""
    home, rooms = (os.path.dirname(os.path.realpath(p)) for p in (door, FOLDER))
    if home == rooms:
        return ""
    return (
        f"this module is a link to {home}, the folder z_touch in klippy/extras one to"
        f" {rooms}; run install.sh of the one that you want, then {restart}"
    )
