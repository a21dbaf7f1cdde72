# Named probes beside [probe], and the Z offset from a switch laid on the bed
#
# Copyright (C) 2026  the Z calibration developers
#
# This file may be distributed under the terms of the GNU GPLv3 license.
#
# EXTRA_PROBE touches what is wired to the pin of [extra_probe NAME].
# EXTRA_PROBE_CALIBRATE does so with the nozzle on a switch of known thickness
# that somebody lays on the bed, such as a membrane switch:
#
#     \_/               trigger: toolhead Z at which the switch triggers
#    [===]              z_offset: its thickness (mm) at that moment
#   ======= bed         offset: toolhead Z at which the nozzle meets the bed
#
# offset = trigger - z_offset becomes the G-code Z offset.  Or Z is homed so
# much lower: position_endstop of the axis, or z_offset of the probe that homes
# it, is saved as old - offset.  Every height is a toolhead Z, in mm, in the
# frame that the last homing defined; up is positive.
from __future__ import absolute_import

import logging
import traceback

__version__ = "1.0.0"

FAULT = None
try:
    from .z_touch.core import copies
    from .z_touch.extra_probe import module
except ImportError as e:
    FAULT = e, traceback.format_exc()
    try:
        # A plugin of Kalico since 2026-01-02 (2c9b0b4de)
        from ..extras.z_touch.core import copies
        from ..extras.z_touch.extra_probe import module

        FAULT = None
    except (ImportError, ValueError) as e:
        # Nothing is above Klipper's extras
        if "relative import" not in str(e):
            FAULT = e, traceback.format_exc()

# Now, as Python keeps what is loaded over a RESTART
MIXED = "" if FAULT else copies.why_mixed(__file__, __version__)


def load_config_prefix(config):
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
    return module.ExtraProbe(config)
