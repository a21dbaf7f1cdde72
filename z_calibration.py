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
            from ..extras.z_touch.z_calibration import module
        else:
            from .z_touch import why_apart
            from .z_touch.z_calibration import module

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
    return module.ZCalibration(config)
