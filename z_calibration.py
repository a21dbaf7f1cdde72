# Z offset calibration with a nozzle endstop and a detachable switch probe
#
# Copyright (C) 2026  the Z calibration developers
#
# This file may be distributed under the terms of the GNU GPLv3 license.
#
# CALIBRATE_Z measures three heights, in this order:
#
#   nozzle   the nozzle tip touches the pin of the Z endstop
#   switch   the body of the probe's switch touches the same pin
#   bed      the probe triggers on the print surface
#
# and applies, as the G-code Z offset:
#
#   Z offset = probe - (switch - nozzle + switch_offset)
#
#      nozzle           switch           bed
#
#       \_/              \_/              \_/          tip of the nozzle
#        I  [s]              [s]              [s]      body of the switch
#        I                    I                :       its plunger, pressed
#     ===I======       =======I===      ===========    bed; I is the pin
#
# Every height is a toolhead Z in mm: the position, in the frame that the last
# homing defined, at which a touch triggered.  G-code offset, bed mesh and skew
# play no part in it.  Up is positive; a touch that is reached lower down has the
# smaller height.
#
#   switch - nozzle   how far the switch body hangs below the nozzle  (> 0)
#   switch_offset     from the body to the trigger point above it     (>= 0)
#   offset            toolhead Z where the nozzle meets the bed; a larger
#                     switch_offset moves the nozzle closer to the bed
from __future__ import absolute_import

import logging
import traceback

__version__ = "1.0.0"

FAULT = None
try:
    from .z_touch.core import copies
    from .z_touch.guide import dialog
    from .z_touch.z_calibration import module
except ImportError as e:
    FAULT = e, traceback.format_exc()
    try:
        # A plugin of Kalico since 2026-01-02 (2c9b0b4de)
        from ..extras.z_touch.core import copies
        from ..extras.z_touch.guide import dialog
        from ..extras.z_touch.z_calibration import module

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
    calibration = module.ZCalibration(config)
    dialog.Setup(calibration.interface)
    return calibration
