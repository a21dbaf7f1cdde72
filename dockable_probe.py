# A probe that the printer fetches from a dock and puts back
#
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3
#
# To fetch the probe the head goes to the approach position, from there into the
# dock and out to the extract position; to put it back it goes to the insert
# position, into the dock, and out to the detach position, which strips the
# probe off.  Anywhere else it stays out of a circle around the dock.
#
# Every place is one of the toolhead, in mm; G-code offset and bed mesh play no
# part.  What holds the probe is asked of the pins, never assumed; a pin proves
# nothing before it was seen to change on the way out of the dock.
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
