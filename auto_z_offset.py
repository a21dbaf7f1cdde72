# Correction of an inductive probe with a piezo sensor below the bed
#
# Copyright (C) 2026  the Z calibration developers
#
# This file may be distributed under the terms of the GNU GPLv3 license.
#
# AUTO_Z_CALIBRATE measures two heights over the same point of the bed:
#
#   sensor   the nozzle presses the bed until the sensor below it triggers
#   probe    the inductive probe triggers, at a distance from the bed
#
# and takes from them by how much the probe is wrong:
#
#   correction = sensor - (probe - probe z_offset) + z_offset
#
#      sensor           probe           Z=0 with the correction
#
#       \_/  [p]         \_/  [p]         \_/  [p]     nozzle, probe
#     ===v============         :                :  } z_offset, the air gap
#                      =================  ===============  bed
#
# Both heights are toolhead Z: the position, in mm and in the frame of the last
# homing, at which the touch triggered.  G-code offset, bed mesh and skew play
# no part in it.  Up is positive.
#
#   probe - probe z_offset   where the probe believes the bed to be; about 0,
#                            as Z is homed with this probe
#   sensor                   where the bed is: the nozzle stands on it and has
#                            pressed it down as far as the sensor needs
#   z_offset                 air gap above that point which Z=0 shall mean;
#                            below 0 the nozzle is inside the bed there
#   correction               applied as the G-code Z offset: toolhead Z of
#                            G-code Z=0, where the probe says that the bed is 0
#
# The correction belongs to the probe, not to the homing: the next G28 with
# this probe makes it right again.
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
            from ..extras.z_touch.auto_z_offset import module
        else:
            from .z_touch import why_apart
            from .z_touch.auto_z_offset import module

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
    return module.AutoZOffset(config)
