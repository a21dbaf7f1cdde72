# The pin that nozzle and switch body press: the Z endstop, or one of its own.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from ..core import endstops
from .places import Places

# An endstop that stops the Z motors; what messages call it; where its MCU pin is
# written, in words and as section and option; and where the nozzle has met it.
Pin = collections.namedtuple("Pin", "endstop name origin section option places")


# Another switch than the Z endstop, with endstop_pin; None without.  'old_names'
# have looked the option up.
def read_pin(config, host, old_names):
    if not old_names.was_given("endstop_pin"):
        return None
    option = old_names.name_of("endstop_pin")
    remedy = (
        "give the pin of the switch that the nozzle presses, or leave the"
        " option out to use the Z endstop"
    )
    return Pin(
        endstop=host.endstops.make(config, option, remedy),
        name="endstop_pin (%s)" % (config.get(option),),
        origin="Option 'endstop_pin' in section 'z_calibration'",
        section=config.get_name(),
        option=option,
        places=Places(host, is_homed_on=False),
    )


# The Z endstop, which exists when klippy connects.  Raises the error of a
# configuration where there is none that the nozzle can press.
def find_pin(host):
    axis, endstop = host.axes.z_axis, host.endstops.find_z()
    origin = "Option 'endstop_pin: %s' in section '%s'"
    origin %= (axis.endstop_pin, axis.section)
    if endstop is None:
        raise host.printer.config_error(
            "%s: the printer knows no endstop of that section; the Z axis"
            " needs a switch that the nozzle can press" % (origin,)
        )
    if endstops.is_virtual(endstop):
        raise host.printer.config_error(
            "%s is the probe: z_calibration needs a Z endstop that the"
            " nozzle can press; set it to the pin of that switch, or give"
            " the pin as endstop_pin in section 'z_calibration'" % (origin,)
        )
    return Pin(
        endstop=endstop,
        name="the Z endstop",
        origin=origin,
        section=axis.section,
        option="endstop_pin",
        places=Places(host, is_homed_on=True),
    )
