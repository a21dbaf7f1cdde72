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
            from ..extras.z_touch.extra_probe import module
        else:
            from .z_touch import why_apart
            from .z_touch.extra_probe import module

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


def load_config_prefix(config):
    """Return the module for the section; an error where z_touch cannot be used."""
    if FAULT:
        logging.error("z_touch: %s\n%s", FAULT, TRACE)
        raise config.error("Section '%s': %s" % (config.get_name(), FAULT))
    return module.ExtraProbe(config)
