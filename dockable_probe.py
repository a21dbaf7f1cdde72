# A probe that the printer fetches from a dock and puts back
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# Two kinds of trips, seen from above; o and D are positions of the toolhead:
#
#               . - - - .
#           .'      D ----'.----> o  detach_position
#         /         ^ |      \
#        |          | |       |      D  dock_position, where the magnets meet
#         \         | |      /
#           '.      | v    .'
#               ' - o o - '
#   approach_position   extract_position
#     insert_position
#
#   fetch   approach_position --> D --> extract_position, with the probe
#   dock    insert_position --> D --> detach_position, which strips it off
#
# On every other way the head goes around the circle of safe_dock_distance.
#
#           \_/ ........         nozzle
#               [p]    :         body of the probe
#                I ....:         z_offset: from there down to where the probe
#       ================         triggers, the bed               (> 0)
#
# Positions and heights are those of the toolhead in mm, in the frame that the
# last homing defined: X to the right, Y to the back, Z up; G-code offset and
# bed mesh play no part.  x_offset and y_offset lead from the nozzle to the
# probe.
#
# What holds the probe is asked of the pins, never assumed: before it is fetched
# and docked, after that, and before and after each touch.  A pin proves nothing
# before it was seen to change on the way out of the dock.
from __future__ import absolute_import

import logging
import traceback

__version__ = "1.0.0"

FAULT = None
try:
    from .z_touch.core import copies
    from .z_touch.dockable_probe import module
except ImportError as e:
    FAULT = e, traceback.format_exc()
    try:
        # A plugin of Kalico since 2026-01-02 (2c9b0b4de)
        from ..extras.z_touch.core import copies
        from ..extras.z_touch.dockable_probe import module

        FAULT = None
    except (ImportError, ValueError) as e:
        # Nothing is above Klipper's extras
        if "relative import" not in str(e):
            FAULT = e, traceback.format_exc()

# Now, as Python keeps what is loaded over a RESTART
MIXED = "" if FAULT else copies.why_mixed(__file__, __version__)


def load_config(config):
    if FAULT is not None:
        error, trace = FAULT
        logging.error("z_touch cannot be loaded:\n%s", trace)
        what = "cannot be loaded (%s)" % (error,)
        if str(error).endswith(("z_touch'", "named z_touch.core")):
            what = "is not in klippy/extras"
        raise config.error(
            "Section '%s': the folder z_touch that belongs to this module %s;"
            " run install.sh again, or copy z_touch there, too, then restart"
            " the Klipper service" % (config.get_name(), what)
        )
    if MIXED:
        raise config.error("Section '%s': %s" % (config.get_name(), MIXED))
    return module.DockableProbe(config)
