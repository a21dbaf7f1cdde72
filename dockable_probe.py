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
# On every other way the toolhead goes around the circle of safe_dock_distance.
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
import logging
import sys
import traceback

__version__ = "1.0.0"

# Why this module cannot be used, for the user and for klippy.log; empty: it can
FAULT, TRACE = "", ""
if sys.version_info < (3, 8):
    FAULT = (
        "this module needs Python 3.8 or newer, and this Klipper runs on %d.%d;"
        " install Klipper anew, as KIAUH does, on a system that has it"
        % sys.version_info[:2]
    )
else:
    try:
        if "plugins" in __name__.split("."):
            # Kalico since 2026-01-02 (2c9b0b4de); the folder is in klippy/extras
            from ..extras.z_touch import why_apart
            from ..extras.z_touch.dockable_probe import module
        else:
            from .z_touch import why_apart
            from .z_touch.dockable_probe import module

        FAULT = why_apart(__file__, __version__)
    except Exception as e:  # noqa: BLE001
        # Whatever it is: klippy would call it internal, or not tell what it is
        TRACE, what = traceback.format_exc(), "cannot be loaded (%s)" % (e,)
        if str(e).endswith("z_touch'"):
            what = "is not in klippy/extras"
        FAULT = (
            "the folder z_touch that belongs to this module %s; run install.sh"
            " again, or copy all of z_touch to klippy/extras, then restart the"
            " Klipper service" % (what,)
        )


def load_config(config):
    """Return the module for the section; an error where z_touch cannot be used."""
    if FAULT:
        logging.error("z_touch: %s\n%s", FAULT, TRACE)
        raise config.error("Section '%s': %s" % (config.get_name(), FAULT))
    return module.DockableProbe(config)
