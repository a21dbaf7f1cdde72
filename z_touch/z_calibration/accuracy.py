# What CALIBRATE_Z_ACCURACY and PROBE_Z_ACCURACY are asked for: where the spread
# is the question, no touch is taken again.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import functools

from ..core import options
from .settings import param_switch_offset, with_counts

# Cycles of CALIBRATE_Z_ACCURACY, at most
MOST_CYCLES = 200


# How many cycles, whether the probe is attached and Z homed in each, and how to
# touch: parameters of CALIBRATE_Z_ACCURACY
class CycleParams:
    def __init__(self, gcmd, settings):
        count = options.param_int
        self.cycles = count(gcmd, "CYCLES", 10, minval=2, maxval=MOST_CYCLES)
        self.attach = bool(count(gcmd, "ATTACH", 1))
        self.home = bool(count(gcmd, "HOME", 0))
        if self.home and not self.attach:
            raise gcmd.error(
                "HOME=1 with ATTACH=0: the probe has to be put away to home;"
                " leave one of the two out"
            )
        self.settings = for_cycles(settings)

    # Of all cycles
    def touches(self):
        settings = self.settings
        return self.cycles * (2 * settings.pin.samples + settings.probe.samples)

    # The settings with SWITCH_OFFSET.  Raises CalibrationError where nobody
    # knows it.
    def with_switch_offset(self, gcmd):
        default = self.settings.switch_offset
        return self.settings._replace(
            switch_offset=param_switch_offset(gcmd, default)
        )


# The settings of cycles, each with the same number of touches
def for_cycles(settings):
    pin, probe = [
        sampling._replace(
            samples=settings.counting.for_cycles(sampling),
            tolerance=float("inf"),
            result="average",
        )
        for sampling in (settings.pin, settings.probe)
    ]
    # At one point: texture would look like a switch that varies
    settings = settings._replace(bed_spread=0.0)
    return with_counts(settings, pin, probe)


# The settings of PROBE_Z_ACCURACY, with its parameters
def for_nozzle(gcmd, settings):
    pin, number = settings.pin, functools.partial(options.param_number, gcmd)
    count = settings.counting.for_spread(pin)
    pin = pin._replace(
        samples=options.param_int(gcmd, "SAMPLES", count, minval=1),
        speed=number("PROBE_SPEED", pin.speed, above=0.0),
        lift_speed=number("LIFT_SPEED", pin.lift_speed, above=0.0),
        retract_dist=number("SAMPLE_RETRACT_DIST", pin.retract_dist, above=0.0),
        tolerance=float("inf"),
    )
    return with_counts(settings, pin, settings.probe)
