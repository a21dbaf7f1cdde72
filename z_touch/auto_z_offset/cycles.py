# The cycles of one AUTO_Z_CALIBRATE, and what becomes of them.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

from .. import errors
from ..sampling import collect, summarize
from ..texture import spread_tolerance
from .heights import check_correction, without_outliers
from .measuring import DIFFER
from .sites import probe_site


# The numbers of one measurement, as the header of the door has them
def formula(name, result):
    return (
        "%s: sensor=%.3f - (probe=%.3f - probe z_offset=%.3f)"
        " + z_offset=%.3f --> correction=%.6f" % ((name,) + tuple(result))
    )


# Bed sensor, then probe, over one point, again and again: corrections are
# sampled as heights are, with a tolerance of their own.
class Cycles:
    # 'run' measures, 'expectations' know the frame; 'bed' is the site.
    def __init__(self, run, settings, expectations, bed):
        self.run = run
        self.host = run.host
        self.settings = settings
        self.expectations = expectations
        self.bed = bed
        # Result of every cycle
        self.results = []

    # Returns the Results that count, and the correction (mm).
    def measure(self):
        corrections = self.collect()
        counted = without_outliers(corrections, self.noise())
        z = summarize(counted, self.settings.sampling.result)
        check_correction(z)
        return tuple(self.results[-len(corrections) :]), z

    # How far (mm) corrections may be apart that are all as good
    def noise(self):
        settings = self.settings
        tolerance = settings.sampling.tolerance
        return spread_tolerance(tolerance, settings.bed_spread)

    # One cycle; returns its correction.
    def take(self):
        result = self.run.measure(probe_site(self.host, self.bed))
        stale = self.expectations.why_stale(result)
        if stale and self.host.axes.homes_with_probe():
            raise errors.CalibrationError(stale)
        if stale:
            self.run.watch.say(stale)
        self.results.append(result)
        self.run.watch.say(formula("cycle", result))
        return result.correction

    # The corrections of the series that agrees
    def collect(self):
        option = "cycles_tolerance"
        settings = self.settings
        tolerance = spread_tolerance(
            settings.cycles_tolerance, settings.bed_spread
        )
        cycles = settings.sampling._replace(
            samples=settings.offset_samples, tolerance=tolerance
        )
        with errors.about("cycles", only=errors.SamplesDiffer):
            corrections = collect(self.take, cycles, self.say, DIFFER, option)
        spread = max(corrections) - min(corrections)
        if spread > self.noise():
            self.say(
                "they differ by %.4f mm, and the touches of one by %.4f at"
                " most: what is farther from the median is left out; %s"
                % (spread, self.noise(), DIFFER)
            )
        return corrections

    def say(self, text):
        self.run.watch.say("cycles: %s" % (text,))
