# What the calibration modules share: sampling, options, the host, the frame of
# the heights, touching and running; what a result is worth, the history of runs
# and its report.  It has no config section; the modules import it, and it stands
# in klippy/extras on every host.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

__version__ = "1.0.0"
