# What other parts may ask of [z_calibration]: the guide, and the corrections.
# Copyright (C) 2026  the Z calibration developers, under the GNU GPLv3

import collections

from ..core.sampling import AUTO
from ..uncertainty import adaptive
from . import heights
from .sites import SiteFinder

# One site that was touched: its height (toolhead Z, mm), those of all samples, and what
# was odd, in words
Touched = collections.namedtuple("Touched", "z samples warnings")


# Touches single sites, and knows nothing of earlier runs.
class FirstTouches:
    # 'calibration': calibration.Calibration, which is not used by others
    def __init__(self, calibration):
        self._calibration = calibration

    # Toolhead Z (mm) at which the head moves over pin and bed
    def travel_z(self):
        return self._calibration.travel_z

    # To that height, never down
    def lift(self):
        self._calibration.lift()

    # Where a touch of a site ends at the latest (toolhead Z, mm); 'before' are the
    # heights of the sites that come before it.
    def floor(self, *before):
        return self._calibration.expected.floor(*before)

    # Returns Touched; 'before' as in floor().  The head stays there.  Raises
    # CalibrationError.
    def touch(self, name, *before):
        run = self._calibration.run
        z = self._calibration.measure_site(name, *before)
        warnings = [warned.text for warned in run.warnings]
        return Touched(z, list(run.plan.samples[name]), warnings)


# The section as the guide and the corrections see it.  They get records and
# objects of their own from it; the object behind the section is not theirs, and
# only correct() changes something in there.
class Interface:
    # 'section': the object behind [z_calibration]
    def __init__(self, section):
        self.host = section.host
        self._section = section

    ##################################################################
    # Settings
    ##################################################################

    # The settings.Settings in force
    def settings(self):
        return self._section.settings

    # From now on it is this one (mm).  The last run comes to 'z_offset' (mm) with it,
    # which is in force.
    def correct(self, switch_offset, z_offset):
        self._section.use_switch_offset(switch_offset)
        self._section.results.correct(switch_offset, z_offset)

    # What samples should be where so many touches of each site are enough, in words;
    # empty: as it is.  An owner who has set enough of them keeps his.
    def proposed_samples(self, count):
        settings = self.settings()
        samplings = settings.pin, settings.probe
        is_exceeded = settings.counting.is_exceeded(count, samplings)
        if "samples" in settings.said and not is_exceeded:
            return ""
        auto = adaptive.choose(AUTO, settings.target_uncertainty)
        if not auto.impossible(self.host.axes.z_step()):
            return AUTO
        return "%d" % (count,) if is_exceeded else ""

    # So far (mm) the probe may hang below the nozzle, with 'more' on top
    def may_hang(self, more):
        return heights.may_hang(self.settings().z_offset, more)

    # What nozzle and body press: pin.Pin
    def pin(self):
        return self._section.pin

    # Finds and checks sites by the settings in force
    def site_finder(self):
        return SiteFinder(self.host, self.settings())

    ##################################################################
    # One command at a time
    ##################################################################

    # Raises the command's error unless nothing is under way
    def check_idle(self, gcmd):
        self._section.runner.check_idle(gcmd)

    # Raises the command's error while anybody else is asked something
    def check_nobody_asked(self, gcmd):
        self._section.check_nobody_asked(gcmd)

    # Returns what work() does, which meets no G-code offset and leaves none; see
    # running.Runner.  The status shows 'phase' meanwhile.
    def run_command(self, gcmd, work, phase):
        return self._section.run_without_offset(gcmd, work, phase, 0)

    # What has moved the pin since Z was homed on it, in words; empty: nothing has, or
    # Z is not homed on it
    def pin_moved(self):
        is_homed_on = self.settings().position_endstop is not None
        return self._section.homed.moved() if is_homed_on else ""

    ##################################################################
    # Touches
    ##################################################################

    # FirstTouches.  'settings' may be others than those in force; the pin is no
    # higher than pin_z (toolhead Z, mm; None: nobody knows).
    def first_touches(self, settings, sites, pin_z):
        plan = self._section.recorder.make_plan(settings.counting)
        calibration = self._section.new_calibration(settings, sites, plan)
        calibration.rise_over(pin_z)
        return FirstTouches(calibration)

    # Whether something puts the probe on the head: the owner's G-code, or a dock
    def is_fetched(self):
        settings = self.settings()
        return settings.may_attach_late or "start_gcode" in settings.said

    # A context in which a probe that fetches itself stays where it is
    def holding_probe(self):
        return self._section.hooks.holding_probe()

    # Runs start_gcode, which may fetch the probe
    def fetch(self):
        self._section.hooks.start()

    # Runs before_switch_gcode, which fetches it late; 'mark' is of the frame that
    # must be the same after it, None: any frame will do.
    def fetch_late(self, mark):
        self._section.hooks.before_switch(mark)

    # Whether before_switch_gcode was seen to put the probe on
    def is_late(self):
        return self._section.hooks.attachment.is_late

    # Runs end_gcode
    def put_away(self):
        self._section.hooks.end()

    ##################################################################
    # What was measured
    ##################################################################

    # Of the frame as it is
    def mark(self):
        return self._section.frame.mark()

    # What has moved the frame since then, in words; empty: nothing
    def moved_since(self, mark):
        return self._section.frame.moved_since(mark)

    # The results.Last run that was applied
    def last(self):
        return self._section.results.last

    # Why its offset is not right (any more), in words; empty: it is, even if
    # another one is set now.  'besides' counts as nothing.
    def why_not_right(self, besides=None):
        return self._section.results.why_not_right(besides)

    # Why no baby steps can be counted from it, alike
    def why_no_steps(self, besides=None):
        results = self._section.results
        return results.why_not_right(besides) or results.why_moved_by_g92()
