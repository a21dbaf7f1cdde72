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
from __future__ import absolute_import

import logging
import traceback

__version__ = "1.0.0"

FAULT = None
try:
    from .z_touch.core import copies
    from .z_touch.auto_z_offset import module
except ImportError as e:
    FAULT = e, traceback.format_exc()
    try:
        # A plugin of Kalico since 2026-01-02 (2c9b0b4de)
        from ..extras.z_touch.core import copies
        from ..extras.z_touch.auto_z_offset import module

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
    return module.AutoZOffset(config)
