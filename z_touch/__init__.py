# The rooms behind the four modules, which are their doors; this folder stands in
# klippy/extras on every host.  A room has the name of its config section:
# z_calibration (with uncertainty: what a result is worth; history: its runs and
# their report; guide: Z_CALIBRATION_SETUP), auto_z_offset, dockable_probe,
# extra_probe.  core is what two or more sections use, and the only place that
# knows how hosts differ.  No room imports a door, and core imports no room.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

__version__ = "1.0.0"
